//! When the model is wrong, the verdict says so and why; when it is right, it says nothing.

use nalgebra::{UnitQuaternion, Vector3};
use plumb::calibration::solve::{SolvedCamera, solve_views};
use plumb::estimation::camera::{CameraOptions, calibrate_camera};
use plumb::estimation::measured_board::MeasuredBoard;
use plumb::estimation::problem::{CameraProblem, LensChoice, Shutter};
use plumb::estimation::uncertainty::{
    Distance, PixelGrid, projection_difference, projection_uncertainty,
};
use plumb::estimation::view_motion::read_out_time;
use plumb::geometry::lens::LensModel;
use plumb::geometry::pose::Pose;
use rand::RngExt;
use rand_distr::{Distribution, Normal};

use crate::seeded_camera::SeededCamera;

fn brown() -> CameraOptions {
    CameraOptions { lens: LensChoice::Model(LensModel::Brown), ..CameraOptions::default() }
}

fn says(solved: &SolvedCamera, word: &str) -> bool {
    solved.verdict.reasons.iter().any(|reason| reason.contains(word))
}

/// A camera that reads its rows one after another while the board moves at random, each view
/// otherwise: per image's height by `translation_m` along each axis and `rotation` about each.
pub fn rolling(
    views: usize,
    seed: u64,
    (translation_m, rotation): (f64, f64),
) -> (SeededCamera, CameraProblem) {
    let camera = SeededCamera::ordinary();
    let mut rng = SeededCamera::rng(seed);
    let poses = camera.poses(views, &mut rng);
    let mut problem = camera.problem(&poses, &mut rng);
    let normal = Normal::new(0.0, 1.0).unwrap();
    for (view, pose) in problem.views.iter_mut().zip(&poses) {
        let [translation, rotation] = [translation_m, rotation]
            .map(|scale| Vector3::from_fn(|_, _| scale * normal.sample(&mut rng)));
        for corner in &mut view.correspondences {
            let still = camera.lens.pixel_from_point(&(*pose * corner.point_in_board)).unwrap();
            let mut seen = still;
            for _ in 0..20 {
                let time = (seen.y + 0.5) / f64::from(camera.size.height) - 0.5;
                let rotated = UnitQuaternion::from_scaled_axis(rotation * time) * pose.rotation();
                let moved = Pose::new(rotated, pose.translation() + translation * time);
                seen = camera.lens.pixel_from_point(&(moved * corner.point_in_board)).unwrap();
            }
            corner.pixel.x += seen.x - still.x;
            corner.pixel.y += seen.y - still.y;
        }
    }
    (camera, problem)
}

#[test]
fn a_rolling_shutter_is_named() {
    // Shears along rows and along columns differ by a rotation alone, which a view or two from the
    // front may not determine.
    let mut named = 0;
    for seed in 0..8 {
        let (_, problem) = rolling(14, seed, (0.002, 0.006));
        let solved = solve_views(&problem, &brown()).unwrap();
        named += usize::from(says(&solved, "rolling shutter"));
    }
    assert!(named >= 6, "named in {named} of 8");
}

/// Motions of which eight views show so little that some of them contradict it: what is beyond
/// chance is taken into account, and the rest is in the deviations.
#[test]
fn a_shutter_in_doubt_counts_in_part_and_widens_the_deviations() {
    let still = brown().as_stated();
    let may_roll = CameraOptions { shutter: Shutter::Auto, ..still.clone() };
    let (mut left_out, mut in_part) = (0, 0);
    // Squared errors of fx: over the stated variance; in pixels and in pixels without the motion,
    // where it counts in part.
    let mut observed = [0.0; 3];
    for seed in 0..60 {
        let strength = if seed % 2 == 0 { 1.0 } else { 2.5 };
        let moved = (0.0004 * strength, 0.0012 * strength);
        let (camera, problem) = rolling(8, 300 + seed, moved);
        let [with, without] =
            [&may_roll, &still].map(|options| calibrate_camera(&problem, options).unwrap());
        let [std, std_alone] =
            [&with, &without].map(|estimate| estimate.lens_covariance[(0, 0)].sqrt());
        let [off, off_alone] =
            [&with, &without].map(|it| it.lens.matrix.fx - camera.lens.matrix.fx);
        match with.rolling_shutter {
            Some(shutter) if shutter.agreement < 1.0 => {
                observed[1] += off * off;
                observed[2] += off_alone * off_alone;
                in_part += 1;
            }
            None if std != std_alone => {
                assert_eq!(with.lens, without.lens, "seed {seed}");
                assert!(std > std_alone, "seed {seed}: {std} px, without {std_alone} px");
                left_out += 1;
            }
            _ => continue,
        }
        observed[0] += (off / std).powi(2);
    }
    assert!(left_out >= 10 && in_part >= 10, "left out {left_out}, in part {in_part} of 60");
    let z = f64::sqrt(observed[0] / f64::from(left_out + in_part));
    let [off_px, off_alone_px] = [1, 2].map(|k| f64::sqrt(observed[k] / f64::from(in_part)));
    assert!((0.75..1.2).contains(&z), "rms of errors over deviations: {z}");
    assert!(off_px < 0.9 * off_alone_px, "off by {off_px} px, without motion {off_alone_px} px");
}

#[test]
fn what_moves_whole_views_is_in_the_uncertainty() {
    let (mut observed, mut predicted, mut alone) = (0.0, 0.0, 0.0);
    for seed in 0..40 {
        let (camera, problem) = rolling(20, 100 + seed, (0.002, 0.006));
        let estimate = solve_views(&problem, &brown().as_stated()).unwrap().estimate;
        let grid = PixelGrid::over(camera.size, 10);
        let map = projection_uncertainty(
            &estimate.lens,
            &estimate.lens_covariance,
            grid,
            Distance::Infinity,
        )
        .unwrap();
        let difference = projection_difference(&camera.lens, &estimate.lens, grid, &map.weights);
        let seen: Vec<_> = difference.into_iter().flatten().collect();
        observed += seen.iter().map(|[x, y]| x * x + y * y).sum::<f64>() / seen.len() as f64;
        predicted += map.mean_square_px2();
        alone += map.mean_square_px2() / estimate.variance_inflation;
    }
    let (ratio, naive) = (f64::sqrt(observed / predicted), f64::sqrt(observed / alone));
    assert!(
        (0.5..1.6).contains(&ratio),
        "observed over predicted {ratio}; corner by corner {naive}"
    );
    assert!(
        naive > 2.0,
        "the test means to have views that differ more than their corners' scatter: {naive}"
    );
}

#[test]
fn an_uneven_board_is_named_and_no_rolling_shutter() {
    for seed in 0..8 {
        let camera = SeededCamera::ordinary();
        let mut rng = SeededCamera::rng(200 + seed);
        let poses = camera.poses(20, &mut rng);
        let mut problem = camera.problem(&poses, &mut rng);
        for (view, pose) in problem.views.iter_mut().zip(&poses) {
            for corner in &mut view.correspondences {
                let mut point = corner.point_in_board;
                // A twist: half a millimeter up at two corners of the board, as much down at the
                // others, which is 0.22 mm in the root mean square.
                point.z = 0.0005 * (point.x / 0.12 - 1.0) * (point.y / 0.075 - 1.0);
                let [flat, bent] = [corner.point_in_board, point]
                    .map(|p| camera.lens.pixel_from_point(&(*pose * p)).unwrap());
                corner.pixel.x += bent.x - flat.x;
                corner.pixel.y += bent.y - flat.y;
            }
        }
        let solved = solve_views(&problem, &brown()).unwrap();
        assert!(says(&solved, "the board is uneven by 0.2"), "seed {seed}: {:?}", solved.verdict);
        let shape = solved.estimate.board_shape.as_ref().unwrap();
        let off = (shape.unevenness_m - 0.2205e-3) / shape.unevenness_std_m;
        assert!(
            off.abs() < 4.0 && shape.unevenness_std_m < 0.02e-3,
            "seed {seed}: {} ± {} m",
            shape.unevenness_m,
            shape.unevenness_std_m
        );
        assert!(!says(&solved, "rolling shutter"), "seed {seed}: {:?}", solved.verdict);
    }
}

/// Whoever projects the measured board by the lens and the poses that are stated finds the
/// residuals that are stated.
#[test]
fn what_is_stated_of_a_badly_printed_board_reprojects() {
    let camera = SeededCamera::ordinary();
    let mut rng = SeededCamera::rng(230);
    let poses = camera.poses(12, &mut rng);
    let mut problem = camera.problem(&poses, &mut rng);
    let count = problem.views[0].correspondences.len();
    let printed: Vec<[f64; 2]> =
        (0..count).map(|_| [0, 1].map(|_| 0.3e-3 * rng.random::<f64>())).collect();
    for (view, pose) in problem.views.iter_mut().zip(&poses) {
        for (corner, [x, y]) in view.correspondences.iter_mut().zip(&printed) {
            let mut point = corner.point_in_board;
            (point.x, point.y) = (point.x + x, point.y + y);
            let [stated, printed] = [corner.point_in_board, point]
                .map(|p| camera.lens.pixel_from_point(&(*pose * p)).unwrap());
            corner.pixel.x += printed.x - stated.x;
            corner.pixel.y += printed.y - stated.y;
        }
    }
    let estimate = solve_views(&problem, &brown()).unwrap().estimate;
    let shape = estimate.board_shape.as_ref().unwrap();
    assert!(shape.unevenness_m > 0.08e-3, "{} m", shape.unevenness_m);
    for (view, found) in problem.views.iter().zip(&estimate.views) {
        let pose = found.camera_from_board.unwrap();
        assert_eq!(found.residuals_px.len(), view.correspondences.len());
        for (corner, residual) in view.correspondences.iter().zip(&found.residuals_px) {
            let stated = corner.point_in_board;
            let place = shape.points.iter().position(|p| (p - stated).norm() < 1e-9).unwrap();
            let point = stated + shape.offsets_m[place];
            let projected = estimate.lens.pixel_from_point(&(pose * point)).unwrap();
            let off = [corner.pixel.x - projected.x, corner.pixel.y - projected.y];
            for (off, residual) in off.into_iter().zip(residual) {
                assert!((off - residual).abs() < 1e-6, "{off} px, {residual} px are stated");
            }
        }
    }
}

/// The same of a board that moves while rows are read, also where its motion counts in part.
#[test]
fn what_is_stated_of_a_moving_board_reprojects() {
    let (mut whole, mut in_part) = (0, 0);
    for (views, seed, moved) in
        (0..4).map(|k| (14, k, (0.002, 0.006))).chain((300..320).map(|k| (8, k, (0.001, 0.003))))
    {
        let (camera, problem) = rolling(views, seed, moved);
        let estimate = calibrate_camera(&problem, &brown()).unwrap();
        let Some(shutter) = estimate.rolling_shutter else { continue };
        *(if shutter.agreement < 1.0 { &mut in_part } else { &mut whole }) += 1;
        for (view, found) in problem.views.iter().zip(&estimate.views) {
            let (pose, motion) = (found.camera_from_board.unwrap(), found.motion.unwrap());
            assert_eq!(found.residuals_px.len(), view.correspondences.len());
            for (corner, residual) in view.correspondences.iter().zip(&found.residuals_px) {
                let time = read_out_time(corner.pixel.y, f64::from(camera.size.height));
                let offset = |shape: &MeasuredBoard| shape.offset_at(&corner.point_in_board);
                let offset = estimate.board_shape.as_ref().and_then(offset).unwrap_or_default();
                let point =
                    motion.camera_from_board_at(&pose, time) * (corner.point_in_board + offset);
                let projected = estimate.lens.pixel_from_point(&point).unwrap();
                let off = [corner.pixel.x - projected.x, corner.pixel.y - projected.y];
                for (off, residual) in off.into_iter().zip(residual) {
                    assert!((off - residual).abs() < 1e-6, "{off} px, {residual} px are stated");
                }
            }
        }
    }
    assert!(whole >= 2 && in_part >= 2, "{whole} worlds with a rolling shutter, {in_part} in part");
}

#[test]
fn a_right_model_is_not_accused() {
    // Chance makes views seem to differ seven times in a hundred, and then hardly; halves of the
    // views differ by more than 2.5 times what is predicted once in two hundred times.
    let (mut widened, mut accused) = (0, 0);
    for seed in 0..30 {
        let camera = SeededCamera::ordinary();
        let mut rng = SeededCamera::rng(300 + seed);
        let poses = camera.poses(8 + seed as usize, &mut rng);
        let solved = solve_views(&camera.problem(&poses, &mut rng), &brown()).unwrap();
        let factor = solved.estimate.variance_inflation;
        assert!(factor < 1.25, "seed {seed}: variances are {factor} times as large");
        widened += i32::from(factor > 1.0);
        accused += i32::from(says(&solved, "does not fit"));
    }
    assert!(widened <= 6 && accused <= 1, "{widened} and {accused} of 30");
}

/// Rounding errors say nothing of the model, even where they are smooth.
#[test]
fn exact_corners_are_accused_of_nothing() {
    for seed in 0..12 {
        let camera = SeededCamera { noise_px: 0.0, ..SeededCamera::ordinary() };
        let mut rng = SeededCamera::rng(400 + seed);
        let poses = camera.poses(6 + seed as usize, &mut rng);
        let solved = solve_views(&camera.problem(&poses, &mut rng), &brown()).unwrap();
        for word in ["does not fit", "rolling shutter", "uneven", "bent"] {
            assert!(!says(&solved, word), "seed {seed}: {:?}", solved.verdict);
        }
        assert_eq!(solved.estimate.variance_inflation, 1.0, "seed {seed}");
        assert!(solved.estimate.board_shape.is_none() && solved.estimate.rolling_shutter.is_none());
    }
}

/// The board of [`an_uneven_board_is_named_and_no_rolling_shutter`], a millimeter high: measured by
/// twenty views, then given to a solve of four, which by themselves leave a shape open.
#[test]
fn a_measured_board_serves_the_next_calibration() {
    let height = |p: &nalgebra::Point3<f64>| 0.001 * (p.x / 0.12 - 1.0) * (p.y / 0.075 - 1.0);
    let seen = |views: usize, seed: u64| {
        let camera = SeededCamera { noise_px: 0.02, ..SeededCamera::ordinary() };
        let mut rng = SeededCamera::rng(600 + seed);
        let poses = camera.poses(views, &mut rng);
        let mut problem = camera.problem(&poses, &mut rng);
        for (view, pose) in problem.views.iter_mut().zip(&poses) {
            for corner in &mut view.correspondences {
                let mut point = corner.point_in_board;
                point.z = height(&point);
                let [flat, bent] = [corner.point_in_board, point]
                    .map(|p| camera.lens.pixel_from_point(&(*pose * p)).unwrap());
                corner.pixel.x += bent.x - flat.x;
                corner.pixel.y += bent.y - flat.y;
            }
        }
        problem
    };
    let measured = solve_views(&seen(20, 0), &brown()).unwrap().estimate.board_shape;
    let fx = SeededCamera::ordinary().lens.matrix.fx;
    let (mut with, mut without) = (0.0, 0.0);
    for seed in 1..9 {
        let problem = seen(4, seed);
        let of = |options: &CameraOptions| {
            solve_views(&problem, options).unwrap().estimate.lens.matrix.fx - fx
        };
        with += of(&CameraOptions { measured_board: measured.clone(), ..brown() }).powi(2);
        without += of(&brown().as_stated()).powi(2);
    }
    assert!(with < 0.05 * without, "{} against {} px", with.sqrt(), without.sqrt());
    let other = SeededCamera {
        board: plumb::geometry::board::Chessboard::new("9x6".parse().unwrap(), 0.025).unwrap(),
        ..SeededCamera::ordinary()
    };
    let mut rng = SeededCamera::rng(7);
    let poses = other.poses(4, &mut rng);
    let options = CameraOptions { measured_board: measured, ..brown() };
    let refused = solve_views(&other.problem(&poses, &mut rng), &options).unwrap_err().to_string();
    assert!(refused.contains("measured board has no corner"), "{refused}");
}

/// Views in which the board moves faster than in most are further off than wrong labels would put
/// them, until the shutter is known.
#[test]
fn views_that_only_a_rolling_shutter_explains_are_used() {
    let mut lost = 0;
    for seed in 0..24 {
        // The same views, but for the motion.
        let [(_, mut problem), (_, fast)] =
            [(0.001, 0.003), (0.003, 0.01)].map(|moved| rolling(14, 700 + seed, moved));
        for (view, fast) in problem.views.iter_mut().zip(fast.views).skip(2).step_by(4) {
            *view = fast;
        }
        // No motion exchanges neighbors.
        for pair in problem.views[5].correspondences.chunks_exact_mut(2) {
            let [first, second] = pair else { unreachable!("pairs") };
            std::mem::swap(&mut first.pixel, &mut second.pixel);
        }
        let unused = |shutter| {
            let options = CameraOptions { shutter, ..brown().as_stated() };
            let views = calibrate_camera(&problem, &options).unwrap().views;
            let unused = (0..views.len()).filter(|view| views[*view].fault.is_some());
            unused.collect::<Vec<_>>()
        };
        let without = unused(Shutter::Global);
        println!("seed {seed}: unused as by a global shutter {without:?}");
        assert_eq!(unused(Shutter::Rolling), [5], "seed {seed}");
        lost += without.len() - 1;
    }
    assert!(lost >= 1, "no view is lost by a global shutter");
}
