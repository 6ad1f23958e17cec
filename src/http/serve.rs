//! Connections: their number, their time limits, and their end.

use std::convert::Infallible;
use std::io;
use std::net::SocketAddr;
use std::sync::Arc;
use std::time::Duration;

use axum::http::StatusCode;
use axum::response::{IntoResponse, Response};
use hyper::body::Incoming;
use hyper::server::conn::http1;
use hyper::service::{Service as _, service_fn};
use hyper_util::rt::{TokioIo, TokioTimer};
use hyper_util::server::graceful::{GracefulShutdown, Watcher};
use hyper_util::service::TowerToHyperService;
use tokio::net::{TcpListener, TcpStream};
use tokio::sync::{Semaphore, watch};

use crate::http::bodies::Bodies;
use crate::http::connections::{Connections, OpenConnection, WatchedStream};
use crate::http::problem::Problem;
use crate::http::router::router;
use crate::http::shared::{SOLVES, Service, Shared};
use crate::http::tls::{HANDSHAKE, Tls};

/// How many endless answers (previews, events) are sent at once.
const STREAMS: usize = 128;
/// How long the head of a request may take to arrive, and how long a connection may be idle.
const HEAD_TIME: Duration = Duration::from_secs(20);
/// How long the answers in progress may take when the daemon stops.
const FAREWELL: Duration = Duration::from_millis(800);
/// The pause after an `accept` that failed, for instance because there are no file descriptors
/// left.
const ACCEPT_PAUSE: Duration = Duration::from_millis(100);
/// Paths that are answered however many connections there are.
const HEALTH: [&str; 3] = ["/healthz", "/readyz", "/metrics"];

/// Serves on `listener` until `stop` resolves; then endless answers end, and the others have 0.8 s
/// to finish.
///
/// # Errors
/// None in operation: a connection that fails concerns its client only. The result is for the
/// convenience of `main`.
pub async fn serve(
    listener: TcpListener,
    service: Service,
    stop: impl Future<Output = ()>,
) -> io::Result<()> {
    let (stopping, watched) = watch::channel(false);
    let Service { fleet, store, access, tls, solve_time } = service;
    let solves = Arc::new(Semaphore::new(SOLVES));
    let streams = Arc::new(Semaphore::new(STREAMS));
    let bodies = Bodies::new();
    let shared =
        Shared { fleet, store, access, solves, solve_time, bodies, streams, stopping: watched };
    let service = TowerToHyperService::new(router(Arc::new(shared)));
    let mut http = http1::Builder::new();
    http.timer(TokioTimer::new()).header_read_timeout(HEAD_TIME);
    let connections = Arc::new(Connections::new());
    let graceful = GracefulShutdown::new();
    let accepting = async {
        loop {
            let (stream, client) = next_client(&listener).await;
            let Some(connection) = connections.admit(client) else { continue };
            // Events are small and must not be delayed.
            let _ = stream.set_nodelay(true);
            let stream = WatchedStream::new(stream, Arc::clone(&connection));
            let (service, answered) = (service.clone(), Arc::clone(&connection));
            let answer = service_fn(move |request: hyper::Request<Incoming>| {
                let (service, answered) = (service.clone(), Arc::clone(&answered));
                async move {
                    let _answering = answered.answering();
                    if answered.is_crowded && !HEALTH.contains(&request.uri().path()) {
                        return Ok::<Response, Infallible>(crowded());
                    }
                    service.call(request).await
                }
            });
            let served = serve_one(http.clone(), stream, tls.clone(), answer, graceful.watcher());
            let connections = Arc::clone(&connections);
            tokio::spawn(async move {
                until_evicted(served, &connection).await;
                connections.remove(&connection);
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

/// The next client that connects. An `accept` that fails is repeated after a pause.
async fn next_client(listener: &TcpListener) -> (TcpStream, SocketAddr) {
    loop {
        match listener.accept().await {
            Ok(accepted) => return accepted,
            Err(error) => {
                tracing::warn!(%error, "a connection could not be accepted");
                tokio::time::sleep(ACCEPT_PAUSE).await;
            }
        }
    }
}

/// Serves a connection until it ends, or has to make room for another one.
async fn until_evicted(
    served: impl Future<Output = Result<(), ConnectionError>>,
    connection: &OpenConnection,
) {
    tokio::select! {
        ended = served => {
            if let Err(error) = ended {
                tracing::debug!(%error, "a connection ended early");
            }
        }
        () = connection.evicted() => {
            tracing::debug!("a silent connection made room for another one");
        }
    }
}

/// Answers one client. Where TLS is required, a client without it is only answered with the reason
/// and, for the daemon's watchdog, whether the daemon is alive.
async fn serve_one<S>(
    http: http1::Builder,
    mut stream: WatchedStream<TcpStream>,
    tls: Option<Arc<Tls>>,
    answer: S,
    graceful: Watcher,
) -> Result<(), ConnectionError>
where
    S: hyper::service::Service<hyper::Request<Incoming>, Response = Response, Error = Infallible>,
    S::Future: Send,
{
    let Some(tls) = tls else {
        let served = graceful.watch(http.serve_connection(TokioIo::new(stream), answer)).await;
        return Ok(served?);
    };
    let secured = tokio::time::timeout(HEAD_TIME, async {
        if stream.first_byte().await? != HANDSHAKE {
            return Ok(Err(stream));
        }
        tls.acceptor().accept(stream).await.map(Ok)
    });
    match secured.await.map_err(|_| io::Error::from(io::ErrorKind::TimedOut))?? {
        Ok(secured) => {
            graceful.watch(http.serve_connection(TokioIo::new(secured), answer)).await?;
        }
        Err(plain) => {
            let answer =
                service_fn(|request| async move { Ok::<_, Infallible>(in_plain(&request)) });
            graceful.watch(http.serve_connection(TokioIo::new(plain), answer)).await?;
        }
    }
    Ok(())
}

/// The answer to a client that does not use TLS.
fn in_plain(request: &hyper::Request<Incoming>) -> Response {
    if request.uri().path() == "/healthz" {
        return StatusCode::OK.into_response();
    }
    let detail = "this address is secured; write https:// in place of http://";
    Problem::new(StatusCode::BAD_REQUEST, detail).into_response()
}

/// Why a connection ended early.
#[derive(Debug, thiserror::Error)]
enum ConnectionError {
    #[error(transparent)]
    Http(#[from] hyper::Error),
    #[error(transparent)]
    Stream(#[from] io::Error),
}

fn crowded() -> Response {
    Problem::unavailable("too many connections are open; try again in a moment").into_response()
}
