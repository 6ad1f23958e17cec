//! How far one lens projects from another, and how much of that can be chance.

use crate::estimation::uncertainty::{UncertaintyMap, projection_difference};
use crate::geometry::lens::Lens;
use crate::geometry::median::median;

/// What a lens that images show says of the calibrated one, in the median over the image.
#[derive(Debug, Clone, Copy)]
pub(super) struct LensChange {
    /// How far it projects from the calibrated one, after the best compensating rotation.
    pub seen_px: f64,
    /// The least such change that these images show.
    pub visible_px: f64,
}

impl LensChange {
    /// Between the `calibrated` lens and the one that is `seen`, with its uncertainty, of which so
    /// many standard deviations, `sigmas`, are no chance.
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
