//! Compares an edge's offset from the pixels near the corner with that from the pixels farther out.
//! The difference is noise as it affects a position, correlated or not; misfit that is symmetric
//! about the edge, such as the shape of motion blur, affects neither.

use pulp::{Simd, WithSimd};

use crate::detection::refine::corner_model::{CornerModel, OFFSETS};
use crate::detection::refine::normal_equations::{ModelColumns, RESIDUAL};
use crate::detection::refine::samples::Samples;

/// Minimum information of a half, as a share of the whole edge's.
const LEAST_SHARE: f64 = 0.1;

/// For each edge, the squared difference between the offsets from its two halves, in units of its
/// variance under white noise with the weights' standard deviations. `reach` is the window's extent
/// along each edge, in samples; `columns` are those of the last linearization. `None` where a half
/// has too little information.
pub(super) fn disagreements(
    samples: &Samples,
    model: &CornerModel,
    reach: [f64; 2],
    columns: &ModelColumns,
) -> [Option<f64>; 2] {
    pulp::Arch::new().dispatch(Halves { samples, model, reach, columns })
}

struct Halves<'a> {
    samples: &'a Samples,
    model: &'a CornerModel,
    reach: [f64; 2],
    columns: &'a ModelColumns,
}

impl WithSimd for Halves<'_> {
    type Output = [Option<f64>; 2];

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) -> Self::Output {
        let mut disagreements = [None; 2];
        for (edge, disagreement) in disagreements.iter_mut().enumerate() {
            // For all pixels, then for the near ones: the sum of squared derivatives by the offset,
            // and of derivatives times residuals.
            let [all, all_score, near, near_score] = self.sums(simd, edge);
            let far = all - near;
            if near.min(far) > LEAST_SHARE * all {
                let difference = near_score / near - (all_score - near_score) / far;
                *disagreement = Some(difference * difference * near * far / all);
            }
        }
        disagreements
    }
}

impl Halves<'_> {
    #[inline(always)]
    fn sums<S: Simd>(&self, simd: S, edge: usize) -> [f64; 4] {
        let Self { samples, model, reach, columns } = self;
        let [xs, ys, ..] = samples.vectors::<S>();
        let (residuals, offsets) = (
            columns.column::<S>(RESIDUAL, xs.len()),
            columns.column::<S>(OFFSETS + edge, xs.len()),
        );
        let [ax, ay] = model.along[edge];
        let offset = simd.splat_f32s((-ax * model.center[0] - ay * model.center[1]) as f32);
        let (ax, ay) = (simd.splat_f32s(ax as f32), simd.splat_f32s(ay as f32));
        // Within the other edge's blur this edge is not visible.
        let middle =
            simd.splat_f32s(((reach[edge] + 0.7 / model.sharpness[1 - edge]) / 2.0) as f32);
        let zero = simd.splat_f32s(0.0);
        let mut sums = [zero; 4];
        for i in 0..xs.len().min(offsets.len()).min(residuals.len()) {
            let s = simd.mul_add_f32s(ax, xs[i], simd.mul_add_f32s(ay, ys[i], offset));
            let near =
                simd.select_f32s(simd.less_than_f32s(simd.abs_f32s(s), middle), offsets[i], zero);
            sums[0] = simd.mul_add_f32s(offsets[i], offsets[i], sums[0]);
            sums[1] = simd.mul_add_f32s(offsets[i], residuals[i], sums[1]);
            sums[2] = simd.mul_add_f32s(near, near, sums[2]);
            sums[3] = simd.mul_add_f32s(near, residuals[i], sums[3]);
        }
        [
            f64::from(simd.reduce_sum_f32s(sums[0])),
            f64::from(simd.reduce_sum_f32s(sums[1])),
            f64::from(simd.reduce_sum_f32s(sums[2])),
            f64::from(simd.reduce_sum_f32s(sums[3])),
        ]
    }
}
