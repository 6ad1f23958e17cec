use nalgebra::Vector3;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};

use super::*;
use crate::estimation::camera::{CameraOptions, calibrate_camera};
use crate::estimation::problem::{Correspondence, LensChoice};
use crate::estimation::relabeled::RelabeledProblem;
use crate::estimation::view_motion::{ViewMotion, read_out_time};
use crate::geometry::board::{BoardSize, Chessboard};
use crate::geometry::camera_matrix::CameraMatrix;
use crate::geometry::lens::{Distortion, Lens, LensModel};
use crate::geometry::pixel::{ImageSize, Pixel};

const SIZE: ImageSize = ImageSize::new(640, 480);
const SQUARE_M: f64 = 0.03;
const NOISE_PX: f64 = 0.05;

/// A board that is uneven by `unevenness_m` rms per axis, seen in `views` poses of any rotation
/// about its normal, while it moves by `motion_m` rms per axis during the readout.
struct RotatedBoard {
    board: Chessboard,
    views: usize,
    unevenness_m: f64,
    motion_m: f64,
}

impl RotatedBoard {
    fn of(cols: u32, rows: u32, views: usize, unevenness_m: f64) -> Self {
        let size = BoardSize::new(cols, rows).unwrap();
        let board = Chessboard::new(size, SQUARE_M).unwrap();
        Self { board, views, unevenness_m, motion_m: 0.0 }
    }

    /// The views, with the symmetry by which each one's labels are rotated.
    fn seen(&self, seed: u64) -> (CameraProblem, Vec<usize>, Vec<Vector3<f64>>) {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        let stated = self.board.corners_in_board();
        let middle = stated.iter().map(|p| p.coords).sum::<Vector3<f64>>() / stated.len() as f64;
        let offsets: Vec<Vector3<f64>> =
            stated.iter().map(|_| normal(&mut rng) * self.unevenness_m).collect();
        let symmetries = self.board.symmetries();
        let (mut views, mut rotated) = (Vec::new(), Vec::new());
        while views.len() < self.views {
            let tilt = normal(&mut rng) * 0.35;
            let roll = Vector3::z() * rng.random_range(-3.1..3.1);
            let about_middle = Pose::from_axis_angle(tilt, Vector3::zeros())
                * Pose::from_axis_angle(roll, Vector3::zeros());
            let at = Vector3::new(
                rng.random_range(-0.12..0.12),
                rng.random_range(-0.08..0.08),
                rng.random_range(0.36..0.7),
            );
            let pose = Pose::new(about_middle.rotation(), at - about_middle.rotation() * middle);
            let motion = ViewMotion {
                rotation_rad: normal(&mut rng) * (3.0 * self.motion_m),
                translation_m: normal(&mut rng) * self.motion_m,
                center_m: middle.into(),
            };
            let symmetry = rng.random_range(0..symmetries.len());
            let corner = |(point, offset): (&nalgebra::Point3<f64>, &Vector3<f64>)| {
                let first = lens().pixel_from_point(&(pose * (point + offset)))?;
                let read = motion.camera_from_board_at(&pose, read_out_time(first.y, 480.0));
                let pixel = lens().pixel_from_point(&(read * (point + offset)))?;
                let noise = normal(&mut rng) * NOISE_PX;
                let pixel = Pixel::new(pixel.x + noise.x, pixel.y + noise.y);
                let in_image = (0.0..640.0).contains(&pixel.x) && (0.0..480.0).contains(&pixel.y);
                let point_in_board = symmetries[symmetry] * *point;
                in_image.then_some(Correspondence { point_in_board, pixel, std_px: NOISE_PX })
            };
            let corners: Option<Vec<Correspondence>> =
                stated.iter().zip(&offsets).map(corner).collect();
            let Some(correspondences) = corners else { continue };
            views.push(BoardView { name: views.len().to_string(), correspondences });
            rotated.push(symmetry);
        }
        (CameraProblem { image_size: SIZE, views }, rotated, offsets)
    }

    fn labels(&self, problem: &CameraProblem, measured: Option<&MeasuredBoard>) -> Vec<usize> {
        let flat = calibrate_camera(problem, &options().as_stated()).unwrap();
        labels_by_shape(problem, &flat, &self.board.symmetries(), measured)
    }
}

fn normal(rng: &mut ChaCha8Rng) -> Vector3<f64> {
    Vector3::from_fn(|_, _| StandardNormal.sample(rng))
}

fn lens() -> Lens {
    let matrix = CameraMatrix { fx: 600.0, fy: 602.0, cx: 322.0, cy: 238.0, skew: 0.0 };
    let brown = [-0.1, 0.05, 0.0, 0.0, 0.0];
    Lens { matrix, distortion: Distortion::from_coefficients(LensModel::Brown, &brown).unwrap() }
}

fn options() -> CameraOptions {
    CameraOptions { lens: LensChoice::Model(LensModel::Brown), ..CameraOptions::default() }
}

/// How many views have the labels of most, after the chosen symmetries.
fn alike(board: &Chessboard, rotated: &[usize], chosen: &[usize]) -> usize {
    let symmetries = board.symmetries();
    let far = board.corners_in_board()[1];
    // Labels are rotated by `symmetries[rotated]`, then back by `symmetries[chosen]`.
    let corner = |(rotated, chosen): (&usize, &usize)| {
        symmetries[*chosen].inverse() * (symmetries[*rotated] * far)
    };
    let corners: Vec<_> = rotated.iter().zip(chosen).map(corner).collect();
    let same = |own: &nalgebra::Point3<f64>| {
        corners.iter().filter(|other| (*other - own).norm() < 1e-9).count()
    };
    corners.iter().map(same).max().unwrap()
}

#[test]
fn views_of_an_uneven_board_are_labeled_alike() {
    for (cols, rows, views) in [(8, 6, 12), (9, 7, 5), (8, 6, 4), (7, 7, 12)] {
        for seed in 0..4 {
            let world = RotatedBoard::of(cols, rows, views, 0.004 * SQUARE_M);
            let (problem, rotated, _) = world.seen(seed);
            let chosen = world.labels(&problem, None);
            assert_eq!(alike(&world.board, &rotated, &chosen), views, "{cols}x{rows} seed {seed}");
            let kept = chosen.iter().filter(|symmetry| **symmetry == 0).count();
            let groups = world.board.symmetries().len();
            assert!(kept * groups >= views, "most views keep their labels: {chosen:?}");
        }
    }
}

#[test]
fn neither_a_flat_board_nor_motion_changes_any_label() {
    for seed in 0..6 {
        for motion_m in [0.0, 0.001] {
            let world = RotatedBoard { motion_m, ..RotatedBoard::of(8, 6, 12, 0.0) };
            let (problem, ..) = world.seen(100 + seed);
            assert_eq!(world.labels(&problem, None), vec![0; 12], "seed {seed} {motion_m} m");
        }
    }
}

#[test]
fn motion_during_the_readout_does_not_hide_the_labels() {
    for seed in 0..4 {
        let world =
            RotatedBoard { motion_m: 0.001, ..RotatedBoard::of(8, 6, 12, 0.004 * SQUARE_M) };
        let (problem, rotated, _) = world.seen(200 + seed);
        let chosen = world.labels(&problem, None);
        assert_eq!(alike(&world.board, &rotated, &chosen), 12, "seed {seed}");
    }
}

#[test]
fn labels_become_those_of_a_measured_board() {
    let world = RotatedBoard::of(8, 6, 3, 0.004 * SQUARE_M);
    let (problem, rotated, offsets) = world.seen(7);
    let points = world.board.corners_in_board();
    let board = MeasuredBoard {
        std_m: vec![Vector3::repeat(1e-6); points.len()],
        offsets_m: offsets,
        points,
        unevenness_m: 0.004 * SQUARE_M,
        unevenness_std_m: 1e-6,
        bow_m: [0.0; 2],
    };
    assert_eq!(world.labels(&problem, Some(&board)), rotated);
}

#[test]
fn labels_as_detected_cost_precision_that_labels_alike_restore() {
    let world = RotatedBoard::of(8, 6, 12, 0.01 * SQUARE_M);
    let (problem, ..) = world.seen(31);
    let symmetries = world.board.symmetries();
    let as_detected = calibrate_camera(&problem, &options()).unwrap();
    let alike = RelabeledProblem::labeled_alike(&problem, &symmetries, &options()).unwrap();
    let estimate = calibrate_camera(&alike.problem, &options()).unwrap();
    assert!(estimate.lens_std()[0] < 0.5 * as_detected.lens_std()[0]);
    assert!((estimate.lens.matrix.fx - 600.0).abs() < 3.0 * estimate.lens_std()[0]);
    // A start under the labels as given leads to the same estimate.
    let start = alike.start(&alike.start_as_given(&estimate.to_start()));
    for (own, rotated) in estimate.to_start().camera_from_board.iter().zip(start.camera_from_board)
    {
        assert!((own.unwrap().translation() - rotated.unwrap().translation()).norm() < 1e-12);
    }
}
