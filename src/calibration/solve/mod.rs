//! From observations to a calibration. This file solves one camera: an estimate with its checks and
//! its verdict. `instrument` solves whatever the observations are of: by way of `solve_rgbd` a
//! camera with depth, by way of `cameras` and `solve_rig` several.

mod auxiliary_image_sensor;
mod cameras;
mod composed_pose;
pub mod depth_orientation;
pub(in crate::calibration) mod disparity_meaning;
pub mod factory_check;
pub mod instrument;
mod labels_alike;
mod list_shift;
pub mod observations;
pub mod rgbd_calibration;
mod rgbd_check;
mod rgbd_error;
pub(in crate::calibration) mod rgbd_guess;
pub mod rgbd_input;
pub mod rig_input;
mod rig_joint;
mod rig_member;
pub(in crate::calibration) mod solve_options;
pub mod solve_rgbd;
pub mod solve_rig;

use nalgebra::DMatrix;

use crate::calibration::coverage::Coverage;
use crate::calibration::result::{
    CalibratedSensor, CalibratedView, Calibration, Checks, ComparedLens, Grade, ImageCalibration,
    ProjectionUncertainty, Verdict,
};
use crate::calibration::sensor::SensorId;
use crate::calibration::verdict;
use crate::estimation::camera::{
    CameraEstimate, CameraOptions, calibrate_camera, calibrate_with_jackknife,
};
use crate::estimation::dlt::calibrate_dlt;
use crate::estimation::error::EstimationError;
use crate::estimation::given_misfit::{GivenCheck, GivenMisfit};
use crate::estimation::interrupt::Interrupt;
use crate::estimation::model_check::ModelCheck;
use crate::estimation::problem::CameraProblem;
use crate::estimation::split_halves::LensDifference;
pub use crate::estimation::uncertainty::{Distance, UncertaintyMap};
use crate::estimation::uncertainty::{MedianAndWorst, PixelGrid, projection_uncertainty};
use crate::geometry::lens::Lens;
use crate::geometry::pixel::ImageSize;
use crate::geometry::target::Target;
use crate::imaging::frame::SensorKind;

/// A solved camera.
#[derive(Debug, Clone, PartialEq)]
pub struct SolvedCamera {
    /// The sensor's part of the calibration.
    pub sensor: ImageCalibration,
    /// How it performs on views that it was not fitted to.
    pub checks: Checks,
    /// How far to trust it.
    pub verdict: Verdict,
    /// The estimate itself: residuals, covariances, and a start for estimates with more views.
    pub estimate: CameraEstimate,
    basis: VerdictBasis,
}

/// What a verdict rests on besides the estimate and its uncertainty.
#[derive(Debug, Clone, PartialEq)]
struct VerdictBasis {
    model_check: ModelCheck,
    coverage: Coverage,
    /// Whether pixels were taken as square.
    square_pixels: bool,
}

impl VerdictBasis {
    fn verdict(
        &self,
        estimate: &CameraEstimate,
        uncertainty: Option<&UncertaintyMap>,
        shutter_in_model: bool,
    ) -> Verdict {
        let Self { model_check, coverage, square_pixels } = self;
        let mut verdict =
            verdict::judge(estimate, uncertainty, model_check, coverage, shutter_in_model);
        if let Some(doubt) = verdict::square_pixels(estimate).filter(|_| *square_pixels) {
            verdict.lower(Grade::Usable, doubt);
        }
        verdict
    }
}

impl SolvedCamera {
    /// Takes the difference between two halves of the views from a solve with other sensors.
    pub(super) fn take_halves(&mut self, lens: LensDifference, held_out_rms_px: Option<f64>) {
        let check = &mut self.basis.model_check;
        (check.split_half_ratio, check.focal_change) = (lens.ratio, Some(lens.focal_change));
        check.held_out_rms_px = held_out_rms_px;
        (self.checks.split_half_ratio, self.checks.held_out_rms_px) = (lens.ratio, held_out_rms_px);
    }

    /// What the views contradict of the given lens parameters.
    pub(super) fn given_misfit(&self) -> Option<&GivenMisfit> {
        match &self.basis.model_check.given {
            GivenCheck::Contradicted(misfit) => Some(misfit),
            _ => None,
        }
    }

    /// The verdict with the uncertainty of `sensor`, which a joint solve has reduced.
    pub(super) fn verdict_of(&self, sensor: &ImageCalibration) -> Verdict {
        let uncertainty = sensor_uncertainty(sensor, UNCERTAINTY_COLUMNS, Distance::Infinity);
        let shutter_in_model = sensor.rolling_shutter.is_some();
        self.basis.verdict(&self.estimate, uncertainty.as_ref(), shutter_in_model)
    }

    /// The calibration of an instrument that is this one sensor.
    pub fn into_calibration(self, target: Option<Target>) -> Calibration {
        let color = CalibratedSensor::image(SensorId::own(SensorKind::Color), self.sensor);
        Calibration::unnamed(target, vec![color], self.checks, self.verdict)
    }
}

/// Columns of the grid over which uncertainty is summarized, everywhere.
pub const UNCERTAINTY_COLUMNS: u32 = 12;

/// Calibrates a camera from `problem`, checks the result, and says how far to trust it.
///
/// # Errors
/// As [`calibrate_camera`].
pub fn solve_views(
    problem: &CameraProblem,
    options: &CameraOptions,
) -> Result<SolvedCamera, EstimationError> {
    let (estimate, model_check) = calibrate_with_jackknife(problem, options)?;
    let coverage = corner_coverage(problem, &estimate);
    let checks = Checks {
        split_half_ratio: model_check.split_half_ratio,
        held_out_rms_px: model_check.held_out_rms_px,
        outlier_fraction: estimate.outlier_fraction(),
        coverage: coverage.fraction(),
    };
    let uncertainty = uncertainty_map(&estimate, UNCERTAINTY_COLUMNS, Distance::Infinity);
    let mut sensor = with_uncertainty(&estimate, uncertainty.as_ref());
    if let Some(given) = &options.measured_board {
        (sensor.board_warp_m, sensor.board_shape) = (Some(given.bow_m), Some(given.clone()));
    }
    let basis = VerdictBasis { model_check, coverage, square_pixels: options.square_pixels };
    let verdict = basis.verdict(&estimate, uncertainty.as_ref(), true);
    Ok(SolvedCamera { sensor, checks, verdict, estimate, basis })
}

/// Calibrates a camera without distortion from one view of points in space, by the direct linear
/// transform.
///
/// # Errors
/// As [`calibrate_dlt`].
pub(super) fn solve_dlt(
    problem: &CameraProblem,
    interrupt: &Interrupt,
) -> Result<SolvedCamera, EstimationError> {
    let estimate = calibrate_dlt(problem, interrupt)?.camera;
    let coverage = corner_coverage(problem, &estimate);
    let checks = Checks { coverage: coverage.fraction(), ..Checks::default() };
    let uncertainty = uncertainty_map(&estimate, UNCERTAINTY_COLUMNS, Distance::Infinity);
    let sensor = with_uncertainty(&estimate, uncertainty.as_ref());
    let basis = VerdictBasis { model_check: ModelCheck::default(), coverage, square_pixels: false };
    let verdict = basis.verdict(&estimate, uncertainty.as_ref(), true);
    Ok(SolvedCamera { sensor, checks, verdict, estimate, basis })
}

/// The running estimate of a session: as [`solve_views`], without the checks.
///
/// # Errors
/// As [`calibrate_camera`].
pub fn estimate_views(
    problem: &CameraProblem,
    options: &CameraOptions,
) -> Result<(CameraEstimate, ProjectionUncertainty), EstimationError> {
    let estimate = calibrate_camera(problem, options)?;
    let uncertainty = summary(&estimate);
    Ok((estimate, uncertainty))
}

/// The predicted 1-σ projection uncertainty over the image at `distance`, on a grid with `columns`
/// along its longer side.
pub fn uncertainty_map(
    estimate: &CameraEstimate,
    columns: u32,
    distance: Distance,
) -> Option<UncertaintyMap> {
    let grid = PixelGrid::over(estimate.image_size, columns);
    projection_uncertainty(&estimate.lens, &estimate.lens_covariance, grid, distance)
}

/// As [`uncertainty_map`], for a finished calibration; `None` if it has no covariance.
pub fn sensor_uncertainty(
    sensor: &ImageCalibration,
    columns: u32,
    distance: Distance,
) -> Option<UncertaintyMap> {
    let rows = &sensor.lens_covariance;
    let covariance = DMatrix::from_fn(rows.len(), rows.len(), |i, j| rows[i][j]);
    let grid = PixelGrid::over(sensor.image_size, columns);
    if rows.is_empty() {
        None
    } else {
        projection_uncertainty(&sensor.lens, &covariance, grid, distance)
    }
}

fn summary(estimate: &CameraEstimate) -> ProjectionUncertainty {
    uncertainty_over(&estimate.lens, &estimate.lens_covariance, estimate.image_size)
}

/// The predicted 1-σ projection uncertainty at infinity, summarized over images of `size`, for a
/// lens with this covariance of its parameters; infinite where no pixel is in the lens's valid
/// region.
pub fn uncertainty_over(
    lens: &Lens,
    covariance: &DMatrix<f64>,
    size: ImageSize,
) -> ProjectionUncertainty {
    let grid = PixelGrid::over(size, UNCERTAINTY_COLUMNS);
    summed_up(projection_uncertainty(lens, covariance, grid, Distance::Infinity).as_ref())
}

fn summed_up(map: Option<&UncertaintyMap>) -> ProjectionUncertainty {
    let figures = map.and_then(|map| Some((map.center()?, map.median_and_worst()?)));
    let (center, known) = figures.unwrap_or((f64::INFINITY, MedianAndWorst::UNKNOWN));
    ProjectionUncertainty { center, median: known.median_px, worst: known.worst_px }
}

pub(super) fn sensor_calibration(estimate: &CameraEstimate) -> ImageCalibration {
    with_uncertainty(
        estimate,
        uncertainty_map(estimate, UNCERTAINTY_COLUMNS, Distance::Infinity).as_ref(),
    )
}

fn with_uncertainty(
    estimate: &CameraEstimate,
    uncertainty: Option<&UncertaintyMap>,
) -> ImageCalibration {
    let view = |view: &crate::estimation::camera::ViewEstimate| CalibratedView {
        name: view.name.clone(),
        used: view.fault.is_none(),
        reason: view.fault.map(|fault| fault.to_string()),
        rms_px: view.rms_px.filter(|rms| rms.is_finite()),
        camera_from_board: view.camera_from_board,
        motion: view.motion,
        camera_from_scene: None,
    };
    let compared = |trial: &crate::estimation::lens_choice::LensTrial| ComparedLens {
        model: trial.model,
        held_out_rms_px: trial.held_out_rms_px,
    };
    ImageCalibration {
        image_size: estimate.image_size,
        lens: estimate.lens,
        lens_std: estimate.lens_std(),
        lens_covariance: estimate
            .lens_covariance
            .row_iter()
            .map(|row| row.iter().copied().collect())
            .collect(),
        rms_px: estimate.rms_px,
        uncertainty_px: summed_up(uncertainty),
        views: estimate.views.iter().map(view).collect(),
        compared: estimate.compared.iter().map(compared).collect(),
        board_warp_m: estimate.board_shape.as_ref().map(|shape| shape.bow_m),
        board_shape: estimate.board_shape.clone(),
        rolling_shutter: estimate.rolling_shutter,
        scene: None,
    }
}

/// The image coverage of the corners in use.
fn corner_coverage(problem: &CameraProblem, estimate: &CameraEstimate) -> Coverage {
    let mut cells = Coverage::empty(problem.image_size).cells().to_vec();
    let grid = Coverage::empty(problem.image_size);
    for (view, estimated) in problem.views.iter().zip(&estimate.views) {
        for (corner, used) in view.correspondences.iter().zip(&estimated.used) {
            if let Some((row, col)) =
                grid.cell_of(corner.pixel, problem.image_size).filter(|_| *used)
            {
                cells[row][col] += 1;
            }
        }
    }
    Coverage::from_cells(cells).unwrap_or(grid)
}
