//! Images of a chessboard under stated conditions, rendered with exact truth: what
//! `hard_images` and `thresholds` search.

use std::error::Error;

use image::codecs::jpeg::{JpegDecoder, JpegEncoder};
use image::{DynamicImage, GrayImage as Luma};
use nalgebra::{UnitQuaternion, Vector3};
use plumb::geometry::board::Chessboard;
use plumb::geometry::lens::{Lens, LensModel};
use plumb::geometry::pixel::{ImageSize, Pixel};
use plumb::geometry::pose::Pose;
use plumb::simulation::{Background, BoardPattern, ImageSensor, Renderer};

pub const SQUARE_M: f64 = 0.03;

/// One condition.
pub struct Case {
    pub name: String,
    pub size: ImageSize,
    pub board: [u32; 2],
    pub blur_px: f64,
    pub full_well_e: f64,
    pub cell_px: f64,
    pub tilt_deg: f64,
    pub roll_deg: f64,
    /// Where the board's middle is, as a part of its distance from the axis.
    pub aside: [f64; 2],
    /// k₁ of the lens.
    pub distortion: f64,
    /// Quality of a JPEG that the image goes through.
    pub jpeg: Option<u8>,
    /// A gray bar over the board: left, top, right, bottom.
    pub bar: Option<[u32; 4]>,
}

impl Case {
    pub fn new(name: impl Into<String>) -> Self {
        Self {
            name: name.into(),
            size: ImageSize::new(640, 480),
            board: [9, 6],
            blur_px: 0.7,
            full_well_e: 8_000.0,
            cell_px: 40.0,
            tilt_deg: 25.0,
            roll_deg: 12.0,
            aside: [0.0, 0.0],
            distortion: -0.1,
            jpeg: None,
            bar: None,
        }
    }
}

/// A rendered image, and where its corners are.
pub fn render(case: &Case, board: Chessboard) -> Result<(Luma, Vec<Pixel>), Box<dyn Error>> {
    let (width, height) = (f64::from(case.size.width), f64::from(case.size.height));
    let focal_px = width / 1.28;
    let middle_px = [width / 2.0 + 2.0, height / 2.0 - 2.0];
    let radial = [case.distortion, case.distortion * -0.25];
    let parameters =
        [focal_px, focal_px, middle_px[0], middle_px[1], 0.0, radial[0], radial[1], 0.0, 0.0, 0.0];
    let lens = Lens::from_parameters(LensModel::Brown, &parameters).ok_or("lens")?;
    let sensor = ImageSensor {
        blur_px: case.blur_px,
        full_well_e: case.full_well_e,
        ..ImageSensor::new(case.size, lens)
    };
    let tilt = UnitQuaternion::from_scaled_axis(
        Vector3::new(0.3, 1.0, 0.0).normalize() * case.tilt_deg.to_radians(),
    );
    let roll = UnitQuaternion::from_scaled_axis(Vector3::z() * case.roll_deg.to_radians());
    let distance_m = SQUARE_M * focal_px / case.cell_px;
    let aim = Vector3::new(case.aside[0], case.aside[1], 1.0) * distance_m;
    let (cols, rows) = (f64::from(board.size.cols), f64::from(board.size.rows));
    let middle = Vector3::new(cols - 1.0, rows - 1.0, 0.0) * (SQUARE_M / 2.0);
    let camera_from_board = Pose::new(tilt * roll, aim - tilt * roll * middle);
    let place = |k: u32| {
        let (col, row) = (f64::from(k % board.size.cols), f64::from(k / board.size.cols));
        let point = camera_from_board * nalgebra::Point3::new(col * SQUARE_M, row * SQUARE_M, 0.0);
        lens.pixel_from_point(&point).unwrap_or(Pixel::new(f64::NAN, f64::NAN))
    };
    let corners = (0..board.size.cols * board.size.rows).map(place).collect();
    let mut renderer = Renderer::new(sensor, BoardPattern::new(board), &Background::new(7, 12));
    let light = renderer.light(&[camera_from_board]);
    let image = renderer.sensor().develop(&light, 3, 0);
    let pixels = (0..image.view().height()).flat_map(|y| image.view().row(y).to_vec()).collect();
    let mut image = Luma::from_raw(case.size.width, case.size.height, pixels).ok_or("pixels")?;
    if let Some([left, top, right, bottom]) = case.bar {
        let inside = |x: u32, y: u32| (left..right).contains(&x) && (top..bottom).contains(&y);
        image
            .enumerate_pixels_mut()
            .filter(|(x, y, _)| inside(*x, *y))
            .for_each(|(_, _, pixel)| pixel.0 = [140]);
    }
    if let Some(quality) = case.jpeg {
        let mut bytes = Vec::new();
        JpegEncoder::new_with_quality(&mut bytes, quality).encode_image(&image)?;
        image = DynamicImage::from_decoder(JpegDecoder::new(std::io::Cursor::new(bytes))?)?
            .into_luma8();
    }
    Ok((image, corners))
}

/// Whether a corner is to be seen.
pub fn is_seen(case: &Case, corner: Pixel) -> bool {
    let inside = |[left, top, right, bottom]: [f64; 4]| {
        (left..right).contains(&corner.x) && (top..bottom).contains(&corner.y)
    };
    let covered = case.bar.is_some_and(|bar| {
        let [left, top, right, bottom] = bar.map(f64::from);
        inside([left - 4.0, top - 4.0, right + 3.0, bottom + 3.0])
    });
    inside([2.0, 2.0, f64::from(case.size.width) - 3.0, f64::from(case.size.height) - 3.0])
        && !covered
}
