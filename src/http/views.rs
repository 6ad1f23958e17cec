//! The views that a session kept: their detections, their residuals, their images.

use std::sync::Arc;

use axum::Json;
use axum::extract::State;
use axum::http::HeaderMap;
use axum::http::header::CONTENT_TYPE;
use axum::response::IntoResponse;

use crate::calibration::result::{Calibration, ImageCalibration};
use crate::calibration::sensor::SensorId;
use crate::calibration::view_residuals::view_residuals;
use crate::document::pose::PoseDocument;
use crate::document::session::{SessionViewDocument, SessionViewsDocument};
use crate::document::time;
use crate::geometry::target::Target;
use crate::http::pages::{PageParameters, PageRefusals};
use crate::http::problem::Problem;
use crate::http::request::{Address, Asked};
use crate::http::sessions::session;
use crate::http::shared::{Shared, on_a_blocking_thread};
use crate::imaging::decode;
use crate::imaging::frame::SensorKind;
use crate::imaging::image_file::frame_from_file;
use crate::store::SensorView;

const JPEG: &str = "image/jpeg";
const JPEG_QUALITY: u8 = 90;

/// The views that a session kept, in order, each with its residuals once there is a calibration;
/// all, or page by page with `limit`. A cursor is a view's number.
#[utoipa::path(get, path = "/v1/sessions/{id}/views", operation_id = "list_views", tag = "sessions",
    params(("id" = String, Path, description = "session id"), PageParameters),
    responses(
        (status = 200, description = "the views", body = SessionViewsDocument, headers(("Link" = String, description = "the next page, as `<address>; rel=\"next\"`; none on the last"))),
        PageRefusals,
        (status = 404, description = "no such session, or none of its views at that cursor", body = Problem, content_type = "application/problem+json"),
    ))]
pub(super) async fn list(
    State(shared): State<Arc<Shared>>,
    Address(id): Address<String>,
    Asked(page): Asked<PageParameters>,
) -> Result<(HeaderMap, Json<SessionViewsDocument>), Problem> {
    let record = session(&shared, &id).await?;
    let target = record.request.target.board();
    let (mut views, calibration) = shared
        .stored(move |store| {
            let calibration =
                record.calibration.as_deref().map(|id| store.calibration(id)).transpose()?;
            Ok((store.sensor_views(&record.id)?, calibration.flatten()))
        })
        .await?;
    views.retain(|view| view.number.is_some());
    views.sort_by_key(|view| view.number);
    let number = |view: &&SensorView| view.number.unwrap_or_default().to_string();
    let path = format!("/v1/sessions/{id}/views");
    let (asked, headers) = page.of(&path, views.iter().collect(), number)?;
    let documents = asked.into_iter().filter_map(|view| {
        // Its position among the views of its own camera.
        let before = |other: &&SensorView| {
            other.sensor.camera == view.sensor.camera && other.number < view.number
        };
        let place = views.iter().filter(before).count();
        view_document(&id, target, view, place, calibration.as_ref())
    });
    Ok((headers, Json(SessionViewsDocument { views: documents.collect() })))
}

/// The image of a kept view, as JPEG.
#[utoipa::path(get, path = "/v1/sessions/{id}/views/{n}.jpg", tag = "sessions",
    params(("id" = String, Path, description = "session id"), ("n" = u32, Path, description = "the view's number, from 0")),
    responses(
        (status = 200, description = "the image", body = Vec<u8>, content_type = "image/jpeg"),
        (status = 404, description = "no such session or view", body = Problem, content_type = "application/problem+json"),
    ))]
pub(super) async fn view_image(
    State(shared): State<Arc<Shared>>,
    Address((id, name)): Address<(String, String)>,
) -> Result<impl IntoResponse, Problem> {
    let number = name.strip_suffix(".jpg").and_then(|number| number.parse::<u32>().ok());
    let asked = id.clone();
    let image =
        shared.stored(move |store| number.map_or(Ok(None), |n| store.picture(&asked, n))).await?;
    let Some(image) = image else {
        session(&shared, &id).await?;
        return Err(Problem::not_found(format!(
            "session {id} has no view `{name}`; see GET /v1/sessions/{id}/views"
        )));
    };
    let bytes = if image.media_type == JPEG {
        image.bytes
    } else {
        on_a_blocking_thread(move || to_jpeg(image.bytes)).await??
    };
    Ok(([(CONTENT_TYPE, JPEG)], bytes))
}

fn to_jpeg(bytes: Vec<u8>) -> Result<Vec<u8>, Problem> {
    let frame = frame_from_file(SensorKind::Color, bytes);
    let image = decode::rgb(&frame)
        .map_err(|e| Problem::broken(format!("the kept image cannot be read: {e}")))?;
    Ok(decode::encode_jpeg_rgb(&image, JPEG_QUALITY))
}

/// The calibration of the sensor that a view is of.
fn sensor_of<'a>(calibration: &'a Calibration, view: &SensorView) -> Option<&'a ImageCalibration> {
    let Some(camera) = &view.sensor.camera else { return calibration.color() };
    calibration.sensor(&SensorId::of(camera, SensorKind::Color))?.as_image()
}

/// `place` is the position among the views of the same sensor; `shown` is the target that the
/// session searched for.
fn view_document(
    session_id: &str,
    shown: Option<Target>,
    view: &SensorView,
    place: usize,
    calibration: Option<&Calibration>,
) -> Option<SessionViewDocument> {
    let (n, detection) = (view.number?, view.detection.as_ref());
    let sensor = calibration.and_then(|calibration| sensor_of(calibration, view));
    let name = view.frame.display_name();
    // If an earlier view can no longer be read, the position is wrong: then the view is found by
    // its name, if that is unique.
    let calibrated = sensor.and_then(|sensor| {
        let at_place = sensor.views.get(place).filter(|calibrated| calibrated.name == name);
        let mut of_name = sensor.views.iter().filter(|calibrated| calibrated.name == name);
        at_place.or_else(|| of_name.next().filter(|_| of_name.next().is_none()))
    });
    let target = calibration.and_then(|calibration| calibration.target?.board());
    let residuals = sensor.zip(calibrated).zip(target).zip(detection);
    let corners = || detection.into_iter().flat_map(|detection| detection.corners.iter());
    Some(SessionViewDocument {
        n,
        camera: view.sensor.camera.clone(),
        moment: view.sensor.camera.is_some().then_some(view.frame_set),
        name,
        // The times of images with names are only a count.
        taken_at: view.frame.name.is_none().then(|| time::from_utc_ns(view.frame.host_time_ns)),
        corners: corners().count() as u32,
        corners_px: corners().map(|corner| [corner.pixel.x, corner.pixel.y]).collect(),
        indices: corners().map(|corner| [corner.index.col, corner.index.row]).collect(),
        ids: detection.zip(shown).and_then(|(detection, shown)| detection.corner_ids(&shown)),
        used: calibrated.map(|calibrated| calibrated.used),
        reason: calibrated.and_then(|calibrated| calibrated.reason.clone()),
        rms_px: calibrated.and_then(|calibrated| calibrated.rms_px),
        residuals_px: residuals.and_then(|(((sensor, calibrated), target), detection)| {
            view_residuals(detection, sensor, calibrated, target)
        }),
        camera_from_board: calibrated
            .and_then(|calibrated| calibrated.camera_from_board.as_ref())
            .map(PoseDocument::from),
        camera_from_scene: calibrated
            .and_then(|calibrated| calibrated.camera_from_scene.as_ref())
            .map(PoseDocument::from),
        image: format!("/v1/sessions/{session_id}/views/{n}.jpg"),
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::calibration::view::FrameFacts;
    use crate::document::{calibration, detection};
    use crate::estimation::measured_board::RollingShutter;
    use crate::geometry::pixel::ImageSize;

    #[test]
    fn residuals_are_those_of_the_moving_board_and_null_where_its_motion_is_not_said() {
        let mut calibration = calibration::tests::example();
        let sensor = SensorId::own(SensorKind::Color);
        let motion = calibration.image_mut(&sensor).unwrap().views[0].motion.take();
        let frame = FrameFacts {
            sequence: 0,
            name: Some("left01.jpg".into()),
            host_time_ns: 0,
            device_time_ns: None,
            image_size: ImageSize::new(640, 480),
        };
        let view = SensorView {
            frame_set: 0,
            sensor: SensorId::own(SensorKind::Color),
            number: Some(0),
            frame,
            depth_encoding: None,
            detection: Some(detection::tests::example()),
        };
        let shown = |calibration: &Calibration| {
            view_document("s", None, &view, 0, Some(calibration)).unwrap()
        };
        let still = shown(&calibration);
        assert_eq!(still.residuals_px.as_ref().map(Vec::len), Some(still.corners_px.len()));
        calibration.image_mut(&sensor).unwrap().rolling_shutter =
            Some(RollingShutter { translation_m: 0.01, rotation_rad: 0.0, agreement: 1.0 });
        let unsaid = shown(&calibration);
        assert_eq!(unsaid, SessionViewDocument { residuals_px: None, ..still.clone() });
        assert!(unsaid.rms_px.is_some() && unsaid.camera_from_board.is_some());

        let image = calibration.image_mut(&sensor).unwrap();
        image.views[0].motion = motion;
        let (lens, pose) = (image.lens, image.views[0].camera_from_board.unwrap());
        let moving = shown(&calibration);
        let [u, v] = moving.corners_px[0];
        let [col, row] = moving.indices[0];
        let point = calibration.target.unwrap().board().unwrap().corner_at(col, row).unwrap();
        let read = (v + 0.5) / 480.0 - 0.5;
        let predicted = lens
            .pixel_from_point(&(motion.unwrap().camera_from_board_at(&pose, read) * point))
            .unwrap();
        let [x, y] = moving.residuals_px.unwrap()[0];
        assert!((x - (u - predicted.x)).abs() + (y - (v - predicted.y)).abs() < 1e-9);
        assert_ne!(Some([x, y]), still.residuals_px.map(|residuals| residuals[0]));
    }
}
