//! Color and depth together: the predicted uncertainty is the scatter that is observed, depth's
//! error goes away, and what the factory states stays where it is as good.

use std::f64::consts::FRAC_PI_2;

use nalgebra::{DMatrix, Point3, Rotation3, Vector3, Vector6};
use plumb::calibration::solve::factory_check::FactoryCheck;
use plumb::calibration::solve::solve_rgbd::{SolvedRgbd, solve_rgbd};
use plumb::estimation::camera::CameraOptions;
use plumb::estimation::error::EstimationError;
use plumb::estimation::interrupt::Interrupt;
use plumb::estimation::problem::GivenParameter;
use plumb::estimation::rgbd::halves::{RgbdDifference, RgbdHalves};
use plumb::estimation::rgbd::{RgbdEstimate, RgbdProblem, calibrate_rgbd};
use plumb::geometry::board::{BoardSize, Chessboard};
use plumb::geometry::depth_camera::PosedDepthLens;
use plumb::geometry::lens::Lens;
use plumb::geometry::pixel::Pixel;
use plumb::geometry::pose::Pose;
use plumb::simulation::DepthError;
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};

use crate::seeded_camera::SeededCamera;
use crate::seeded_rgbd::SeededRgbd;

const RUNS: u64 = 100;

/// Of each run with the same poses and other noise, where depth is found to be off, in predicted
/// standard deviations.
fn scatter(rig: &SeededRgbd, views: usize) -> Vec<Vector6<f64>> {
    let poses = rig.poses(views, &mut SeededCamera::rng(31));
    let run = |run: u64| {
        let problem = rig.problem(&poses, &mut SeededCamera::rng(500 + run));
        in_deviations(&calibrate_rgbd(&problem).unwrap(), rig)
    };
    (0..RUNS).map(run).collect()
}

/// How far off depth was found to be, in predicted standard deviations.
fn in_deviations(found: &RgbdEstimate, rig: &SeededRgbd) -> Vector6<f64> {
    let truth = rig.depth_from_color.inverse();
    let rotation = (found.color_from_depth.rotation() * truth.rotation().inverse()).scaled_axis();
    let translation = found.color_from_depth.translation() - truth.translation();
    let std = |k: usize| found.color_from_depth_covariance[(k, k)].sqrt();
    Vector6::from_fn(|k, _| if k < 3 { rotation[k] } else { translation[k - 3] } / std(k))
}

/// Each of the six numbers within a fifth of what is predicted, and no run further off than chance.
fn expect_predicted(name: &str, runs: &[Vector6<f64>]) {
    let rms =
        |k: usize| (runs.iter().map(|run| run[k] * run[k]).sum::<f64>() / runs.len() as f64).sqrt();
    let each: Vec<f64> = (0..6).map(rms).collect();
    let all = (each.iter().map(|rms| rms * rms).sum::<f64>() / 6.0).sqrt();
    let worst = runs.iter().map(nalgebra::Matrix::amax).fold(0.0, f64::max);
    println!("{name}: observed over predicted {all:.3}, each {each:.2?}, worst {worst:.2} sigma");
    assert!(
        each.iter().all(|rms| (0.8..1.2).contains(rms)) && worst < 4.5,
        "{name}: each {each:.2?}, worst {worst}"
    );
}

#[test]
fn predicted_and_observed_scatter_agree_with_infrared() {
    expect_predicted("with infrared", &scatter(&SeededRgbd::new(), 9));
}

#[test]
fn a_solve_that_nobody_waits_for_ends_as_interrupted() {
    let rig = SeededRgbd::new();
    let poses = rig.poses(9, &mut SeededCamera::rng(31));
    let problem = rig.problem(&poses, &mut SeededCamera::rng(500));
    let waited_for = RgbdProblem { interrupt: Interrupt::new(), ..problem.clone() };
    let solved = calibrate_rgbd(&problem).unwrap();
    assert_eq!(calibrate_rgbd(&waited_for).as_ref(), Ok(&solved));
    waited_for.interrupt.request();
    assert_eq!(calibrate_rgbd(&waited_for), Err(EstimationError::Interrupted));
}

#[test]
fn predicted_and_observed_scatter_agree_by_planes_alone() {
    // What planes alone do not determine is given: a depth image without distortion.
    let rig = SeededRgbd { with_infrared: false, ..SeededRgbd::new() }.without_distortion();
    expect_predicted("by planes alone", &scatter(&rig, 12));
}

/// The halves' ratios of `runs` solves of so many views each: color's lens, depth's lens, depth's
/// pose; the root of the mean square of each.
fn halves_of(rig: &SeededRgbd, views: usize, runs: u64) -> [f64; 3] {
    let mut squares = [0.0; 3];
    for run in 0..runs {
        let poses = rig.poses(views, &mut SeededCamera::rng(700 + run));
        let problem = rig.problem(&poses, &mut SeededCamera::rng(800 + run));
        let whole = calibrate_rgbd(&problem).unwrap();
        let halves = RgbdHalves::of(&problem, &whole);
        assert_eq!(halves.views.iter().map(Vec::len).sum::<usize>(), views);
        let RgbdDifference { color, depth, color_from_depth } =
            halves.difference(&problem, &whole, rig.color.size).unwrap();
        let ratios = [color.ratio, depth.unwrap().ratio, color_from_depth.map(|pose| pose.ratio)];
        for (sum, ratio) in squares.iter_mut().zip(ratios) {
            *sum += ratio.unwrap().powi(2) / runs as f64;
        }
    }
    squares.map(f64::sqrt)
}

#[test]
fn halves_of_the_views_differ_as_predicted() {
    let with_infrared = SeededRgbd::new();
    let by_planes = SeededRgbd { with_infrared: false, ..SeededRgbd::new() }.without_distortion();
    for (name, rig) in [("with infrared", with_infrared), ("by planes alone", by_planes)] {
        let ratios = halves_of(&rig, 18, 20);
        println!("{name}: color's lens, depth's lens, depth's pose {ratios:.2?}");
        assert!(ratios.iter().all(|ratio| (0.75..1.25).contains(ratio)), "{name}: {ratios:.2?}");
    }
}

fn of_normal(rng: &mut ChaCha8Rng) -> f64 {
    StandardNormal.sample(rng)
}

/// Tilts what depth shows of each view, by a part of 1/z over the image that is its own.
fn tilted_depth(mut problem: RgbdProblem, rng: &mut ChaCha8Rng) -> RgbdProblem {
    let size = problem.depth.image_size;
    for view in &mut problem.views {
        let [of_width, of_height] = [0, 1].map(|_| 0.01 * of_normal(rng));
        for tile in view.tiles.iter_mut().chain(&mut view.surround) {
            let x = tile.pixel.x / f64::from(size.width) - 0.5;
            let y = tile.pixel.y / f64::from(size.height) - 0.5;
            tile.inverse_depth *= 1.0 + of_width * x + of_height * y;
        }
    }
    problem
}

/// Depth that differs from view to view as no correction does moves a lens and a pose by planes as
/// far as they say. To first order, with the tiles that are believed held, they say less: 1.25
/// times what is stated was observed.
#[test]
fn depth_that_differs_from_view_to_view_is_in_what_planes_state() {
    // The same error at every pixel. Where it varies over the image, tilts hide it from the choice of
    // the correction's form, and rotations are off by up to 1.6 stated deviations: decision 009.
    let error =
        DepthError { scale: [0.006, 0.0, 0.0, 0.0, 0.0], offset: [0.004, 0.0, 0.0, 0.0, 0.0] };
    let rig = SeededRgbd { with_infrared: false, error, ..SeededRgbd::new() }.without_distortion();
    let mut squares = [0.0; 10];
    let runs = 60;
    for run in 0..runs {
        let poses = rig.poses(14, &mut SeededCamera::rng(900 + run));
        let mut rng = SeededCamera::rng(1900 + run);
        let problem = tilted_depth(rig.problem(&poses, &mut rng), &mut rng);
        let found = calibrate_rgbd(&problem).unwrap();
        let (lens, truth) = (found.depth.lens.parameters(), rig.depth.lens.parameters());
        for k in 0..4 {
            squares[k] += (lens[k] - truth[k]).powi(2) / found.depth_covariance[(k, k)];
        }
        let pose = in_deviations(&found, &rig);
        (0..6).for_each(|k| squares[4 + k] += pose[k] * pose[k]);
    }
    let ratios = squares.map(|square| (square / runs as f64).sqrt());
    println!("observed over predicted, lens and pose: {ratios:.2?}");
    let mean = (squares.iter().sum::<f64>() / (10 * runs) as f64).sqrt();
    assert!((0.8..1.2).contains(&mean), "{ratios:.2?}");
    assert!(ratios.iter().all(|ratio| (0.7..1.3).contains(ratio)), "{ratios:.2?}");
}

fn against_factory(rig: &SeededRgbd, depth_from_color: Pose) -> FactoryCheck {
    let poses = rig.poses(12, &mut SeededCamera::rng(5));
    let mut input = rig.input(&poses, &mut SeededCamera::rng(6));
    input.depth.factory = Some(PosedDepthLens { lens: rig.depth.lens, depth_from_color });
    let check = solve_rgbd(&input, &SeededRgbd::options()).unwrap().factory.unwrap();
    println!("{}", check.line());
    check
}

#[test]
fn the_factory_s_calibration_is_kept_where_it_is_as_good_and_replaced_where_ours_is_better() {
    let right =
        SeededRgbd { error: DepthError { scale: [0.0; 5], offset: [0.0; 5] }, ..SeededRgbd::new() };
    let kept = against_factory(&right, right.depth_from_color);
    let estimate = kept.kept.as_ref().unwrap();
    assert!((estimate.depth.lens, estimate.depth.correction.is_none()) == (right.depth.lens, true));
    assert!(
        estimate.color_from_depth == right.depth_from_color.inverse()
            && kept.line().contains("is kept")
    );
    let bumped = right.depth_from_color
        * Pose::from_axis_angle(Vector3::new(0.0, 0.01, 0.0), Vector3::new(0.0, 0.0, 0.004));
    for (rig, depth_from_color) in [(&SeededRgbd::new(), right.depth_from_color), (&right, bumped)]
    {
        let replaced = against_factory(rig, depth_from_color);
        assert!(
            replaced.kept.is_none() && replaced.own < 0.5 * replaced.factory,
            "{}",
            replaced.line()
        );
        assert!(replaced.line().contains("is replaced") && replaced.views == 12);
    }
}

/// Each sensor calls another corner of a square board its first one, view by view.
#[test]
fn a_square_board_is_labeled_alike_by_both_sensors() {
    let mut rig = SeededRgbd::new();
    let board = Chessboard::new(BoardSize::new(7, 7).unwrap(), 0.03).unwrap();
    (rig.color.board, rig.depth.board) = (board, board);
    let poses = rig.poses(10, &mut SeededCamera::rng(8));
    let mut input = rig.input(&poses, &mut SeededCamera::rng(9));
    let middle = Point3::new(0.09, 0.09, 0.0);
    for (index, capture) in input.frame_sets.iter_mut().enumerate() {
        let rotation =
            Rotation3::from_axis_angle(&Vector3::z_axis(), FRAC_PI_2 * ((index * 7) % 4) as f64);
        for corner in &mut capture.infrared {
            corner.point_in_board = middle + rotation * (corner.point_in_board - middle);
        }
    }
    let joint = solve_rgbd(&input, &SeededRgbd::options()).unwrap().joint;
    let truth = rig.depth_from_color.inverse();
    let translation = joint.color_from_depth.translation() - truth.translation();
    let rotation = joint.color_from_depth.angle_to(&truth);
    println!("{translation:?} m, {rotation} rad");
    for k in 0..3 {
        assert!(
            translation[k].abs() < 4.0 * joint.color_from_depth_covariance[(k + 3, k + 3)].sqrt(),
            "{translation:?}"
        );
    }
    assert!(rotation < 1e-3 && translation.norm() < 5e-4, "{rotation} rad, {translation:?} m");
}

/// Mean over the image of |bias| before and after correction and of a reading's σ at 1/z, in
/// meters: exact, without noise.
fn left_at(rig: &SeededRgbd, solved: &SolvedRgbd, z_m: f64) -> [f64; 3] {
    let (size, mut sums, mut count) = (rig.depth.size, [0.0; 3], 0.0);
    for (x, y) in (3..30).flat_map(|x| (3..22).map(move |y| (10 * x, 10 * y))) {
        let pixel = Pixel::new(f64::from(x), f64::from(y));
        let measured = rig.error.measured(1.0 / z_m, pixel, size);
        let correction = solved.joint.depth.correction.as_ref().unwrap();
        let corrected = correction.correct(pixel, measured).unwrap();
        sums[0] += (1.0 / measured - z_m).abs();
        sums[1] += (1.0 / corrected - z_m).abs();
        sums[2] += rig.noise_per_m * z_m * z_m;
        count += 1.0;
    }
    sums.map(|sum| sum / count)
}

#[test]
fn the_error_of_depth_goes_away_at_every_distance_seen() {
    let rig = SeededRgbd::new();
    let mut rng = SeededCamera::rng(77);
    let poses = rig.poses(40, &mut rng);
    let solved = solve_rgbd(&rig.input(&poses, &mut rng), &SeededRgbd::options()).unwrap();
    let [near, far] = solved.joint.depth.correction.as_ref().unwrap().seen_m;
    for part in [0.1, 0.3, 0.5, 0.7, 0.9] {
        let z_m = near + part * (far - near);
        let [before, after, noise] = left_at(&rig, &solved, z_m);
        println!(
            "{z_m:.2} m: {:.2} mm before, {:.3} mm after, noise {:.2} mm",
            1e3 * before,
            1e3 * after,
            1e3 * noise
        );
        assert!(
            after <= 0.1 * before && after <= 0.3 * noise,
            "{z_m} m: {before} to {after}, noise {noise}"
        );
    }
}

#[test]
fn an_uneven_board_is_measured_before_depth_with_infrared() {
    expect_a_measured_board(true);
}

#[test]
fn an_uneven_board_is_measured_before_depth_of_planes_alone() {
    expect_a_measured_board(false);
}

/// A board that is twisted by half a millimeter is measured by color, and every sensor sees it so:
/// lenses and pose are as exact as stated, and color's lens far more exact than on a flat board.
fn expect_a_measured_board(with_infrared: bool) {
    let height_m = |x: f64, y: f64| 0.0005 * (x / 0.12 - 1.0) * (y / 0.075 - 1.0);
    let rig = SeededRgbd { with_infrared, height_m, ..SeededRgbd::new() };
    let (mut color_z2, mut infrared_z2, mut pose_z2) = (0.0, 0.0, 0.0);
    let (mut squares, mut flat_squares, mut count) = (0.0, 0.0, 0.0);
    for seed in 900..908 {
        let mut rng = SeededCamera::rng(seed);
        let poses = rig.poses(16, &mut rng);
        let input = rig.input(&poses, &mut rng);
        let solved = solve_rgbd(&input, &SeededRgbd::options()).unwrap();
        let joint = &solved.joint;
        let z2 = |lens: &Lens, covariance: &DMatrix<f64>, truth: &Lens| {
            let each = (0..4).map(|k| {
                (lens.parameters()[k] - truth.parameters()[k]).powi(2) / covariance[(k, k)]
            });
            each.sum::<f64>() / 4.0
        };
        color_z2 += z2(&joint.color, &joint.color_covariance, &rig.color.lens);
        if with_infrared {
            infrared_z2 += z2(&joint.depth.lens, &joint.depth_covariance, &rig.depth.lens);
        }
        let truth = rig.depth_from_color.inverse();
        let off = joint.color_from_depth.translation() - truth.translation();
        let variance = |k: usize| joint.color_from_depth_covariance[(k + 3, k + 3)];
        pose_z2 += (0..3).map(|k| off[k].powi(2) / variance(k)).sum::<f64>() / 3.0;
        let flat = SeededRgbd::options().as_stated();
        let flat = solve_rgbd(&input, &flat).unwrap().joint;
        let fx = rig.color.lens.matrix.fx;
        squares += (joint.color.matrix.fx - fx).powi(2);
        flat_squares += (flat.color.matrix.fx - fx).powi(2);
        count += 1.0;
    }
    let [color, infrared, pose] =
        [color_z2, infrared_z2, pose_z2].map(|sum: f64| (sum / count).sqrt());
    let ratio = f64::sqrt(squares / flat_squares);
    let line = format!(
        "infrared {with_infrared}: z of color {color:.2}, infrared {infrared:.2}, pose {pose:.2}; \
         fx {ratio:.2} of the flat board's error"
    );
    println!("{line}");
    assert!((0.6..1.4).contains(&color) && ratio < 0.5, "{line}");
    assert!((0.4..1.4).contains(&pose) && infrared < 1.4, "{line}");
}

/// What is given of color's lens holds in the joint solve, and is not infrared's.
#[test]
fn what_is_given_of_color_holds_beside_depth() {
    let rig = SeededRgbd::new();
    let mut rng = SeededCamera::rng(930);
    let poses = rig.poses(14, &mut rng);
    let fx = rig.color.lens.matrix.fx;
    let given = vec![GivenParameter { name: "fx".to_owned(), value: fx }];
    let options = CameraOptions { given, ..SeededRgbd::options() };
    let joint = solve_rgbd(&rig.input(&poses, &mut rng), &options).unwrap().joint;
    assert_eq!((joint.color.matrix.fx, joint.color_covariance[(0, 0)]), (fx, 0.0));
    let off = joint.depth.lens.matrix.fx - rig.depth.lens.matrix.fx;
    assert!(off.abs() < 4.0 * joint.depth_covariance[(0, 0)].sqrt(), "{off} px");
    assert!(joint.depth_covariance[(0, 0)] > 0.0);
}

fn bowed(x: f64, _: f64) -> f64 {
    let x = x / 0.12 - 1.0;
    0.002 * (1.0 - x * x)
}

fn twisted(x: f64, y: f64) -> f64 {
    0.002 * (x / 0.12 - 1.0) * (y / 0.075 - 1.0)
}

/// How far corrected depth is off at the near end, in the middle and at the far end of what was
/// seen: its mean size over the image and six sets of sixteen views, in millimeters.
fn left_mm(rig: &SeededRgbd, first_seed: u64) -> [f64; 3] {
    let mut left_mm = [0.0; 3];
    for seed in first_seed..first_seed + 6 {
        let mut rng = SeededCamera::rng(seed);
        let poses = rig.poses(16, &mut rng);
        let solved = solve_rgbd(&rig.input(&poses, &mut rng), &SeededRgbd::options()).unwrap();
        let [near, far] = solved.joint.depth.correction.as_ref().unwrap().seen_m;
        for (left, part) in left_mm.iter_mut().zip([0.1, 0.5, 0.9]) {
            *left += 1e3 * left_at(rig, &solved, near + part * (far - near))[1] / 6.0;
        }
    }
    left_mm
}

/// Depth is compared with the surface that color measured: a board that is bowed or twisted by two
/// millimeters leaves about what a flat one does, where its plane would leave three times as much.
#[test]
fn depth_is_corrected_by_an_uneven_board_as_by_a_flat_one() {
    let first_seed = std::env::var("SEED").map_or(920, |seed| seed.parse().unwrap());
    for with_infrared in [true, false] {
        let rig = || SeededRgbd { with_infrared, ..SeededRgbd::new() };
        let flat_mm = left_mm(&rig(), first_seed);
        for (name, height_m) in [("bowed", bowed as fn(f64, f64) -> f64), ("twisted", twisted)] {
            let uneven_mm = left_mm(&SeededRgbd { height_m, ..rig() }, first_seed);
            println!(
                "seed {first_seed}, infrared {with_infrared}: {name} {uneven_mm:.3?} mm, flat \
                 {flat_mm:.3?} mm"
            );
            for (uneven_mm, flat_mm) in uneven_mm.iter().zip(flat_mm) {
                assert!(*uneven_mm < 2.2 * flat_mm + 0.05, "{uneven_mm} of {flat_mm} mm");
            }
        }
    }
}
