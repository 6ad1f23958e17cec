//! The stateless solve: its input is correspondences, its result a calibration.

use std::sync::Arc;
use std::time::Instant;

use axum::Json;
use axum::extract::{Request, State};
use axum::http::StatusCode;

use crate::calibration::result::Calibration;
use crate::calibration::{self, InstrumentObservations, SolveOptions};
use crate::document::calibration::CalibrationDocument;
use crate::document::problem::ProblemDocument;
use crate::document::time;
use crate::estimation::camera::CameraOptions;
use crate::estimation::interrupt::Interrupt;
use crate::estimation::problem::CameraProblem;
use crate::http::bodies::body;
use crate::http::problem::Problem;
use crate::http::request::{BodyRefusals, json_only, parsed};
use crate::http::shared::{Shared, on_a_blocking_thread};

/// The largest request, in bytes: [`MOST_POINTS`] with every digit of a double.
const LARGEST: usize = 8 << 20;
/// The most points of all views together: 925 views of 54. A solve needs 1 to 2.2 kB for each
/// point.
const MOST_POINTS: usize = 50_000;

/// Interrupts a computation when its request has been answered, or its client has disconnected.
struct EndsWithRequest(Interrupt);

impl Drop for EndsWithRequest {
    fn drop(&mut self) {
        self.0.request();
    }
}

/// Calibrates from given correspondences; nothing is stored. At most two solves run at a time. A
/// solve is canceled when its client disconnects.
#[utoipa::path(post, path = "/v1/solve", tag = "calibrations", request_body = ProblemDocument,
    responses(
        (status = 200, description = "the calibration", body = CalibrationDocument),
        BodyRefusals,
        (status = 422, description = "an invalid field, more than 50000 points, or views that determine no camera", body = Problem, content_type = "application/problem+json"),
        (status = 503, description = "the solve took longer than `[server] solve_seconds` (60 unless set), or had to wait that long; the memory for request bodies is in use; too many connections; or the daemon is stopping", body = Problem, content_type = "application/problem+json"),
    ))]
pub(super) async fn solve(
    State(shared): State<Arc<Shared>>,
    request: Request,
) -> Result<Json<CalibrationDocument>, Problem> {
    json_only(request.headers())?;
    // The body is read before a permit is taken, so that a slow sender blocks no other solve.
    let body = body(request, LARGEST, Some(&shared.bodies)).await?;
    let seconds = shared.solve_time.as_secs();
    let busy = || {
        Problem::unavailable(format!(
            "all solvers were busy for {seconds} s; send the request again"
        ))
    };
    let stopping =
        || Problem::unavailable("the daemon is stopping; send the request again when it is back");
    let place = Arc::clone(&shared.solves).acquire_owned();
    let place = tokio::time::timeout(shared.solve_time, place).await;
    let place = place.map_err(|_| busy())?.map_err(|_| stopping())?;
    let interrupt = Interrupt::new();
    let _ends = EndsWithRequest(interrupt.clone());
    let computed = move || {
        // The permit belongs to the computation, which continues for a moment after the client has
        // disconnected.
        let _place = place;
        let document: ProblemDocument = parsed(&body.bytes)?;
        drop(body);
        solved(document, interrupt)
    };
    let too_long = || {
        let detail = format!(
            "it was not solved within {seconds} s (solve_seconds in the daemon's configuration); \
             give fewer points or views, name the lens model, or use `plumb solve`"
        );
        Problem::new(StatusCode::SERVICE_UNAVAILABLE, detail)
    };
    let computed = on_a_blocking_thread(computed);
    let solved = tokio::time::timeout(shared.solve_time, computed).await;
    Ok(Json(solved.map_err(|_| too_long())???))
}

fn solved(document: ProblemDocument, interrupt: Interrupt) -> Result<CalibrationDocument, Problem> {
    let points: usize = document.views.iter().map(|view| view.object.len()).sum();
    if points > MOST_POINTS {
        let problem = format!(
            "have {points} points; at most {MOST_POINTS} are solved here: give fewer views, or use \
             `plumb solve`"
        );
        return Err(Problem::field("views", &problem));
    }
    let problem = CameraProblem::try_from(&document)?;
    let options = CameraOptions { interrupt, ..document.options() };
    let method = document.method.into();
    drop(document);
    let started = Instant::now();
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
