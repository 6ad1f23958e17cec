//! The hardest conditions a board is found under, and ordinary ones at every size, rendered with
//! exact truth, and what is found in them.
//!
//!     cargo bench --bench hard_images -- FOLDER
//!
//! Writes FOLDER/NAME.png (the image), FOLDER/NAME.jpg (what was found drawn over it), and
//! FOLDER/truth.json, which `benches/detectors.py FOLDER` shows to other detectors. Prints how many
//! corners were found and how far off they are.

#![expect(clippy::print_stdout, reason = "a benchmark prints what it measures")]

#[path = "hard_cases.rs"]
mod hard_cases;

use std::error::Error;
use std::path::{Path, PathBuf};

use image::codecs::jpeg::JpegEncoder;
use image::{DynamicImage, RgbImage};
use plumb::detection::board_detection::DetectOptions;
use plumb::detection::detector::Detector;
use plumb::geometry::board::{BoardSize, Chessboard};
use plumb::geometry::pixel::{ImageSize, Pixel};
use plumb::imaging::draw::draw_corners;
use plumb::imaging::gray::GrayImage;

use crate::hard_cases::{Case, SQUARE_M, is_seen, render};

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

/// Two boards that fill half of the image's height, at every size that cameras commonly have.
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

/// Searches one image, writes it with the detection; returns its line of the truth.
fn search(case: &Case, folder: &Path) -> Result<serde_json::Value, Box<dyn Error>> {
    let [cols, rows] = case.board;
    let board = Chessboard::new(BoardSize::new(cols, rows)?, SQUARE_M)?;
    let (rendered, corners) = render(case, board)?;
    let file = format!("{}.png", case.name);
    rendered.save(folder.join(&file))?;
    let image = GrayImage::from_pixels(
        case.size.width as usize,
        case.size.height as usize,
        rendered.as_raw().clone(),
    )
    .ok_or("size")?;
    let found =
        Detector::new(board.size).find_board(image.view(), &DetectOptions { allow_partial: true });
    let mut drawn: RgbImage = DynamicImage::ImageLuma8(rendered).into_rgb8();
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
    let folder = PathBuf::from(folder.unwrap_or_else(|| "target/hard_images".into()));
    std::fs::create_dir_all(&folder)?;
    let mut images = Vec::new();
    for case in hard_cases().into_iter().chain(ordinary_cases()) {
        images.push(search(&case, &folder)?);
    }
    let truth = serde_json::json!({ "images": images });
    std::fs::write(folder.join("truth.json"), serde_json::to_string(&truth)?)?;
    Ok(())
}
