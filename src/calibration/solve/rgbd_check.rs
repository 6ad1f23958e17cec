//! Rejects solutions of color and depth that fit but are not possible: another unit, another
//! device, a mirrored image.

use crate::calibration::solve::rgbd_error::RgbdError;
use crate::estimation::depth_error::ComparedTile;
use crate::estimation::rgbd::device_prior::is_plausible;
use crate::estimation::rgbd::{DepthLens, RgbdEstimate};
use crate::geometry::camera_matrix::CameraMatrix;
use crate::geometry::depth_camera::DepthReading;
use crate::geometry::median::median;

/// If depth is more than this many times the board's distance, or less than its reciprocal, the
/// unit is wrong.
const UNIT_FACTOR: f64 = 1.2;

/// The most that patches may deviate from that factor, as a relative median, for it to be a unit.
const UNIT_DEVIATION: f64 = 0.1;

/// The least fraction of patches that must follow the board.
const LEAST_FOLLOWING_FRACTION: f64 = 0.6;

/// The most that may remain of the relative difference in 1/z between patches and the board, as the
/// median over all patches.
const MOST_REMAINING_DIFFERENCE: f64 = 0.02;

/// The greatest distance between sensors of one device, in meters, …
const FARTHEST_M: f64 = 0.5;
/// … and the greatest rotation between them, in degrees.
const MOST_ROTATED_DEG: f64 = 45.0;

/// # Errors
/// [`RgbdError`]: another unit, depth that does not follow the board, a lens that no depth camera
/// has, or sensors too far from each other for one device.
pub(super) fn check_joint(joint: &RgbdEstimate, lens_from: DepthLens) -> Result<(), RgbdError> {
    let tiles = || joint.compared.iter().flatten();
    let factors = || tiles().map(|compared| compared.plane / compared.tile.inverse_depth);
    let factor = median(factors().collect()).unwrap_or(1.0);
    let deviation =
        median(factors().map(|one| (one / factor - 1.0).abs()).collect()).unwrap_or(0.0);
    let wrong_unit = !(1.0 / UNIT_FACTOR..UNIT_FACTOR).contains(&factor);
    if wrong_unit && matches!(joint.depth.reading, DepthReading::Metric { .. }) {
        // A wrong unit gives the same factor everywhere; another scene does not.
        return Err(match deviation < UNIT_DEVIATION {
            true => RgbdError::Unit { factor, factor_inverse: 1.0 / factor },
            false => RgbdError::Disagree { percent: 100.0 },
        });
    }
    let left = |compared: &ComparedTile| {
        let inverse = compared.tile.inverse_depth;
        let corrected = joint
            .depth
            .correction
            .as_ref()
            .map_or(Some(inverse), |c| c.correct(compared.tile.pixel, inverse));
        corrected.map_or(f64::INFINITY, |corrected| (corrected / compared.plane - 1.0).abs())
    };
    let middle = median(tiles().map(left).collect()).unwrap_or(0.0);
    if joint.following < LEAST_FOLLOWING_FRACTION || middle > MOST_REMAINING_DIFFERENCE {
        let off = tiles().filter(|compared| left(compared) > MOST_REMAINING_DIFFERENCE).count()
            as f64
            / tiles().count().max(1) as f64;
        return Err(RgbdError::Disagree { percent: 100.0 * (1.0 - joint.following * (1.0 - off)) });
    }
    let lens = &joint.depth.lens;
    if lens_from == DepthLens::FromPlanes && !is_plausible(lens, joint.depth.image_size) {
        let CameraMatrix { fx, fy, cx, cy, .. } = lens.matrix;
        return Err(RgbdError::ImplausibleLens { fx, fy, cx, cy });
    }
    let pose = &joint.color_from_depth;
    let (distance_m, degrees) = (pose.translation().norm(), pose.rotation().angle().to_degrees());
    if distance_m > FARTHEST_M || degrees > MOST_ROTATED_DEG {
        return Err(RgbdError::SensorsTooDistant { distance_m, degrees });
    }
    Ok(())
}
