//! Notifications to systemd: that the daemon is ready, that it is alive, that it ends. Without systemd,
//! nothing happens.

use std::sync::Arc;
use std::time::Duration;

use sd_notify::NotifyState;

use crate::pipeline::fleet::Fleet;

/// Says that cameras and HTTP are up, and from then on, on `runtime`, that they still are: a daemon
/// whose requests or cameras hang falls silent, and is started again.
pub(super) fn ready_and_alive(runtime: &tokio::runtime::Runtime, fleet: &Arc<Fleet>) {
    notify(&[NotifyState::Ready]);
    let Some(limit) = sd_notify::watchdog_enabled() else { return };
    let fleet = Arc::clone(fleet);
    runtime.spawn(async move {
        let mut ticks = tokio::time::interval(interval_of(limit));
        loop {
            ticks.tick().await;
            let cameras = fleet.cameras();
            let streaming =
                cameras.iter().filter(|camera| camera.state.name() == "streaming").count();
            let status = format!("{streaming} of {} cameras streaming", cameras.len());
            notify(&[NotifyState::Watchdog, NotifyState::Status(&status)]);
        }
    });
}

/// Says that the end was asked for.
pub(super) fn stopping() {
    notify(&[NotifyState::Stopping]);
}

/// Twice within the limit, so that one late sign is not taken for none.
fn interval_of(limit: Duration) -> Duration {
    (limit / 2).max(Duration::from_millis(100))
}

fn notify(state: &[NotifyState<'_>]) {
    if let Err(error) = sd_notify::notify(state) {
        tracing::warn!("systemd cannot be notified: {error}");
    }
}
