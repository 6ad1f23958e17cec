//! The depth of field of a camera's lens, and the board that suits it.

use std::sync::Arc;

use axum::Json;
use axum::extract::State;

use crate::document::focus::FocusDocument;
use crate::geometry::thin_lens::ThinLens;
use crate::http::problem::Problem;
use crate::http::request::{Address, Asked, Parameters, ReadQuery};
use crate::http::schemas;
use crate::http::shared::Shared;
use crate::imaging::frame::SensorKind;

/// What is known of the lens, and what is asked of it.
#[derive(utoipa::IntoParams)]
#[into_params(parameter_in = Query)]
pub(super) struct FocusParameters {
    /// Focal length over the aperture's diameter, as in 2.8.
    #[param(minimum = 0.1, maximum = 1000.0)]
    f_number: f64,
    /// The width of one pixel, in micrometers.
    #[param(minimum = 0.01, maximum = 1000.0)]
    pixel_um: f64,
    /// Focal length, in millimeters; default: the current calibration's.
    #[param(schema_with = schemas::focal_mm, required = false)]
    focal_mm: Option<f64>,
    /// The distance in focus, in meters; default: infinity.
    #[param(schema_with = schemas::focus_m, required = false)]
    focus_m: Option<f64>,
    /// Largest acceptable circle of confusion, in pixels; default: 1.
    #[param(schema_with = schemas::blur_px, required = false)]
    blur_px: Option<f64>,
    /// Inner corners along a row of the board to be recommended.
    #[param(schema_with = schemas::count, required = false)]
    cols: Option<u32>,
}

impl ReadQuery for FocusParameters {
    fn read(parameters: &Parameters) -> Result<Self, Problem> {
        let needed = |name: &str, range| {
            let missing = || Problem::field(name, "is missing; give a positive number");
            parameters.within(name, range)?.ok_or_else(missing)
        };
        Ok(Self {
            pixel_um: needed("pixel_um", schemas::PIXEL_UM)?,
            f_number: needed("f_number", schemas::F_NUMBER)?,
            focus_m: parameters.within("focus_m", schemas::FOCUS_M)?,
            focal_mm: parameters.within("focal_mm", schemas::FOCAL_MM)?,
            blur_px: parameters.within("blur_px", schemas::BLUR_PX)?,
            cols: parameters.count("cols")?,
        })
    }
}

/// What a lens keeps sharp, by the thin-lens model: depth of field, hyperfocal distance, and the
/// board size and distance to use.
#[utoipa::path(get, path = "/v1/cameras/{camera}/focus", tag = "cameras",
    params(
        ("camera" = String, Path, description = "its name in the configuration"),
        FocusParameters,
    ),
    responses(
        (status = 200, description = "depth of field, and the recommended board", body = FocusDocument),
        (status = 404, description = "no such camera", body = Problem, content_type = "application/problem+json"),
        (status = 409, description = "no frame yet to know the image's width by", body = Problem, content_type = "application/problem+json"),
        (status = 422, description = "a missing or invalid parameter", body = Problem, content_type = "application/problem+json"),
    ))]
pub(super) async fn focus(
    State(shared): State<Arc<Shared>>,
    Address(camera): Address<String>,
    Asked(asked): Asked<FocusParameters>,
) -> Result<Json<FocusDocument>, Problem> {
    let status = shared.fleet.camera(&camera)?;
    let pixel_m = asked.pixel_um * 1e-6;
    let f_number = asked.f_number;
    let focus_m = asked.focus_m.unwrap_or(f64::INFINITY);
    let focal_m = match asked.focal_mm {
        Some(focal_mm) => focal_mm * 1e-3,
        None => calibrated_focal_m(&shared, status.calibration, pixel_m, focus_m).await?,
    };
    let lens = ThinLens { focal_m, f_number, pixel_m, focus_m };
    let lens = lens.check().map_err(|e| Problem::field("focus_m", &e.to_string()))?;
    let blur_px = asked.blur_px.unwrap_or(1.0);
    let color = status.sensors.iter().find(|sensor| sensor.kind == SensorKind::Color);
    let board = match asked.cols {
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

/// The focal length for which the calibrated one in pixels results at this focus distance: 1/f =
/// 1/(fx · pixel) + 1/focus.
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
