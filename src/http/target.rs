//! The target that a camera sees now.

use std::sync::Arc;

use axum::Json;
use axum::extract::State;
use axum::http::HeaderMap;

use crate::document::target_in_view::TargetInViewDocument;
use crate::http::frames::stale;
use crate::http::problem::Problem;
use crate::http::request::Address;
use crate::http::shared::{Shared, on_a_blocking_thread};

/// Recognizes the board in the newest frame: a chessboard, a ChArUco board or an AprilGrid, without
/// its lengths, which no image determines.
#[utoipa::path(get, path = "/v1/cameras/{camera}/target", tag = "cameras",
    params(("camera" = String, Path, description = "its name in the configuration")),
    responses(
        (status = 200, description = "the target, or why none is recognized", body = TargetInViewDocument, headers(("Plumb-Stale" = String, description = "why the camera gives nothing newer; none while it does"))),
        (status = 404, description = "no such camera", body = Problem, content_type = "application/problem+json"),
        (status = 409, description = "no frame yet, or one that cannot be read", body = Problem, content_type = "application/problem+json"),
        (status = 503, description = "too many solves and searches already run", body = Problem, content_type = "application/problem+json"),
    ))]
pub(super) async fn in_view(
    State(shared): State<Arc<Shared>>,
    Address(camera): Address<String>,
) -> Result<(HeaderMap, Json<TargetInViewDocument>), Problem> {
    let (fleet, stale) = (Arc::clone(&shared.fleet), stale(&shared, &camera));
    // It takes as long as a small solve.
    let busy =
        |_| Problem::unavailable("too many solves and searches are running; try again in a moment");
    let place = Arc::clone(&shared.solves).try_acquire_owned().map_err(busy)?;
    let seen = on_a_blocking_thread(move || {
        let _place = place;
        fleet.target_in_view(&camera)
    });
    Ok((stale, Json(seen.await??.as_ref().into())))
}
