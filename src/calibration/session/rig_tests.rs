//! A rig's session against seeded frame sets: what is kept together, what is not, how it ends.

use nalgebra::Vector3;

use super::*;
use crate::calibration::placement::tests::{SIZE, detection_at};
use crate::calibration::session_record::{Finish, SessionRequest};
use crate::estimation::problem::LensChoice;
use crate::geometry::board::{BoardSize, Chessboard};

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
    Some(CameraFrame { frame: frame(time_ms), seen: Ok(detection.into()) })
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
    });
    let first = [sees(0, board(0.0, 0.5, 0.0)), sees(0, board(-0.1, 0.5, 0.0)), none];
    let observed = session.observe(&first).unwrap();
    assert_eq!(places(&session), [(0, 0, 0), (1, 0, 0)]);
    assert_eq!(observed.kept, session.kept());
    // New to the left camera alone.
    session
        .observe(&[sees(1000, board(0.1, 0.5, 0.5)), sees(1000, board(-0.1, 0.5, 0.0)), None])
        .unwrap();
    // New to none.
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
    let actions = session.stop(NOW_NS).unwrap();
    assert_eq!(actions, [Action::Close]);
    let record = session.record();
    assert_eq!(record.state, SessionState::Failed);
    assert!(record.reason.as_ref().unwrap().contains("left 1, right 1"), "{:?}", record.reason);
    assert!(session.observe(&[None, None]).is_none());
    assert!(session.stop(NOW_NS).is_err() && session.abort(NOW_NS).is_err());
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
