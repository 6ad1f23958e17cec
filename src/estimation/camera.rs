//! One camera from views of a board: lens, poses, what was rejected and why, and the covariance of
//! everything.

use nalgebra::{DMatrix, Matrix6, Vector3};

use crate::estimation::error::EstimationError;
use crate::estimation::joint::minimize::{Minimum, Stop};
use crate::estimation::joint::normal::chain;
use crate::estimation::joint::{BoardObservation, FreeLens, Layout, State};
use crate::estimation::lens_choice::{self, LensTrial};
use crate::estimation::model_check::ModelCheck;
use crate::estimation::model_error::{noise_floor_px_of, with_noise_floor};
use crate::estimation::problem::{CameraProblem, LensChoice};
use crate::estimation::robust::{Loss, median_scale};
use crate::estimation::robust_fit::{RobustFit, robust_fit};
use crate::estimation::start::{self, Prepared};
use crate::estimation::variance_inflation::variance_inflation;
use crate::estimation::view_fault::ViewFault;
use crate::geometry::lens::{Lens, LensModel};
use crate::geometry::pixel::ImageSize;
use crate::geometry::pose::Pose;

/// What to estimate, and from where.
#[derive(Debug, Clone, PartialEq)]
pub struct CameraOptions {
    /// The lens model. Default: chosen by held-out error.
    pub lens: LensChoice,
    /// Whether skew is estimated; else it is 0. Default: no.
    pub skew: bool,
    /// Whether fx = fy. Default: no.
    pub square_pixels: bool,
    /// Whether the board may be bowed, by two parameters. Default: no.
    pub warp: bool,
    /// Lens parameters that are known, by name, with their values. Default: none.
    pub given: Vec<(String, f64)>,
    /// An earlier estimate to go on from. Default: none.
    pub start: Option<CameraStart>,
}

impl Default for CameraOptions {
    fn default() -> Self {
        Self {
            lens: LensChoice::Auto,
            skew: false,
            square_pixels: false,
            warp: false,
            given: Vec::new(),
            start: None,
        }
    }
}

/// An estimate of nearly the same problem.
#[derive(Debug, Clone, PartialEq)]
pub struct CameraStart {
    /// Its lens; used where it is of the model to fit.
    pub lens: Lens,
    /// Its `camera_from_board` of the problem's first views; views beyond it, or without one, are
    /// found anew.
    pub camera_from_board: Vec<Option<Pose>>,
    /// Its [`CameraEstimate::noise_floor_px`].
    pub noise_floor_px: f64,
}

/// A calibrated camera.
#[derive(Debug, Clone, PartialEq)]
pub struct CameraEstimate {
    /// The size of its images.
    pub image_size: ImageSize,
    /// Its lens.
    pub lens: Lens,
    /// Covariance of the lens parameters, in the order of [`Lens::parameter_names`]; zero rows for
    /// those not estimated.
    pub lens_covariance: DMatrix<f64>,
    /// The error that all corners were taken to have beyond their own `std_px`, in pixels: what the
    /// residuals show of one. It brings weights nearer to equal.
    pub noise_floor_px: f64,
    /// The noise that the residuals tell of: the factor on each corner's `std_px`, with
    /// [`Self::noise_floor_px`] in it.
    pub noise: f64,
    /// How many times greater all variances are than if each corner erred by itself: 1 unless the
    /// views show that the corners of a view err together. Covariances have it in them.
    pub variance_inflation: f64,
    /// Root mean square over the used corners of the distance between seen and projected, in
    /// pixels.
    pub rms_px: f64,
    /// Every view of the problem, in order.
    pub views: Vec<ViewEstimate>,
    /// The board's bow along x and y at its middle, in meters, where it was estimated.
    pub warp_m: Option<[f64; 2]>,
    /// The models that were compared, where the choice was left open; the chosen one is
    /// [`Self::lens`]'s.
    pub compared: Vec<LensTrial>,
}

/// One view of an estimate.
#[derive(Debug, Clone, PartialEq)]
pub struct ViewEstimate {
    /// The view's name.
    pub name: String,
    /// Why it took no part; `None` if it did.
    pub fault: Option<ViewFault>,
    /// Where the board was; for a view that took no part the best guess, if there is one.
    pub camera_from_board: Option<Pose>,
    /// Covariance of that pose, as a turn about the camera's axes (radians) and a shift of the
    /// problem's mean point (meters); `None` for a view that took no part.
    pub covariance: Option<Matrix6<f64>>,
    /// Root mean square over the corners that took part (over all of them in a view that did not),
    /// in pixels.
    pub rms_px: Option<f64>,
    /// Projected minus seen of each corner, in pixels; infinite where nothing is projected.
    pub residuals_px: Vec<[f64; 2]>,
    /// Which corners took part.
    pub used: Vec<bool>,
}

impl CameraEstimate {
    /// Standard deviation of each lens parameter, in the order of [`Lens::parameter_names`]; 0
    /// where not estimated.
    pub fn lens_std(&self) -> Vec<f64> {
        self.lens_covariance.diagonal().iter().map(|variance| variance.sqrt()).collect()
    }

    /// What to start from when views are added.
    pub fn to_start(&self) -> CameraStart {
        let good =
            |view: &ViewEstimate| view.fault.is_none().then_some(view.camera_from_board).flatten();
        let camera_from_board = self.views.iter().map(good).collect();
        CameraStart { lens: self.lens, camera_from_board, noise_floor_px: self.noise_floor_px }
    }

    /// The part of all corners that took no part.
    pub fn outlier_fraction(&self) -> f64 {
        let corners = || self.views.iter().flat_map(|view| &view.used);
        corners().filter(|used| !**used).count() as f64 / corners().count().max(1) as f64
    }
}

/// Calibrates a camera: Zhang's closed form for a start (or `options.start`), then
/// Levenberg–Marquardt over the lens and all poses, against corners and views chosen robustly.
/// Deterministic.
///
/// # Errors
/// Numbers that are not finite, too few usable views, views that leave the lens open: each says
/// what to do.
pub fn calibrate_camera(
    problem: &CameraProblem,
    options: &CameraOptions,
) -> Result<CameraEstimate, EstimationError> {
    Ok(solve(problem, options)?.0)
}

/// As [`calibrate_camera`], with what tells whether the model is right
/// ([`crate::estimation::model_check`]).
///
/// # Errors
/// As [`calibrate_camera`].
pub fn calibrate_and_check(
    problem: &CameraProblem,
    options: &CameraOptions,
) -> Result<(CameraEstimate, ModelCheck), EstimationError> {
    let (estimate, fit) = solve(problem, options)?;
    let check = ModelCheck::of(&fit, &estimate);
    Ok((estimate, check))
}

fn solve(
    problem: &CameraProblem,
    options: &CameraOptions,
) -> Result<(CameraEstimate, CameraFit), EstimationError> {
    check(problem)?;
    let known_px = options.start.as_ref().map_or(0.0, |start| start.noise_floor_px);
    let (first, first_fit) = solve_weighted((problem, known_px), options)?;
    let Some(noise_floor_px) = noise_floor_px_of(problem, &first) else {
        return Ok((first, first_fit));
    };
    let model = LensChoice::Model(first.lens.model());
    let again = CameraOptions { lens: model, start: Some(first.to_start()), ..options.clone() };
    match solve_weighted((problem, noise_floor_px), &again) {
        Ok((estimate, fit)) => Ok((CameraEstimate { compared: first.compared, ..estimate }, fit)),
        Err(_) => Ok((first, first_fit)),
    }
}

/// As [`solve`], with an error of `noise_floor_px` added to every corner's own.
fn solve_weighted(
    (problem, noise_floor_px): (&CameraProblem, f64),
    options: &CameraOptions,
) -> Result<(CameraEstimate, CameraFit), EstimationError> {
    let problem = &*with_noise_floor(problem, noise_floor_px);
    let mut prepared = Prepared::of(problem);
    let (fit, compared) = match options.lens {
        LensChoice::Model(model) => (fit_camera(&mut prepared, model, options)?, Vec::new()),
        LensChoice::Auto => lens_choice::choose_lens(&mut prepared, options)?,
    };
    Ok((
        CameraEstimate {
            noise_floor_px,
            compared,
            ..assemble(problem, &prepared, &fit, Part::WHOLE)?
        },
        fit,
    ))
}

pub(crate) fn check(problem: &CameraProblem) -> Result<(), EstimationError> {
    let ImageSize { width, height } = problem.image_size;
    if width == 0 || height == 0 {
        return Err(EstimationError::ImageSize { width, height });
    }
    for view in &problem.views {
        for (point, c) in view.correspondences.iter().enumerate() {
            let not_finite =
                |what| EstimationError::NotFinite { view: view.name.clone(), point, what };
            if !c.point_in_board.coords.iter().all(|v| v.is_finite()) {
                return Err(not_finite("the board point"));
            }
            if !c.pixel.is_finite() {
                return Err(not_finite("the pixel"));
            }
            if !(c.std_px > 0.0 && c.std_px.is_finite()) {
                return Err(EstimationError::Std {
                    view: view.name.clone(),
                    point,
                    std_px: c.std_px,
                });
            }
        }
    }
    Ok(())
}

/// A fitted camera, about the common center of its points.
#[derive(Debug, Clone)]
pub(crate) struct CameraFit {
    pub(crate) layout: Layout,
    pub(crate) robust: RobustFit,
    pub(crate) observations: Vec<BoardObservation>,
    pub(crate) faults: Vec<Option<ViewFault>>,
}

/// Views looked at one by one, at most: with this many, views that differ do so visibly.
const MAX_VIEWS: usize = 60;

impl CameraFit {
    pub(crate) fn new(
        layout: Layout,
        robust: RobustFit,
        observations: Vec<BoardObservation>,
        faults: Vec<Option<ViewFault>>,
    ) -> Self {
        Self { layout, robust, observations, faults }
    }

    pub(crate) fn lens(&self) -> &Lens {
        &self.robust.minimum.state.lenses[0]
    }

    /// The variance that the residuals show, in units of the corners' own.
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

    /// The covariance of its first camera's lens parameters, as if no corner were seen better than
    /// [`LEAST_NOISE`]; `None` where they are not determined.
    pub(crate) fn lens_covariance(&self) -> Option<DMatrix<f64>> {
        let free = &self.layout.sensors[0].lens;
        let unit = self.robust.minimum.equations.global_covariance()?;
        let spread = free.spread(self.lens());
        let unit = unit.view((0, 0), (free.free.len(), free.free.len()));
        let covariance = &spread
            * unit
            * spread.transpose()
            * self.noise_square().max(LEAST_NOISE * LEAST_NOISE);
        let known = |axis: usize| {
            covariance[(axis, axis)].sqrt() < OPEN_FOCAL * self.lens().parameters()[axis]
        };
        (known(0) && known(1)).then_some(covariance)
    }

    /// The views that take part, by index.
    pub(crate) fn good_views(&self) -> Vec<usize> {
        (0..self.faults.len()).filter(|view| self.faults[*view].is_none()).collect()
    }

    /// The good observations of each frame set, by index: of all frame sets that have any, or of enough of
    /// them, evenly. For a camera by itself a frame set is a view.
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

/// Fits one lens model.
pub(crate) fn fit_camera(
    prepared: &mut Prepared,
    model: LensModel,
    options: &CameraOptions,
) -> Result<CameraFit, EstimationError> {
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
    fit_from(prepared, state, free_lens, (options.warp, needed))
}

/// Fits on from a state; then looks again at every view.
fn fit_from(
    prepared: &Prepared,
    state: State,
    free_lens: FreeLens,
    (warp, needed): (bool, usize),
) -> Result<CameraFit, EstimationError> {
    let layout = Layout::new(vec![free_lens], warp.then(|| prepared.half_extent()));
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

/// Looks again, with the lens known, at views that were set aside only because no homography
/// explained them.
fn readmit(prepared: &Prepared, robust: &mut RobustFit, faults: &mut [Option<ViewFault>]) -> bool {
    let mut readmitted = false;
    for (view, fault) in faults.iter_mut().enumerate() {
        let Some(ViewFault::NoPose { .. }) = fault else { continue };
        let Some((pose, residuals)) = locate(prepared, view, &robust.minimum.state) else {
            continue;
        };
        let good = residuals.iter().filter(|[x, y]| x.hypot(*y) <= robust.limit).count();
        if 10 * good >= 9 * residuals.len() {
            robust.minimum.state.rig_from_board[view] = pose;
            (*fault, readmitted) = (None, true);
        }
    }
    readmitted
}

/// The pose of a view by itself under a known lens, robustly, with its residuals in standard
/// deviations.
fn locate(prepared: &Prepared, view: usize, state: &State) -> Option<(Pose, Vec<[f64; 2]>)> {
    let lens = state.lenses[0];
    let pose = prepared.pose(view, &lens)?;
    let start = State { rig_from_board: vec![pose], ..state.clone() };
    let fixed = FreeLens { model: lens.model(), free: Vec::new(), square_pixels: false };
    let layout = Layout::new(vec![fixed], None);
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

/// Names the views that see the board's other side than most.
fn name_mirrored(prepared: &Prepared, state: &State, faults: &mut [Option<ViewFault>]) -> bool {
    let Some(normal) = prepared.board_normal() else { return false };
    let from_behind = |view: usize| {
        let pose = &state.rig_from_board[view];
        (*pose * normal).dot(&pose.translation()) < 0.0
    };
    let good: Vec<usize> = (0..faults.len()).filter(|view| faults[*view].is_none()).collect();
    let (behind, front): (Vec<usize>, Vec<usize>) =
        good.into_iter().partition(|view| from_behind(*view));
    // A board whose points are given in a left-handed order is seen so in every view: only the odd
    // ones out are wrong.
    let odd = if behind.len() <= front.len() { behind } else { front };
    for view in &odd {
        faults[*view] = Some(ViewFault::Mirrored);
    }
    !odd.is_empty()
}

/// Poses for the views that took no part, for their residuals to be seen.
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

/// The rms in pixels of residuals in standard deviations.
fn rms(residuals: &[[f64; 2]], inverse_std: &[f64], used: impl Fn(usize) -> bool) -> f64 {
    let (mut sum, mut count) = (0.0, 0);
    for (index, ([x, y], inverse_std)) in residuals.iter().zip(inverse_std).enumerate() {
        if used(index) {
            sum += (x * x + y * y) / (inverse_std * inverse_std);
            count += 1;
        }
    }
    (sum / f64::from(count.max(1))).sqrt()
}

/// The relative standard deviation of the focal length above which views are refused: a lens known
/// no better than this is not known.
const OPEN_FOCAL: f64 = 0.2;

/// No corner is seen better than this, in units of its own standard deviation.
const LEAST_NOISE: f64 = 0.01;

/// Which part of a fit is one camera's.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Part {
    pub(crate) sensor: usize,
    /// Its first observation; the others follow, one per view.
    pub(crate) first_observation: usize,
    /// What its corners' standard deviations were multiplied by.
    pub(crate) noise: f64,
}

impl Part {
    /// A camera by itself.
    pub(crate) const WHOLE: Self = Self { sensor: 0, first_observation: 0, noise: 1.0 };
}

/// What a fit says of one of its cameras.
pub(crate) fn assemble(
    problem: &CameraProblem,
    prepared: &Prepared,
    fit: &CameraFit,
    part: Part,
) -> Result<CameraEstimate, EstimationError> {
    let Minimum { state, equations, .. } = &fit.robust.minimum;
    let noise2 = fit.noise_square();
    let lens = state.lenses[part.sensor];
    let at = &fit.layout.sensors[part.sensor];
    let observations = part.first_observation..part.first_observation + problem.views.len();
    let good: Vec<usize> =
        observations.clone().filter(|observation| fit.faults[*observation].is_none()).collect();
    let pose_of = |observation: usize| {
        state.sensor_from_board(part.sensor, fit.observations[observation].frame_set)
    };
    let camera_from_board: Vec<Pose> =
        good.iter().map(|observation| pose_of(*observation)).collect();
    let open = |parameter, std| undetermined(prepared, &camera_from_board, &lens, (parameter, std));
    let unit = equations.global_covariance().ok_or_else(|| open(0, f64::INFINITY))?;
    let variance_inflation =
        variance_inflation(fit, &unit, at.lens_at..at.lens_at + at.lens.free.len());
    let variance = noise2 * variance_inflation;
    let (spread, free) = (at.lens.spread(&lens), at.lens.free.len());
    let of_lens = unit.view((at.lens_at, at.lens_at), (free, free));
    let lens_covariance = &spread * of_lens * spread.transpose() * variance;
    for axis in [0, 1] {
        // Exact corners must not make a lens known that a hundredth of a pixel would leave open.
        let of_unit_noise = spread.row(axis) * of_lens * spread.row(axis).transpose();
        let std = (of_unit_noise[(0, 0)] * variance_inflation).sqrt()
            * noise2.sqrt().max(LEAST_NOISE / part.noise);
        if !(std < OPEN_FOCAL * lens.parameters()[axis]) {
            return Err(open(axis, std));
        }
    }
    let views = observations.map(|index| {
        let (fault, observation, residuals) =
            (fit.faults[index], &fit.observations[index], &equations.residuals[index]);
        let placed = residuals.iter().any(|r| r[0].is_finite());
        let pose = pose_of(index);
        let shift = pose.translation() - pose * prepared.center_in_board;
        let chained = at.pose_at.map(|pose_at| {
            let (by_sensor, by_board) = chain(state, (part.sensor, observation.frame_set));
            (pose_at, by_sensor, by_board)
        });
        let known = fault.is_none();
        let covariance = known
            .then(|| equations.pose_covariance(observation.frame_set, &unit, chained))
            .flatten();
        ViewEstimate {
            name: problem.views[index - part.first_observation].name.clone(),
            fault,
            camera_from_board: placed.then(|| Pose::new(pose.rotation(), shift)),
            covariance: covariance.map(|c| c * variance),
            rms_px: placed.then(|| {
                rms(residuals, &observation.inverse_std, |k| fault.is_some() || observation.used[k])
            }),
            residuals_px: residuals
                .iter()
                .zip(&observation.inverse_std)
                .map(|(r, s)| r.map(|r| r / s))
                .collect(),
            used: observation.used.clone(),
        }
    });
    let views: Vec<ViewEstimate> = views.collect();
    Ok(CameraEstimate {
        image_size: problem.image_size,
        lens,
        lens_covariance,
        noise_floor_px: 0.0,
        noise: part.noise * noise2.sqrt(),
        variance_inflation,
        rms_px: rms_of_views(&views),
        views,
        warp_m: fit.layout.warp.map(|_| state.warp),
        compared: Vec::new(),
    })
}

/// The rms over all corners that took part.
fn rms_of_views(views: &[ViewEstimate]) -> f64 {
    let (mut squares, mut corners) = (0.0, 0.0);
    for view in views.iter().filter(|view| view.fault.is_none()) {
        let count = view.used.iter().filter(|used| **used).count() as f64;
        squares += view.rms_px.unwrap_or(0.0).powi(2) * count;
        corners += count;
    }
    (squares / f64::max(corners, 1.0)).sqrt()
}

/// Why the focal length is open: the board's normals in the views tell.
fn undetermined(
    prepared: &Prepared,
    camera_from_board: &[Pose],
    lens: &Lens,
    (index, std): (usize, f64),
) -> EstimationError {
    let normals: Vec<Vector3<f64>> = match prepared.board_normal() {
        Some(normal) => camera_from_board.iter().map(|pose| *pose * normal).collect(),
        None => Vec::new(),
    };
    let widest = |a: &Vector3<f64>| normals.iter().map(|b| a.angle(b)).fold(0.0, f64::max);
    if normals.first().is_some_and(|first| widest(first) < 0.05) {
        return EstimationError::ParallelViews;
    }
    EstimationError::Undetermined {
        parameter: Lens::parameter_names(lens.model())[index],
        value: lens.parameters()[index],
        std,
        remedy: "tilt the board by 20 to 45 degrees in different directions and let it fill more of the picture",
    }
}
