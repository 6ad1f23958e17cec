//! Calibrations: a camera's current one in any format, the history, approval.

use std::sync::Arc;

use axum::Json;
use axum::extract::State;
use axum::http::header::{CONTENT_DISPOSITION, CONTENT_TYPE};
use axum::http::{HeaderMap, HeaderName, HeaderValue, StatusCode};
use axum::response::{IntoResponse, Response};

use crate::calibration::result::Calibration;
use crate::calibration::stated_calibration::stated_calibration;
use crate::calibration::stereo_pair::StereoPairError;
use crate::document::calibration::{CalibrationDocument, CalibrationsDocument};
use crate::document::time;
use crate::export::other_images::{OtherImages, OtherImagesError, for_other_images};
use crate::export::{ExportError, ExportOptions, Exported, Format, export};
use crate::geometry::image_region::{ImageRegion, RegionError};
use crate::geometry::pixel::ImageSize;
use crate::http::pages::{PageParameters, PageRefusals};
use crate::http::problem::Problem;
use crate::http::request::{Address, Asked, Parameters, ReadQuery};
use crate::http::schemas;
use crate::http::shared::{Shared, on_a_blocking_thread};
use crate::store::Store;

/// How a calibration is to be written.
#[derive(utoipa::IntoParams)]
#[into_params(parameter_in = Query)]
pub(super) struct ExportParameters {
    /// The format; default: json. Its schema says what each is.
    #[param(schema_with = schemas::format, required = false)]
    format: Option<Format>,
    /// The sensor, for formats with a single sensor: color (default), infrared, infrared2, depth,
    /// or a camera of a rig. Stereo formats take two, as `left,right` (default: the two cameras of
    /// a rig); kalibr takes several, in chain order.
    #[param(min_length = 1)]
    sensor: Option<String>,
    /// For ros, ros_stereo and opencv_stereo: free scaling parameter of the rectified image, as in
    /// OpenCV. 0 (default): only valid pixels; 1: all source pixels are retained.
    #[param(schema_with = schemas::alpha, required = false)]
    alpha: Option<f64>,
    /// Convert to images scaled to this width (after `crop`).
    #[param(schema_with = schemas::count, required = false)]
    width: Option<u32>,
    /// Convert to images scaled to this height.
    #[param(schema_with = schemas::count, required = false)]
    height: Option<u32>,
    /// Convert to images cropped to `left,top,width,height` (pixels of the original images); with
    /// several sensors, of the one that `sensor` names.
    #[param(schema_with = schemas::region, required = false)]
    crop: Option<ImageRegion>,
}

impl ReadQuery for ExportParameters {
    fn read(parameters: &Parameters) -> Result<Self, Problem> {
        let known = Format::ALL.map(Format::name).join(", ");
        let crop = parameters.text("crop").map(str::parse::<ImageRegion>).transpose();
        Ok(Self {
            format: parameters.one_of("format", Format::from_name, &known)?,
            sensor: parameters.text("sensor").map(str::to_owned),
            alpha: parameters.fraction("alpha")?,
            width: parameters.count("width")?,
            height: parameters.count("height")?,
            crop: crop.map_err(|error| Problem::field("crop", &error.to_string()))?,
        })
    }
}

/// The camera's current calibration: the one that was approved last.
#[utoipa::path(get, path = "/v1/cameras/{camera}/calibration", tag = "calibrations",
    params(("camera" = String, Path, description = "its name in the configuration"), ExportParameters),
    responses(
        (status = 200, description = "the calibration", content(
            (CalibrationDocument = "application/json"), (String = "application/yaml"), (String = "application/xml"), (String = "text/plain"))),
        (status = 404, description = "no such camera, or none approved yet", body = Problem, content_type = "application/problem+json"),
        (status = 422, description = "an unknown format, or one that cannot hold this lens", body = Problem, content_type = "application/problem+json"),
    ))]
pub(super) async fn current(
    State(shared): State<Arc<Shared>>,
    Address(camera): Address<String>,
    Asked(parameters): Asked<ExportParameters>,
) -> Result<Response, Problem> {
    shared.fleet.camera(&camera)?;
    current_of(&shared, &format!("camera `{camera}`"), &camera, parameters).await
}

/// The current calibration of the camera or rig `name`, in the requested format; `who` is its name
/// in messages.
pub(super) async fn current_of(
    shared: &Shared,
    who: &str,
    name: &str,
    parameters: ExportParameters,
) -> Result<Response, Problem> {
    let asked = name.to_owned();
    let found = shared
        .stored(move |store| {
            store.current_calibration_id(&asked)?.map_or(Ok(None), |id| store.calibration(&id))
        })
        .await?;
    let none = || {
        Problem::not_found(format!(
            "{who} has no approved calibration; run a session, or approve one with POST /v1/calibrations/ID/approve"
        ))
    };
    written(found.ok_or_else(none)?, parameters).await
}

/// The factory calibration that the device reports, in any format: as reported, not verified by
/// measurement.
#[utoipa::path(get, path = "/v1/cameras/{camera}/factory", tag = "calibrations",
    params(("camera" = String, Path, description = "its name in the configuration"), ExportParameters),
    responses(
        (status = 200, description = "the factory calibration", content(
            (CalibrationDocument = "application/json"), (String = "application/yaml"), (String = "application/xml"), (String = "text/plain"))),
        (status = 404, description = "no such camera, or its device states no lens that a calibration can hold", body = Problem, content_type = "application/problem+json"),
        (status = 422, description = "an unknown format, or one that cannot hold this lens", body = Problem, content_type = "application/problem+json"),
    ))]
pub(super) async fn stated(
    State(shared): State<Arc<Shared>>,
    Address(camera): Address<String>,
    Asked(parameters): Asked<ExportParameters>,
) -> Result<Response, Problem> {
    let factory = shared.fleet.camera(&camera)?.factory;
    let now_ns = time::utc_ns(jiff::Timestamp::now());
    let stated = stated_calibration(&factory, &camera, now_ns).ok_or_else(|| {
        Problem::not_found(format!(
            "the device of camera `{camera}` states no lens that a calibration can hold (`factory` in GET /v1/cameras/{camera} has what it states), or is not there yet; run a session to calibrate it"
        ))
    })?;
    written(stated, parameters).await
}

/// Every calibration of a camera, newest first; all, or page by page with `limit`.
#[utoipa::path(get, path = "/v1/cameras/{camera}/calibrations", tag = "calibrations",
    params(("camera" = String, Path, description = "its name in the configuration"), PageParameters),
    responses(
        (status = 200, description = "the calibrations", body = CalibrationsDocument, headers(("Link" = String, description = "the next page, as `<address>; rel=\"next\"`; none on the last"))),
        PageRefusals,
        (status = 404, description = "no such camera, or none of its calibrations at that cursor", body = Problem, content_type = "application/problem+json"),
    ))]
pub(super) async fn history(
    State(shared): State<Arc<Shared>>,
    Address(camera): Address<String>,
    Asked(page): Asked<PageParameters>,
) -> Result<(HeaderMap, Json<CalibrationsDocument>), Problem> {
    shared.fleet.camera(&camera)?;
    let path = format!("/v1/cameras/{camera}/calibrations");
    history_of(&shared, camera, &path, &page).await
}

/// The requested part of the calibrations of the camera or rig `name`, newest first.
pub(super) async fn history_of(
    shared: &Shared,
    name: String,
    path: &str,
    page: &PageParameters,
) -> Result<(HeaderMap, Json<CalibrationsDocument>), Problem> {
    let (limit, cursor) = (page.limit, page.cursor.clone());
    let asked = move |store: &Store| {
        let (page, last) = store.calibrations_page(&name, cursor.as_deref(), limit)?;
        Ok((page.iter().map(CalibrationDocument::from).collect(), last))
    };
    let (calibrations, last) = shared.stored(asked).await?;
    Ok((page.to_next(path, last.as_deref()), Json(CalibrationsDocument { calibrations })))
}

/// One calibration, approved or not.
#[utoipa::path(get, path = "/v1/calibrations/{id}", operation_id = "get_calibration", tag = "calibrations",
    params(("id" = String, Path, description = "calibration id"), ExportParameters),
    responses(
        (status = 200, description = "the calibration", content(
            (CalibrationDocument = "application/json"), (String = "application/yaml"), (String = "application/xml"), (String = "text/plain"))),
        (status = 404, description = "no such calibration", body = Problem, content_type = "application/problem+json"),
        (status = 422, description = "an unknown format, or one that cannot hold this lens", body = Problem, content_type = "application/problem+json"),
    ))]
pub(super) async fn one(
    State(shared): State<Arc<Shared>>,
    Address(id): Address<String>,
    Asked(parameters): Asked<ExportParameters>,
) -> Result<Response, Problem> {
    written(calibration(&shared, &id).await?, parameters).await
}

/// Makes a calibration the camera's current one; also reverts to an older one.
#[utoipa::path(post, path = "/v1/calibrations/{id}/approve", tag = "calibrations",
    params(("id" = String, Path, description = "calibration id")),
    responses(
        (status = 200, description = "now the camera's current calibration", body = CalibrationDocument),
        (status = 404, description = "no such calibration, or its camera is not configured any more", body = Problem, content_type = "application/problem+json"),
    ))]
pub(super) async fn approve(
    State(shared): State<Arc<Shared>>,
    Address(id): Address<String>,
) -> Result<Json<CalibrationDocument>, Problem> {
    let (fleet, approved) = (Arc::clone(&shared.fleet), id.clone());
    on_a_blocking_thread(move || fleet.approve(&approved)).await??;
    Ok(Json((&calibration(&shared, &id).await?).into()))
}

/// Deletes a calibration that was never approved.
#[utoipa::path(delete, path = "/v1/calibrations/{id}", tag = "calibrations",
    params(("id" = String, Path, description = "calibration id")),
    responses(
        (status = 204, description = "deleted"),
        (status = 404, description = "no such calibration", body = Problem, content_type = "application/problem+json"),
        (status = 409, description = "it was approved", body = Problem, content_type = "application/problem+json"),
    ))]
pub(super) async fn delete_calibration(
    State(shared): State<Arc<Shared>>,
    Address(id): Address<String>,
) -> Result<StatusCode, Problem> {
    shared.stored(move |store| store.delete_calibration(&id)).await?;
    Ok(StatusCode::NO_CONTENT)
}

/// The calibration `id`, as it was stored.
pub(super) async fn calibration(shared: &Shared, id: &str) -> Result<Calibration, Problem> {
    let asked = id.to_owned();
    let found = shared.stored(move |store| store.calibration(&asked)).await?;
    found.ok_or_else(|| {
        Problem::not_found(format!(
            "there is no calibration `{id}`; see GET /v1/cameras/CAMERA/calibrations"
        ))
    })
}

/// The calibration, converted to another resolution or to a part of the images if requested.
fn for_asked_images(
    calibration: &Calibration,
    parameters: &ExportParameters,
) -> Result<Calibration, Problem> {
    let size = match (parameters.width, parameters.height) {
        (None, None) => None,
        (Some(width), Some(height)) => Some(ImageSize::new(width, height)),
        (None, _) => {
            return Err(Problem::field("width", "is missing; give both, width and height"));
        }
        (_, None) => {
            return Err(Problem::field("height", "is missing; give both, width and height"));
        }
    };
    let crop = parameters.crop;
    // Two names are for a stereo format, and apply to the images of both.
    let sensor = parameters.sensor.clone().filter(|names| !names.contains(','));
    let other = OtherImages { crop, size, sensor };
    let field = |error: &OtherImagesError| match error {
        OtherImagesError::SeveralSensors { .. } | OtherImagesError::UnknownSensor { .. } => {
            "sensor"
        }
        OtherImagesError::Region { error: RegionError::Outside { .. }, .. } => "crop",
        OtherImagesError::Region { .. } if crop.is_some() && size.is_none() => "crop",
        OtherImagesError::Region { .. } => "width",
    };
    for_other_images(calibration, &other)
        .map_err(|error| Problem::field(field(&error), &error.to_string()))
}

/// The calibration in the requested format. A map for rectified images takes a while to compute.
async fn written(
    calibration: Calibration,
    parameters: ExportParameters,
) -> Result<Response, Problem> {
    let format = parameters.format.unwrap_or(Format::Json);
    let exported = on_a_blocking_thread(move || exported(&calibration, format, &parameters));
    let Exported { bytes, media_type, file_name, note, .. } = exported.await??;
    let mut response = ([(CONTENT_TYPE, media_type)], bytes).into_response();
    let mut set = |name: HeaderName, value: &str| {
        // If a header cannot contain the name, the browser chooses one itself.
        if let Ok(value) = HeaderValue::from_str(value) {
            response.headers_mut().insert(name, value);
        }
    };
    if format != Format::Json {
        set(CONTENT_DISPOSITION, &format!("attachment; filename=\"{file_name}\""));
    }
    if let Some(note) = note {
        set(HeaderName::from_static("plumb-note"), &note);
    }
    Ok(response)
}

fn exported(
    calibration: &Calibration,
    format: Format,
    parameters: &ExportParameters,
) -> Result<Exported, Problem> {
    let options = ExportOptions {
        sensor: parameters.sensor.clone(),
        alpha: parameters.alpha.unwrap_or_default(),
    };
    let field = |error: &ExportError| match error {
        ExportError::SeveralSensors { .. }
        | ExportError::UnknownSensor { .. }
        | ExportError::StereoNames { .. }
        | ExportError::StereoOrder { .. }
        | ExportError::Order { .. }
        | ExportError::StereoPair(
            StereoPairError::Unknown { .. } | StereoPairError::NotTwo { several: true, .. },
        ) => "sensor",
        _ => "format",
    };
    export(&for_asked_images(calibration, parameters)?, format, &options)
        .map_err(|e| Problem::field(field(&e), &e.to_string()))
}

#[cfg(test)]
mod tests {
    use std::sync::mpsc::channel;
    use std::task::{Context, Waker};

    use super::*;

    /// With the only thread for computations taken, an export waits for it, and does not take the
    /// one that answers requests.
    #[test]
    fn an_export_is_computed_beside_the_requests() {
        let mut one = tokio::runtime::Builder::new_current_thread();
        let runtime = one.max_blocking_threads(1).build().unwrap();
        runtime.block_on(async {
            let (release, taken) = channel::<()>();
            let busy = tokio::task::spawn_blocking(move || taken.recv());
            let calibration = crate::document::calibration::tests::example();
            let asked = ExportParameters::read(&Parameters::default()).unwrap();
            let mut answer = Box::pin(written(calibration, asked));
            let mut context = Context::from_waker(Waker::noop());
            assert!(answer.as_mut().poll(&mut context).is_pending());
            release.send(()).unwrap();
            assert!(busy.await.unwrap().is_ok());
            assert_eq!(answer.await.unwrap().status(), StatusCode::OK);
        });
    }
}
