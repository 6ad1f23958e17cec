//! The difference between the projections of two lenses, and how much of it can be due to chance.

use crate::estimation::uncertainty::{UncertaintyMap, projection_difference};
use crate::geometry::lens::Lens;
use crate::geometry::median::median;

/// The comparison of a lens estimated from images with the calibrated one, as medians over the
/// image.
#[derive(Debug, Clone, Copy)]
pub(super) struct LensChange {
    /// The difference of their projections, after the best compensating rotation.
    pub seen_px: f64,
    /// The smallest difference that is significant with these images.
    pub visible_px: f64,
}

impl LensChange {
    /// Between the `calibrated` lens and the `seen` one, which has this uncertainty; a difference
    /// of more than `sigmas` standard deviations is significant.
    pub fn between(
        calibrated: &Lens,
        seen: &Lens,
        uncertainty: &UncertaintyMap,
        sigmas: f64,
    ) -> Option<Self> {
        let (grid, weights) = (uncertainty.grid, &uncertainty.weights);
        let moved = projection_difference(calibrated, seen, grid, weights);
        Some(Self {
            seen_px: median(moved.into_iter().flatten().map(|[x, y]| x.hypot(y)).collect())?,
            visible_px: sigmas * uncertainty.median_and_worst()?.median_px,
        })
    }
}
