//! Calibrates a camera from correspondences of board points and pixels, and prints each lens
//! parameter with its standard deviation.
//!
//! The pixels are projected through a known lens and rounded to a tenth, so that the answer can be
//! compared with the truth.
//!
//! ```text
//! cargo run --example solve_correspondences
//! ```

#![allow(clippy::print_stdout, reason = "it is what the program is for")]

use std::error::Error;

use nalgebra::Vector3;
use plumb::geometry::lens::{Lens, LensModel};
use plumb::geometry::pixel::{ImageSize, Pixel};
use plumb::geometry::pose::Pose;
use plumb::{BoardSize, BoardView, CameraOptions, CameraProblem, Chessboard, Correspondence};

fn main() -> Result<(), Box<dyn Error>> {
    let board = Chessboard::new(BoardSize::new(9, 6)?, 0.025)?;
    let truth = Lens::from_parameters(LensModel::Radial, &[600.0, 600.0, 320.0, 240.0, 0.0, -0.1])
        .ok_or("a radial lens has six parameters")?;
    let problem = CameraProblem {
        image_size: ImageSize::new(640, 480),
        views: (0..12).map(|number| view(&board, &truth, number)).collect(),
    };

    let solved = plumb::calibrate(&problem, &CameraOptions::default())?;

    let estimate = &solved.estimate;
    println!("lens {}, rms {:.3} px", estimate.lens.model(), estimate.rms_px);
    let names = Lens::parameter_names(estimate.lens.model());
    for (i, (name, value)) in names.iter().zip(estimate.lens.parameters()).enumerate() {
        let std = estimate.lens_covariance[(i, i)].sqrt();
        println!("{name:>5}: {value:9.4} ± {std:.4}");
    }
    Ok(())
}

/// What the camera measures of the board in one of several poses.
fn view(board: &Chessboard, lens: &Lens, number: u32) -> BoardView {
    let angle = f64::from(number) * 0.9;
    let camera_from_board = Pose::from_axis_angle(
        Vector3::new(0.5 * angle.cos(), 0.5 * angle.sin(), 0.1 * angle),
        Vector3::new(-0.1 + 0.04 * angle.sin(), -0.06 + 0.03 * angle.cos(), 0.45),
    );
    let measured = |point_in_board| {
        let pixel = lens.pixel_from_point(&(camera_from_board * point_in_board))?;
        let rounded = Pixel::new((pixel.x * 10.0).round() / 10.0, (pixel.y * 10.0).round() / 10.0);
        Some(Correspondence { point_in_board, pixel: rounded, std_px: 0.1 / 12f64.sqrt() })
    };
    BoardView {
        name: format!("view {number}"),
        correspondences: board.corners_in_board().into_iter().filter_map(measured).collect(),
    }
}
