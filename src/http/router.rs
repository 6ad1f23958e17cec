//! The list of routes, and the file that handles each.

use std::any::Any;
use std::sync::Arc;

use axum::Router;
use axum::http::{HeaderName, HeaderValue, Method, Uri, header};
use axum::middleware::{Next, from_fn, from_fn_with_state};
use axum::response::{IntoResponse, Response};
use axum::routing::{get, post};
use tower_http::catch_panic::CatchPanicLayer;
use utoipa_swagger_ui::SwaggerUi;

use crate::http::problem::Problem;
use crate::http::shared::Shared;
use crate::http::{
    board, calibrations, cameras, events, focus, frames, gate, health, openapi, page, recordings,
    rigs, sessions, solve, target, uncertainty, views,
};

pub(super) fn router(shared: Arc<Shared>) -> Router {
    Router::new()
        .route("/", get(page::index))
        .route("/page/{file}", get(page::file))
        .route("/healthz", get(health::healthz))
        .route("/readyz", get(health::readyz))
        .route("/metrics", get(health::metrics))
        .route("/v1/cameras", get(cameras::list))
        .route("/v1/cameras/{camera}", get(cameras::one))
        .route("/v1/cameras/{camera}/frame.jpg", get(frames::frame))
        .route("/v1/cameras/{camera}/preview.mjpg", get(frames::preview))
        .route("/v1/cameras/{camera}/focus", get(focus::focus))
        .route("/v1/cameras/{camera}/target", get(target::in_view))
        .route("/v1/cameras/{camera}/sessions", post(sessions::start))
        .route("/v1/cameras/{camera}/calibration", get(calibrations::current))
        .route("/v1/cameras/{camera}/calibrations", get(calibrations::history))
        .route("/v1/cameras/{camera}/factory", get(calibrations::stated))
        .route("/v1/rigs", get(rigs::list))
        .route("/v1/rigs/{rig}", get(rigs::one))
        .route("/v1/rigs/{rig}/sessions", post(rigs::start))
        .route("/v1/rigs/{rig}/calibration", get(rigs::calibration))
        .route("/v1/rigs/{rig}/calibrations", get(rigs::calibrations))
        .route("/v1/sessions", get(sessions::list))
        .route("/v1/sessions/{id}", get(sessions::one).delete(sessions::abort))
        .route("/v1/sessions/{id}/uncertainty.png", get(uncertainty::session_image))
        .route("/v1/sessions/{id}/stop", post(sessions::stop))
        .route("/v1/sessions/{id}/views", get(views::list))
        .route("/v1/sessions/{id}/views/{image}", get(views::view_image))
        .route(
            "/v1/calibrations/{id}",
            get(calibrations::one).delete(calibrations::delete_calibration),
        )
        .route("/v1/calibrations/{id}/uncertainty", get(uncertainty::numbers))
        .route("/v1/calibrations/{id}/uncertainty.png", get(uncertainty::uncertainty_image))
        .route("/v1/calibrations/{id}/board.png", get(board::board_image))
        .route("/v1/calibrations/{id}/approve", post(calibrations::approve))
        .route("/v1/solve", post(solve::solve))
        .route("/v1/cameras/{camera}/recordings", post(recordings::start))
        .route("/v1/recordings", get(recordings::list))
        .route("/v1/recordings/{id}", get(recordings::one).delete(recordings::delete_recording))
        .route("/v1/recordings/{id}/stop", post(recordings::stop))
        .route("/v1/events", get(events::follow))
        .merge(SwaggerUi::new("/docs").url("/openapi.json", openapi::document()))
        .fallback(no_route)
        .method_not_allowed_fallback(no_method)
        .layer(from_fn_with_state(Arc::clone(&shared), gate::check))
        .layer(from_fn(careful))
        .layer(CatchPanicLayer::custom(|_: Box<dyn Any + Send>| {
            Problem::broken("internal error; see the daemon's log").into_response()
        }))
        .with_state(shared)
}

async fn no_route(uri: Uri) -> Problem {
    Problem::not_found(format!("no such path: {}; /docs lists the API", uri.path()))
}

async fn no_method(method: Method, uri: Uri) -> Problem {
    Problem::method_not_allowed(
        format!("{method} is not allowed at {}; /docs lists the API", uri.path()),
        None,
    )
}

/// Adds headers to every answer: it may not be cached, because the state changes at any time, and
/// no other site may embed it.
async fn careful(request: axum::extract::Request, next: Next) -> Response {
    let mut response = next.run(request).await;
    let fixed = [
        (header::CACHE_CONTROL, "no-store"),
        (header::X_CONTENT_TYPE_OPTIONS, "nosniff"),
        (header::X_FRAME_OPTIONS, "DENY"),
        (header::REFERRER_POLICY, "no-referrer"),
        // No page of another site may show the live image.
        (HeaderName::from_static("cross-origin-resource-policy"), "same-origin"),
    ];
    for (name, value) in fixed {
        set_default(&mut response, name, HeaderValue::from_static(value));
    }
    response
}

fn set_default(response: &mut Response, name: HeaderName, value: HeaderValue) {
    response.headers_mut().entry(name).or_insert(value);
}
