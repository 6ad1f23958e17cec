//! What a camera's lens keeps sharp, and which board suits it.

use std::sync::Arc;

use axum::Json;
use axum::extract::State;

use crate::document::focus::FocusDocument;
use crate::geometry::thin_lens::ThinLens;
use crate::http::problem::Problem;
use crate::http::request::{Address, Parameters};
use crate::http::shared::Shared;
use crate::imaging::frame::SensorKind;

/// What a lens keeps sharp, by the thin-lens model: depth of field, hyperfocal distance, and the
/// board size and distance to use.
#[utoipa::path(get, path = "/v1/cameras/{camera}/focus", tag = "cameras",
    params(
        ("camera" = String, Path, description = "its name in the configuration"),
        ("f_number" = f64, Query, description = "focal length over the aperture's diameter, as in 2.8"),
        ("pixel_um" = f64, Query, description = "the width of one pixel, in micrometers"),
        ("focal_mm" = Option<f64>, Query, description = "focal length, in millimeters; the current calibration's when left out"),
        ("focus_m" = Option<f64>, Query, description = "the distance in focus, in meters; infinity when left out"),
        ("blur_px" = Option<f64>, Query, description = "how wide a point may become and count as sharp; 1 when left out"),
        ("cols" = Option<u32>, Query, description = "inner corners along a row of the board that advice is wanted for"),
    ),
    responses(
        (status = 200, description = "what is sharp", body = FocusDocument),
        (status = 404, description = "no such camera", body = Problem, content_type = "application/problem+json"),
        (status = 409, description = "no frame yet to know the image's width by", body = Problem, content_type = "application/problem+json"),
        (status = 422, description = "a parameter that is missing or cannot be", body = Problem, content_type = "application/problem+json"),
    ))]
pub(super) async fn focus(
    State(shared): State<Arc<Shared>>,
    Address(camera): Address<String>,
    parameters: Parameters,
) -> Result<Json<FocusDocument>, Problem> {
    let status = shared.fleet.camera(&camera)?;
    let needed = |name: &str| {
        let missing = || Problem::field(name, "is missing; give a positive number");
        parameters.positive(name)?.ok_or_else(missing)
    };
    let pixel_m = needed("pixel_um")? * 1e-6;
    let f_number = needed("f_number")?;
    let focus_m = parameters.positive("focus_m")?.unwrap_or(f64::INFINITY);
    let focal_m = match parameters.positive("focal_mm")? {
        Some(focal_mm) => focal_mm * 1e-3,
        None => calibrated_focal_m(&shared, status.calibration, pixel_m, focus_m).await?,
    };
    let lens = ThinLens { focal_m, f_number, pixel_m, focus_m };
    let lens = lens.check().map_err(|e| Problem::field("focus_m", &e.to_string()))?;
    let blur_px = parameters.positive("blur_px")?.unwrap_or(1.0);
    let color = status.sensors.iter().find(|sensor| sensor.kind == SensorKind::Color);
    let board = match parameters.count("cols")? {
        None => None,
        Some(cols) => {
            let unseen = || {
                Problem::conflict(format!(
                    "camera `{camera}` has given no frame yet to know its width by"
                ))
            };
            Some((cols, color.ok_or_else(unseen)?.size.width))
        }
    };
    Ok(Json(FocusDocument::new(&lens, blur_px, board)))
}

/// The focal length that makes the calibrated one in pixels, at this focus: 1/f = 1/(fx · pixel) +
/// 1/focus.
async fn calibrated_focal_m(
    shared: &Shared,
    calibration: Option<String>,
    pixel_m: f64,
    focus_m: f64,
) -> Result<f64, Problem> {
    let missing = || {
        Problem::field("focal_mm", "is missing, and the camera has no calibration to take it from")
    };
    let id = calibration.ok_or_else(missing)?;
    let calibration = shared.stored(move |store| store.calibration(&id)).await?;
    let calibration = calibration.ok_or_else(missing)?;
    let lens = calibration.color().ok_or_else(missing)?.lens;
    Ok(1.0 / (1.0 / (lens.matrix.fx * pixel_m) + 1.0 / focus_m))
}
