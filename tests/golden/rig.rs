//! Several sensors at once: where they are, to within the prediction; and what only a rig can find.

use nalgebra::{Point3, Vector3};
use plumb::calibration::sensor::SensorId;
use plumb::calibration::solve::rig_input::{RigInput, RigSensorInput};
use plumb::calibration::solve::solve_rig::solve_rig;
use plumb::estimation::camera::CameraOptions;
use plumb::estimation::error::EstimationError;
use plumb::estimation::problem::{GivenParameter, LensChoice};
use plumb::estimation::rig::{FrameSetView, RigProblem, RigSensor, calibrate_rig};
use plumb::estimation::view_fault::ViewFault;
use plumb::geometry::lens::LensModel;
use plumb::geometry::pose::Pose;
use plumb::geometry::target::Target;
use plumb::imaging::frame::SensorKind;
use rand_distr::{Distribution, Normal};

use crate::seeded_camera::SeededCamera;

/// Two sensors of different lens and noise, six centimeters from each other, and what each sees of
/// `frame_sets` boards.
fn stereo(frame_sets: usize, seed: u64) -> (RigProblem, Pose) {
    let (problem, right_from_left, _) = stereo_with_poses(frame_sets, seed);
    (problem, right_from_left)
}

/// The mean of all points that were seen, which pose covariances are about.
fn center_in_board(problem: &RigProblem) -> Point3<f64> {
    let views = problem.sensors.iter().flat_map(|sensor| &sensor.views);
    let points: Vec<_> = views
        .flat_map(|seen| &seen.view.correspondences)
        .map(|c| c.point_in_board.coords)
        .collect();
    Point3::from(points.iter().sum::<Vector3<f64>>() / points.len() as f64)
}

fn right_camera() -> SeededCamera {
    let mut right = SeededCamera { noise_px: 0.2, ..SeededCamera::ordinary() };
    right.lens.matrix.fx = 500.0;
    right.lens.matrix.fy = 502.0;
    right
}

/// As [`stereo`], with where the left sensor sees the board at each instant.
fn stereo_with_poses(frame_sets: usize, seed: u64) -> (RigProblem, Pose, Vec<Pose>) {
    let (left, right) = (SeededCamera::ordinary(), right_camera());
    let right_from_left =
        Pose::from_axis_angle(Vector3::new(0.01, -0.05, 0.02), Vector3::new(-0.06, 0.002, 0.004));
    let mut rng = SeededCamera::rng(seed);
    let left_from_board = left.poses(frame_sets, &mut rng);
    let sensor = |name: &str, camera: &SeededCamera, sensor_from_left: Pose, rng: &mut _| {
        let sees = |(_, pose): &(usize, Pose)| camera.exact(pose).is_some();
        let poses = left_from_board.iter().map(|pose| sensor_from_left * *pose).enumerate();
        let (frame_sets, poses): (Vec<usize>, Vec<Pose>) = poses.filter(sees).unzip();
        let views = camera.problem(&poses, rng).views;
        let lens = LensChoice::Model(camera.lens.model());
        let options = CameraOptions { lens, ..CameraOptions::default() };
        let numbered = |(frame_set, view)| FrameSetView { frame_set, view };
        let views = frame_sets.into_iter().zip(views).map(numbered).collect();
        RigSensor {
            name: name.to_owned(),
            image_size: camera.size,
            views,
            options,
            lens_covariance_with_shape: None,
        }
    };
    let sensors = vec![
        sensor("left", &left, Pose::identity(), &mut rng),
        sensor("right", &right, right_from_left, &mut rng),
    ];
    (RigProblem { sensors, frame_sets }, right_from_left, left_from_board)
}

#[test]
fn a_pair_is_found_to_within_its_prediction() {
    let (mut inside, mut count) = (0, 0);
    for seed in 0..20 {
        let (problem, truth) = stereo(20, seed);
        assert!(
            problem.sensors[1].views.len() < 20,
            "the test means to have views that only one sensor sees"
        );
        let estimate = calibrate_rig(&problem).unwrap();
        let known = &estimate.sensor_poses[1];
        let rotation =
            (known.sensor_from_rig.rotation() * truth.rotation().inverse()).scaled_axis();
        let translation = known.sensor_from_rig.translation() - truth.translation();
        for (axis, error) in rotation.iter().chain(translation.iter()).enumerate() {
            let std = known.covariance[(axis, axis)].sqrt();
            assert!(error.abs() < 4.5 * std, "seed {seed}, axis {axis}: {error} ± {std}");
            inside += usize::from(error.abs() < std);
            count += 1;
        }
        assert!(
            (estimate.cameras[1].noise - 0.2).abs() < 0.02,
            "noise {}",
            estimate.cameras[1].noise
        );
    }
    let part = inside as f64 / f64::from(count);
    assert!((0.55..0.82).contains(&part), "{part} of the errors are within one standard deviation");
}

#[test]
fn every_sensor_knows_how_well_it_knows_the_board_s_place() {
    let (mut inside, mut count) = ([0; 2], 0);
    for seed in 40..60 {
        let (problem, right_from_left, left_from_board) = stereo_with_poses(20, seed);
        let estimate = calibrate_rig(&problem).unwrap();
        let center = center_in_board(&problem);
        for (sensor, from_left) in [(0, Pose::identity()), (1, right_from_left)] {
            for (seen, view) in
                problem.sensors[sensor].views.iter().zip(&estimate.cameras[sensor].views)
            {
                let (found, truth) =
                    (view.camera_from_board.unwrap(), from_left * left_from_board[seen.frame_set]);
                let covariance = view.covariance.unwrap();
                let rotation = (found.rotation() * truth.rotation().inverse()).scaled_axis();
                let translation = (found * center - truth * center).norm();
                let rotation_inside = rotation
                    .iter()
                    .enumerate()
                    .filter(|(k, e)| e.abs() < covariance[(*k, *k)].sqrt())
                    .count();
                inside[0] += rotation_inside;
                let predicted = (0..3).map(|k| covariance[(3 + k, 3 + k)]).sum::<f64>().sqrt();
                inside[1] += usize::from(translation < predicted);
                count += 1;
            }
        }
    }
    let rotations = inside[0] as f64 / (3 * count) as f64;
    let translations = inside[1] as f64 / count as f64;
    assert!(
        (0.62..0.75).contains(&rotations),
        "{rotations} of the rotations are within one standard deviation"
    );
    assert!(
        (0.5..0.85).contains(&translations),
        "{translations} of the translations are within the predicted length"
    );
}

/// Shears each image of one sensor along its rows, each by another amount: what a rolling shutter
/// makes of a moving board.
fn sheared(problem: &mut RigProblem, sensor: usize, std_px: f64, seed: u64) {
    let normal = Normal::new(0.0, std_px).unwrap();
    let mut rng = SeededCamera::rng(seed);
    let size = problem.sensors[sensor].image_size;
    for FrameSetView { view, .. } in &mut problem.sensors[sensor].views {
        let [across, down] = [normal.sample(&mut rng), normal.sample(&mut rng)];
        for corner in &mut view.correspondences {
            let time = corner.pixel.y / f64::from(size.height) - 0.5;
            corner.pixel.x += across * time;
            corner.pixel.y += down * time;
        }
    }
}

#[test]
fn what_moves_whole_views_of_one_sensor_is_in_the_rig_s_uncertainty() {
    let (mut seen, mut alone, mut count) = (0.0, 0.0, 0.0);
    for seed in 200..220 {
        let (mut problem, truth) = stereo(20, seed);
        sheared(&mut problem, 1, 2.0, seed);
        let estimate = calibrate_rig(&problem).unwrap();
        let known = &estimate.sensor_poses[1];
        let [left, right] = [0, 1].map(|camera| estimate.cameras[camera].variance_inflation);
        assert!(
            right > 2.0,
            "seed {seed}: the right one's variances are {right} times as large, the left one's {left}"
        );
        let rotation =
            (known.sensor_from_rig.rotation() * truth.rotation().inverse()).scaled_axis();
        for axis in 0..3 {
            let square = rotation[axis].powi(2) / known.covariance[(axis, axis)];
            (seen, alone, count) =
                (seen + square, alone + square * known.variance_inflation, count + 1.0);
        }
    }
    let [ratio, naive] = [seen, alone].map(|sum: f64| (sum / count).sqrt());
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
fn halves_of_a_rig_differ_as_predicted() {
    let (mut lens, mut pose, mut held_out, mut count) = (0.0, 0.0, 0.0, 0.0);
    for seed in 500..530 {
        let (problem, _) = stereo(20, seed);
        let estimate = calibrate_rig(&problem).unwrap();
        let [left, right] = estimate.halves[..] else { panic!("seed {seed}: no halves") };
        assert_eq!(left.pose, None, "the left one is the rig's own frame");
        let known = right.pose.unwrap();
        pose += known.ratio * known.ratio;
        lens += [left, right].map(|of| of.lens.ratio.unwrap().powi(2) / 2.0).iter().sum::<f64>();
        count += 1.0;
        for (halves, camera) in [left, right].iter().zip(&estimate.cameras) {
            held_out += halves.held_out_rms_px.unwrap() / camera.rms_px / 2.0;
        }
    }
    let [lens, pose] = [lens, pose].map(|sum: f64| (sum / count).sqrt());
    held_out /= count;
    let line =
        format!("lenses {lens:.2} times as predicted, poses {pose:.2}; held out {held_out:.3} rms");
    println!("{line}");
    assert!((0.8..1.2).contains(&lens) && (0.8..1.2).contains(&pose), "{line}");
    // Corners that were not fitted to are off by little more than those that were.
    assert!((1.0..1.15).contains(&held_out), "{line}");
}

#[test]
fn a_right_rig_is_not_accused() {
    // Chance makes views seem to differ seven times in a hundred, and then hardly.
    let mut widened = 0;
    for seed in 300..310 {
        let (problem, _) = stereo(20, seed);
        let estimate = calibrate_rig(&problem).unwrap();
        let factors = [
            estimate.cameras[0].variance_inflation,
            estimate.cameras[1].variance_inflation,
            estimate.sensor_poses[1].variance_inflation,
        ];
        assert!(factors.iter().all(|factor| *factor < 1.25), "seed {seed}: {factors:?}");
        widened += factors.iter().filter(|factor| **factor > 1.0).count();
    }
    assert!(widened <= 6, "{widened} of 30");
}

/// Twists the board of `problem`: `height_m` up at two of its corners, as much down at the others.
fn twisted(problem: &mut RigProblem, boards: &[Vec<Pose>], height_m: f64) {
    let cameras = [SeededCamera::ordinary().lens, right_camera().lens];
    for ((sensor, lens), boards) in problem.sensors.iter_mut().zip(&cameras).zip(boards) {
        for (FrameSetView { view, .. }, sensor_from_board) in sensor.views.iter_mut().zip(boards) {
            for corner in &mut view.correspondences {
                let mut point = corner.point_in_board;
                point.z = height_m * (point.x / 0.12 - 1.0) * (point.y / 0.075 - 1.0);
                let [flat, bent] = [corner.point_in_board, point]
                    .map(|point| lens.pixel_from_point(&(*sensor_from_board * point)).unwrap());
                corner.pixel.x += bent.x - flat.x;
                corner.pixel.y += bent.y - flat.y;
            }
        }
    }
}

fn input_of(problem: &RigProblem) -> RigInput {
    let sensor = |sensor: &RigSensor| RigSensorInput {
        id: SensorId { camera: Some(sensor.name.clone()), kind: SensorKind::Color },
        name: sensor.name.clone(),
        image_size: sensor.image_size,
        given: None,
        views: sensor.views.clone(),
    };
    let board = Target::Chessboard(SeededCamera::ordinary().board);
    RigInput { board, sensors: problem.sensors.iter().map(sensor).collect() }
}

/// In the joint solve as in that of each camera by itself.
#[test]
fn square_pixels_and_what_is_given_hold_in_a_rig() {
    let (problem, _) = stereo(12, 430);
    let options = CameraOptions {
        lens: LensChoice::Model(LensModel::Brown),
        square_pixels: true,
        given: vec![GivenParameter { name: "k3".to_owned(), value: 0.01 }],
        ..CameraOptions::default()
    };
    let solved = solve_rig(&input_of(&problem), &options).unwrap();
    assert_eq!(solved.sensors.len(), 2);
    for (_, sensor) in &solved.sensors {
        let matrix = sensor.lens.matrix;
        assert_eq!(matrix.fx, matrix.fy);
        assert_eq!((sensor.lens.parameters()[9], sensor.lens_std[9]), (0.01, 0.0));
        assert!(sensor.lens_std[0] > 0.0 && sensor.lens_std[0] == sensor.lens_std[1]);
    }
    // By themselves fx and fy differ.
    let options = CameraOptions { lens: options.lens, ..CameraOptions::default() };
    let solved = solve_rig(&input_of(&problem), &options).unwrap();
    assert!(solved.sensors.iter().all(|(_, it)| it.lens.matrix.fx != it.lens.matrix.fy));
}

/// The board's shape is measured by both cameras and both are solved on it: lenses and pose as
/// exact as stated, and far more exact than on the board as it was stated.
#[test]
fn an_uneven_board_is_measured_by_the_whole_rig() {
    let (mut pose_z2, mut lens_z2, mut count) = (0.0, 0.0, 0.0);
    let (mut squares, mut flat_squares) = (0.0, 0.0);
    for seed in 400..420 {
        let (mut problem, truth, left_from_board) = stereo_with_poses(20, seed);
        let of_sensor = |sensor: usize, from_left: Pose| -> Vec<Pose> {
            let views = problem.sensors[sensor].views.iter();
            views.map(|seen| from_left * left_from_board[seen.frame_set]).collect()
        };
        let boards = [of_sensor(0, Pose::identity()), of_sensor(1, truth)];
        twisted(&mut problem, &boards, 0.002);
        let input = input_of(&problem);
        let lens = LensChoice::Model(LensModel::Brown);
        let options = CameraOptions { lens, ..CameraOptions::default() };
        let solved = solve_rig(&input, &options).unwrap();
        let shapes: Vec<_> =
            solved.sensors.iter().map(|(_, sensor)| sensor.board_shape.as_ref().unwrap()).collect();
        assert_eq!(shapes[0], shapes[1], "one board");
        let off = (shapes[0].unevenness_m - 0.882e-3) / shapes[0].unevenness_std_m;
        assert!(off.abs() < 4.0, "seed {seed}: {off} deviations");
        let left_from_right = &solved.extrinsics[0];
        let error_m =
            left_from_right.target_from_source.translation() - truth.inverse().translation();
        for (error, std) in error_m.iter().zip(left_from_right.translation_std_m) {
            pose_z2 += (error / std).powi(2) / 3.0;
        }
        let flat = calibrate_rig(&problem).unwrap();
        for (((_, sensor), flat), fx) in
            solved.sensors.iter().zip(&flat.cameras).zip([560.0, 500.0])
        {
            let off = sensor.lens.matrix.fx - fx;
            lens_z2 += (off / sensor.lens_std[0]).powi(2) / 2.0;
            squares += off * off;
            flat_squares += (flat.lens.matrix.fx - fx).powi(2);
        }
        count += 1.0;
    }
    let [pose_z, lens_z] = [pose_z2, lens_z2].map(|sum: f64| (sum / count).sqrt());
    let ratio = f64::sqrt(squares / flat_squares);
    let line =
        format!("pose z {pose_z:.2}, fx z {lens_z:.2}; fx {ratio:.2} of the flat board's error");
    println!("{line}");
    assert!((0.7..1.3).contains(&pose_z) && (0.7..1.3).contains(&lens_z) && ratio < 0.5, "{line}");
}

#[test]
fn a_board_labeled_from_its_other_end_is_found_and_named() {
    let (mut problem, truth) = stereo(20, 3);
    let view = &mut problem.sensors[1].views[4].view;
    let reversed: Vec<_> = view.correspondences.iter().rev().map(|corner| corner.pixel).collect();
    for (corner, pixel) in view.correspondences.iter_mut().zip(reversed) {
        corner.pixel = pixel;
    }
    let estimate = calibrate_rig(&problem).unwrap();
    assert_eq!(estimate.cameras[1].views[4].fault, Some(ViewFault::HalfTurn));
    let translation = estimate.sensor_poses[1].sensor_from_rig.translation() - truth.translation();
    assert!(translation.norm() < 0.002, "{translation}");
}

#[test]
fn sensors_that_share_nothing_are_refused() {
    let (mut problem, _) = stereo(20, 4);
    for seen in &mut problem.sensors[1].views {
        seen.frame_set += 20;
    }
    problem.frame_sets = 40;
    assert_eq!(
        calibrate_rig(&problem).unwrap_err(),
        EstimationError::NothingShared { sensor: "right".to_owned() }
    );
}

#[test]
fn the_order_of_frame_sets_changes_nothing() {
    let (problem, _) = stereo(20, 5);
    let estimate = calibrate_rig(&problem).unwrap();
    let mut other = problem.clone();
    for sensor in &mut other.sensors {
        for seen in &mut sensor.views {
            seen.frame_set = problem.frame_sets - 1 - seen.frame_set;
        }
        sensor.views.sort_by_key(|seen| seen.frame_set);
    }
    let mut again = calibrate_rig(&other).unwrap();
    for camera in &mut again.cameras {
        camera.views.reverse();
    }
    assert_eq!(again, estimate);
}
