//! The direct linear transform: a projection matrix, and from it K, R and t, from one view of
//! points in space.
//!
//! R. Hartley and A. Zisserman, *Multiple View Geometry*, 2nd edition, algorithm 7.1: normalized
//! coordinates, the least algebraic error, RQ decomposition, then the least distance in the image.

use nalgebra::{DMatrix, Matrix3, Matrix3x4, Matrix4, Point3, Vector3};

use crate::estimation::camera_estimate::{CameraEstimate, Part, assemble};
use crate::estimation::camera_fit::CameraFit;
use crate::estimation::clustered_covariance::FitCovariance;
use crate::estimation::error::EstimationError;
use crate::estimation::interrupt::Interrupt;
use crate::estimation::joint::minimize::{Minimum, Stop};
use crate::estimation::joint::{FreeLens, Layout, State};
use crate::estimation::problem::{CameraOptions, CameraProblem, Correspondence, LensChoice, check};
use crate::estimation::robust::Loss;
use crate::estimation::robust_fit::RobustFit;
use crate::estimation::start::Prepared;
use crate::geometry::camera_matrix::CameraMatrix;
use crate::geometry::lens::{Lens, LensModel};
use crate::geometry::pose::Pose;

/// The result of the direct linear transform.
#[derive(Debug, Clone, PartialEq)]
pub struct DltEstimate {
    /// The linear solution: maps homogeneous points to homogeneous pixels; the first three entries
    /// of its last row have length 1, and points in front of the camera a positive third
    /// coordinate.
    pub projection: Matrix3x4<f64>,
    /// K, R and t of the refined solution, a pinhole lens with skew, with their uncertainty.
    pub camera: CameraEstimate,
}

/// The least ratio of the points' thickness to their width; below it they count as coplanar.
const LEAST_THICKNESS: f64 = 1e-3;

/// The least second-smallest singular value, relative to the largest. Below it the null space has
/// two dimensions: points and camera on a twisted cubic, or on a plane and a line (HZ 22.1).
const LEAST_SECOND_SINGULAR_VALUE: f64 = 1e-7;

/// The projection matrix of the points of one view, scaled as in [`DltEstimate::projection`].
///
/// # Errors
/// Fewer than 6 points, or points that determine no projection, such as coplanar ones.
pub fn projection_matrix(seen: &[Correspondence]) -> Result<Matrix3x4<f64>, EstimationError> {
    if seen.len() < 6 {
        return Err(EstimationError::TooFewPoints { points: seen.len() });
    }
    let n = seen.len() as f64;
    let center = seen.iter().map(|c| c.point_in_board.coords).sum::<Vector3<f64>>() / n;
    let scatter: Matrix3<f64> =
        seen.iter().map(|c| c.point_in_board.coords - center).map(|d| d * d.transpose() / n).sum();
    let mut widths = scatter.symmetric_eigenvalues().map(|v| v.max(0.0).sqrt()).as_slice().to_vec();
    widths.sort_by(f64::total_cmp);
    if !(widths[0] > LEAST_THICKNESS * widths[2]) {
        return Err(EstimationError::Coplanar);
    }
    let middle = seen.iter().map(|c| c.pixel.to_vector()).sum::<nalgebra::Vector2<f64>>() / n;
    let mean_square_px2 =
        seen.iter().map(|c| (c.pixel.to_vector() - middle).norm_squared()).sum::<f64>() / n;
    if !(mean_square_px2 > 0.0 && mean_square_px2.is_finite()) {
        return Err(EstimationError::Coplanar);
    }
    let (to_unit, to_unit_px) = ((3.0 / scatter.trace()).sqrt(), (2.0 / mean_square_px2).sqrt());
    let mut rows = DMatrix::zeros(2 * seen.len(), 12);
    for (k, c) in seen.iter().enumerate() {
        let point = ((c.point_in_board.coords - center) * to_unit).push(1.0);
        let pixel = (c.pixel.to_vector() - middle) * to_unit_px;
        for axis in 0..2 {
            for (i, x) in point.iter().enumerate() {
                rows[(2 * k + axis, 4 * axis + i)] = *x;
                rows[(2 * k + axis, 8 + i)] = -pixel[axis] * x;
            }
        }
    }
    let normalized = null_vector(rows).ok_or(EstimationError::Coplanar)?;
    let to_pixels = Matrix3::new(
        1.0 / to_unit_px,
        0.0,
        middle.x,
        0.0,
        1.0 / to_unit_px,
        middle.y,
        0.0,
        0.0,
        1.0,
    );
    let mut to_normalized = Matrix4::identity() * to_unit;
    to_normalized.fixed_view_mut::<3, 1>(0, 3).copy_from(&(-center * to_unit));
    to_normalized[(3, 3)] = 1.0;
    let projection = to_pixels * normalized * to_normalized;
    let depth: f64 =
        seen.iter().map(|c| (projection * c.point_in_board.coords.push(1.0)).z.signum()).sum();
    let scale = projection.fixed_view::<1, 3>(2, 0).norm() * depth.signum();
    let scaled = projection / scale;
    scaled.iter().all(|v| v.is_finite()).then_some(scaled).ok_or(EstimationError::Coplanar)
}

/// The right singular vector of the smallest singular value, as a projection; `None` where the null
/// space has more than one dimension.
fn null_vector(mut rows: DMatrix<f64>) -> Option<Matrix3x4<f64>> {
    // The singular value iteration does not end on numbers that are not finite.
    if !rows.iter().all(|v| v.is_finite()) {
        return None;
    }
    if rows.nrows() < 12 {
        rows = rows.resize_vertically(12, 0.0);
    }
    let svd = rows.svd(false, true);
    let (v_t, values) = (svd.v_t?, svd.singular_values);
    let mut order: Vec<usize> = (0..values.len()).collect();
    order.sort_by(|a, b| values[*a].total_cmp(&values[*b]));
    let (smallest, second, largest) = (order[0], values[order[1]], values[order[values.len() - 1]]);
    (second > LEAST_SECOND_SINGULAR_VALUE * largest)
        .then(|| Matrix3x4::from_row_slice(v_t.row(smallest).transpose().as_slice()))
}

/// K, R and t of a projection matrix: K upper triangular with a positive diagonal, R a rotation (RQ
/// decomposition). `None` for a camera at infinity, or a matrix of a mirrored camera.
pub fn camera_from_projection(projection: &Matrix3x4<f64>) -> Option<(CameraMatrix, Pose)> {
    let left: Matrix3<f64> = projection.fixed_columns::<3>(0).into_owned();
    let flip = Matrix3::new(0.0, 0.0, 1.0, 0.0, 1.0, 0.0, 1.0, 0.0, 0.0);
    let qr = (flip * left).transpose().qr();
    let (mut upper, mut rotation) = (flip * qr.r().transpose() * flip, flip * qr.q().transpose());
    for axis in 0..3 {
        if upper[(axis, axis)] < 0.0 {
            upper.column_mut(axis).neg_mut();
            rotation.row_mut(axis).neg_mut();
        }
    }
    let translation = upper.try_inverse()? * projection.column(3);
    let matrix = CameraMatrix::from_matrix(&upper)?;
    let usable = rotation.determinant() > 0.0 && translation.iter().all(|v| v.is_finite());
    usable.then(|| (matrix, Pose::from_matrix(&rotation, translation)))
}

/// Calibrates a camera without distortion from the one view of `problem`: the linear solution, then
/// the least reprojection error over K (with skew), R and t.
///
/// # Errors
/// More than one view, fewer than 6 points, points that determine no projection, numbers that are
/// not finite; [`EstimationError::Interrupted`].
pub fn calibrate_dlt(
    problem: &CameraProblem,
    interrupt: &Interrupt,
) -> Result<DltEstimate, EstimationError> {
    check(problem)?;
    let [view] = problem.views.as_slice() else {
        return Err(EstimationError::NotOneView { views: problem.views.len() });
    };
    let projection = projection_matrix(&view.correspondences)?;
    let (matrix, camera_from_world) =
        camera_from_projection(&projection).ok_or(EstimationError::NoFit)?;
    let prepared = Prepared::of(problem);
    let about_center = camera_from_world * Point3::from(prepared.center_in_board);
    let start = State {
        lenses: vec![Lens::pinhole(matrix)],
        sensor_from_rig: vec![Pose::identity()],
        rig_from_board: vec![Pose::new(camera_from_world.rotation(), about_center.coords)],
        warp: [0.0; 2],
    };
    let lens = LensChoice::Model(LensModel::Pinhole);
    let options = CameraOptions { lens, skew: true, ..CameraOptions::default() };
    let (free_lens, _) = FreeLens::from_options(LensModel::Pinhole, &options)?;
    let layout = Layout::new(vec![free_lens], None).ended_by(interrupt);
    let loss = Loss::Squares;
    interrupt.check()?;
    let minimum = Minimum::start(&layout, start, &prepared.observations, loss)
        .ok_or(EstimationError::NoFit)?;
    let minimum = minimum.descend(&layout, &prepared.observations, loss, Stop::default());
    interrupt.check()?;
    let robust = RobustFit { minimum, limit: f64::INFINITY };
    let fit = CameraFit::new(layout, robust, prepared.observations.clone(), vec![None]);
    let known = FitCovariance::of(&fit);
    let camera = assemble(problem, &prepared, &fit, known.as_ref(), Part::WHOLE)?;
    Ok(DltEstimate { projection, camera })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::estimation::problem::BoardView;
    use crate::geometry::pixel::ImageSize;

    fn truth() -> (Lens, Pose) {
        let matrix = CameraMatrix { fx: 700.0, fy: 690.0, cx: 330.0, cy: 235.0, skew: 2.5 };
        let camera_from_world =
            Pose::from_axis_angle(Vector3::new(0.5, -0.4, 0.2), Vector3::new(-0.1, 0.05, 1.5));
        (Lens::pinhole(matrix), camera_from_world)
    }

    fn problem(points: impl Iterator<Item = Point3<f64>>) -> CameraProblem {
        let (lens, camera_from_world) = truth();
        let seen = |point: Point3<f64>| Correspondence {
            point_in_board: point,
            pixel: lens.pixel_from_point(&(camera_from_world * point)).unwrap(),
            std_px: 1.0,
        };
        let view =
            BoardView { name: "cube".to_owned(), correspondences: points.map(seen).collect() };
        CameraProblem { image_size: ImageSize::new(640, 480), views: vec![view] }
    }

    fn cube(count: usize) -> impl Iterator<Item = Point3<f64>> {
        let corner =
            |k: usize| Point3::new((k % 2) as f64, (k / 2 % 2) as f64, (k / 4 % 2) as f64) * 0.3;
        (0..count).map(corner)
    }

    #[test]
    fn exact_points_give_the_exact_camera() {
        let (lens, camera_from_world) = truth();
        for count in [6, 7, 8] {
            let found = calibrate_dlt(&problem(cube(count)), &Interrupt::default()).unwrap();
            let matrix = found.camera.lens.matrix.to_matrix();
            assert!((matrix - lens.matrix.to_matrix()).norm() < 1e-6, "{count} points: {matrix}");
            let pose = found.camera.views[0].camera_from_board.unwrap();
            assert!((pose.translation() - camera_from_world.translation()).norm() < 1e-8);
            let (linear, _) = camera_from_projection(&found.projection).unwrap();
            assert!((linear.to_matrix() - lens.matrix.to_matrix()).norm() < 1e-6);
        }
    }

    #[test]
    fn what_determines_no_projection_is_refused() {
        let table = [
            (problem(cube(5)), EstimationError::TooFewPoints { points: 5 }),
            (
                problem(
                    (0..30).map(|k| Point3::new(f64::from(k % 6), f64::from(k / 6), 0.0) * 0.1),
                ),
                EstimationError::Coplanar,
            ),
            (
                problem((0..9).map(|k| Point3::new(0.01, 0.02, 0.03) * f64::from(k))),
                EstimationError::Coplanar,
            ),
        ];
        for (problem, expected) in table {
            assert_eq!(calibrate_dlt(&problem, &Interrupt::default()).unwrap_err(), expected);
        }
        let mut far = problem(cube(8));
        for (k, seen) in far.views[0].correspondences.iter_mut().enumerate() {
            seen.pixel.x = if k % 3 == 0 { 1.6e308 } else { 1.7e308 };
        }
        assert_eq!(
            calibrate_dlt(&far, &Interrupt::default()).unwrap_err(),
            EstimationError::Coplanar
        );
        let mut two = problem(cube(8));
        two.views.push(two.views[0].clone());
        assert_eq!(
            calibrate_dlt(&two, &Interrupt::default()).unwrap_err(),
            EstimationError::NotOneView { views: 2 }
        );
    }
}
