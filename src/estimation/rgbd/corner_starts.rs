//! The corners' fit from more than one start, where the first may have ended elsewhere.

use crate::estimation::rgbd::corners::CornerBlocks;
use crate::estimation::rgbd::problem::RgbdProblem;

/// Two fits are of one minimum where the variance of the sensors' pose differs by less than this
/// factor. From 10 to 100 seeded boards that move and few frontal ones are answered the same; 5
/// takes a board that was carried about for one at rest, 300 leaves some of the latter elsewhere.
const SAME_MINIMUM: f64 = 30.0;

/// Two ways where the board's motion is known: each board moved on to when infrared was taken,
/// or taken as it was for views in which it stood still, the others left out. The one that
/// knows the sensors' pose better is right: velocities can be wrong where frames are rare,
/// and hardly a view may be still.
pub(super) fn fit_corners(problem: &RgbdProblem) -> Option<CornerBlocks> {
    let as_taken = fit_from_both(&RgbdProblem { time_offset: None, ..problem.clone() });
    let Some(offset) = problem.time_offset else { return as_taken };
    let moved_on = fit_from_both(problem);
    let unsure = |corners: &Option<CornerBlocks>| corners.as_ref().map_or(f64::INFINITY, unsure_m2);
    if unsure(&moved_on) <= unsure(&as_taken) {
        return moved_on;
    }
    let mut still = as_taken?;
    (still.time_offset, still.separate_in_time) = (Some(offset), Vec::new());
    Some(still)
}

/// Few frontal boards leave infrared's own lens open by far: its boards are then not where color
/// has them, and a fit that starts by taking that for their motion may end with it. Where a fit
/// has such motion, one that starts without is tried.
fn fit_from_both(problem: &RgbdProblem) -> Option<CornerBlocks> {
    let each_moved = CornerBlocks::fit_from(problem, false);
    if each_moved.as_ref().is_some_and(|corners| corners.found_still) {
        return each_moved;
    }
    let together = CornerBlocks::fit_from(problem, true);
    let is_better = |together: &CornerBlocks| {
        each_moved.as_ref().is_none_or(|moved| {
            together.separate_in_time.len() <= moved.separate_in_time.len()
                && SAME_MINIMUM * unsure_m2(together) < unsure_m2(moved)
        })
    };
    if together.as_ref().is_some_and(is_better) { together } else { each_moved }
}

/// How uncertain the sensors' pose is: the variance of where a point 1 m away is, in m².
fn unsure_m2(corners: &CornerBlocks) -> f64 {
    let at = corners.layout.sensors.get(1).and_then(|sensor| sensor.pose_at);
    at.map_or(0.0, |at| (at..at + 6).map(|k| corners.covariance[(k, k)]).sum())
}
