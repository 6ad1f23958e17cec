//! What views of color and depth are said to teach of a depth camera, before there is a solve, is
//! what solves of them scatter by.

use nalgebra::{DMatrix, DVector, Matrix6, Point3, Vector6};
use plumb::calibration::information::depth_goal::{DepthColorPair, DepthGoal};
use plumb::calibration::information::depth_information::DepthInformation;
use plumb::calibration::information::infrared_corners::InfraredNormal;
use plumb::calibration::information::lens_information::{LensInformation, open_parameters};
use plumb::calibration::information::projection_goal::GoalFigure;
use plumb::calibration::information::view_information::{ViewNormal, WeightedCorner};
use plumb::estimation::board_pose::board_poses;
use plumb::estimation::problem::{BoardView, Correspondence};
use plumb::estimation::rgbd::plane_information::{
    PlacedDepth, PlaneNormal, TileSample, depth_pose_step,
};
use plumb::estimation::rgbd::{RgbdEstimate, RgbdView, calibrate_rgbd};
use plumb::geometry::depth_camera::DepthReading;
use plumb::geometry::lens::Lens;
use plumb::geometry::pixel::Pixel;
use plumb::geometry::pose::Pose;
use plumb::simulation::DepthError;

use crate::seeded_camera::SeededCamera;
use crate::seeded_rgbd::SeededRgbd;

const RUNS: u64 = 60;

/// What views of known truth teach.
fn predicted(rig: &SeededRgbd, views: &[RgbdView]) -> (DepthInformation, PlacedDepth) {
    let reading = DepthReading::Metric { unit_m: rig.unit_m };
    let z_m: Vec<f64> =
        views.iter().flat_map(|view| &view.tiles).map(|tile| 1.0 / tile.inverse_depth).collect();
    let seen_m =
        [f64::min, f64::max].map(|of: fn(f64, f64) -> f64| z_m.iter().copied().reduce(of).unwrap());
    let mut depth =
        PlacedDepth::new(rig.depth.lens, rig.depth.size, rig.depth_from_color, reading, seen_m);
    if rig.with_infrared {
        depth = depth.with_open_lens();
    }
    let free = open_parameters(rig.color.lens.model());
    let nothing = DMatrix::zeros(free.len(), free.len());
    let color = LensInformation { lens: rig.color.lens, free, matrix: nothing };
    let mut known = DepthInformation::of_solve(&color, &depth);
    if rig.with_infrared {
        known = known.with_infrared(&depth);
    }
    for view in views {
        let normal =
            ViewNormal::of(&rig.color.lens, &view.color_from_board, &weighted(&view.color));
        known.color += normal.lens_information(&known.free).unwrap();
        let centered = Pose::new(view.color_from_board.rotation(), normal.middle_in_camera);
        let all = TileSample { tiles: view.tiles.clone(), each: 1.0 };
        let planes = PlaneNormal::of(&depth, &centered, &all, 1.0).unwrap();
        let taught = if rig.with_infrared {
            let infrared_from_board = rig.depth_from_color * view.color_from_board;
            let corners = weighted(&view.infrared);
            let infrared = ViewNormal::of(&rig.depth.lens, &infrared_from_board, &corners);
            let infrared = InfraredNormal::of(&depth, &normal.middle_in_camera, &infrared);
            known.of_view_with_infrared(&normal, &infrared, Some(&planes)).unwrap()
        } else {
            known.of_view(&normal, &planes).unwrap()
        };
        known.add(&taught);
    }
    (known, depth)
}

fn weighted(corners: &[Correspondence]) -> Vec<WeightedCorner> {
    (corners.iter())
        .map(|seen| WeightedCorner { point_in_board: seen.point_in_board, std_px: seen.std_px })
        .collect()
}

/// Where color sees depth's pixel at a distance.
fn transferred(rig: &SeededRgbd, found: &RgbdEstimate, pixel: Pixel, z_m: f64) -> Pixel {
    let measured = rig.error.measured(1.0 / z_m, pixel, rig.depth.size);
    let reading = found.depth.reading.reading(measured);
    let point = found.depth.point_from_reading(pixel, reading).unwrap();
    found.color.pixel_from_point(&(found.color_from_depth * point)).unwrap()
}

/// By planes alone, of a depth camera whose error is a scale and an offset.
fn rig() -> SeededRgbd {
    let error =
        DepthError { scale: [0.006, 0.0, 0.0, 0.0, 0.0], offset: [0.004, 0.0, 0.0, 0.0, 0.0] };
    SeededRgbd { with_infrared: false, error, ..SeededRgbd::new() }.without_distortion()
}

/// Solves of the same poses with other noise against what is predicted of them.
fn compared(rig: &SeededRgbd, views: usize, seed: u64) -> [f64; 2] {
    let poses = rig.poses(views, &mut SeededCamera::rng(seed));
    let problem = rig.problem(&poses, &mut SeededCamera::rng(1000 * seed));
    let (known, depth) = predicted(rig, &problem.views);
    let at = depth.pose_at();
    let covariance: Matrix6<f64> =
        known.covariance().unwrap().fixed_view::<6, 6>(at, at).into_owned();
    let (middle, z_m) = (Pixel::new(160.0, 120.0), 0.6);
    let sensors = DepthColorPair {
        depth: &depth,
        depth_size: rig.depth.size,
        color: &rig.color.lens,
        free: &known.free,
        color_size: rig.color.size,
    };
    let goal = DepthGoal::new(sensors, &[z_m], GoalFigure::Median).unwrap();
    let predicted_px = goal.figure_px(&goal.std_px(&known).unwrap());
    let inside = DepthGoal::new(sensors, &[0.45, 0.6, 0.8], GoalFigure::Median).unwrap();
    let bands = inside.figures_px(&inside.std_px(&known).unwrap());
    let truth = {
        let in_depth = depth.lens.bearing_from_pixel(middle).unwrap();
        let point = Point3::from(in_depth.into_inner() * (z_m / in_depth.z));
        rig.color.lens.pixel_from_point(&(rig.depth_from_color.inverse() * point)).unwrap()
    };
    let (mut errors, mut squares) = (Vec::new(), 0.0);
    for run in 0..RUNS {
        let mut rng = SeededCamera::rng(1000 * seed + 1 + run);
        let found = calibrate_rgbd(&rig.problem(&poses, &mut rng)).unwrap();
        let place = found.color_from_depth.inverse();
        errors.push(depth_pose_step(&rig.depth_from_color, &place));
        squares += transferred(rig, &found, middle, z_m).distance_px(truth).powi(2);
    }
    let inverse = covariance.try_inverse().unwrap();
    let mean_square =
        errors.iter().map(|error| error.dot(&(inverse * error))).sum::<f64>() / (6 * RUNS) as f64;
    let std = |k: usize| covariance[(k, k)].sqrt();
    let each = Vector6::from_fn(|k, _| {
        let sum: f64 = errors.iter().map(|error| (error[k] / std(k)).powi(2)).sum();
        (sum / RUNS as f64).sqrt()
    });
    let rms_px = (squares / RUNS as f64).sqrt();
    println!(
        "seed {seed}: mean square of errors over their prediction {mean_square:.2}, each {:.2?}; \
         at 0.6 m {rms_px:.4} px rms, {predicted_px:.4} px predicted over the image; at 0.45, 0.6, \
         0.8 m {bands:.4?} px",
        each.as_slice()
    );
    [mean_square, rms_px / predicted_px]
}

#[test]
fn what_is_predicted_of_depth_is_what_its_solves_scatter_by() {
    let seeds: Vec<u64> = match std::env::var("SEEDS") {
        Ok(seeds) => seeds.split(',').map(|seed| seed.parse().unwrap()).collect(),
        Err(_) => vec![61],
    };
    for seed in seeds {
        let infrared = SeededRgbd { with_infrared: true, error: rig().error, ..SeededRgbd::new() };
        for rig in [rig(), infrared] {
            let [mean_square, _] = compared(&rig, 12, seed);
            // 360 numbers of which each six are independent: 1 ± 0.07.
            assert!((mean_square - 1.0).abs() < 0.3, "{mean_square}");
        }
    }
}

#[test]
fn derivatives_of_depth_s_points_are_those_of_differences() {
    let rig = rig();
    let reading = DepthReading::Metric { unit_m: rig.unit_m };
    let mut depth = PlacedDepth::new(
        SeededRgbd::new().depth.lens,
        rig.depth.size,
        rig.depth_from_color,
        reading,
        [0.3, 2.0],
    );
    depth.correction.coefficients = vec![0.01, -0.02];
    let depth = depth.with_open_lens();
    for (pixel, z_m) in [(Pixel::new(20.0, 200.0), 0.5), (Pixel::new(170.0, 100.0), 1.3)] {
        let (point, by_depth) = depth.point_in_color(pixel, z_m).unwrap();
        let measured = depth.uncorrected(pixel, 1.0 / z_m);
        for k in 0..depth.parameters() {
            let step = if k < 4 { 1e-2 } else { 1e-5 };
            let moved =
                |sign: f64| {
                    let by = DVector::from_fn(depth.parameters(), |j, _| {
                        if j == k { sign * step } else { 0.0 }
                    });
                    let there = depth.stepped(&by).unwrap();
                    let z_m = 1.0 / there.correction.correct(pixel, measured).unwrap();
                    there.point_in_color(pixel, z_m).unwrap().0
                };
            let numeric = (moved(1.0) - moved(-1.0)) / (2.0 * step);
            let analytic = by_depth.column(k);
            let off = (0..3).map(|a| (numeric[a] - analytic[a]).abs()).fold(0.0, f64::max);
            assert!(off < 1e-6 + 1e-4 * numeric.norm(), "{k}: {numeric:?}, {analytic:?}");
        }
        let direct = rig.depth_from_color * point;
        assert!((direct.z - z_m).abs() < 1e-9, "{direct:?}");
    }
}

/// Of exact corners and planes: another lens of color moves the boards, and those the depth camera.
#[test]
fn depth_moves_with_color_s_lens_as_its_information_says() {
    let rig = SeededRgbd { noise_per_m: 1e-9, ..rig() };
    let poses = rig.poses(8, &mut SeededCamera::rng(5));
    let problem = rig.problem(&poses, &mut SeededCamera::rng(6));
    let mut views = problem.views;
    for view in &mut views {
        for seen in &mut view.color {
            let point = view.color_from_board * seen.point_in_board;
            seen.pixel = rig.color.lens.pixel_from_point(&point).unwrap();
        }
        for tile in &mut view.tiles {
            tile.reading_std = 0.003;
            let quiet = rig.error.measured(0.0, tile.pixel, rig.depth.size);
            let by_scale = rig.error.measured(1.0, tile.pixel, rig.depth.size) - quiet;
            tile.inverse_depth = (tile.inverse_depth - quiet) / by_scale;
        }
    }
    let (known, depth) = predicted(&rig, &views);
    let moved = {
        let mut parameters = rig.color.lens.parameters();
        (parameters[0], parameters[3]) = (parameters[0] + 0.05, parameters[3] - 0.03);
        Lens::from_parameters(rig.color.lens.model(), &parameters).unwrap()
    };
    let (mut normal, mut gradient) =
        (known.depth.by_depth.clone() * 0.0, DVector::zeros(depth.parameters()));
    normal += depth.correction_prior();
    for view in &views {
        let seen = BoardView { name: String::new(), correspondences: view.color.clone() };
        let color_from_board = board_poses(&moved, &seen).unwrap()[0].camera_from_board;
        let color = ViewNormal::of(&moved, &color_from_board, &weighted(&view.color));
        let centered = Pose::new(color_from_board.rotation(), color.middle_in_camera);
        let all = TileSample { tiles: view.tiles.clone(), each: 1.0 };
        let planes = PlaneNormal::of(&depth, &centered, &all, 1.0).unwrap();
        let inverse = (color.by_pose + planes.by_pose).try_inverse().unwrap();
        let through = &planes.coupling * inverse;
        normal += &planes.by_depth - &through * planes.coupling.transpose();
        gradient += &planes.gradient - through * planes.pose_gradient;
    }
    let found = -(normal.try_inverse().unwrap() * gradient);
    let step = DVector::from_fn(known.free.len(), |k, _| match known.free[k] {
        0 => 0.05,
        3 => -0.03,
        _ => 0.0,
    });
    let said = known.depth.by_depth.clone().try_inverse().unwrap() * &known.depth.by_color * step;
    for k in 0..10 {
        let off = (found[k] - said[k]).abs();
        println!("{k}: {:.3e}, said {:.3e}", found[k], said[k]);
        assert!(off < 0.03 * said[k].abs() + 1e-6, "{k}: {} for {}", said[k], found[k]);
    }
}
