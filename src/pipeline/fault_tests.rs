//! Tests of a panic on each of an instrument's threads: it is reported, the work it hit is aborted,
//! and the camera goes on.

use crate::calibration::session_record::{SessionRecord, SessionState};
use crate::pipeline::camera_status::CameraState;
use crate::pipeline::event::EventKind;
use crate::pipeline::fleet::Fleet;
use crate::pipeline::guarded::faults::InducedFault;
use crate::pipeline::scripted::*;

/// Asserts that the reason why `record` failed or its camera was lost is a panic on `thread`.
fn assert_said(reason: Option<&str>, thread: &str) {
    let said = format!("a fault in plumb itself (a test's fault on {thread}); please report it");
    assert_eq!(reason, Some(said.as_str()));
}

/// Asserts that after the panic a session of camera `name` still collects views and is solved.
async fn assert_goes_on(fleet: &Fleet, name: &str) {
    let mut events = fleet.events(None);
    let id = fleet.start_session(name, request()).await.unwrap().id;
    let has_enough = |record: &SessionRecord| record.id == id && record.views_kept >= 4;
    until_session(&mut events, has_enough).await;
    fleet.stop_session(&id).await.unwrap();
    let over = fleet.session_over(&id).await.unwrap();
    assert!(over.calibration.is_some(), "{:?}", over.reason);
}

#[tokio::test]
async fn a_fault_in_capture_is_a_loss() {
    let folder = tempfile::tempdir().unwrap();
    let fleet = fleet_of(vec![walking("torn")], &folder, PATIENCE);
    let mut events = fleet.events(Some(0));
    until_state(&mut events, "torn", CameraState::Streaming).await;
    let fault = InducedFault::on("capture-torn");
    // An open source is guarded as a whole: it panics when it is opened again.
    let id = fleet.start_session("torn", request()).await.unwrap().id;
    let lost = until_state(&mut events, "torn", CameraState::Lost).await;
    assert_said(lost.reason.as_deref(), "capture-torn");
    drop(fault);
    until_state(&mut events, "torn", CameraState::Streaming).await;
    fleet.abort_session(&id).await.unwrap();
    assert_goes_on(&fleet, "torn").await;
}

#[tokio::test]
async fn a_fault_in_detection_costs_the_frame() {
    let folder = tempfile::tempdir().unwrap();
    let fault = InducedFault::on("detect-blind");
    let fleet = fleet_of(vec![walking("blind")], &folder, PATIENCE);
    // A frame that is dropped is not announced.
    let dropped = async {
        while fleet.camera("blind").unwrap().dropped_frames < 3 {
            tokio::task::yield_now().await;
        }
    };
    tokio::time::timeout(PATIENCE, dropped).await.unwrap();
    let counted = "plumb_frames_dropped_total{camera=\"blind\",why=\"fault\"}";
    assert!(count(&fleet, counted) >= 3);
    drop(fault);
    assert_goes_on(&fleet, "blind").await;
}

#[tokio::test]
async fn a_fault_in_a_solve_fails_its_session() {
    let folder = tempfile::tempdir().unwrap();
    let fleet = fleet_of(vec![walking("dull")], &folder, PATIENCE);
    let mut events = fleet.events(Some(0));
    let fault = InducedFault::on("solve-dull");
    let id = fleet.start_session("dull", request()).await.unwrap().id;
    // Estimates panic too: the session continues without them.
    let kept = until_session(&mut events, |record| record.views_kept >= 4).await;
    assert_eq!(kept.estimate, None);
    fleet.stop_session(&id).await.unwrap();
    let failed = fleet.session_over(&id).await.unwrap();
    assert_eq!(failed.state, SessionState::Failed);
    assert_said(failed.reason.as_deref(), "solve-dull");
    let views = fleet.store().sensor_views(&id).unwrap().len();
    assert_eq!(failed.views_kept as usize, views, "they stay");
    until(&mut events, |event| {
        let EventKind::Session(record) = &event.kind else { return None };
        (record.state == SessionState::Failed && record.reason == failed.reason).then_some(())
    })
    .await;
    drop(fault);
    assert_goes_on(&fleet, "dull").await;
}

#[tokio::test]
async fn a_fault_in_a_session_fails_it() {
    let folder = tempfile::tempdir().unwrap();
    let fleet = fleet_of(vec![walking("lost")], &folder, PATIENCE);
    let mut events = fleet.events(Some(0));
    let id = fleet.start_session("lost", request()).await.unwrap().id;
    until_session(&mut events, |record| record.views_kept >= 1).await;
    let fault = InducedFault::on("session-lost");
    let failed = fleet.session_over(&id).await.unwrap();
    assert_eq!(failed.state, SessionState::Failed);
    assert_said(failed.reason.as_deref(), "session-lost");
    assert_eq!(fleet.camera("lost").unwrap().session, None);
    drop(fault);
    assert_goes_on(&fleet, "lost").await;
}
