//! What a format cannot hold, and what to do instead.

use crate::calibration::stereo_pair::StereoPairError;
use crate::export::format::Format;
use crate::geometry::lens::LensModel;
use crate::geometry::pixel::ImageSize;
use crate::geometry::rectification::RectificationError;

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
        "the {format} format has no {model} lens, and its nearest lens {}; calibrate with --lens brown --given k3=0, or with --lens {instead}, or export to another format (json holds every lens)",
        how_far(*worst_px)
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
        "the {format} format holds the relative poses of sensors, and this calibration has none: calibrate a camera with color and depth, or a rig"
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
    /// It is no stereo pair.
    #[error("{0}")]
    StereoPair(#[from] StereoPairError),
    /// It cannot be rectified.
    #[error("{0}")]
    Rectification(#[from] RectificationError),
    /// A pair is two.
    #[error("the {format} format takes two cameras: `{asked}` is not two names, as in left,right")]
    StereoNames {
        /// The format.
        format: Format,
        /// What was asked for.
        asked: String,
    },
    /// The format's readers take the first camera as the left one.
    #[error(
        "the {format} format takes the {} camera first, which is `{first}`: write {first},{second}", if *is_vertical { "upper" } else { "left" }
    )]
    StereoOrder {
        /// The format.
        format: Format,
        /// The left (or the upper) camera.
        first: String,
        /// The other one, which was asked for first.
        second: String,
        /// Whether one is above the other.
        is_vertical: bool,
    },
    /// The format's order is the document's.
    #[error(
        "the {format} format holds every sensor, in the calibration's order: leave out `{asked}`"
    )]
    Order {
        /// The format.
        format: Format,
        /// What was asked for.
        asked: String,
    },
    /// Rectified images have one size.
    #[error(
        "the {format} format needs images of one size, and these are {} and {}; scale them (--width, --height), or export to json", sizes[0], sizes[1]
    )]
    StereoSizes {
        /// The format.
        format: Format,
        /// The cameras' image sizes.
        sizes: [ImageSize; 2],
    },
    /// OpenCV's functions are of one kind of lens.
    #[error(
        "the {format} format needs the same lens model for both cameras, and these are {} and {}; calibrate both with one of them", models[0].name(), models[1].name()
    )]
    StereoModels {
        /// The format.
        format: Format,
        /// The cameras' lens models.
        models: [LensModel; 2],
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

/// How far a refitted lens is off.
fn how_far(worst_px: f64) -> String {
    if worst_px.is_finite() {
        format!("is off by up to {worst_px:.2} px")
    } else {
        "does not cover the whole image".to_owned()
    }
}
