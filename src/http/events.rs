//! Server-sent events, which can be resumed.

use std::convert::Infallible;
use std::sync::Arc;
use std::time::Duration;

use axum::extract::State;
use axum::http::HeaderMap;
use axum::response::sse::{Event as SentEvent, KeepAlive, Sse};
use futures_util::{Stream, StreamExt};
use serde::Serialize;
use tokio::sync::OwnedSemaphorePermit;
use utoipa::ToSchema;

use crate::calibration::drift::Drift;
use crate::document::image_sensor::UncertaintyDocument;
use crate::document::session::SessionDocument;
use crate::document::time;
use crate::document::verdict::GradeName;
use crate::http::cameras::camera_document;
use crate::http::problem::Problem;
use crate::http::request::Parameters;
use crate::http::shared::Shared;
use crate::pipeline::event::{
    CalibrationEvent, DetectionEvent, Event, EventKind, EventStream, FrameEvent,
};

/// How long a client waits before it connects again.
const RETRY: Duration = Duration::from_secs(1);
/// The interval of keep-alive messages on a silent connection.
const KEEP_ALIVE: Duration = Duration::from_secs(10);

/// Server-sent events: `frame`, `detection`, `session`, `calibration`, `camera`, `drift`. Each has
/// an `id`; a client that sends the last one it saw as `Last-Event-ID` receives the missed events
/// that are still buffered.
#[utoipa::path(get, path = "/v1/events", tag = "events",
    params(
        ("camera" = Option<String>, Query, description = "only events of this camera and of the rigs it belongs to; or only those of this rig, without those of its cameras"),
        ("Last-Event-ID" = Option<u64>, Header, description = "the last event that was seen"),
    ),
    responses(
        (status = 200, description = "an endless stream", body = String, content_type = "text/event-stream"),
        (status = 404, description = "no such camera", body = Problem, content_type = "application/problem+json"),
        (status = 503, description = "too many event streams are open", body = Problem, content_type = "application/problem+json"),
    ))]
pub(super) async fn follow(
    State(shared): State<Arc<Shared>>,
    headers: HeaderMap,
    parameters: Parameters,
) -> Result<Sse<impl Stream<Item = Result<SentEvent, Infallible>>>, Problem> {
    let camera = parameters.text("camera").map(str::to_owned);
    if let Some(camera) = &camera
        && shared.fleet.rig(camera).is_err()
    {
        shared.fleet.camera(camera)?;
    }
    // An id that cannot be read counts as no id, as clients expect from the standard.
    let last_seen =
        headers.get("last-event-id").and_then(|id| id.to_str().ok()?.trim().parse().ok());
    let stream = futures_util::stream::unfold(
        (shared.fleet.events(last_seen), shared.stream_place()?),
        |(mut stream, place): (EventStream, OwnedSemaphorePermit)| async move {
            let event = stream.next().await;
            Some((event, (stream, place)))
        },
    );
    let fleet = Arc::clone(&shared.fleet);
    let wanted = move |event: &Arc<Event>| {
        let concerns = |camera: &String| {
            let in_rig = |name: &str| fleet.rig(name).is_ok_and(|rig| rig.cameras.contains(camera));
            match &event.kind {
                EventKind::Session(record) => record.is_of(camera),
                _ => event.camera == *camera || in_rig(&event.camera),
            }
        };
        std::future::ready(camera.as_ref().is_none_or(concerns))
    };
    let hello = futures_util::stream::once(std::future::ready(Ok(SentEvent::default()
        .retry(RETRY)
        .comment("events"))));
    let sent = stream.filter(wanted).map(|event| Ok(sent_event(&event)));
    let sent = hello.chain(sent).take_until(shared.ended(&headers));
    Ok(Sse::new(sent).keep_alive(KeepAlive::new().interval(KEEP_ALIVE)))
}

fn sent_event(event: &Event) -> SentEvent {
    let json = match &event.kind {
        EventKind::Frame(frame) => json(&frame_document(&event.camera, frame)),
        EventKind::Detection(detection) => json(&detection_document(&event.camera, detection)),
        EventKind::Session(record) => json(&SessionDocument::from(record.as_ref())),
        EventKind::Calibration(calibration) => {
            json(&calibration_document(&event.camera, calibration))
        }
        EventKind::Camera(status) => json(&camera_document(status)),
        EventKind::Drift(drift) => json(&drift_document(&event.camera, drift)),
    };
    SentEvent::default().id(event.id.to_string()).event(event.kind.name()).data(json)
}

fn json<T: Serialize>(document: &T) -> String {
    crate::document::reading::to_json(document).unwrap_or_default()
}

/// A frame set was taken (`frame`).
#[derive(Debug, Serialize, ToSchema)]
pub(super) struct FrameEventDocument<'a> {
    /// The camera's name.
    camera: &'a str,
    /// The frame set's number; a gap is a lost one.
    sequence: u64,
    /// When the host received it.
    #[schema(value_type = String, format = DateTime)]
    received_at: jiff::Timestamp,
    /// When the device took it, nanoseconds of its own clock; null where it does not say.
    device_time_ns: Option<i64>,
    /// Frame sets lost so far.
    dropped_frames: u64,
}

fn frame_document<'a>(camera: &'a str, event: &FrameEvent) -> FrameEventDocument<'a> {
    FrameEventDocument {
        camera,
        sequence: event.sequence,
        received_at: time::from_utc_ns(event.host_time_ns),
        device_time_ns: event.device_time_ns,
        dropped_frames: event.dropped_frames,
    }
}

/// What a session made of a frame (`detection`).
#[derive(Debug, Serialize, ToSchema)]
pub(super) struct DetectionEventDocument<'a> {
    /// The camera's name.
    camera: &'a str,
    /// The session that searched.
    session: &'a str,
    /// The frame set's number.
    sequence: u64,
    /// Whether the board was found.
    found: bool,
    /// The corners in the board's order; empty if not found.
    corners: Vec<[f64; 2]>,
    /// Which corner of the board each is: `[col, row]`.
    indices: Vec<[i32; 2]>,
    /// The number of each on a board with markers, as `plumb detect` has it; left out of a
    /// chessboard, and if none was found.
    #[serde(skip_serializing_if = "Option::is_none")]
    ids: Option<&'a [u32]>,
    /// The number of the view it became; null if it was not kept.
    kept_view: Option<u32>,
    /// Why it was not kept, as counted in the session's `rejected`; null if it was kept.
    rejection: Option<&'a str>,
    /// The same in words.
    reason: Option<&'a str>,
    /// What decoding and detection took, in milliseconds.
    elapsed_ms: f64,
}

fn detection_document<'a>(
    camera: &'a str,
    event: &'a DetectionEvent,
) -> DetectionEventDocument<'a> {
    DetectionEventDocument {
        camera,
        session: &event.session,
        sequence: event.sequence,
        found: event.found,
        corners: event.corners_px.iter().map(|pixel| [pixel.x, pixel.y]).collect(),
        indices: event.indices.iter().map(|index| [index.col, index.row]).collect(),
        ids: event.ids.as_deref(),
        kept_view: event.kept_view,
        rejection: event.rejection,
        reason: event.reason.as_deref(),
        elapsed_ms: event.elapsed_ms,
    }
}

/// A calibration was made or became current (`calibration`).
#[derive(Debug, Serialize, ToSchema)]
pub(super) struct CalibrationEventDocument<'a> {
    /// The camera's name.
    camera: &'a str,
    /// Its id.
    id: &'a str,
    /// The session it came from.
    session: Option<&'a str>,
    /// Whether it is the camera's current one now.
    current: bool,
    /// How far to trust it.
    grade: GradeName,
    /// Its reprojection error, in pixels.
    rms_px: f64,
    /// Its uncertainty over the image.
    uncertainty_px: UncertaintyDocument,
}

fn calibration_document<'a>(
    camera: &'a str,
    event: &'a CalibrationEvent,
) -> CalibrationEventDocument<'a> {
    CalibrationEventDocument {
        camera,
        id: &event.id,
        session: event.session.as_deref(),
        current: event.current,
        grade: event.grade.into(),
        rms_px: event.rms_px,
        uncertainty_px: event.uncertainty_px.into(),
    }
}

/// The current calibration may not hold any more (`drift`): the device's focus, zoom or exposure
/// was moved, it is another device or gives images of another size, or the boards of a later
/// session are explained worse than they should be.
#[derive(Debug, Serialize, ToSchema)]
pub(super) struct DriftEventDocument<'a> {
    /// The camera's name, or the rig's.
    camera: &'a str,
    /// The current calibration.
    calibration: &'a str,
    /// What has changed and what to do.
    reason: &'a str,
    /// The reprojection error of the boards seen lately, with only their poses fitted, in pixels;
    /// null where no boards were compared.
    rms_px: Option<f64>,
    /// What the calibration had when it was made, in pixels.
    expected_px: f64,
}

fn drift_document<'a>(camera: &'a str, drift: &'a Drift) -> DriftEventDocument<'a> {
    let Drift { calibration, reason, rms_px, expected_px } = drift;
    DriftEventDocument { camera, calibration, reason, rms_px: *rms_px, expected_px: *expected_px }
}
