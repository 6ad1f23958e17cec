//! What is computed of a session's views: how far they are, and the result.

use crate::calibration::result::{Calibration, Grade};
use crate::calibration::rgbd_calibration::with_depth;
use crate::calibration::running_estimate::{EstimateSoFar, GoingOn, estimate_so_far};
use crate::calibration::second_infrared::{StereoInput, with_second_infrared};
use crate::calibration::session::Session;
use crate::calibration::solve::{SolvedCamera, solve_views};
use crate::calibration::solve_instrument::{Observations, SolveError, solve};
use crate::calibration::solve_rgbd::{RgbdInput, solve_rgbd};
use crate::estimation::camera::CameraOptions;
use crate::estimation::problem::{CameraProblem, LensChoice};
use crate::geometry::pixel::ImageSize;
use crate::geometry::target::Target;
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
pub(super) fn problem_of(session: &Session, place: usize) -> Option<CameraProblem> {
    let (board, part) = (session.record().request.target, session.camera(place)?);
    let views = part.views().iter().map(|view| view.to_board_view(&board)).collect();
    let image_size = part.image_size().unwrap_or(ImageSize::new(0, 0));
    Some(CameraProblem { image_size, views })
}

/// The result of a session.
#[derive(Debug)]
pub(super) struct SolveJob {
    pub(super) session: String,
    pub(super) target: Target,
    pub(super) lens: LensChoice,
    pub(super) seen: SeenBySensors,
}

/// What the sensors of an instrument saw.
#[derive(Debug)]
pub(super) enum SeenBySensors {
    /// Of one camera.
    Camera {
        /// In color.
        problem: CameraProblem,
        /// With depth and infrared, where it has them.
        depth: Option<Box<RgbdInput>>,
        /// With right infrared, where it has it.
        second_infrared: Option<StereoInput>,
    },
    /// Of a rig's cameras.
    Rig(Observations),
}

impl SolveJob {
    /// The calibration, without the names that it gets when it is stored. Another sensor that
    /// cannot be calibrated does not cost the color's calibration: the verdict says why it is
    /// missing.
    pub(super) fn solve(&self) -> Result<Box<Calibration>, String> {
        let options = CameraOptions { lens: self.lens, ..CameraOptions::default() };
        let calibration = guarded(|| match &self.seen {
            SeenBySensors::Camera { problem, depth, second_infrared } => {
                self.solve_camera(problem, depth.as_deref(), second_infrared.as_ref(), &options)
            }
            SeenBySensors::Rig(observations) => solve_rig(observations, &options),
        })??;
        let session = Some(self.session.clone());
        Ok(Box::new(Calibration { session, ..calibration }))
    }

    fn solve_camera(
        &self,
        problem: &CameraProblem,
        depth: Option<&RgbdInput>,
        second_infrared: Option<&StereoInput>,
        options: &CameraOptions,
    ) -> Result<Calibration, String> {
        let finished = |solved: SolvedCamera| solved.into_calibration(Some(self.target));
        let alone = || solve_views(problem, options).map(finished).map_err(|e| e.to_string());
        let calibration = match depth {
            Some(input) => match solve_rgbd(input, options) {
                Ok(solved) => with_depth(finished(solved.color.clone()), input, &solved),
                Err(reason) => without_depth(alone()?, &reason.to_string()),
            },
            None => alone()?,
        };
        Ok(match second_infrared {
            Some(input) => with_second_infrared(calibration, input, options),
            None => calibration,
        })
    }
}

/// All cameras with all of their sensors; a camera whose depth cannot be calibrated is solved
/// without it.
fn solve_rig(observations: &Observations, options: &CameraOptions) -> Result<Calibration, String> {
    let mut observations = observations.clone();
    let mut without = Vec::new();
    loop {
        match solve(&observations, options) {
            Err(SolveError::Camera { camera, source }) => {
                let mut cameras = observations.cameras.iter_mut();
                let with_depth = cameras
                    .find(|other| other.color.name == camera && other.depth.is_some())
                    .ok_or_else(|| format!("camera `{camera}`: {source}"))?;
                (with_depth.depth, with_depth.second_infrared) = (None, None);
                without.push(format!("{camera}: depth is not calibrated: {source}"));
            }
            Err(error) => return Err(error.to_string()),
            Ok(mut calibration) => {
                if !without.is_empty() {
                    let verdict = &mut calibration.verdict;
                    verdict.grade = verdict.grade.min(Grade::Usable);
                    verdict.reasons.extend(without);
                }
                return Ok(calibration);
            }
        }
    }
}

fn without_depth(mut calibration: Calibration, reason: &str) -> Calibration {
    calibration.verdict.grade = calibration.verdict.grade.min(Grade::Usable);
    calibration.verdict.reasons.push(format!("depth is not calibrated: {reason}"));
    calibration
}
