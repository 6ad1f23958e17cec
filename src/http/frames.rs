//! What a camera sees now: one picture, or an endless preview.

use std::sync::Arc;

use axum::body::{Body, Bytes};
use axum::extract::State;
use axum::http::header::CONTENT_TYPE;
use axum::response::{IntoResponse, Response};
use futures_util::StreamExt;
use tokio::sync::watch;

use crate::geometry::pixel::Pixel;
use crate::http::problem::Problem;
use crate::http::registered::{self, registration};
use crate::http::request::{Address, Parameters};
use crate::http::undistorted::undistortion;
use crate::http::{Shared, on_a_blocking_thread};
use crate::imaging::decode::{self, DecodeError};
use crate::imaging::draw::{self, Pen};
use crate::imaging::frame::{PixelFormat, SensorKind};
use crate::imaging::remap::Interpolation;
use crate::imaging::undistort::Undistortion;
use crate::pipeline::live_frame::LiveFrame;

const JPEG_QUALITY: u8 = 85;
const BOUNDARY: &str = "plumb-frame";

/// What to show of a frame.
#[derive(Debug, Clone, Copy)]
struct Look {
    sensor: SensorKind,
    overlay: bool,
    guidance: bool,
    undistorted: bool,
    /// Depth in color's picture, or color in depth's.
    registered: bool,
}

/// What of a frame is asked for.
#[derive(utoipa::IntoParams)]
#[into_params(parameter_in = Query)]
#[expect(dead_code, reason = "describes the query; Parameters reads it")]
struct LookParameters {
    /// color (when left out), infrared, infrared2 (the right one of two) or depth.
    sensor: Option<String>,
    /// Draw the corners that were found, and with `registered=color` the edges of depth over
    /// color. When left out: false for a picture, true for the preview.
    overlay: Option<bool>,
    /// Draw where to hold the board next; as `overlay` when left out.
    guidance: Option<bool>,
    /// Through the current calibration; false when left out.
    undistorted: Option<bool>,
    /// With `sensor=depth`, color: depth in color's picture; with `sensor=color`, depth: color in
    /// depth's picture. By the current calibration.
    registered: Option<String>,
}

/// The newest frame as JPEG.
#[utoipa::path(get, path = "/v1/cameras/{camera}/frame.jpg", tag = "cameras",
    params(("camera" = String, Path, description = "its name in the configuration"), LookParameters),
    responses(
        (status = 200, description = "the picture", body = Vec<u8>, content_type = "image/jpeg"),
        (status = 404, description = "no such camera, or it has no such sensor", body = Problem, content_type = "application/problem+json"),
        (status = 409, description = "no frame yet, or no calibration to undistort with", body = Problem, content_type = "application/problem+json"),
        (status = 422, description = "an unknown sensor", body = Problem, content_type = "application/problem+json"),
    ))]
pub(super) async fn frame(
    State(shared): State<Arc<Shared>>,
    Address(camera): Address<String>,
    parameters: Parameters,
) -> Result<Response, Problem> {
    let look = look(&parameters, false)?;
    let newest = shared.fleet.frames(&camera)?.borrow().clone();
    let live = match newest {
        Some(live) => live,
        None => return Err(no_frame(&shared, &camera)),
    };
    let jpeg = picture(&shared, &camera, live, look).await?;
    Ok(([(CONTENT_TYPE, "image/jpeg")], jpeg).into_response())
}

/// The frames as they come, each drawn over with what was found, as multipart JPEG.
#[utoipa::path(get, path = "/v1/cameras/{camera}/preview.mjpg", tag = "cameras",
    params(("camera" = String, Path, description = "its name in the configuration"), LookParameters),
    responses(
        (status = 200, description = "an endless picture", body = Vec<u8>, content_type = "multipart/x-mixed-replace"),
        (status = 404, description = "no such camera", body = Problem, content_type = "application/problem+json"),
        (status = 422, description = "an unknown sensor", body = Problem, content_type = "application/problem+json"),
    ))]
pub(super) async fn preview(
    State(shared): State<Arc<Shared>>,
    Address(camera): Address<String>,
    parameters: Parameters,
) -> Result<Response, Problem> {
    let look = look(&parameters, true)?;
    let mut frames = shared.fleet.frames(&camera)?;
    // The newest frame is shown at once, and not only the next one.
    frames.mark_changed();
    let stopped = shared.stopped();
    let parts = futures_util::stream::unfold(
        (frames, shared, camera),
        move |(mut frames, shared, camera)| async move {
            let part = next_part(&mut frames, &shared, &camera, look).await?;
            Some((Ok::<_, std::convert::Infallible>(part), (frames, shared, camera)))
        },
    );
    let first = futures_util::stream::once(std::future::ready(Ok(Bytes::from(format!(
        "--{BOUNDARY}\r\n"
    )))));
    let body = Body::from_stream(first.chain(parts).take_until(stopped));
    let media_type = format!("multipart/x-mixed-replace; boundary={BOUNDARY}");
    Ok(([(CONTENT_TYPE, media_type)], body).into_response())
}

/// The next frame that can be shown; a slow viewer skips those in between.
async fn next_part(
    frames: &mut watch::Receiver<Option<Arc<LiveFrame>>>,
    shared: &Shared,
    camera: &str,
    look: Look,
) -> Option<Bytes> {
    loop {
        frames.changed().await.ok()?;
        let live = frames.borrow_and_update().clone();
        let Some(live) = live else { continue };
        if let Ok(jpeg) = picture(shared, camera, live, look).await {
            let head =
                format!("Content-Type: image/jpeg\r\nContent-Length: {}\r\n\r\n", jpeg.len());
            // A browser shows a picture when it meets the boundary after it: it is not kept waiting
            // for the next one.
            let tail = format!("\r\n--{BOUNDARY}\r\n");
            return Some([head.as_bytes(), &jpeg, tail.as_bytes()].concat().into());
        }
    }
}

fn look(parameters: &Parameters, overlay: bool) -> Result<Look, Problem> {
    let overlay = parameters.flag("overlay", overlay)?;
    let sensor =
        parameters.one_of("sensor", SensorKind::from_name, "color, infrared, infrared2, depth")?;
    let sensor = sensor.unwrap_or(SensorKind::Color);
    Ok(Look {
        sensor,
        overlay,
        guidance: parameters.flag("guidance", overlay)?,
        undistorted: parameters.flag("undistorted", false)?,
        registered: registered(parameters, sensor)?,
    })
}

/// Whether the sensor is to be shown in the other one's picture.
fn registered(parameters: &Parameters, sensor: SensorKind) -> Result<bool, Problem> {
    let Some(to) = parameters.one_of("registered", SensorKind::from_name, "color, depth")? else {
        return Ok(false);
    };
    match (sensor, to) {
        (SensorKind::Depth, SensorKind::Color) | (SensorKind::Color, SensorKind::Depth) => Ok(true),
        _ => {
            let problem = "shows depth in color's picture (sensor=depth&registered=color) or color in depth's (sensor=color&registered=depth)";
            Err(Problem::field("registered", problem))
        }
    }
}

fn no_frame(shared: &Shared, camera: &str) -> Problem {
    let said = match shared.fleet.camera(camera) {
        Ok(status) => match status.reason {
            Some(reason) => format!("it is {}: {reason}", status.state.name()),
            None => format!("it is {}; ask again in a moment", status.state.name()),
        },
        Err(unknown) => return unknown.into(),
    };
    Problem::conflict(format!("camera `{camera}` has given no frame yet: {said}"))
}

/// Where the running session wants the board next, where that is to be drawn.
fn wish(shared: &Shared, camera: &str, look: Look) -> Vec<Pixel> {
    let shown = look.guidance && look.sensor == SensorKind::Color && !look.undistorted;
    let session = shown.then(|| shared.fleet.camera(camera).ok()?.session).flatten();
    let record = session.and_then(|id| shared.fleet.live_session(&id));
    record.map(|record| record.guidance.outline_px.clone()).unwrap_or_default()
}

async fn picture(
    shared: &Shared,
    camera: &str,
    live: Arc<LiveFrame>,
    look: Look,
) -> Result<Vec<u8>, Problem> {
    if live.frame_set.frame(look.sensor).is_none() {
        let detail = format!(
            "camera `{camera}` has no {} sensor; see GET /v1/cameras/{camera}",
            look.sensor.name()
        );
        return Err(Problem::not_found(detail));
    }
    if look.registered {
        let registration = registration(shared, camera).await?;
        let shown = on_a_blocking_thread(move || match look.sensor {
            SensorKind::Depth => {
                registered::depth_in_color(&registration, &live.frame_set, look.overlay)
            }
            _ => registered::color_in_depth(&registration, &live.frame_set),
        });
        return Ok(decode::encode_jpeg_rgb(&shown.await??, JPEG_QUALITY));
    }
    let wish = wish(shared, camera, look);
    let undistortion = match look.undistorted {
        true => Some(undistortion(shared, camera, look.sensor).await?),
        false => None,
    };
    on_a_blocking_thread(move || drawn(&live, look, &wish, undistortion.as_deref())).await?
}

fn drawn(
    live: &LiveFrame,
    look: Look,
    wish: &[Pixel],
    undistortion: Option<&Undistortion>,
) -> Result<Vec<u8>, Problem> {
    let frame =
        live.frame_set.frame(look.sensor).ok_or_else(|| Problem::not_found("no such sensor"))?;
    if look.sensor == SensorKind::Depth {
        return Ok(decode::encode_jpeg_rgb(
            &registered::shaded_depth(&live.frame_set)?,
            JPEG_QUALITY,
        ));
    }
    let seen = live.look.as_ref().and_then(|look| look.outcome.as_ref().ok());
    let seen = seen.filter(|_| look.overlay && look.sensor == SensorKind::Color);
    let plain = seen.is_none() && wish.is_empty() && !look.undistorted;
    if plain && frame.format == PixelFormat::Jpeg {
        return Ok(frame.bytes.to_vec());
    }
    let unreadable =
        |e: DecodeError| Problem::conflict(format!("the newest frame cannot be read: {e}"));
    let mut picture = decode::rgb(frame).map_err(unreadable)?;
    let pen = Pen::fitting(&picture, draw::WISHED);
    draw::draw_polygon(&mut picture, wish, Pen { width_px: 2.0 * pen.width_px, ..pen });
    if let Some(detection) = seen {
        let corners: Vec<Pixel> = detection.corners.iter().map(|corner| corner.pixel).collect();
        draw::draw_corners(&mut picture, &corners);
    }
    if let Some(undistortion) = undistortion {
        let other_size = || {
            Problem::conflict(
                "the current calibration is for pictures of another size; calibrate again",
            )
        };
        picture = undistortion.map.rgb(&picture, Interpolation::Bilinear).ok_or_else(other_size)?;
    }
    Ok(decode::encode_jpeg_rgb(&picture, JPEG_QUALITY))
}
