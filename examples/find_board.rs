//! Finds a chessboard in one image and prints its corners.
//!
//! ```text
//! cargo run --example find_board -- examples/board.jpg 9x6
//! ```

#![allow(clippy::print_stdout, reason = "it is what the program is for")]

use std::error::Error;

use plumb::BoardSize;
use plumb::imaging::decode::luma;
use plumb::imaging::frame::SensorKind;
use plumb::imaging::gray::GrayImage;
use plumb::imaging::image_file::frame_from_file;

fn main() -> Result<(), Box<dyn Error>> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let [path, size] = arguments.as_slice() else {
        return Err("give an image and the number of inner corners, as in: board.jpg 9x6".into());
    };
    let board: BoardSize = size.parse()?;

    let mut image = GrayImage::default();
    luma(&frame_from_file(SensorKind::Color, std::fs::read(path)?), &mut image)?;
    let detection = plumb::detect(image.view(), board)?;

    println!("{} corners, blur {:.2} px", detection.corners.len(), detection.blur_px);
    for corner in &detection.corners {
        let (index, pixel) = (corner.index, corner.pixel);
        println!(
            "({}, {}): x {:.3}, y {:.3}, std {:.3} px",
            index.col, index.row, pixel.x, pixel.y, corner.std_px
        );
    }
    Ok(())
}
