//! The corners' fit from more than one start, since the first may end in another minimum.

use crate::estimation::rgbd::corners::CornerBlocks;
use crate::estimation::rgbd::problem::RgbdProblem;

/// Two fits are of one minimum where the variances of the sensors' pose differ by less than this
/// factor. Seeded boards that move, and few frontal ones, have the same results from 10 to 100; 5
/// takes a moving board for one at rest, 300 leaves some boards at rest in another minimum.
const SAME_MINIMUM_RATIO: f64 = 30.0;

/// Where the board's motion is known, the better of two fits: with each board moved on to when
/// infrared was taken, and with each board as color saw it, which leaves out the views in which it
/// moved. The fit with the smaller variance of the sensors' pose is returned, because velocities
/// can be wrong where frames are rare, and there may be hardly a view without motion.
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

/// With few frontal boards, infrared's own lens is poorly determined, and its board poses differ
/// from color's. A fit that starts by attributing this to motion of the boards may end there. So
/// where a fit ends with such motion, a start without motion is tried too.
fn fit_from_both(problem: &RgbdProblem) -> Option<CornerBlocks> {
    let each_moved = CornerBlocks::fit_from(problem, false);
    if each_moved.as_ref().is_some_and(|corners| corners.found_still) {
        return each_moved;
    }
    let together = CornerBlocks::fit_from(problem, true);
    let is_better = |together: &CornerBlocks| {
        each_moved.as_ref().is_none_or(|moved| {
            together.separate_in_time.len() <= moved.separate_in_time.len()
                && SAME_MINIMUM_RATIO * unsure_m2(together) < unsure_m2(moved)
        })
    };
    if together.as_ref().is_some_and(is_better) { together } else { each_moved }
}

/// The uncertainty of the sensors' pose: about the variance of the position of a point 1 m away, in
/// m².
fn unsure_m2(corners: &CornerBlocks) -> f64 {
    let at = corners.layout.sensors.get(1).and_then(|sensor| sensor.pose_at);
    at.map_or(0.0, |at| (at..at + 6).map(|k| corners.covariance[(k, k)]).sum())
}
