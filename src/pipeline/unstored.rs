//! What a session could not store, and tries again.

use std::time::Duration;

use tokio::time::Instant;

use crate::calibration::result::Calibration;
use crate::calibration::session::{Action, Observed};
use crate::pipeline::message::SeenFrameSet;
use crate::store::{Picture, SensorView};

/// How soon it is tried again.
const RETRY: Duration = Duration::from_secs(1);

/// What could not be stored, and is tried again.
#[derive(Debug)]
pub(super) struct Unstored {
    pub(super) what: UnstoredWork,
    /// What the session decided meanwhile.
    then: Vec<Action>,
    reason: String,
    retry_at: Instant,
}

/// What is to be stored.
#[derive(Debug)]
pub(super) enum UnstoredWork {
    /// The views of a frame set.
    Views(Box<KeptFrameSet>),
    /// The session's state, which these actions lead out of.
    Actions(Vec<Action>),
    /// The result.
    Calibration(Box<Calibration>),
}

/// A frame set that was kept.
#[derive(Debug)]
pub(super) struct KeptFrameSet {
    pub(super) views: Vec<(SensorView, Picture)>,
    pub(super) seen: SeenFrameSet,
    pub(super) observed: Observed,
}

impl Unstored {
    /// Something that was not tried yet.
    pub(super) fn new(what: UnstoredWork) -> Self {
        Self { what, then: Vec::new(), reason: String::new(), retry_at: Instant::now() }
    }

    /// The views of a frame set.
    pub(super) fn views(
        views: Vec<(SensorView, Picture)>,
        seen: SeenFrameSet,
        observed: Observed,
    ) -> Self {
        Self::new(UnstoredWork::Views(Box::new(KeptFrameSet { views, seen, observed })))
    }

    /// It could not be stored for `reason`; it is tried again in a while.
    pub(super) fn failed(&mut self, reason: &str) {
        reason.clone_into(&mut self.reason);
        self.retry_at = Instant::now() + RETRY;
    }

    /// What is to be done after it is stored.
    pub(super) fn then(&mut self, actions: Vec<Action>) {
        self.then.extend(actions);
    }

    pub(super) fn take_then(&mut self) -> Vec<Action> {
        std::mem::take(&mut self.then)
    }

    /// Why it could not be stored, in words.
    pub(super) fn reason(&self) -> &str {
        &self.reason
    }

    pub(super) fn retry_at(&self) -> Instant {
        self.retry_at
    }
}
