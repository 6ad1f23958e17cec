//! How threads are asked to end, even while they wait.

use std::sync::Arc;
use std::time::{Duration, Instant};

#[cfg(test)]
use super::sync::testing;
use super::sync::{Condvar, Mutex, MutexGuard, lock, unpoisoned};

/// Set once; every clone sees it.
#[derive(Debug, Clone, Default)]
pub(super) struct StopSignal {
    shared: Arc<(Mutex<bool>, Condvar)>,
}

impl StopSignal {
    pub(super) fn set(&self) {
        *self.lock() = true;
        self.shared.1.notify_all();
    }

    pub(super) fn is_set(&self) -> bool {
        *self.lock()
    }

    /// Waits for `time`, or until the signal is set. Returns whether it is set.
    pub(super) fn wait(&self, time: Duration) -> bool {
        let until = Instant::now() + time;
        let mut set = self.lock();
        while !*set {
            let left = until.saturating_duration_since(Instant::now());
            if left.is_zero() {
                break;
            }
            set = unpoisoned(self.shared.1.wait_timeout(set, left)).0;
        }
        *set
    }

    fn lock(&self) -> MutexGuard<'_, bool> {
        lock(&self.shared.0)
    }
}

#[cfg(test)]
mod tests {
    use super::testing::{in_any_order, thread};
    use super::*;

    #[test]
    fn whoever_waits_is_woken_whenever_it_is_set() {
        in_any_order(|| {
            let signal = StopSignal::default();
            let waiting: Vec<_> = (0..2)
                .map(|_| {
                    let signal = signal.clone();
                    thread::spawn(move || signal.wait(Duration::from_secs(3600)))
                })
                .collect();
            assert!(!signal.wait(Duration::ZERO), "no time is no wait");
            signal.set();
            assert!(waiting.into_iter().all(|thread| thread.join().unwrap()));
            assert!(signal.is_set() && signal.wait(Duration::from_secs(3600)));
        });
    }
}
