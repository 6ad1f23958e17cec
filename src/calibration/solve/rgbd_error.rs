//! Why color and depth could not be calibrated, and what to do.

use crate::calibration::solve::depth_orientation::DepthOrientation;
use crate::estimation::error::EstimationError;

/// Why color and depth could not be calibrated.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum RgbdError {
    /// One sensor could not be calibrated by itself.
    #[error("{sensor}: {source}")]
    Sensor {
        /// Which.
        sensor: &'static str,
        /// Why not.
        source: EstimationError,
    },
    /// No depth image has a reading.
    #[error(
        "none of {images} depth images has a valid reading (every pixel is {reading}): check that the depth stream is on, that it is recorded as 16-bit depth, and that the board is within its range; or calibrate color without depth"
    )]
    NothingMeasured {
        /// How many views have one.
        images: usize,
        /// The value that they read, which means that nothing was measured.
        reading: u16,
    },
    /// Too few frame sets have the board's surface in depth.
    #[error(
        "the board was measured in the depth image of only {usable} of {all} views; 3 are needed{reasons}: check that depth and color are of the same device and of the same time"
    )]
    TooLittleDepth {
        /// How many.
        usable: usize,
        /// Of how many with the board in color.
        all: usize,
        /// Why the others do not, as `; how many, as view: reason` each, the most frequent first,
        /// or empty.
        reasons: String,
    },
    /// The lens that was fitted to planes only projects the board elsewhere: either the planes do
    /// not determine it, or depth is not of the board.
    #[error(
        "the board was measured in the depth image of {usable} of {all} views{reasons}, but the depth lens estimated from its planes projects it elsewhere: tilt the board more, near and far, or record infrared; and check that depth and color are of the same device, not mirrored, and taken together"
    )]
    LensElsewhere {
        /// How many.
        usable: usize,
        /// Of how many with the board in color.
        all: usize,
        /// As in [`RgbdError::TooLittleDepth`].
        reasons: String,
    },
    /// The lens that fits the planes best is implausible for a depth camera.
    #[error(
        "the depth lens that fits the board best is implausible (focal lengths {fx:.0} and {fy:.0} px, principal point ({cx:.0}, {cy:.0})): check that depth and color are of the same device, not mirrored, and taken together; and tilt the board more, near and far, or record infrared"
    )]
    ImplausibleLens {
        /// Focal length along x, in pixels.
        fx: f64,
        /// Along y.
        fy: f64,
        /// Principal point, in pixels.
        cx: f64,
        /// Its other coordinate.
        cy: f64,
    },
    /// Depth is a multiple of the board's distance.
    #[error(
        "depth readings are {factor:.3} times the board's distance: check the depth unit (the stated one times {factor_inverse:.4} would fit), the square size, and that depth and color are of the same device"
    )]
    Unit {
        /// The factor.
        factor: f64,
        /// Its reciprocal.
        factor_inverse: f64,
    },
    /// Depth fits the board only with this orientation of its images undone.
    #[error(
        "the depth images are {} relative to color: with that undone, they fit the board; disable it in the device or its driver, or undo it in the images",
        .0.name()
    )]
    Orientation(DepthOrientation),
    /// Depth is not of the board.
    #[error(
        "depth does not fit the board: {percent:.0} % of its surface in depth is off the board plane found in color: check that depth and color are of the same device, not swapped, not mirrored, and taken together"
    )]
    Disagree {
        /// The fraction of the patches, in percent.
        percent: f64,
    },
    /// The sensors would be too far from each other for one device.
    #[error(
        "depth and color are consistent only if their sensors are separated by {distance_m:.2} m and rotated by {degrees:.0} degrees: check that they are of the same device, not swapped, and not mirrored"
    )]
    SensorsTooDistant {
        /// How far, in meters.
        distance_m: f64,
        /// How much they are rotated against each other.
        degrees: f64,
    },
    /// No pose of the sensors, with any lens of the depth camera, makes planes and corners
    /// consistent.
    #[error(
        "no relative pose of the sensors makes depth consistent with color: check that depth and color are of the same device, not swapped, not mirrored, and taken together"
    )]
    NotOneDevice,
    /// The joint solve failed.
    #[error("joint solve of color and depth: {0}")]
    Joint(EstimationError),
}
