//! Two devices with color, infrared and depth as one rig, in one solve: every sensor is where it
//! is said to be, to within what is said of it.

use nalgebra::Vector3;
use plumb::calibration::sensor::SensorId;
use plumb::calibration::solve::rgbd_input::RgbdInput;
use plumb::calibration::{
    CameraFrameSets, InstrumentObservations, ObservedFrameSet, SolveOptions, solve,
};
use plumb::geometry::pose::Pose;
use plumb::imaging::frame::SensorKind;

use crate::seeded_camera::SeededCamera;
use crate::seeded_rgbd::SeededRgbd;

const SEEDS: u64 = 20;
const VIEWS: usize = 12;

/// A camera's sensors as they saw the board.
fn camera(name: &str, device: &SeededRgbd, input: RgbdInput) -> CameraFrameSets {
    let seen = |(number, capture): (usize, plumb::calibration::solve::rgbd_input::RgbdFrameSet)| {
        ObservedFrameSet {
            number,
            name: capture.name,
            time_s: capture.time_s,
            is_view: capture.is_view,
            corners: vec![
                (SensorKind::Color, capture.color),
                (SensorKind::Infrared, capture.infrared),
            ],
            depth: capture.depth,
        }
    };
    CameraFrameSets {
        name: Some(name.to_owned()),
        image_sensors: vec![
            (SensorKind::Color, device.color.size),
            (SensorKind::Infrared, device.depth.size),
        ],
        given: None,
        depth: Some(input.depth),
        frame_sets: input.frame_sets.into_iter().enumerate().map(seen).collect(),
    }
}

/// How far each of the six numbers of a pose is off, in its own predicted standard deviations.
fn off(found: &plumb::calibration::result::Extrinsics, truth: &Pose) -> [f64; 6] {
    let pose = &found.target_from_source;
    let rotation = (pose.rotation() * truth.rotation().inverse()).scaled_axis();
    let translation = pose.translation() - truth.translation();
    std::array::from_fn(|k| match k {
        0..3 => rotation[k] / found.rotation_std[k],
        _ => translation[k - 3] / found.translation_std_m[k - 3],
    })
}

#[test]
fn every_sensor_of_two_devices_is_where_it_is_said_to_be() {
    let (left, right) = (SeededRgbd::new(), SeededRgbd::new());
    let left_from_right =
        Pose::from_axis_angle(Vector3::new(0.02, -0.15, 0.01), Vector3::new(0.12, 0.004, 0.01));
    let [left_depth, right_depth] = [&left, &right].map(|device| device.depth_from_color.inverse());
    let id = SensorId::of;
    let truth = [
        (id("right", SensorKind::Color), left_from_right),
        (id("left", SensorKind::Infrared), left_depth),
        (id("left", SensorKind::Depth), left_depth),
        (id("right", SensorKind::Infrared), left_from_right * right_depth),
        (id("right", SensorKind::Depth), left_from_right * right_depth),
    ];
    let mut squares = vec![0.0; truth.len()];
    let (mut numbers, mut beyond, mut worst) = (0, 0, 0.0_f64);
    for seed in 0..SEEDS {
        let rng = &mut SeededCamera::rng(7000 + seed);
        let mut poses = Vec::new();
        while poses.len() < VIEWS {
            let right_from_left = left_from_right.inverse();
            let seen = |pose: &Pose| {
                let in_right = right_from_left * *pose;
                right.color.exact(&in_right).is_some()
                    && right.depth.exact(&(right.depth_from_color * in_right)).is_some()
            };
            poses.extend(left.poses(1, rng).into_iter().filter(seen));
        }
        let in_right: Vec<Pose> =
            poses.iter().map(|pose| left_from_right.inverse() * *pose).collect();
        let cameras = vec![
            camera("left", &left, left.input(&poses, rng)),
            camera("right", &right, right.input(&in_right, rng)),
        ];
        let observations = InstrumentObservations { board: Some(left.color.board.into()), cameras };
        let options = SolveOptions { camera: SeededRgbd::options(), ..SolveOptions::default() };
        let solved = solve(&observations, &options).unwrap();
        assert_eq!(solved.extrinsics.len(), truth.len(), "{:?}", solved.verdict);
        for ((sensor, truth), square) in truth.iter().zip(&mut squares) {
            let found = solved.pose(&id("left", SensorKind::Color), sensor).unwrap();
            for sigma in off(found, truth) {
                *square += sigma * sigma;
                numbers += 1;
                beyond += usize::from(sigma.abs() > 3.0);
                worst = worst.max(sigma.abs());
            }
        }
    }
    let rms: Vec<f64> = squares.iter().map(|square| (square / (6 * SEEDS) as f64).sqrt()).collect();
    println!("{rms:.2?} sigma rms, {beyond} of {numbers} beyond 3 sigma, worst {worst:.2}");
    // Of 600 Gaussian numbers 1.6 are beyond 3 sigma; seven are once in a thousand.
    assert!(beyond < 7 && worst < 4.5, "{beyond} of {numbers} beyond 3 sigma, worst {worst:.2}");
    assert!(rms.iter().all(|rms| *rms < 1.3), "{rms:.2?}");
}
