//! Tests of the fleet with scripted sources: they deliver, stall, disappear, fail, panic or end.

use std::sync::Arc;
use std::sync::mpsc::channel;
use std::time::Duration;

use crate::calibration::session_record::SessionState;
use crate::capture::{CaptureError, FrameSource};
use crate::pipeline::Supervision;
use crate::pipeline::camera_status::CameraState;
use crate::pipeline::event::EventKind;
use crate::pipeline::fleet::Fleet;
use crate::pipeline::running::{CameraPlan, FleetOptions};
use crate::pipeline::scripted::*;
use crate::pipeline::session_request::{EndError, StartError};
use crate::store::Store;

#[tokio::test]
async fn a_session_lives_through_a_loss_and_says_so() {
    let folder = tempfile::tempdir().unwrap();
    let (plan, script) = scripted("front");
    let feed = script.plug_in();
    let fleet = fleet_of(vec![plan], &folder, PATIENCE);
    // A camera's thread and its session's thread publish concurrently: one stream for each.
    let (mut events, mut session_events) = (fleet.events(Some(0)), fleet.events(Some(0)));
    feed.send(ScriptStep::Frame).unwrap();
    until_state(&mut events, "front", CameraState::Streaming).await;
    let id = fleet.start_session("front", request()).await.unwrap().id;

    feed.send(ScriptStep::Fail(lost("unplugged"))).unwrap();
    let status = until_state(&mut events, "front", CameraState::Lost).await;
    assert_eq!(status.reason.as_deref(), Some("camera 7 was lost: unplugged"));
    until_session(&mut session_events, |record| {
        record.reason.as_deref() == Some("waiting for the camera: camera 7 was lost: unplugged")
    })
    .await;

    let feed = script.plug_in();
    feed.send(ScriptStep::Frame).unwrap();
    until_state(&mut events, "front", CameraState::Streaming).await;
    let record = until_session(&mut session_events, |record| record.reason.is_none()).await;
    assert_eq!((record.id, record.state), (id.clone(), SessionState::Collecting));
    let busy = fleet.start_session("front", request()).await.unwrap_err();
    assert_eq!(busy, StartError::Busy { camera: "front".to_owned(), session: id.clone() });
    assert_eq!(fleet.abort_session(&id).await.unwrap().state, SessionState::Aborted);
    assert_eq!(fleet.session_over(&id).await.unwrap().state, SessionState::Aborted);
}

#[tokio::test]
async fn silence_is_a_loss_and_a_panic_too() {
    let folder = tempfile::tempdir().unwrap();
    let (plan, script) = scripted("front");
    let feed = script.plug_in();
    let fleet = fleet_of(vec![plan], &folder, Duration::from_millis(1));
    let mut events = fleet.events(Some(0));
    feed.send(ScriptStep::Frame).unwrap();
    until_state(&mut events, "front", CameraState::Streaming).await;
    let status = until_state(&mut events, "front", CameraState::Lost).await;
    assert_eq!(status.reason.as_deref(), Some("no frame for 0.2 s"));

    let feed = script.plug_in();
    feed.send(ScriptStep::Frame).unwrap();
    feed.send(ScriptStep::Panic).unwrap();
    until_state(&mut events, "front", CameraState::Streaming).await;
    until(&mut events, |event| match &event.kind {
        EventKind::Camera(status) => {
            status.reason.as_ref().filter(|reason| reason.contains("binding broke")).cloned()
        }
        _ => None,
    })
    .await;
    let feed = script.plug_in();
    feed.send(ScriptStep::Frame).unwrap();
    until_state(&mut events, "front", CameraState::Streaming).await;
    assert!(fleet.metrics_text().contains("plumb_camera_opened_total{camera=\"front\"} 3"));
}

#[tokio::test]
async fn what_needs_a_person_is_said_and_tried_again() {
    let folder = tempfile::tempdir().unwrap();
    let (plan, script) = scripted("front");
    let reason = "no permission; join the group `video`";
    script.openings.send(Err(CaptureError::Failed { reason: reason.to_owned() })).unwrap();
    let fleet = fleet_of(vec![plan], &folder, PATIENCE);
    let mut events = fleet.events(Some(0));
    let status = until_state(&mut events, "front", CameraState::Failed).await;
    assert_eq!(status.reason.as_deref(), Some(reason));
    assert!(!fleet.is_ready());
    let feed = script.plug_in();
    feed.send(ScriptStep::Frame).unwrap();
    until_state(&mut events, "front", CameraState::Streaming).await;
    assert!(fleet.is_ready());
}

#[tokio::test]
async fn two_cameras_never_hold_each_other_up() {
    let folder = tempfile::tempdir().unwrap();
    let (release, blocked) = channel::<()>();
    let stuck = move || {
        // A driver that does not return.
        let _ = blocked.recv();
        Err(lost("gone"))
    };
    let stuck = CameraPlan {
        name: "stuck".to_owned(),
        kind: "v4l2".to_owned(),
        image_source: "camera 7".to_owned(),
        open: Box::new(stuck),
        may_stall: true,
    };
    let (plan, script) = scripted("front");
    let feed = script.plug_in();
    let fleet = fleet_of(vec![stuck, plan], &folder, PATIENCE);
    let mut events = fleet.events(Some(0));
    for _ in 0..100 {
        feed.send(ScriptStep::Frame).unwrap();
        until_frame(&mut events, "front").await;
    }
    assert_eq!(fleet.camera("stuck").unwrap().state, CameraState::Starting);
    assert_eq!(fleet.camera("front").unwrap().frames, 100);
    let id = fleet.start_session("stuck", request()).await.unwrap().id;
    let failed = fleet.stop_session(&id).await.unwrap();
    assert_eq!(
        failed.state,
        SessionState::Failed,
        "a session can be stopped while its camera hangs"
    );
    drop(release);
}

#[tokio::test]
async fn a_driver_that_does_not_let_go_is_said_and_the_camera_comes_back() {
    let folder = tempfile::tempdir().unwrap();
    let (plan, script) = scripted("front");
    let feed = script.plug_in();
    let supervision = Supervision { closing: Duration::ZERO, ..watched(PATIENCE) };
    let fleet = fleet_supervised(vec![plan], &folder, supervision);
    let mut events = fleet.events(Some(0));
    let (release, held) = channel();
    feed.send(ScriptStep::Hold(held)).unwrap();
    feed.send(ScriptStep::Frame).unwrap();
    until_state(&mut events, "front", CameraState::Streaming).await;
    feed.send(ScriptStep::Fail(lost("unplugged"))).unwrap();
    let status = until_state(&mut events, "front", CameraState::Lost).await;
    assert_eq!(status.reason.as_deref(), Some("camera 7 was lost: unplugged"), "at once");
    let advice = "; its driver does not release it: unplug it and plug it in again";
    for problem in ["unplugged", "not plugged in"] {
        let said = format!("camera 7 was lost: {problem}{advice}");
        until(&mut events, |event| match &event.kind {
            EventKind::Camera(status) => (status.reason.as_ref() == Some(&said)).then_some(()),
            _ => None,
        })
        .await;
    }
    // When it is plugged in again, the system treats it as another device, whatever the driver
    // does.
    let feed = script.plug_in();
    feed.send(ScriptStep::Frame).unwrap();
    until_state(&mut events, "front", CameraState::Streaming).await;
    drop(release);
    feed.send(ScriptStep::Fail(lost("unplugged"))).unwrap();
    until(&mut events, |event| match &event.kind {
        EventKind::Camera(status) => {
            (status.reason.as_deref() == Some("camera 7 was lost: not plugged in")).then_some(())
        }
        _ => None,
    })
    .await;
}

/// A replay of `frames` frames that waits for each to be searched.
fn replay(frames: u64) -> CameraPlan {
    let open = move || {
        let (feed, steps) = channel();
        (0..frames).for_each(|_| feed.send(ScriptStep::Frame).unwrap());
        Ok(Box::new(Scripted {
            steps,
            sequence: 0,
            waits: true,
            moved: false,
            held: None,
            serial: None,
        }) as Box<dyn FrameSource>)
    };
    CameraPlan {
        name: "front".to_owned(),
        kind: "recording".to_owned(),
        image_source: "camera 7".to_owned(),
        open: Box::new(open),
        may_stall: false,
    }
}

#[tokio::test]
async fn every_session_sees_the_whole_of_a_replay() {
    let folder = tempfile::tempdir().unwrap();
    let fleet = fleet_of(vec![replay(500)], &folder, PATIENCE);
    let mut events = fleet.events(Some(0));
    for _ in 0..3 {
        let id = fleet.start_session("front", request()).await.unwrap().id;
        let record = until_session(&mut events, |record| {
            record.id == id
                && record.reason.as_ref().is_some_and(|reason| reason.contains("has ended"))
        })
        .await;
        assert_eq!((record.frames_seen, record.state), (500, SessionState::Collecting));
        fleet.abort_session(&id).await.unwrap();
    }
}

#[tokio::test]
async fn an_unfinished_session_goes_on_under_its_id() {
    let folder = tempfile::tempdir().unwrap();
    let fleet = fleet_of(vec![replay(10)], &folder, PATIENCE);
    let id = fleet.start_session("front", request()).await.unwrap().id;
    drop(fleet);
    let fleet = fleet_of(vec![replay(10)], &folder, PATIENCE);
    assert_eq!(fleet.live_session(&id).unwrap().state, SessionState::Collecting);
    let mut events = fleet.events(Some(0));
    until_session(&mut events, |record| record.id == id && record.frames_seen >= 10).await;
    let unknown = fleet.stop_session("other").await.unwrap_err();
    assert_eq!(
        unknown.to_string(),
        "there is no session `other`; see GET /v1/sessions for those there are"
    );
}

/// SQLite reports that the disk is full: the session pauses and reports this everywhere, and
/// nothing that was announced is missing; once there is room, it resumes by itself.
#[tokio::test]
async fn a_session_pauses_while_it_cannot_be_stored_and_goes_on_by_itself() {
    let folder = tempfile::tempdir().unwrap();
    let store = Arc::new(Store::open(folder.path()).unwrap());
    let fleet =
        Fleet::start(vec![walking("front")], Arc::clone(&store), &FleetOptions::default()).unwrap();
    let mut events = fleet.events(Some(0));
    let id = fleet.start_session("front", request()).await.unwrap().id;
    until_session(&mut events, |record| record.views_kept >= 1).await;
    store.limit_growth(Some(2));
    let paused = until_session(&mut events, |record| record.reason.is_some()).await;
    let reason = paused.reason.clone().unwrap();
    assert!(reason.starts_with("paused: store ") && reason.contains("full"), "{reason}");
    assert_eq!(paused.state, SessionState::Collecting);
    let stored = store.sensor_views(&id).unwrap().len();
    assert_eq!(paused.views_kept as usize, stored, "what was announced is stored");
    assert_eq!(fleet.live_session(&id).unwrap().views_kept, paused.views_kept);
    assert!(!fleet.is_ready() && fleet.paused()[0].starts_with("front is paused: "));
    assert_eq!(count(&fleet, "plumb_sessions_paused"), 1);
    let refused = fleet.stop_session(&id).await.unwrap_err();
    assert!(matches!(refused, EndError::Store { .. }), "{refused}");

    store.limit_growth(None);
    let views = paused.views_kept + 2;
    let record = until_session(&mut events, |record| record.views_kept >= views).await;
    assert_eq!((record.reason, count(&fleet, "plumb_sessions_paused")), (None, 0));
    assert!(fleet.paused().is_empty());
    fleet.abort_session(&id).await.unwrap();
    let kept = fleet.live_session(&id).unwrap().views_kept as usize;
    let numbers: Vec<u32> =
        store.sensor_views(&id).unwrap().iter().filter_map(|view| view.number).collect();
    assert_eq!(numbers, (0..kept as u32).collect::<Vec<_>>(), "none is lost, none twice");
}

#[tokio::test]
async fn a_session_never_mixes_two_devices() {
    let folder = tempfile::tempdir().unwrap();
    let (plan, script) = scripted("front");
    let mut feed = script.plug_in_device(Some("A"));
    let fleet = fleet_of(vec![plan], &folder, PATIENCE);
    let mut events = fleet.events(Some(0));
    feed.send(ScriptStep::Frame).unwrap();
    until_state(&mut events, "front", CameraState::Streaming).await;
    let id = fleet.start_session("front", request()).await.unwrap().id;
    for serial in ["A", "B"] {
        feed.send(ScriptStep::Fail(lost("unplugged"))).unwrap();
        until_state(&mut events, "front", CameraState::Lost).await;
        feed = script.plug_in_device(Some(serial));
        feed.send(ScriptStep::Frame).unwrap();
        if serial == "A" {
            until_state(&mut events, "front", CameraState::Streaming).await;
            assert_eq!(fleet.live_session(&id).unwrap().state, SessionState::Collecting);
        }
    }
    let over = fleet.session_over(&id).await.unwrap();
    assert_eq!(over.state, SessionState::Aborted);
    assert_eq!(
        over.reason.as_deref(),
        Some(
            "the device of camera `front` changed from serial A to serial B, and a session never mixes views of both; its views are kept: start a new session"
        )
    );
}
