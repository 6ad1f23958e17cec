//! Notifications to systemd: that the daemon is ready, that it is alive, that it ends. Without
//! systemd, nothing happens.

use std::io::ErrorKind;
use std::net::{IpAddr, Ipv4Addr, SocketAddr};
use std::sync::Arc;
use std::time::Duration;

use sd_notify::NotifyState;
use tokio::net::TcpStream;

use crate::pipeline::fleet::Fleet;

/// Says that cameras and HTTP are up, and from then on, on `runtime`, that they still are: a daemon
/// whose requests or cameras hang falls silent, and is started again.
pub(super) fn ready_and_alive(
    runtime: &tokio::runtime::Runtime,
    fleet: &Arc<Fleet>,
    listening: SocketAddr,
) {
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
            match tokio::time::timeout(interval_of(limit), is_answered(listening)).await {
                Ok(Some(())) => notify(&[NotifyState::Watchdog, NotifyState::Status(&status)]),
                _ => tracing::error!(%listening, "/healthz is not answered"),
            }
        }
    });
}

/// Asks for the daemon's health as anyone would; `None` where it is not answered.
async fn is_answered(listening: SocketAddr) -> Option<()> {
    const ASKED: &[u8] = b"GET /healthz HTTP/1.1\r\nHost: localhost\r\nConnection: close\r\n\r\n";
    const ANSWERED: &[u8] = b"HTTP/1.1 200";
    let own = IpAddr::V4(Ipv4Addr::LOCALHOST);
    let ip = if listening.ip().is_unspecified() { own } else { listening.ip() };
    let stream = TcpStream::connect((ip, listening.port())).await.ok()?;
    stream.writable().await.ok()?;
    // A new connection takes so few bytes at once.
    stream.try_write(ASKED).ok().filter(|written| *written == ASKED.len())?;
    let mut head = [0; ANSWERED.len()];
    loop {
        stream.readable().await.ok()?;
        match stream.try_read(&mut head) {
            Ok(read) => return (head[..read] == *ANSWERED).then_some(()),
            Err(error) if error.kind() == ErrorKind::WouldBlock => {}
            Err(_) => return None,
        }
    }
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
