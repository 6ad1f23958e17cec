//! What the pixels of a corner's own window show of its edges' curvature beyond that which the fit
//! took from the board. It compares an edge's offset far from the corner with that near it, by
//! least squares on the last linearization: offset = a + b · t + excess · t²/2.
//!
//! One window has little information (for small cells about a third of what a corner with both its
//! neighbors has, for large ones none), but it has it at the ends of the board's lines too, where
//! the neighbors' differences have to be extrapolated: in small cells that error was common to all
//! corners of a border and up to three times their standard deviation.
//!
//! A window that reaches a part e of the way to the next corner has 6/45 · e⁴ of the information
//! of the second difference of three corners: an offset's variance is ε²/(2r) where white noise
//! along an edge has the density ε² and the window reaches r to each side, the curvature's by one
//! window 45/2 · ε²/r⁵, by three corners at the distance d six offsets' over d⁴.

use pulp::{Simd, WithSimd};

use crate::detection::refine::corner_model::{CornerModel, OFFSETS};
use crate::detection::refine::fit::CornerFit;
use crate::detection::refine::normal_equations::{ModelColumns, RESIDUAL};
use crate::detection::refine::samples::Samples;
use crate::detection::refine::window::Window;

/// A window that reaches a smaller part of the way to the next corner is skipped: it has less than
/// a hundredth of the information of the corner's neighbors (above).
const LEAST_EXTENT: f64 = 0.5;

/// The curvature of one edge in its corner's window, beyond that of the fit.
#[derive(Debug, Clone, Copy)]
pub(super) struct ExcessCurvature {
    /// How much it exceeds that of the fit, towards the edge's normal, in 1/px.
    pub excess: f64,
    /// Its variance, in 1/px².
    pub variance: f64,
    /// The corner's displacement, in px, per 1/px of additional curvature.
    pub move_px2: [f64; 2],
}

/// For the fit of a corner in `window`, with its samples and last linearization. `None` where the
/// window does not determine the curvature.
pub(super) fn edge_curvatures(
    samples: &Samples,
    columns: &ModelColumns,
    fit: &CornerFit,
    window: &Window,
) -> [Option<ExcessCurvature>; 2] {
    let asked = window.extent.map(|extent| extent >= LEAST_EXTENT);
    if asked == [false; 2] {
        return [None; 2];
    }
    let model = &fit.model;
    let sums = pulp::Arch::new().dispatch(AlongEdges { samples, columns, model });
    let bin = window.bin as f64;
    [0, 1].map(|edge| {
        let [s0, s1, s2, s3, s4] = sums[edge].information;
        let [r0, r1, r2] = sums[edge].scores;
        // Projection of t² onto a translation and a rotation of the edge.
        let det = s0 * s2 - s1 * s1;
        let (offset, slope) = ((s2 * s2 - s1 * s3) / det, (s0 * s3 - s1 * s2) / det);
        let information = s4 - offset * s2 - slope * s3;
        let score = r2 - offset * r0 - slope * r1;
        let excess = 2.0 * score / information / bin;
        let variance = 4.0 * fit.mean_square / information / (bin * bin);
        // Blur displaces a curved edge too: CornerModel::pull_of_blur.
        let blur = 1.0 / (model.sharpness[1 - edge] * model.sharpness[1 - edge]);
        let mut offsets = [0.0; 2];
        offsets[edge] = -0.5 * (offset + blur);
        let move_px2 = model.center_move(offsets).map(|v| v * bin * bin);
        let known = asked[edge]
            && variance > 0.0
            && (excess + variance + move_px2[0] + move_px2[1]).is_finite();
        known.then_some(ExcessCurvature { excess, variance, move_px2 })
    })
}

/// Sums over an edge's samples; t is the distance from the corner along the edge.
#[derive(Debug, Clone, Copy, Default)]
struct EdgeSums {
    /// Of the squared derivatives by the edge's offset, times t⁰ … t⁴.
    information: [f64; 5],
    /// Of these derivatives times residuals, times t⁰ … t².
    scores: [f64; 3],
}

struct AlongEdges<'a> {
    samples: &'a Samples,
    columns: &'a ModelColumns,
    model: &'a CornerModel,
}

impl WithSimd for AlongEdges<'_> {
    type Output = [EdgeSums; 2];

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) -> Self::Output {
        [self.along(simd, 0), self.along(simd, 1)]
    }
}

impl AlongEdges<'_> {
    /// No closures: all of it must be inlined to be compiled for the processor.
    #[inline(always)]
    fn along<S: Simd>(&self, simd: S, edge: usize) -> EdgeSums {
        let Self { samples, columns, model } = self;
        let [xs, ys, ..] = samples.vectors::<S>();
        let residuals = columns.column::<S>(RESIDUAL, xs.len());
        let zero = simd.splat_f32s(0.0);
        let offsets = columns.column::<S>(OFFSETS + edge, xs.len());
        let [ax, ay] = model.along[edge];
        let offset = simd.splat_f32s((-ax * model.center[0] - ay * model.center[1]) as f32);
        let (ax, ay) = (simd.splat_f32s(ax as f32), simd.splat_f32s(ay as f32));
        let (mut information, mut scores) = ([zero; 5], [zero; 3]);
        for i in 0..xs.len().min(offsets.len()).min(residuals.len()) {
            let t = simd.mul_add_f32s(ax, xs[i], simd.mul_add_f32s(ay, ys[i], offset));
            let mut square = simd.mul_f32s(offsets[i], offsets[i]);
            for sum in &mut information {
                *sum = simd.add_f32s(*sum, square);
                square = simd.mul_f32s(square, t);
            }
            let mut score = simd.mul_f32s(offsets[i], residuals[i]);
            for sum in &mut scores {
                *sum = simd.add_f32s(*sum, score);
                score = simd.mul_f32s(score, t);
            }
        }
        let mut sums = EdgeSums::default();
        for (into, sum) in sums.information.iter_mut().zip(information) {
            *into = f64::from(simd.reduce_sum_f32s(sum));
        }
        for (into, sum) in sums.scores.iter_mut().zip(scores) {
            *into = f64::from(simd.reduce_sum_f32s(sum));
        }
        sums
    }
}
