use nalgebra::Vector3;
use rand::{RngExt, SeedableRng};

use super::*;
use crate::calibration::sensor::SensorId;
use crate::calibration::solve::observations::ObservedFrameSet;
use crate::estimation::camera::CameraOptions;
use crate::estimation::problem::{BoardView, Correspondence, GivenParameter, LensChoice};
use crate::estimation::rig::FrameSetView;
use crate::geometry::board::{BoardSize, Chessboard};
use crate::geometry::camera_matrix::CameraMatrix;
use crate::geometry::lens::{Lens, LensModel};
use crate::geometry::pixel::{ImageSize, Pixel};
use crate::geometry::pose::Pose;

const NOISE_PX: f64 = 0.05;
const SIZE: ImageSize = ImageSize::new(640, 480);

fn lens(fx: f64) -> Lens {
    Lens::pinhole(CameraMatrix { fx, fy: fx, cx: 322.0, cy: 238.0, skew: 0.0 })
}

fn board() -> Chessboard {
    Chessboard::new(BoardSize::new(8, 5).unwrap(), 0.03).unwrap()
}

fn options() -> SolveOptions {
    let lens = LensChoice::Model(LensModel::Pinhole);
    let camera = CameraOptions { lens, ..CameraOptions::default() };
    SolveOptions { camera, ..SolveOptions::default() }
}

/// A board that moves and rotates in front of the color sensor and another sensor, 75 mm beside it.
fn frame_sets(other: SensorKind, color_from_other: Pose) -> Vec<ObservedFrameSet> {
    let board = board();
    let mut noise = rand_chacha::ChaCha8Rng::seed_from_u64(5);
    let mut seen = |lens: &Lens, camera_from_board: Pose| -> Vec<Correspondence> {
        let corner = |point_in_board| {
            let pixel = lens.pixel_from_point(&(camera_from_board * point_in_board)).unwrap();
            let mut noisy = |at: f64| at + NOISE_PX * noise.random_range(-1.7..1.7);
            let pixel = Pixel::new(noisy(pixel.x), noisy(pixel.y));
            Correspondence { point_in_board, pixel, std_px: NOISE_PX }
        };
        board.corners_in_board().into_iter().map(corner).collect()
    };
    let frame_set = |number: usize| {
        let across = |factor: f64| (number as f64 * factor).sin();
        let rotation = Vector3::new(0.5 * across(1.3), 0.5 * across(2.1), 0.3 * across(0.7));
        let translation = Vector3::new(
            -0.1 + 0.12 * across(3.1),
            -0.06 + 0.08 * across(1.9),
            0.7 + 0.1 * across(0.9),
        );
        let color_from_board = Pose::from_axis_angle(rotation, translation);
        let color = seen(&lens(600.0), color_from_board);
        let beside = seen(&lens(575.0), color_from_other.inverse() * color_from_board);
        ObservedFrameSet {
            number,
            name: number.to_string(),
            time_s: None,
            is_view: true,
            corners: vec![(SensorKind::Color, color), (other, beside)],
            depth: None,
        }
    };
    (0..15).map(frame_set).collect()
}

fn camera(
    name: Option<&str>,
    kinds: &[SensorKind],
    frame_sets: Vec<ObservedFrameSet>,
) -> CameraFrameSets {
    CameraFrameSets {
        name: name.map(str::to_owned),
        image_sensors: kinds.iter().map(|kind| (*kind, SIZE)).collect(),
        given: None,
        depth: None,
        frame_sets,
    }
}

fn beside() -> Pose {
    Pose::from_axis_angle(Vector3::new(0.01, -0.02, 0.005), Vector3::new(0.075, 0.001, -0.002))
}

#[test]
fn one_sensor_is_solved_as_a_camera_by_itself() {
    let only = camera(None, &[SensorKind::Color], frame_sets(SensorKind::Infrared2, beside()));
    let alone = solve_views(&only.problem(SensorKind::Color), &options().camera).unwrap();
    let observations = InstrumentObservations::of_camera(Some(board().into()), only);
    let solved = solve(&observations, &options()).unwrap();
    assert_eq!(solved, alone.into_calibration(Some(board().into())));
    assert_eq!(observations.sensors(), [SensorId::own(SensorKind::Color)]);
}

#[test]
fn a_lens_that_is_given_is_held() {
    let mut only = camera(None, &[SensorKind::Color], frame_sets(SensorKind::Infrared2, beside()));
    only.given = Some(lens(601.0));
    let observations = InstrumentObservations::of_camera(Some(board().into()), only);
    let solved = solve(&observations, &options()).unwrap();
    assert_eq!(solved.color().unwrap().lens, lens(601.0));
}

#[test]
fn given_parameters_that_the_views_contradict_are_named_and_no_others() {
    let camera = camera(None, &[SensorKind::Color], frame_sets(SensorKind::Infrared2, beside()));
    let verdict_of = |given: &[(&str, f64)]| {
        let parameter = |(name, value): &(&str, f64)| GivenParameter {
            name: (*name).to_owned(),
            value: *value,
        };
        let given = given.iter().map(parameter).collect();
        let camera_options = CameraOptions { given, ..options().camera };
        let options = SolveOptions { camera: camera_options, ..options() };
        let observations = InstrumentObservations::of_camera(Some(board().into()), camera.clone());
        solve(&observations, &options).map(|solved| solved.verdict)
    };
    let wrong = verdict_of(&[("cx", 322.0), ("fx", 612.0)]).unwrap();
    assert_eq!(wrong.grade, Grade::Poor);
    let first = &wrong.reasons[0];
    assert!(first.starts_with("the views contradict the given fx 612 (without it"), "{first}");
    assert!(!wrong.reasons.iter().any(|reason| reason.contains("cause is unknown")), "{wrong:?}");
    let right = verdict_of(&[("cx", 322.0), ("fx", 600.0)]).unwrap();
    assert!(!right.reasons.iter().any(|reason| reason.contains("given")), "{right:?}");
    let far = match verdict_of(&[("fx", 90_000.0)]) {
        Ok(verdict) => verdict.reasons[0].clone(),
        Err(error) => error.to_string(),
    };
    assert!(far.contains("the views contradict the given fx 90000"), "{far}");
}

#[test]
fn a_whole_lens_of_another_camera_is_named() {
    let of = |fx: f64| {
        let mut only =
            camera(None, &[SensorKind::Color], frame_sets(SensorKind::Infrared2, beside()));
        only.given = Some(lens(fx));
        let observations = InstrumentObservations::of_camera(Some(board().into()), only);
        solve(&observations, &options()).unwrap().verdict
    };
    let other = of(575.0);
    assert_eq!(other.grade, Grade::Poor);
    assert!(other.reasons[0].starts_with("the given lens contradicts the views: its"), "{other:?}");
    assert!(!of(600.0).reasons.iter().any(|reason| reason.contains("given")));
}

#[test]
fn every_other_image_sensor_is_placed_beside_color() {
    let truth = beside();
    for kind in [SensorKind::Infrared, SensorKind::Infrared2] {
        let both = camera(None, &[SensorKind::Color, kind], frame_sets(kind, truth));
        let mut observations = InstrumentObservations::of_camera(Some(board().into()), both);
        let solved = solve(&observations, &options()).unwrap();
        let found = solved.pose(&SensorId::own(SensorKind::Color), &SensorId::own(kind)).unwrap();
        let off_m = found.target_from_source.translation() - truth.translation();
        for (off_m, std_m) in off_m.iter().zip(found.translation_std_m) {
            assert!(off_m.abs() < 4.0 * std_m && std_m < 1e-3, "{found:?}");
        }
        assert!(found.target_from_source.angle_to(&truth) < 1e-3, "{found:?}");
        let sensor = solved.image(kind).unwrap();
        assert!((sensor.lens.matrix.fx - 575.0).abs() < 4.0 * sensor.lens_std[0]);

        let seen = observations.cameras[0].frame_sets.iter_mut();
        seen.for_each(|seen| seen.corners.truncate(1));
        let solved = solve(&observations, &options()).unwrap();
        let reason = solved.verdict.reasons.last().unwrap();
        let expected = format!(
            "{0} is not calibrated: only 1 of 2 cameras can be calibrated; camera `{0}`: ",
            kind.name()
        );
        assert!(reason.starts_with(&expected), "{reason}");
    }
}

#[test]
fn a_rig_is_placed_by_what_its_cameras_saw_together() {
    let truth = beside();
    let seen = frame_sets(SensorKind::Infrared2, truth);
    let of = |sensor: usize| {
        let view = |seen: &ObservedFrameSet| {
            let correspondences = seen.corners[sensor].1.clone();
            ObservedFrameSet::of_view(FrameSetView {
                frame_set: seen.number,
                view: BoardView { name: seen.name.clone(), correspondences },
            })
        };
        seen.iter().map(view).collect::<Vec<_>>()
    };
    let cameras = vec![
        camera(Some("left"), &[SensorKind::Color], of(0)),
        camera(Some("right"), &[SensorKind::Color], of(1)),
    ];
    let observations = InstrumentObservations { board: Some(board().into()), cameras };
    let solved = solve(&observations, &options()).unwrap();
    let [left, right] = ["left", "right"].map(|name| SensorId::of(name, SensorKind::Color));
    assert_eq!(observations.sensors(), [left.clone(), right.clone()]);
    let found = solved.pose(&left, &right).unwrap();
    assert!(found.target_from_source.angle_to(&truth) < 1e-3, "{found:?}");
    let off_m = (found.target_from_source.translation() - truth.translation()).norm();
    assert!(off_m < 1e-3, "{found:?}");
}

#[test]
fn what_cannot_be_solved_is_refused() {
    let none = InstrumentObservations { board: Some(board().into()), cameras: Vec::new() };
    assert_eq!(solve(&none, &options()), Err(InstrumentError::NoCamera));
    let kinds = [SensorKind::Color, SensorKind::Infrared2];
    let two = camera(None, &kinds, frame_sets(SensorKind::Infrared2, beside()));
    let without_board = InstrumentObservations::of_camera(None, two);
    assert_eq!(solve(&without_board, &options()), Err(InstrumentError::NoBoard));
}
