//! The daemon's face: routes in `router`, one file a resource. Uses geometry, imaging,
//! estimation, calibration, document, export, store and pipeline; never a camera.
//!
//! Every answer is read from the newest state; only a `stop` waits, and only for its solve. Every
//! refusal, of whatever cause, is a [`problem::Problem`]. A request can be too large, too slow or
//! too many, never fatal.

mod access;
mod calibrations;
mod cameras;
mod events;
mod focus;
mod frames;
mod health;
mod openapi;
mod page;
pub mod problem;
mod recordings;
mod request;
mod rigs;
mod router;
mod serve;
mod sessions;
mod solve;
mod uncertainty;
mod views;

use std::sync::Arc;

use tokio::sync::{Semaphore, watch};

use crate::http::problem::Problem;
use crate::pipeline::fleet::Fleet;
use crate::store::{Store, StoreError};

pub use crate::http::serve::serve;

/// What is served.
#[derive(Debug, Clone)]
pub struct Service {
    /// The cameras and their sessions.
    pub fleet: Arc<Fleet>,
    /// What has been stored.
    pub store: Arc<Store>,
    /// The secret that every request must carry; `None` lets everyone in who reaches the address,
    /// which must then be a loopback one.
    pub token: Option<String>,
}

/// What every route shares.
#[derive(Debug)]
struct Shared {
    fleet: Arc<Fleet>,
    store: Arc<Store>,
    token: Option<String>,
    /// How many stateless solves may run at once.
    solves: Semaphore,
    /// Becomes true when the daemon goes down: endless answers end.
    stopping: watch::Receiver<bool>,
}

impl Shared {
    /// Asks the store on a thread that may wait for the disk.
    async fn stored<T: Send + 'static>(
        &self,
        ask: impl FnOnce(&Store) -> Result<T, StoreError> + Send + 'static,
    ) -> Result<T, Problem> {
        let store = Arc::clone(&self.store);
        Ok(on_a_blocking_thread(move || ask(&store)).await??)
    }

    /// Resolves when the daemon goes down.
    fn stopped(&self) -> impl Future<Output = ()> + Send + use<> {
        let mut stopping = self.stopping.clone();
        async move {
            // A sender that is gone means the same.
            let _ = stopping.wait_for(|stopping| *stopping).await;
        }
    }
}

/// Computes on a thread that may take its time.
async fn on_a_blocking_thread<T: Send + 'static>(
    compute: impl FnOnce() -> T + Send + 'static,
) -> Result<T, Problem> {
    tokio::task::spawn_blocking(compute)
        .await
        .map_err(|_| Problem::broken("the computation failed"))
}
