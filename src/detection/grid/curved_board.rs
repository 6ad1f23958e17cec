//! Predicts a corner on a board that lens distortion curves: by a second-order surface through the
//! corners around it.
//!
//! Needs a 3×3 neighborhood: it can interpolate, not extrapolate beyond the outermost line. Over a
//! few squares a second-order surface follows even a full fisheye, where repeating the last step,
//! or a homography, is off by a quarter of a square.

use nalgebra::{SMatrix, SVector};

use crate::detection::grid::Grid;
use crate::detection::vec2::Vec2;

/// Corners up to this many lines away are used, on each side. Chosen, not swept.
const REACH_LINES: i32 = 2;
/// Terms of the surface: 1, i, j, i², ij, j².
const TERMS: usize = 6;
/// Minimum corners of a fit.
const FEWEST_CORNERS: usize = TERMS + 2;

/// The predicted position of the corner (i, j) of `grid` without its own measurement; `None` if
/// there are too few corners around it.
pub(in crate::detection) fn predict_on_curve(grid: &Grid, i: i32, j: i32) -> Option<Vec2> {
    let mut normal = SMatrix::<f32, TERMS, TERMS>::zeros();
    let mut right = SMatrix::<f32, TERMS, 2>::zeros();
    let (mut count, mut origin) = (0, None);
    for (dj, di) in (-REACH_LINES..=REACH_LINES)
        .flat_map(|dj| (-REACH_LINES..=REACH_LINES).map(move |di| (dj, di)))
    {
        let Some(p) = grid.pixel(i + di, j + dj).filter(|_| (di, dj) != (0, 0)) else { continue };
        let away = p - *origin.get_or_insert(p);
        let (x, y) = (di as f32, dj as f32);
        let row = SVector::<f32, TERMS>::from([1.0, x, y, x * x, x * y, y * y]);
        // Nearer corners have more weight.
        let weight = (1.0 + x * x + y * y).powi(-2);
        normal += row * row.transpose() * weight;
        right += row * away.transpose() * weight;
        count += 1;
    }
    let origin = origin.filter(|_| count >= FEWEST_CORNERS)?;
    let least = 1e-3 * normal.diagonal().min();
    let surface = normal
        .cholesky()
        .filter(|factor| factor.l_dirty().diagonal().min().powi(2) > least)?
        .solve(&right);
    Some(origin + Vec2::new(surface[(0, 0)], surface[(0, 1)]))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::detection::grid::Node;

    fn grid(members: impl Iterator<Item = (i32, i32)>, at: impl Fn(i32, i32) -> Vec2) -> Grid {
        let mut grid = Grid::default();
        grid.clear(10, true);
        for (i, j) in members {
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
        grid
    }

    /// As an equidistant fisheye sees a board from close by: steps shrink by a third from one to
    /// the next at its rim.
    fn fisheye(i: i32, j: i32) -> Vec2 {
        let (x, y) = (f64::from(i) * 0.45 - 0.2, f64::from(j) * 0.4 - 0.5);
        let radius = x.hypot(y);
        let scale = 110.0 * radius.atan() / radius.max(1e-9);
        Vec2::new((200.0 + scale * x) as f32, (150.0 + scale * y) as f32)
    }

    #[test]
    fn a_corner_at_the_rim_of_a_fisheye_is_where_those_around_it_have_it() {
        let grid = grid((0..5).flat_map(|j| (0..5).map(move |i| (i, j))), fisheye);
        for (i, j) in [(4, 1), (4, 3), (3, 4), (2, 0), (2, 2)] {
            let put = predict_on_curve(&grid, i, j).expect("enough corners");
            let step = (fisheye(i, j) - fisheye(i - 1, j)).norm();
            assert!(
                (put - fisheye(i, j)).norm() < 0.15 * step,
                "({i}, {j}) is off by {}",
                put - fisheye(i, j)
            );
        }
    }

    #[test]
    fn corners_that_determine_no_surface_give_no_prediction() {
        let straight = |i: i32, j: i32| Vec2::new(20.0 * i as f32, 20.0 * j as f32);
        assert_eq!(
            predict_on_curve(
                &grid((0..3).flat_map(|j| (0..2).map(move |i| (i, j))), straight),
                2,
                1
            ),
            None
        );
        assert_eq!(predict_on_curve(&grid((0..10).map(|k| (k % 5, k / 5)), straight), 2, 2), None);
    }
}
