//! AprilGrids that move by most of the interval between two tags while an image is exposed: their
//! edges run into each other, and corners are found where the whole print is most like the image.

use nalgebra::{Matrix3, Vector2, Vector3};
use plumb::detection::coded::detector::TargetDetector;
use plumb::geometry::dictionary::Dictionary;
use plumb::geometry::printed_board::PrintedBoard;
use plumb::geometry::target::{AprilGrid, Target};
use plumb::imaging::gray::GrayImage;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

use crate::printed_images::rendered;

const SIZE: [usize; 2] = [480, 360];
/// Equal parts of the exposure, each at a place of its own: half a pixel farther at most.
const PARTS: i32 = 24;
/// Pixels of the image that a meter of the sheet takes: 52 a tag, and 13 between two.
const SCALE: f64 = 1300.0;

fn april_grid() -> Target {
    Target::AprilGrid(AprilGrid {
        cols: 4,
        rows: 3,
        tag_m: 0.04,
        spacing: 0.25,
        family: Dictionary::named("tag36h11").expect("a family"),
        border_bits: Some(2),
        first_id: 0,
    })
}

/// An image exposed while the print moves by `length_px` in the direction `angle`, and the map from
/// the sheet to it in the middle of the exposure.
fn exposed(
    print: &PrintedBoard,
    length_px: f64,
    angle: f64,
    seed: u64,
) -> (GrayImage, Matrix3<f64>) {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let (sin, cos) = rng.random_range(-0.4..0.4_f64).sin_cos();
    let (a, b) = (SCALE * cos, SCALE * sin);
    let slant = [0, 1].map(|_| rng.random_range(-0.9..0.9));
    let slanted = Matrix3::new(a, -b, 0.0, b, a, 0.0, slant[0], slant[1], 1.0);
    let middle = Vector2::new(print.width_m / 2.0, print.height_m / 2.0);
    let to_middle = Vector2::new(SIZE[0] as f64 / 2.0, SIZE[1] as f64 / 2.0);
    let pixel_from_sheet =
        Matrix3::new_translation(&to_middle) * slanted * Matrix3::new_translation(&-middle);
    let places = (0..PARTS).map(|part| {
        let along = length_px * ((f64::from(part) + 0.5) / f64::from(PARTS) - 0.5);
        let moved = Vector2::new(along * angle.cos(), along * angle.sin());
        Matrix3::new_translation(&moved) * pixel_from_sheet
    });
    let places: Vec<Matrix3<f64>> = places.collect();
    (rendered(print, SIZE, &places, &mut rng), pixel_from_sheet)
}

#[test]
fn tags_that_run_into_each_other_are_found_where_they_were_halfway() {
    let target = april_grid();
    let print = PrintedBoard::of(&target);
    let (mut squares, mut squares_over_variance, mut answered) = (0.0, 0.0, 0);
    let boards = 8;
    for seed in 0..boards {
        let angle = std::f64::consts::PI * (seed as f64 + 0.5) / boards as f64;
        let length_px = 10.5 + 0.4 * seed as f64;
        let (image, pixel_from_sheet) = exposed(&print, length_px, angle, seed);
        let mut detector = TargetDetector::new(target).expect("a target with markers");
        let detection = detector.find(image.view()).expect("a board in full view");
        let before: f64 = squares;
        for corner in &detection.corners {
            let truth = print.corner(&target, corner.id).expect("an id of the board");
            let truth = pixel_from_sheet * Vector3::new(truth.x, truth.y, 1.0);
            let off_px =
                (corner.pixel.x - truth.x / truth.z).hypot(corner.pixel.y - truth.y / truth.z);
            squares += off_px.powi(2);
            squares_over_variance += (off_px / corner.std_px).powi(2) / 2.0;
            answered += 1;
        }
        println!(
            "motion of {length_px:.1} px, {:.0} degrees: {} corners, rms {:.3} px",
            angle.to_degrees(),
            detection.corners.len(),
            ((squares - before) / detection.corners.len() as f64).sqrt()
        );
    }
    let rms_px = (squares / f64::from(answered)).sqrt();
    let ratio = (squares_over_variance / f64::from(answered)).sqrt();
    let all = target.corner_count() * boards as usize;
    println!("{answered} of {all} corners, rms {rms_px:.3} px, error over std {ratio:.2}");
    assert!(answered as usize * 100 >= 93 * all, "{answered} of {all} corners");
    assert!(rms_px < 0.05, "rms {rms_px} px");
    assert!((0.5..1.5).contains(&ratio), "error over std {ratio}");
}
