//! The configured cameras and their states.

use std::sync::Arc;

use axum::Json;
use axum::extract::State;

use crate::document::camera::{
    CameraDocument, CameraIdentityDocument, CameraSensorDocument, CameraStateName, CamerasDocument,
    FactoryDocument,
};
use crate::http::problem::Problem;
use crate::http::request::Address;
use crate::http::shared::Shared;
use crate::pipeline::camera_status::{CameraState, CameraStatus, SensorStatus};

/// Every configured camera, in the order of the configuration.
#[utoipa::path(get, path = "/v1/cameras", operation_id = "list_cameras", tag = "cameras", responses((status = 200, description = "the cameras", body = CamerasDocument)))]
pub(super) async fn list(State(shared): State<Arc<Shared>>) -> Json<CamerasDocument> {
    Json(CamerasDocument { cameras: shared.fleet.cameras().iter().map(camera_document).collect() })
}

/// One camera.
#[utoipa::path(get, path = "/v1/cameras/{camera}", operation_id = "get_camera", tag = "cameras",
    params(("camera" = String, Path, description = "its name in the configuration")),
    responses(
        (status = 200, description = "the camera", body = CameraDocument),
        (status = 404, description = "no such camera", body = Problem, content_type = "application/problem+json"),
    ))]
pub(super) async fn one(
    State(shared): State<Arc<Shared>>,
    Address(camera): Address<String>,
) -> Result<Json<CameraDocument>, Problem> {
    Ok(Json(camera_document(&shared.fleet.camera(&camera)?)))
}

/// A camera's status as its document.
pub(super) fn camera_document(status: &CameraStatus) -> CameraDocument {
    let identity = &status.identity;
    CameraDocument {
        name: status.name.clone(),
        backend: status.backend.clone(),
        state: state_name(status.state),
        reason: status.reason.clone(),
        sensors: status.sensors.iter().map(sensor_document).collect(),
        fps: status.fps,
        frames: status.frames,
        dropped_frames: status.dropped_frames,
        identity: CameraIdentityDocument {
            model: identity.model.clone(),
            serial: identity.serial.clone(),
            bus: identity.bus.clone(),
        },
        factory: FactoryDocument::of(&status.factory),
        session: status.session.clone(),
        calibration: status.calibration.clone(),
    }
}

fn state_name(state: CameraState) -> CameraStateName {
    match state {
        CameraState::Starting => CameraStateName::Starting,
        CameraState::Streaming => CameraStateName::Streaming,
        CameraState::Lost => CameraStateName::Lost,
        CameraState::Failed => CameraStateName::Failed,
    }
}

fn sensor_document(sensor: &SensorStatus) -> (String, CameraSensorDocument) {
    let document = CameraSensorDocument {
        image_size: [sensor.size.width, sensor.size.height],
        format: sensor.format.name().to_owned(),
    };
    (sensor.kind.name().to_owned(), document)
}
