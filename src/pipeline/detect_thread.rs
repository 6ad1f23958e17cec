//! Thread `detect-<camera>`: searches for the board while a session collects, shows each frame with
//! its detection, and passes it to the session through the instrument's assembly.
//!
//! Only luma is decoded, and only while a session collects.

use std::sync::Arc;

use crate::calibration::target::CalibrationTarget;
use crate::pipeline::board_search::{BoardSearch, SearchMode};
use crate::pipeline::captured::{Captured, CapturedFrame};
use crate::pipeline::event::{EventKind, FrameEvent};
use crate::pipeline::guarded::guarded;
use crate::pipeline::live_camera::LiveCamera;
use crate::pipeline::live_frame::{FrameDetection, LiveFrame};
use crate::pipeline::scene_search::search_scene;
use crate::pipeline::search::CameraSearch;
use crate::pipeline::seen::SeenFrame;

pub(super) struct Detect {
    camera: Arc<LiveCamera>,
    board_search: BoardSearch,
}

impl Detect {
    pub(super) fn new(camera: Arc<LiveCamera>) -> Self {
        Self { camera, board_search: BoardSearch::default() }
    }

    pub(super) fn run(mut self) {
        while let Some(captured) = self.camera.slot.take() {
            match captured {
                Captured::Frame(captured) => {
                    if let Err(fault) = guarded(|| self.take(captured)) {
                        tracing::error!(camera = self.camera.name, "frame dropped: {fault}");
                        self.camera.count_dropped("fault", 1);
                        self.board_search = BoardSearch::default();
                    }
                }
                Captured::End { search: Some(search), reason } => {
                    search.assembly.ended(search.place, &reason);
                }
                Captured::End { search: None, .. } => {}
            }
        }
    }

    fn take(&mut self, captured: CapturedFrame) {
        let detection = captured.search.as_ref().map(|search| self.detect(&captured, search));
        self.show(&captured, detection.clone());
        let (Some(search), Some(detection)) = (&captured.search, detection) else { return };
        let seen = SeenFrame {
            frame_set: captured.frame_set,
            arrived: captured.arrived,
            waits: captured.waits,
            detection,
            sensors: Vec::new(),
        };
        if !search.assembly.put(search.place, seen) {
            self.camera.count_dropped("store", 1);
        }
    }

    fn show(&self, captured: &CapturedFrame, detection: Option<FrameDetection>) {
        let frame_set = Arc::clone(&captured.frame_set);
        let live = Arc::new(LiveFrame { frame_set, detection });
        if self.camera.preview.offer(&live) {
            self.camera.metrics.previews_skipped.with_label_values(&[&self.camera.name]).inc();
        }
        self.camera.frames.send_replace(Some(live));
        self.camera.publish(EventKind::Frame(FrameEvent {
            sequence: captured.frame_set.sequence,
            host_time_ns: captured.frame_set.host_time.utc_ns,
            device_time_ns: captured.frame_set.device_time.map(|time| time.monotonic_ns),
            dropped_frames: self.camera.status.borrow().dropped_frames,
        }));
    }

    /// In a live frame, the board is tracked from the previous one. In a replay that waits for its
    /// frames, each is searched in full, so that the result is bit for bit the same as for these
    /// images anywhere else.
    fn detect(&mut self, captured: &CapturedFrame, search: &CameraSearch) -> FrameDetection {
        let mode = if captured.waits { SearchMode::Whole } else { SearchMode::Tracked };
        let detection = match &search.assembly.target {
            CalibrationTarget::Board(board) => {
                self.board_search.search(&captured.frame_set, board, mode)
            }
            CalibrationTarget::Scene => search_scene(&captured.frame_set),
        };
        let (name, metrics) = (&self.camera.name, &self.camera.metrics);
        let elapsed_s = detection.elapsed_ms * 1e-3;
        metrics.detection_seconds.with_label_values(&[name]).observe(elapsed_s);
        metrics.searched.with_label_values(&[name]).inc();
        if detection.board().is_some() {
            metrics.boards.with_label_values(&[name]).inc();
        }
        detection
    }
}
