//! Connections: how many, how slow, and how they end.

use std::io;
use std::sync::Arc;
use std::time::Duration;

use hyper::server::conn::http1;
use hyper_util::rt::{TokioIo, TokioTimer};
use hyper_util::server::graceful::GracefulShutdown;
use hyper_util::service::TowerToHyperService;
use tokio::net::TcpListener;
use tokio::sync::{Semaphore, watch};

use crate::http::router::router;
use crate::http::{Service, Shared};

/// How many connections are open at once; more wait to be accepted.
const CONNECTIONS: usize = 256;
/// How many stateless solves run at once; more wait.
const SOLVES: usize = 2;
/// How long the head of a request may take to arrive, and a connection may idle.
const HEAD_TIME: Duration = Duration::from_secs(30);
/// How long the answers in flight have when the daemon goes down.
const FAREWELL: Duration = Duration::from_millis(800);
/// The pause after an `accept` that failed, as when file descriptors have run out.
const ACCEPT_PAUSE: Duration = Duration::from_millis(100);

/// Serves on `listener` until `stop` resolves; then endless answers end, and the others have 0.8 s
/// to finish.
///
/// # Errors
/// None in operation: a connection that fails is its client's matter. The result is for `main`'s
/// comfort.
pub async fn serve(
    listener: TcpListener,
    service: Service,
    stop: impl Future<Output = ()>,
) -> io::Result<()> {
    let (stopping, watched) = watch::channel(false);
    let Service { fleet, store, token } = service;
    let solves = Semaphore::new(SOLVES);
    let shared = Shared { fleet, store, token, solves, stopping: watched };
    let service = TowerToHyperService::new(router(Arc::new(shared)));
    let mut http = http1::Builder::new();
    http.timer(TokioTimer::new()).header_read_timeout(HEAD_TIME);
    let open = Arc::new(Semaphore::new(CONNECTIONS));
    let graceful = GracefulShutdown::new();
    let accepting = async {
        loop {
            let Ok(place) = Arc::clone(&open).acquire_owned().await else { break };
            let stream = match listener.accept().await {
                Ok((stream, _)) => stream,
                Err(error) => {
                    tracing::warn!(%error, "a connection could not be accepted");
                    tokio::time::sleep(ACCEPT_PAUSE).await;
                    continue;
                }
            };
            // Events are small and wanted at once.
            let _ = stream.set_nodelay(true);
            let connection =
                graceful.watch(http.serve_connection(TokioIo::new(stream), service.clone()));
            tokio::spawn(async move {
                if let Err(error) = connection.await {
                    tracing::debug!(%error, "a connection ended early");
                }
                drop(place);
            });
        }
    };
    tokio::select! {
        () = accepting => {}
        () = stop => {}
    }
    drop(listener);
    stopping.send_replace(true);
    if tokio::time::timeout(FAREWELL, graceful.shutdown()).await.is_err() {
        tracing::info!("connections that were still busy are closed");
    }
    Ok(())
}
