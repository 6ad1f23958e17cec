//! What the hand-overs between threads lock and wait on. `interleavings` compiles them a second
//! time with the primitives of `shuttle` in this place, so that their tests run in many orders of
//! their threads.

pub(super) use std::sync::{Condvar, Mutex, MutexGuard};

pub(super) use crate::locks::{lock, unpoisoned};

/// How the tests of the hand-overs run: here as any other.
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
