//! The configured rigs: cameras that are fixed to each other, calibrated in one session.

use std::sync::Arc;

use axum::Json;
use axum::extract::{Request, State};
use axum::http::HeaderMap;
use axum::response::{IntoResponse, Response};

use crate::calibration::session_record::{HeldLens, SessionRequest};
use crate::document::calibration::{CalibrationDocument, CalibrationsDocument};
use crate::document::rig::{RigDocument, RigsDocument};
use crate::document::session::{SessionDocument, StartDocument};
use crate::http::calibrations::{self, ExportParameters};
use crate::http::pages::{PageParameters, PageRefusals};
use crate::http::problem::Problem;
use crate::http::request::{Address, Asked, BodyRefusals, SMALL_BODY, document};
use crate::http::sessions::created;
use crate::http::shared::Shared;
use crate::pipeline::RigStatus;

/// Every configured rig, in the order of the configuration.
#[utoipa::path(get, path = "/v1/rigs", operation_id = "list_rigs", tag = "rigs", responses((status = 200, description = "the rigs", body = RigsDocument)))]
pub(super) async fn list(State(shared): State<Arc<Shared>>) -> Json<RigsDocument> {
    Json(RigsDocument { rigs: shared.fleet.rigs().into_iter().map(rig_document).collect() })
}

/// One rig.
#[utoipa::path(get, path = "/v1/rigs/{rig}", operation_id = "get_rig", tag = "rigs",
    params(("rig" = String, Path, description = "its name in the configuration")),
    responses(
        (status = 200, description = "the rig", body = RigDocument),
        (status = 404, description = "no such rig", body = Problem, content_type = "application/problem+json"),
    ))]
pub(super) async fn one(
    State(shared): State<Arc<Shared>>,
    Address(rig): Address<String>,
) -> Result<Json<RigDocument>, Problem> {
    Ok(Json(rig_document(shared.fleet.rig(&rig)?)))
}

/// Starts a session on all cameras of a rig, which calibrates lenses and relative poses with one
/// board.
#[utoipa::path(post, path = "/v1/rigs/{rig}/sessions", operation_id = "start_rig_session", tag = "rigs",
    params(("rig" = String, Path, description = "its name in the configuration")),
    request_body = StartDocument,
    responses(
        (status = 201, description = "the session was started", body = SessionDocument, headers(("Location" = String, description = "where it is"))),
        (status = 404, description = "no such rig", body = Problem, content_type = "application/problem+json"),
        (status = 409, description = "the rig, or one of its cameras, is in a session already", body = Problem, content_type = "application/problem+json"),
        BodyRefusals,
        (status = 422, description = "an invalid field", body = Problem, content_type = "application/problem+json"),
    ))]
pub(super) async fn start(
    State(shared): State<Arc<Shared>>,
    Address(rig): Address<String>,
    request: Request,
) -> Result<impl IntoResponse, Problem> {
    let cameras = shared.fleet.rig(&rig)?.cameras;
    let start: StartDocument = document(request, SMALL_BODY).await?;
    let request = SessionRequest::try_from(&start)?;
    if request.target.is_scene() {
        let problem = "a scene is for one camera; start the session on a camera of the rig";
        return Err(Problem::field("target.kind", problem));
    }
    let is_foreign = |held: &&HeldLens| {
        held.sensor.camera.as_ref().is_none_or(|camera| !cameras.contains(camera))
    };
    if let Some(HeldLens { sensor, .. }) = request.given.iter().find(is_foreign) {
        let camera = sensor.camera.as_deref().unwrap_or_default();
        let problem = format!("the rig has {}", cameras.join(", "));
        return Err(Problem::field(&format!("given.{camera}.color"), &problem));
    }
    Ok(created(&shared.fleet.start_rig_session(&rig, request).await?))
}

/// The rig's current calibration: the one that was approved last.
#[utoipa::path(get, path = "/v1/rigs/{rig}/calibration", tag = "rigs",
    params(("rig" = String, Path, description = "its name in the configuration"), ExportParameters),
    responses(
        (status = 200, description = "the calibration", content(
            (CalibrationDocument = "application/json"), (String = "application/yaml"), (String = "application/xml"), (String = "text/plain"))),
        (status = 404, description = "no such rig, or none approved yet", body = Problem, content_type = "application/problem+json"),
        (status = 422, description = "an unknown format, or one that cannot hold it", body = Problem, content_type = "application/problem+json"),
    ))]
pub(super) async fn calibration(
    State(shared): State<Arc<Shared>>,
    Address(rig): Address<String>,
    Asked(parameters): Asked<ExportParameters>,
) -> Result<Response, Problem> {
    shared.fleet.rig(&rig)?;
    calibrations::current_of(&shared, &format!("rig `{rig}`"), &rig, parameters).await
}

/// Every calibration of a rig, newest first; all, or page by page with `limit`.
#[utoipa::path(get, path = "/v1/rigs/{rig}/calibrations", tag = "rigs",
    params(("rig" = String, Path, description = "its name in the configuration"), PageParameters),
    responses(
        (status = 200, description = "the calibrations", body = CalibrationsDocument, headers(("Link" = String, description = "the next page, as `<address>; rel=\"next\"`; none on the last"))),
        PageRefusals,
        (status = 404, description = "no such rig, or none of its calibrations at that cursor", body = Problem, content_type = "application/problem+json"),
    ))]
pub(super) async fn calibrations(
    State(shared): State<Arc<Shared>>,
    Address(rig): Address<String>,
    Asked(page): Asked<PageParameters>,
) -> Result<(HeaderMap, Json<CalibrationsDocument>), Problem> {
    shared.fleet.rig(&rig)?;
    let path = format!("/v1/rigs/{rig}/calibrations");
    calibrations::history_of(&shared, rig, &path, &page).await
}

fn rig_document(status: RigStatus) -> RigDocument {
    let RigStatus { name, cameras, session, calibration, .. } = status;
    RigDocument { name, cameras, session, calibration }
}
