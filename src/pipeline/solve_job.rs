//! What is computed of a session's views: how far they are, and the result.

use crate::calibration::result::Calibration;
use crate::calibration::running_estimate::{EstimateSoFar, GoingOn, estimate_so_far};
use crate::calibration::session::Session;
use crate::calibration::{self, InstrumentObservations, SolveOptions, UnsolvedDepth};
use crate::estimation::camera::CameraOptions;
use crate::estimation::interrupt::Interrupt;
use crate::estimation::problem::{CameraProblem, LensChoice};
use crate::geometry::pixel::ImageSize;
use crate::pipeline::guarded::guarded;

/// How far the views of one camera are.
#[derive(Debug)]
pub(super) struct EstimateJob {
    pub(super) session: String,
    /// The camera, as its place in the instrument.
    pub(super) place: usize,
    problem: CameraProblem,
    lens: LensChoice,
    /// What the newest estimate left to this one.
    going_on: Option<GoingOn>,
}

impl EstimateJob {
    /// Of the camera at `place`; `None` for a place that the session does not have.
    pub(super) fn of(session: &Session, place: usize) -> Option<Self> {
        let part = session.camera(place)?;
        Some(Self {
            session: session.record().id.clone(),
            place,
            problem: problem_of(session, place)?,
            lens: session.record().request.lens,
            going_on: part.going_on().cloned(),
        })
    }

    /// `None` while the views do not determine the lens.
    pub(super) fn estimate(&self) -> Option<EstimateSoFar> {
        match guarded(|| estimate_so_far(&self.problem, self.lens, self.going_on.as_ref())) {
            Ok(Ok(estimate)) => {
                let running = &estimate.running;
                (running.uncertainty_px.worst.is_finite() && running.rms_px.is_finite())
                    .then_some(estimate)
            }
            Ok(Err(error)) => {
                tracing::debug!(session = self.session, "no estimate yet: {error}");
                None
            }
            Err(fault) => {
                tracing::error!(session = self.session, "{fault}");
                None
            }
        }
    }
}

/// The views of one camera of a session.
fn problem_of(session: &Session, place: usize) -> Option<CameraProblem> {
    let (board, part) = (session.record().request.target, session.camera(place)?);
    let views = part.views().iter().map(|view| view.to_board_view(&board)).collect();
    let image_size = part.image_size().unwrap_or(ImageSize::new(0, 0));
    Some(CameraProblem { image_size, views })
}

/// The result of a session.
#[derive(Debug)]
pub(super) struct SolveJob {
    pub(super) session: String,
    pub(super) lens: LensChoice,
    pub(super) observations: InstrumentObservations,
    /// Ends the solve when nobody waits for it any more.
    pub(super) interrupt: Interrupt,
}

impl SolveJob {
    /// The calibration, without the names that it gets when it is stored. Another sensor that
    /// cannot be calibrated does not cost the color's calibration: the verdict says why it is
    /// missing.
    pub(super) fn solve(&self) -> Result<Box<Calibration>, String> {
        let options = SolveOptions {
            camera: CameraOptions {
                lens: self.lens,
                interrupt: self.interrupt.clone(),
                ..CameraOptions::default()
            },
            unsolved_depth: UnsolvedDepth::LeftOut,
            ..SolveOptions::default()
        };
        let solved = guarded(|| calibration::solve(&self.observations, &options))?;
        let calibration = solved.map_err(|error| error.to_string())?;
        let session = Some(self.session.clone());
        Ok(Box::new(Calibration { session, ..calibration }))
    }
}
