//! Tests with more frames than can be searched, and with a rig whose cameras deliver at different
//! rates.

use std::sync::Arc;
use std::sync::mpsc::{Receiver, Sender, channel};
use std::time::{Duration, Instant};

use crate::calibration::session_record::{SessionRecord, SessionState};
use crate::capture::{CaptureError, FrameSource, SourceDescription};
use crate::geometry::pixel::ImageSize;
use crate::imaging::frame::{Frame, FrameSet, PixelFormat, SensorKind};
use crate::pipeline::camera_status::CameraState;
use crate::pipeline::event::{EventKind, EventStream};
use crate::pipeline::fleet::Fleet;
use crate::pipeline::instrument::RigPlan;
use crate::pipeline::running::{CameraPlan, Exchange};
use crate::pipeline::scripted::*;
use crate::pipeline::session_request::StartError;

/// A fleet of scripted cameras that are one rig, `head`, with the script of each.
fn rig_of(names: &[&str], folder: &tempfile::TempDir) -> (Fleet, Vec<Script>) {
    let (plans, scripts): (Vec<_>, Vec<_>) = names.iter().map(|name| scripted(name)).unzip();
    let fleet = fleet_of(plans, folder, PATIENCE);
    let cameras = names.iter().map(|name| (*name).to_owned()).collect();
    let rigs = vec![RigPlan { name: "head".to_owned(), cameras }];
    fleet.exchange(Exchange { rigs, ..Exchange::default() }).unwrap();
    (fleet, scripts)
}

/// Waits until each of these cameras has shown its frame of this sequence number.
async fn until_frames(events: &mut EventStream, wanted: &[(&str, u64)]) {
    let mut open = wanted.to_vec();
    until(events, |event| {
        if let EventKind::Frame(frame) = &event.kind {
            open.retain(|wanted| *wanted != (event.camera.as_str(), frame.sequence));
        }
        open.is_empty().then_some(())
    })
    .await;
}

/// One camera of a rig delivers every third frame, then none, then it is unplugged: the session
/// goes on with the frames of the others, reports what it waits for, and ends on request.
#[tokio::test]
async fn a_rig_goes_on_without_the_camera_that_does_not() {
    const COMPLETE: &str = "plumb_rig_frame_sets_total{complete=\"true\",rig=\"head\"}";
    const INCOMPLETE: &str = "plumb_rig_frame_sets_total{complete=\"false\",rig=\"head\"}";
    let folder = tempfile::tempdir().unwrap();
    let (fleet, scripts) = rig_of(&["left", "right"], &folder);
    let feeds: Vec<Sender<ScriptStep>> = scripts.iter().map(Script::plug_in).collect();
    let mut events = fleet.events(Some(0));
    for (feed, name) in feeds.iter().zip(["left", "right"]) {
        feed.send(ScriptStep::At(0)).unwrap();
        until_state(&mut fleet.events(Some(0)), name, CameraState::Streaming).await;
    }
    let id = fleet.start_rig_session("head", request()).await.unwrap().id;
    let busy = fleet.start_session("right", request()).await.unwrap_err();
    assert_eq!(busy, StartError::Busy { camera: "right".to_owned(), session: id.clone() });
    // A frame that was requested before the session began belongs to no session.
    feeds.iter().for_each(|feed| feed.send(ScriptStep::At(1)).unwrap());
    until_frames(&mut events, &[("left", 1), ("right", 1)]).await;
    let seen = |record: &SessionRecord, place: usize| record.members[place].frames_seen;
    for k in 1..=30 {
        feeds[0].send(ScriptStep::At(100 * k)).unwrap();
        let mut sent = vec![("left", 1 + k as u64)];
        if k % 3 == 0 {
            feeds[1].send(ScriptStep::At(100 * k)).unwrap();
            sent.push(("right", 1 + k as u64 / 3));
        }
        until_frames(&mut events, &sent).await;
    }
    until(&mut events, |_| (count(&fleet, COMPLETE) >= 10).then_some(())).await;
    // Stalled: half a second later, frame sets are made without it, and no queue grows.
    for k in 31..=80 {
        feeds[0].send(ScriptStep::At(100 * k)).unwrap();
        until_frames(&mut events, &[("left", 1 + k as u64)]).await;
    }
    let before = count(&fleet, INCOMPLETE);
    assert!((20 + 50 - 17..=20 + 50).contains(&before), "{before}");
    // Unplugged: it is no longer waited for.
    feeds[1].send(ScriptStep::Fail(lost("unplugged"))).unwrap();
    until_session(&mut events, |record| {
        record.id == id
            && record.reason.as_deref()
                == Some("waiting for camera `right`: camera 7 was lost: unplugged")
    })
    .await;
    feeds[0].send(ScriptStep::At(100 * 81)).unwrap();
    until(&mut events, |event| {
        matches!(&event.kind, EventKind::Detection(found) if found.session == id
            && event.camera == "left" && seen(&fleet.live_session(&id).unwrap(), 0) >= 81)
        .then_some(())
    })
    .await;
    let record = fleet.live_session(&id).unwrap();
    assert!((10..=11).contains(&seen(&record, 1)), "{}", seen(&record, 1));
    let ended = fleet.stop_session(&id).await.unwrap();
    assert_eq!(ended.state, SessionState::Failed, "{ended:?}");
    let why = ended.reason.unwrap();
    // By then, an attempt to open it again may have failed too, for its own reason.
    assert!(why.starts_with("still waiting for camera `right`: camera 7 was lost: "), "{why}");
    assert!(why.contains("views kept: left 0, right 0; at least two cameras need"), "{why}");
    assert!(fleet.camera("left").unwrap().session.is_none());
    let own = fleet.start_session("left", request()).await.unwrap();
    fleet.abort_session(&own.id).await.unwrap();
}

/// A device that delivers a large, noisy image whenever it receives a sign, as fast as requested.
struct Flood {
    signs: Receiver<()>,
    next: u64,
    bytes: Arc<[u8]>,
}

const FLOOD_SIZE: ImageSize = ImageSize::new(2000, 1500);

impl FrameSource for Flood {
    fn next_frame(&mut self, timeout: Duration) -> Result<FrameSet, CaptureError> {
        self.signs.recv_timeout(timeout).map_err(|_| CaptureError::TimedOut { waited: timeout })?;
        let bytes = Arc::clone(&self.bytes);
        let format = PixelFormat::Mono8;
        let frame =
            Frame { sensor: SensorKind::Color, size: FLOOD_SIZE, format, stride: 2000, bytes };
        self.next += 1;
        Ok(FrameSet { frames: vec![frame], ..gray_frame(self.next - 1) })
    }

    fn description(&self) -> SourceDescription {
        SourceDescription::default()
    }
}

/// A search takes far longer than the interval between images: those that are not searched are
/// counted, and the last one is always searched.
#[tokio::test]
async fn when_detection_cannot_keep_up_the_newest_frame_wins() {
    const FRAMES: u64 = 200;
    let folder = tempfile::tempdir().unwrap();
    let (flood, signs) = channel();
    let mut source = Some(Flood {
        signs,
        next: 0,
        bytes: (0..2000 * 1500_u32).map(|k| (k.wrapping_mul(2_654_435_761) >> 24) as u8).collect(),
    });
    let open = move || {
        source.take().map(|s| Box::new(s) as Box<dyn FrameSource>).ok_or_else(|| lost("gone"))
    };
    let plan = CameraPlan {
        name: "front".to_owned(),
        kind: "v4l2".to_owned(),
        image_source: "camera 7".to_owned(),
        open: Box::new(open),
        may_stall: false,
    };
    let fleet = fleet_of(vec![plan], &folder, PATIENCE);
    let mut events = fleet.events(Some(0));
    let id = fleet.start_session("front", request()).await.unwrap().id;
    (0..FRAMES).for_each(|_| flood.send(()).unwrap());
    let (mut taken, mut searched_frames) = (0, Vec::new());
    until(&mut events, |event| {
        taken += u64::from(matches!(event.kind, EventKind::Frame(_)));
        let EventKind::Detection(detection) = &event.kind else { return None };
        searched_frames.push(detection.sequence);
        (detection.sequence == FRAMES - 1).then_some(())
    })
    .await;
    let searched = searched_frames.len() as u64;
    assert!(searched_frames.is_sorted() && searched < FRAMES / 4, "{searched_frames:?}");
    // The first image may have been requested before the session began: then it is taken, but not
    // searched.
    assert!((searched..=searched + 1).contains(&taken), "{taken} taken, {searched} searched");
    // A frame that replaces another is counted only after it has done so; by then, the detector may
    // have finished with it.
    let dropped = || fleet.camera("front").unwrap().dropped_frames;
    let began = Instant::now();
    while taken + dropped() < FRAMES && began.elapsed() < PATIENCE {
        tokio::task::yield_now().await;
    }
    let dropped = dropped();
    assert_eq!(taken + dropped, FRAMES);
    assert_eq!(fleet.abort_session(&id).await.unwrap().frames_seen, searched);
    let metrics = fleet.metrics_text();
    let counted =
        format!("plumb_frames_dropped_total{{camera=\"front\",why=\"overload\"}} {dropped}");
    assert!(metrics.contains(&counted), "{metrics}");
    assert!(
        metrics
            .contains(&format!("plumb_frame_latency_seconds_count{{camera=\"front\"}} {searched}")),
        "{metrics}"
    );
}
