//! The estimate of a camera from a fit: lens, poses, rejected views with the reason, and all
//! covariances.

use nalgebra::{DMatrix, Matrix6, Vector3};

use crate::estimation::camera_fit::{CameraFit, LEAST_NOISE, OPEN_FOCAL, rms};
use crate::estimation::clustered_covariance::{Clustered, FitCovariance};
use crate::estimation::error::EstimationError;
use crate::estimation::joint::SensorLayout;
use crate::estimation::joint::minimize::Minimum;
use crate::estimation::joint::normal::ChainedPose;
use crate::estimation::lens_choice::LensTrial;
use crate::estimation::lens_choice::other_minimum::OtherMinimum;
use crate::estimation::measured_board::{MeasuredBoard, RollingShutter};
use crate::estimation::problem::{CameraProblem, CameraStart};
use crate::estimation::start::Prepared;
use crate::estimation::view_fault::ViewFault;
use crate::estimation::view_motion::ViewMotion;
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
    /// The noise floor, in pixels: a common standard deviation, added in quadrature to every
    /// corner's own `std_px`. Estimated by maximum likelihood.
    pub noise_floor_px: f64,
    /// The noise estimated from the residuals, as a factor on each corner's `std_px` with
    /// [`Self::noise_floor_px`] added in quadrature.
    pub noise: f64,
    /// Variance inflation: the ratio to the variances for independent corners, 1 unless residuals
    /// within a view are correlated. All covariances include it.
    pub variance_inflation: f64,
    /// Root mean square of the reprojection error over the used corners, in pixels.
    pub rms_px: f64,
    /// Every view of the problem, in order.
    pub views: Vec<ViewEstimate>,
    /// The board's shape, where the views show one.
    pub board_shape: Option<MeasuredBoard>,
    /// Motion during the readout, where the views show it.
    pub rolling_shutter: Option<RollingShutter>,
    /// The models that were compared, where the choice was left open; the chosen one is
    /// [`Self::lens`]'s.
    pub compared: Vec<LensTrial>,
    /// Another lens of the same model that fits the views as closely as [`Self::lens`].
    /// [`Self::lens_covariance`] is about [`Self::lens`] alone; [`Self::lens_std`] includes both.
    pub other_minimum: Option<OtherMinimum>,
}

/// One view of an estimate.
#[derive(Debug, Clone, PartialEq)]
pub struct ViewEstimate {
    /// The view's name.
    pub name: String,
    /// Why it is not in use; `None` if it is.
    pub fault: Option<ViewFault>,
    /// The board's pose; for a view that is not in use the best guess, if there is one.
    pub camera_from_board: Option<Pose>,
    /// The board's motion during the view's readout; `None` without a rolling shutter.
    pub motion: Option<ViewMotion>,
    /// Covariance of that pose, as a rotation about the camera's axes (radians) and a translation
    /// of the problem's mean point (meters); `None` for a view that is not in use.
    pub covariance: Option<Matrix6<f64>>,
    /// Root mean square over the corners in use (over all of them in a view that is not), in
    /// pixels.
    pub rms_px: Option<f64>,
    /// Measured minus projected position of each corner, in pixels; infinite where it cannot be
    /// projected.
    pub residuals_px: Vec<[f64; 2]>,
    /// Which corners are in use: the inliers, unless the whole view is left out.
    pub used: Vec<bool>,
}

impl CameraEstimate {
    /// Standard deviation of each lens parameter, in the order of [`Lens::parameter_names`]; 0
    /// where not estimated.
    pub fn lens_std(&self) -> Vec<f64> {
        let mut variances: Vec<f64> = self.lens_covariance.diagonal().iter().copied().collect();
        if let Some(OtherMinimum { lens, probability }) = &self.other_minimum {
            // At even odds, the error is the whole distance to the other lens where this one is
            // wrong.
            let odds = probability / (1.0 - probability);
            let pairs = lens.parameters().into_iter().zip(self.lens.parameters());
            for (variance, (other, own)) in variances.iter_mut().zip(pairs) {
                *variance += odds * (other - own).powi(2);
            }
        }
        variances.into_iter().map(f64::sqrt).collect()
    }

    /// The start of a solve with more views.
    pub fn to_start(&self) -> CameraStart {
        let good =
            |view: &ViewEstimate| view.fault.is_none().then_some(view.camera_from_board).flatten();
        let camera_from_board = self.views.iter().map(good).collect();
        CameraStart { lens: self.lens, camera_from_board, noise_floor_px: self.noise_floor_px }
    }

    /// The part of all corners that is not in use.
    pub fn outlier_fraction(&self) -> f64 {
        let corners = || self.views.iter().flat_map(|view| &view.used);
        corners().filter(|used| !**used).count() as f64 / corners().count().max(1) as f64
    }
}

/// One camera's part of a fit.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Part {
    pub(crate) sensor: usize,
    /// Its first observation; the others follow, one per view.
    pub(crate) first_observation: usize,
    /// The factor by which its corners' standard deviations were multiplied.
    pub(crate) noise: f64,
}

impl Part {
    /// A camera by itself.
    pub(crate) const WHOLE: Self = Self { sensor: 0, first_observation: 0, noise: 1.0 };
}

/// The estimate of one camera of a fit.
pub(crate) fn assemble(
    problem: &CameraProblem,
    prepared: &Prepared,
    fit: &CameraFit,
    covariance: Option<&FitCovariance>,
    part: Part,
) -> Result<CameraEstimate, EstimationError> {
    let state = &fit.robust.minimum.state;
    let observations = part.first_observation..part.first_observation + problem.views.len();
    let good: Vec<usize> =
        observations.clone().filter(|observation| fit.faults[*observation].is_none()).collect();
    let pose_of = |observation: &usize| {
        state.sensor_from_board(part.sensor, fit.observations[*observation].frame_set)
    };
    let camera_from_board: Vec<Pose> = good.iter().map(pose_of).collect();
    let lens = state.lenses[part.sensor];
    let open = |parameter, std| undetermined(prepared, &camera_from_board, &lens, parameter, std);
    let covariance = covariance.ok_or_else(|| open(0, f64::INFINITY))?;
    let part_of_fit = FittedPart::of(fit, covariance, part);
    if let Some((axis, std)) = part_of_fit.open_focal() {
        return Err(open(axis, std));
    }
    let views: Vec<ViewEstimate> = observations
        .zip(&problem.views)
        .map(|(index, view)| part_of_fit.view(&view.name, index, &prepared.center_in_board))
        .collect();
    let effects = fit.effects.as_ref();
    Ok(CameraEstimate {
        image_size: problem.image_size,
        lens,
        lens_covariance: part_of_fit.lens_covariance(),
        noise_floor_px: 0.0,
        noise: part.noise * part_of_fit.noise_square.sqrt(),
        variance_inflation: part_of_fit.of_lens.factor,
        rms_px: rms_of_views(&views),
        views,
        board_shape: effects
            .and_then(|effects| MeasuredBoard::of(effects, prepared.center_in_board)),
        rolling_shutter: effects.and_then(|effects| RollingShutter::of(effects, &good)),
        compared: Vec::new(),
        other_minimum: None,
    })
}

/// One camera of a fit, with the covariance of its parameters.
struct FittedPart<'a> {
    fit: &'a CameraFit,
    part: Part,
    /// The covariance of all global parameters, for noise of unit variance.
    unit: &'a DMatrix<f64>,
    /// The covariance of the lens's free parameters, including the scatter between views.
    of_lens: Clustered,
    /// The variance of the noise, as a factor on the corners' own variances.
    noise_square: f64,
}

impl<'a> FittedPart<'a> {
    fn of(fit: &'a CameraFit, covariance: &'a FitCovariance, part: Part) -> Self {
        let at = &fit.layout.sensors[part.sensor];
        let (of_lens, noise_square) = match &fit.effects {
            Some(effects) => {
                let of_lens = Clustered {
                    covariance: effects.lens_covariance.clone(),
                    factor: effects.inflation,
                    weight: effects.weight_of_views,
                };
                (of_lens, effects.noise_square)
            }
            None => {
                let block = at.lens_at..at.lens_at + at.lens.free.len();
                (covariance.block(block), fit.noise_square())
            }
        };
        Self { fit, part, unit: &covariance.unit, of_lens, noise_square }
    }

    fn lens(&self) -> &Lens {
        &self.fit.robust.minimum.state.lenses[self.part.sensor]
    }

    fn at(&self) -> &SensorLayout {
        &self.fit.layout.sensors[self.part.sensor]
    }

    /// The covariance of all parameters of the lens, with the uncertainty about a rolling shutter
    /// and about the model.
    fn lens_covariance(&self) -> DMatrix<f64> {
        let by_free = self.at().lens.all_by_free(self.lens());
        let mut covariance = &by_free * &self.of_lens.covariance * by_free.transpose();
        if let Some(step) = &self.fit.shutter_step {
            // The scatter between views already includes the shutter's part.
            covariance += step * step.transpose() * (1.0 - self.of_lens.weight);
        }
        if let Some(between_models) = &self.fit.between_models {
            covariance += between_models;
        }
        covariance
    }

    /// The index of the first focal length that the views do not determine, with its standard
    /// deviation in pixels.
    fn open_focal(&self) -> Option<(usize, f64)> {
        let (at, lens) = (self.at(), self.lens());
        let (by_free, free) = (at.lens.all_by_free(lens), at.lens.free.len());
        let of_lens = self.unit.view((at.lens_at, at.lens_at), (free, free));
        [0, 1].into_iter().find_map(|axis| {
            // Noiseless corners must not determine a lens that noise of 0.01 σ per corner would
            // leave undetermined.
            let of_unit_noise = by_free.row(axis) * of_lens * by_free.row(axis).transpose();
            let std = (of_unit_noise[(0, 0)] * self.of_lens.factor).sqrt()
                * self.noise_square.sqrt().max(LEAST_NOISE / self.part.noise);
            let is_known = std < OPEN_FOCAL * lens.parameters()[axis];
            (!is_known).then_some((axis, std))
        })
    }

    /// The view of observation `index`; in the fit, poses are relative to `center_in_board`.
    fn view(&self, name: &str, index: usize, center_in_board: &Vector3<f64>) -> ViewEstimate {
        let Minimum { state, equations, .. } = &self.fit.robust.minimum;
        let (fault, observation, residuals) =
            (self.fit.faults[index], &self.fit.observations[index], &equations.residuals[index]);
        let is_projected = residuals.iter().any(|r| r[0].is_finite());
        let pose = state.sensor_from_board(self.part.sensor, observation.frame_set);
        let translation = pose.translation() - pose * *center_in_board;
        let counts = |k: usize| fault.is_some() || observation.used[k];
        let place = (index, observation.frame_set);
        let motion = |effects| ViewMotion::of(effects, place, &pose, center_in_board);
        ViewEstimate {
            name: name.to_owned(),
            fault,
            camera_from_board: is_projected.then(|| Pose::new(pose.rotation(), translation)),
            motion: self.fit.effects.as_ref().and_then(motion).filter(|_| is_projected),
            covariance: self.pose_covariance(index).filter(|_| fault.is_none()),
            rms_px: is_projected.then(|| rms(residuals, &observation.inverse_std, counts)),
            residuals_px: residuals
                .iter()
                .zip(&observation.inverse_std)
                .map(|(r, s)| r.map(|r| if r.is_finite() { -r / s } else { f64::INFINITY }))
                .collect(),
            used: observation.used.clone(),
        }
    }

    /// The covariance of the board's pose in observation `index`.
    fn pose_covariance(&self, index: usize) -> Option<Matrix6<f64>> {
        let inflation = self.of_lens.factor;
        if let Some(effects) = &self.fit.effects {
            return effects.pose_covariances[index].map(|covariance| covariance * inflation);
        }
        let Minimum { state, equations, .. } = &self.fit.robust.minimum;
        let observation = &self.fit.observations[index];
        let chained = ChainedPose::where_posed(&self.fit.layout, state, observation);
        let unit = equations.pose_covariance(observation.frame_set, self.unit, chained)?;
        Some(unit * (self.noise_square * inflation))
    }
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

/// The reason why the focal length is not determined, from the board's normals in the views.
fn undetermined(
    prepared: &Prepared,
    camera_from_board: &[Pose],
    lens: &Lens,
    index: usize,
    std: f64,
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
