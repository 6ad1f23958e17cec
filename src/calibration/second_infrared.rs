//! The right infrared sensor of a stereo depth camera: its lens, and where it is beside color.
//!
//! Depth is measured in the left one's view, so that the right one adds nothing to depth: it is
//! solved with color alone, as a rig of two cameras.

use crate::calibration::result::{CalibratedSensor, Calibration, Grade};
use crate::calibration::sensor::SensorId;
use crate::calibration::solve_rig::{
    RigCameraInput, RigError, RigInput, RigPose, SolvedRig, solve_rig,
};
use crate::estimation::camera::CameraOptions;
use crate::estimation::problem::{BoardView, Correspondence, LensChoice};
use crate::geometry::pixel::ImageSize;
use crate::geometry::target::Target;
use crate::imaging::frame::SensorKind;

/// What was seen at one instant.
#[derive(Debug, Clone, PartialEq)]
pub struct StereoCapture {
    /// Its path or sequence number.
    pub name: String,
    /// The board in the color picture; empty where it wasn't found.
    pub color: Vec<Correspondence>,
    /// The board in the right infrared picture; empty where it wasn't found.
    pub infrared2: Vec<Correspondence>,
}

/// Color and right infrared of one camera.
#[derive(Debug, Clone, PartialEq)]
pub struct StereoInput {
    /// The board.
    pub board: Target,
    /// The size of the color pictures.
    pub color_size: ImageSize,
    /// The size of the right infrared pictures.
    pub infrared2_size: ImageSize,
    /// What was seen.
    pub captures: Vec<StereoCapture>,
}

/// Solves color and right infrared together, both with the lens model that color has taken.
///
/// # Errors
/// [`RigError`]: one of them cannot be calibrated, or they never saw the board together.
pub fn solve_second_infrared(
    input: &StereoInput,
    options: &CameraOptions,
) -> Result<SolvedRig, RigError> {
    let views = |seen: fn(&StereoCapture) -> &Vec<Correspondence>| {
        let with_board =
            input.captures.iter().enumerate().filter(|(_, capture)| !seen(capture).is_empty());
        let view = |capture: &StereoCapture| BoardView {
            name: capture.name.clone(),
            correspondences: seen(capture).clone(),
        };
        with_board.map(|(moment, capture)| (moment, view(capture))).collect()
    };
    let camera = |name: &str, image_size, views| RigCameraInput {
        name: name.to_owned(),
        image_size,
        given: None,
        views,
    };
    let cameras = vec![
        camera("color", input.color_size, views(|capture| &capture.color)),
        camera("infrared2", input.infrared2_size, views(|capture| &capture.infrared2)),
    ];
    solve_rig(&RigInput { board: input.board, cameras }, options)
}

/// `calibration`, which has color, with its right infrared sensor and where that is; where it
/// cannot be had, color stays as it is and the verdict says why.
pub fn with_second_infrared(
    mut calibration: Calibration,
    input: &StereoInput,
    options: &CameraOptions,
) -> Calibration {
    let lens = calibration.color().map(|color| LensChoice::Model(color.lens.model()));
    let options = CameraOptions { lens: lens.unwrap_or(options.lens), ..options.clone() };
    match solve_second_infrared(input, &options) {
        Ok(SolvedRig { cameras, extrinsics, .. }) => {
            let infrared2 = SensorId::own(SensorKind::Infrared2);
            let sensor = cameras.into_iter().find(|(name, _)| name == SensorKind::Infrared2.name());
            if let Some((_, sensor)) = sensor {
                calibration.add_sensor(CalibratedSensor::image(infrared2.clone(), sensor));
            }
            let color = SensorId::own(SensorKind::Color);
            let placed = |pose: RigPose| pose.between(color.clone(), infrared2.clone());
            calibration.extrinsics.extend(extrinsics.into_iter().map(placed));
        }
        Err(reason) => {
            calibration.verdict.grade = calibration.verdict.grade.min(Grade::Usable);
            calibration.verdict.reasons.push(format!("infrared2 is not calibrated: {reason}"));
        }
    }
    calibration
}

#[cfg(test)]
mod tests {
    use nalgebra::Vector3;
    use rand::{RngExt, SeedableRng};

    use super::*;
    use crate::geometry::board::{BoardSize, Chessboard};
    use crate::geometry::camera_matrix::CameraMatrix;
    use crate::geometry::lens::{Lens, LensModel};
    use crate::geometry::pixel::Pixel;
    use crate::geometry::pose::Pose;

    const NOISE_PX: f64 = 0.05;
    const SIZE: ImageSize = ImageSize::new(640, 480);

    /// A board that is turned and carried about before color and, 75 mm beside it, right infrared.
    fn input(color: &Lens, infrared2: &Lens, color_from_infrared2: Pose) -> StereoInput {
        let board = Chessboard::new(BoardSize::new(8, 5).unwrap(), 0.03).unwrap();
        let mut noise = rand_chacha::ChaCha8Rng::seed_from_u64(5);
        let mut seen = |lens: &Lens, camera_from_board: Pose| -> Vec<Correspondence> {
            let corner = |point_in_board| {
                let pixel = lens.pixel_from_point(&(camera_from_board * point_in_board)).unwrap();
                let mut noisy = |at: f64| at + NOISE_PX * noise.random_range(-1.7..1.7);
                Correspondence {
                    point_in_board,
                    pixel: Pixel::new(noisy(pixel.x), noisy(pixel.y)),
                    std_px: NOISE_PX,
                }
            };
            board.corners_in_board().into_iter().map(corner).collect()
        };
        let capture = |k: usize| {
            let across = |factor: f64| (k as f64 * factor).sin();
            let turn = Vector3::new(0.5 * across(1.3), 0.5 * across(2.1), 0.3 * across(0.7));
            let shift = Vector3::new(
                -0.1 + 0.12 * across(3.1),
                -0.06 + 0.08 * across(1.9),
                0.7 + 0.1 * across(0.9),
            );
            let color_from_board = Pose::from_axis_angle(turn, shift);
            StereoCapture {
                name: k.to_string(),
                color: seen(color, color_from_board),
                infrared2: seen(infrared2, color_from_infrared2.inverse() * color_from_board),
            }
        };
        StereoInput {
            board: board.into(),
            color_size: SIZE,
            infrared2_size: SIZE,
            captures: (0..15).map(capture).collect(),
        }
    }

    #[test]
    fn the_right_sensor_is_placed_beside_color() {
        let lens =
            |fx: f64| Lens::pinhole(CameraMatrix { fx, fy: fx, cx: 322.0, cy: 238.0, skew: 0.0 });
        let truth = Pose::from_axis_angle(
            Vector3::new(0.01, -0.02, 0.005),
            Vector3::new(0.075, 0.001, -0.002),
        );
        let mut input = input(&lens(600.0), &lens(575.0), truth);
        let options = CameraOptions {
            lens: LensChoice::Model(LensModel::Pinhole),
            ..CameraOptions::default()
        };
        let solved = solve_second_infrared(&input, &options).unwrap();
        let found = &solved.extrinsics[0];
        let off_m = found.target_from_source.translation() - truth.translation();
        for (off_m, std_m) in off_m.iter().zip(found.translation_std_m) {
            assert!(off_m.abs() < 4.0 * std_m && std_m < 1e-3, "{found:?}");
        }
        assert!(found.target_from_source.angle_to(&truth) < 1e-3, "{found:?}");
        let infrared2 = &solved.cameras[1];
        let off_px = infrared2.1.lens.matrix.fx - 575.0;
        assert!(
            infrared2.0 == "infrared2" && off_px.abs() < 4.0 * infrared2.1.lens_std[0],
            "{off_px}"
        );

        input.captures.iter_mut().for_each(|capture| capture.infrared2.clear());
        let error = solve_second_infrared(&input, &options).unwrap_err().to_string();
        assert!(
            error.starts_with("only 1 of 2 cameras can be calibrated; camera `infrared2`: "),
            "{error}"
        );
    }
}
