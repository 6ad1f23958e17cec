//! Thread `detect-<camera>`: looks for the board while a session collects, and shows each frame with what was seen in it.
//!
//! Only luma is decoded, and only while someone looks for a board.

use std::sync::Arc;
use std::time::Instant;

use crate::detection::board_detection::DetectOptions;
use crate::detection::detector::Detector;
use crate::imaging::decode;
use crate::imaging::frame::{Frame, FrameSet, SensorKind};
use crate::imaging::gray::GrayImage;
use crate::pipeline::event::{EventKind, FrameEvent};
use crate::pipeline::guarded::guarded;
use crate::pipeline::live_camera::LiveCamera;
use crate::pipeline::live_frame::{LiveFrame, Look, LookError};
use crate::pipeline::message::{Captured, CapturedFrame, Message};
use crate::pipeline::search::Search;

pub(super) struct Detect {
    camera: Arc<LiveCamera>,
    detector: Option<Detector>,
    luma: GrayImage,
}

impl Detect {
    pub(super) fn new(camera: Arc<LiveCamera>) -> Self {
        Self { camera, detector: None, luma: GrayImage::default() }
    }

    pub(super) fn run(mut self) {
        while let Some(captured) = self.camera.slot.take() {
            let message = match captured {
                Captured::Frame(captured) => self.look_at(captured),
                Captured::End { search, reason } => Some(Message::Ended { search, reason }),
            };
            if let Some(message) = message
                && self.camera.messages.blocking_send(message).is_err()
            {
                return;
            }
        }
    }

    fn look_at(&mut self, captured: CapturedFrame) -> Option<Message> {
        let look = captured.search.clone().map(|search| {
            let look = self.look(&captured.frame_set, &search);
            (search, look)
        });
        let seen = look.as_ref().map(|(_, look)| look.clone());
        let live = LiveFrame { frame_set: Arc::clone(&captured.frame_set), look: seen };
        self.camera.frames.send_replace(Some(Arc::new(live)));
        self.camera.publish(EventKind::Frame(FrameEvent {
            sequence: captured.frame_set.sequence,
            host_time_ns: captured.frame_set.host_time.utc_ns,
            device_time_ns: captured.frame_set.device_time.map(|time| time.monotonic_ns),
            dropped_frames: self.camera.status.borrow().dropped_frames,
        }));
        look.map(|(search, look)| Message::Looked { captured, search, look })
    }

    fn look(&mut self, frame_set: &FrameSet, search: &Search) -> Look {
        let started = Instant::now();
        let searched = guarded(|| self.search(frame_set, search));
        let outcome = searched.unwrap_or_else(|detail| {
            // What it was doing when it broke off is not to be trusted.
            self.detector = None;
            Err(LookError::Unreadable { detail })
        });
        let elapsed = started.elapsed().as_secs_f64();
        let (name, metrics) = (&self.camera.name, &self.camera.metrics);
        metrics.detection_seconds.with_label_values(&[name]).observe(elapsed);
        metrics.searched.with_label_values(&[name]).inc();
        if outcome.is_ok() {
            metrics.boards.with_label_values(&[name]).inc();
        }
        Look { outcome: outcome.map(Arc::new), elapsed_ms: elapsed * 1e3 }
    }

    fn search(
        &mut self,
        frame_set: &FrameSet,
        search: &Search,
    ) -> Result<crate::detection::board_detection::Detection, LookError> {
        let unreadable = |detail: String| LookError::Unreadable { detail };
        let frame = picture_of(frame_set).ok_or_else(|| unreadable("there is none in this frame set".to_owned()))?;
        decode::luma(frame, &mut self.luma).map_err(|error| unreadable(error.to_string()))?;
        let detector = match &mut self.detector {
            Some(detector) if detector.board() == search.board => detector,
            other => other.insert(Detector::new(search.board)),
        };
        Ok(detector.find_board(self.luma.view(), &DetectOptions::default())?)
    }
}

/// The frame that boards are looked for in.
pub(super) fn picture_of(frame_set: &FrameSet) -> Option<&Frame> {
    frame_set.frame(SensorKind::Color).or_else(|| frame_set.frame(SensorKind::Infrared))
}
