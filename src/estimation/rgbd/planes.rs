//! Estimates from planes: the correction of depth, and for a depth camera without an infrared image
//! its lens and pose. The board's poses are those of the corners. They are fixed where infrared
//! sees the boards too; otherwise they are estimated with the corners' information as a prior, so
//! that the uncertain tilt of a distant board does not distort the lens.

use std::ops::Range;

use nalgebra::{Matrix6, Vector3};

use crate::estimation::depth_error::{ComparedTile, Prior, Smoothness, TriedCorrection};
use crate::estimation::error::EstimationError;
use crate::estimation::joint::depth_terms::{CorrectionColumns, PlaneObservation, add_planes, ray};
use crate::estimation::joint::linearize::LinearizationPoint;
use crate::estimation::joint::minimize::{Stop, walk};
use crate::estimation::joint::normal::{LocalBlock, NormalEquations, Step};
use crate::estimation::joint::{Layout, SensorLayout, State};
use crate::estimation::rgbd::corners::CornerBlocks;
use crate::estimation::rgbd::device_prior::{LENS_PARAMETERS, add_prior};
use crate::estimation::rgbd::problem::{
    DepthLens, RgbdEstimate, RgbdProblem, free, with_origin_at,
};
use crate::geometry::depth_camera::{DepthCamera, DepthReading, DepthTile};
use crate::geometry::depth_correction::DepthCorrection;
use crate::geometry::lens::Lens;
use crate::geometry::median::{NORMAL_MEDIAN, median};
use crate::geometry::pose::{Pose, pose_step};

/// Residual limit of an inlier tile, in standard deviations of the tiles' scatter: its tails are
/// longer than those of a normal distribution. Not swept.
const LIMIT_STDS: f64 = 6.0;
/// The same in the first round, whose residuals include the error of the start.
const FIRST_LIMIT_STDS: f64 = 12.0;

/// The largest number of rounds of a fit; between them tiles are weighted and selected again.
/// Chosen, not swept.
const ROUNDS: usize = 6;
/// The same for a fit that starts from the result of another: its last round uses the tiles and the
/// weight that its first one found. Chosen, not swept.
const ROUNDS_AGAIN: usize = 2;

/// The least standard deviation of a tile's mean, as a part of that of its readings. It corresponds
/// to a hundred independent readings: the errors of neighboring readings are correlated.
const LEAST_READING_STDS: f64 = 0.1;

/// The problem of the planes.
#[derive(Clone)]
pub(super) struct Planes<'a> {
    problem: &'a RgbdProblem,
    pub(super) layout: Layout,
    pub(super) planes: Vec<PlaneObservation>,
    /// Each board's pose from corners with its information, where planes may move it within the
    /// uncertainty of the corners.
    pub(super) anchors: Option<Vec<PosePrior>>,
}

/// A board's pose from corners, with its information matrix.
#[derive(Clone)]
pub(super) struct PosePrior {
    rig_from_board: Pose,
    square: Matrix6<f64>,
}

/// The planes' parameters.
#[derive(Clone)]
struct PlaneState {
    rig: State,
    correction: DepthCorrection,
}

pub(super) struct Fit {
    pub(super) state: State,
    pub(super) correction: DepthCorrection,
    pub(super) smoothness: Smoothness,
    pub(super) equations: NormalEquations,
    pub(super) tile_noise: f64,
    /// By how much the mean of many tiles scatters more than with independent errors.
    pub(super) together: f64,
}

impl Fit {
    /// The form of the correction with one power less, not fitted; `None` where that would be less
    /// than a scale and an offset.
    pub(super) fn other_form(&self) -> Option<DepthCorrection> {
        let DepthCorrection { quantity, terms, grid, seen_m, .. } = self.correction;
        (terms > 2).then(|| DepthCorrection::none(quantity, terms - 1, grid, seen_m))
    }
}

impl<'a> Planes<'a> {
    /// `depth_state` has each board at its pose when depth was taken; `by_corners` is the corners'
    /// information on those poses.
    pub(super) fn of(
        problem: &'a RgbdProblem,
        depth_state: &State,
        by_corners: &[LocalBlock],
    ) -> Self {
        let known = |lens: &Lens| free(lens, 0);
        let depth_lens = &depth_state.lenses[1];
        let color = SensorLayout { lens: known(&problem.color), lens_at: 0, pose_at: None };
        let depth = match problem.depth_lens {
            DepthLens::Infrared => {
                SensorLayout { lens: known(depth_lens), lens_at: 0, pose_at: None }
            }
            DepthLens::FromPlanes => SensorLayout {
                lens: free(depth_lens, LENS_PARAMETERS),
                lens_at: 0,
                pose_at: Some(LENS_PARAMETERS),
            },
            DepthLens::Known => {
                SensorLayout { lens: known(depth_lens), lens_at: 0, pose_at: Some(0) }
            }
        };
        let len = depth.lens.free.len() + if depth.pose_at.is_some() { 6 } else { 0 };
        let inverse_std = |tile: &DepthTile| tile_inverse_std(problem.depth.reading, tile);
        let with_depth =
            problem.views.iter().enumerate().filter(|(_, view)| !view.tiles.is_empty());
        let planes = with_depth.map(|(frame_set, view)| {
            let tiles = [view.tiles.as_slice(), &view.surround].concat();
            PlaneObservation {
                sensor: 1,
                frame_set,
                inverse_std: tiles.iter().map(inverse_std).collect(),
                // A lens that was refitted since the tiles were found may not see all of them.
                used: tiles
                    .iter()
                    .map(|tile| ray(&depth_state.lenses[1], tile).is_some())
                    .collect(),
                tiles,
            }
        });
        let anchor = |(pose, block): (&Pose, &LocalBlock)| PosePrior {
            rig_from_board: *pose,
            square: Matrix6::from_fn(|a, b| block.hessian[a][b]),
        };
        let each = depth_state.rig_from_board.iter().zip(by_corners);
        let anchors =
            (problem.depth_lens != DepthLens::Infrared).then(|| each.map(anchor).collect());
        let interrupt = problem.interrupt.clone();
        let layout = Layout { sensors: vec![color, depth], warp: None, len, interrupt };
        Self { problem, layout, planes: planes.collect(), anchors }
    }

    /// The problem of only those planes, counted from 0, for which `is_kept` is true.
    pub(super) fn of_views(&self, is_kept: impl Fn(usize) -> bool) -> Self {
        let kept = self.planes.iter().enumerate().filter(|(k, _)| is_kept(*k));
        Self { planes: kept.map(|(_, plane)| plane.clone()).collect(), ..self.clone() }
    }

    /// The nearest and the farthest depth that was measured.
    pub(super) fn seen_m(&self) -> [f64; 2] {
        let depths = || {
            self.planes.iter().flat_map(|plane| &plane.tiles).map(|tile| 1.0 / tile.inverse_depth)
        };
        [depths().fold(f64::INFINITY, f64::min), depths().fold(0.0, f64::max)]
    }

    /// Fits a correction of this form, and lens and pose where planes determine them. Tiles are
    /// weighted by their observed scatter, and outliers are left out.
    pub(super) fn fit(
        &mut self,
        start: &State,
        correction: DepthCorrection,
        smoothness: Smoothness,
    ) -> Option<Fit> {
        let start = PlaneState { rig: start.clone(), correction };
        self.fit_in(0..ROUNDS, start, smoothness, 1.0)
    }

    /// Fits again from the result `before`, after planes were left out.
    pub(super) fn fit_again(&mut self, before: &Fit) -> Option<Fit> {
        let start = PlaneState { rig: before.state.clone(), correction: before.correction.clone() };
        let rounds = ROUNDS - ROUNDS_AGAIN..ROUNDS;
        self.fit_in(rounds, start, before.smoothness, before.tile_noise)
    }

    fn fit_in(
        &mut self,
        rounds: Range<usize>,
        start: PlaneState,
        smoothness: Smoothness,
        mut tile_noise: f64,
    ) -> Option<Fit> {
        let at = self.layout.len;
        let mut whole = start;
        let prior = Prior::of(&whole.correction, smoothness);
        let len = at + whole.correction.coefficients.len();
        let layout = Layout { len, ..self.layout.clone() };
        let (mut together, mut equations) = (1.0, None);
        for round in rounds {
            if self.problem.interrupt.is_requested() {
                return None;
            }
            let planes: Vec<PlaneObservation> =
                self.planes.iter().map(|plane| scaled(plane, tile_noise)).collect();
            let anchors = self.anchors.as_deref();
            let interrupt = &self.problem.interrupt;
            let linearized = |whole: &PlaneState| {
                let goes_on = !interrupt.is_requested();
                goes_on.then(|| linearized(&layout, (whole, &prior), at, (&planes, anchors)))?
            };
            let stepped = |whole: &PlaneState, step: &Step| {
                let rig = whole.rig.stepped(&layout, &step.global, &step.frame_sets)?;
                let mut correction = whole.correction.clone();
                for (coefficient, step) in
                    correction.coefficients.iter_mut().zip(&step.global[at..])
                {
                    *coefficient += step;
                }
                Some(PlaneState { rig, correction })
            };
            let count = planes.iter().map(|plane| plane.tiles.len()).sum::<usize>();
            let mut at_end = linearized(&whole)?;
            if layout.len > 0 {
                // Later rounds start close to their minimum.
                let lambda = if round == 0 { Stop::default().lambda } else { 0.0 };
                let stop = Stop { lambda, ..Stop::default() };
                (whole, at_end, _) = walk((whole, at_end), count, stop, (linearized, stepped));
            }
            let residuals = std::mem::take(&mut at_end.tile_residuals);
            equations = Some(at_end);
            let before = tile_noise;
            let limit_stds = if round == 0 { FIRST_LIMIT_STDS } else { LIMIT_STDS };
            let changed = self.select_inliers(&residuals, limit_stds);
            tile_noise = (self.scatter(&residuals) * before).max(1e-3);
            together = self.together(&residuals);
            if !changed && (tile_noise / before - 1.0).abs() < 0.02 {
                break;
            }
        }
        Some(Fit {
            state: whole.rig,
            correction: whole.correction,
            smoothness,
            equations: equations?,
            tile_noise,
            together,
        })
    }

    /// Selects as inliers the tiles whose residual is at most `limit_stds` times the scatter of
    /// all. Returns whether the selection changed.
    fn select_inliers(&mut self, residuals: &[Vec<f64>], limit_stds: f64) -> bool {
        let sizes = residuals.iter().flatten().filter(|r| r.is_finite()).map(|r| r.abs()).collect();
        let limit = limit_stds * median(sizes).unwrap_or(0.0) / NORMAL_MEDIAN;
        let mut changed = false;
        for (plane, residuals) in self.planes.iter_mut().zip(residuals) {
            for (used, residual) in plane.used.iter_mut().zip(residuals) {
                let next = residual.abs() <= limit;
                changed |= next != *used;
                *used = next;
            }
        }
        changed
    }

    /// Root mean square of the residuals of inlier tiles.
    fn scatter(&self, residuals: &[Vec<f64>]) -> f64 {
        let pairs = self.planes.iter().zip(residuals).flat_map(|(p, r)| p.used.iter().zip(r));
        let (sum, count) = pairs
            .filter(|(used, _)| **used)
            .fold((0.0, 0), |(sum, count), (_, r)| (sum + r * r, count + 1));
        (sum / f64::from(count.max(1))).sqrt()
    }

    /// By how much the means over quarters of views scatter more than those of independent tiles;
    /// at least 1. Where the correction leaves a systematic error, neighboring tiles share it, and
    /// their mean is less certain than their number suggests.
    fn together(&self, residuals: &[Vec<f64>]) -> f64 {
        let (mut of_means, mut of_tiles, mut count) = (0.0, 0.0, 0.0);
        for (plane, residuals) in self.planes.iter().zip(residuals) {
            let tiles =
                || plane.tiles.iter().zip(residuals).zip(&plane.used).filter(|(_, used)| **used);
            let middle = |axis: fn(&DepthTile) -> f64| {
                median(tiles().map(|((tile, _), _)| axis(tile)).collect())
            };
            let (Some(x), Some(y)) = (middle(|tile| tile.pixel.x), middle(|tile| tile.pixel.y))
            else {
                continue;
            };
            let mut quarters = [(0.0, 0.0); 4];
            for ((tile, residual), _) in tiles() {
                let quarter = &mut quarters
                    [usize::from(tile.pixel.x > x) + 2 * usize::from(tile.pixel.y > y)];
                *quarter = (quarter.0 + residual, quarter.1 + 1.0);
                (of_tiles, count) = (of_tiles + residual * residual, count + 1.0);
            }
            let mean_square = |(sum, n): &(f64, f64)| if *n > 0.0 { sum * sum / n } else { 0.0 };
            of_means += quarters.iter().map(mean_square).sum::<f64>();
        }
        let quarters = 4.0 * self.planes.len().max(1) as f64;
        (of_means / quarters / (of_tiles / f64::max(count, 1.0)).max(f64::MIN_POSITIVE))
            .max(1.0)
            .sqrt()
    }

    /// The part of the board's own tiles that are inliers.
    fn following(&self) -> f64 {
        let own = self.planes.iter().flat_map(|plane| {
            plane.used.iter().take(self.problem.views[plane.frame_set].tiles.len())
        });
        let (used, all) = own.fold((0, 0), |(used, all), one| (used + u32::from(*one), all + 1));
        f64::from(used) / f64::from(all.max(1))
    }

    /// Each inlier tile, with the 1/z that it should have measured.
    pub(super) fn compared(&self, fit: &Fit) -> Vec<Vec<ComparedTile>> {
        let mut views = vec![Vec::new(); self.problem.views.len()];
        for plane in &self.planes {
            let depth_from_board = fit.state.sensor_from_board(1, plane.frame_set);
            let normal = depth_from_board * Vector3::z();
            let distance = normal.dot(&depth_from_board.translation());
            for ((tile, inverse_std), used) in
                plane.tiles.iter().zip(&plane.inverse_std).zip(&plane.used)
            {
                if let (true, Some(ray)) = (used, ray(&fit.state.lenses[1], tile)) {
                    let inverse_std = inverse_std / fit.tile_noise;
                    views[plane.frame_set].push(ComparedTile {
                        tile: *tile,
                        plane: normal.dot(&ray) / distance,
                        inverse_std,
                    });
                }
            }
        }
        views
    }

    pub(super) fn assemble(
        &self,
        corners: &CornerBlocks,
        fit: &Fit,
        other: Option<&Fit>,
        tried: Vec<TriedCorrection>,
    ) -> Result<RgbdEstimate, EstimationError> {
        let lens = fit.state.lenses[1];
        let (depth_covariance, pose_covariance) = match corners.layout.sensors.get(1) {
            Some(sensor) => {
                let pose_at = sensor.pose_at.unwrap_or(0);
                (
                    corners.lens_covariance(1),
                    Matrix6::from_fn(|a, b| corners.covariance[(pose_at + a, pose_at + b)]),
                )
            }
            None => {
                let covariance = self.covariance(corners, fit).ok_or(EstimationError::NoFit)?;
                let covariance = &covariance + self.by_form(fit, other, &covariance);
                let sensor = &self.layout.sensors[1];
                let (at, count, pose_at) =
                    (sensor.lens_at, sensor.lens.free.len(), sensor.pose_at.unwrap_or(0));
                let by_free = sensor.lens.all_by_free(&lens);
                let of_lens =
                    &by_free * covariance.view((at, at), (count, count)) * by_free.transpose();
                (of_lens, Matrix6::from_fn(|a, b| covariance[(pose_at + a, pose_at + b)]))
            }
        };
        let depth_from_color = fit.state.sensor_from_rig[1];
        let by_step = depth_from_color.inverse_jacobian();
        let correction = (fit.correction.terms > 0).then(|| fit.correction.clone());
        let uncentered =
            |color_from_board: &Pose| with_origin_at(color_from_board, &-corners.center);
        Ok(RgbdEstimate {
            color: fit.state.lenses[0],
            color_covariance: corners.lens_covariance(0),
            depth: DepthCamera { lens, correction, ..self.problem.depth.clone() },
            depth_covariance,
            color_from_depth: depth_from_color.inverse(),
            color_from_depth_covariance: by_step * pose_covariance * by_step.transpose(),
            time_offset: corners.time_offset,
            not_together: corners.separate_in_time.clone(),
            color_from_board: corners.state.rig_from_board.iter().map(uncentered).collect(),
            board_from_later: corners.board_from_later(),
            following: self.following(),
            tile_noise: fit.tile_noise,
            compared: self.compared(fit),
            smoothness: fit.smoothness,
            tried,
        })
    }

    /// `estimate` with the correction of `fit`, lens and pose being known.
    pub(super) fn refitted(
        &self,
        estimate: &RgbdEstimate,
        fit: &Fit,
        tried: Vec<TriedCorrection>,
    ) -> RgbdEstimate {
        let correction = (fit.correction.terms > 0).then(|| fit.correction.clone());
        let lens = fit.state.lenses[1];
        RgbdEstimate {
            color: fit.state.lenses[0],
            depth: DepthCamera { lens, correction, ..self.problem.depth.clone() },
            color_from_depth: fit.state.sensor_from_rig[1].inverse(),
            following: self.following(),
            tile_noise: fit.tile_noise,
            compared: self.compared(fit),
            smoothness: fit.smoothness,
            tried,
            ..estimate.clone()
        }
    }
}

/// The planes' normal equations with the prior of the correction, whose coefficients begin at
/// global parameter `at`, and every tile's residual.
fn linearized(
    layout: &Layout,
    (whole, prior): (&PlaneState, &Prior),
    at: usize,
    (planes, anchors): (&[PlaneObservation], Option<&[PosePrior]>),
) -> Option<NormalEquations> {
    let mut equations = NormalEquations::empty(layout.len, whole.rig.rig_from_board.len());
    equations.tile_residuals = add_planes(
        &mut equations,
        LinearizationPoint { layout, state: &whole.rig },
        CorrectionColumns { correction: &whole.correction, first: at },
        planes,
        anchors.is_some(),
    );
    for plane in planes {
        if let Some(anchor) = anchors.and_then(|anchors| anchors.get(plane.frame_set)) {
            let pose = &whole.rig.rig_from_board[plane.frame_set];
            anchor.hold(pose, &mut equations.cost, &mut equations.frame_sets[plane.frame_set]);
        }
    }
    let depth = &layout.sensors[1].lens;
    if depth.free.len() == LENS_PARAMETERS {
        let size = whole.correction.grid.size;
        add_prior(&mut equations, layout.sensors[1].lens_at, &whole.rig.lenses[1], size);
    }
    let size = whole.correction.coefficients.len();
    let coefficients = nalgebra::DVector::from_column_slice(&whole.correction.coefficients);
    let pull = &prior.hessian * &coefficients;
    equations.cost += coefficients.dot(&pull);
    for i in 0..size {
        equations.global_gradient[at + i] += pull[i];
        for j in 0..size {
            equations.global[(at + i, at + j)] += prior.hessian[(i, j)];
        }
    }
    equations.mirror();
    let lost = |(residuals, plane): (&Vec<f64>, &PlaneObservation)| {
        residuals.iter().zip(&plane.used).any(|(residual, used)| *used && !residual.is_finite())
    };
    let mut seen = equations.tile_residuals.iter().zip(planes);
    let usable = equations.cost.is_finite() && !seen.any(lost);
    usable.then_some(equations)
}

impl PosePrior {
    /// Adds the corners' equations about their own estimate.
    pub(super) fn hold(&self, rig_from_board: &Pose, cost: &mut f64, block: &mut LocalBlock) {
        let rotation =
            (rig_from_board.rotation() * self.rig_from_board.rotation().inverse()).scaled_axis();
        let translation = rig_from_board.translation() - self.rig_from_board.translation();
        let step = pose_step(&rotation, &translation);
        let pull = self.square * step;
        *cost += step.dot(&pull);
        for a in 0..6 {
            block.gradient[a] += pull[a];
            for b in 0..6 {
                block.hessian[a][b] += self.square[(a, b)];
            }
        }
    }
}

/// 1 over the standard deviation of a tile's 1/z, in m, from its readings' scatter and their
/// quantization step.
pub(super) fn tile_inverse_std(reading: DepthReading, tile: &DepthTile) -> f64 {
    let step = reading.inverse_depth_step(tile.inverse_depth);
    let reading_std = tile.reading_std.hypot(step / 12.0_f64.sqrt());
    1.0 / (reading_std * (1.0 / f64::from(tile.count)).sqrt().max(LEAST_READING_STDS))
}

pub(super) fn scaled(plane: &PlaneObservation, noise: f64) -> PlaneObservation {
    PlaneObservation {
        inverse_std: plane.inverse_std.iter().map(|s| s / noise).collect(),
        ..plane.clone()
    }
}
