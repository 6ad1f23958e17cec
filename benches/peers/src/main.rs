//! Corners as other detectors find them: `plumb-peers METHOD REPEATS IMAGE…` prints a line of
//! JSON for each image, `{"corners": [[x, y], …], "elapsed_ms": …}`, the fastest of so many
//! times, without reading the image.
//!
//! METHOD is `chess-corners` (its saddle-point refinement, the most exact it has) or
//! `calib-targets` (its best of several thresholds, with the same refinement).

use std::error::Error;
use std::time::Instant;

use calib_targets::chessboard::ChessboardParams;
use calib_targets::detect::{default_chess_config, detect_chessboard_best};
use chess_corners::{Detector, DetectorConfig, ImageRefiner};
use image::GrayImage;

type Corners = Vec<[f32; 2]>;
type Find = Box<dyn FnMut(&GrayImage) -> Result<Corners, Box<dyn Error>>>;

fn chess_corners() -> Result<Find, Box<dyn Error>> {
    let config = DetectorConfig::chess().with_refiner(ImageRefiner::saddle_point());
    let mut detector = Detector::new(config)?;
    Ok(Box::new(move |image| Ok(detector.detect(image)?.iter().map(|corner| [corner.x, corner.y]).collect())))
}

fn calib_targets() -> Find {
    let config = default_chess_config().with_refiner(calib_targets::detect::ImageRefiner::saddle_point());
    Box::new(move |image| {
        let board = detect_chessboard_best(image, &config, &ChessboardParams::sweep_default());
        // No board is an answer, too.
        let corners = board.map(|board| board.corners.iter().map(|corner| [corner.position.x, corner.position.y]).collect());
        Ok(corners.unwrap_or_default())
    })
}

fn main() -> Result<(), Box<dyn Error>> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let [method, repeats, paths @ ..] = arguments.as_slice() else {
        return Err("usage: plumb-peers chess-corners|calib-targets REPEATS IMAGE…".into());
    };
    let mut find = match method.as_str() {
        "chess-corners" => chess_corners()?,
        "calib-targets" => calib_targets(),
        other => return Err(format!("no detector is called {other}: chess-corners or calib-targets").into()),
    };
    let repeats: u32 = repeats.parse()?;
    for path in paths {
        let image = image::open(path)?.into_luma8();
        let (mut corners, mut fastest_ms) = (Corners::new(), f64::INFINITY);
        for _ in 0..repeats.max(1) {
            let start = Instant::now();
            corners = find(&image)?;
            fastest_ms = fastest_ms.min(1e3 * start.elapsed().as_secs_f64());
        }
        println!("{}", serde_json::json!({ "corners": corners, "elapsed_ms": fastest_ms }));
    }
    Ok(())
}
