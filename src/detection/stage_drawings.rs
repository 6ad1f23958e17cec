//! The stages of the search on one photograph, one after the other, and their drawings in
//! `README.md`.

use std::path::{Path, PathBuf};

use image::{Rgb, RgbImage};

use crate::detection::board_detection::DetectOptions;
use crate::detection::detector::Detector;
use crate::detection::measure::Probe;
use crate::detection::search::candidates::Candidate;
use crate::detection::search::pyramid::coarsest_level;
use crate::detection::thresholds::Thresholds;
use crate::geometry::board::BoardSize;
use crate::geometry::pixel::Pixel;
use crate::imaging::decode::{encode_jpeg_rgb, luma};
use crate::imaging::draw::{Pen, draw_corners, draw_line, draw_polygon, draw_ring};
use crate::imaging::frame::SensorKind;
use crate::imaging::gray::GrayImage;
use crate::imaging::image_file::frame_from_file;

/// Width of the drawings, in pixels.
const WIDTH: u32 = 320;
const PEN: Pen = Pen { color: Rgb([255, 64, 64]), width_px: 1.5 };

fn project(path: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join(path)
}

/// A drawing of `gray` (a pixel of an image of `size`), scaled by `scale`.
fn canvas(size: [usize; 2], scale: f64, gray: impl Fn(usize, usize) -> u8) -> RgbImage {
    let [width, height] = size.map(|side| (side as f64 * scale).round() as u32);
    RgbImage::from_fn(width, height, |x, y| {
        let at = |v: u32, side: usize| ((f64::from(v) / scale) as usize).min(side - 1);
        Rgb([gray(at(x, size[0]), at(y, size[1])); 3])
    })
}

/// Writes the drawings where `PLUMB_STAGE_DRAWINGS` says; only draws them without it.
fn save(name: &str, drawing: &RgbImage) {
    let bytes = encode_jpeg_rgb(drawing, 80);
    if let Some(folder) = std::env::var_os("PLUMB_STAGE_DRAWINGS") {
        std::fs::write(Path::new(&folder).join(name), bytes).expect("the folder is there");
    }
}

#[test]
fn each_stage_leaves_what_the_next_one_needs() {
    let mut image = GrayImage::default();
    let file = std::fs::read(project("examples/board.jpg")).expect("the example's image");
    luma(&frame_from_file(SensorKind::Color, file), &mut image).expect("a JPEG");
    let mut detector = Detector::new(BoardSize { cols: 9, rows: 6 });
    let detection =
        detector.find_board(image.view(), &DetectOptions::default()).expect("a whole board");

    let coarsest = coarsest_level(image.size(), 9);
    let level = detector.search.pyramid.level(image.view(), coarsest);
    detector.search.levels.response.compute(level, 1);
    let probe = Probe { image: level, thresholds: &Thresholds::DEFAULT };
    detector.search.levels.candidates.search(probe, &detector.search.levels.response, 54);
    let size = [level.width(), level.height()];
    let scale = f64::from(WIDTH) / size[0] as f64;
    let plain = canvas(size, scale, |x, y| level.row(y)[x]);
    let place = |p: crate::detection::vec2::Vec2| {
        Pixel::new((f64::from(p.x) + 0.5) * scale - 0.5, (f64::from(p.y) + 0.5) * scale - 0.5)
    };
    save("1-level.jpg", &plain);
    let response = &detector.search.levels.response;
    save("2-response.jpg", &canvas(size, scale, |x, y| response.row(y)[x].saturating_mul(3)));

    let candidates = &detector.search.levels.candidates.found;
    assert!(candidates.len() >= 54 / 2, "{} candidates", candidates.len());
    let mut drawing = plain.clone();
    for Candidate { pixel, edges, .. } in candidates {
        for edge in edges {
            draw_line(&mut drawing, place(pixel - 2.0 * edge), place(pixel + 2.0 * edge), PEN);
        }
    }
    save("3-candidates.jpg", &drawing);

    detector.search.levels.neighborhood.fill(candidates, size[0], size[1]);
    let seed = (0..candidates.len())
        .find_map(|first| {
            detector.search.levels.neighborhood.seed(candidates, first, size[0] as f32)
        })
        .expect("a square");
    let mut drawing = plain.clone();
    let outline = [0, 1, 3, 2].map(|k| place(candidates[seed.corners[k]].pixel));
    draw_polygon(&mut drawing, &outline, PEN);
    save("4-seed.jpg", &drawing);

    let scale = f64::from(WIDTH) / image.width() as f64;
    let whole = canvas([image.width(), image.height()], scale, |x, y| image.row(y)[x]);
    let mut drawing = whole.clone();
    for &(i, j) in &detector.search.levels.part.members {
        let at = |i, j| {
            let p = detector.search.levels.part.pixel(i, j)?;
            Some(Pixel::new(f64::from(p.x) * scale, f64::from(p.y) * scale))
        };
        let Some(from) = at(i, j) else { continue };
        draw_ring(&mut drawing, from, 1.5, PEN);
        for to in [at(i + 1, j), at(i, j + 1)].into_iter().flatten() {
            draw_line(&mut drawing, from, to, Pen { width_px: 1.0, ..PEN });
        }
    }
    save("5-grid.jpg", &drawing);

    assert_eq!(detector.search.levels.part.members.len(), 54);
    assert_eq!(detection.corners.len(), 54);
    let corners = detection.corners.iter();
    let pixels: Vec<Pixel> =
        corners.map(|corner| Pixel::new(corner.pixel.x * scale, corner.pixel.y * scale)).collect();
    let mut drawing = whole;
    draw_corners(&mut drawing, &pixels);
    save("6-detection.jpg", &drawing);
}
