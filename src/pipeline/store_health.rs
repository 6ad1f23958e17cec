//! Which sessions are paused because their data cannot be stored.

use std::collections::BTreeMap;
use std::sync::{Arc, Mutex, MutexGuard};

use crate::locks::lock;
use crate::pipeline::metrics::Metrics;

/// Why a session is paused, by instrument.
#[derive(Debug)]
pub(super) struct StoreHealth {
    paused: Mutex<BTreeMap<String, String>>,
    metrics: Arc<Metrics>,
}

impl StoreHealth {
    pub(super) fn new(metrics: Arc<Metrics>) -> Self {
        Self { paused: Mutex::default(), metrics }
    }

    /// A session of `instrument` could not store its data. Returns whether this is new.
    pub(super) fn pause(&self, instrument: &str, reason: &str) -> bool {
        self.metrics.store_failures.inc();
        let mut paused = self.lock();
        let before = paused.insert(instrument.to_owned(), reason.to_owned());
        self.metrics.paused.set(i64::try_from(paused.len()).unwrap_or(i64::MAX));
        before.as_deref() != Some(reason)
    }

    /// Everything that waited has been stored. Returns whether the session was paused.
    pub(super) fn go_on(&self, instrument: &str) -> bool {
        let mut paused = self.lock();
        let was_paused = paused.remove(instrument).is_some();
        self.metrics.paused.set(i64::try_from(paused.len()).unwrap_or(i64::MAX));
        was_paused
    }

    /// Which sessions are paused, and why, in words; empty if none is.
    pub(super) fn reasons(&self) -> Vec<String> {
        self.lock().iter().map(|(instrument, reason)| format!("{instrument} is {reason}")).collect()
    }

    fn lock(&self) -> MutexGuard<'_, BTreeMap<String, String>> {
        lock(&self.paused)
    }
}
