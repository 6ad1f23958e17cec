//! Boards with markers that stand on floors of square tiles, smaller and larger than their squares:
//! a floor is a lattice, too, and uses up nothing of what the board is searched with.

use nalgebra::{Matrix3, Vector3};
use plumb::detection::coded::detector::TargetDetector;
use plumb::geometry::dictionary::Dictionary;
use plumb::geometry::printed_board::PrintedBoard;
use plumb::geometry::target::{AprilGrid, CharucoBoard, Target};
use plumb::imaging::gray::GrayImage;
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;

use crate::printed_images::rendered;

const WIDTH: usize = 640;
const HEIGHT: usize = 480;
/// Sides of the floors' tiles, in pixels.
const TILES_PX: [f64; 5] = [8.0, 14.0, 20.0, 34.0, 60.0];
/// The board's height, as a part of the image's.
const HEIGHTS: [f64; 2] = [0.35, 0.7];

fn targets() -> [Target; 2] {
    let dictionary = |name: &str| Dictionary::named(name).expect("a dictionary");
    let charuco = CharucoBoard {
        cols: 7,
        rows: 5,
        square_m: 0.04,
        marker_m: 0.03,
        dictionary: dictionary("DICT_4X4_50"),
        first_id: 0,
        legacy: Some(false),
    };
    let grid = AprilGrid {
        cols: 4,
        rows: 3,
        tag_m: 0.04,
        spacing: 0.3,
        family: dictionary("tag36h11"),
        border_bits: Some(2),
        first_id: 0,
    };
    [Target::Charuco(charuco), Target::AprilGrid(grid)]
}

/// The print of `target`, upright in the image's middle, on tiles that are seen at a slant; and how
/// many pixels a meter takes, with the image of the sheet's origin.
fn image(target: &Target, height: f64, tile_px: f64) -> (GrayImage, Matrix3<f64>) {
    let print = PrintedBoard::of(target);
    let scale = height * HEIGHT as f64 / print.height_m;
    let corner = [
        (WIDTH as f64 - scale * print.width_m) / 2.0,
        (HEIGHT as f64 - scale * print.height_m) / 2.0,
    ];
    let pixel_from_sheet =
        Matrix3::new(scale, 0.0, corner[0], 0.0, scale, corner[1], 0.0, 0.0, 1.0);
    let mut rng = ChaCha8Rng::seed_from_u64(7);
    let board = rendered(&print, [WIDTH, HEIGHT], &[pixel_from_sheet], &mut rng);
    let is_sheet = |x: usize, y: usize| {
        let within = |at: usize, k: usize, side_m: f64| {
            (-0.01..side_m + 0.01).contains(&((at as f64 - corner[k]) / scale))
        };
        within(x, 0, print.width_m) && within(y, 1, print.height_m)
    };
    let pixels = board.pixels().iter().enumerate().map(|(at, &pixel)| {
        let (x, y) = (at % WIDTH, at / WIDTH);
        if is_sheet(x, y) { pixel } else { tile_gray(x, y, tile_px) }
    });
    let image = GrayImage::from_pixels(WIDTH, HEIGHT, pixels.collect()).expect("so many pixels");
    (image, pixel_from_sheet)
}

fn tile_gray(x: usize, y: usize, tile_px: f64) -> u8 {
    let bright = (0..16).filter(|sub| {
        let at = |v: usize, k: usize| v as f64 - 0.5 + (k as f64 + 0.5) / 4.0;
        let (x, y) = (at(x, sub % 4) - 300.0, at(y, sub / 4) - 200.0);
        let depth = 1.0 + 0.0006 * y;
        let tile = |v: f64| (v / depth / tile_px).floor() as i64;
        (tile(x + 0.1 * y) + tile(y - 0.1 * x)).rem_euclid(2) == 0
    });
    40 + 10 * bright.count() as u8
}

#[test]
fn a_board_on_a_floor_of_tiles_is_found() {
    for target in targets() {
        let mut detector = TargetDetector::new(target).expect("a target with markers");
        let print = PrintedBoard::of(&target);
        for (height, tile_px) in HEIGHTS.into_iter().flat_map(|h| TILES_PX.map(|tile| (h, tile))) {
            let (image, pixel_from_sheet) = image(&target, height, tile_px);
            let what = format!("{target}, {height} of the height, tiles of {tile_px} px");
            let found = detector.find(image.view()).unwrap_or_else(|none| panic!("{what}: {none}"));
            let lattice = target.lattice();
            assert_eq!(found.corners.len(), lattice.corner_count(), "{what}");
            for corner in &found.corners {
                let truth = print.corner(&target, corner.id).expect("an id of the board");
                let truth = pixel_from_sheet * Vector3::new(truth.x, truth.y, 1.0);
                let off = (corner.pixel.x - truth.x).hypot(corner.pixel.y - truth.y);
                assert!(off < 0.3, "{what}: {} is {off} px off", corner.id);
            }
        }
    }
}
