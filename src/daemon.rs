//! The daemon: starts in order (address, store, cameras, HTTP), ends in reverse.
//!
//! Nothing is begun that a later step may refuse for a reason that could be known before: the
//! address is taken first, so that a second daemon neither opens the store nor a camera.

mod error;
#[cfg(feature = "ros2")]
mod graph;
mod reload;
pub mod sources;
#[cfg(target_os = "linux")]
mod systemd;

use std::path::PathBuf;
use std::sync::Arc;
use std::time::Duration;

use tokio::net::TcpListener;
use tokio::runtime::Runtime;
use tokio::sync::watch;

pub use crate::daemon::error::DaemonError;

use crate::config::{Config, Overrides};
use crate::daemon::reload::Reload;
use crate::daemon::sources::{plan_of, rig_of};
use crate::document::time;
use crate::http::tls::{Certificate, Tls};
use crate::http::{self, Access, Service};
use crate::pipeline::fleet::Fleet;
use crate::pipeline::recording::recording_retention::RecordingRetention;
use crate::pipeline::{Exchange, FleetOptions};
use crate::store::{Retention, Store};

/// Threads that answer requests; frames and solves have their own.
const HTTP_THREADS: usize = 2;
/// What a request may still be computing when everything else has ended.
const SHUTDOWN_TIMEOUT: Duration = Duration::from_millis(100);

/// Runs until the process is asked to end (Ctrl-C, SIGTERM); `file` is where `config` came from,
/// but for `overrides`, and what SIGHUP reads again.
///
/// # Errors
/// [`DaemonError`] when it cannot start.
pub fn run(
    config: &Config,
    file: Option<PathBuf>,
    overrides: Overrides,
) -> Result<(), DaemonError> {
    let runtime = tokio::runtime::Builder::new_multi_thread()
        .worker_threads(HTTP_THREADS)
        .thread_name("http")
        .enable_all()
        .build()
        .map_err(|source| DaemonError::System {
            what: "the threads for HTTP could not be started",
            source,
        })?;
    let outcome = run_on(&runtime, config, file, overrides);
    runtime.shutdown_timeout(SHUTDOWN_TIMEOUT);
    outcome
}

fn run_on(
    runtime: &Runtime,
    config: &Config,
    file: Option<PathBuf>,
    overrides: Overrides,
) -> Result<(), DaemonError> {
    // Before anything is begun, so that a signal that comes early ends it as cleanly as a late one.
    let stop = runtime.block_on(async { asked_to_stop() })?;
    let address = config.listen;
    let listener = runtime
        .block_on(TcpListener::bind(address))
        .map_err(|source| DaemonError::Listen { address, source })?;
    let (store, repaired) = Store::open_or_repair(&config.store_path, config.least_free_bytes)?;
    if let Some(report) = repaired {
        tracing::error!("{report}");
    }
    let store = Arc::new(store);
    let plans = config.cameras.iter().map(plan_of).collect();
    let options = FleetOptions { auto_approve: config.auto_approve, ..FleetOptions::default() };
    let fleet = Arc::new(Fleet::start(plans, Arc::clone(&store), &options)?);
    let rigs = config.rigs.iter().map(rig_of).collect();
    fleet.exchange(Exchange { rigs, ..Exchange::default() })?;
    if config.cameras.is_empty() {
        tracing::warn!("no camera is configured; give a file with [[camera]] tables with --config");
    }
    let listening = listener.local_addr().unwrap_or(address);
    let access = Access::new(config.tokens.clone(), listening.port(), config.tls.is_some());
    let access = Arc::new(access);
    let tls = config.tls.as_ref().map(|files| Certificate::read(&files.cert, &files.key));
    let tls = tls.transpose()?.map(|certificate| Arc::new(Tls::new(certificate)));
    let scheme = if tls.is_some() { "https" } else { "http" };
    let running = watch::Sender::new(config.clone());
    #[cfg(feature = "ros2")]
    graph::begin(runtime, &fleet, &store, config, running.subscribe());
    let reload = Reload {
        fleet: Arc::clone(&fleet),
        access: Arc::clone(&access),
        tls: tls.clone(),
        file: file.clone(),
        overrides,
        config: config.clone(),
        running,
    };
    runtime.block_on(async { reload.with_each_hangup() })?;
    runtime.spawn(prune_by_the_hour(
        Arc::clone(&store),
        Arc::clone(&fleet),
        config.retention,
        config.recording_retention,
    ));
    tracing::info!(
        file = file.map(|file| file.display().to_string()),
        "listening on {scheme}://{listening}"
    );
    let service =
        Service { fleet: Arc::clone(&fleet), store, access, tls, solve_time: config.solve_time };
    #[cfg(target_os = "linux")]
    systemd::ready_and_alive(runtime, &fleet, listening);
    let served = runtime.block_on(http::serve(listener, service, stop));
    tracing::info!("stopping");
    #[cfg(target_os = "linux")]
    systemd::stopping();
    fleet.shutdown();
    served.map_err(|source| DaemonError::System { what: "HTTP ended", source })
}

/// Deletes the sessions and recordings that the configuration does not keep: at the start, and each
/// hour.
async fn prune_by_the_hour(
    store: Arc<Store>,
    fleet: Arc<Fleet>,
    of_sessions: Retention,
    of_recordings: RecordingRetention,
) {
    const HOUR: Duration = Duration::from_secs(3600);
    if of_sessions == Retention::default() && of_recordings == RecordingRetention::default() {
        return;
    }
    let mut hours = tokio::time::interval(HOUR);
    loop {
        hours.tick().await;
        let (store, fleet) = (Arc::clone(&store), Arc::clone(&fleet));
        let now_ns = time::utc_ns(jiff::Timestamp::now());
        let prune = move || {
            match store.prune(&of_sessions, now_ns, false) {
                Ok(pruned) if pruned.sessions.is_empty() => {}
                Ok(pruned) => {
                    tracing::info!(sessions = ?pruned.sessions, "deleted as [store] says");
                }
                Err(error) => tracing::warn!("old sessions could not be deleted: {error}"),
            }
            match fleet.prune_recordings(&of_recordings, now_ns) {
                Ok(recordings) if recordings.is_empty() => {}
                Ok(recordings) => tracing::info!(?recordings, "deleted as [store] says"),
                Err(error) => tracing::warn!("old recordings could not be deleted: {error}"),
            }
        };
        if tokio::task::spawn_blocking(prune).await.is_err() {
            return;
        }
    }
}

/// Resolves with the first signal to end.
fn asked_to_stop() -> Result<impl Future<Output = ()>, DaemonError> {
    let failed = |source| DaemonError::System { what: "signals could not be listened to", source };
    #[cfg(unix)]
    {
        use tokio::signal::unix::{SignalKind, signal};
        let mut interrupt = signal(SignalKind::interrupt()).map_err(failed)?;
        let mut terminate = signal(SignalKind::terminate()).map_err(failed)?;
        Ok(async move {
            tokio::select! {
                _ = interrupt.recv() => {}
                _ = terminate.recv() => {}
            }
        })
    }
    #[cfg(not(unix))]
    {
        let _ = failed;
        Ok(async {
            // Without signals it runs until it is ended otherwise.
            if tokio::signal::ctrl_c().await.is_err() {
                std::future::pending::<()>().await;
            }
        })
    }
}
