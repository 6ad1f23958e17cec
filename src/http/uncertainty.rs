//! The projection uncertainty of a calibration: as numbers, and as an image.

use std::sync::Arc;

use axum::Json;
use axum::extract::State;
use axum::http::header::CONTENT_TYPE;
use axum::response::IntoResponse;

use crate::calibration::result::ImageCalibration;
use crate::calibration::solve::{
    Distance, UNCERTAINTY_COLUMNS, UncertaintyMap, sensor_uncertainty,
};
use crate::document::uncertainty::UncertaintyMapDocument;
use crate::http::calibrations::calibration;
use crate::http::problem::Problem;
use crate::http::request::{Address, Asked, Parameters, ReadQuery, known_name};
use crate::http::schemas;
use crate::http::shared::{Shared, on_a_blocking_thread};
use crate::imaging::draw::heat_map::{GridValues, ONE_SIGMA_PX, heat_map_png};

/// Grid columns along the image's longer side, of the numbers and of the image.
const COLUMNS: [u32; 2] = [UNCERTAINTY_COLUMNS, 49];

/// What is asked about, and at which distance.
#[derive(utoipa::IntoParams)]
#[into_params(parameter_in = Query)]
pub(super) struct UncertaintyParameters {
    /// color, infrared, infrared2, or a camera of a rig; default: the first.
    sensor: Option<String>,
    /// Distance of the scene, in meters; default: infinity.
    #[param(schema_with = schemas::focus_m, required = false)]
    distance_m: Option<f64>,
}

impl ReadQuery for UncertaintyParameters {
    fn read(parameters: &Parameters) -> Result<Self, Problem> {
        Ok(Self {
            sensor: parameters.text("sensor").map(str::to_owned),
            distance_m: parameters.within("distance_m", schemas::FOCUS_M)?,
        })
    }
}

/// The predicted 1-σ projection uncertainty on a grid of pixels over the image.
#[utoipa::path(get, path = "/v1/calibrations/{id}/uncertainty", tag = "calibrations",
    params(("id" = String, Path, description = "calibration id"), UncertaintyParameters),
    responses(
        (status = 200, description = "the numbers", body = UncertaintyMapDocument),
        (status = 404, description = "no such calibration, or it has no covariance for this sensor", body = Problem, content_type = "application/problem+json"),
        (status = 422, description = "an unknown sensor, or an invalid distance", body = Problem, content_type = "application/problem+json"),
    ))]
pub(super) async fn numbers(
    State(shared): State<Arc<Shared>>,
    Address(id): Address<String>,
    Asked(parameters): Asked<UncertaintyParameters>,
) -> Result<Json<UncertaintyMapDocument>, Problem> {
    let (name, sensor, distance) = asked(&shared, &id, &parameters).await?;
    let map = sensor_uncertainty(&sensor, COLUMNS[0], distance).ok_or_else(|| unknown(&id))?;
    Ok(Json(UncertaintyMapDocument::new(&name, distance, &map)))
}

/// The predicted 1-σ projection uncertainty over the image as a heat map: contours at round values,
/// each with its label in pixels.
#[utoipa::path(get, path = "/v1/calibrations/{id}/uncertainty.png", tag = "calibrations",
    params(("id" = String, Path, description = "calibration id"), UncertaintyParameters),
    responses(
        (status = 200, description = "the image", body = Vec<u8>, content_type = "image/png"),
        (status = 404, description = "no such calibration, or it has no covariance for this sensor", body = Problem, content_type = "application/problem+json"),
        (status = 422, description = "an unknown sensor, or an invalid distance", body = Problem, content_type = "application/problem+json"),
    ))]
pub(super) async fn uncertainty_image(
    State(shared): State<Arc<Shared>>,
    Address(id): Address<String>,
    Asked(parameters): Asked<UncertaintyParameters>,
) -> Result<impl IntoResponse, Problem> {
    let (_, sensor, distance) = asked(&shared, &id, &parameters).await?;
    let png = on_a_blocking_thread(move || heat_map(&sensor, distance))
        .await?
        .ok_or_else(|| unknown(&id))?;
    Ok(([(CONTENT_TYPE, "image/png")], png))
}

/// Which camera of a rig's session is asked about.
#[derive(utoipa::IntoParams)]
#[into_params(parameter_in = Query)]
pub(super) struct MemberParameters {
    /// A camera of the rig; default: the one with the largest uncertainty.
    camera: Option<String>,
}

impl ReadQuery for MemberParameters {
    fn read(parameters: &Parameters) -> Result<Self, Problem> {
        Ok(Self { camera: parameters.text("camera").map(str::to_owned) })
    }
}

/// The projection uncertainty of a running session's estimate, as a heat map in the same colors: it
/// darkens as views are added.
#[utoipa::path(get, path = "/v1/sessions/{id}/uncertainty.png", tag = "sessions",
    params(("id" = String, Path, description = "session id"), MemberParameters),
    responses(
        (status = 200, description = "the image", body = Vec<u8>, content_type = "image/png"),
        (status = 404, description = "no such session is running, it has no such camera, or no estimate yet", body = Problem, content_type = "application/problem+json"),
    ))]
pub(super) async fn session_image(
    State(shared): State<Arc<Shared>>,
    Address(id): Address<String>,
    Asked(parameters): Asked<MemberParameters>,
) -> Result<impl IntoResponse, Problem> {
    let live = shared.fleet.live_session(&id);
    let session = live.ok_or_else(|| Problem::not_found(format!("no session {id} is running")))?;
    let asked = parameters.camera.as_ref().filter(|asked| **asked != session.camera);
    let member = session.members.iter().find(|member| Some(&member.camera) == asked);
    if let (Some(asked), None) = (asked, member) {
        return Err(Problem::not_found(format!("session {id} has no camera `{asked}`")));
    }
    let estimate = member.map_or(&session.estimate, |member| &member.estimate).as_ref();
    let map = estimate.and_then(|estimate| estimate.uncertainty_map.clone());
    let map = map.ok_or_else(|| Problem::not_found(format!("session {id} has no estimate yet")))?;
    let png = on_a_blocking_thread(move || drawn(&map)).await?;
    let png = png.ok_or_else(|| Problem::not_found(format!("session {id} has no estimate yet")))?;
    Ok(([(CONTENT_TYPE, "image/png")], png))
}

/// The requested sensor, with its name, and the requested distance.
async fn asked(
    shared: &Shared,
    id: &str,
    parameters: &UncertaintyParameters,
) -> Result<(String, ImageCalibration, Distance), Problem> {
    let distance = parameters.distance_m.map_or(Distance::Infinity, Distance::Meters);
    let found = calibration(shared, id).await?;
    let known: Vec<String> = found.image_sensors().map(|(id, _)| found.name_of(id)).collect();
    let asked = parameters.sensor.as_ref();
    known_name("sensor", asked.map(String::as_str), &known)?;
    let mut sensors = found.image_sensors().map(|(id, sensor)| (found.name_of(id), sensor));
    let sensor = sensors.find(|(name, _)| asked.is_none_or(|asked| asked == name));
    let (name, sensor) = sensor
        .filter(|(_, sensor)| !sensor.lens_covariance.is_empty())
        .ok_or_else(|| unknown(id))?;
    Ok((name, sensor.clone(), distance))
}

fn unknown(id: &str) -> Problem {
    Problem::not_found(format!(
        "calibration {id} has no covariance for this sensor; calibrate again"
    ))
}

fn heat_map(sensor: &ImageCalibration, distance: Distance) -> Option<Vec<u8>> {
    drawn(&sensor_uncertainty(sensor, COLUMNS[1], distance)?)
}

fn drawn(map: &UncertaintyMap) -> Option<Vec<u8>> {
    let (cols, rows) = (map.grid.cols as usize, map.grid.rows as usize);
    let values = GridValues { size: map.grid.size, cols, rows, values: &map.std_px };
    heat_map_png(&values, ONE_SIGMA_PX)
}
