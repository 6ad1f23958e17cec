//! Why a model does not fit: which effect, added to the model, would explain the residuals. Each
//! candidate is tested by one Gauss–Newton step from the minimum (a score test, C. R. Rao, 1948).
//! There are two: a board whose points are off its plane, the same in every view; and motion of the
//! board or the camera during the readout of an image.
//!
//! The board is tested twice. A bow has two unknowns, z = a (1 − x²) + b (1 − y²) over the half
//! extents. It is reported with its directions, and is cheap enough to test for every set of views.
//! A general shape has the seven terms of second and third order, and its height from the lowest to
//! the highest point is reported. It is tested for sets that something else shows to be wrong.
//! Where both are found the verdict names the second, which contains the first.
//!
//! Motion has twelve unknowns per view, which always explain a part of the residuals. So it must
//! explain far more than a board of any shape does, or clearly more than the same motion with
//! columns read in place of rows. Those two differ by perspective only, since a shear along rows is
//! a shear along columns and a rotation.

use nalgebra::{DMatrix, DVector, Matrix2x3, Matrix3xX, Point3, Vector3};

use crate::estimation::camera_fit::CameraFit;
use crate::estimation::joint::Layout;
use crate::estimation::joint::linearize::LinearizationPoint;
use crate::estimation::joint::per_observation::{assemble, linearize_each};
use crate::estimation::problem::{BoardShape, CameraOptions, Shutter};
use crate::estimation::scaled_factor::ScaledFactor;
use crate::estimation::view_motion::read_out_time;
use crate::geometry::pixel::Pixel;

/// The effects that would explain the residuals.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Misfit {
    /// The part of the sum of squared residuals that motion during the readout explains, where
    /// that is large enough.
    pub rolling_shutter: Option<f64>,
    /// The height of the board's points off a plane, from the lowest to the highest, in meters,
    /// where that explains enough of the residuals. (A measured board has the root mean square
    /// instead, [`crate::estimation::measured_board::MeasuredBoard::unevenness_m`].)
    pub peak_to_valley_m: Option<f64>,
}

/// The least part of the sum of squared residuals that the board's shape must explain to be
/// reported: less would lower the rms by less than 2.5 %.
const SHAPE_LEAST_PART: f64 = 0.05;
/// The least of that in units of the noise's variance. Chance explains a χ² with as many degrees of
/// freedom as the shape has unknowns; with seven it exceeds this once in a million times.
const SHAPE_LEAST_CHI2: f64 = 40.0;

// What motion must explain. Chosen when photographs of a rolling shutter (photon-lifecam, where it
// explains 83 % of the squares) and of uneven boards (opencv-samples) were the only real ones, and
// not swept.
/// Motion must leave less than this part of the variance that remains with a board of any shape, …
const MOTION_LEFT: f64 = 0.8;
/// … and either less than this part, …
const MOTION_ALONE: f64 = 0.4;
/// … or less than this part of what remains with columns in place of rows.
const MOTION_AGAINST_COLUMNS: f64 = 0.8;

/// Unknowns of the board's shape: z by x², xy, y², x³, x²y, xy², y³ over its half extents.
const SHAPE: usize = 7;

/// The direction in which an image was read out.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum ReadOut {
    AtOnce,
    ByRows,
    ByColumns,
}

impl Misfit {
    /// Tests each effect on `views` of a fitted camera, except those that the solve itself has
    /// estimated or refuted, according to `options`.
    pub(crate) fn of(
        fit: &CameraFit,
        views: &[usize],
        size: [f64; 2],
        options: &CameraOptions,
    ) -> Self {
        let is_flat =
            views.iter().flat_map(|view| &fit.observations[*view].points).all(|p| p.z == 0.0);
        if fit.layout.warp.is_some() || fit.layout.sensors.len() > 1 {
            return Self::default();
        }
        let score = |read, shape| Score::of(fit, views, AddedEffect { size, read, shape });
        let shape = is_flat.then(|| score(ReadOut::AtOnce, SHAPE)).flatten();
        let without_motion = shape.as_ref().map_or(fit.noise_square(), Score::variance_left);
        let rows = (options.shutter == Shutter::Global)
            .then(|| score(ReadOut::ByRows, 0))
            .flatten()
            .filter(|rows| rows.variance_left() < MOTION_LEFT * without_motion);
        let is_motion = |rows: &Score| {
            let by_columns = || {
                score(ReadOut::ByColumns, 0).is_some_and(|columns| {
                    rows.variance_left() < MOTION_AGAINST_COLUMNS * columns.variance_left()
                })
            };
            rows.variance_left() < MOTION_ALONE * without_motion || by_columns()
        };
        if let Some(rows) = rows.filter(is_motion) {
            let rolling_shutter = Some(rows.decrease / rows.cost);
            return Self { rolling_shutter, peak_to_valley_m: None };
        }
        let peak_to_valley_m = shape
            .filter(|_| options.board_shape == BoardShape::Flat)
            .filter(|score| is_shape(score.decrease, score.cost, fit))
            .map(|score| score.peak_to_valley_m(fit, views));
        Self { rolling_shutter: None, peak_to_valley_m }
    }
}

/// Whether a shape that lowers the sum of squares from `cost` by `decrease` is significant.
fn is_shape(decrease: f64, cost: f64, fit: &CameraFit) -> bool {
    decrease > SHAPE_LEAST_PART * cost && decrease > SHAPE_LEAST_CHI2 * fit.noise_square()
}

/// The bow along x and along y, in meters, of a board that was assumed flat, as in
/// [`crate::estimation::joint::State::warp`]; `None` where it is not significant.
pub(crate) fn board_bow_m(fit: &CameraFit, views: &[usize]) -> Option<[f64; 2]> {
    let points = || views.iter().flat_map(|view| &fit.observations[*view].points);
    let [only] = fit.layout.sensors.as_slice() else { return None };
    if fit.layout.warp.is_some() || points().any(|p| p.z != 0.0) {
        return None;
    }
    let half_extent = half_extent(&points());
    let layout = Layout::new(vec![only.lens.clone()], Some(half_extent));
    let at = LinearizationPoint { layout: &layout, state: &fit.robust.minimum.state };
    let local = linearize_each(at, &fit.observations, views)?;
    let parts = views.iter().enumerate().map(|(k, view)| (*view, k));
    let equations = assemble(&local, at, &fit.observations, parts, views.len());
    let step = equations.solve(0.0)?;
    let last = step.global.len() - 2;
    is_shape(step.predicted_decrease, equations.cost, fit)
        .then(|| [step.global[last], step.global[last + 1]])
}

/// The effect that is added to the model.
#[derive(Debug, Clone, Copy)]
struct AddedEffect {
    /// The image's width and height in pixels.
    size: [f64; 2],
    read: ReadOut,
    /// 0 or [`SHAPE`].
    shape: usize,
}

impl AddedEffect {
    /// When a pixel was read, relative to the middle of the readout and in units of its duration;
    /// `None` where all are read at once.
    fn time(&self, pixel: Pixel) -> Option<f64> {
        match self.read {
            ReadOut::AtOnce => None,
            ReadOut::ByRows => Some(read_out_time(pixel.y, self.size[1])),
            ReadOut::ByColumns => Some(read_out_time(pixel.x, self.size[0])),
        }
    }

    fn per_view(&self) -> usize {
        if self.read == ReadOut::AtOnce { 6 } else { 12 }
    }
}

/// The result of one step.
struct Score {
    /// The sum of squares before the step, and its decrease by the step.
    cost: f64,
    decrease: f64,
    /// Number of residuals minus number of unknowns.
    freedom: f64,
    /// The step of the board's shape, in meters.
    shape: Vec<f64>,
}

impl Score {
    fn of(fit: &CameraFit, views: &[usize], extra: AddedEffect) -> Option<Self> {
        let globals = fit.layout.len + extra.shape;
        let (mut schur, mut right) = (DMatrix::zeros(globals, globals), DVector::zeros(globals));
        let (mut cost, mut decrease, mut residuals) = (0.0, 0.0, 0);
        for view in views {
            let (jacobian, residual) = linearized(fit, *view, extra)?;
            (cost, residuals) = (cost + residual.norm_squared(), residuals + residual.len());
            let (by_global, by_view) =
                (jacobian.columns(0, globals), jacobian.columns(globals, extra.per_view()));
            let square = by_view.transpose() * by_view;
            let factor = square.cholesky()?;
            let gradient = by_view.transpose() * &residual;
            let step = factor.solve(&gradient);
            decrease += gradient.dot(&step);
            let coupling = by_global.transpose() * by_view;
            schur +=
                by_global.transpose() * by_global - &coupling * factor.solve(&coupling.transpose());
            right += by_global.transpose() * &residual - coupling * step;
        }
        let step = ScaledFactor::of(&schur)?.solve(&right);
        decrease += right.dot(&step);
        let unknowns = globals + extra.per_view() * views.len();
        let shape = step.iter().skip(fit.layout.len).map(|s| -s).collect();
        let freedom = residuals as f64 - unknowns as f64;
        (freedom > 0.0 && decrease.is_finite()).then_some(Self { cost, decrease, freedom, shape })
    }

    fn variance_left(&self) -> f64 {
        (self.cost - self.decrease).max(0.0) / self.freedom
    }

    /// From the lowest to the highest of the board's points, relative to their best plane.
    fn peak_to_valley_m(&self, fit: &CameraFit, views: &[usize]) -> f64 {
        let half = board_half_extent(fit);
        let points: Vec<&Point3<f64>> =
            views.iter().flat_map(|view| &fit.observations[*view].points).collect();
        let heights = points
            .iter()
            .map(|p| shape_at(p, half).iter().zip(&self.shape).map(|(b, s)| b * s).sum());
        let heights = DVector::from_iterator(points.len(), heights);
        let plane =
            DMatrix::from_fn(points.len(), 3, |row, k| [1.0, points[row].x, points[row].y][k]);
        let tilt = plane.clone().svd(true, true).solve(&heights, 1e-12);
        let off = tilt.map_or_else(|_| heights.clone(), |tilt| &heights - plane * tilt);
        off.max() - off.min()
    }
}

/// Half the extent of `points` along x and y, about the common center, in meters.
fn half_extent<'a>(points: &(impl Iterator<Item = &'a Point3<f64>> + Clone)) -> [f64; 2] {
    [0, 1].map(|axis| points.clone().map(|p| p[axis].abs()).fold(f64::MIN_POSITIVE, f64::max))
}

/// The same for all points of the fit.
fn board_half_extent(fit: &CameraFit) -> [f64; 2] {
    half_extent(&fit.observations.iter().flat_map(|observation| &observation.points))
}

fn shape_at(point: &Point3<f64>, half: [f64; 2]) -> [f64; SHAPE] {
    let (x, y) = (point.x / half[0], point.y / half[1]);
    [x * x, x * y, y * y, x * x * x, x * x * y, x * y * y, y * y * y]
}

/// The weighted derivatives (lens, shape, pose, motion) and residuals of one view's inlier
/// corners.
fn linearized(
    fit: &CameraFit,
    view: usize,
    extra: AddedEffect,
) -> Option<(DMatrix<f64>, DVector<f64>)> {
    let (observation, lens) = (&fit.observations[view], fit.lens());
    let pose = fit.robust.minimum.state.rig_from_board[observation.frame_set];
    let (rotation, half) = (pose.rotation_matrix(), board_half_extent(fit));
    let used: Vec<usize> = (0..observation.points.len()).filter(|k| observation.used[*k]).collect();
    let by_free = fit.layout.sensors[0].lens.all_by_free(lens);
    let columns = fit.layout.len + extra.shape + extra.per_view();
    let (mut jacobian, mut residual) =
        (DMatrix::zeros(2 * used.len(), columns), DVector::zeros(2 * used.len()));
    for (row, k) in used.into_iter().enumerate() {
        let (point, seen, weight) =
            (observation.points[k], observation.pixels[k], observation.inverse_std[k]);
        let rotated: Vector3<f64> = rotation * point.coords;
        let projection = lens.project(&Point3::from(rotated + pose.translation()))?;
        let by_point: Matrix2x3<f64> = projection.by_point * weight;
        residual[2 * row] = (projection.pixel.x - seen.x) * weight;
        residual[2 * row + 1] = (projection.pixel.y - seen.y) * weight;
        let by_lens = projection.by_parameters.columns(0, by_free.nrows()) * &by_free * weight;
        let mut moved = Matrix3xX::zeros(columns - fit.layout.len);
        let normal = rotation.column(2).into_owned();
        for (column, height) in shape_at(&point, half).into_iter().take(extra.shape).enumerate() {
            moved.set_column(column, &(normal * height));
        }
        for (part, time) in [Some(1.0), extra.time(seen)].into_iter().flatten().enumerate() {
            let at = extra.shape + 6 * part;
            moved.fixed_view_mut::<3, 3>(0, at).copy_from(&(-rotated.cross_matrix() * time));
            moved
                .fixed_view_mut::<3, 3>(0, at + 3)
                .copy_from(&(nalgebra::Matrix3::identity() * time));
        }
        jacobian.view_mut((2 * row, 0), (2, fit.layout.len)).copy_from(&by_lens);
        jacobian
            .view_mut((2 * row, fit.layout.len), (2, moved.ncols()))
            .copy_from(&(by_point * moved));
    }
    Some((jacobian, residual))
}
