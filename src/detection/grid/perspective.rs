//! Predicts corners far from all known ones: by the homography of the whole board, corrected for
//! lens distortion with the residuals of the nearest corners.

use nalgebra::{SMatrix, SVector};

use crate::detection::grid::{Grid, in_steps};
use crate::detection::vec2::Vec2;

/// Normal equations of the eight parameters of a homography with h₃₃ = 1.
type NormalMatrix = SMatrix<f64, 8, 8>;
/// The eight parameters, row by row, or their right-hand side.
type HomographyVector = SVector<f64, 8>;

/// Least w of a homography whose w is 1 at the board's middle: what has less is near the horizon of
/// the board's plane, or behind the camera. Chosen, not swept.
pub(in crate::detection) const LEAST_W: f64 = 0.05;
/// Largest squared distance of a corner whose residual corrects a prediction, in squared steps:
/// four steps. Chosen, not swept.
const MOST_SQUARED_STEPS: f32 = 16.0;

/// A homography from grid indices to pixels, fitted to all corners of a grid.
///
/// It minimizes the algebraic error of (h₁₁i + h₁₂j + h₁₃)/w = x, (h₂₁i + h₂₂j + h₂₃)/w = y with w
/// = 1 + h₃₁i + h₃₂j, indices counted from the grid's middle and pixels from the corners' mean.
#[derive(Debug, Clone, Copy)]
pub(in crate::detection) struct Perspective {
    h: HomographyVector,
    middle: (f64, f64),
    mean: Vec2,
    scale: f64,
}

impl Perspective {
    /// Fits all corners of `grid`; `None` if they do not determine it.
    pub(in crate::detection) fn fit(grid: &Grid) -> Option<Self> {
        Self::fit_to(grid, |_, _| true)
    }

    /// Fits those corners of `grid` that `is_consistent` accepts; `None` if they do not determine
    /// it.
    pub(in crate::detection) fn fit_to(
        grid: &Grid,
        is_consistent: impl Fn(i32, i32) -> bool,
    ) -> Option<Self> {
        let bounds = grid.bounds()?;
        let members = || grid.members.iter().filter(|&&(i, j)| is_consistent(i, j));
        let pixels = || members().filter_map(|&(i, j)| Some((i, j, grid.pixel(i, j)?)));
        let count = pixels().count() as f32;
        let mean = pixels().fold(Vec2::zeros(), |sum, (_, _, p)| sum + p) / count;
        let spread = pixels().map(|(_, _, p)| (p - mean).norm()).sum::<f32>() / count;
        let middle =
            (f64::from(bounds.i.0 + bounds.i.1) / 2.0, f64::from(bounds.j.0 + bounds.j.1) / 2.0);
        let scale = f64::from(spread.max(1.0));
        let mut normal = NormalMatrix::zeros();
        let mut right = HomographyVector::zeros();
        for (i, j, p) in pixels() {
            let (i, j) = (f64::from(i) - middle.0, f64::from(j) - middle.1);
            let (x, y) = (f64::from(p.x - mean.x) / scale, f64::from(p.y - mean.y) / scale);
            for (row, value) in [
                (HomographyVector::from([i, j, 1.0, 0.0, 0.0, 0.0, -i * x, -j * x]), x),
                (HomographyVector::from([0.0, 0.0, 0.0, i, j, 1.0, -i * y, -j * y]), y),
            ] {
                normal += row * row.transpose();
                right += row * value;
            }
        }
        let h = normal.cholesky()?.solve(&right);
        Some(Self { h, middle, mean, scale })
    }

    /// The pixel of the grid's point (i, j) by the homography; `None` behind the camera.
    pub(in crate::detection) fn at(&self, i: f32, j: f32) -> Option<Vec2> {
        let (i, j) = (f64::from(i) - self.middle.0, f64::from(j) - self.middle.1);
        let h = &self.h;
        let w = 1.0 + h[6] * i + h[7] * j;
        (w > LEAST_W).then(|| {
            let (x, y) = ((h[0] * i + h[1] * j + h[2]) / w, (h[3] * i + h[4] * j + h[5]) / w);
            self.mean + Vec2::new((x * self.scale) as f32, (y * self.scale) as f32)
        })
    }

    /// The predicted position of the corner (i, j) of `grid`: by the homography plus the residuals
    /// of the nearest known corners.
    pub(in crate::detection) fn predict(&self, grid: &Grid, i: i32, j: i32) -> Option<Vec2> {
        self.predict_by(grid, i, j, |_, _| true)
    }

    /// The same, with the residuals only of corners that `is_consistent` accepts.
    fn predict_by(
        &self,
        grid: &Grid,
        i: i32,
        j: i32,
        is_consistent: impl Fn(i32, i32) -> bool,
    ) -> Option<Vec2> {
        let (mut sum, mut weight) = (Vec2::zeros(), 0.0);
        for &(mi, mj) in grid.members.iter().filter(|&&(mi, mj)| is_consistent(mi, mj)) {
            let away = ((mi - i) * (mi - i) + (mj - j) * (mj - j)) as f32;
            if away > MOST_SQUARED_STEPS || away == 0.0 {
                continue;
            }
            let (Some(seen), Some(put)) = (grid.pixel(mi, mj), self.at(mi as f32, mj as f32))
            else {
                continue;
            };
            let w = 1.0 / (away * away);
            sum += (seen - put) * w;
            weight += w;
        }
        let correction = if weight > 0.0 { sum / weight } else { Vec2::zeros() };
        Some(self.at(i as f32, j as f32)? + correction)
    }

    /// Distance of the corner (i, j) of `grid` from its prediction with the residuals of corners
    /// that `is_consistent` accepts, in steps.
    pub(in crate::detection) fn off(
        &self,
        grid: &Grid,
        i: i32,
        j: i32,
        is_consistent: impl Fn(i32, i32) -> bool,
    ) -> Option<f32> {
        let off = in_steps(
            grid.pixel(i, j)? - self.predict_by(grid, i, j, is_consistent)?,
            self.steps(i, j)?,
        )?;
        Some(off.x.abs().max(off.y.abs()))
    }

    /// The steps from (i, j) to the next corner along i and along j.
    pub(in crate::detection) fn steps(&self, i: i32, j: i32) -> Option<[Vec2; 2]> {
        let (i, j) = (i as f32, j as f32);
        Some([
            self.at(i + 0.5, j)? - self.at(i - 0.5, j)?,
            self.at(i, j + 0.5)? - self.at(i, j - 0.5)?,
        ])
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::detection::grid::Node;

    #[test]
    fn a_board_in_perspective_is_continued_across_a_gap() {
        let at = |i: i32, j: i32| {
            let w = 1.0 + 0.06 * i as f32 - 0.02 * j as f32;
            Vec2::new(
                200.0 + (31.0 * i as f32 + 4.0 * j as f32) / w,
                150.0 + (24.0 * j as f32 - 3.0 * i as f32) / w,
            )
        };
        let mut grid = Grid::default();
        grid.clear(10, true);
        for (i, j) in (0..4).flat_map(|j| (0..5).map(move |i| (i, j))) {
            grid.set(
                i,
                j,
                Node {
                    pixel: at(i, j),
                    contrast: 100.0,
                    near_contrast: 90.0,
                    score: 1.0,
                    tight: false,
                },
            );
        }
        let perspective = Perspective::fit(&grid).expect("twenty corners");
        for (i, j) in [(7, 1), (8, 5), (-2, 0), (2, 7)] {
            let put = perspective.predict(&grid, i, j).expect("in front");
            assert!((put - at(i, j)).norm() < 0.1, "({i}, {j}): {put}");
        }
        let [u, _] = perspective.steps(2, 2).expect("in front");
        assert!((u - (at(3, 2) - at(1, 2)) / 2.0).norm() < 1.0);
    }

    #[test]
    fn corners_on_a_line_determine_nothing() {
        let mut grid = Grid::default();
        grid.clear(10, true);
        for i in 0..6 {
            grid.set(
                i,
                0,
                Node {
                    pixel: Vec2::new(20.0 * i as f32, 5.0),
                    contrast: 100.0,
                    near_contrast: 90.0,
                    score: 1.0,
                    tight: false,
                },
            );
        }
        assert!(Perspective::fit(&grid).is_none());
    }
}
