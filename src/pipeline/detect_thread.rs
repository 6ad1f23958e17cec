//! Thread `detect-<camera>`: looks for the board while a session collects, and shows each frame
//! with what was seen in it.
//!
//! Only luma is decoded, and only while someone looks for a board.

use std::sync::Arc;
use std::time::Instant;

use crate::pipeline::board_look::{BoardLook, Manner};
use crate::pipeline::event::{EventKind, FrameEvent};
use crate::pipeline::live_camera::LiveCamera;
use crate::pipeline::live_frame::{LiveFrame, Look};
use crate::pipeline::message::{Captured, CapturedFrame, Message};
use crate::pipeline::rig_inbox::Looked;
use crate::pipeline::search::Search;

pub(super) struct Detect {
    camera: Arc<LiveCamera>,
    board_look: BoardLook,
}

impl Detect {
    pub(super) fn new(camera: Arc<LiveCamera>) -> Self {
        Self { camera, board_look: BoardLook::default() }
    }

    pub(super) fn run(mut self) {
        while let Some(captured) = self.camera.slot.take() {
            let message = match captured {
                Captured::Frame(captured) => self.look_at(captured),
                Captured::End { search, reason } => Some(Message::Ended { search, reason }),
            };
            let message = message.and_then(hand_to_rig);
            if let Some(message) = message
                && self.camera.messages.blocking_send(message).is_err()
            {
                return;
            }
        }
    }

    fn look_at(&mut self, captured: CapturedFrame) -> Option<Message> {
        let look = captured.search.clone().map(|search| {
            let look = self.look(&captured, &search);
            (search, look)
        });
        let seen = look.as_ref().map(|(_, look)| look.clone());
        let live = LiveFrame { frame_set: Arc::clone(&captured.frame_set), look: seen };
        let live = Arc::new(live);
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
        look.map(|(search, look)| Message::Looked { captured, search, look })
    }

    /// A live frame is followed from the one before. A replay that waits for its frames has each
    /// searched by itself, so that it gives the very bits that the same pictures give anywhere
    /// else.
    fn look(&mut self, captured: &CapturedFrame, search: &Search) -> Look {
        let started = Instant::now();
        let manner = if captured.waits { Manner::Searched } else { Manner::Followed };
        let sighting = self.board_look.look(&captured.frame_set, &search.target, manner);
        let elapsed = started.elapsed().as_secs_f64();
        let (name, metrics) = (&self.camera.name, &self.camera.metrics);
        metrics.detection_seconds.with_label_values(&[name]).observe(elapsed);
        metrics.searched.with_label_values(&[name]).inc();
        if sighting.is_ok() {
            metrics.boards.with_label_values(&[name]).inc();
        }
        Look::of(sighting, elapsed * 1e3)
    }
}

/// Hands what a rig's session looks for to the rig; what is left is the camera's own.
fn hand_to_rig(message: Message) -> Option<Message> {
    match message {
        Message::Looked { captured, search, look } => match &search.rig {
            Some(seat) => {
                seat.inbox.put(&search.session, seat.member, Looked { captured, look });
                None
            }
            None => Some(Message::Looked { captured, search, look }),
        },
        Message::Ended { search: Some(search), reason } => match &search.rig {
            Some(seat) => {
                seat.inbox.end(&search.session, seat.member, &reason);
                None
            }
            None => Some(Message::Ended { search: Some(search), reason }),
        },
        message => Some(message),
    }
}
