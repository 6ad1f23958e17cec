//! The homography between two planes: the image of a flat board through a lens without distortion.

use nalgebra::{Matrix3, Point2, SMatrix, SVector, Vector2, Vector3};

/// A 3×3 homography `target_from_source` in homogeneous coordinates, scaled to unit Frobenius norm.
/// Points of the source are mapped only where their third coordinate is positive; a fit chooses the
/// sign such that it is for the fitted points.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Homography {
    matrix: Matrix3<f64>,
}

/// Why no homography could be fitted.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum HomographyError {
    /// Too few points: a homography has eight degrees of freedom.
    #[error("{points} point pairs are too few for a homography: give at least 4")]
    TooFewPoints {
        /// How many were given.
        points: usize,
    },
    /// A coordinate is NaN or infinite.
    #[error("point pair {index} has a coordinate that is not a finite number")]
    NotFinite {
        /// Which pair, counted from 0.
        index: usize,
    },
    /// All on a line, all in one place, or three of four on a line.
    #[error("the points do not span a plane: give points that are not all on one line")]
    Degenerate,
}

impl Homography {
    /// The homography with this matrix, rescaled; `None` if it is singular or not finite.
    pub fn from_matrix(matrix: &Matrix3<f64>) -> Option<Self> {
        let norm = matrix.norm();
        let scaled = matrix / norm;
        let usable = norm.is_finite() && norm > 0.0 && scaled.determinant().abs() > 1e-14;
        usable.then_some(Self { matrix: scaled })
    }

    /// The matrix that maps the unit square (0,0), (1,0), (1,1), (0,1) to four points, scaled so
    /// that its last entry is 1 (P. Heckbert, *Fundamentals of Texture Mapping and Image Warping*,
    /// 1989, section 2.2.3); `None` if three of them lie on a line.
    pub fn of_unit_square(points: [Vector2<f64>; 4]) -> Option<Matrix3<f64>> {
        let [p0, p1, p2, p3] = points;
        let (d1, d2, sum) = (p1 - p2, p3 - p2, p0 - p1 + p2 - p3);
        let determinant = d1.perp(&d2);
        if determinant.abs() < 1e-12 {
            return None;
        }
        let (g, h) = (sum.perp(&d2) / determinant, d1.perp(&sum) / determinant);
        let (a, b) = (p1 - p0 + g * p1, p3 - p0 + h * p3);
        Some(Matrix3::new(a.x, b.x, p0.x, a.y, b.y, p0.y, g, h, 1.0))
    }

    /// The 3×3 matrix.
    pub fn matrix(&self) -> &Matrix3<f64> {
        &self.matrix
    }

    /// The image of `point`; `None` for a point that is mapped to infinity or beyond.
    pub fn apply(&self, point: Point2<f64>) -> Option<Point2<f64>> {
        let mapped = self.matrix * Vector3::new(point.x, point.y, 1.0);
        (mapped.z > 0.0).then(|| Point2::new(mapped.x / mapped.z, mapped.y / mapped.z))
    }

    /// `source_from_target`.
    pub fn inverse(&self) -> Option<Self> {
        Self::from_matrix(&self.matrix.try_inverse()?)
    }

    /// The normalized direct linear transform (Hartley and Zisserman, *Multiple View Geometry*,
    /// algorithm 4.2): the least algebraic error over `pairs` of (source, target).
    ///
    /// # Errors
    /// Fewer than 4 pairs, a coordinate that is not finite, or points that do not determine a
    /// homography.
    pub fn fit(pairs: &[(Point2<f64>, Point2<f64>)]) -> Result<Self, HomographyError> {
        if pairs.len() < 4 {
            return Err(HomographyError::TooFewPoints { points: pairs.len() });
        }
        let finite = |p: &Point2<f64>| p.x.is_finite() && p.y.is_finite();
        if let Some(index) =
            pairs.iter().position(|(source, target)| !finite(source) || !finite(target))
        {
            return Err(HomographyError::NotFinite { index });
        }
        let source =
            Normalization::of(pairs.iter().map(|p| p.0)).ok_or(HomographyError::Degenerate)?;
        let target =
            Normalization::of(pairs.iter().map(|p| p.1)).ok_or(HomographyError::Degenerate)?;
        let normal = dlt_normal_matrix(pairs, source, target);
        let h = smallest_eigenvector(&normal).ok_or(HomographyError::Degenerate)?;
        let normalized = Matrix3::from_row_slice(h.as_slice());
        if normalized.determinant().abs() < 1e-6 {
            return Err(HomographyError::Degenerate);
        }
        let matrix = target.undo() * normalized * source.to_matrix();
        let (mut homography, first) = (Self { matrix: matrix / matrix.norm() }, pairs[0].0);
        if (homography.matrix * Vector3::new(first.x, first.y, 1.0)).z < 0.0 {
            homography.matrix = -homography.matrix;
        }
        Ok(homography)
    }

    /// [`Self::fit`], then Gauss–Newton on the distance in the target plane (Hartley and Zisserman,
    /// section 4.2.3): the maximum-likelihood homography for equal, independent noise of the
    /// targets.
    ///
    /// # Errors
    /// As [`Self::fit`].
    pub fn fit_refined(pairs: &[(Point2<f64>, Point2<f64>)]) -> Result<Self, HomographyError> {
        let mut best = Self::fit(pairs)?;
        let mut lowest = best.squared_error(pairs);
        for _ in 0..10 {
            let Some(next) = best.gauss_newton_step(pairs) else { break };
            let error = next.squared_error(pairs);
            if !(error < lowest) {
                break;
            }
            let settled = lowest - error < 1e-12 * lowest;
            (best, lowest) = (next, error);
            if settled {
                break;
            }
        }
        Ok(best)
    }

    /// Root mean square distance in the target plane; infinite if a point is mapped beyond
    /// infinity.
    pub fn rms(&self, pairs: &[(Point2<f64>, Point2<f64>)]) -> f64 {
        (self.squared_error(pairs) / pairs.len() as f64).sqrt()
    }

    fn squared_error(&self, pairs: &[(Point2<f64>, Point2<f64>)]) -> f64 {
        pairs
            .iter()
            .map(|(s, t)| self.apply(*s).map_or(f64::INFINITY, |p| (p - t).norm_squared()))
            .sum()
    }

    fn gauss_newton_step(&self, pairs: &[(Point2<f64>, Point2<f64>)]) -> Option<Self> {
        let (mut normal, mut gradient) =
            (SMatrix::<f64, 9, 9>::zeros(), SVector::<f64, 9>::zeros());
        for (source, target) in pairs {
            let at = Vector3::new(source.x, source.y, 1.0);
            let mapped = self.matrix * at;
            let (x, y) = (mapped.x / mapped.z, mapped.y / mapped.z);
            let a = at / mapped.z;
            let row_x = SVector::<f64, 9>::from_column_slice(&[
                a.x,
                a.y,
                a.z,
                0.0,
                0.0,
                0.0,
                -x * a.x,
                -x * a.y,
                -x * a.z,
            ]);
            let row_y = SVector::<f64, 9>::from_column_slice(&[
                0.0,
                0.0,
                0.0,
                a.x,
                a.y,
                a.z,
                -y * a.x,
                -y * a.y,
                -y * a.z,
            ]);
            normal += row_x * row_x.transpose() + row_y * row_y.transpose();
            gradient += row_x * (x - target.x) + row_y * (y - target.y);
        }
        // The scale of the matrix is free: this term fixes it.
        let h = SVector::<f64, 9>::from_row_slice(self.matrix.transpose().as_slice());
        let stiffness = normal.trace();
        let step = (normal + h * h.transpose() * stiffness).cholesky()?.solve(&gradient);
        let next = Matrix3::from_row_slice((h - step).as_slice());
        Some(Self { matrix: next / next.norm() })
    }
}

/// A similarity that moves points to mean 0 and mean squared distance 2.
#[derive(Clone, Copy)]
struct Normalization {
    center: Point2<f64>,
    scale: f64,
}

impl Normalization {
    /// `None` for points on one line (or in one place): no plane is spanned.
    fn of(points: impl ExactSizeIterator<Item = Point2<f64>> + Clone) -> Option<Self> {
        let n = points.len() as f64;
        let sum = points.clone().fold(nalgebra::Vector2::zeros(), |sum, p| sum + p.coords);
        let center = Point2::from(sum / n);
        let (mut xx, mut xy, mut yy) = (0.0, 0.0, 0.0);
        for p in points {
            let d = p - center;
            xx += d.x * d.x;
            xy += d.x * d.y;
            yy += d.y * d.y;
        }
        let trace = xx + yy;
        let spans_a_plane = xx * yy - xy * xy > 1e-10 * trace * trace;
        (trace > 0.0 && spans_a_plane).then(|| Self { center, scale: (2.0 * n / trace).sqrt() })
    }

    fn apply(self, point: Point2<f64>) -> (f64, f64) {
        ((point.x - self.center.x) * self.scale, (point.y - self.center.y) * self.scale)
    }

    fn to_matrix(self) -> Matrix3<f64> {
        let (s, c) = (self.scale, self.center);
        Matrix3::new(s, 0.0, -s * c.x, 0.0, s, -s * c.y, 0.0, 0.0, 1.0)
    }

    fn undo(self) -> Matrix3<f64> {
        let (s, c) = (1.0 / self.scale, self.center);
        Matrix3::new(s, 0.0, c.x, 0.0, s, c.y, 0.0, 0.0, 1.0)
    }
}

/// AᵀA of the DLT, from 24 sums over the points: its blocks are Σ p pᵀ times 1, −u, −v and u² + v².
fn dlt_normal_matrix(
    pairs: &[(Point2<f64>, Point2<f64>)],
    source: Normalization,
    target: Normalization,
) -> SMatrix<f64, 9, 9> {
    let mut sums = [[0.0; 6]; 4];
    for (from, to) in pairs {
        let ((x, y), (u, v)) = (source.apply(*from), target.apply(*to));
        let products = [x * x, x * y, x, y * y, y, 1.0];
        for (sum, factor) in sums.iter_mut().zip([1.0, -u, -v, u * u + v * v]) {
            for (s, p) in sum.iter_mut().zip(products) {
                *s += factor * p;
            }
        }
    }
    let blocks = sums.map(|[xx, xy, x, yy, y, n]| Matrix3::new(xx, xy, x, xy, yy, y, x, y, n));
    let mut normal = SMatrix::<f64, 9, 9>::zeros();
    normal.fixed_view_mut::<3, 3>(0, 0).copy_from(&blocks[0]);
    normal.fixed_view_mut::<3, 3>(3, 3).copy_from(&blocks[0]);
    normal.fixed_view_mut::<3, 3>(0, 6).copy_from(&blocks[1]);
    normal.fixed_view_mut::<3, 3>(6, 0).copy_from(&blocks[1]);
    normal.fixed_view_mut::<3, 3>(3, 6).copy_from(&blocks[2]);
    normal.fixed_view_mut::<3, 3>(6, 3).copy_from(&blocks[2]);
    normal.fixed_view_mut::<3, 3>(6, 6).copy_from(&blocks[3]);
    normal
}

/// The eigenvector of the smallest eigenvalue of a positive semidefinite matrix, by inverse
/// iteration; `None` where that eigenvalue is not simple.
pub(crate) fn smallest_eigenvector(matrix: &SMatrix<f64, 9, 9>) -> Option<SVector<f64, 9>> {
    let ridge = matrix.trace() * 1e-13;
    let factor = (matrix + SMatrix::<f64, 9, 9>::identity() * ridge).cholesky()?;
    let mut vector =
        SVector::<f64, 9>::from_column_slice(&[0.9, 0.3, 0.4, -0.2, 1.1, 0.5, 0.15, -0.35, 0.7])
            .normalize();
    for _ in 0..30 {
        let mut next = factor.solve(&vector);
        next /= next.norm();
        if next.dot(&vector) < 0.0 {
            next = -next;
        }
        let change = (next - vector).norm_squared();
        vector = next;
        if change < 1e-26 {
            return Some(vector);
        }
    }
    // With two nearly equal smallest eigenvalues, the points hardly determine the solution.
    let rest = factor.solve(&vector);
    let change = (rest / rest.norm() - vector).norm();
    (change < 1e-6).then_some(vector)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn grid() -> Vec<Point2<f64>> {
        (0..54).map(|k| Point2::new(f64::from(k % 9) * 0.03, f64::from(k / 9) * 0.03)).collect()
    }

    fn truth() -> Homography {
        Homography::from_matrix(&Matrix3::new(
            900.0, -40.0, 210.0, 60.0, 850.0, 140.0, 0.3, -0.2, 1.0,
        ))
        .unwrap()
    }

    #[test]
    fn exact_pairs_give_the_exact_map_and_its_inverse() {
        let truth = truth();
        let pairs: Vec<_> = grid().into_iter().map(|p| (p, truth.apply(p).unwrap())).collect();
        for fitted in [Homography::fit(&pairs).unwrap(), Homography::fit_refined(&pairs).unwrap()] {
            assert!(fitted.rms(&pairs) < 1e-9, "{}", fitted.rms(&pairs));
            let back = fitted.inverse().unwrap();
            for (source, target) in &pairs {
                assert!((back.apply(*target).unwrap() - source).norm() < 1e-12);
            }
        }
    }

    #[test]
    fn refinement_lowers_the_distance() {
        let truth = truth();
        let wobble =
            |k: usize| Point2::new((k as f64 * 12.9898).sin(), (k as f64 * 78.233).sin()) * 2.0;
        let pairs: Vec<_> = grid()
            .iter()
            .enumerate()
            .map(|(k, p)| (*p, truth.apply(*p).unwrap() + wobble(k).coords))
            .collect();
        let (algebraic, geometric) =
            (Homography::fit(&pairs).unwrap(), Homography::fit_refined(&pairs).unwrap());
        assert!(geometric.rms(&pairs) < algebraic.rms(&pairs));
        assert!(geometric.rms(&pairs) < 2.0);
    }

    #[test]
    fn what_determines_no_homography_is_refused() {
        let p = |x: f64, y: f64| Point2::new(x, y);
        let square = [p(0.0, 0.0), p(1.0, 0.0), p(0.0, 1.0), p(1.0, 1.0)];
        let same = |points: &[Point2<f64>]| points.iter().map(|q| (*q, *q)).collect::<Vec<_>>();
        assert_eq!(
            Homography::fit(&same(&square[..3])),
            Err(HomographyError::TooFewPoints { points: 3 })
        );
        let line: Vec<_> = (0..9).map(|k| p(f64::from(k), 2.0 * f64::from(k))).collect();
        assert_eq!(Homography::fit(&same(&line)), Err(HomographyError::Degenerate));
        let one_place: Vec<_> = grid().into_iter().map(|q| (q, p(640.0, 360.0))).collect();
        assert_eq!(Homography::fit(&one_place), Err(HomographyError::Degenerate));
        let three_on_a_line = [p(0.0, 0.0), p(1.0, 0.0), p(2.0, 0.0), p(1.0, 1.0)];
        assert_eq!(Homography::fit(&same(&three_on_a_line)), Err(HomographyError::Degenerate));
        let mut bad = same(&square);
        bad[2].1.x = f64::NAN;
        assert_eq!(Homography::fit(&bad), Err(HomographyError::NotFinite { index: 2 }));
    }
}
