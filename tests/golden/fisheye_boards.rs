//! Boards close before a full fisheye, whose steps shrink by a third from one to the next towards
//! its rim: found, and never mislabeled.

use nalgebra::{Matrix3, Rotation3, Vector3};
use plumb::detection::board_detection::DetectOptions;
use plumb::detection::detector::Detector;
use plumb::geometry::board::BoardSize;
use plumb::imaging::gray::GrayImage;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, Normal};

use crate::detection::Scene;

const SIDE: usize = 360;
const MIDDLE: f64 = 179.5;
/// Pixels a radian: an equidistant lens that shows 180° across the image.
const FOCAL: f64 = 114.0;
const DARK: f64 = 40.0;
const BRIGHT: f64 = 190.0;
const BEHIND: f64 = 120.0;

/// A board somewhere before the lens, all of its corners seen under less than 80° from the axis.
fn camera_from_board(rng: &mut ChaCha8Rng, board: BoardSize) -> Matrix3<f64> {
    let (cols, rows) = (f64::from(board.cols), f64::from(board.rows));
    loop {
        let mut angle = |most: f64| rng.random_range(-most..most);
        let roll = Rotation3::from_axis_angle(&Vector3::z_axis(), angle(std::f64::consts::PI));
        let tilt = Rotation3::new(Vector3::new(angle(0.6), angle(0.6), 0.0));
        let aside = Rotation3::new(Vector3::new(angle(0.8), angle(0.8), 0.0));
        let rotation = aside * tilt * roll;
        let away = cols.max(rows) * rng.random_range(0.35..0.7);
        let first = rotation * Vector3::new(-(cols - 1.0) / 2.0, -(rows - 1.0) / 2.0, 0.0)
            + aside * Vector3::z() * away;
        let axes = rotation.matrix();
        let matrix = Matrix3::from_columns(&[axes.column(0).into(), axes.column(1).into(), first]);
        let ends = [(0.0, 0.0), (cols - 1.0, 0.0), (0.0, rows - 1.0), (cols - 1.0, rows - 1.0)];
        let within = |(c, r): (f64, f64)| {
            let p = matrix * Vector3::new(c, r, 1.0);
            p.xy().norm().atan2(p.z) < 80f64.to_radians()
        };
        let from_front =
            axes.column(2).dot(&(matrix * Vector3::new(cols / 2.0, rows / 2.0, 1.0))) > 0.0;
        if from_front && ends.into_iter().all(within) {
            return matrix;
        }
    }
}

fn project(camera_from_board: &Matrix3<f64>, col: f64, row: f64) -> [f64; 2] {
    let p = camera_from_board * Vector3::new(col, row, 1.0);
    let across = p.xy().norm().max(1e-12);
    let scale = FOCAL * across.atan2(p.z) / across;
    [MIDDLE + scale * p.x, MIDDLE + scale * p.y]
}

/// Brightness at a place of the image.
fn light(board_from_camera: &Matrix3<f64>, board: BoardSize, x: f64, y: f64) -> f64 {
    let (dx, dy) = (x - MIDDLE, y - MIDDLE);
    let radius = dx.hypot(dy).max(1e-12);
    let (sine, cosine) = (radius / FOCAL).sin_cos();
    let q = board_from_camera * Vector3::new(sine * dx / radius, sine * dy / radius, cosine);
    if q.z <= 0.0 {
        return BEHIND;
    }
    let (c, r) = (q.x / q.z, q.y / q.z);
    let within = |edge: f64| {
        (-edge..f64::from(board.cols) - 1.0 + edge).contains(&c)
            && (-edge..f64::from(board.rows) - 1.0 + edge).contains(&r)
    };
    match () {
        () if within(1.0) && (c.floor() + r.floor()).rem_euclid(2.0) < 0.5 => DARK,
        () if within(1.8) => BRIGHT,
        () => BEHIND,
    }
}

fn scene(seed: u64, board: BoardSize) -> Scene {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let camera_from_board = camera_from_board(&mut rng, board);
    let board_from_camera = camera_from_board.try_inverse().unwrap();
    let noise = Normal::new(0.0, rng.random_range(0.5..4.0)).unwrap();
    let spread = rng.random_range(0.35..0.6);
    let mut pixels = Vec::with_capacity(SIDE * SIDE);
    for (y, x) in (0..SIDE).flat_map(|y| (0..SIDE).map(move |x| (y as f64, x as f64))) {
        let points = (-1..=1)
            .flat_map(|j| (-1..=1).map(move |i| (f64::from(i) * spread, f64::from(j) * spread)));
        let mean =
            points.map(|(dx, dy)| light(&board_from_camera, board, x + dx, y + dy)).sum::<f64>()
                / 9.0;
        pixels.push((mean + noise.sample(&mut rng)).clamp(0.0, 255.0) as u8);
    }
    let corners = (0..board.rows * board.cols)
        .map(|k| project(&camera_from_board, f64::from(k % board.cols), f64::from(k / board.cols)))
        .collect();
    Scene {
        image: GrayImage::from_pixels(SIDE, SIDE, pixels).unwrap(),
        board,
        corners,
        inverted: false,
    }
}

#[test]
fn boards_in_a_full_fisheye_are_found_and_never_mislabeled() {
    let (mut seen, mut answered, mut whole) = (0, 0, 0);
    for (kind, board) in ["9x6", "4x6", "7x5"].iter().enumerate() {
        let board: BoardSize = board.parse().unwrap();
        let mut detector = Detector::new(board);
        for seed in (0..40).map(|index| 700_000 + 1000 * kind as u64 + index) {
            let scene = scene(seed, board);
            if scene.shortest_step_px() < 7.0 {
                continue;
            }
            seen += 1;
            if let Ok(found) =
                detector.find_board(scene.image.view(), &DetectOptions { allow_partial: true })
            {
                assert!(scene.is_right(&found), "board {board}, seed {seed}: {found:?}");
                answered += 1;
                whole += u32::from(!found.partial);
            }
        }
    }
    assert!(
        seen >= 60 && answered * 100 >= 95 * seen && whole * 100 >= 95 * seen,
        "{whole} of {answered} of {seen}"
    );
}
