//! What a camera sees now: one image, or an endless preview.

use std::convert::Infallible;
use std::sync::Arc;

use axum::body::{Body, Bytes};
use axum::extract::State;
use axum::http::header::CONTENT_TYPE;
use axum::http::{HeaderMap, HeaderName, HeaderValue};
use axum::response::{IntoResponse, Response};
use futures_util::StreamExt;

use crate::http::problem::Problem;
use crate::http::request::{Address, Asked, Parameters, ReadQuery};
use crate::http::schemas;
use crate::http::shared::{Shared, on_a_blocking_thread};
use crate::imaging::frame::SensorKind;
use crate::pipeline::preview::PreviewReceiver;
use crate::pipeline::preview::drawing::Drawing;

const BOUNDARY: &str = "plumb-frame";

/// What of a frame is asked for.
#[derive(utoipa::IntoParams)]
#[into_params(parameter_in = Query)]
pub(super) struct DrawingParameters {
    /// color (default), infrared, infrared2 (the right one of two) or depth.
    #[param(schema_with = schemas::sensor_kind, required = false)]
    sensor: Option<SensorKind>,
    /// Draw the corners that were found, and with `registered=color` the edges of depth over
    /// color. When left out: false for an image, true for the preview.
    overlay: Option<bool>,
    /// Draw where to hold the board next; default: as `overlay`.
    guidance: Option<bool>,
    /// Undistort with the current calibration; default: false.
    undistorted: Option<bool>,
    /// Rectify as one image of a stereo pair, with the current calibration of the camera's rig (or
    /// of its two infrared sensors); default: false.
    rectified: Option<bool>,
    /// Free scaling parameter of undistorted or rectified images, as in OpenCV. 0 (default): only
    /// valid pixels; 1: all source pixels are retained.
    #[param(schema_with = schemas::alpha, required = false)]
    alpha: Option<f64>,
    /// With `sensor=depth`, color: depth in color's image; with `sensor=color`, depth: color in
    /// depth's image. By the current calibration.
    #[param(schema_with = schemas::sensor_kind, required = false)]
    registered: Option<SensorKind>,
}

impl ReadQuery for DrawingParameters {
    fn read(parameters: &Parameters) -> Result<Self, Problem> {
        let known = SensorKind::ALL.map(SensorKind::name).join(", ");
        Ok(Self {
            sensor: parameters.one_of("sensor", SensorKind::from_name, &known)?,
            overlay: parameters.flag("overlay")?,
            guidance: parameters.flag("guidance")?,
            undistorted: parameters.flag("undistorted")?,
            rectified: parameters.flag("rectified")?,
            alpha: parameters.fraction("alpha")?,
            registered: parameters.one_of("registered", SensorKind::from_name, "color, depth")?,
        })
    }
}

/// The newest frame as JPEG.
#[utoipa::path(get, path = "/v1/cameras/{camera}/frame.jpg", tag = "cameras",
    params(("camera" = String, Path, description = "its name in the configuration"), DrawingParameters),
    responses(
        (status = 200, description = "the image", body = Vec<u8>, content_type = "image/jpeg", headers(("Plumb-Stale" = String, description = "why the camera gives nothing newer; none while it does"))),
        (status = 404, description = "no such camera, or no image of such a sensor has come from it", body = Problem, content_type = "application/problem+json"),
        (status = 409, description = "no frame yet, no image of the sensor in the newest frames, or no calibration to undistort or rectify with", body = Problem, content_type = "application/problem+json"),
        (status = 422, description = "an unknown sensor, or an alpha that is not from 0 to 1", body = Problem, content_type = "application/problem+json"),
    ))]
pub(super) async fn frame(
    State(shared): State<Arc<Shared>>,
    Address(camera): Address<String>,
    Asked(parameters): Asked<DrawingParameters>,
) -> Result<Response, Problem> {
    let drawing = drawing(&parameters, false)?;
    let (fleet, stale) = (Arc::clone(&shared.fleet), stale(&shared, &camera));
    let jpeg = on_a_blocking_thread(move || fleet.newest_frame(&camera, drawing)).await??;
    Ok((stale, [(CONTENT_TYPE, "image/jpeg")], Bytes::from_owner(jpeg)).into_response())
}

/// A header for an answer with the newest frame of `camera`: the reason why the camera delivers
/// nothing newer at present.
pub(super) fn stale(shared: &Shared, camera: &str) -> HeaderMap {
    let reason = shared.fleet.why_nothing_newer(camera);
    // A header may contain printable ASCII only.
    let printable = |reason: String| reason.replace(|c: char| !(' '..='~').contains(&c), "?");
    let reason = reason.and_then(|reason| HeaderValue::from_str(&printable(reason)).ok());
    reason.map(|reason| (HeaderName::from_static("plumb-stale"), reason)).into_iter().collect()
}

/// The frames as they come, each drawn over with what was found, as multipart JPEG.
///
/// A request that cannot be shown is refused as by `frame.jpg`; before the first frame it waits.
#[utoipa::path(get, path = "/v1/cameras/{camera}/preview.mjpg", tag = "cameras",
    params(("camera" = String, Path, description = "its name in the configuration"), DrawingParameters),
    responses(
        (status = 200, description = "an endless image", body = Vec<u8>, content_type = "multipart/x-mixed-replace"),
        (status = 404, description = "no such camera, or no image of such a sensor has come from it", body = Problem, content_type = "application/problem+json"),
        (status = 409, description = "no calibration to undistort, rectify or register with, or one of images of another size", body = Problem, content_type = "application/problem+json"),
        (status = 422, description = "an unknown sensor, or an alpha that is not from 0 to 1", body = Problem, content_type = "application/problem+json"),
        (status = 503, description = "too many previews are open", body = Problem, content_type = "application/problem+json"),
    ))]
pub(super) async fn preview(
    State(shared): State<Arc<Shared>>,
    Address(camera): Address<String>,
    headers: HeaderMap,
    Asked(parameters): Asked<DrawingParameters>,
) -> Result<Response, Problem> {
    let drawing = drawing(&parameters, true)?;
    let (fleet, asked) = (Arc::clone(&shared.fleet), camera.clone());
    let newest = on_a_blocking_thread(move || fleet.newest_frame(&asked, drawing)).await?;
    if let Err(error) = newest
        && !error.is_of_one_frame()
    {
        return Err(error.into());
    }
    let frames = shared.fleet.preview(&camera, drawing)?;
    let place = shared.stream_place()?;
    let parts = futures_util::stream::unfold((frames, place), |(mut frames, place)| async move {
        let part = next_part(&mut frames).await?;
        Some((futures_util::stream::iter(part.map(Ok::<_, Infallible>)), (frames, place)))
    });
    let first = Bytes::from(format!("--{BOUNDARY}\r\n"));
    let first = futures_util::stream::once(std::future::ready(Ok(first)));
    let body = Body::from_stream(first.chain(parts.flatten()).take_until(shared.ended(&headers)));
    let media_type = format!("multipart/x-mixed-replace; boundary={BOUNDARY}");
    Ok(([(CONTENT_TYPE, media_type)], body).into_response())
}

/// The next frame that can be shown; a slow client skips those in between.
async fn next_part(frames: &mut PreviewReceiver) -> Option<[Bytes; 3]> {
    loop {
        frames.changed().await.ok()?;
        let Some(jpeg) = frames.borrow_and_update().clone() else { continue };
        let head = format!("Content-Type: image/jpeg\r\nContent-Length: {}\r\n\r\n", jpeg.len());
        // A browser shows an image only once it has received the boundary after it, so that is sent
        // now and not with the next frame.
        let tail = format!("\r\n--{BOUNDARY}\r\n");
        return Some([head.into(), Bytes::from_owner(jpeg), tail.into()]);
    }
}

fn drawing(asked: &DrawingParameters, overlay: bool) -> Result<Drawing, Problem> {
    let overlay = asked.overlay.unwrap_or(overlay);
    let sensor = asked.sensor.unwrap_or(SensorKind::Color);
    let undistorted = asked.undistorted.unwrap_or(false);
    let rectified = asked.rectified.unwrap_or(false);
    if asked.alpha.is_some() && !undistorted && !rectified {
        let problem = "applies only to undistorted or rectified images; add undistorted=true or rectified=true";
        return Err(Problem::field("alpha", problem));
    }
    Ok(Drawing {
        sensor,
        overlay,
        guidance: asked.guidance.unwrap_or(overlay),
        undistorted,
        rectified,
        alpha: asked.alpha.unwrap_or_default(),
        registered: registered(asked, sensor)?,
    })
}

/// Whether the sensor is to be shown registered to the other one's image.
fn registered(asked: &DrawingParameters, sensor: SensorKind) -> Result<bool, Problem> {
    let Some(to) = asked.registered else { return Ok(false) };
    if asked.rectified == Some(true) {
        return Err(Problem::field(
            "rectified",
            "cannot be combined with `registered`; give only one",
        ));
    }
    match (sensor, to) {
        (SensorKind::Depth, SensorKind::Color) | (SensorKind::Color, SensorKind::Depth) => Ok(true),
        _ => {
            let problem = "shows depth in color's image (sensor=depth&registered=color) or color in depth's (sensor=color&registered=depth)";
            Err(Problem::field("registered", problem))
        }
    }
}
