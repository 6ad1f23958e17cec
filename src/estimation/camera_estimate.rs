//! What a fit says of a camera: lens, poses, what was rejected and why, and the covariance of
//! everything.

use nalgebra::{DMatrix, Matrix6, Vector3};

use crate::estimation::camera_fit::{CameraFit, LEAST_NOISE, OPEN_FOCAL, rms};
use crate::estimation::clustered_covariance::{Clustered, FitCovariance};
use crate::estimation::error::EstimationError;
use crate::estimation::joint::minimize::Minimum;
use crate::estimation::joint::normal::chain;
use crate::estimation::lens_choice::LensTrial;
use crate::estimation::measured_board::{MeasuredBoard, RollingShutter};
use crate::estimation::problem::{CameraProblem, CameraStart};
use crate::estimation::start::Prepared;
use crate::estimation::view_fault::ViewFault;
use crate::geometry::lens::Lens;
use crate::geometry::pixel::ImageSize;
use crate::geometry::pose::Pose;

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
    /// The noise floor, in pixels: a common standard deviation, added in quadrature to every corner's
    /// own `std_px`. Estimated by maximum likelihood.
    pub noise_floor_px: f64,
    /// The noise estimated from the residuals: the factor on each corner's `std_px`, with
    /// [`Self::noise_floor_px`] in it.
    pub noise: f64,
    /// Variance inflation: the ratio to the variances for independent corners, 1 unless residuals
    /// within a view are correlated. All covariances include it.
    pub variance_inflation: f64,
    /// Root mean square over the used corners of the distance between seen and projected, in
    /// pixels.
    pub rms_px: f64,
    /// Every view of the problem, in order.
    pub views: Vec<ViewEstimate>,
    /// The board's shape, where the views show one.
    pub board_shape: Option<MeasuredBoard>,
    /// Motion while rows were read, where the views show it.
    pub rolling_shutter: Option<RollingShutter>,
    /// The models that were compared, where the choice was left open; the chosen one is
    /// [`Self::lens`]'s.
    pub compared: Vec<LensTrial>,
}

/// One view of an estimate.
#[derive(Debug, Clone, PartialEq)]
pub struct ViewEstimate {
    /// The view's name.
    pub name: String,
    /// Why it is not in use; `None` if it is.
    pub fault: Option<ViewFault>,
    /// Where the board was; for a view that is not in use the best guess, if there is one.
    pub camera_from_board: Option<Pose>,
    /// Covariance of that pose, as a rotation about the camera's axes (radians) and a translation of the
    /// problem's mean point (meters); `None` for a view that is not in use.
    pub covariance: Option<Matrix6<f64>>,
    /// Root mean square over the corners in use (over all of them in a view that is not), in
    /// pixels.
    pub rms_px: Option<f64>,
    /// Measured minus projected of each corner, in pixels; infinite where nothing is projected.
    pub residuals_px: Vec<[f64; 2]>,
    /// Which corners are in use: the inliers, unless the whole view is left out.
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

    /// The share of all corners that are not in use.
    pub fn outlier_fraction(&self) -> f64 {
        let corners = || self.views.iter().flat_map(|view| &view.used);
        corners().filter(|used| !**used).count() as f64 / corners().count().max(1) as f64
    }
}

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
    (fit, covariance): (&CameraFit, Option<&FitCovariance>),
    part: Part,
) -> Result<CameraEstimate, EstimationError> {
    let Minimum { state, equations, .. } = &fit.robust.minimum;
    let noise2 = fit.effects.as_ref().map_or_else(|| fit.noise_square(), |e| e.noise_square);
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
    let covariance = covariance.ok_or_else(|| open(0, f64::INFINITY))?;
    let unit = &covariance.unit;
    let of_lens = match &fit.effects {
        Some(effects) => Clustered {
            covariance: effects.lens_covariance.clone(),
            factor: effects.inflation,
            weight: effects.weight_of_views,
        },
        None => covariance.block(at.lens_at..at.lens_at + at.lens.free.len()),
    };
    let variance_inflation = of_lens.factor;
    let variance = noise2 * variance_inflation;
    let (by_free, free) = (at.lens.all_by_free(&lens), at.lens.free.len());
    let mut lens_covariance = &by_free * of_lens.covariance * by_free.transpose();
    if let Some(doubt) = &fit.shutter_doubt {
        // How views differ has the shutter's part in it.
        lens_covariance += doubt * doubt.transpose() * (1.0 - of_lens.weight);
    }
    if let Some(between_models) = &fit.between_models {
        lens_covariance += between_models;
    }
    let of_lens = unit.view((at.lens_at, at.lens_at), (free, free));
    for axis in [0, 1] {
        // Exact corners must not make a lens known that a hundredth of a pixel would leave open.
        let of_unit_noise = by_free.row(axis) * of_lens * by_free.row(axis).transpose();
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
        let translation = pose.translation() - pose * prepared.center_in_board;
        let chained = at.pose_at.map(|pose_at| {
            let (by_sensor, by_board) = chain(state, (part.sensor, observation.frame_set));
            (pose_at, by_sensor, by_board)
        });
        let known = fault.is_none();
        let covariance = known
            .then(|| equations.pose_covariance(observation.frame_set, unit, chained))
            .flatten();
        ViewEstimate {
            name: problem.views[index - part.first_observation].name.clone(),
            fault,
            camera_from_board: placed.then(|| Pose::new(pose.rotation(), translation)),
            covariance: match &fit.effects {
                Some(effects) => effects.pose_covariances[index]
                    .filter(|_| known)
                    .map(|covariance| covariance * variance_inflation),
                None => covariance.map(|c| c * variance),
            },
            rms_px: placed.then(|| {
                rms(residuals, &observation.inverse_std, |k| fault.is_some() || observation.used[k])
            }),
            residuals_px: residuals
                .iter()
                .zip(&observation.inverse_std)
                .map(|(r, s)| r.map(|r| if r.is_finite() { -r / s } else { f64::INFINITY }))
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
        board_shape: fit
            .effects
            .as_ref()
            .and_then(|effects| MeasuredBoard::of(effects, prepared.center_in_board)),
        rolling_shutter: fit
            .effects
            .as_ref()
            .and_then(|effects| RollingShutter::of(effects, &good)),
        compared: Vec::new(),
    })
}

/// The rms over all corners in use.
fn rms_of_views(views: &[ViewEstimate]) -> f64 {
    let (mut squares, mut corners) = (0.0, 0.0);
    for view in views.iter().filter(|view| view.fault.is_none()) {
        let count = view.used.iter().filter(|used| **used).count() as f64;
        squares += view.rms_px.unwrap_or(0.0).powi(2) * count;
        corners += count;
    }
    (squares / f64::max(corners, 1.0)).sqrt()
}

/// Why the focal length is not determined, by the board's normals in the views.
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
        remedy: "tilt the board by 20 to 45 degrees in different directions and let it fill more of the image",
    }
}
