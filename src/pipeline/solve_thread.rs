//! Thread `solve-<camera>`: estimates and solves beside the frames.

use std::sync::Arc;
use std::sync::mpsc::Receiver;
use std::time::Instant;

use crate::calibration::session::Session;
use crate::calibration::session_record::RunningEstimate;
use crate::calibration::solve::{SolvedCamera, estimate_views, solve_views};
use crate::estimation::camera::CameraOptions;
use crate::estimation::problem::{CameraProblem, LensChoice};
use crate::geometry::pixel::ImageSize;
use crate::pipeline::guarded::guarded;
use crate::pipeline::live_camera::LiveCamera;
use crate::pipeline::message::Message;

/// What is to be computed of a session's views.
#[derive(Debug)]
pub(super) struct Job {
    pub(super) session: String,
    pub(super) problem: CameraProblem,
    pub(super) lens: LensChoice,
    /// The result itself, and not only how far it is.
    pub(super) is_final: bool,
}

impl Job {
    pub(super) fn of(session: &Session, is_final: bool) -> Self {
        let record = session.record();
        let views = session.views().iter().map(|view| view.to_board_view(&record.request.target)).collect();
        let image_size = session.image_size().unwrap_or(ImageSize::new(0, 0));
        Self {
            session: record.id.clone(),
            problem: CameraProblem { image_size, views },
            lens: record.request.lens,
            is_final,
        }
    }

    fn options(&self) -> CameraOptions {
        CameraOptions { lens: self.lens, ..CameraOptions::default() }
    }

    /// How far the views are; `None` while they do not determine the lens.
    pub(super) fn estimate(&self) -> Option<RunningEstimate> {
        let estimated = guarded(|| estimate_views(&self.problem, &self.options()));
        match estimated {
            Ok(Ok((estimate, uncertainty_px))) => {
                let views = estimate.views.iter().filter(|view| view.fault.is_none()).count() as u32;
                let running = RunningEstimate { lens: estimate.lens, rms_px: estimate.rms_px, uncertainty_px, views };
                (uncertainty_px.worst.is_finite() && running.rms_px.is_finite()).then_some(running)
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

    fn solve(&self) -> Result<Box<SolvedCamera>, String> {
        let solved = guarded(|| solve_views(&self.problem, &self.options()))?;
        solved.map(Box::new).map_err(|error| error.to_string())
    }
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
            Message::Estimated { session, estimate: job.estimate() }
        };
        if camera.messages.blocking_send(answer).is_err() {
            return;
        }
    }
}
