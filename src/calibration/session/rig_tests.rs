//! Tests of a rig's session with seeded frame sets: which views are kept together, which are not,
//! and how the session ends.

use nalgebra::{Point3, Vector3};

use super::*;
use crate::calibration::placement::tests::{SIZE, detection_at};
use crate::calibration::running_estimate::estimate_so_far;
use crate::calibration::session_record::{Finish, SessionRequest};
use crate::calibration::view::target_as_seen;
use crate::estimation::problem::CameraProblem;
use crate::estimation::problem::LensChoice;
use crate::geometry::board::{BoardSize, Chessboard};
use crate::geometry::camera_matrix::CameraMatrix;
use crate::geometry::lens::{Lens, LensModel};
use crate::geometry::pixel::Pixel;
use crate::geometry::pose::Pose;

const NOW_NS: i64 = 9_000_000_000;

fn session(cameras: &[&str], finish: Option<Finish>) -> Session {
    let target = Chessboard::new(BoardSize::new(9, 6).unwrap(), 0.025).unwrap();
    let request =
        SessionRequest { target: target.into(), lens: LensChoice::Auto, finish, given: Vec::new() };
    let cameras: Vec<String> = cameras.iter().map(|camera| (*camera).to_owned()).collect();
    Session::begin(
        SessionRecord::begin("01", "pair", request, 1_000_000_000),
        &cameras,
        &AdmissionOptions::default(),
    )
}

fn frame(time_ms: i64) -> FrameFacts {
    FrameFacts {
        sequence: 0,
        name: None,
        host_time_ns: 1_000_000_000 + time_ms * 1_000_000,
        device_time_ns: None,
        image_size: SIZE,
    }
}

/// A board `across` meters to the right, `far` away, tilted.
fn board(across: f64, far: f64, tilt: f64) -> Detection {
    detection_at(Vector3::new(across, 0.02, far), Vector3::new(tilt, 0.0, 0.0))
}

fn sees(time_ms: i64, detection: Detection) -> Option<CameraFrame> {
    Some(CameraFrame { frame: frame(time_ms), seen: Ok(detection.into()), depth: None })
}

fn places(session: &Session) -> Vec<(usize, u32, u32)> {
    session.kept().iter().map(|place| (place.camera, place.frame_set, place.view)).collect()
}

#[test]
fn what_is_new_to_one_camera_is_kept_of_all_that_see_it() {
    let mut session = session(&["left", "right", "far"], None);
    let none = Some(CameraFrame {
        frame: frame(0),
        seen: Err(Rejection::Partial { seen: 40, expected: 54 }),
        depth: None,
    });
    let first = [sees(0, board(0.0, 0.5, 0.0)), sees(0, board(-0.1, 0.5, 0.0)), none];
    let observed = session.observe(&first).unwrap();
    assert_eq!(places(&session), [(0, 0, 0), (1, 0, 0)]);
    assert_eq!(observed.kept, session.kept());
    // New for the left camera only.
    session
        .observe(&[sees(1000, board(0.1, 0.5, 0.5)), sees(1000, board(-0.1, 0.5, 0.0)), None])
        .unwrap();
    // New for no camera.
    session
        .observe(&[sees(2000, board(0.1, 0.5, 0.5)), sees(2000, board(-0.1, 0.5, 0.0)), None])
        .unwrap();
    assert_eq!(places(&session), [(0, 0, 0), (1, 0, 0), (0, 1, 1), (1, 1, 1)]);
    let record = session.record();
    assert_eq!((record.views_kept, record.frames_seen, record.boards_seen), (2, 7, 6));
    assert_eq!(
        record.members.iter().map(|member| member.views_shared).collect::<Vec<_>>(),
        [2, 2, 0]
    );
}

#[test]
fn a_board_that_moved_between_the_images_is_not_shared() {
    let mut session = session(&["left", "right"], None);
    let at = |time_ms: i64, across: f64| {
        [sees(time_ms, board(across, 0.5, 0.0)), sees(time_ms + 15, board(across - 0.1, 0.5, 0.0))]
    };
    // 0.1 mm in 100 ms, and then 2 cm.
    session.observe(&at(0, 0.0)).unwrap();
    assert_eq!(places(&session), [(0, 0, 0), (1, 1, 0)], "how fast it moves is not known yet");
    session.observe(&at(100, 0.0001)).unwrap();
    let shared = [(0, 0, 0), (1, 1, 0), (0, 2, 1), (1, 2, 1)];
    assert_eq!(places(&session), shared, "new to neither, and the first that both share");
    session.observe(&at(200, 0.02)).unwrap();
    session.observe(&at(300, 0.0201)).unwrap();
    assert_eq!(places(&session).len(), 4, "nothing new to what they share");
    session.observe(&[sees(5000, board(0.1, 0.5, 0.5)), sees(5015, board(0.0, 0.5, 0.5))]).unwrap();
    session
        .observe(&[sees(5100, board(0.1, 0.5, -0.5)), sees(5115, board(0.0, 0.5, -0.5))])
        .unwrap();
    assert_eq!(session.record().members[0].views_shared, 1);
}

#[test]
fn too_little_fails_and_says_what_there_is() {
    let mut session = session(&["left", "right"], None);
    session.observe(&[sees(0, board(0.0, 0.5, 0.0)), sees(0, board(-0.1, 0.5, 0.0))]).unwrap();
    let asks = |member: &SessionMember| !member.guidance.message.is_empty();
    assert!(session.record().members.iter().all(asks));
    let actions = session.stop(NOW_NS).unwrap();
    assert_eq!(actions, [Action::Close]);
    let record = session.record();
    assert_eq!(record.state, SessionState::Failed);
    assert!(!record.members.iter().any(asks), "{:?}", record.members);
    assert!(record.reason.as_ref().unwrap().contains("left 1, right 1"), "{:?}", record.reason);
    assert!(session.observe(&[None, None]).is_none());
    assert!(session.stop(NOW_NS).is_err() && session.abort(NOW_NS).is_err());
}

#[test]
fn nothing_is_asked_for_while_it_solves() {
    let mut session = pair_session(None);
    for k in 0..4 {
        let [left, right] = [placement(k), right_from_left() * placement(k)];
        let mut seed = k as u64;
        let frames = [left, right].map(|pose| sees(1000 * k as i64, seen_at(&pose, &mut seed)));
        session.observe(&frames).unwrap();
    }
    session.stop(NOW_NS).unwrap();
    assert_eq!(session.record().state, SessionState::Solving);
    // An estimate that was in progress when the session was stopped.
    perform(&mut session, &[Action::Estimate(0)]);
    let record = session.record();
    let mut guidances = record.members.iter().map(|it| &it.guidance).chain([&record.guidance]);
    assert!(guidances.all(|guidance| *guidance == Guidance::default()), "{record:?}");
    assert!(record.members[0].estimate.is_some());
}

#[test]
fn a_session_goes_on_with_its_stored_views() {
    let mut session = session(&["left", "right"], None);
    for k in 0..4 {
        let across = -0.12 + 0.08 * f64::from(k);
        let time_ms = i64::from(k) * 1000;
        session
            .observe(&[
                sees(time_ms, board(across, 0.5, 0.3)),
                sees(time_ms, board(across - 0.1, 0.5, 0.3)),
            ])
            .unwrap();
    }
    let stored: Vec<(KeptView, View)> =
        session.kept().iter().map(|kept| (*kept, session.view(kept).unwrap().clone())).collect();
    let cameras = ["left".to_owned(), "right".to_owned()];
    let (resumed, actions) =
        Session::resume(session.record().clone(), &cameras, &stored, &AdmissionOptions::default());
    assert_eq!(resumed.kept(), session.kept());
    for kept in session.kept() {
        assert_eq!(resumed.view(kept), session.view(kept));
    }
    assert!(actions.contains(&Action::Estimate(1)));
}

fn right_from_left() -> Pose {
    Pose::from_axis_angle(Vector3::new(0.01, -0.12, 0.02), Vector3::new(-0.1, 0.005, 0.01))
}

fn true_lens() -> Lens {
    Lens::pinhole(CameraMatrix { fx: 576.0, fy: 576.0, cx: 319.5, cy: 239.5, skew: 0.0 })
}

/// The detection of a board by a camera: its corners have errors of up to 0.2 px, with an rms of
/// 0.1 px.
fn seen_at(camera_from_board: &Pose, seed: &mut u64) -> Detection {
    let mut found = detection_at(Vector3::new(0.0, 0.0, 0.5), Vector3::zeros());
    let mut noise = || {
        *seed =
            seed.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        0.35 * ((*seed >> 11) as f64 / (1_u64 << 53) as f64 - 0.5)
    };
    for corner in &mut found.corners {
        let (col, row) = (f64::from(corner.index.col), f64::from(corner.index.row));
        let point = Point3::new(0.025 * col, 0.025 * row, 0.0);
        let pixel = true_lens().pixel_from_point(&(*camera_from_board * point)).unwrap();
        corner.pixel = Pixel::new(pixel.x + noise(), pixel.y + noise());
        corner.std_px = 0.1;
    }
    found
}

/// The `k`-th of many placements.
fn placement(k: usize) -> Pose {
    let part = |at: usize| (0.5 + [0.819, 0.671, 0.550, 0.450, 0.369][at] * (k as f64 + 1.0)) % 1.0;
    let tilt = Vector3::new(part(0) - 0.5, part(1) - 0.5, 0.4 * (part(2) - 0.5)) * 1.3;
    let at = Vector3::new(0.12 * (part(3) - 0.5), 0.1 * (part(4) - 0.5), 0.4 + 0.15 * part(2));
    let rotation = nalgebra::UnitQuaternion::from_scaled_axis(tilt);
    Pose::new(rotation, at - rotation * Vector3::new(0.1, 0.0625, 0.0))
}

/// Performs what a session requests except the solve. Returns whether the solve was requested.
fn perform(session: &mut Session, actions: &[Action]) -> bool {
    let mut open = actions.to_vec();
    let mut solves = false;
    while let Some(action) = open.pop() {
        solves |= action == Action::Solve;
        let Action::Estimate(place) = action else { continue };
        let part = session.camera(place).unwrap();
        let target: crate::geometry::target::Target =
            Chessboard::new(BoardSize::new(9, 6).unwrap(), 0.025).unwrap().into();
        let target = target_as_seen(&target, part.views());
        let views = part.views().iter().map(|view| view.to_board_view(&target)).collect();
        let problem = CameraProblem { image_size: SIZE, views };
        let lens = LensChoice::Model(LensModel::Radial);
        let estimate = estimate_so_far(&problem, &[], lens, part.continuation()).ok();
        open.extend(session.estimated(place, estimate));
    }
    solves
}

fn pair_session(finish: Option<Finish>) -> Session {
    let target = Chessboard::new(BoardSize::new(9, 6).unwrap(), 0.025).unwrap();
    let lens = LensChoice::Model(LensModel::Radial);
    let request = SessionRequest { target: target.into(), lens, finish, given: Vec::new() };
    Session::begin(
        SessionRecord::begin("01", "pair", request, 1_000_000_000),
        &["left".to_owned(), "right".to_owned()],
        &AdmissionOptions::default(),
    )
}

/// Two cameras with a board that is moved in front of them, one frame set each second.
struct Shown {
    session: Session,
    seed: u64,
    time_ms: i64,
    solves: bool,
}

impl Shown {
    /// Thirty views of each camera alone, and three of a board far away that both see, which add
    /// little information about the relative pose of the cameras.
    fn gathered(goal_px: f64) -> Self {
        let finish = Finish { uncertainty_px: Some(goal_px), ..Finish::default() };
        let session = pair_session(Some(finish));
        let mut shown = Self { session, seed: 5, time_ms: 0, solves: false };
        for k in 0..30 {
            shown.show([Some(placement(k)), None]);
            shown.show([None, Some(placement(k + 40))]);
        }
        for k in 0..3 {
            let rotation = nalgebra::UnitQuaternion::from_scaled_axis(Vector3::new(0.3, 0.1, 0.0));
            let at = Vector3::new(0.6 + 0.15 * f64::from(k), 0.0, 3.0);
            let left = Pose::new(rotation, at - rotation * Vector3::new(0.1, 0.0625, 0.0));
            shown.show([Some(left), Some(right_from_left() * left)]);
        }
        shown
    }

    fn show(&mut self, camera_from_board: [Option<Pose>; 2]) {
        self.time_ms += 1000;
        let frames = camera_from_board.map(|pose| {
            let none = Err(Rejection::Partial { seen: 40, expected: 54 });
            let seen = pose.map_or(none, |pose| Ok(seen_at(&pose, &mut self.seed).into()));
            Some(CameraFrame { frame: frame(self.time_ms), seen, depth: None })
        });
        let observed = self.session.observe(&frames).unwrap();
        self.solves |= perform(&mut self.session, &observed.actions);
    }

    /// The uncertainty of the less certain lens, and that of both cameras together.
    fn uncertainty_px(&self) -> [f64; 2] {
        let members = self.session.record().members.iter();
        let medians = members.map(|it| it.estimate.as_ref().unwrap().uncertainty_px.median);
        [medians.fold(0.0, f64::max), self.session.pairs.links[0].information.uncertainty_px()]
    }
}

#[test]
fn cameras_that_know_themselves_are_asked_for_what_both_see_until_they_know_each_other() {
    let [own_px, together_px] = Shown::gathered(1e-6).uncertainty_px();
    eprintln!("each by itself {own_px:.4} px, both together {together_px:.4} px");
    assert!(together_px > 1.3 * own_px, "{own_px}, {together_px}");
    // Between the uncertainty of each camera alone and that of both together.
    let mut shown = Shown::gathered((own_px * together_px).sqrt());
    assert!(!shown.solves);
    assert!(shown.session.record().members.iter().all(|member| member.views_shared >= 3));
    let mut more = 0;
    while !shown.solves {
        let record = shown.session.record();
        let guidance = &record.guidance;
        let asked = "keep the board in view of left and right; in the image of left: ";
        assert!(guidance.message.starts_with(asked), "{}", guidance.message);
        assert!(guidance.views_to_go.is_some_and(|[few, many]| few <= many));
        assert!(guidance.expected_uncertainty_px.is_some_and(|px| px < together_px));
        let [left, right] =
            [0, 1].map(|place| record.members[place].guidance.camera_from_board.unwrap());
        let truth = right_from_left() * left;
        // The same place in front of both, within the uncertainty of their relative pose.
        assert!(truth.angle_to(&right) < 0.05, "{truth:?}, {right:?}");
        assert!((truth.translation() - right.translation()).norm() < 0.1);
        let kept = shown.session.kept().len();
        shown.show([Some(left), Some(truth)]);
        assert_eq!(shown.session.kept().len(), kept + 2, "what is asked for is kept");
        more += 1;
        assert!(more < 40, "{:?}", shown.uncertainty_px());
    }
    eprintln!("{more} shared views more: {:.4} px", shown.uncertainty_px()[1]);
}
