//! Tests of the session with seeded frames: which views it keeps and rejects, and when it ends.

use nalgebra::{Point3, Vector3};

use super::*;
use crate::calibration::placement::tests::{SIZE, detection_at};
use crate::calibration::result::ProjectionUncertainty;
use crate::calibration::session_record::{Finish, RunningEstimate, SessionRequest};
use crate::detection::board_detection::NoBoard;
use crate::estimation::problem::LensChoice;
use crate::geometry::board::{BoardSize, Chessboard};
use crate::geometry::camera_matrix::CameraMatrix;
use crate::geometry::lens::Lens;
use crate::geometry::pixel::ImageSize;

const NOW_NS: i64 = 9_000_000_000;

fn session(finish: Option<Finish>) -> Session {
    let target = Chessboard::new(BoardSize::new(9, 6).unwrap(), 0.025).unwrap();
    let request =
        SessionRequest { target: target.into(), lens: LensChoice::Auto, finish, given: Vec::new() };
    Session::begin(
        SessionRecord::begin("01", "front", request, 1_000_000_000),
        &[],
        &AdmissionOptions::default(),
    )
}

/// The `n`-th frame of a camera that takes one a second.
fn frame(n: u64) -> FrameFacts {
    FrameFacts {
        sequence: n,
        name: None,
        host_time_ns: 1_000_000_000 + n as i64 * 1_000_000_000,
        device_time_ns: None,
        image_size: SIZE,
    }
}

/// Twelve placements that differ by more than a step.
fn placements() -> Vec<Detection> {
    let tilts = [[0.0, 0.0], [0.5, 0.0], [-0.5, 0.0], [0.0, 0.5]];
    let at = |x: f64, tilt: [f64; 2]| {
        detection_at(Vector3::new(x, 0.02, 0.5), Vector3::new(tilt[0], tilt[1], 0.0))
    };
    [-0.12, 0.0, 0.12].iter().flat_map(|x| tilts.map(|tilt| at(*x, tilt))).collect()
}

fn estimate_of(views: u32, median: f64) -> Option<EstimateSoFar> {
    let lens =
        Lens::pinhole(CameraMatrix { fx: 576.0, fy: 576.0, cx: 319.5, cy: 239.5, skew: 0.0 });
    let uncertainty_px =
        ProjectionUncertainty { center: median / 2.0, median, worst: 3.0 * median };
    let running =
        RunningEstimate { lens, rms_px: 0.1, uncertainty_px, uncertainty_map: None, views };
    Some(EstimateSoFar { running, continuation: None, model_holds: true })
}

/// The decision on a frame.
fn admitted(
    session: &mut Session,
    frame: &FrameFacts,
    seen: Result<&Detection, Rejection>,
) -> Result<u32, Rejection> {
    let observed = session.observe_frame(frame.clone(), seen.cloned()).unwrap();
    observed.admissions[0].clone().unwrap()
}

/// A session's views as they are stored.
fn stored(session: &Session) -> Vec<(KeptView, View)> {
    session.kept().iter().map(|kept| (*kept, session.view(kept).unwrap().clone())).collect()
}

/// A board that moves in `steps` from its last placement to the suggested view.
fn carried_to_the_suggested_view(session: &Session, steps: u32) -> Vec<Detection> {
    let there = session.record().guidance.camera_from_board.unwrap();
    let middle = (there * Point3::new(0.1, 0.0625, 0.0)).coords;
    let (here, rotation) = (Vector3::new(0.12, 0.02, 0.5), there.rotation().scaled_axis());
    let at = |step| {
        let part = f64::from(step) / f64::from(steps);
        detection_at(here + (middle - here) * part, rotation * part)
    };
    (0..=steps).map(at).collect()
}

/// Observes `detections` as frames from `first` on. Returns the actions of all.
fn feed(session: &mut Session, first: u64, detections: &[Detection]) -> Vec<Action> {
    let observed = |(k, detection): (usize, &Detection)| {
        session.observe_frame(frame(first + k as u64), Ok(detection.clone())).unwrap()
    };
    detections.iter().enumerate().map(observed).flat_map(|observed| observed.actions).collect()
}

#[test]
fn new_placements_are_kept_and_known_ones_named() {
    let mut session = session(None);
    let detections = placements();
    for (n, detection) in detections.iter().enumerate() {
        let observed = session.observe_frame(frame(n as u64), Ok(detection.clone())).unwrap();
        let number = n as u32;
        assert_eq!(observed.admissions, [Some(Ok(number))]);
        let kept = KeptView { number, camera: 0, frame_set: number, view: number };
        assert_eq!(observed.kept, [kept]);
    }
    let again = admitted(&mut session, &frame(20), Ok(&detections[5]));
    assert_eq!(again, Err(Rejection::TooSimilar { view: 5 }));
    let record = session.record();
    assert_eq!((record.frames_seen, record.boards_seen, record.views_kept), (13, 13, 12));
    assert_eq!(record.rejected.of("too_similar"), 1);
    assert!(record.coverage.fraction() > 0.3);
}

#[test]
fn each_reason_is_counted_and_reported() {
    let mut session = session(None);
    let still = detection_at(Vector3::new(0.0, 0.0, 0.5), Vector3::zeros());
    let moved = detection_at(Vector3::new(0.02, 0.0, 0.5), Vector3::zeros());
    let blurred = Detection { blur_px: 3.0, ..still.clone() };
    let soon = FrameFacts { host_time_ns: frame(1).host_time_ns + 20_000_000, ..frame(2) };
    let other_size = FrameFacts { image_size: ImageSize::new(1280, 960), ..frame(9) };
    let no_board = || Err(Rejection::NoBoard(NoBoard::NoCorners));
    let unreadable = || Err(Rejection::Unreadable { detail: "cut short".to_owned() });
    let steps: [(&FrameFacts, Result<&Detection, Rejection>, Option<&str>); 7] = [
        (&frame(0), no_board(), Some("no_corners")),
        (&frame(1), Ok(&still), None),
        (&soon, Ok(&moved), Some("moving")),
        (&frame(4), Ok(&moved), Some("too_similar")),
        (&frame(5), Ok(&blurred), Some("blurred")),
        (&frame(6), unreadable(), Some("unreadable")),
        (&other_size, Ok(&still), Some("other_image_size")),
    ];
    for (frame, seen, expected) in steps {
        let admission = admitted(&mut session, frame, seen);
        assert_eq!(admission.as_ref().err().map(Rejection::kind), expected, "{admission:?}");
    }
    assert_eq!(session.record().rejected.total(), 6);
}

#[test]
fn a_pile_of_photographs_has_no_motion() {
    let mut session = session(None);
    let still = detection_at(Vector3::new(0.0, 0.0, 0.5), Vector3::zeros());
    let moved = detection_at(Vector3::new(0.1, 0.0, 0.5), Vector3::zeros());
    let named = |n: u64| FrameFacts {
        name: Some(format!("{n}.png")),
        host_time_ns: frame(0).host_time_ns + n as i64 * 10_000_000,
        ..frame(n)
    };
    assert_eq!(admitted(&mut session, &named(0), Ok(&still)), Ok(0));
    assert_eq!(admitted(&mut session, &named(1), Ok(&moved)), Ok(1));
}

#[test]
fn one_estimate_at_a_time_and_the_newest_views_at_the_end() {
    let mut session = session(None);
    let detections = placements();
    let requested = |actions: &[Action]| {
        actions.iter().filter(|action| **action == Action::Estimate(0)).count()
    };
    assert_eq!(
        requested(&feed(&mut session, 0, &detections[..6])),
        1,
        "the third view asks, the others wait"
    );
    assert_eq!(session.estimated(0, estimate_of(3, 0.5)), [Action::Announce, Action::Estimate(0)]);
    assert_eq!(session.estimated(0, estimate_of(6, 0.4)), [Action::Announce]);
    assert!(!session.camera(0).unwrap().is_estimating());
    assert_eq!(requested(&feed(&mut session, 6, &detections[6..7])), 1);
    session.estimated(0, None);
    assert_eq!(
        session.record().estimate.as_ref().unwrap().views,
        6,
        "a failed estimate leaves the one before"
    );
}

#[test]
fn goals_end_it() {
    let goal = Finish { uncertainty_px: Some(0.2), min_views: Some(5), max_seconds: None };
    let mut session = session(Some(goal));
    feed(&mut session, 0, &placements()[..5]);
    assert_eq!(
        session.estimated(0, estimate_of(3, 0.1)),
        [Action::Announce, Action::Estimate(0)],
        "of too few views"
    );
    assert_eq!(session.estimated(0, estimate_of(5, 0.3)), [Action::Announce], "not sure enough");
    feed(&mut session, 5, &placements()[5..6]);
    assert_eq!(
        session.estimated(0, estimate_of(6, 0.2)),
        [Action::Announce, Action::Announce, Action::Solve]
    );
    assert_eq!(
        session.observe_frame(frame(9), Ok(placements()[9].clone())),
        None,
        "takes no more frames"
    );
    assert_eq!(session.stop(NOW_NS), Ok(Vec::new()), "it solves already");
    assert_eq!(session.solved("c", NOW_NS), [Action::Close]);
    let record = session.record();
    assert_eq!((record.state, record.finished_at_ns), (SessionState::Finished, Some(NOW_NS)));
    assert_eq!(session.stop(NOW_NS), Err(SessionOver { state: SessionState::Finished }));
}

#[test]
fn a_number_of_views_alone_is_a_goal() {
    let mut session = session(Some(Finish { min_views: Some(4), ..Finish::default() }));
    assert!(!feed(&mut session, 0, &placements()[..3]).contains(&Action::Solve));
    assert!(feed(&mut session, 3, &placements()[3..4]).contains(&Action::Solve));
}

#[test]
fn time_is_that_of_the_frames_and_ends_it() {
    let finish = Some(Finish { max_seconds: Some(10.0), ..Finish::default() });
    let mut enough = session(finish);
    assert!(!feed(&mut enough, 0, &placements()[..10]).contains(&Action::Solve));
    assert_eq!(enough.record().collecting_s, 9.0);
    assert!(feed(&mut enough, 10, &placements()[10..11]).contains(&Action::Solve));

    let mut starved = session(finish);
    assert_eq!(starved.waited(9.9), []);
    assert_eq!(starved.waited(0.2), [Action::Close]);
    assert_eq!(starved.record().state, SessionState::Failed);
    assert!(
        starved
            .record()
            .reason
            .as_ref()
            .unwrap()
            .starts_with("the time is up: views kept: 0; at least 3")
    );

    let mut lost = session(finish);
    lost.camera_lost(0, "camera 7 was lost: unplugged");
    assert_eq!(lost.waited(10.1), [Action::Close]);
    let reason = lost.record().reason.clone().unwrap();
    let waits =
        "the time is up: still waiting for the camera: camera 7 was lost: unplugged; views kept: 0";
    assert!(reason.starts_with(waits), "{reason}");
}

#[test]
fn too_few_views_fail_and_stay() {
    let mut session = session(None);
    feed(&mut session, 0, &placements()[..2]);
    assert_eq!(session.stop(NOW_NS), Ok(vec![Action::Close]));
    assert_eq!((session.record().state, session.kept().len()), (SessionState::Failed, 2));
    assert!(
        session.record().reason.as_ref().unwrap().contains("views kept: 2; at least 3 are needed")
    );
}

#[test]
fn images_that_change_size_are_the_reason() {
    let mut session = session(None);
    feed(&mut session, 0, &placements()[..1]);
    let still = detection_at(Vector3::new(0.0, 0.0, 0.5), Vector3::zeros());
    for n in 1..3 {
        let other_size = FrameFacts { image_size: ImageSize::new(1280, 960), ..frame(n) };
        let admission = admitted(&mut session, &other_size, Ok(&still));
        assert_eq!(admission.unwrap_err().kind(), "other_image_size");
    }
    session.stop(NOW_NS).unwrap();
    let reason = session.record().reason.clone().unwrap();
    assert!(reason.starts_with("views kept: 1; at least 3 are needed; "), "{reason}");
    assert!(reason.ends_with("keep the camera at one size and start again"), "{reason}");
}

#[test]
fn an_aborted_solve_changes_nothing_any_more() {
    let mut session = session(None);
    feed(&mut session, 0, &placements());
    assert_eq!(session.stop(NOW_NS), Ok(vec![Action::Announce, Action::Solve]));
    assert_eq!(session.abort(NOW_NS), Ok(vec![Action::Close]));
    assert_eq!(session.solved("c", NOW_NS), []);
    assert_eq!(
        (session.record().state, &session.record().calibration),
        (SessionState::Aborted, &None)
    );
    assert_eq!(session.abort(NOW_NS), Err(SessionOver { state: SessionState::Aborted }));
}

#[test]
fn a_fault_ends_it_while_it_collects_or_solves() {
    for solves in [false, true] {
        let mut session = session(None);
        feed(&mut session, 0, &placements());
        let kept = session.record().views_kept;
        if solves {
            session.stop(NOW_NS).unwrap();
        }
        assert_eq!(session.fail("a fault", NOW_NS), [Action::Close]);
        let record = session.record();
        assert_eq!((record.state, record.views_kept), (SessionState::Failed, kept));
        assert_eq!(record.reason.as_deref(), Some("a fault"));
        assert_eq!(session.fail("another", NOW_NS), [], "it is over");
    }
}

#[test]
fn a_loss_is_waited_through_and_said() {
    let mut session = session(None);
    feed(&mut session, 0, &placements()[..4]);
    assert_eq!(session.camera_lost(0, "unplugged"), [Action::Announce]);
    assert_eq!(session.camera_lost(0, "unplugged"), [], "said once");
    assert_eq!(session.record().reason.as_deref(), Some("waiting for the camera: unplugged"));
    assert_eq!(session.camera_back(), [Action::Announce]);
    assert_eq!(session.record().reason, None);
    feed(&mut session, 100, &placements()[4..5]);
    assert_eq!(
        (session.record().views_kept, session.record().collecting_s),
        (5, 3.0),
        "the gap is not counted"
    );
}

#[test]
fn the_end_of_a_recording_ends_only_what_ends_by_itself() {
    let mut until_stopped = session(None);
    feed(&mut until_stopped, 0, &placements());
    assert_eq!(until_stopped.source_ended("the recording has ended", NOW_NS), [Action::Announce]);
    assert_eq!(until_stopped.record().state, SessionState::Collecting);
    let mut with_goal = session(Some(Finish { uncertainty_px: Some(1e-9), ..Finish::default() }));
    feed(&mut with_goal, 0, &placements());
    assert!(with_goal.source_ended("the recording has ended", NOW_NS).contains(&Action::Solve));
}

#[test]
fn a_resumed_session_is_the_one_that_was() {
    let mut before = session(None);
    feed(&mut before, 0, &placements()[..7]);
    let (mut after, actions) = Session::resume(
        before.record().clone(),
        &[],
        &stored(&before),
        &AdmissionOptions::default(),
    );
    assert_eq!(actions, [Action::Announce, Action::Estimate(0)]);
    assert_eq!((after.record(), stored(&after)), (before.record(), stored(&before)));
    let again = admitted(&mut after, &frame(7), Ok(&placements()[3]));
    assert_eq!(again, Err(Rejection::TooSimilar { view: 3 }));
    assert_eq!(admitted(&mut after, &frame(8), Ok(&placements()[7])), Ok(7));

    after.stop(NOW_NS).unwrap();
    let (_, actions) =
        Session::resume(after.record().clone(), &[], &stored(&after), &AdmissionOptions::default());
    assert_eq!(actions, [Action::Announce, Action::Solve]);
}

#[test]
fn the_operator_learns_what_lasts_and_not_what_flickers() {
    let mut session = session(None);
    let no_board = || Err::<Detection, _>(Rejection::NoBoard(NoBoard::NoCorners));
    let message = |session: &Session| session.record().guidance.message.clone();
    feed(&mut session, 0, &placements()[..1]);
    let suggestion = message(&session);
    (1..4).for_each(|n| {
        session.observe_frame(frame(n), no_board());
    });
    assert_eq!(message(&session), suggestion);
    let actions = session.observe_frame(frame(4), no_board()).unwrap().actions;
    assert_eq!(
        (message(&session).as_str(), actions),
        ("show the board to the camera", vec![Action::Announce])
    );
    assert_eq!(session.observe_frame(frame(5), no_board()).unwrap().actions, [], "nothing new");
}

#[test]
fn a_full_session_exchanges_its_least_informative_view() {
    let target = Chessboard::new(BoardSize::new(9, 6).unwrap(), 0.025).unwrap();
    let (lens, given) = (LensChoice::Auto, Vec::new());
    let request = SessionRequest { target: target.into(), lens, finish: None, given };
    let options = AdmissionOptions { view_limit: 6, ..AdmissionOptions::default() };
    let record = SessionRecord::begin("01", "front", request, 1_000_000_000);
    let mut session = Session::begin(record, &[], &options);
    // Five placements that hardly differ and a tilted one, and then other tilts.
    let across = |k: u32| Vector3::new(-0.1 + 0.05 * f64::from(k), 0.02, 0.5);
    let mut shown: Vec<Detection> =
        (0..5).map(|k| detection_at(across(k), Vector3::new(0.4, 0.0, 0.0))).collect();
    shown.push(detection_at(across(2), Vector3::new(-0.4, 0.3, 0.0)));
    feed(&mut session, 0, &shown);
    assert_eq!(session.record().views_kept, 6);
    let tilted = detection_at(across(1), Vector3::new(0.0, -0.6, 0.0));
    let admitted = admitted(&mut session, &frame(20), Ok(&tilted)).unwrap();
    assert!(admitted < 5, "view {admitted} went");
    assert_eq!((session.record().views_kept, session.kept().len()), (6, 6));
    let newest = session.kept().last().unwrap();
    assert_eq!((newest.number, newest.view), (6, admitted));
    assert_eq!(session.view(newest).unwrap().detection, tilted);
}

#[test]
fn what_is_asked_for_has_a_place_a_worth_and_views_to_go() {
    let goal = Finish { uncertainty_px: Some(1e-9), ..Finish::default() };
    let mut session = session(Some(goal));
    feed(&mut session, 0, &placements()[..1]);
    let guidance = session.record().guidance.clone();
    assert!(guidance.camera_from_board.is_some() && guidance.outline_px.len() == 4);
    assert!(guidance.expected_uncertainty_px.is_some_and(f64::is_finite));
    let [few, many] = guidance.views_to_go.unwrap();
    assert!(0 < few && few <= many);
    feed(&mut session, 1, &placements()[1..10]);
    let message = &session.record().guidance.message;
    assert!(message.contains("out of reach"), "{message}");
}

#[test]
fn a_board_on_its_way_to_the_suggested_view_is_waited_for() {
    let mut session = session(None);
    feed(&mut session, 0, &placements());
    let way = carried_to_the_suggested_view(&session, 40);
    let on_the_way = |k: usize| FrameFacts {
        host_time_ns: frame(13).host_time_ns + k as i64 * 30_000_000,
        ..frame(13 + k as u64)
    };
    // If the board is not on its way there, the same view is kept.
    let mut shown_at_once = session.clone();
    assert!(admitted(&mut shown_at_once, &on_the_way(0), Ok(&way[30])).is_ok());

    let admissions: Vec<_> = way
        .iter()
        .enumerate()
        .map(|(k, board)| admitted(&mut session, &on_the_way(k), Ok(board)))
        .collect();
    assert!(admissions[1..36].iter().all(Result::is_err), "{admissions:?}");
    let waited = |admission: &Result<u32, Rejection>| matches!(admission, Err(Rejection::LittleInformation { gain, needed }) if gain < needed);
    assert!(admissions.iter().filter(|it| waited(it)).count() > 5, "{admissions:?}");
    let arrived = (41..44).map(|k| admitted(&mut session, &on_the_way(k), Ok(&way[40])));
    assert!(admissions[36..].iter().cloned().chain(arrived).any(|it| it.is_ok()));
}
