//! Why a model does not fit: which effect, added to the model, would explain the residuals. Each
//! candidate is tried by one Gauss–Newton step from the minimum (a score test, C. R. Rao, 1948).
//! There are two: a board whose points are off its plane, alike in every view; and a board or camera
//! that moves while the rows of the image are read one after another.
//!
//! Motion has twelve unknowns a view, which always explain something. So it must explain far more
//! than a board of any shape does, or clearly more than the same motion with columns read in place
//! of rows. Those two differ by perspective only, since a shear along rows is a shear along columns
//! and a rotation.

use nalgebra::{DMatrix, DVector, Matrix2x3, Matrix3xX, Point3, Vector3};

use crate::estimation::camera_fit::CameraFit;
use crate::estimation::problem::{BoardShape, CameraOptions, Shutter};
use crate::geometry::pixel::Pixel;

/// What seems to be wrong.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Misfit {
    /// The part of the residuals' squares that motion while rows were read explains, where it
    /// explains a good part.
    pub rolling_shutter: Option<f64>,
    /// How far the board's points seem to be off a plane, from the lowest to the highest, in
    /// meters, where that explains a visible part of what is left.
    pub unevenness_m: Option<f64>,
}

/// The least part of the residuals' squares that an uneven board must explain to be named, and the
/// least of that in units of the noise's variance; chance alone explains 7.
const UNEVEN_GAIN: [f64; 2] = [0.05, 40.0];

/// Motion must leave less than this part of the variance that a board of any shape leaves, …
const MOTION_LEFT: f64 = 0.8;
/// … and either less than this part, …
const MOTION_ALONE: f64 = 0.4;
/// … or less than this part of what it leaves with columns in place of rows.
const MOTION_AGAINST_COLUMNS: f64 = 0.8;

/// Unknowns of the board's shape: z by x², xy, y², x³, x²y, xy², y³ over its half extents.
const SHAPE: usize = 7;

/// Which way time runs over the image.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Read {
    AtOnce,
    ByRows,
    ByColumns,
}

impl Misfit {
    /// Tests each cause on `views` of a fitted camera, but for those that the solve itself has
    /// estimated or refuted, as `options` ask.
    pub(crate) fn of(
        fit: &CameraFit,
        views: &[usize],
        (size, options): ([f64; 2], &CameraOptions),
    ) -> Self {
        let is_flat =
            views.iter().flat_map(|view| &fit.observations[*view].points).all(|p| p.z == 0.0);
        if fit.layout.warp.is_some() || fit.layout.sensors.len() > 1 {
            return Self::default();
        }
        let score = |read, shape| Score::of(fit, views, Extra { size, read, shape });
        let shape = is_flat.then(|| score(Read::AtOnce, SHAPE)).flatten();
        let without_motion = shape.as_ref().map_or(fit.noise_square(), Score::variance_left);
        let rows = (options.shutter == Shutter::Global)
            .then(|| score(Read::ByRows, 0))
            .flatten()
            .filter(|rows| rows.variance_left() < MOTION_LEFT * without_motion);
        let is_motion = |rows: &Score| {
            let by_columns = || {
                score(Read::ByColumns, 0).is_some_and(|columns| {
                    rows.variance_left() < MOTION_AGAINST_COLUMNS * columns.variance_left()
                })
            };
            rows.variance_left() < MOTION_ALONE * without_motion || by_columns()
        };
        if let Some(rows) = rows.filter(is_motion) {
            return Self { rolling_shutter: Some(rows.decrease / rows.cost), unevenness_m: None };
        }
        let is_uneven = |score: &Score| {
            score.decrease > UNEVEN_GAIN[0] * score.cost
                && score.decrease > UNEVEN_GAIN[1] * fit.noise_square()
        };
        let unevenness_m = shape
            .filter(|_| options.board_shape == BoardShape::Flat)
            .filter(is_uneven)
            .map(|score| score.unevenness_m(fit, views));
        Self { rolling_shutter: None, unevenness_m }
    }
}

/// What is added to the model.
#[derive(Debug, Clone, Copy)]
struct Extra {
    /// The image's width and height in pixels.
    size: [f64; 2],
    read: Read,
    /// 0 or [`SHAPE`].
    shape: usize,
}

impl Extra {
    /// When a pixel was read, in images, from its middle; `None` where all are read at once.
    fn time(&self, pixel: Pixel) -> Option<f64> {
        match self.read {
            Read::AtOnce => None,
            Read::ByRows => Some((pixel.y + 0.5) / self.size[1] - 0.5),
            Read::ByColumns => Some((pixel.x + 0.5) / self.size[0] - 0.5),
        }
    }

    fn per_view(&self) -> usize {
        if self.read == Read::AtOnce { 6 } else { 12 }
    }
}

/// The outcome of one step.
struct Score {
    /// The sum of squares before it, and by how much the step lowers it.
    cost: f64,
    decrease: f64,
    /// How many residuals more than unknowns.
    freedom: f64,
    /// The step of the board's shape, in meters.
    shape: Vec<f64>,
}

impl Score {
    fn of(fit: &CameraFit, views: &[usize], extra: Extra) -> Option<Self> {
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
        // Parameters differ by orders of magnitude: solve in units of their own strength.
        let unit = schur.diagonal().map(|d| 1.0 / d.max(f64::MIN_POSITIVE).sqrt());
        let scaled = DMatrix::from_fn(globals, globals, |i, j| schur[(i, j)] * unit[i] * unit[j]);
        let step = scaled.cholesky()?.solve(&right.component_mul(&unit)).component_mul(&unit);
        decrease += right.dot(&step);
        let unknowns = globals + extra.per_view() * views.len();
        let shape = step.iter().skip(fit.layout.len).map(|s| -s).collect();
        let freedom = residuals as f64 - unknowns as f64;
        (freedom > 0.0 && decrease.is_finite()).then_some(Self { cost, decrease, freedom, shape })
    }

    fn variance_left(&self) -> f64 {
        (self.cost - self.decrease).max(0.0) / self.freedom
    }

    /// From the lowest to the highest of the board's points, off the plane that fits them best.
    fn unevenness_m(&self, fit: &CameraFit, views: &[usize]) -> f64 {
        let half = half_extent(fit);
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

/// Half the board's extent along x and y, about the common center.
fn half_extent(fit: &CameraFit) -> [f64; 2] {
    let points = || fit.observations.iter().flat_map(|observation| &observation.points);
    [0, 1].map(|axis| points().map(|p| p[axis].abs()).fold(f64::MIN_POSITIVE, f64::max))
}

fn shape_at(point: &Point3<f64>, half: [f64; 2]) -> [f64; SHAPE] {
    let (x, y) = (point.x / half[0], point.y / half[1]);
    [x * x, x * y, y * y, x * x * x, x * x * y, x * y * y, y * y * y]
}

/// The weighted derivatives (lens, shape, pose, motion) and residuals of one view's inlier
/// corners.
fn linearized(fit: &CameraFit, view: usize, extra: Extra) -> Option<(DMatrix<f64>, DVector<f64>)> {
    let (observation, lens) = (&fit.observations[view], fit.lens());
    let pose = fit.robust.minimum.state.rig_from_board[observation.frame_set];
    let (rotation, half) = (pose.rotation_matrix(), half_extent(fit));
    let used: Vec<usize> = (0..observation.points.len()).filter(|k| observation.used[*k]).collect();
    let spread = fit.layout.sensors[0].lens.spread(lens);
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
        let by_lens = projection.by_parameters.columns(0, spread.nrows()) * &spread * weight;
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
