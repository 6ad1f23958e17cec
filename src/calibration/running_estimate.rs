//! The estimate that a session shows while it collects. It is continued from view to view, which
//! takes a fraction of a solve, and made anew when the continuation is suspect. The calibration
//! itself is never a continuation: it is solved from scratch at the end.

use std::sync::Arc;

use crate::calibration::result::Grade;
use crate::calibration::session_record::{RunningEstimate, SHOWN_COLUMNS};
use crate::calibration::solve::{uncertainty_map, uncertainty_over};
use crate::calibration::verdict::SPLIT_HALF;
use crate::estimation::camera::{CameraEstimate, CameraOptions, CameraStart, calibrate_and_check};
use crate::estimation::error::EstimationError;
use crate::estimation::model_check::ModelCheck;
use crate::estimation::problem::{CameraProblem, LensChoice};
use crate::estimation::relabeled::RelabeledProblem;
use crate::estimation::uncertainty::Distance;
use crate::geometry::pose::Pose;

/// With fewer views a new estimate takes little time, and each view still changes much.
const LEAST_VIEWS: usize = 8;

/// Residuals may be at most this many times those of the previous estimate: with [`LEAST_VIEWS`] or
/// more, one more view changes them less, unless something is wrong with it or with the estimate.
const MOST_RMS_RATIO: f64 = 1.25;

/// No parameter may move by more than this many of its previous standard deviations: one more view
/// moves them by less than one.
const MOST_CHANGE_SIGMAS: f64 = 4.0;

/// An estimate of the views so far.
#[derive(Debug, Clone, PartialEq)]
pub struct EstimateSoFar {
    /// The part that is shown.
    pub running: RunningEstimate,
    /// What the next estimate continues from; `None` if it has to be made anew.
    pub continuation: Option<Continuation>,
    /// Whether halves of the views agree as well as a good verdict requires; true if there are too
    /// few views for halves.
    pub model_holds: bool,
}

/// What an estimate passes on to the next one.
#[derive(Debug, Clone, PartialEq)]
pub struct Continuation {
    start: CameraStart,
    lens_std: Vec<f64>,
    rms_px: f64,
    /// Which of the views were rejected.
    rejected: Vec<bool>,
    /// How many views there were when the lens model was last chosen.
    chosen_from_views: usize,
    from_scratch: bool,
}

impl Continuation {
    /// Whether the estimate was made from scratch.
    pub fn is_from_scratch(&self) -> bool {
        self.from_scratch
    }

    /// Whether the lens model has to be chosen again: the number of views has doubled since.
    fn is_outgrown_by(&self, views: usize) -> bool {
        views >= 2 * self.chosen_from_views
    }

    /// Continues to the estimate of `problem`, whose first views must be those of this one; `None`
    /// if that fails or is suspect.
    fn continue_with(
        &self,
        problem: &CameraProblem,
        board_from_labels: &[Pose],
    ) -> Option<EstimateSoFar> {
        let lens = LensChoice::Model(self.start.lens.model());
        let options =
            CameraOptions { lens, start: Some(self.start.clone()), ..CameraOptions::default() };
        let origin =
            EstimateOrigin { from_scratch: false, chosen_from_views: self.chosen_from_views };
        let (estimate, so_far) = estimated(problem, board_from_labels, &options, origin).ok()?;
        self.is_continued_by(&estimate).then_some(so_far)
    }

    /// Whether `next` is plausible as this estimate with a few more views. A newly rejected view,
    /// greater residuals or a jump of the lens may each be an effect of the start.
    fn is_continued_by(&self, next: &CameraEstimate) -> bool {
        let known = self.rejected.iter().copied().chain(std::iter::repeat(false));
        let newly_rejected =
            next.views.iter().zip(known).any(|(view, known)| view.fault.is_some() && !known);
        let (before, after) = (self.start.lens.parameters(), next.lens.parameters());
        let mut moved = before.iter().zip(&after).zip(&self.lens_std);
        !newly_rejected
            && next.rms_px <= MOST_RMS_RATIO * self.rms_px
            && moved
                .all(|((before, after), std)| (after - before).abs() <= MOST_CHANGE_SIGMAS * std)
    }
}

/// How an estimate was made.
#[derive(Clone, Copy)]
struct EstimateOrigin {
    from_scratch: bool,
    chosen_from_views: usize,
}

impl EstimateSoFar {
    /// `start` is that of `estimate`, under the labels as detected.
    fn of(
        estimate: &CameraEstimate,
        start: CameraStart,
        check: &ModelCheck,
        origin: EstimateOrigin,
    ) -> Self {
        let uncertainty_px =
            uncertainty_over(&estimate.lens, &estimate.lens_covariance, estimate.image_size);
        let uncertainty_map = uncertainty_map(estimate, SHOWN_COLUMNS, Distance::Infinity);
        let rejected: Vec<bool> = estimate.views.iter().map(|view| view.fault.is_some()).collect();
        let views = rejected.iter().filter(|rejected| !**rejected).count() as u32;
        Self {
            running: RunningEstimate {
                lens: estimate.lens,
                rms_px: estimate.rms_px,
                uncertainty_px,
                uncertainty_map: uncertainty_map.map(Arc::new),
                views,
            },
            continuation: Some(Continuation {
                start,
                lens_std: estimate.lens_std(),
                rms_px: estimate.rms_px,
                rejected,
                chosen_from_views: origin.chosen_from_views,
                from_scratch: origin.from_scratch,
            }),
            model_holds: check
                .split_half_ratio
                .is_none_or(|ratio| Grade::of_figure(ratio, SPLIT_HALF) == Grade::Good),
        }
    }
}

/// Estimates a camera from a session's views so far. `earlier` is from the newest estimate of the
/// same session, made of the first of these views in the same order. `board_from_labels` are those
/// of [`crate::geometry::target::Target::symmetries`]: where there are several, views are labeled
/// alike ([`RelabeledProblem::labeled_alike`]). If the lens model is to be
/// chosen, it is chosen again each time the views have doubled: comparing all models takes ten
/// times as long as a fit.
///
/// # Errors
/// As [`crate::estimation::camera::calibrate_camera`].
pub fn estimate_so_far(
    problem: &CameraProblem,
    board_from_labels: &[Pose],
    lens: LensChoice,
    earlier: Option<&Continuation>,
) -> Result<EstimateSoFar, EstimationError> {
    let views = problem.views.len();
    let earlier = earlier.filter(|earlier| !earlier.is_outgrown_by(views));
    let continued = earlier
        .filter(|_| views > LEAST_VIEWS)
        .and_then(|earlier| earlier.continue_with(problem, board_from_labels));
    if let Some(continued) = continued {
        return Ok(continued);
    }
    let from_scratch = |lens: LensChoice, chosen_from_views: usize| {
        let options = CameraOptions { lens, ..CameraOptions::default() };
        let origin = EstimateOrigin { from_scratch: true, chosen_from_views };
        estimated(problem, board_from_labels, &options, origin).map(|(_, so_far)| so_far)
    };
    // If only the fit is made anew, the lens model stays that of the earlier choice.
    let of_chosen = earlier.and_then(|kept| {
        from_scratch(LensChoice::Model(kept.start.lens.model()), kept.chosen_from_views).ok()
    });
    of_chosen.map_or_else(|| from_scratch(lens, views), Ok)
}

/// The estimate of `problem`, with its views labeled alike.
fn estimated(
    problem: &CameraProblem,
    board_from_labels: &[Pose],
    options: &CameraOptions,
    origin: EstimateOrigin,
) -> Result<(CameraEstimate, EstimateSoFar), EstimationError> {
    let Some(labeled) = RelabeledProblem::labeled_alike(problem, board_from_labels, options) else {
        let (estimate, check) = calibrate_and_check(problem, options)?;
        let so_far = EstimateSoFar::of(&estimate, estimate.to_start(), &check, origin);
        return Ok((estimate, so_far));
    };
    let start = options.start.as_ref().map(|start| labeled.start(start));
    let options = CameraOptions { start, ..options.clone() };
    let (estimate, check) = calibrate_and_check(&labeled.problem, &options)?;
    let start = labeled.start_as_given(&estimate.to_start());
    let so_far = EstimateSoFar::of(&estimate, start, &check, origin);
    Ok((estimate, so_far))
}
