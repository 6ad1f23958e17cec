//! The maximum-likelihood two-view geometry: least squares of Sampson distances (HZ section
//! 11.4.3), over exactly the degrees of freedom of the matrix.

use nalgebra::{DMatrix, DVector, Matrix3, Rotation3, Vector3};

use crate::estimation::two_view::PointPair;
use crate::estimation::two_view::essential::essential_from_pose;
use crate::estimation::two_view::fundamental::sampson_distance_px;
use crate::geometry::pose::Pose;

/// The largest number of steps; few are needed from an algebraic fit.
const MAX_STEPS: usize = 10;

/// A step that lowers the cost by less than this part is the last.
const LEAST_DECREASE: f64 = 1e-7;

/// Rounds of estimating the weights of the pairs; they converge in three or four.
const ROUNDS: usize = 6;

/// The distribution of residuals: Gaussian for inliers, uniform for outliers.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ResidualMixture {
    /// The standard deviation of inliers' residuals, in the pairs' unit.
    pub std: f64,
    /// The probability that an outlier's residual is within one unit of 0.
    pub wrong_within_unit: f64,
}

impl ResidualMixture {
    /// The probability of each pair to be an inlier, with `std` and the part of inliers estimated
    /// from the residuals: expectation maximization (A. Dempster, N. Laird and D. Rubin, 1977).
    fn weigh(&mut self, residuals: &[f64], weights: &mut [f64]) {
        let part = weights.iter().sum::<f64>() / weights.len() as f64;
        let wrong = 0.5 * self.wrong_within_unit * (1.0 - part);
        let height = part / (self.std * std::f64::consts::TAU.sqrt());
        for (weight, residual) in weights.iter_mut().zip(residuals) {
            let right = height * (-0.5 * (residual / self.std).powi(2)).exp();
            *weight = if right > 0.0 { right / (right + wrong) } else { 0.0 };
        }
        let sum = weights.iter().sum::<f64>();
        let squares: f64 = weights.iter().zip(residuals).map(|(w, r)| w * r * r).sum();
        let std = (squares / sum).sqrt();
        // Exact pairs have no scatter: `std` falls by half at most per round, and never reaches 0.
        self.std = if std.is_finite() { std.max(0.5 * self.std) } else { self.std };
    }
}

/// A parameterization of an epipolar matrix by its degrees of freedom.
trait EpipolarGeometry: Sized {
    fn matrix(&self) -> Matrix3<f64>;
    /// The derivative of [`Self::matrix`] by each degree of freedom.
    fn tangents(&self) -> Vec<Matrix3<f64>>;
    fn stepped(&self, step: &DVector<f64>) -> Self;
}

/// F with the least sum of squared Sampson distances near `f`, by its seven degrees of freedom
/// (A. Bartoli and P. Sturm, *Nonlinear estimation of the fundamental matrix with minimal
/// parameters*, 2004).
pub fn refine_fundamental(f: &Matrix3<f64>, pairs: &[PointPair]) -> Option<Matrix3<f64>> {
    Some(descend(Orthonormal::of(f)?, pairs, &vec![1.0; pairs.len()]).matrix())
}

/// As [`refine_fundamental`], with outliers among `pairs`: each is weighted by its probability of
/// being an inlier.
pub fn refine_fundamental_among_wrong(
    f: &Matrix3<f64>,
    pairs: &[PointPair],
    mixture: ResidualMixture,
) -> Option<Matrix3<f64>> {
    Some(descend_among_wrong(Orthonormal::of(f)?, pairs, mixture).matrix())
}

/// The pose `second_from_first`, unit translation, with the least sum of squared Sampson distances
/// of `pairs` in normalized coordinates near `second_from_first`.
pub fn refine_pose(second_from_first: &Pose, pairs: &[PointPair]) -> Pose {
    descend(UnitBaseline::of(second_from_first), pairs, &vec![1.0; pairs.len()]).pose()
}

/// As [`refine_pose`], with outliers among `pairs`: each is weighted by its probability of being an
/// inlier.
pub fn refine_pose_among_wrong(
    second_from_first: &Pose,
    pairs: &[PointPair],
    mixture: ResidualMixture,
) -> Pose {
    descend_among_wrong(UnitBaseline::of(second_from_first), pairs, mixture).pose()
}

fn descend_among_wrong<G: EpipolarGeometry>(
    start: G,
    pairs: &[PointPair],
    mut mixture: ResidualMixture,
) -> G {
    let mut best = start;
    let mut weights = vec![0.5; pairs.len()];
    for _ in 0..ROUNDS {
        let f = best.matrix();
        let residuals: Vec<f64> = pairs.iter().map(|pair| sampson_distance_px(&f, pair)).collect();
        mixture.weigh(&residuals, &mut weights);
        best = descend(best, pairs, &weights);
    }
    best
}

/// Levenberg–Marquardt.
fn descend<G: EpipolarGeometry>(start: G, pairs: &[PointPair], weights: &[f64]) -> G {
    let mut best = start;
    let mut lambda = 1e-4;
    let (mut cost, mut normal, mut gradient) = equations(&best, pairs, weights);
    for _ in 0..MAX_STEPS {
        let mut damped = normal.clone();
        for k in 0..damped.nrows() {
            damped[(k, k)] *= 1.0 + lambda;
        }
        let Some(factor) = damped.cholesky() else { break };
        let next = best.stepped(&-factor.solve(&gradient));
        let (next_cost, next_normal, next_gradient) = equations(&next, pairs, weights);
        if !(next_cost < cost) {
            lambda *= 10.0;
            if lambda > 1e6 {
                break;
            }
            continue;
        }
        let settled = cost - next_cost < LEAST_DECREASE * cost;
        (best, cost, normal, gradient) = (next, next_cost, next_normal, next_gradient);
        lambda *= 0.1;
        if settled {
            break;
        }
    }
    best
}

/// The cost with its normal equations over the degrees of freedom. They are summed over the nine
/// elements of the matrix, by which the derivatives of residuals are the same for every geometry.
fn equations(
    geometry: &impl EpipolarGeometry,
    pairs: &[PointPair],
    weights: &[f64],
) -> (f64, DMatrix<f64>, DVector<f64>) {
    let (f, tangents) = (geometry.matrix(), geometry.tangents());
    let mut cost = 0.0;
    let (mut normal, mut gradient) = ([[0.0; 9]; 9], [0.0; 9]);
    for (pair, weight) in pairs.iter().zip(weights).filter(|(_, weight)| **weight > 0.0) {
        let [first, second] = pair.homogeneous();
        let in_plane = |line: Vector3<f64>| Vector3::new(line.x, line.y, 0.0);
        let (in_second, in_first) = (in_plane(f * first), in_plane(f.tr_mul(&second)));
        let squares = in_second.norm_squared() + in_first.norm_squared();
        if !(squares > 0.0) {
            continue;
        }
        let root = squares.sqrt();
        let residual = second.dot(&(f * first)) / root;
        // Derivatives of the algebraic error, and of the root that divides it.
        let by_error = (second - in_second * (residual / root)) / root;
        let by_root = second * (-residual / squares);
        let by_element = by_error * first.transpose() + by_root * in_first.transpose();
        let by_element = by_element.as_slice();
        for (i, (row, own)) in normal.iter_mut().zip(by_element).enumerate() {
            let weighted = weight * own;
            gradient[i] += weighted * residual;
            for (sum, other) in row.iter_mut().zip(&by_element[..=i]) {
                *sum += weighted * other;
            }
        }
        cost += weight * residual * residual;
    }
    let elements = tangents.iter().flat_map(|tangent| tangent.iter().copied());
    let by_freedom = DMatrix::from_iterator(9, tangents.len(), elements);
    let normal = DMatrix::from_fn(9, 9, |i, j| normal[i.max(j)][i.min(j)]);
    let gradient = DVector::from_column_slice(&gradient);
    (cost, by_freedom.tr_mul(&(normal * &by_freedom)), by_freedom.tr_mul(&gradient))
}

fn axes() -> [Matrix3<f64>; 3] {
    [Vector3::x(), Vector3::y(), Vector3::z()].map(|axis| axis.cross_matrix())
}

/// F = U diag(cos a, sin a, 0) Vᵀ.
struct Orthonormal {
    u: Matrix3<f64>,
    v: Matrix3<f64>,
    angle: f64,
}

impl Orthonormal {
    fn of(f: &Matrix3<f64>) -> Option<Self> {
        let svd = f.svd(true, true);
        let angle = svd.singular_values[1].atan2(svd.singular_values[0]);
        Some(Self { u: svd.u?, v: svd.v_t?.transpose(), angle })
    }

    fn middle(&self) -> Matrix3<f64> {
        Matrix3::from_diagonal(&Vector3::new(self.angle.cos(), self.angle.sin(), 0.0))
    }
}

impl EpipolarGeometry for Orthonormal {
    fn matrix(&self) -> Matrix3<f64> {
        self.u * self.middle() * self.v.transpose()
    }

    fn tangents(&self) -> Vec<Matrix3<f64>> {
        let (middle, v_t) = (self.middle(), self.v.transpose());
        let by_angle =
            Matrix3::from_diagonal(&Vector3::new(-self.angle.sin(), self.angle.cos(), 0.0));
        let mut tangents: Vec<_> = axes().iter().map(|g| self.u * g * middle * v_t).collect();
        tangents.extend(axes().iter().map(|g| -self.u * middle * g * v_t));
        tangents.push(self.u * by_angle * v_t);
        tangents
    }

    fn stepped(&self, step: &DVector<f64>) -> Self {
        let rotation = |k: usize| {
            Rotation3::from_scaled_axis(Vector3::new(step[k], step[k + 1], step[k + 2]))
                .into_inner()
        };
        Self { u: self.u * rotation(0), v: self.v * rotation(3), angle: self.angle + step[6] }
    }
}

/// E = `[t]ₓ` R with |t| = 1.
struct UnitBaseline {
    rotation: Matrix3<f64>,
    translation: Vector3<f64>,
}

impl UnitBaseline {
    fn of(second_from_first: &Pose) -> Self {
        Self {
            rotation: second_from_first.rotation_matrix(),
            translation: second_from_first.translation().normalize(),
        }
    }

    fn pose(&self) -> Pose {
        Pose::from_matrix(&self.rotation, self.translation)
    }

    /// Two unit directions orthogonal to the translation.
    fn across(&self) -> [Vector3<f64>; 2] {
        let axis = Vector3::ith(self.translation.iamin(), 1.0);
        let first = self.translation.cross(&axis).normalize();
        [first, self.translation.cross(&first)]
    }
}

impl EpipolarGeometry for UnitBaseline {
    fn matrix(&self) -> Matrix3<f64> {
        essential_from_pose(&self.rotation, &self.translation)
    }

    fn tangents(&self) -> Vec<Matrix3<f64>> {
        let e = self.matrix();
        let mut tangents: Vec<_> = axes().iter().map(|g| e * g).collect();
        tangents.extend(self.across().iter().map(|t| essential_from_pose(&self.rotation, t)));
        tangents
    }

    fn stepped(&self, step: &DVector<f64>) -> Self {
        let rotation = Rotation3::from_scaled_axis(Vector3::new(step[0], step[1], step[2]));
        let [a, b] = self.across();
        Self {
            rotation: self.rotation * rotation.into_inner(),
            translation: (self.translation + a * step[3] + b * step[4]).normalize(),
        }
    }
}

#[cfg(test)]
mod tests {
    use nalgebra::Point2;

    use super::*;

    /// Pairs that fit no geometry, so that residuals are large.
    fn pairs() -> Vec<PointPair> {
        let at = |k: u32, by: f64| 0.4 * (f64::from(k) * by).sin();
        (0..20)
            .map(|k| PointPair {
                first: Point2::new(at(k, 1.3), at(k, 2.1)),
                second: Point2::new(at(k, 1.7), at(k, 2.9)),
            })
            .collect()
    }

    /// Signed Sampson distances.
    fn residuals(geometry: &impl EpipolarGeometry) -> DVector<f64> {
        let f = geometry.matrix();
        let of_pair = |pair: &PointPair| {
            let [first, second] = pair.homogeneous();
            let error = second.dot(&(f * first));
            error.signum() * sampson_distance_px(&f, pair).abs()
        };
        DVector::from_iterator(20, pairs().iter().map(of_pair))
    }

    fn assert_derivatives(geometry: &impl EpipolarGeometry) {
        const STEP: f64 = 1e-5;
        let freedom = geometry.tangents().len();
        let columns: Vec<DVector<f64>> = (0..freedom)
            .map(|k| {
                let at = |sign: f64| {
                    let mut step = DVector::zeros(freedom);
                    step[k] = sign * STEP;
                    residuals(&geometry.stepped(&step))
                };
                (at(1.0) - at(-1.0)) / (2.0 * STEP)
            })
            .collect();
        let jacobian = DMatrix::from_columns(&columns);
        let weights: Vec<f64> = (0..20).map(|k| 0.5 + 0.02 * f64::from(k)).collect();
        let weighted = DMatrix::from_diagonal(&DVector::from_row_slice(&weights));
        let residuals = residuals(geometry);
        let (cost, normal, gradient) = equations(geometry, &pairs(), &weights);
        let close = |found: f64, wanted: f64| (found - wanted).abs() < 1e-6 * (1.0 + wanted.abs());
        assert!(close(cost, residuals.dot(&(&weighted * &residuals))) && cost > 0.1, "{cost}");
        let wanted = jacobian.transpose() * &weighted * &residuals;
        assert!(gradient.iter().zip(&wanted).all(|(a, b)| close(*a, *b)), "{gradient} {wanted}");
        let wanted = jacobian.transpose() * weighted * &jacobian;
        assert!(normal.iter().zip(&wanted).all(|(a, b)| close(*a, *b)), "{normal} {wanted}");
    }

    #[test]
    fn equations_are_those_of_numeric_differences() {
        let rotation = Rotation3::from_scaled_axis(Vector3::new(0.2, -0.1, 0.3)).into_inner();
        let translation = Vector3::new(0.6, 0.48, 0.64);
        let pose = UnitBaseline { rotation, translation };
        assert_derivatives(&pose);
        assert_derivatives(&Orthonormal::of(&pose.matrix()).unwrap());
    }
}
