//! Thread `solve-<camera>`: estimates and solves beside the frames.

use std::sync::Arc;
use std::sync::mpsc::Receiver;
use std::time::Instant;

use crate::calibration::result::{Calibration, Grade};
use crate::calibration::rgbd_calibration::with_depth;
use crate::calibration::running_estimate::{EstimateSoFar, GoingOn, estimate_so_far};
use crate::calibration::second_infrared::{StereoInput, with_second_infrared};
use crate::calibration::session::Session;
use crate::calibration::solve::{SolvedCamera, solve_views};
use crate::calibration::solve_rgbd::{RgbdInput, solve_rgbd};
use crate::calibration::view::target_as_seen;
use crate::estimation::camera::CameraOptions;
use crate::estimation::error::EstimationError;
use crate::estimation::problem::{CameraProblem, LensChoice};
use crate::geometry::pixel::ImageSize;
use crate::geometry::target::Target;
use crate::pipeline::guarded::guarded;
use crate::pipeline::live_camera::LiveCamera;
use crate::pipeline::message::Message;

/// What is to be computed of a session's views.
#[derive(Debug)]
pub(super) struct Job {
    pub(super) session: String,
    pub(super) problem: CameraProblem,
    pub(super) lens: LensChoice,
    /// What the newest estimate left to this one; the result is solved from nothing.
    pub(super) going_on: Option<GoingOn>,
    /// The result itself, and not only how far it is.
    pub(super) is_final: bool,
    /// The board, and what depth adds, for the result.
    pub(super) target: Target,
    pub(super) with_depth: Option<RgbdInput>,
    /// What the right infrared sensor adds, for the result.
    pub(super) with_infrared2: Option<StereoInput>,
}

impl Job {
    /// Of the camera at place `camera`; `None` for a place that the session does not have.
    pub(super) fn of(session: &Session, camera: usize, is_final: bool) -> Option<Self> {
        let (record, part) = (session.record(), session.camera(camera)?);
        let views =
            part.views().iter().map(|view| view.to_board_view(&record.request.target)).collect();
        let image_size = part.image_size().unwrap_or(ImageSize::new(0, 0));
        Some(Self {
            session: record.id.clone(),
            going_on: part.going_on().filter(|_| !is_final).cloned(),
            problem: CameraProblem { image_size, views },
            lens: record.request.lens,
            is_final,
            target: target_as_seen(&record.request.target, part.views()),
            with_depth: None,
            with_infrared2: None,
        })
    }

    fn options(&self) -> CameraOptions {
        CameraOptions { lens: self.lens, ..CameraOptions::default() }
    }

    /// How far the views are; `None` while they do not determine the lens.
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

    /// The calibration, without the names that it gets when it is stored. Another sensor that
    /// cannot be calibrated does not cost the color's calibration: the verdict says why it is
    /// missing.
    fn solve(&self) -> Result<Box<Calibration>, String> {
        let options = self.options();
        let calibration = guarded(|| {
            let calibration = match &self.with_depth {
                Some(input) => match solve_rgbd(input, &options) {
                    Ok(solved) => {
                        Ok(with_depth(self.unnamed(solved.color.clone()), input, &solved))
                    }
                    Err(reason) => solve_views(&self.problem, &options)
                        .map(|solved| without_depth(self.unnamed(solved), &reason.to_string())),
                },
                None => solve_views(&self.problem, &options).map(|solved| self.unnamed(solved)),
            }?;
            Ok::<_, EstimationError>(match &self.with_infrared2 {
                Some(input) => with_second_infrared(calibration, input, &options),
                None => calibration,
            })
        })?;
        calibration.map(Box::new).map_err(|error| error.to_string())
    }

    fn unnamed(&self, solved: SolvedCamera) -> Calibration {
        let session = Some(self.session.clone());
        Calibration { session, ..solved.into_calibration(Some(self.target)) }
    }
}

fn without_depth(mut calibration: Calibration, reason: &str) -> Calibration {
    calibration.verdict.grade = calibration.verdict.grade.min(Grade::Usable);
    calibration.verdict.reasons.push(format!("depth is not calibrated: {reason}"));
    calibration
}

/// Does one job after the other until nobody asks any more.
pub(super) fn run(camera: &Arc<LiveCamera>, jobs: &Receiver<Job>) {
    while let Ok(job) = jobs.recv() {
        let started = Instant::now();
        let session = job.session.clone();
        let answer = if job.is_final {
            let solved = job.solve();
            let elapsed = started.elapsed().as_secs_f64();
            camera.metrics.solve_seconds.with_label_values(&[&camera.name]).observe(elapsed);
            Message::Solved { session, solved }
        } else {
            Message::Estimated { session, estimate: job.estimate().map(Box::new) }
        };
        if camera.messages.blocking_send(answer).is_err() {
            return;
        }
    }
}
