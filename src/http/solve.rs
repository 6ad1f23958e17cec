//! The stateless solve: correspondences in, a calibration out.

use std::sync::Arc;
use std::time::Instant;

use axum::Json;
use axum::extract::{Request, State};

use crate::calibration::result::Calibration;
use crate::calibration::{self, InstrumentObservations, SolveOptions};
use crate::document::calibration::CalibrationDocument;
use crate::document::problem::ProblemDocument;
use crate::document::time;
use crate::estimation::problem::CameraProblem;
use crate::http::problem::Problem;
use crate::http::request::{BodyRefusals, LARGE_BODY, document};
use crate::http::shared::{Shared, on_a_blocking_thread};

/// Calibrates from given correspondences; nothing is stored.
#[utoipa::path(post, path = "/v1/solve", tag = "calibrations", request_body = ProblemDocument,
    responses(
        (status = 200, description = "the calibration", body = CalibrationDocument),
        BodyRefusals,
        (status = 422, description = "a field that cannot be, or views that determine no camera", body = Problem, content_type = "application/problem+json"),
    ))]
pub(super) async fn solve(
    State(shared): State<Arc<Shared>>,
    request: Request,
) -> Result<Json<CalibrationDocument>, Problem> {
    let stopping = || Problem::unavailable("the daemon is stopping; send it again when it is back");
    // Before the body is read, so that the bodies of all together are bounded.
    let place = Arc::clone(&shared.solves).acquire_owned().await.map_err(|_| stopping())?;
    let document: ProblemDocument = document(request, LARGE_BODY).await?;
    // The place is the computation's, which goes on when the client has left.
    let solved = move || {
        let _place = place;
        solved(&document)
    };
    Ok(Json(on_a_blocking_thread(solved).await??))
}

fn solved(document: &ProblemDocument) -> Result<CalibrationDocument, Problem> {
    let problem = CameraProblem::try_from(document)?;
    let options = document.options();
    let started = Instant::now();
    let method = document.method.into();
    let options = SolveOptions { camera: options, method, ..SolveOptions::default() };
    let observations = InstrumentObservations::of_views(None, problem);
    let solved = calibration::solve(&observations, &options);
    let solved = solved.map_err(|error| Problem::field("views", &error.to_string()))?;
    let elapsed = started.elapsed();
    let calibration = Calibration {
        id: ulid::Ulid::generate().to_string(),
        created_at_ns: time::utc_ns(jiff::Timestamp::now()),
        ..solved
    };
    Ok(CalibrationDocument {
        elapsed_ms: Some(elapsed.as_secs_f64() * 1e3),
        ..CalibrationDocument::from(&calibration)
    })
}
