//! The state that all routes share.

use std::sync::Arc;
use std::time::Duration;

use axum::http::HeaderMap;
use tokio::sync::{OwnedSemaphorePermit, Semaphore, watch};

use crate::http::access::Access;
use crate::http::bodies::Bodies;
use crate::http::problem::Problem;
use crate::http::tls::Tls;
use crate::pipeline::fleet::Fleet;
use crate::store::{Store, StoreError};

/// How many stateless solves run at once; more wait.
pub(super) const SOLVES: usize = 2;

/// What the server needs.
#[derive(Debug, Clone)]
pub struct Service {
    /// The cameras and their sessions.
    pub fleet: Arc<Fleet>,
    /// The stored sessions and calibrations.
    pub store: Arc<Store>,
    /// Access control.
    pub access: Arc<Access>,
    /// The certificate for TLS; `None` for plain HTTP.
    pub tls: Option<Arc<Tls>>,
    /// How long a stateless solve may take.
    pub solve_time: Duration,
}

/// The state that all routes share.
#[derive(Debug)]
pub(super) struct Shared {
    pub(super) fleet: Arc<Fleet>,
    pub(super) store: Arc<Store>,
    pub(super) access: Arc<Access>,
    /// How many stateless solves may run at once.
    pub(super) solves: Arc<Semaphore>,
    /// How long a solve may take, and how long it may wait for its permit.
    pub(super) solve_time: Duration,
    /// The memory for the bodies of solve requests.
    pub(super) bodies: Bodies,
    /// How many endless answers may be sent at once.
    pub(super) streams: Arc<Semaphore>,
    /// Becomes true when the daemon stops: endless answers end.
    pub(super) stopping: watch::Receiver<bool>,
}

impl Shared {
    /// Calls the store on a thread that may wait for the disk.
    pub(super) async fn stored<T: Send + 'static>(
        &self,
        ask: impl FnOnce(&Store) -> Result<T, StoreError> + Send + 'static,
    ) -> Result<T, Problem> {
        let store = Arc::clone(&self.store);
        Ok(on_a_blocking_thread(move || ask(&store)).await??)
    }

    /// A permit for an endless answer.
    ///
    /// # Errors
    /// 503 where all are taken.
    pub(super) fn stream_place(&self) -> Result<OwnedSemaphorePermit, Problem> {
        Arc::clone(&self.streams).try_acquire_owned().map_err(|_| {
            Problem::unavailable(
                "too many previews and event streams are open; close one, and ask again",
            )
        })
    }

    /// Resolves when the daemon stops, or when a client with `headers` no longer has access.
    pub(super) fn ended(&self, headers: &HeaderMap) -> impl Future<Output = ()> + Send + use<> {
        let mut stopping = self.stopping.clone();
        let (access, headers) = (Arc::clone(&self.access), headers.clone());
        async move {
            tokio::select! {
                // A sender that was dropped means the same.
                _ = stopping.wait_for(|stopping| *stopping) => {}
                () = access.withdrawn(&headers) => {}
            }
        }
    }
}

/// Computes on a thread that may block.
pub(super) async fn on_a_blocking_thread<T: Send + 'static>(
    compute: impl FnOnce() -> T + Send + 'static,
) -> Result<T, Problem> {
    tokio::task::spawn_blocking(compute)
        .await
        .map_err(|_| Problem::broken("the computation failed"))
}
