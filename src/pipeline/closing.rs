//! Closes a source on a thread of its own: if the driver no longer responds, closing may never
//! return, while the camera may be plugged in again.

use std::convert::Infallible;
use std::sync::mpsc::{Receiver, RecvTimeoutError, SyncSender, sync_channel};
use std::thread;
use std::time::Duration;

use crate::capture::FrameSource;

/// A source that is being closed: the channel is disconnected once it is closed.
#[derive(Debug)]
pub(super) struct Closing(Receiver<Infallible>);

impl Closing {
    /// Starts to close `source`, which is of the camera with this name.
    pub(super) fn begin(source: Box<dyn FrameSource>, camera: &str) -> Self {
        let (running, ended): (SyncSender<Infallible>, _) = sync_channel(0);
        // If no thread can be started, the source is closed here, because the closure that owns it
        // is dropped.
        let _ = thread::Builder::new().name(format!("close-{camera}")).spawn(move || {
            drop(source);
            drop(running);
        });
        Self(ended)
    }

    /// Waits until the source is closed, at most for `wait`. Returns whether it is.
    pub(super) fn is_over(&self, wait: Duration) -> bool {
        self.0.recv_timeout(wait) != Err(RecvTimeoutError::Timeout)
    }
}
