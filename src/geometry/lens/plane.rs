//! Common code of the models that distort the image *plane*: pinhole, radial, brown, rational.
//!
//! Such a model maps ideal normalized coordinates (x/z, y/z) to distorted ones, and is one-to-one
//! up to a largest radius.

use nalgebra::{Matrix2, Matrix2x3, Point3, SMatrix, Unit, Vector2, Vector3};

use crate::geometry::lens::model::Distorted;
use crate::geometry::pixel::Bearing;

/// The largest ideal radius of any plane model: 89.9° off the axis.
pub(super) const MAX_RADIUS: f64 = 573.0;

/// The relative accuracy to which a radius is inverted before Newton's method takes over.
const BRACKETED_PART: f64 = 1e-6;

/// A distortion of the ideal image plane.
pub(super) trait PlaneDistortion<const N: usize> {
    /// The square of the ideal radius at which the model folds over; at most `MAX_RADIUS`².
    fn radius2_limit(&self) -> f64;

    /// The radial factor d in (x_d, y_d) = d · (x, y) without tangential terms, at squared radius
    /// `r2`.
    fn radial_factor(&self, r2: f64) -> f64;

    /// The distorted coordinates of ideal ones, their 2×2 derivative, and the derivative by the
    /// coefficients.
    fn distorted_with_jacobians(
        &self,
        ideal: Vector2<f64>,
    ) -> (Vector2<f64>, Matrix2<f64>, SMatrix<f64, 2, N>);
}

pub(super) fn distort<const N: usize>(
    model: &impl PlaneDistortion<N>,
    point: &Point3<f64>,
) -> Option<Vector2<f64>> {
    let ideal = ideal_from_point(model, point)?;
    let (distorted_ideal, by_ideal, _) = model.distorted_with_jacobians(ideal);
    (by_ideal.determinant() > 0.0).then_some(distorted_ideal)
}

/// Without branches, so that a loop over points is vectorized.
#[inline(always)]
pub(super) fn distort_or_axis<const N: usize>(
    model: &impl PlaneDistortion<N>,
    point: &Point3<f64>,
) -> (Distorted<N>, bool) {
    let inverse_z = 1.0 / point.z;
    let (x, y) = (point.x * inverse_z, point.y * inverse_z);
    // Written so that NaN fails too.
    let inside = (point.z > 0.0) & (x * x + y * y < model.radius2_limit());
    let inverse_z = if inside { inverse_z } else { 1.0 };
    let ideal = if inside { Vector2::new(x, y) } else { Vector2::zeros() };
    let (normalized, by_ideal, by_coefficients) = model.distorted_with_jacobians(ideal);
    let along = |axis: usize| {
        let (by_x, by_y) = (by_ideal[(axis, 0)] * inverse_z, by_ideal[(axis, 1)] * inverse_z);
        [by_x, by_y, -(by_x * ideal.x + by_y * ideal.y)]
    };
    let ([a, b, c], [d, e, f]) = (along(0), along(1));
    let determinant = by_ideal[(0, 0)] * by_ideal[(1, 1)] - by_ideal[(0, 1)] * by_ideal[(1, 0)];
    (
        Distorted { normalized, by_point: Matrix2x3::new(a, b, c, d, e, f), by_coefficients },
        inside & (determinant > 0.0),
    )
}

fn ideal_from_point<const N: usize>(
    model: &impl PlaneDistortion<N>,
    point: &Point3<f64>,
) -> Option<Vector2<f64>> {
    // Written so that NaN fails too.
    if !(point.z > 0.0) {
        return None;
    }
    let ideal = point.coords.xy() * (1.0 / point.z);
    (ideal.norm_squared() < model.radius2_limit()).then_some(ideal)
}

/// Newton's method in the plane, starting from the radial solution, which lies on the invertible
/// branch by construction.
pub(super) fn undistort<const N: usize>(
    model: &impl PlaneDistortion<N>,
    distorted: Vector2<f64>,
) -> Option<Bearing> {
    let radius = distorted.norm();
    if !radius.is_finite() {
        return None;
    }
    let limit = model.radius2_limit().sqrt();
    let mut ideal = distorted;
    if radius > 0.0 {
        ideal *= radial_inverse(model, radius, limit) / radius;
    }
    let mut best = f64::INFINITY;
    for _ in 0..50 {
        let (distorted_ideal, by_ideal, _) = model.distorted_with_jacobians(ideal);
        let miss = distorted_ideal - distorted;
        let determinant = by_ideal.determinant();
        if determinant <= 0.0 {
            return None;
        }
        let step = Vector2::new(
            by_ideal[(1, 1)] * miss.x - by_ideal[(0, 1)] * miss.y,
            by_ideal[(0, 0)] * miss.y - by_ideal[(1, 0)] * miss.x,
        ) / determinant;
        let size = step.norm();
        // Converged: the steps are at the rounding of the coordinates and no longer shrink.
        if size <= 1e-15 * (1.0 + ideal.norm())
            || (size < 1e-12 * (1.0 + ideal.norm()) && size >= best)
        {
            let inside = ideal.norm_squared() < model.radius2_limit();
            return inside.then(|| Unit::new_normalize(Vector3::new(ideal.x, ideal.y, 1.0)));
        }
        best = best.min(size);
        ideal -= step;
        let norm = ideal.norm();
        if norm > limit {
            ideal *= limit * (1.0 - 1e-9) / norm;
        }
    }
    None
}

/// The ideal radius with the distorted radius `radius`, on the branch around the axis; the limit
/// itself beyond that branch.
fn radial_inverse<const N: usize>(model: &impl PlaneDistortion<N>, radius: f64, limit: f64) -> f64 {
    let distorted_radius = |r: f64| r * model.radial_factor(r * r);
    let (mut low, mut high) = (0.0, radius.min(limit));
    while distorted_radius(high) < radius {
        low = high;
        if high >= limit * (1.0 - 1e-6) {
            return limit * (1.0 - 1e-6);
        }
        high = (high * 2.0).min(limit * (1.0 - 1e-6));
    }
    // False position with the Illinois rule: the value at an end that is kept twice is halved.
    let (mut at_low, mut at_high, mut moved) =
        (distorted_radius(low) - radius, distorted_radius(high) - radius, 0);
    if at_high <= BRACKETED_PART * radius {
        return high;
    }
    for _ in 0..30 {
        let between = (low * at_high - high * at_low) / (at_high - at_low);
        if !(low < between && between < high) {
            break;
        }
        let at_between = distorted_radius(between) - radius;
        if at_between.abs() <= BRACKETED_PART * radius {
            return between;
        }
        if at_between < 0.0 {
            at_high *= if moved < 0 { 0.5 } else { 1.0 };
            (low, at_low, moved) = (between, at_between, -1);
        } else {
            at_low *= if moved > 0 { 0.5 } else { 1.0 };
            (high, at_high, moved) = (between, at_between, 1);
        }
    }
    0.5 * (low + high)
}
