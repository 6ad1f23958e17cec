//! Fits the depth camera to a session's views so far: least squares over the board's surface in
//! each view, as in the solve, but with a depth correction of two parameters.

use nalgebra::{DMatrix, DVector, Vector6};

use crate::calibration::information::camera_information::ViewInformation;
use crate::calibration::information::view_information::inverse_of_pose;
use crate::estimation::rgbd::plane_information::{
    PlacedDepth, PlaneNormal, TileSample, moved_board,
};
use crate::estimation::scaled_factor::scaled_inverse;
use crate::geometry::depth_camera::DepthTile;
use crate::geometry::median::{NORMAL_MEDIAN, median};

/// The fitted depth camera.
pub(super) struct FittedDepth {
    pub(super) depth: PlacedDepth,
    /// Standard deviation of the tiles relative to that of their readings, and how much more the
    /// means over many tiles scatter than independent errors would.
    pub(super) scatter: [f64; 2],
    /// The sum of all steps.
    moved: DVector<f64>,
    /// Which tiles of each view lie on its plane.
    pub(super) used: Vec<Vec<bool>>,
}

/// One view: the corners in color, and the tiles on the board's surface.
type PlaneView<'a> = (&'a ViewInformation, &'a [DepthTile]);

/// As in the solve: the first round finds the tiles that do not lie on the plane.
const ROUNDS: usize = 2;
const STEPS: usize = 20;
/// The iteration ends with a step that lowers half the sum of squares by less than this per view.
const SETTLED: f64 = 1e-4;
/// The initial relative damping of the diagonal …
const FIRST_DAMPING: f64 = 1e-3;
/// … and the factor by which it grows after a step that does not lower the cost, and falls after
/// one that does.
const DAMPING_FACTOR: f64 = 10.0;
/// Residual limit of an inlier tile, in standard deviations.
const LIMIT: f64 = 6.0;

/// Tiles that stand for all tiles of a view.
const SAMPLED: usize = 24;

/// Fits the depth camera, starting from `start` with the information `prior` about it: in
/// directions that the views leave open it stays there. `None` if the fit fails.
pub(super) fn fit_depth(
    start: &PlacedDepth,
    prior: &DMatrix<f64>,
    views: &[PlaneView<'_>],
) -> Option<FittedDepth> {
    let mut fitted = FittedDepth {
        depth: start.clone(),
        scatter: [1.0; 2],
        moved: DVector::zeros(prior.nrows()),
        used: views.iter().map(|(_, tiles)| vec![true; tiles.len()]).collect(),
    };
    for _ in 0..ROUNDS {
        fitted.settle(prior, views)?;
        fitted.judge(views)?;
    }
    Some(fitted)
}

/// The normal equations of all views together, with the boards' poses eliminated.
struct DepthEquations {
    normal: DMatrix<f64>,
    gradient: DVector<f64>,
    /// Half the sum of squares, minimized over the boards' poses.
    cost: f64,
}

impl FittedDepth {
    /// Levenberg–Marquardt until the cost no longer falls: far from the solution, or in directions
    /// that few views leave open, a full Gauss–Newton step overshoots.
    fn settle(&mut self, prior: &DMatrix<f64>, views: &[PlaneView<'_>]) -> Option<()> {
        for (at, (in_color, tiles)) in views.iter().enumerate() {
            if self.normal((*in_color, *tiles), &self.used[at]).is_none() {
                self.used[at].fill(false);
            }
        }
        let mut now = self.equations(prior, views)?;
        let mut damping = FIRST_DAMPING;
        for _ in 0..STEPS {
            let mut damped = now.normal.clone();
            (0..damped.nrows()).for_each(|k| damped[(k, k)] *= 1.0 + damping);
            let step = -(scaled_inverse(&damped)? * &now.gradient);
            let next = self.stepped(&step);
            let after = next.as_ref().and_then(|next| next.equations(prior, views));
            match next.zip(after).filter(|(_, after)| after.cost < now.cost) {
                Some((next, after)) => {
                    let lowered = now.cost - after.cost;
                    (*self, now, damping) = (next, after, damping / DAMPING_FACTOR);
                    if lowered < SETTLED * views.len() as f64 {
                        break;
                    }
                }
                None if -step.dot(&now.gradient) < SETTLED * views.len() as f64 => break,
                None => damping *= DAMPING_FACTOR,
            }
        }
        Some(())
    }

    fn stepped(&self, step: &DVector<f64>) -> Option<Self> {
        let depth =
            step.iter().all(|value| value.is_finite()).then(|| self.depth.stepped(step))??;
        Some(Self { depth, moved: &self.moved + step, used: self.used.clone(), ..*self })
    }

    fn equations(&self, prior: &DMatrix<f64>, views: &[PlaneView<'_>]) -> Option<DepthEquations> {
        let mut normal = prior.clone();
        let mut gradient = prior * &self.moved;
        let mut cost = 0.5 * self.moved.dot(&gradient);
        for ((in_color, tiles), used) in views.iter().zip(&self.used) {
            // A step that leaves the lens's valid region is rejected.
            let planes = self.normal((*in_color, *tiles), used)?;
            let inverse = inverse_of_pose(&(in_color.normal().by_pose + planes.by_pose))?;
            let through = &planes.coupling * inverse;
            normal += &planes.by_depth - &through * planes.coupling.transpose();
            gradient += &planes.gradient - through * planes.pose_gradient;
            let explained = planes.pose_gradient.dot(&(inverse * planes.pose_gradient));
            cost += 0.5 * (planes.squares - explained);
        }
        cost.is_finite().then_some(DepthEquations { normal, gradient, cost })
    }

    fn normal(&self, (in_color, tiles): PlaneView<'_>, used: &[bool]) -> Option<PlaneNormal> {
        let variance = self.scatter[0] * self.scatter[0];
        PlaneNormal::of(&self.depth, &in_color.centered(), &sample(tiles, used), variance)
    }

    /// Determines which tiles lie on their planes, and their scatter. The boards' poses are those
    /// that corners and planes give together.
    fn judge(&mut self, views: &[PlaneView<'_>]) -> Option<()> {
        let residuals: Vec<Vec<f64>> = (views.iter().zip(&self.used))
            .map(|((in_color, tiles), used)| {
                let step = self.normal((*in_color, *tiles), used).and_then(|planes| {
                    let inverse = inverse_of_pose(&(in_color.normal().by_pose + planes.by_pose))?;
                    Some(-(inverse * planes.pose_gradient))
                });
                let board = moved_board(&in_color.centered(), &step.unwrap_or(Vector6::zeros()));
                let depth_from_board = self.depth.depth_from_color * board;
                let residual =
                    |tile| self.depth.residual(&depth_from_board, tile).unwrap_or(f64::INFINITY);
                tiles.iter().map(residual).collect()
            })
            .collect();
        let sizes = residuals.iter().flatten().map(|residual| residual.abs());
        let limit =
            LIMIT * median(sizes.filter(|size| size.is_finite()).collect())? / NORMAL_MEDIAN;
        for (used, residuals) in self.used.iter_mut().zip(&residuals) {
            used.iter_mut().zip(residuals).for_each(|(used, it)| *used = it.abs() <= limit);
        }
        let (mut squares, mut count, mut quarters) = (0.0, 0.0, 0.0);
        for (((_, tiles), used), residuals) in views.iter().zip(&self.used).zip(&residuals) {
            let on_plane = || (tiles.iter().zip(residuals).zip(used)).filter(|(_, used)| **used);
            squares += on_plane().map(|((_, residual), _)| residual * residual).sum::<f64>();
            count += on_plane().count() as f64;
            let each: Vec<(&DepthTile, f64)> =
                on_plane().map(|((tile, residual), _)| (tile, *residual)).collect();
            quarters += mean_squares_of_quarters(&each).unwrap_or(0.0);
        }
        let variance = (squares / f64::max(count, 1.0)).max(1e-6);
        let together = quarters / (4.0 * views.len() as f64) / variance;
        self.scatter = [variance.sqrt(), together.max(1.0).sqrt()];
        Some(())
    }
}

/// The sum over the four quarters of a view of (sum of residuals)² / count, as in the solve: on
/// average four times the residual variance if errors are independent.
fn mean_squares_of_quarters(tiles: &[(&DepthTile, f64)]) -> Option<f64> {
    let middle =
        |of: fn(&DepthTile) -> f64| median(tiles.iter().map(|(tile, _)| of(tile)).collect());
    let (x, y) = (middle(|tile| tile.pixel.x)?, middle(|tile| tile.pixel.y)?);
    let mut quarters = [(0.0, 0.0); 4];
    for (tile, residual) in tiles {
        let at = usize::from(tile.pixel.x > x) + 2 * usize::from(tile.pixel.y > y);
        quarters[at] = (quarters[at].0 + residual, quarters[at].1 + 1.0);
    }
    let mean_square =
        |(sum, count): &(f64, f64)| if *count > 0.0 { sum * sum / count } else { 0.0 };
    Some(quarters.iter().map(mean_square).sum())
}

/// At most [`SAMPLED`] of the used tiles, spaced by the golden ratio so that the sample does not
/// align with the rows and columns of tiles.
pub(super) fn sample(tiles: &[DepthTile], used: &[bool]) -> TileSample {
    let used: Vec<DepthTile> =
        tiles.iter().zip(used).filter(|(_, used)| **used).map(|(tile, _)| *tile).collect();
    if used.len() <= SAMPLED {
        return TileSample { tiles: used, each: 1.0 };
    }
    let golden = 0.5 * (5.0_f64.sqrt() - 1.0);
    let index = |k: usize| ((k as f64 * golden).fract() * used.len() as f64) as usize;
    TileSample {
        tiles: (0..SAMPLED).map(|k| used[index(k).min(used.len() - 1)]).collect(),
        each: used.len() as f64 / SAMPLED as f64,
    }
}
