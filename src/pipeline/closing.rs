//! Closes a source on a thread of its own: a driver that stopped answering may never return from
//! it, and the camera may be plugged in again meanwhile.

use std::convert::Infallible;
use std::sync::mpsc::{Receiver, RecvTimeoutError, SyncSender, sync_channel};
use std::thread;
use std::time::Duration;

use crate::capture::FrameSource;

/// A source that is being closed: a channel that ends with it.
#[derive(Debug)]
pub(super) struct Closing(Receiver<Infallible>);

impl Closing {
    /// Begins to close `source`, of a camera of this name.
    pub(super) fn begin(source: Box<dyn FrameSource>, camera: &str) -> Self {
        let (running, ended): (SyncSender<Infallible>, _) = sync_channel(0);
        // Where no thread can be had, the source is closed here, with what the thread would own.
        let _ = thread::Builder::new().name(format!("close-{camera}")).spawn(move || {
            drop(source);
            drop(running);
        });
        Self(ended)
    }

    /// Whether it is closed, at the latest after `wait`.
    pub(super) fn is_over(&self, wait: Duration) -> bool {
        self.0.recv_timeout(wait) != Err(RecvTimeoutError::Timeout)
    }
}
