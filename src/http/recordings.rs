//! Recordings that the daemon writes in the background.

use std::sync::Arc;

use axum::Json;
use axum::body::HttpBody;
use axum::extract::{Request, State};
use axum::http::header::LOCATION;
use axum::http::{HeaderMap, StatusCode};
use axum::response::IntoResponse;

use crate::document::recording::{RecordDocument, RecordingDocument, RecordingsDocument};
use crate::http::pages::{PageParameters, PageRefusals};
use crate::http::problem::Problem;
use crate::http::request::{Address, Asked, BodyRefusals, SMALL_BODY, document};
use crate::http::shared::{Shared, on_a_blocking_thread};
use crate::pipeline::recording::recorder::{RecordError, RecordingLimits};
use crate::pipeline::recording::recording_notes::recording_document;

/// Records a camera to an MCAP file in the store's folder; frames are written as they came.
#[utoipa::path(post, path = "/v1/cameras/{camera}/recordings", operation_id = "start_recording", tag = "recordings",
    params(("camera" = String, Path, description = "its name in the configuration")),
    request_body = Option<RecordDocument>,
    responses(
        (status = 201, description = "the recording was started", body = RecordingDocument, headers(("Location" = String, description = "where it is"))),
        (status = 404, description = "no such camera", body = Problem, content_type = "application/problem+json"),
        (status = 409, description = "the camera is being recorded already", body = Problem, content_type = "application/problem+json"),
        BodyRefusals,
        (status = 422, description = "an invalid limit", body = Problem, content_type = "application/problem+json"),
        (status = 503, description = "the disk is fuller than `[store] min_free_mb` lets it become; too many connections, or the daemon is stopping", body = Problem, content_type = "application/problem+json"),
    ))]
pub(super) async fn start(
    State(shared): State<Arc<Shared>>,
    Address(camera): Address<String>,
    request: Request,
) -> Result<impl IntoResponse, Problem> {
    shared.fleet.camera(&camera)?;
    let RecordDocument { max_seconds, max_bytes } = match request.body().is_end_stream() {
        true => RecordDocument::default(),
        false => {
            let document: Option<RecordDocument> = document(request, SMALL_BODY).await?;
            let document = document.unwrap_or_default();
            document.check()?;
            document
        }
    };
    let fleet = Arc::clone(&shared.fleet);
    let limits = RecordingLimits { seconds: max_seconds, bytes: max_bytes };
    let status = on_a_blocking_thread(move || fleet.start_recording(&camera, limits)).await??;
    let location = format!("/v1/recordings/{}", status.id);
    Ok((StatusCode::CREATED, [(LOCATION, location)], Json(recording_document(&status))))
}

/// The recordings that lie on disk, those that go on first; all, or page by page with `limit`.
#[utoipa::path(get, path = "/v1/recordings", operation_id = "list_recordings", tag = "recordings",
    params(PageParameters),
    responses(
        (status = 200, description = "the recordings", body = RecordingsDocument, headers(("Link" = String, description = "the next page, as `<address>; rel=\"next\"`; none on the last"))),
        PageRefusals,
        (status = 404, description = "unknown cursor", body = Problem, content_type = "application/problem+json"),
    ))]
pub(super) async fn list(
    State(shared): State<Arc<Shared>>,
    Asked(page): Asked<PageParameters>,
) -> Result<(HeaderMap, Json<RecordingsDocument>), Problem> {
    let fleet = Arc::clone(&shared.fleet);
    let recordings = on_a_blocking_thread(move || fleet.recordings()).await?;
    let (recordings, headers) = page.of("/v1/recordings", recordings, |one| one.id.clone())?;
    let recordings = recordings.iter().map(recording_document).collect();
    Ok((headers, Json(RecordingsDocument { recordings })))
}

/// One recording.
#[utoipa::path(get, path = "/v1/recordings/{id}", operation_id = "get_recording", tag = "recordings",
    params(("id" = String, Path, description = "recording id")),
    responses(
        (status = 200, description = "the recording", body = RecordingDocument),
        (status = 404, description = "no such recording", body = Problem, content_type = "application/problem+json"),
    ))]
pub(super) async fn one(
    State(shared): State<Arc<Shared>>,
    Address(id): Address<String>,
) -> Result<Json<RecordingDocument>, Problem> {
    let fleet = Arc::clone(&shared.fleet);
    let recordings = on_a_blocking_thread(move || fleet.recordings()).await?;
    let found = recordings.into_iter().find(|recording| recording.id == id);
    Ok(Json(recording_document(&found.ok_or(RecordError::UnknownRecording { id })?)))
}

/// Ends a recording; its file is whole when this answers.
#[utoipa::path(post, path = "/v1/recordings/{id}/stop", operation_id = "stop_recording", tag = "recordings",
    params(("id" = String, Path, description = "recording id")),
    responses(
        (status = 200, description = "it has ended", body = RecordingDocument),
        (status = 404, description = "no such recording", body = Problem, content_type = "application/problem+json"),
        (status = 409, description = "it had ended already", body = Problem, content_type = "application/problem+json"),
    ))]
pub(super) async fn stop(
    State(shared): State<Arc<Shared>>,
    Address(id): Address<String>,
) -> Result<Json<RecordingDocument>, Problem> {
    let fleet = Arc::clone(&shared.fleet);
    Ok(Json(recording_document(&on_a_blocking_thread(move || fleet.stop_recording(&id)).await??)))
}

/// Deletes a recording that has ended, with its file.
#[utoipa::path(delete, path = "/v1/recordings/{id}", tag = "recordings",
    params(("id" = String, Path, description = "recording id")),
    responses(
        (status = 204, description = "deleted"),
        (status = 404, description = "no such recording", body = Problem, content_type = "application/problem+json"),
        (status = 409, description = "still recording: stop it first", body = Problem, content_type = "application/problem+json"),
    ))]
pub(super) async fn delete_recording(
    State(shared): State<Arc<Shared>>,
    Address(id): Address<String>,
) -> Result<StatusCode, Problem> {
    let fleet = Arc::clone(&shared.fleet);
    on_a_blocking_thread(move || fleet.delete_recording(&id)).await??;
    Ok(StatusCode::NO_CONTENT)
}

impl From<RecordError> for Problem {
    fn from(error: RecordError) -> Self {
        let detail = error.to_string();
        match error {
            RecordError::UnknownCamera { .. } | RecordError::UnknownRecording { .. } => {
                Self::not_found(detail)
            }
            RecordError::Busy { .. } | RecordError::Over { .. } | RecordError::GoesOn { .. } => {
                Self::conflict(detail)
            }
            RecordError::NoRoom { .. } => Self::unavailable(detail),
            RecordError::File { .. } => Self::broken(detail),
        }
    }
}
