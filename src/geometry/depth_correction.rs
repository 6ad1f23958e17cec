//! The systematic error of a depth camera: a polynomial in depth or inverse depth whose
//! coefficients vary smoothly over the image.
//!
//! With g_k(u, v) a cubic B-spline surface (C. de Boor, *A Practical Guide to Splines*, 1978):
//!
//! ```text
//! stereo:                          1/z' = 1/z + Σ_k g_k(u, v) · (1/z)^k
//! structured light, time of flight:   z' =   z + Σ_k g_k(u, v) ·     z^k
//! ```
//!
//! With two terms the first is a(u,v)/z + b(u,v). Outside the range of depths it was fitted over,
//! the polynomial keeps its value at the nearer end of the range.

use crate::geometry::pixel::{ImageSize, Pixel};

/// The quantity in which the polynomial is given.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum CorrectedQuantity {
    /// 1/z, in 1/m: the errors of a stereo camera are constant in it.
    InverseDepth,
    /// z, in meters.
    Depth,
}

impl CorrectedQuantity {
    /// Its name in documents.
    pub fn name(self) -> &'static str {
        match self {
            Self::InverseDepth => "inverse_depth",
            Self::Depth => "depth",
        }
    }
}

/// A grid of equal cells over an image, with the nodes of cubic B-splines. Without cells it is a
/// single constant.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct SplineGrid {
    /// The size of the image.
    pub size: ImageSize,
    /// Cells along x; 0 with `rows` 0 for a constant.
    pub cols: u32,
    /// Cells along y.
    pub rows: u32,
}

/// The nodes that affect a pixel, with their weights, which add up to 1.
#[derive(Debug, Clone, Copy)]
pub struct NodeWeights {
    /// Indices of nodes.
    pub nodes: [usize; 16],
    /// Their weights.
    pub weights: [f64; 16],
    /// Number of nodes: 16, or 1 for a constant.
    pub len: usize,
}

impl NodeWeights {
    /// The nodes that affect the pixel, each with its weight.
    pub fn used(&self) -> impl Iterator<Item = (usize, f64)> + '_ {
        self.nodes.iter().copied().zip(self.weights.iter().copied()).take(self.len)
    }
}

impl SplineGrid {
    /// One constant for the whole image.
    pub fn constant(size: ImageSize) -> Self {
        Self { size, cols: 0, rows: 0 }
    }

    /// Nodes along x and y.
    pub fn nodes(self) -> [usize; 2] {
        let along = |cells: u32| if cells == 0 { 1 } else { cells as usize + 3 };
        [along(self.cols), along(self.rows)]
    }

    /// Number of nodes; node (i, j) has the index j · nodes along x + i.
    pub fn node_count(self) -> usize {
        let [across, down] = self.nodes();
        across * down
    }

    /// The nodes that affect `pixel` (outside the image: its nearest edge).
    pub fn weights(self, pixel: Pixel) -> NodeWeights {
        let mut result = NodeWeights { nodes: [0; 16], weights: [0.0; 16], len: 1 };
        if self.cols == 0 || self.rows == 0 {
            result.weights[0] = 1.0;
            return result;
        }
        let (column, across) = cell(pixel.x, self.size.width, self.cols);
        let (row, down) = cell(pixel.y, self.size.height, self.rows);
        let width = self.nodes()[0];
        for (j, wy) in down.into_iter().enumerate() {
            for (i, wx) in across.into_iter().enumerate() {
                result.nodes[4 * j + i] = (row + j) * width + column + i;
                result.weights[4 * j + i] = wx * wy;
            }
        }
        result.len = 16;
        result
    }
}

/// The cell that contains a coordinate, and the four values of the uniform cubic B-spline there.
fn cell(coordinate: f64, length: u32, cells: u32) -> (usize, [f64; 4]) {
    let along = (coordinate + 0.5) / f64::from(length) * f64::from(cells);
    let along = if along.is_finite() { along.clamp(0.0, f64::from(cells)) } else { 0.0 };
    let first = along.floor().min(f64::from(cells) - 1.0);
    let t = along - first;
    let (t2, t3) = (t * t, t * t * t);
    let weights =
        [(1.0 - t).powi(3), 3.0 * t3 - 6.0 * t2 + 4.0, -3.0 * t3 + 3.0 * t2 + 3.0 * t + 1.0, t3];
    (first as usize, weights.map(|w| w / 6.0))
}

/// A correction of depth over an image.
#[derive(Debug, Clone, PartialEq)]
pub struct DepthCorrection {
    /// The quantity in which the polynomial is given.
    pub quantity: CorrectedQuantity,
    /// Number of terms: powers 0 to terms − 1.
    pub terms: usize,
    /// The grid of its coefficients.
    pub grid: SplineGrid,
    /// For each power, one coefficient per node of the grid.
    pub coefficients: Vec<f64>,
    /// The nearest and the farthest depth it was fitted over, in meters.
    pub seen_m: [f64; 2],
}

impl DepthCorrection {
    /// A correction with all coefficients 0.
    pub fn none(
        quantity: CorrectedQuantity,
        terms: usize,
        grid: SplineGrid,
        seen_m: [f64; 2],
    ) -> Self {
        Self { quantity, terms, grid, coefficients: vec![0.0; terms * grid.node_count()], seen_m }
    }

    /// The corrected 1/z, in 1/m; `None` where it is not in front of the camera.
    pub fn correct(&self, pixel: Pixel, inverse_depth: f64) -> Option<f64> {
        let corrected = self.at(pixel).correct(inverse_depth);
        (corrected.is_finite() && corrected > 0.0).then_some(corrected)
    }

    /// Whether 1/z lies within the distances it was fitted over.
    pub fn has_seen(&self, inverse_depth: f64) -> bool {
        inverse_depth * self.seen_m[0] <= 1.0 && inverse_depth * self.seen_m[1] >= 1.0
    }

    /// The polynomial at one pixel.
    pub fn at(&self, pixel: Pixel) -> PixelCorrection {
        self.at_nodes(&self.grid.weights(pixel))
    }

    /// The polynomial at the pixel with these weights in the correction's grid.
    pub fn at_nodes(&self, weights: &NodeWeights) -> PixelCorrection {
        let count = self.grid.node_count();
        let mut at = PixelCorrection {
            quantity: self.quantity,
            terms: [0.0; MAX_TERMS],
            seen_m: self.seen_m,
        };
        for (power, term) in at.terms.iter_mut().enumerate().take(self.terms) {
            let nodes =
                self.coefficients.get(power * count..(power + 1) * count).unwrap_or_default();
            let value = |(node, weight)| nodes.get(node).copied().unwrap_or(0.0) * weight;
            *term = weights.used().map(value).sum();
        }
        at
    }
}

/// The largest number of terms of a correction.
pub const MAX_TERMS: usize = 4;

/// The value nearest to `inverse_depth` in the range of depths `seen_m` [nearest, farthest], for
/// which a correction is valid; `inverse_depth` itself where that range is empty (nearest beyond
/// farthest).
pub(crate) fn held_inverse_depth(inverse_depth: f64, seen_m: [f64; 2]) -> f64 {
    let [near, far] = seen_m.map(|depth| 1.0 / depth);
    if far <= near { inverse_depth.clamp(far, near) } else { inverse_depth }
}

/// The correction of one pixel.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PixelCorrection {
    /// The quantity in which the polynomial is given.
    pub quantity: CorrectedQuantity,
    /// Its coefficients, by power.
    pub terms: [f64; MAX_TERMS],
    /// The range of depths for which it is valid, in meters.
    pub seen_m: [f64; 2],
}

impl PixelCorrection {
    /// The corrected 1/z.
    pub fn correct(&self, inverse_depth: f64) -> f64 {
        let held = held_inverse_depth(inverse_depth, self.seen_m);
        let polynomial = |x: f64| self.terms.iter().rev().fold(0.0, |sum, term| sum * x + term);
        match self.quantity {
            CorrectedQuantity::InverseDepth => inverse_depth + polynomial(held),
            CorrectedQuantity::Depth => 1.0 / (1.0 / inverse_depth + polynomial(1.0 / held)),
        }
    }
}

impl PixelCorrection {
    /// ∂(corrected 1/z)/∂(1/z), the factor on small differences and thus on noise; 1 without a
    /// correction.
    pub fn gain(&self, inverse_depth: f64) -> f64 {
        let [near, far] = self.seen_m;
        let held = !(inverse_depth * near <= 1.0 && inverse_depth * far >= 1.0);
        let slope = |x: f64| {
            let powers = self.terms.iter().enumerate();
            if held { 0.0 } else { powers.map(|(k, term)| term * power_slope(x, k)).sum() }
        };
        match self.quantity {
            CorrectedQuantity::InverseDepth => 1.0 + slope(inverse_depth),
            CorrectedQuantity::Depth => {
                let z = 1.0 / inverse_depth;
                (self.correct(inverse_depth) * z).powi(2) * (1.0 + slope(z))
            }
        }
    }
}

/// k xᵏ⁻¹.
pub(crate) fn power_slope(x: f64, k: usize) -> f64 {
    if k == 0 { 0.0 } else { k as f64 * x.powi(k as i32 - 1) }
}

#[cfg(test)]
mod tests {
    use super::*;

    const SIZE: ImageSize = ImageSize::new(640, 480);

    #[test]
    fn weights_add_up_to_one_and_follow_a_plane() {
        let grid = SplineGrid { size: SIZE, cols: 8, rows: 6 };
        for pixel in [
            Pixel::new(-0.5, -0.5),
            Pixel::new(639.5, 479.5),
            Pixel::new(321.3, 17.0),
            Pixel::new(900.0, -9.0),
        ] {
            let at = grid.weights(pixel);
            assert!((at.weights.iter().sum::<f64>() - 1.0).abs() < 1e-14);
            assert!(at.nodes.iter().all(|node| *node < grid.node_count()));
            // Node i of a uniform cubic B-spline sits at cell i − 1.
            let x: f64 = at
                .nodes
                .iter()
                .zip(&at.weights)
                .map(|(n, w)| ((n % 11) as f64 - 1.0) * 80.0 * w)
                .sum();
            assert!((x - (pixel.x.clamp(-0.5, 639.5) + 0.5)).abs() < 1e-9, "{pixel:?} {x}");
        }
    }

    #[test]
    fn a_stereo_correction_is_affine_in_inverse_depth_and_held_outside_what_was_seen() {
        let grid = SplineGrid::constant(SIZE);
        let mut correction =
            DepthCorrection::none(CorrectedQuantity::InverseDepth, 2, grid, [0.5, 4.0]);
        correction.coefficients = vec![0.01, -0.02];
        let pixel = Pixel::new(3.0, 4.0);
        assert!((correction.correct(pixel, 1.0).unwrap() - 0.99).abs() < 1e-15);
        assert!((correction.correct(pixel, 4.0).unwrap() - (4.0 + 0.01 - 0.04)).abs() < 1e-15);
        assert!(correction.has_seen(1.0) && !correction.has_seen(4.0) && !correction.has_seen(0.1));
        correction.quantity = CorrectedQuantity::Depth;
        assert!(
            (1.0 / correction.correct(pixel, 0.5).unwrap() - (2.0 + 0.01 - 0.04)).abs() < 1e-14
        );
        correction.coefficients = vec![-9.0, 0.0];
        assert_eq!(correction.correct(pixel, 0.5), None);
    }

    #[test]
    fn a_correction_of_no_depths_is_held_nowhere() {
        let none = DepthCorrection::none(
            CorrectedQuantity::Depth,
            1,
            SplineGrid::constant(SIZE),
            [f64::INFINITY, 0.0],
        );
        assert_eq!(none.correct(Pixel::new(3.0, 4.0), 0.5), Some(0.5));
    }

    #[test]
    fn the_gain_is_the_slope_of_what_is_corrected() {
        for quantity in [CorrectedQuantity::InverseDepth, CorrectedQuantity::Depth] {
            let at =
                PixelCorrection { quantity, terms: [0.01, -0.05, 0.03, 0.01], seen_m: [0.5, 4.0] };
            for inverse in [0.3, 0.9, 1.8, 0.1, 3.0] {
                let slope = (at.correct(inverse + 1e-6) - at.correct(inverse - 1e-6)) / 2e-6;
                assert!((at.gain(inverse) - slope).abs() < 1e-8, "{quantity:?} {inverse}: {slope}");
            }
        }
    }
}
