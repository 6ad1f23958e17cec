//! The expected standard deviation of the corners of a future view.
//!
//! A corner is where two edges cross. An edge with a Gaussian blur of width w, seen over a length
//! s, has a position variance ∝ w / s (the Fisher information of its position is ∫ (dI/dx)² dx per
//! unit of length ∝ 1 / w). The length is the side of a square in the image, which a tilt shortens.
//! The blur follows the thin lens: constant in focus, beyond it linear in 1/distance. The remaining
//! factor combines light and detector; it is estimated from the views so far.

use nalgebra::{Matrix2, Point3, Vector3};

use crate::geometry::lens::Lens;
use crate::geometry::median::median;
use crate::geometry::pose::Pose;

/// The noise of one view, with what it depends on.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct NoiseSample {
    /// Median standard deviation of its corners, in pixels.
    pub std_px: f64,
    /// The shorter side of a square in the image, in pixels.
    pub side_px: f64,
    /// The blur of its edges, in pixels.
    pub blur_px: f64,
    /// The board's distance, in meters.
    pub distance_m: f64,
}

/// The standard deviation of corners as a function of the length of their edges and of the
/// distance.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct CornerNoise {
    /// √(σ² s / w) in pixels: the noise of an edge one pixel long with a blur of one pixel.
    factor_px: f64,
    /// Coefficients of blur² by 1/distance, in px², px² m, px² m².
    blur_square: [f64; 3],
    /// The nearest and the farthest distance of the views, in meters.
    seen_m: Option<[f64; 2]>,
}

/// The factor before any view: 0.1 px for a square of 30 px with a blur of 0.8 px, as detectors
/// reach.
const UNSEEN_FACTOR_PX: f64 = 0.61;
const UNSEEN_BLUR_PX: f64 = 0.8;
/// The detector's window ends here: longer edges do not make a corner more accurate.
const LONGEST_SIDE_PX: f64 = 40.0;
/// Fewer views do not determine the depth of field.
const LEAST_DISTANCES: usize = 5;
/// Nor do distances that differ by less than this factor.
const LEAST_RANGE: f64 = 1.3;

impl Default for CornerNoise {
    fn default() -> Self {
        Self {
            factor_px: UNSEEN_FACTOR_PX,
            blur_square: [UNSEEN_BLUR_PX * UNSEEN_BLUR_PX, 0.0, 0.0],
            seen_m: None,
        }
    }
}

impl CornerNoise {
    /// Learns the noise from views.
    pub fn learn(samples: &[NoiseSample]) -> Self {
        let factors = samples.iter().map(|sample| {
            sample.std_px * (sample.side_px.min(LONGEST_SIDE_PX) / sample.blur_px.max(0.1)).sqrt()
        });
        let Some(factor_px) = median_of_finite(factors) else { return Self::default() };
        let distances = || samples.iter().map(|sample| sample.distance_m);
        let seen_m = [distances().fold(f64::INFINITY, f64::min), distances().fold(0.0, f64::max)];
        let blur =
            median_of_finite(samples.iter().map(|sample| sample.blur_px)).unwrap_or(UNSEEN_BLUR_PX);
        let constant = [blur * blur, 0.0, 0.0];
        let determined = samples.len() >= LEAST_DISTANCES && seen_m[1] > LEAST_RANGE * seen_m[0];
        let blur_square = determined.then(|| depth_of_field(samples)).flatten().unwrap_or(constant);
        Self { factor_px, blur_square, seen_m: Some(seen_m) }
    }

    /// The blur of a board at this distance, in pixels.
    pub fn blur_px(&self, distance_m: f64) -> f64 {
        // Extrapolates a little beyond the distances seen; farther out the blur stays constant.
        let [near, far] = self.seen_m.unwrap_or([distance_m; 2]);
        let q = 1.0 / distance_m.clamp(0.7 * near, 1.4 * far);
        let [a, b, c] = self.blur_square;
        (a + b * q + c * q * q).max(0.05).sqrt()
    }

    /// The standard deviation of a corner whose square has a shorter side of `side_px` pixels in
    /// the image.
    pub fn std_px(&self, side_px: f64, distance_m: f64) -> f64 {
        let side_px = side_px.clamp(1.0, LONGEST_SIDE_PX);
        self.factor_px * (self.blur_px(distance_m) / side_px).sqrt()
    }
}

/// The shorter side in the image of a square of `side_m` meters at `point_in_board`, in pixels: the
/// smaller singular value of the projection's Jacobian there. `None` outside the lens's valid
/// region.
pub fn side_px(
    lens: &Lens,
    camera_from_board: &Pose,
    point_in_board: &Point3<f64>,
    side_m: f64,
) -> Option<f64> {
    let projection = lens.project(&(*camera_from_board * *point_in_board))?;
    let along = |axis: Vector3<f64>| projection.by_point * (*camera_from_board * axis) * side_m;
    let sides = Matrix2::from_columns(&[along(Vector3::x()), along(Vector3::y())]);
    // The smaller singular value, in closed form.
    let (square, area) = (sides.norm_squared(), sides.determinant());
    let gap = (square * square - 4.0 * area * area).max(0.0).sqrt();
    Some((0.5 * (square - gap)).max(0.0).sqrt())
}

/// Fits blur² = a + b q + c q² in q = 1/distance by least squares; `None` unless the parabola opens
/// upward and has its minimum at a distance, as that of a lens that is in focus somewhere.
fn depth_of_field(samples: &[NoiseSample]) -> Option<[f64; 3]> {
    let (mut normal, mut right) = (nalgebra::Matrix3::zeros(), Vector3::zeros());
    for sample in samples {
        let q = 1.0 / sample.distance_m;
        let row = Vector3::new(1.0, q, q * q);
        normal += row * row.transpose();
        right += row * (sample.blur_px * sample.blur_px);
    }
    let [a, b, c] = normal.lu().solve(&right)?.into();
    let focus = -b / (2.0 * c);
    (c > 0.0 && focus >= 0.0 && a + b * focus + c * focus * focus > 0.0).then_some([a, b, c])
}

fn median_of_finite(values: impl Iterator<Item = f64>) -> Option<f64> {
    median(values.filter(|v| v.is_finite()).collect())
}
