//! What every route shares.

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

/// What is served.
#[derive(Debug, Clone)]
pub struct Service {
    /// The cameras and their sessions.
    pub fleet: Arc<Fleet>,
    /// What has been stored.
    pub store: Arc<Store>,
    /// Who may ask.
    pub access: Arc<Access>,
    /// What connections are secured with; `None` for plain HTTP.
    pub tls: Option<Arc<Tls>>,
    /// How long a stateless solve may take.
    pub solve_time: Duration,
}

/// What every route shares.
#[derive(Debug)]
pub(super) struct Shared {
    pub(super) fleet: Arc<Fleet>,
    pub(super) store: Arc<Store>,
    pub(super) access: Arc<Access>,
    /// How many stateless solves may run at once.
    pub(super) solves: Arc<Semaphore>,
    /// How long one may take, and wait for its place.
    pub(super) solve_time: Duration,
    /// The memory that there is for what is to be solved.
    pub(super) bodies: Bodies,
    /// How many endless answers may go out at once.
    pub(super) streams: Arc<Semaphore>,
    /// Becomes true when the daemon goes down: endless answers end.
    pub(super) stopping: watch::Receiver<bool>,
}

impl Shared {
    /// Asks the store on a thread that may wait for the disk.
    pub(super) async fn stored<T: Send + 'static>(
        &self,
        ask: impl FnOnce(&Store) -> Result<T, StoreError> + Send + 'static,
    ) -> Result<T, Problem> {
        let store = Arc::clone(&self.store);
        Ok(on_a_blocking_thread(move || ask(&store)).await??)
    }

    /// A place among those whom an endless answer goes to.
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

    /// Resolves when the daemon goes down, or when whoever asked with `headers` may not ask any
    /// more.
    pub(super) fn ended(&self, headers: &HeaderMap) -> impl Future<Output = ()> + Send + use<> {
        let mut stopping = self.stopping.clone();
        let (access, headers) = (Arc::clone(&self.access), headers.clone());
        async move {
            tokio::select! {
                // A sender that is gone means the same.
                _ = stopping.wait_for(|stopping| *stopping) => {}
                () = access.withdrawn(&headers) => {}
            }
        }
    }
}

/// Computes on a thread that may take its time.
pub(super) async fn on_a_blocking_thread<T: Send + 'static>(
    compute: impl FnOnce() -> T + Send + 'static,
) -> Result<T, Problem> {
    tokio::task::spawn_blocking(compute)
        .await
        .map_err(|_| Problem::broken("the computation failed"))
}
