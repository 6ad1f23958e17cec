//! The views that a session kept: what was seen, how well it fits, the picture.

use std::sync::Arc;

use axum::Json;
use axum::extract::State;
use axum::http::header::CONTENT_TYPE;
use axum::response::IntoResponse;

use crate::calibration::result::{CalibratedView, Calibration, ImageCalibration};
use crate::calibration::sensor::SensorId;
use crate::calibration::view::View;
use crate::document::pose::PoseDocument;
use crate::document::session::{SessionViewDocument, SessionViewsDocument};
use crate::document::time;
use crate::geometry::target::Target;
use crate::http::problem::Problem;
use crate::http::request::Address;
use crate::http::sessions::session;
use crate::http::{Shared, on_a_blocking_thread};
use crate::imaging::decode;
use crate::imaging::frame::SensorKind;
use crate::imaging::picture_file::frame_from_file;
use crate::store::RigPlace;

const JPEG: &str = "image/jpeg";
const JPEG_QUALITY: u8 = 90;

/// The views that a session kept, in order, each with its residuals once there is a calibration.
#[utoipa::path(get, path = "/v1/sessions/{id}/views", tag = "sessions",
    params(("id" = String, Path, description = "the session's")),
    responses(
        (status = 200, description = "the views", body = SessionViewsDocument),
        (status = 404, description = "no such session", body = Problem, content_type = "application/problem+json"),
    ))]
pub(super) async fn list(
    State(shared): State<Arc<Shared>>,
    Address(id): Address<String>,
) -> Result<Json<SessionViewsDocument>, Problem> {
    let record = session(&shared, &id).await?;
    let (views, places, calibration) = shared
        .stored(move |store| {
            let calibration =
                record.calibration.as_deref().map(|id| store.calibration(id)).transpose()?;
            Ok((store.views(&record.id)?, store.rig_places(&record.id)?, calibration.flatten()))
        })
        .await?;
    let view =
        |view: &View| view_document(&id, view, &Place::of(view, &places), calibration.as_ref());
    Ok(Json(SessionViewsDocument { views: views.iter().map(view).collect() }))
}

/// The picture of a kept view, as JPEG.
#[utoipa::path(get, path = "/v1/sessions/{id}/views/{n}.jpg", tag = "sessions",
    params(("id" = String, Path, description = "the session's"), ("n" = u32, Path, description = "the view's number, from 0")),
    responses(
        (status = 200, description = "the picture", body = Vec<u8>, content_type = "image/jpeg"),
        (status = 404, description = "no such session or view", body = Problem, content_type = "application/problem+json"),
    ))]
pub(super) async fn picture(
    State(shared): State<Arc<Shared>>,
    Address((id, name)): Address<(String, String)>,
) -> Result<impl IntoResponse, Problem> {
    let unknown = || {
        Problem::not_found(format!(
            "session {id} has no view `{name}`; see GET /v1/sessions/{id}/views"
        ))
    };
    let number: u32 =
        name.strip_suffix(".jpg").and_then(|number| number.parse().ok()).ok_or_else(unknown)?;
    let asked = id.clone();
    let picture =
        shared.stored(move |store| store.picture(&asked, number)).await?.ok_or_else(unknown)?;
    let bytes = if picture.media_type == JPEG {
        picture.bytes
    } else {
        on_a_blocking_thread(move || to_jpeg(picture.bytes)).await??
    };
    Ok(([(CONTENT_TYPE, JPEG)], bytes))
}

fn to_jpeg(bytes: Vec<u8>) -> Result<Vec<u8>, Problem> {
    let frame = frame_from_file(SensorKind::Color, bytes);
    let picture = decode::rgb(&frame)
        .map_err(|e| Problem::broken(format!("the kept picture cannot be read: {e}")))?;
    Ok(decode::encode_jpeg_rgb(&picture, JPEG_QUALITY))
}

/// Which of a sensor's views a view is.
struct Place<'a> {
    /// Of a rig: the camera and the moment.
    rig: Option<&'a RigPlace>,
    /// Counts the views of the sensor, from 0.
    number: usize,
}

impl<'a> Place<'a> {
    fn of(view: &View, places: &'a [RigPlace]) -> Self {
        let Some(place) = places.iter().find(|place| place.number == view.number) else {
            return Self { rig: None, number: view.number as usize };
        };
        let before =
            |other: &&RigPlace| other.camera == place.camera && other.number < place.number;
        Self { rig: Some(place), number: places.iter().filter(before).count() }
    }

    /// The sensor that a calibration has for it.
    fn sensor<'c>(&self, calibration: &'c Calibration) -> Option<&'c ImageCalibration> {
        let Some(place) = self.rig else { return calibration.color() };
        calibration.sensor(&SensorId::of(&place.camera, SensorKind::Color))?.as_image()
    }
}

fn view_document(
    session_id: &str,
    view: &View,
    place: &Place<'_>,
    calibration: Option<&Calibration>,
) -> SessionViewDocument {
    let sensor = calibration.and_then(|calibration| place.sensor(calibration));
    let calibrated = sensor.and_then(|sensor| sensor.views.get(place.number));
    let target = calibration.and_then(|calibration| calibration.target);
    let residuals = sensor.zip(calibrated).zip(target);
    let corners = || view.detection.corners.iter();
    SessionViewDocument {
        n: view.number,
        camera: place.rig.map(|place| place.camera.clone()),
        moment: place.rig.map(|place| place.moment),
        name: view.frame.display_name(),
        taken_at: time::from_utc_ns(view.frame.host_time_ns),
        corners: view.detection.corners.len() as u32,
        corners_px: corners().map(|corner| [corner.pixel.x, corner.pixel.y]).collect(),
        used: calibrated.map(|calibrated| calibrated.used),
        reason: calibrated.and_then(|calibrated| calibrated.reason.clone()),
        rms_px: calibrated.and_then(|calibrated| calibrated.rms_px),
        residuals_px: residuals.and_then(|((sensor, calibrated), target)| {
            residuals_px(view, sensor, calibrated, target)
        }),
        camera_from_board: calibrated
            .and_then(|calibrated| calibrated.camera_from_board.as_ref())
            .map(PoseDocument::from),
        picture: format!("/v1/sessions/{session_id}/views/{}.jpg", view.number),
    }
}

/// Seen minus predicted, corner by corner; `None` for a view without a pose.
fn residuals_px(
    view: &View,
    sensor: &ImageCalibration,
    calibrated: &CalibratedView,
    target: Target,
) -> Option<Vec<[f64; 2]>> {
    let camera_from_board = calibrated.camera_from_board?;
    let corners = view.detection.corners.iter();
    let residual = |corner: &crate::detection::board_detection::DetectedCorner| {
        let point_in_board = target.corner_at(corner.index.col, corner.index.row)?;
        let predicted = sensor.lens.pixel_from_point(&(camera_from_board * point_in_board))?;
        Some([corner.pixel.x - predicted.x, corner.pixel.y - predicted.y])
    };
    corners.map(residual).collect()
}
