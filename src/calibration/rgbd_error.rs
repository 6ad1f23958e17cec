//! Why color and depth could not be calibrated, and what to do.

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
        "none of {images} depth images holds a measured pixel, all read {reading} everywhere: see that the depth stream is on, recorded as 16-bit depth, and has the board within its range; or leave depth out and calibrate color by itself"
    )]
    NothingMeasured {
        /// How many views have one.
        images: usize,
        /// The value that they read, which means that nothing was measured.
        reading: u16,
    },
    /// Too few frame sets have the board's surface in depth.
    #[error(
        "only {usable} of {all} views have the board in the depth image, 3 are needed{reasons}: check that depth and color are of the same device and moment"
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
        "{usable} of {all} views have the board in the depth image{reasons}, but the lens that fits its planes does not see it there: tilt the board more, near and far, or record infrared; and check that depth and color are of the same device, not mirrored, and taken together"
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
        "the depth lens that fits the board best has focal lengths of {fx:.0} and {fy:.0} px and its principal point at ({cx:.0}, {cy:.0}), as no depth camera has: check that depth and color are of the same device, not mirrored, and taken together; and tilt the board more, near and far, or record infrared"
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
        "depth reads {factor:.3} times the board's distance: check the unit of depth (meters per unit: about {factor_inverse:.4} of what is stated would fit), the board's square, and that depth and color are of the same device"
    )]
    Unit {
        /// The factor.
        factor: f64,
        /// Its reciprocal.
        factor_inverse: f64,
    },
    /// Depth is not of the board.
    #[error(
        "depth does not follow the board: {percent:.0} % of its surface in depth lies off the plane that color sees: check that depth and color are of the same device, not swapped, not mirrored, and taken together"
    )]
    Disagree {
        /// The fraction of the patches, in percent.
        percent: f64,
    },
    /// The sensors would be too far from each other for one device.
    #[error(
        "depth and color only agree if their sensors are {distance_m:.2} m from each other and rotated by {degrees:.0} degrees: check that they are of the same device, not swapped, and not mirrored"
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
        "no pose of the sensors lets depth and color agree: check that depth and color are of the same device, not swapped, not mirrored, and taken together"
    )]
    NotOneDevice,
    /// The joint solve failed.
    #[error("color and depth together: {0}")]
    Joint(EstimationError),
}
