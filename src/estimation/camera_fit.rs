//! One lens model fitted to the views of one camera, and the selection of views.

use nalgebra::{DMatrix, DVector, Point3};

use crate::estimation::effects::effects_fit::EffectsFit;
use crate::estimation::error::EstimationError;
use crate::estimation::joint::linearize::LinearizationPoint;
use crate::estimation::joint::minimize::{Minimum, Stop};
use crate::estimation::joint::{BoardObservation, FreeLens, Layout, State};
use crate::estimation::lens_pole::{has_pole, with_denominator_of, with_smaller_denominators};
use crate::estimation::problem::CameraOptions;
use crate::estimation::robust::{Loss, median_scale};
use crate::estimation::robust_fit::{ROUNDING, RobustFit, is_explained, robust_fit};
use crate::estimation::start::{self, Prepared};
use crate::estimation::view_fault::ViewFault;
use crate::geometry::lens::{Lens, LensModel};
use crate::geometry::pose::Pose;

/// A fitted camera. Points are relative to their common center.
#[derive(Debug, Clone)]
pub(crate) struct CameraFit {
    pub(crate) layout: Layout,
    pub(crate) robust: RobustFit,
    pub(crate) observations: Vec<BoardObservation>,
    pub(crate) faults: Vec<Option<ViewFault>>,
    /// Effects beyond lens and poses. With them, the points of `observations` are displaced by
    /// shape and motion.
    pub(crate) effects: Option<EffectsFit>,
    /// Where a rolling shutter is likely but not significant: the step of the lens's parameters
    /// that it would cause, times the square root of its probability.
    pub(crate) shutter_step: Option<DVector<f64>>,
    /// Where the lens model was chosen: the covariance of all parameters of the lens from the other
    /// models, weighted by their probabilities
    /// ([`crate::estimation::lens_choice::model_averaging`]).
    pub(crate) between_models: Option<DMatrix<f64>>,
}

/// The largest number of points by which a nearest lens is found.
const MAX_POINTS: usize = 600;

/// The largest number of views that are compared with each other: enough to show differences.
const MAX_VIEWS: usize = 60;

impl CameraFit {
    pub(crate) fn new(
        layout: Layout,
        robust: RobustFit,
        observations: Vec<BoardObservation>,
        faults: Vec<Option<ViewFault>>,
    ) -> Self {
        Self {
            layout,
            robust,
            observations,
            faults,
            effects: None,
            shutter_step: None,
            between_models: None,
        }
    }

    /// Its minimum.
    pub(crate) fn minimum_point(&self) -> LinearizationPoint<'_> {
        LinearizationPoint { layout: &self.layout, state: &self.robust.minimum.state }
    }

    pub(crate) fn lens(&self) -> &Lens {
        &self.robust.minimum.state.lenses[0]
    }

    /// The variance of the residuals, as a factor on the corners' own variances.
    pub(crate) fn noise_square(&self) -> f64 {
        let used: usize = self
            .observations
            .iter()
            .map(|observation| observation.used.iter().filter(|used| **used).count())
            .sum();
        let frame_sets = self.robust.minimum.equations.seen_frame_sets();
        let freedom = (2 * used) as f64 - (self.layout.len + 6 * frame_sets) as f64;
        self.robust.minimum.equations.cost / freedom.max(1.0)
    }

    /// Whether the corners are noiseless, so that residuals are rounding and show nothing of the
    /// model.
    pub(crate) fn is_exact(&self) -> bool {
        self.noise_square() < ROUNDING * ROUNDING
    }

    /// The covariance of its first camera's lens parameters, with a noise of at least
    /// [`LEAST_NOISE`]; `None` where they are not determined.
    pub(crate) fn lens_covariance(&self) -> Option<DMatrix<f64>> {
        let free = &self.layout.sensors[0].lens;
        let unit = self.robust.minimum.equations.global_covariance()?;
        let by_free = free.all_by_free(self.lens());
        let unit = unit.view((0, 0), (free.free.len(), free.free.len()));
        let covariance = &by_free
            * unit
            * by_free.transpose()
            * self.noise_square().max(LEAST_NOISE * LEAST_NOISE);
        let known = |axis: usize| {
            covariance[(axis, axis)].sqrt() < OPEN_FOCAL * self.lens().parameters()[axis]
        };
        (known(0) && known(1)).then_some(covariance)
    }

    /// The used views, by index.
    pub(crate) fn good_views(&self) -> Vec<usize> {
        (0..self.faults.len()).filter(|view| self.faults[*view].is_none()).collect()
    }

    /// The good views, or an evenly spaced sample of many.
    pub(crate) fn some_views(&self) -> Vec<usize> {
        self.some_frame_sets().into_iter().flatten().collect()
    }

    /// The corners in use of one camera, or a sample of many, in the camera's frame.
    pub(crate) fn some_points_in_camera(&self) -> Vec<Point3<f64>> {
        let state = &self.robust.minimum.state;
        let of_view = |view: usize| {
            let observation = &self.observations[view];
            let pose = state.rig_from_board[observation.frame_set];
            let used = observation.points.iter().zip(&observation.used).filter(|(_, used)| **used);
            used.map(move |(point, _)| pose * *point)
        };
        let points: Vec<Point3<f64>> = self.good_views().into_iter().flat_map(of_view).collect();
        let step = points.len().div_ceil(MAX_POINTS).max(1);
        points.into_iter().step_by(step).collect()
    }

    /// The good observations of each frame set, by index: of all frame sets that have any, or of an
    /// evenly spaced sample of many. For a single camera, a frame set is a view.
    pub(crate) fn some_frame_sets(&self) -> Vec<Vec<usize>> {
        let mut all: Vec<Vec<usize>> =
            vec![Vec::new(); self.robust.minimum.state.rig_from_board.len()];
        for observation in self.good_views() {
            all[self.observations[observation].frame_set].push(observation);
        }
        all.retain(|observations| !observations.is_empty());
        let step = all.len().div_ceil(MAX_VIEWS).max(1);
        all.into_iter().step_by(step).collect()
    }
}

/// Fits one lens model. Where the denominator of a rational lens would have a zero in or near the
/// image, it is the largest of [`with_smaller_denominators`] that has none; a fit that starts from a
/// lens with a smaller one keeps it.
pub(crate) fn fit_camera(
    prepared: &mut Prepared,
    model: LensModel,
    options: &CameraOptions,
) -> Result<CameraFit, EstimationError> {
    let start = options.start.as_ref().filter(|start| start.lens.model() == model);
    let smaller = start.and_then(|start| with_denominator_of(&start.lens, options));
    let fit = fit_model(prepared, model, smaller.as_ref().unwrap_or(options))?;
    let size = prepared.image_size;
    if !has_pole(fit.lens(), size) {
        return Ok(fit);
    }
    for options in with_smaller_denominators(model, options) {
        match fit_model(prepared, model, &options) {
            Ok(smaller) if !has_pole(smaller.lens(), size) => return Ok(smaller),
            _ => options.interrupt.check()?,
        }
    }
    Ok(fit)
}

/// Fits one lens model with the parameters that `options` leave free.
fn fit_model(
    prepared: &mut Prepared,
    model: LensModel,
    options: &CameraOptions,
) -> Result<CameraFit, EstimationError> {
    options.interrupt.check()?;
    prepared.interrupt = options.interrupt.clone();
    let (free_lens, given) = FreeLens::from_options(model, options)?;
    let needs_focal = free_lens.free.contains(&0) || free_lens.free.contains(&1);
    let needed = if needs_focal && prepared.is_flat() { 3 } else { 1 };
    enough_views(prepared, &prepared.faults(), needed)?;
    let warm = options.start.as_ref().filter(|start| start.lens.model() == model);
    let mut state = match warm {
        Some(start) => start::resume(prepared, start),
        None => start::start(prepared, model),
    }
    .ok_or(EstimationError::NoFit)?;
    given.apply(&mut state.lenses[0]).ok_or(EstimationError::NoFit)?;
    fit_from(prepared, state, free_lens, needed)
}

/// Fits the model of `fit` to the same views again, from another state.
pub(crate) fn fit_again(
    prepared: &Prepared,
    fit: &CameraFit,
    state: State,
) -> Result<CameraFit, EstimationError> {
    fit_from(prepared, state, fit.layout.sensors[0].lens.clone(), 1)
}

/// Continues the fit from a state, then decides again about every view.
fn fit_from(
    prepared: &Prepared,
    state: State,
    free_lens: FreeLens,
    needed: usize,
) -> Result<CameraFit, EstimationError> {
    let layout = Layout::new(vec![free_lens], None).ended_by(&prepared.interrupt);
    let mut observations = prepared.observations.clone();
    let mut faults = prepared.faults();
    let fit = |start, observations: &mut _, faults: &mut _| {
        robust_fit(&layout, start, observations, faults)
    };
    let mut robust = fit(state, &mut observations, &mut faults).ok_or(EstimationError::NoFit)?;
    enough_views(prepared, &faults, needed)?;
    let readmitted = readmit(prepared, &mut robust, &mut faults);
    let mirrored = name_mirrored(prepared, &robust.minimum.state, &mut faults);
    if readmitted || mirrored {
        robust = fit(robust.minimum.state, &mut observations, &mut faults)
            .ok_or(EstimationError::NoFit)?;
        enough_views(prepared, &faults, needed)?;
    }
    let mut fit = CameraFit::new(layout, robust, observations, faults);
    place_rejected_views(prepared, &mut fit);
    Ok(fit)
}

fn enough_views(
    prepared: &Prepared,
    faults: &[Option<ViewFault>],
    needed: usize,
) -> Result<(), EstimationError> {
    let usable = faults.iter().filter(|fault| fault.is_none()).count();
    if usable >= needed {
        return Ok(());
    }
    let named =
        prepared.names.iter().zip(faults).filter_map(|(name, fault)| Some((name, (*fault)?)));
    let rejected = named.take(5).map(|(name, fault)| format!("; view `{name}`: {fault}")).collect();
    Err(EstimationError::TooFewViews { usable, needed, rejected })
}

/// With the lens known, readmits views that were rejected only because no homography fitted them.
fn readmit(prepared: &Prepared, robust: &mut RobustFit, faults: &mut [Option<ViewFault>]) -> bool {
    let mut readmitted = false;
    for (view, fault) in faults.iter_mut().enumerate() {
        let Some(ViewFault::NoPose { .. }) = fault else { continue };
        let Some((pose, residuals)) = locate(prepared, view, &robust.minimum.state) else {
            continue;
        };
        if is_explained(&residuals, robust.limit) {
            robust.minimum.state.rig_from_board[view] = pose;
            (*fault, readmitted) = (None, true);
        }
    }
    readmitted
}

/// The pose of a single view under a known lens, robustly, with its residuals in standard
/// deviations.
fn locate(prepared: &Prepared, view: usize, state: &State) -> Option<(Pose, Vec<[f64; 2]>)> {
    let lens = state.lenses[0];
    let pose = prepared.pose(view, &lens)?;
    let start = State { rig_from_board: vec![pose], ..state.clone() };
    let fixed = FreeLens { model: lens.model(), free: Vec::new(), square_pixels: false };
    let layout = Layout::new(vec![fixed], None).ended_by(&prepared.interrupt);
    let mut observation = BoardObservation { frame_set: 0, ..prepared.observations[view].clone() };
    let at_start = start.residuals(&layout, &observation);
    observation.used = at_start.iter().map(|residual| residual[0].is_finite()).collect();
    let loss = Loss::Huber { scale: median_scale(at_start.into_iter()).max(1e-8) };
    let observations = [observation];
    let minimum = Minimum::start(&layout, start, &observations, loss)?.descend(
        &layout,
        &observations,
        loss,
        Stop::default(),
    );
    let residuals = minimum.state.residuals(&layout, &observations[0]);
    Some((minimum.state.rig_from_board[0], residuals))
}

/// Marks the views that show the other side of the board than most. Returns whether there are any.
fn name_mirrored(prepared: &Prepared, state: &State, faults: &mut [Option<ViewFault>]) -> bool {
    let Some(normal) = prepared.board_normal() else { return false };
    let from_behind = |view: usize| {
        let pose = &state.rig_from_board[view];
        (*pose * normal).dot(&pose.translation()) < 0.0
    };
    let good: Vec<usize> = (0..faults.len()).filter(|view| faults[*view].is_none()).collect();
    let (behind, front): (Vec<usize>, Vec<usize>) =
        good.into_iter().partition(|view| from_behind(*view));
    // A board with left-handed coordinates appears mirrored in every view: only the minority is
    // wrong.
    let odd = if behind.len() <= front.len() { behind } else { front };
    for view in &odd {
        faults[*view] = Some(ViewFault::Mirrored);
    }
    !odd.is_empty()
}

/// Estimates poses of the rejected views, so that their residuals can be shown.
fn place_rejected_views(prepared: &Prepared, fit: &mut CameraFit) {
    for view in 0..fit.faults.len() {
        let Some(fault) = fit.faults[view] else { continue };
        let state = &mut fit.robust.minimum.state;
        match locate(prepared, view, state) {
            Some((pose, residuals)) => {
                state.rig_from_board[view] = pose;
                if let ViewFault::NoPose { .. } = fault {
                    let rms_px = rms(&residuals, &fit.observations[view].inverse_std, |_| true);
                    fit.faults[view] = Some(ViewFault::NoPose { rms_px });
                }
                fit.robust.minimum.equations.residuals[view] = residuals;
            }
            None => fit.robust.minimum.equations.residuals[view].fill([f64::INFINITY; 2]),
        }
    }
}

/// The rms in pixels, from residuals in standard deviations.
pub(crate) fn rms(
    residuals: &[[f64; 2]],
    inverse_std: &[f64],
    used: impl Fn(usize) -> bool,
) -> f64 {
    let (mut sum, mut count) = (0.0, 0);
    for (index, ([x, y], inverse_std)) in residuals.iter().zip(inverse_std).enumerate() {
        if used(index) {
            sum += (x * x + y * y) / (inverse_std * inverse_std);
            count += 1;
        }
    }
    (sum / f64::from(count.max(1))).sqrt()
}

/// The largest relative standard deviation of the focal length: with a larger one, the lens counts
/// as not determined.
pub(crate) const OPEN_FOCAL: f64 = 0.2;

/// The least noise that is assumed, in units of the corners' own standard deviations.
pub(crate) const LEAST_NOISE: f64 = 0.01;
