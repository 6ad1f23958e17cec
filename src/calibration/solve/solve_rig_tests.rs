//! Tests of rigs with seeded ground truth: cameras connected only through others, boards labeled
//! from either end, cameras that share no views.

use nalgebra::Vector3;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

use super::*;
use crate::estimation::problem::{BoardView, Correspondence, LensChoice};
use crate::estimation::rig::FrameSetView;
use crate::geometry::board::{BoardSize, Chessboard};
use crate::geometry::camera_matrix::CameraMatrix;
use crate::geometry::lens::{Lens, LensModel};
use crate::geometry::pixel::ImageSize;
use crate::geometry::pose::Pose;
use crate::imaging::frame::SensorKind;

const SIZE: ImageSize = ImageSize::new(640, 480);
const NOISE_PX: f64 = 0.05;
const NAMES: [&str; 3] = ["left", "right", "far"];

fn lens(fx: f64) -> Lens {
    Lens::pinhole(CameraMatrix { fx, fy: fx, cx: 320.0, cy: 240.0, skew: 0.0 })
}

fn camera_from_first() -> [Pose; 3] {
    let place = |rotation: [f64; 3], translation: [f64; 3]| {
        Pose::from_axis_angle(rotation.into(), translation.into())
    };
    [
        Pose::identity(),
        place([0.01, 0.1, 0.0], [-0.12, 0.0, 0.01]),
        place([-0.02, 0.22, 0.01], [-0.25, 0.0, 0.03]),
    ]
}

/// The observations of three cameras of a board that each may detect rotated by half a turn; `sees`
/// is whether a camera sees the board in a frame set.
fn input(board: Chessboard, sees: impl Fn(usize, usize) -> bool) -> RigInput {
    let mut rng = ChaCha8Rng::seed_from_u64(11);
    let middle =
        board.corner_in_board(board.size.cols as i32 - 1, board.size.rows as i32 - 1).coords * 0.5;
    let mut random = |from: f64, to: f64| rng.random_range(from..to);
    let first_from_board: Vec<Pose> = (0..30)
        .map(|_| {
            let rotation = Vector3::new(random(-0.6, 0.6), random(-0.6, 0.6), random(-0.4, 0.4));
            let place = Vector3::new(random(-0.12, 0.22), random(-0.1, 0.1), random(0.55, 0.9));
            let rotated = Pose::from_axis_angle(rotation, Vector3::zeros());
            Pose::new(rotated.rotation(), place - rotated.rotation() * middle)
        })
        .collect();
    let quarter_turns = board.symmetries();
    let camera = |(camera, from_first): (usize, Pose)| {
        let mut views = Vec::new();
        for (frame_set, first_from_board) in first_from_board.iter().enumerate() {
            let labeled = quarter_turns
                [(random(0.0, 1.0) * quarter_turns.len() as f64) as usize % quarter_turns.len()];
            let pixels = board.corners_in_board().into_iter().map(|point| {
                let pixel = lens(520.0 + 20.0 * camera as f64)
                    .pixel_from_point(&(from_first * *first_from_board * point))?;
                let noisy = crate::geometry::pixel::Pixel::new(
                    pixel.x + NOISE_PX * random(-1.7, 1.7),
                    pixel.y + NOISE_PX * random(-1.7, 1.7),
                );
                SIZE.contains(noisy).then_some((labeled.inverse() * point, noisy))
            });
            let seen: Option<Vec<_>> = pixels.collect();
            if let Some(seen) = seen.filter(|_| sees(camera, frame_set)) {
                let correspondences = seen
                    .into_iter()
                    .map(|(point_in_board, pixel)| Correspondence {
                        point_in_board,
                        pixel,
                        std_px: NOISE_PX,
                    })
                    .collect();
                let view = BoardView { name: frame_set.to_string(), correspondences };
                views.push(FrameSetView { frame_set, view });
            }
        }
        let name = NAMES[camera];
        RigSensorInput {
            id: SensorId::of(name, SensorKind::Color),
            name: name.to_owned(),
            image_size: SIZE,
            given: None,
            views,
        }
    };
    RigInput {
        board: board.into(),
        sensors: camera_from_first().into_iter().enumerate().map(camera).collect(),
    }
}

fn options() -> CameraOptions {
    CameraOptions { lens: LensChoice::Model(LensModel::Pinhole), ..CameraOptions::default() }
}

#[track_caller]
fn within_prediction(known: &Extrinsics, target_from_source: &Pose) {
    let rotation = (known.target_from_source.rotation() * target_from_source.rotation().inverse())
        .scaled_axis();
    let translation = known.target_from_source.translation() - target_from_source.translation();
    for axis in 0..3 {
        assert!(
            rotation[axis].abs() < 4.0 * known.rotation_std[axis],
            "{:?}: {rotation} ± {:?}",
            known.source,
            known.rotation_std
        );
        let std = known.translation_std_m[axis];
        assert!(
            translation[axis].abs() < 4.0 * std && std < 2e-3,
            "{:?}: {translation} ± {:?}",
            known.source,
            known.translation_std_m
        );
    }
}

#[test]
fn a_given_lens_of_another_camera_is_the_first_cause() {
    let board = Chessboard::new(BoardSize::new(8, 5).unwrap(), 0.03).unwrap();
    let first_reason = |fx: f64| {
        let mut input = input(board, |_, _| true);
        input.sensors[1].given = Some(lens(fx));
        match solve_rig(&input, &options()) {
            Ok(solved) => solved.verdict.reasons.first().cloned().unwrap_or_default(),
            Err(error) => error.to_string(),
        }
    };
    for fx in [534.0, 560.0, 700.0] {
        let reason = first_reason(fx);
        assert!(reason.starts_with("right: the given lens contradicts the views: its"), "{reason}");
    }
    let right = first_reason(540.0);
    assert!(!right.contains("given"), "{right}");
}

#[test]
fn symmetric_boards_place_cameras_through_others() {
    for size in [BoardSize::new(8, 6).unwrap(), BoardSize::new(6, 6).unwrap()] {
        let board = Chessboard::new(size, 0.03).unwrap();
        // The far camera shares frame sets with the right one only.
        let solved = solve_rig(
            &input(board, |camera, frame_set| camera != [2, 9, 0][frame_set % 3]),
            &options(),
        )
        .unwrap();
        let named = |known: &Extrinsics| [&known.target, &known.source].map(|id| id.camera.clone());
        let names: Vec<[Option<String>; 2]> = solved.extrinsics.iter().map(named).collect();
        let from_left = |name: &str| ["left", name].map(|name| Some(name.to_owned()));
        assert_eq!(names, [from_left("right"), from_left("far")]);
        for (known, truth) in solved.extrinsics.iter().zip(&camera_from_first()[1..]) {
            within_prediction(known, &truth.inverse());
        }
        assert_eq!(solved.sensors.len(), 3);
    }
}

#[test]
fn a_camera_that_shares_nothing_costs_the_others_nothing() {
    let board = Chessboard::new(BoardSize::new(9, 6).unwrap(), 0.025).unwrap();
    let solved =
        solve_rig(&input(board, |camera, frame_set| (camera == 2) == (frame_set < 12)), &options())
            .unwrap();
    assert_eq!(solved.extrinsics.len(), 1);
    assert_eq!(solved.sensors.len(), 3);
    let reported = solved
        .verdict
        .reasons
        .iter()
        .any(|reason| reason.contains("camera `far` is not determined"));
    assert!(reported && solved.verdict.grade < Grade::Good, "{:?}", solved.verdict);
    let nothing = solve_rig(&input(board, |camera, frame_set| frame_set % 3 == camera), &options())
        .unwrap_err();
    assert_eq!(nothing, RigError::NothingShared);
}

#[test]
fn a_camera_whose_frames_are_of_other_moments_costs_the_others_nothing() {
    let board = Chessboard::new(BoardSize::new(9, 6).unwrap(), 0.025).unwrap();
    let mut input = input(board, |_, _| true);
    let frame_sets: Vec<usize> = input.sensors[2].views.iter().map(|seen| seen.frame_set).collect();
    let count = frame_sets.len();
    for (k, seen) in input.sensors[2].views.iter_mut().enumerate() {
        // No two neighbors stay neighbors.
        seen.frame_set = frame_sets[(k * 11 + 5) % count];
    }
    let solved = solve_rig(&input, &options()).unwrap();
    assert_eq!(solved.extrinsics.len(), 1);
    within_prediction(&solved.extrinsics[0], &camera_from_first()[1].inverse());
    assert_eq!((solved.sensors.len(), solved.verdict.grade), (3, Grade::Poor));
    let reason = solved.verdict.reasons.iter().find(|reason| reason.contains("`far`")).unwrap();
    assert!(reason.contains("in no frame set: give frames"), "{reason}");
}

/// Without noise, as in a recording of a still image: the left camera sees exactly what it saw
/// before, but only now does the right one see the board too.
#[test]
fn a_view_that_equals_an_earlier_one_is_shared_all_the_same() {
    let board = Chessboard::new(BoardSize::new(9, 6).unwrap(), 0.025).unwrap();
    let mut input = input(board, |camera, frame_set| camera < 2 && frame_set >= 15);
    input.sensors.truncate(2);
    let shared = input.sensors[0].views.clone();
    let before = |seen: &FrameSetView| FrameSetView {
        frame_set: seen.frame_set - 15,
        view: seen.view.clone(),
    };
    input.sensors[0].views = shared.iter().map(before).chain(shared.iter().cloned()).collect();
    let solved = solve_rig(&input, &options()).unwrap();
    assert_eq!(solved.extrinsics.len(), 1);
    within_prediction(&solved.extrinsics[0], &camera_from_first()[1].inverse());
}
