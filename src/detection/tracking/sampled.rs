//! Estimates the accuracy of all measured corners from the few that are refined.

use crate::detection::refine::{GridCorner, RefinedCorner};

/// Keeps `count` of `corners`, spread evenly.
pub(in crate::detection) fn keep_spread(corners: &mut Vec<GridCorner>, count: usize) {
    let Some(rest) = corners.len().checked_sub(count).filter(|_| count > 1) else { return };
    for nth in 0..count {
        corners[nth] = corners[nth + rest * nth / (count - 1)];
    }
    corners.truncate(count);
}

/// The standard deviation of corners as `measured`, per axis, in pixels, at least `least`. It is
/// estimated from those that were refined, including the refinement's own uncertainty. `None` if
/// most could not be refined.
pub(in crate::detection) fn measured_std_px(
    measured: &[GridCorner],
    refined: &[Option<RefinedCorner>],
    least: f64,
) -> Option<f64> {
    let (mut squares, mut seen) = (0.0, 0);
    for (guess, refined) in measured.iter().zip(refined) {
        let Some(refined) = refined else { continue };
        squares += refined.pixel.distance_px(guess.pixel).powi(2) + 2.0 * refined.std_px.powi(2);
        seen += 1;
    }
    (2 * seen >= measured.len()).then(|| (squares / (2 * seen) as f64).sqrt().max(least))
}
