//! Tests of which calibration is current and what is reported about it, with scripted sources.

use std::sync::mpsc::Sender;
use std::thread;
use std::time::Duration;

use crate::calibration::result::{
    CalibratedSensor, Calibration, Checks, Grade, ImageCalibration, ProjectionUncertainty, Verdict,
};
use crate::calibration::sensor::SensorId;
use crate::calibration::session_record::{SessionRecord, SessionState};
use crate::geometry::lens::{Lens, LensModel};
use crate::geometry::pixel::ImageSize;
use crate::imaging::frame::SensorKind;
use crate::pipeline::Supervision;
use crate::pipeline::camera_status::CameraState;
use crate::pipeline::event::{EventKind, EventStream};
use crate::pipeline::instrument::RigPlan;
use crate::pipeline::running::Exchange;
use crate::pipeline::scripted::*;
use crate::store::Store;

/// A calibration of `front`, or of a rig that it is in, from images of this width.
fn calibration(name: &str, instrument: &str, width: u32) -> Calibration {
    let mut id = SensorId::own(SensorKind::Color);
    if instrument != "front" {
        id = SensorId::of("front", SensorKind::Color);
    }
    let lens = Lens::from_parameters(LensModel::Pinhole, &[60.0, 60.0, 32.0, 24.0, 0.0]).unwrap();
    let sensor = ImageCalibration {
        image_size: ImageSize::new(width, 48),
        lens,
        lens_std: vec![0.1; 5],
        lens_covariance: Vec::new(),
        rms_px: 0.1,
        uncertainty_px: ProjectionUncertainty::default(),
        views: Vec::new(),
        compared: Vec::new(),
        board_warp_m: None,
        board_shape: None,
        rolling_shutter: None,
        scene: None,
    };
    Calibration {
        id: name.to_owned(),
        camera: Some(instrument.to_owned()),
        session: Some("s1".to_owned()),
        created_at_ns: 1,
        ..Calibration::unnamed(
            None::<crate::geometry::target::Target>,
            vec![CalibratedSensor::image(id, sensor)],
            Checks::default(),
            Verdict { grade: Grade::Good, reasons: Vec::new() },
        )
    }
}

/// The calibration `c1` of `instrument` is current, of a device with the serial number A.
fn calibrated(folder: &tempfile::TempDir, instrument: &str, width: u32) {
    let store = Store::open(folder.path()).unwrap();
    let record = SessionRecord {
        devices: [("front".to_owned(), "serial A".to_owned())].into(),
        state: SessionState::Finished,
        ..SessionRecord::begin("s1", instrument, request(), 0)
    };
    store.begin_session(&record).unwrap();
    store.append_calibration(&calibration("c1", instrument, width)).unwrap();
    store.set_current(instrument, "c1").unwrap();
}

#[tokio::test]
async fn a_focus_that_moves_after_a_session_is_a_drift() {
    let folder = tempfile::tempdir().unwrap();
    calibrated(&folder, "front", 64);
    let (plan, script) = scripted("front");
    let feed = script.plug_in();
    let fleet = fleet_of(vec![plan], &folder, PATIENCE);
    let mut events = fleet.events(Some(0));
    feed.send(ScriptStep::Frame).unwrap();
    until_state(&mut events, "front", CameraState::Streaming).await;
    let id = fleet.start_session("front", request()).await.unwrap().id;
    // The first frame may have been on its way when the session began; the second one belongs to
    // the session.
    (0..2).for_each(|_| feed.send(ScriptStep::Frame).unwrap());
    until(&mut events, |event| (event.kind.name() == "detection").then_some(())).await;
    fleet.abort_session(&id).await.unwrap();
    feed.send(ScriptStep::Move).unwrap();
    (0..3).for_each(|_| feed.send(ScriptStep::Frame).unwrap());
    let drift = until(&mut events, |event| match &event.kind {
        EventKind::Drift(drift) => Some(drift.clone()),
        _ => None,
    })
    .await;
    assert_eq!((drift.calibration.as_str(), drift.reason.as_str()), ("c1", "focus is 30, was 10"));
    assert_eq!(fleet.camera("front").unwrap().reason.as_deref(), Some("focus is 30, was 10"));

    // Another comparison keeps the reason, and does not report it again.
    fleet.approve("c1").unwrap();
    assert_eq!(fleet.camera("front").unwrap().reason.as_deref(), Some("focus is 30, was 10"));
    assert_eq!(drifts_in(&feed, &mut events, &[64; 3]).await, [] as [String; 0]);
    let id = fleet.start_session("front", request()).await.unwrap().id;
    // Whatever was on its way to the session's thread was received before this.
    until(&mut events, |event| match &event.kind {
        EventKind::Drift(drift) => panic!("reported twice: {}", drift.reason),
        EventKind::Session(record) => (record.id == id).then_some(()),
        _ => None,
    })
    .await;
}

/// The drift reported while frames of these widths arrive; each is sent when the one before has
/// been passed on.
async fn drifts_in(
    feed: &Sender<ScriptStep>,
    events: &mut EventStream,
    widths: &[u32],
) -> Vec<String> {
    let mut drifts = Vec::new();
    for width in widths {
        feed.send(ScriptStep::Sized(ImageSize::new(*width, 48))).unwrap();
        until(events, |event| match &event.kind {
            EventKind::Drift(drift) => {
                drifts.push(drift.reason.clone());
                None
            }
            EventKind::Frame(_) => Some(()),
            _ => None,
        })
        .await;
    }
    drifts
}

#[tokio::test]
async fn another_size_in_the_middle_of_a_stream_is_a_drift_until_it_is_back() {
    let folder = tempfile::tempdir().unwrap();
    calibrated(&folder, "front", 64);
    let (plan, script) = scripted("front");
    let feed = script.plug_in_device(Some("A"));
    let fleet = fleet_of(vec![plan], &folder, PATIENCE);
    let mut events = fleet.events(Some(0));
    assert_eq!(drifts_in(&feed, &mut events, &[64, 64]).await, [] as [String; 0]);
    // A frame that could not be read has no size.
    assert_eq!(drifts_in(&feed, &mut events, &[0, 64]).await, [] as [String; 0]);
    let drifts = drifts_in(&feed, &mut events, &[80, 80, 0, 80]).await;
    let said = "color images are now 80x48, but the calibration is for 64x48: ";
    assert!(matches!(drifts.as_slice(), [only] if only.starts_with(said)), "{drifts:?}");
    assert_eq!(fleet.camera("front").unwrap().reason, Some(drifts[0].clone()));
    assert_eq!(drifts_in(&feed, &mut events, &[64, 64]).await, [] as [String; 0]);
    let status = fleet.camera("front").unwrap();
    assert_eq!((status.state, status.reason), (CameraState::Streaming, None));
}

#[tokio::test]
async fn a_folder_of_mixed_sizes_does_not_flood_the_events() {
    let folder = tempfile::tempdir().unwrap();
    calibrated(&folder, "front", 64);
    let (plan, script) = scripted("front");
    let feed = script.plug_in_device(Some("A"));
    let hour = Duration::from_secs(3600);
    let supervision = Supervision { moved_check: hour, ..watched(PATIENCE) };
    let fleet = fleet_supervised(vec![plan], &folder, supervision);
    let mut events = fleet.events(Some(0));
    let drifts = drifts_in(&feed, &mut events, &[64, 80].repeat(20)).await;
    assert_eq!(drifts.len(), 1, "{drifts:?}");
}

#[tokio::test]
async fn a_lost_camera_stays_lost_when_another_calibration_is_current() {
    let folder = tempfile::tempdir().unwrap();
    calibrated(&folder, "front", 80);
    let (plan, script) = scripted("front");
    let feed = script.plug_in_device(Some("A"));
    let fleet = fleet_of(vec![plan], &folder, PATIENCE);
    let mut events = fleet.events(Some(0));
    feed.send(ScriptStep::Frame).unwrap();
    until_state(&mut events, "front", CameraState::Streaming).await;
    feed.send(ScriptStep::Fail(lost("unplugged"))).unwrap();
    until_state(&mut events, "front", CameraState::Lost).await;
    fleet.approve("c1").unwrap();
    let status = fleet.camera("front").unwrap();
    assert_eq!(status.state, CameraState::Lost);
    assert!(status.reason.unwrap().starts_with("camera 7 was lost: "));
}

/// The report about the current calibration, and the camera's reason, when a device with this
/// serial number delivers frames of 64x48.
async fn said_of_calibration(width: u32, serial: &str) -> String {
    let folder = tempfile::tempdir().unwrap();
    calibrated(&folder, "front", width);
    let (plan, script) = scripted("front");
    let feed = script.plug_in_device(Some(serial));
    let fleet = fleet_of(vec![plan], &folder, PATIENCE);
    let mut events = fleet.events(Some(0));
    feed.send(ScriptStep::Frame).unwrap();
    let status = until_state(&mut events, "front", CameraState::Streaming).await;
    let Some(reason) = status.reason else { return String::new() };
    let drift = until(&mut events, |event| match &event.kind {
        EventKind::Drift(drift) => Some(drift.clone()),
        _ => None,
    })
    .await;
    assert_eq!((drift.calibration.as_str(), &drift.reason), ("c1", &reason));
    // The same device again is not reported again, but a device that matches the calibration is.
    feed.send(ScriptStep::Fail(lost("unplugged"))).unwrap();
    until_state(&mut events, "front", CameraState::Lost).await;
    let feed = script.plug_in_device(Some(serial));
    feed.send(ScriptStep::Frame).unwrap();
    let again = until(&mut events, |event| match &event.kind {
        EventKind::Drift(_) => panic!("said twice"),
        EventKind::Camera(status) if status.state == CameraState::Streaming => {
            Some(status.reason.clone())
        }
        _ => None,
    })
    .await;
    assert_eq!(again.as_ref(), Some(&reason));
    feed.send(ScriptStep::Fail(lost("unplugged"))).unwrap();
    until_state(&mut events, "front", CameraState::Lost).await;
    let feed = script.plug_in_device(Some("A"));
    feed.send(ScriptStep::Sized(ImageSize::new(width, 48))).unwrap();
    let right = until(&mut events, |event| match &event.kind {
        EventKind::Drift(drift) => panic!("said of the right one: {}", drift.reason),
        EventKind::Camera(status) if status.state == CameraState::Streaming => {
            Some(status.reason.clone())
        }
        _ => None,
    })
    .await;
    assert_eq!(right, None);
    reason
}

#[tokio::test]
async fn a_calibration_of_other_images_is_said_to_be() {
    assert_eq!(said_of_calibration(64, "A").await, "");
    let reason = said_of_calibration(64, "B").await;
    assert!(reason.starts_with(
        "the device changed from serial A to serial B since the calibration was made: "
    ));
    let reason = said_of_calibration(80, "A").await;
    assert!(reason.starts_with("color images are now 64x48, but the calibration is for 80x48: "));
}

#[tokio::test]
async fn a_rig_s_calibration_of_another_camera_is_said_to_be() {
    let folder = tempfile::tempdir().unwrap();
    calibrated(&folder, "head", 64);
    let (plans, scripts): (Vec<_>, Vec<_>) =
        ["front", "rear"].iter().map(|name| scripted(name)).unzip();
    let fleet = fleet_of(plans, &folder, PATIENCE);
    let mut events = fleet.events(Some(0));
    let feeds: Vec<_> = scripts.iter().map(|script| script.plug_in_device(Some("B"))).collect();
    feeds.iter().for_each(|feed| feed.send(ScriptStep::Frame).unwrap());
    let status = until_state(&mut events, "front", CameraState::Streaming).await;
    assert_eq!(status.reason, None, "it is in no rig");
    let cameras = vec!["front".to_owned(), "rear".to_owned()];
    let rigs = vec![RigPlan { name: "head".to_owned(), cameras }];
    fleet.exchange(Exchange { rigs, ..Exchange::default() }).unwrap();
    let drift = until(&mut events, |event| match &event.kind {
        EventKind::Drift(drift) if event.camera == "head" => Some(drift.clone()),
        _ => None,
    })
    .await;
    let said = "the device changed from serial A to serial B since the calibration of rig `head` was made: ";
    assert!(drift.reason.starts_with(said), "{}", drift.reason);
    assert_eq!(fleet.rig("head").unwrap().reason, Some(drift.reason));
    feeds[0].send(ScriptStep::Fail(lost("unplugged"))).unwrap();
    until_state(&mut events, "front", CameraState::Lost).await;
    let feed = scripts[0].plug_in_device(Some("A"));
    feed.send(ScriptStep::Frame).unwrap();
    until_state(&mut events, "front", CameraState::Streaming).await;
    assert_eq!(fleet.rig("head").unwrap().reason, None);
}

/// Two calibrations that are approved at the same time: the one stored last is the one shown.
#[test]
fn approvals_at_once_leave_what_is_shown_as_it_is_stored() {
    let folder = tempfile::tempdir().unwrap();
    calibrated(&folder, "front", 64);
    let (plan, _script) = scripted("front");
    let fleet = fleet_of(vec![plan], &folder, PATIENCE);
    fleet.store().append_calibration(&calibration("c2", "front", 64)).unwrap();
    for _ in 0..50 {
        thread::scope(|scope| {
            for id in ["c1", "c2"] {
                scope.spawn(|| fleet.approve(id).unwrap());
            }
        });
        let shown = fleet.camera("front").unwrap().calibration;
        assert_eq!(shown, fleet.store().current_calibration_id("front").unwrap());
    }
}
