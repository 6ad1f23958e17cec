//! What a camera sees now: one picture, or an endless preview.

use std::sync::Arc;

use axum::body::{Body, Bytes};
use axum::extract::State;
use axum::http::header::CONTENT_TYPE;
use axum::response::{IntoResponse, Response};
use futures_util::StreamExt;
use tokio::sync::watch;

use crate::http::problem::Problem;
use crate::http::request::{Address, Parameters};
use crate::http::{Shared, on_a_blocking_thread};
use crate::imaging::decode;
use crate::imaging::frame::{PixelFormat, SensorKind};
use crate::pipeline::live_frame::LiveFrame;

const JPEG_QUALITY: u8 = 85;
const BOUNDARY: &str = "plumb-frame";

/// What to show of a frame.
#[derive(Debug, Clone, Copy)]
struct Look {
    sensor: SensorKind,
    overlay: bool,
    undistorted: bool,
}

/// The newest frame as JPEG.
#[utoipa::path(get, path = "/v1/cameras/{camera}/frame.jpg", tag = "cameras",
    params(
        ("camera" = String, Path, description = "its name in the configuration"),
        ("sensor" = Option<String>, Query, description = "color (when left out), infrared or depth"),
        ("overlay" = Option<bool>, Query, description = "draw the corners that were found and where to hold the board next; false when left out"),
        ("undistorted" = Option<bool>, Query, description = "through the current calibration; false when left out"),
    ),
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
    let jpeg = picture(&camera, live, look).await?;
    Ok(([(CONTENT_TYPE, "image/jpeg")], jpeg).into_response())
}

/// The frames as they come, each drawn over with what was found, as multipart JPEG.
#[utoipa::path(get, path = "/v1/cameras/{camera}/preview.mjpg", tag = "cameras",
    params(
        ("camera" = String, Path, description = "its name in the configuration"),
        ("sensor" = Option<String>, Query, description = "color (when left out), infrared or depth"),
        ("overlay" = Option<bool>, Query, description = "true when left out"),
        ("undistorted" = Option<bool>, Query, description = "through the current calibration; false when left out"),
    ),
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
    let parts = futures_util::stream::unfold((frames, camera), move |(mut frames, camera)| async move {
        let part = next_part(&mut frames, &camera, look).await?;
        Some((Ok::<_, std::convert::Infallible>(part), (frames, camera)))
    });
    let body = Body::from_stream(parts.take_until(stopped));
    let media_type = format!("multipart/x-mixed-replace; boundary={BOUNDARY}");
    Ok(([(CONTENT_TYPE, media_type)], body).into_response())
}

/// The next frame that can be shown; a slow viewer skips those in between.
async fn next_part(frames: &mut watch::Receiver<Option<Arc<LiveFrame>>>, camera: &str, look: Look) -> Option<Bytes> {
    loop {
        frames.changed().await.ok()?;
        let live = frames.borrow_and_update().clone();
        let Some(live) = live else { continue };
        if let Ok(jpeg) = picture(camera, live, look).await {
            let head = format!("--{BOUNDARY}\r\nContent-Type: image/jpeg\r\nContent-Length: {}\r\n\r\n", jpeg.len());
            return Some([head.as_bytes(), &jpeg, b"\r\n"].concat().into());
        }
    }
}

fn look(parameters: &Parameters, overlay: bool) -> Result<Look, Problem> {
    Ok(Look {
        sensor: parameters
            .one_of("sensor", SensorKind::from_name, "color, infrared, depth")?
            .unwrap_or(SensorKind::Color),
        overlay: parameters.flag("overlay", overlay)?,
        undistorted: parameters.flag("undistorted", false)?,
    })
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

async fn picture(camera: &str, live: Arc<LiveFrame>, look: Look) -> Result<Vec<u8>, Problem> {
    let frame = live.frame_set.frame(look.sensor);
    if frame.is_none() {
        let detail = format!("camera `{camera}` has no {} sensor; see GET /v1/cameras/{camera}", look.sensor.name());
        return Err(Problem::not_found(detail));
    }
    on_a_blocking_thread(move || draw(&live, look)).await?
}

fn draw(live: &LiveFrame, look: Look) -> Result<Vec<u8>, Problem> {
    let frame = live.frame_set.frame(look.sensor).ok_or_else(|| Problem::not_found("no such sensor"))?;
    let plain = !look.overlay && !look.undistorted;
    if plain && frame.format == PixelFormat::Jpeg {
        return Ok(frame.bytes.to_vec());
    }
    let picture = decode::rgb(frame).map_err(|e| Problem::conflict(format!("the newest frame cannot be read: {e}")))?;
    Ok(decode::encode_jpeg_rgb(&picture, JPEG_QUALITY))
}
