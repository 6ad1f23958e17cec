//! The slot for one item between a camera and its detector. With a live camera, a newer frame
//! replaces one that the detector has not taken, so that the detector never searches an old frame.
//! A replay that must not skip frames waits until the slot is free.

#[cfg(test)]
use super::sync::testing;
use super::sync::{Condvar, Mutex, MutexGuard, lock, unpoisoned};

/// Holds at most one item.
#[derive(Debug)]
pub(super) struct FrameSlot<T> {
    state: Mutex<SlotState<T>>,
    changed: Condvar,
}

#[derive(Debug)]
struct SlotState<T> {
    item: Option<T>,
    closed: bool,
}

/// The slot is closed: its items are no longer taken.
#[derive(Debug, PartialEq, Eq)]
pub(super) struct Closed;

impl<T> FrameSlot<T> {
    pub(super) fn new() -> Self {
        Self { state: Mutex::new(SlotState { item: None, closed: false }), changed: Condvar::new() }
    }

    /// Puts `item` into the slot. Returns the item that it replaced.
    pub(super) fn put_newest(&self, item: T) -> Result<Option<T>, Closed> {
        let mut state = self.lock();
        if state.closed {
            return Err(Closed);
        }
        let replaced = state.item.replace(item);
        self.changed.notify_all();
        Ok(replaced)
    }

    /// Waits until the slot is free, then puts `item` into it.
    pub(super) fn put_waiting(&self, item: T) -> Result<(), Closed> {
        let mut state = self.lock();
        while state.item.is_some() && !state.closed {
            state = unpoisoned(self.changed.wait(state));
        }
        if state.closed {
            return Err(Closed);
        }
        state.item = Some(item);
        self.changed.notify_all();
        Ok(())
    }

    /// Waits for an item and takes it; `None` once closed.
    pub(super) fn take(&self) -> Option<T> {
        let mut state = self.lock();
        while state.item.is_none() && !state.closed {
            state = unpoisoned(self.changed.wait(state));
        }
        let item = state.item.take().filter(|_| !state.closed);
        self.changed.notify_all();
        item
    }

    /// Wakes all threads that wait; no item passes any more.
    pub(super) fn close(&self) {
        self.lock().closed = true;
        self.changed.notify_all();
    }

    fn lock(&self) -> MutexGuard<'_, SlotState<T>> {
        lock(&self.state)
    }
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use super::testing::{alone, in_any_order, thread};
    use super::*;

    #[test]
    fn the_newest_wins_and_the_replaced_one_is_reported() {
        alone(|| {
            let slot = FrameSlot::new();
            assert_eq!(slot.put_newest(1), Ok(None));
            assert_eq!(slot.put_newest(2), Ok(Some(1)));
            assert_eq!(slot.take(), Some(2));
        });
    }

    #[test]
    fn whoever_waits_loses_nothing() {
        in_any_order(|| {
            let slot = Arc::new(FrameSlot::new());
            let taker = Arc::clone(&slot);
            let taken =
                thread::spawn(move || (0..20).map(|_| taker.take().unwrap()).collect::<Vec<_>>());
            (0..20).for_each(|n| slot.put_waiting(n).unwrap());
            assert_eq!(taken.join().unwrap(), (0..20).collect::<Vec<_>>());
        });
    }

    #[test]
    fn a_live_frame_is_taken_or_reported_as_replaced() {
        in_any_order(|| {
            let slot = Arc::new(FrameSlot::new());
            let putter = Arc::clone(&slot);
            let putting = thread::spawn(move || {
                let replaced = (0..10).filter_map(|n| putter.put_newest(n).unwrap());
                replaced.collect::<Vec<_>>()
            });
            // The last one replaces or stays: it is always taken in the end.
            let mut taken = Vec::new();
            while taken.last() != Some(&9) {
                taken.push(slot.take().unwrap());
            }
            let replaced = putting.join().unwrap();
            let mut all: Vec<i32> = taken.iter().chain(&replaced).copied().collect();
            all.sort_unstable();
            assert_eq!(all, (0..10).collect::<Vec<_>>());
            assert!(taken.is_sorted());
        });
    }

    #[test]
    fn closing_wakes_both_sides() {
        in_any_order(|| {
            let empty = Arc::new(FrameSlot::<u32>::new());
            let taker = Arc::clone(&empty);
            let taking = thread::spawn(move || taker.take());
            empty.close();
            assert_eq!(taking.join().unwrap(), None);

            let full = Arc::new(FrameSlot::new());
            full.put_newest(1).unwrap();
            let putter = Arc::clone(&full);
            let putting = thread::spawn(move || putter.put_waiting(2));
            full.close();
            assert_eq!(putting.join().unwrap(), Err(Closed));
            assert_eq!(full.put_newest(3), Err(Closed));
        });
    }
}
