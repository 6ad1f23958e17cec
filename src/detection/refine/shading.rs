//! Light that changes over one corner's window: a highlight, the edge of a shadow.
//!
//! A highlight adds light to black and white alike, and its slope is taken for an offset of the
//! edges: of the products of distances to the two edges, an offset of one edge is even in its own
//! distance and odd in the other's, and so is a slope. The board's polynomial over all corners
//! cannot follow it. Where a corner fits worse than the others, a polynomial of third order over
//! its own window is fitted to what the model leaves and taken off, and the model is fitted again,
//! and so on: one is as narrow as the blur, the other as wide as the window, so a few rounds
//! separate them.

use nalgebra::{SMatrix, SVector};

use crate::detection::refine::normal_equations::{ModelColumns, RESIDUAL};
use crate::detection::refine::samples::Samples;

/// Terms: x, y, x², xy, y², x³, x²y, xy², y³, and x and y times the pattern.
const TERMS: usize = 11;
/// Columns of the derivatives by the mean of black and white and by half their difference.
const BY_LEVEL: usize = 4;
const BY_AMPLITUDE: usize = 5;
/// Prior of the terms, as a share of the samples' weight: a polynomial that the samples do not
/// determine is none.
const PRIOR: f64 = 1e-6;

/// Takes off `samples` the light that their last fit, whose linearization is in `columns`, leaves.
/// `reach`: half the window's extent, in samples.
pub(super) fn take_off_shading(samples: &mut Samples, columns: &ModelColumns, reach: f64) {
    let trust = columns.values(BY_LEVEL);
    let (pattern, residuals) = (columns.values(BY_AMPLITUDE), columns.values(RESIDUAL));
    // Each column is multiplied by the root of the sample's weight, as that by the level is.
    let at = |slot: usize| {
        let weight = trust.get(slot).copied().unwrap_or(0.0);
        let over = if weight > 0.0 { 1.0 / weight } else { 0.0 };
        let of = |column: &[f32]| f64::from(column.get(slot).copied().unwrap_or(0.0) * over);
        (f64::from(weight * weight), of(pattern), of(residuals))
    };
    let mut normal = SMatrix::<f64, TERMS, TERMS>::zeros();
    let mut right = SVector::<f64, TERMS>::zeros();
    let (mut slot, mut total) = (0, 0.0);
    samples.change(|x, y, value| {
        let (weight, pattern, residual) = at(slot);
        slot += 1;
        let terms = basis(f64::from(x) / reach, f64::from(y) / reach, pattern);
        total += weight;
        for row in 0..TERMS {
            let weighted = weight * terms[row];
            right[row] += weighted * residual;
            for col in 0..=row {
                normal[(row, col)] += weighted * terms[col];
            }
        }
        value
    });
    for term in 0..TERMS {
        normal[(term, term)] += PRIOR * total;
    }
    let Some(factors) = normal.cholesky() else { return };
    let shading = factors.solve(&right);
    let mut slot = 0;
    samples.change(|x, y, value| {
        let (_, pattern, _) = at(slot);
        slot += 1;
        let terms = basis(f64::from(x) / reach, f64::from(y) / reach, pattern);
        value - shading.dot(&terms) as f32
    });
}

fn basis(x: f64, y: f64, pattern: f64) -> SVector<f64, TERMS> {
    let (x2, y2) = (x * x, y * y);
    SVector::from([x, y, x2, x * y, y2, x2 * x, x2 * y, x * y2, y2 * y, pattern * x, pattern * y])
}
