//! What is computed from a session's views: running estimates, and the result.

use crate::calibration::result::Calibration;
use crate::calibration::running_estimate::{Continuation, EstimateSoFar, estimate_so_far};
use crate::calibration::scene::correspondence::SceneImage;
use crate::calibration::scene::so_far::{SceneSoFar, scene_so_far};
use crate::calibration::scene::{SceneDepth, SceneOptions, SceneRefusal, calibrate_scene};
use crate::calibration::session::camera::CameraPart;
use crate::calibration::session::{Action, Session};
use crate::calibration::target::CalibrationTarget;
use crate::calibration::{
    self, InstrumentError, InstrumentObservations, SolveOptions, UnsolvedDepth,
};
use crate::estimation::camera::CameraOptions;
use crate::estimation::interrupt::Interrupt;
use crate::estimation::problem::{CameraProblem, LensChoice};
use crate::geometry::pixel::ImageSize;
use crate::geometry::pose::Pose;
use crate::geometry::target::Target;
use crate::pipeline::guarded::{CaughtPanic, guarded};

/// A running estimate of one camera.
#[derive(Debug)]
pub(super) struct EstimateJob {
    pub(super) session: String,
    /// The camera, as its place in the instrument.
    pub(super) place: usize,
    lens: LensChoice,
    input: EstimateInput,
}

/// The input of an estimate.
#[derive(Debug)]
enum EstimateInput {
    /// The views of a board, and what the previous estimate left for this one.
    Board {
        problem: CameraProblem,
        /// The board's symmetries.
        board_from_labels: Vec<Pose>,
        continuation: Option<Box<Continuation>>,
    },
    /// The key frames of a scene.
    Scene(Vec<SceneImage>),
}

/// The running estimate of one camera; `None` while the views do not determine the lens.
#[derive(Debug)]
pub(super) enum Estimate {
    /// Of a board.
    Board(Option<Box<EstimateSoFar>>),
    /// Of a scene.
    Scene(Option<Box<SceneSoFar>>),
}

impl Estimate {
    /// Passes the estimate to the session, for the camera at `place`.
    pub(super) fn take_to(self, session: &mut Session, place: usize) -> Vec<Action> {
        match self {
            Self::Board(estimate) => session.estimated(place, estimate.map(|e| *e)),
            Self::Scene(so_far) => session.scene_estimated(place, so_far.map(|s| *s)),
        }
    }
}

impl EstimateJob {
    /// The job for the camera at `place`; `None` for a place that the session does not have.
    pub(super) fn of(session: &Session, place: usize) -> Option<Self> {
        let part = session.camera(place)?;
        Some(Self {
            session: session.record().id.clone(),
            place,
            lens: session.record().request.lens,
            input: match session.record().request.target {
                CalibrationTarget::Board(board) => EstimateInput::Board {
                    problem: problem_of(part, &board),
                    board_from_labels: board.symmetries(),
                    continuation: part.continuation().cloned().map(Box::new),
                },
                CalibrationTarget::Scene => {
                    let images = part.key_frames().iter().map(|key| key.image.clone());
                    EstimateInput::Scene(images.collect())
                }
            },
        })
    }

    pub(super) fn estimate(&self) -> Estimate {
        match &self.input {
            EstimateInput::Board { problem, board_from_labels, continuation } => {
                let estimate = self.of_board(problem, board_from_labels, continuation.as_deref());
                Estimate::Board(estimate.map(Box::new))
            }
            EstimateInput::Scene(images) => {
                let so_far = guarded(|| scene_so_far(images, self.lens));
                let fault = |fault| tracing::error!(session = self.session, "{fault}");
                Estimate::Scene(so_far.map_err(fault).ok().map(Box::new))
            }
        }
    }

    /// `None` while the views do not determine the lens.
    fn of_board(
        &self,
        problem: &CameraProblem,
        board_from_labels: &[Pose],
        continuation: Option<&Continuation>,
    ) -> Option<EstimateSoFar> {
        match guarded(|| estimate_so_far(problem, board_from_labels, self.lens, continuation)) {
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
fn problem_of(part: &CameraPart, board: &Target) -> CameraProblem {
    let views = part.views().iter().map(|view| view.to_board_view(board)).collect();
    let image_size = part.image_size().unwrap_or(ImageSize::new(0, 0));
    CameraProblem { image_size, views }
}

/// The result of a session.
#[derive(Debug)]
pub(super) struct SolveJob {
    pub(super) session: String,
    pub(super) lens: LensChoice,
    pub(super) observations: SolveInput,
    /// Interrupts the solve once its result is no longer needed.
    pub(super) interrupt: Interrupt,
}

/// What a session has collected.
#[derive(Debug)]
pub(super) enum SolveInput {
    /// Of a board.
    Board(Box<InstrumentObservations>),
    /// Of a scene, with depth where the camera measures it.
    Scene(Vec<SceneImage>, Option<Box<SceneDepth>>),
}

/// Why a session has no result.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub(super) enum SolveFailure {
    /// The views of a board do not determine it.
    #[error(transparent)]
    Board(#[from] InstrumentError),
    /// The images of a scene do not determine it.
    #[error(transparent)]
    Scene(#[from] SceneRefusal),
    /// The solve panicked.
    #[error(transparent)]
    Panic(#[from] CaughtPanic),
}

impl SolveJob {
    /// The calibration, without the names that it gets when it is stored. If another sensor cannot
    /// be calibrated, the color sensor still is: the verdict gives the reason why the other is
    /// missing.
    pub(super) fn solve(&self) -> Result<Box<Calibration>, SolveFailure> {
        let calibration = guarded(|| self.calibration())??;
        let session = Some(self.session.clone());
        Ok(Box::new(Calibration { session, ..calibration }))
    }

    fn calibration(&self) -> Result<Calibration, SolveFailure> {
        match &self.observations {
            SolveInput::Board(observations) => {
                let options = SolveOptions {
                    camera: CameraOptions {
                        lens: self.lens,
                        interrupt: self.interrupt.clone(),
                        ..CameraOptions::default()
                    },
                    unsolved_depth: UnsolvedDepth::LeftOut,
                    ..SolveOptions::default()
                };
                Ok(calibration::solve(observations, &options)?)
            }
            SolveInput::Scene(images, depth) => {
                let options = SceneOptions {
                    lens: self.lens,
                    interrupt: self.interrupt.clone(),
                    ..SceneOptions::default()
                };
                let solved = calibrate_scene(images, &options)?;
                let solved = match depth {
                    Some(depth) => solved.in_meters(depth),
                    None => solved,
                };
                Ok(solved.into_calibration())
            }
        }
    }
}
