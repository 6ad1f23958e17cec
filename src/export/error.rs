//! What a format cannot hold, and what to do instead.

use crate::export::format::Format;
use crate::geometry::lens::LensModel;

/// A calibration that a format cannot hold.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum ExportError {
    /// The format has no such model.
    #[error(
        "the {format} format has no {model} lens; calibrate with --lens {instead}, or export to another format (json holds every lens)"
    )]
    Lens {
        /// The format.
        format: Format,
        /// The calibration's lens model.
        model: LensModel,
        /// Models that the format holds.
        instead: String,
    },
    /// The nearest lens the format has is too far off.
    #[error(
        "the {format} format has no {model} lens, and its nearest lens is off by up to {worst_px:.2} px; calibrate with --lens {instead}, or export to another format (json holds every lens)"
    )]
    Refit {
        /// The format.
        format: Format,
        /// The calibration's lens model.
        model: LensModel,
        /// The largest difference over the image, in pixels.
        worst_px: f64,
        /// Models that the format holds.
        instead: String,
    },
    /// The format's readers take the axes as square.
    #[error(
        "the {format} format has no skew, and this lens has {skew_px} px of it; calibrate without skew, or export to json"
    )]
    Skew {
        /// The format.
        format: Format,
        /// The calibration's skew.
        skew_px: f64,
    },
    /// The format holds one camera.
    #[error(
        "the {format} format holds one sensor, and this calibration has several: ask for one of {known}"
    )]
    SeveralSensors {
        /// The format.
        format: Format,
        /// The calibration's sensors.
        known: String,
    },
    /// There is no such sensor.
    #[error("this calibration has no sensor `{sensor}`; ask for one of {known}")]
    UnknownSensor {
        /// What was asked for.
        sensor: String,
        /// The calibration's sensors.
        known: String,
    },
    /// There is nothing to place.
    #[error(
        "the {format} format says where sensors are, and this calibration has no two whose places are known: calibrate a camera with color and depth, or a rig"
    )]
    NoPlaces {
        /// The format.
        format: Format,
    },
    /// There is no depth.
    #[error("the depth format is for depth sensors, and this calibration has none")]
    NoDepth,
    /// There is nothing to write.
    #[error(
        "this calibration has no image sensor, which is what the {format} format holds; export to json"
    )]
    NoSensor {
        /// The format.
        format: Format,
    },
    /// The document could not be written.
    #[error("the calibration cannot be written as {format}: {reason}")]
    Text {
        /// The format.
        format: Format,
        /// Why.
        reason: String,
    },
}
