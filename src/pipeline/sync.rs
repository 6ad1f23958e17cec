//! The locks and condition variables that threads use to pass data to each other. `interleavings`
//! compiles the same modules a second time with the primitives of `shuttle` in place of these, so
//! that their tests run under many thread schedules.

pub(super) use std::sync::{Condvar, Mutex, MutexGuard};

pub(super) use crate::locks::{lock, unpoisoned};

/// How these tests run here: as any other test.
#[cfg(test)]
pub(in crate::pipeline) mod testing {
    pub(in crate::pipeline) use std::thread;

    pub(in crate::pipeline) fn in_any_order(test: impl Fn() + Send + Sync + 'static) {
        test();
    }

    pub(in crate::pipeline) fn alone(test: impl Fn() + Send + Sync + 'static) {
        test();
    }
}
