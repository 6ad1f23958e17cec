//! Health, readiness and metrics of the daemon.

use std::sync::Arc;

use axum::extract::State;
use axum::http::header::CONTENT_TYPE;
use axum::response::IntoResponse;

use crate::http::problem::Problem;
use crate::http::shared::{SOLVES, Shared};

/// Whether the daemon is alive.
#[utoipa::path(get, path = "/healthz", tag = "daemon", responses((status = 200, description = "alive", body = String, content_type = "text/plain")))]
pub(super) async fn healthz() -> &'static str {
    "ok\n"
}

/// Whether a camera is delivering, and what sessions keep can be stored.
#[utoipa::path(get, path = "/readyz", tag = "daemon", responses(
    (status = 200, description = "at least one camera is delivering, and no session is paused", body = String, content_type = "text/plain"),
    (status = 503, description = "no camera is delivering frames, or a session is paused because its views cannot be stored; `detail` gives the reason", body = Problem, content_type = "application/problem+json"),
))]
pub(super) async fn readyz(State(shared): State<Arc<Shared>>) -> Result<&'static str, Problem> {
    if shared.fleet.is_ready() {
        return Ok("ready\n");
    }
    let paused = shared.fleet.paused();
    if !paused.is_empty() {
        return Err(Problem::unavailable(paused.join("; ")));
    }
    let cameras = shared.fleet.cameras();
    let said = cameras.iter().map(|camera| match &camera.reason {
        Some(reason) => format!("{} is {}: {reason}", camera.name, camera.state.name()),
        None => format!("{} is {}", camera.name, camera.state.name()),
    });
    let said: Vec<String> = said.collect();
    let detail = if said.is_empty() {
        "no camera is configured; add a [[camera]]".into()
    } else {
        said.join("; ")
    };
    Err(Problem::unavailable(format!("no camera is delivering: {detail}")))
}

/// What has been counted, as Prometheus text.
#[utoipa::path(get, path = "/metrics", tag = "daemon", responses((status = 200, description = "Prometheus text", body = String, content_type = "text/plain")))]
pub(super) async fn metrics(State(shared): State<Arc<Shared>>) -> impl IntoResponse {
    let running = SOLVES - shared.solves.available_permits();
    let own = format!(
        "# HELP plumb_solves_running stateless solves that are being computed\n\
         # TYPE plumb_solves_running gauge\nplumb_solves_running {running}\n"
    );
    let text = shared.fleet.metrics_text() + &own;
    ([(CONTENT_TYPE, "text/plain; version=0.0.4; charset=utf-8")], text)
}
