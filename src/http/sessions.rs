//! Calibration sessions: start, watch, stop, abort.

use std::sync::Arc;

use axum::Json;
use axum::extract::{Request, State};
use axum::http::header::{LINK, LOCATION};
use axum::http::{HeaderMap, HeaderValue, StatusCode};
use axum::response::IntoResponse;

use crate::calibration::session_record::{SessionRecord, SessionRequest};
use crate::document::session::{SessionDocument, SessionsDocument, StartDocument};
use crate::http::pages::page_limit;
use crate::http::problem::Problem;
use crate::http::request::{Address, BodyRefusals, Parameters, SMALL_BODY, document};
use crate::http::shared::{Shared, on_a_blocking_thread};
use crate::pipeline::session_request::EndError;
use crate::store::{Store, StoreError};

/// Starts a session: the camera searches for the board and accepts views that add information.
#[utoipa::path(post, path = "/v1/cameras/{camera}/sessions", operation_id = "start_session", tag = "sessions",
    params(("camera" = String, Path, description = "its name in the configuration")),
    request_body = StartDocument,
    responses(
        (status = 201, description = "the session was started", body = SessionDocument, headers(("Location" = String, description = "where it is"))),
        (status = 404, description = "no such camera", body = Problem, content_type = "application/problem+json"),
        (status = 409, description = "the camera is in a session already", body = Problem, content_type = "application/problem+json"),
        BodyRefusals,
        (status = 422, description = "an invalid field", body = Problem, content_type = "application/problem+json"),
    ))]
pub(super) async fn start(
    State(shared): State<Arc<Shared>>,
    Address(camera): Address<String>,
    request: Request,
) -> Result<impl IntoResponse, Problem> {
    shared.fleet.camera(&camera)?;
    let start: StartDocument = document(request, SMALL_BODY).await?;
    let request = SessionRequest::try_from(&start)?;
    if !request.given.is_empty() {
        let problem = "only lenses of a rig can be held; start the session on the rig";
        return Err(Problem::field("given", problem));
    }
    Ok(created(&shared.fleet.start_session(&camera, request).await?))
}

/// The answer to a session that was started.
pub(super) fn created(record: &SessionRecord) -> impl IntoResponse + use<> {
    let location = format!("/v1/sessions/{}", record.id);
    (StatusCode::CREATED, [(LOCATION, location)], Json(SessionDocument::from(record)))
}

/// How many sessions a page has unless `limit` says: at ≈ 1.3 kB each, a page is below 64 kB.
const PAGE: u32 = 40;
/// The sessions, newest first, page by page: the header `Link` has the address of the next page.
#[utoipa::path(get, path = "/v1/sessions", operation_id = "list_sessions", tag = "sessions",
    params(
        ("camera" = Option<String>, Query, description = "only sessions of this camera and of the rigs it belonged to; or only those of this rig"),
        ("limit" = Option<u32>, Query, description = "how many, 1 to 1000; default: 40", minimum = 1, maximum = 1000),
        ("cursor" = Option<String>, Query, description = "id of the last session of the previous page, from its `Link` header"),
    ),
    responses(
        (status = 200, description = "the sessions", body = SessionsDocument, headers(("Link" = String, description = "the next page, as `<address>; rel=\"next\"`; none on the last"))),
        (status = 404, description = "unknown cursor", body = Problem, content_type = "application/problem+json"),
        (status = 422, description = "an invalid limit", body = Problem, content_type = "application/problem+json"),
    ))]
pub(super) async fn list(
    State(shared): State<Arc<Shared>>,
    parameters: Parameters,
) -> Result<impl IntoResponse, Problem> {
    let limit = page_limit(&parameters)?.unwrap_or(PAGE);
    let camera = parameters.text("camera").map(str::to_owned);
    let after = parameters.text("cursor").map(str::to_owned);
    let wanted = camera.clone();
    let asked =
        move |store: &Store| store.sessions_page(wanted.as_deref(), after.as_deref(), limit);
    let (stored, last) = shared.stored(asked).await?;
    let live = shared.fleet.live_sessions();
    let newest = |record: &SessionRecord| {
        let live = live.iter().find(|live| live.id == record.id);
        live.map_or_else(|| record.into(), |live| SessionDocument::from(live.as_ref()))
    };
    let mut headers = HeaderMap::new();
    if let Some(last) = last {
        // Camera names and identifiers need no escaping: letters, digits, `-` and `_`.
        let camera = camera.map(|camera| format!("&camera={camera}")).unwrap_or_default();
        let next = format!("</v1/sessions?limit={limit}&cursor={last}{camera}>; rel=\"next\"");
        headers.extend(HeaderValue::from_str(&next).map(|next| (LINK, next)));
    }
    let documents: Vec<SessionDocument> = stored.iter().map(newest).collect();
    let sessions = move |store: &Store| {
        documents.into_iter().map(|document| with_deleted(store, document)).collect()
    };
    let sessions = shared.stored(sessions).await?;
    let unreadable = shared.store.unreadable();
    Ok((headers, Json(SessionsDocument { sessions, unreadable })))
}

/// One session.
#[utoipa::path(get, path = "/v1/sessions/{id}", operation_id = "get_session", tag = "sessions",
    params(("id" = String, Path, description = "session id")),
    responses(
        (status = 200, description = "the session", body = SessionDocument),
        (status = 404, description = "no such session", body = Problem, content_type = "application/problem+json"),
    ))]
pub(super) async fn one(
    State(shared): State<Arc<Shared>>,
    Address(id): Address<String>,
) -> Result<Json<SessionDocument>, Problem> {
    let document = SessionDocument::from(&session(&shared, &id).await?);
    let stored = move |store: &Store| with_deleted(store, document);
    Ok(Json(shared.stored(stored).await?))
}

/// The document with whether its calibration was deleted since.
fn with_deleted(
    store: &Store,
    mut document: SessionDocument,
) -> Result<SessionDocument, StoreError> {
    if let Some(calibration) = &document.calibration {
        document.calibration_deleted = !store.has_calibration(calibration)?;
    }
    Ok(document)
}

/// Stops collecting and solves. Waits for the result unless `wait=false`. Too few views: the
/// session's state is `failed`, its `reason` says why, and its views stay.
#[utoipa::path(post, path = "/v1/sessions/{id}/stop", operation_id = "stop_session", tag = "sessions",
    params(
        ("id" = String, Path, description = "session id"),
        ("wait" = Option<bool>, Query, description = "wait for the result; default: true"),
    ),
    responses(
        (status = 200, description = "solved, or failed and why", body = SessionDocument),
        (status = 202, description = "solving (`wait=false`)", body = SessionDocument),
        (status = 404, description = "no such session", body = Problem, content_type = "application/problem+json"),
        (status = 409, description = "the session has already ended", body = Problem, content_type = "application/problem+json"),
        (status = 422, description = "`wait` is neither true nor false", body = Problem, content_type = "application/problem+json"),
    ))]
pub(super) async fn stop(
    State(shared): State<Arc<Shared>>,
    Address(id): Address<String>,
    parameters: Parameters,
) -> Result<impl IntoResponse, Problem> {
    let wait = parameters.flag("wait")?.unwrap_or(true);
    let solving = shared.fleet.stop_session(&id).await;
    let solving = or_stored(&shared, &id, solving).await?;
    if !wait {
        return Ok((StatusCode::ACCEPTED, Json(SessionDocument::from(&solving))));
    }
    let over = match shared.fleet.session_over(&id).await {
        Ok(over) => SessionDocument::from(over.as_ref()),
        // A newer session of its camera has started since: this one is over, and stored.
        Err(EndError::UnknownSession { .. }) => (&session(&shared, &id).await?).into(),
        Err(error) => return Err(error.into()),
    };
    Ok((StatusCode::OK, Json(over)))
}

/// Aborts a session; its views are kept. With `purge=true`, one that is over is deleted with its
/// views and their images; the calibrations that it led to stay.
#[utoipa::path(delete, path = "/v1/sessions/{id}", tag = "sessions",
    params(
        ("id" = String, Path, description = "session id"),
        ("purge" = Option<bool>, Query, description = "delete a session that has ended; default: false"),
    ),
    responses(
        (status = 200, description = "the session as it was aborted, or before it was deleted", body = SessionDocument),
        (status = 404, description = "no such session", body = Problem, content_type = "application/problem+json"),
        (status = 409, description = "the session has already ended; with `purge=true`: it is not over, or an approved calibration came from it", body = Problem, content_type = "application/problem+json"),
        (status = 422, description = "`purge` is neither true nor false", body = Problem, content_type = "application/problem+json"),
    ))]
pub(super) async fn abort(
    State(shared): State<Arc<Shared>>,
    Address(id): Address<String>,
    parameters: Parameters,
) -> Result<Json<SessionDocument>, Problem> {
    if parameters.flag("purge")?.unwrap_or(false) {
        let record = session(&shared, &id).await?;
        let deleted = id.clone();
        shared.stored(move |store| store.delete_session(&deleted)).await?;
        shared.fleet.forget_session(&id).await;
        return Ok(Json((&record).into()));
    }
    let aborted = match shared.fleet.abort_session(&id).await {
        Err(EndError::UnknownSession { .. }) => {
            let fleet = Arc::clone(&shared.fleet);
            let asked = id.clone();
            match on_a_blocking_thread(move || fleet.abort_stored(&asked)).await? {
                // Its camera was being exchanged, and has resumed it by now.
                Err(EndError::Over { state, .. }) if !state.is_over() => {
                    shared.fleet.abort_session(&id).await
                }
                aborted => aborted,
            }
        }
        aborted => aborted,
    };
    Ok(Json((&aborted?).into()))
}

/// The present state of the session: live, or else as it was stored.
pub(super) async fn session(shared: &Shared, id: &str) -> Result<SessionRecord, Problem> {
    if let Some(live) = shared.fleet.live_session(id) {
        return Ok(live.as_ref().clone());
    }
    let asked = id.to_owned();
    let stored = shared.stored(move |store| store.session(&asked)).await?;
    stored.ok_or_else(|| EndError::UnknownSession { id: id.to_owned() }.into())
}

/// The fleet knows only the newest session of each camera and rig. An older one is over; one of a
/// camera that is no longer configured waits for it to be configured again. For these, the refusal
/// is another one than "unknown".
async fn or_stored(
    shared: &Shared,
    id: &str,
    ended: Result<SessionRecord, EndError>,
) -> Result<SessionRecord, Problem> {
    match ended {
        Err(EndError::UnknownSession { .. }) => {
            let SessionRecord { id, camera: name, state, .. } = session(shared, id).await?;
            let is_known = state.is_over() || shared.fleet.has_instrument(&name);
            let over = EndError::Over { id: id.clone(), state };
            Err(if is_known { over } else { EndError::NotConfigured { id, name } }.into())
        }
        ended => Ok(ended?),
    }
}
