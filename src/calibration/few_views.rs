//! Too few views to check the stated uncertainty.

use crate::calibration::result::{Finding, Grade};
use crate::estimation::camera::CameraEstimate;

/// With fewer views than this, their model error cannot be seen: the lens and the board's shape
/// absorb it. Of subsets of real photographs, the errors of fx, fy, cx and cy relative to their
/// standard deviations (with those of all photographs) had an rms of 1.3 to 2.2 with three views,
/// 0.9 to 1.5 with four, and 0.8 to 1.2 with five.
const ENOUGH_VIEWS: usize = 5;

/// A finding if a lens was estimated from fewer than [`ENOUGH_VIEWS`].
pub(super) fn few_views(estimate: &CameraEstimate) -> Option<Finding> {
    let used = estimate.views.iter().filter(|view| view.fault.is_none()).count();
    let is_estimated = estimate.lens_std()[..2].iter().any(|std| *std > 0.0);
    let views = if used == 1 { "view was" } else { "views were" };
    let reason = format!(
        "only {used} {views} used, too few to check the stated uncertainty: use at least {ENOUGH_VIEWS}"
    );
    (is_estimated && used < ENOUGH_VIEWS).then_some(Finding { grade: Grade::Usable, reason })
}
