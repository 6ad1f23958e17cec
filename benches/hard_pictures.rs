//! The hardest conditions a board is found under, and ordinary ones at every size, rendered with
//! exact truth, and what is found in them.
//!
//!     cargo bench --bench hard_pictures -- FOLDER
//!
//! Writes FOLDER/NAME.png (the picture), FOLDER/NAME.jpg (what was found drawn over it), and
//! FOLDER/truth.json, which `benches/detectors.py FOLDER` shows to other detectors. Prints how many
//! corners were found and how far off they are.

#![expect(clippy::print_stdout, reason = "a benchmark prints what it measures")]

use std::error::Error;
use std::path::{Path, PathBuf};

use image::codecs::jpeg::{JpegDecoder, JpegEncoder};
use image::{DynamicImage, GrayImage as Luma, RgbImage};
use nalgebra::{UnitQuaternion, Vector3};
use plumb::detection::board_detection::DetectOptions;
use plumb::detection::detector::Detector;
use plumb::geometry::board::{BoardSize, Chessboard};
use plumb::geometry::lens::{Lens, LensModel};
use plumb::geometry::pixel::{ImageSize, Pixel};
use plumb::geometry::pose::Pose;
use plumb::imaging::draw::draw_corners;
use plumb::imaging::gray::GrayImage;
use plumb::simulation::{Background, BoardPattern, PictureSensor, Renderer};

const SQUARE_M: f64 = 0.03;

/// One condition.
struct Case {
    name: String,
    size: ImageSize,
    board: [u32; 2],
    blur_px: f64,
    full_well_e: f64,
    cell_px: f64,
    tilt_deg: f64,
    roll_deg: f64,
    /// Where the board's middle is, as a part of its distance from the axis.
    aside: [f64; 2],
    /// k₁ of the lens.
    distortion: f64,
    /// Quality of a JPEG that the picture goes through.
    jpeg: Option<u8>,
    /// A gray bar over the board: left, top, right, bottom.
    bar: Option<[u32; 4]>,
}

impl Case {
    fn new(name: impl Into<String>) -> Self {
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

fn hard_cases() -> [Case; 8] {
    let case = Case::new;
    [
        Case { tilt_deg: 75.0, roll_deg: 5.0, cell_px: 56.0, ..case("tilt") },
        Case { blur_px: 4.0, ..case("blur") },
        Case { full_well_e: 60.0, ..case("noise") },
        Case { bar: Some([260, 90, 360, 400]), ..case("covered") },
        Case { aside: [0.42, 0.2], ..case("cut") },
        Case { cell_px: 6.0, tilt_deg: 10.0, ..case("small") },
        Case {
            distortion: -0.3,
            cell_px: 62.0,
            roll_deg: 0.0,
            tilt_deg: 15.0,
            ..case("distorted")
        },
        Case { jpeg: Some(12), ..case("jpeg") },
    ]
}

/// Two boards that fill half of the picture's height, at every size that cameras commonly have.
fn ordinary_cases() -> impl Iterator<Item = Case> {
    let sizes = [(640, 480), (1280, 720), (1920, 1080), (3840, 2160)];
    let boards = [[9, 6], [10, 10]];
    boards.into_iter().flat_map(move |board| {
        sizes.map(|(width, height)| Case {
            size: ImageSize::new(width, height),
            board,
            cell_px: f64::from(height) * 0.6 / f64::from(board[1]),
            ..Case::new(format!("{}x{} at {width}x{height}", board[0], board[1]))
        })
    })
}

/// A rendered picture, and where its corners are.
fn render(case: &Case, board: Chessboard) -> Result<(Luma, Vec<Pixel>), Box<dyn Error>> {
    let (width, height) = (f64::from(case.size.width), f64::from(case.size.height));
    let focal_px = width / 1.28;
    let middle_px = [width / 2.0 + 2.0, height / 2.0 - 2.0];
    let radial = [case.distortion, case.distortion * -0.25];
    let parameters =
        [focal_px, focal_px, middle_px[0], middle_px[1], 0.0, radial[0], radial[1], 0.0, 0.0, 0.0];
    let lens = Lens::from_parameters(LensModel::Brown, &parameters).ok_or("lens")?;
    let sensor = PictureSensor {
        blur_px: case.blur_px,
        full_well_e: case.full_well_e,
        ..PictureSensor::new(case.size, lens)
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
    let mut picture = Luma::from_raw(case.size.width, case.size.height, pixels).ok_or("pixels")?;
    if let Some([left, top, right, bottom]) = case.bar {
        let inside = |x: u32, y: u32| (left..right).contains(&x) && (top..bottom).contains(&y);
        picture
            .enumerate_pixels_mut()
            .filter(|(x, y, _)| inside(*x, *y))
            .for_each(|(_, _, pixel)| pixel.0 = [140]);
    }
    if let Some(quality) = case.jpeg {
        let mut bytes = Vec::new();
        JpegEncoder::new_with_quality(&mut bytes, quality).encode_image(&picture)?;
        picture = DynamicImage::from_decoder(JpegDecoder::new(std::io::Cursor::new(bytes))?)?
            .into_luma8();
    }
    Ok((picture, corners))
}

/// Whether a corner is to be seen.
fn is_seen(case: &Case, corner: Pixel) -> bool {
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

/// Searches one image, writes it with the detection; returns its line of the truth.
fn search(case: &Case, folder: &Path) -> Result<serde_json::Value, Box<dyn Error>> {
    let [cols, rows] = case.board;
    let board = Chessboard::new(BoardSize::new(cols, rows)?, SQUARE_M)?;
    let (picture, corners) = render(case, board)?;
    let file = format!("{}.png", case.name);
    picture.save(folder.join(&file))?;
    let image = GrayImage::from_pixels(
        case.size.width as usize,
        case.size.height as usize,
        picture.as_raw().clone(),
    )
    .ok_or("size")?;
    let found =
        Detector::new(board.size).find_board(image.view(), &DetectOptions { allow_partial: true });
    let mut drawn: RgbImage = DynamicImage::ImageLuma8(picture).into_rgb8();
    let seen: Vec<bool> = corners.iter().map(|corner| is_seen(case, *corner)).collect();
    let of_seen = seen.iter().filter(|seen| **seen).count();
    match found {
        Ok(detection) => {
            let pixels: Vec<Pixel> = detection.corners.iter().map(|corner| corner.pixel).collect();
            let nearest = |pixel: &Pixel| {
                corners.iter().map(|c| c.distance_px(*pixel)).fold(f64::MAX, f64::min)
            };
            let squares: f64 = pixels.iter().map(|pixel| nearest(pixel).powi(2)).sum();
            let rms_px = (squares / pixels.len() as f64).sqrt();
            println!(
                "{:<20} {:>3} of {of_seen} corners, {rms_px:.4} px rms",
                case.name,
                pixels.len()
            );
            draw_corners(&mut drawn, &pixels);
        }
        Err(reason) => println!("{:<20} none of {of_seen} corners: {reason}", case.name),
    }
    let marked = std::fs::File::create(folder.join(format!("{}.jpg", case.name)))?;
    JpegEncoder::new_with_quality(marked, 82).encode_image(&drawn)?;
    let corners: Vec<[f64; 2]> = corners.iter().map(|corner| [corner.x, corner.y]).collect();
    Ok(
        serde_json::json!({ "file": file, "cols": cols, "rows": rows, "corners": corners, "seen": seen }),
    )
}

fn main() -> Result<(), Box<dyn Error>> {
    let folder = std::env::args().skip(1).find(|argument| !argument.starts_with("--"));
    let folder = PathBuf::from(folder.unwrap_or_else(|| "target/hard_pictures".into()));
    std::fs::create_dir_all(&folder)?;
    let mut pictures = Vec::new();
    for case in hard_cases().into_iter().chain(ordinary_cases()) {
        pictures.push(search(&case, &folder)?);
    }
    let truth = serde_json::json!({ "pictures": pictures });
    std::fs::write(folder.join("truth.json"), serde_json::to_string(&truth)?)?;
    Ok(())
}
