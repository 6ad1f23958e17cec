//! The board as measured by a calibration, as an image.

use std::sync::Arc;

use axum::extract::State;
use axum::http::header::CONTENT_TYPE;
use axum::response::IntoResponse;

use crate::document::board_shape::BoardShapeDocument;
use crate::http::calibrations::calibration;
use crate::http::problem::Problem;
use crate::http::request::{Address, Asked, Parameters, ReadQuery, known_name};
use crate::http::shared::{Shared, on_a_blocking_thread};
use crate::imaging::draw::board_drawing::{BoardOffsets, board_png};

/// Which sensor's board is asked for.
#[derive(utoipa::IntoParams)]
#[into_params(parameter_in = Query)]
pub(super) struct BoardParameters {
    /// color, infrared, infrared2, or a rig's camera; the first that measured the board when left
    /// out.
    sensor: Option<String>,
}

impl ReadQuery for BoardParameters {
    fn read(parameters: &Parameters) -> Result<Self, Problem> {
        Ok(Self { sensor: parameters.text("sensor").map(str::to_owned) })
    }
}

/// The board as it was measured: heights as colors, offsets in its plane as arrows.
#[utoipa::path(get, path = "/v1/calibrations/{id}/board.png", tag = "calibrations",
    params(("id" = String, Path, description = "calibration id"), BoardParameters),
    responses(
        (status = 200, description = "the image", body = Vec<u8>, content_type = "image/png"),
        (status = 404, description = "no such calibration, or it has no measured board shape", body = Problem, content_type = "application/problem+json"),
        (status = 422, description = "an unknown sensor", body = Problem, content_type = "application/problem+json"),
    ))]
pub(super) async fn board_image(
    State(shared): State<Arc<Shared>>,
    Address(id): Address<String>,
    Asked(asked): Asked<BoardParameters>,
) -> Result<impl IntoResponse, Problem> {
    let found = calibration(&shared, &id).await?;
    let names: Vec<String> =
        found.image_sensors().map(|(sensor, _)| found.name_of(sensor)).collect();
    let asked = asked.sensor.as_ref();
    known_name("sensor", asked.map(String::as_str), &names)?;
    let mut measured = found.image_sensors().zip(&names);
    let shape = measured
        .find_map(|((_, sensor), name)| {
            sensor.board_shape.as_ref().filter(|_| asked.is_none_or(|asked| asked == name))
        })
        .map(BoardShapeDocument::from)
        .ok_or_else(|| unmeasured(&id))?;
    let png = on_a_blocking_thread(move || {
        board_png(BoardOffsets { points: &shape.points, offsets_m: &shape.offsets_m })
    })
    .await?
    .ok_or_else(|| unmeasured(&id))?;
    Ok(([(CONTENT_TYPE, "image/png")], png))
}

fn unmeasured(id: &str) -> Problem {
    Problem::not_found(format!(
        "calibration {id} has no measured board shape: its views show no deviation from a flat board"
    ))
}
