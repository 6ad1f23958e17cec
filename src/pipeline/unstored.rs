//! What a session could not store, and stores again later.

use std::time::Duration;

use tokio::time::Instant;

use crate::calibration::result::Calibration;
use crate::calibration::session::{Action, Observed};
use crate::pipeline::message::SeenFrameSet;
use crate::store::{Picture, SensorView};

/// Time between two attempts.
const RETRY_INTERVAL: Duration = Duration::from_secs(1);

/// What could not be stored, and is retried.
#[derive(Debug)]
pub(super) struct Unstored {
    pub(super) what: UnstoredWork,
    /// The actions that the session decided on meanwhile.
    then: Vec<Action>,
    reason: String,
    retry_at: Instant,
}

/// What is to be stored.
#[derive(Debug)]
pub(super) enum UnstoredWork {
    /// The views of a frame set.
    Views(Box<KeptFrameSet>),
    /// The session's state, stored before these actions are performed.
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
    /// Something that has not been tried yet.
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

    /// Storing failed for `reason`; the next attempt is after [`RETRY_INTERVAL`].
    pub(super) fn failed(&mut self, reason: &str) {
        reason.clone_into(&mut self.reason);
        self.retry_at = Instant::now() + RETRY_INTERVAL;
    }

    /// Adds actions to perform once it has been stored.
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
