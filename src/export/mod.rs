//! Calibrations in other programs' formats, one file a format. Uses geometry, calibration and
//! document.
//!
//! **Never truncates.** A lens that a format cannot hold exactly is refused by name
//! ([`ExportError::Lens`], [`ExportError::Skew`]), or refitted where the format's users would
//! otherwise have nothing, with the refit's error stated in the file and in [`Exported::note`].
//! Numbers are written with every digit of their double.
//!
//! A calibration of several sensors goes whole into the formats that hold several; of the others,
//! it is one sensor's: color's unless [`ExportOptions::sensor`] says another.

mod colmap;
pub mod colmap_scene;
mod depth;
mod kalibr;
mod mrcal;
mod number;
mod opencv;
pub mod other_pictures;
mod refit;
mod ros;
mod sensors;
mod transforms;

use crate::calibration::result::Calibration;
use crate::document::calibration::CalibrationDocument;
use crate::document::reading::to_json_pretty;
use crate::export::sensors::{Sensor, depth_sensor, one_sensor, placed_sensors};
use crate::geometry::lens::LensModel;

/// A format that a calibration can be written in.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum Format {
    /// Plumb's own calibration document.
    Json,
    /// ROS `camera_info` YAML, as `camera_info_manager` and `image_geometry` read it.
    Ros,
    /// OpenCV `FileStorage` YAML, with the field names of its calibration sample.
    Opencv,
    /// Kalibr's camera chain YAML.
    Kalibr,
    /// mrcal's `.cameramodel`.
    Mrcal,
    /// COLMAP's `cameras.txt`.
    Colmap,
    /// Where the sensors are, as a URDF of fixed joints between optical frames.
    Urdf,
    /// Where the sensors are, as a YAML list of ROS `geometry_msgs/TransformStamped`.
    Tf,
    /// The meaning and the correction of a depth sensor's readings; docs/depth-correction has
    /// readers of it.
    Depth,
}

impl Format {
    /// Every format.
    pub const ALL: [Self; 9] = [
        Self::Json,
        Self::Ros,
        Self::Opencv,
        Self::Kalibr,
        Self::Mrcal,
        Self::Colmap,
        Self::Urdf,
        Self::Tf,
        Self::Depth,
    ];

    /// Its name on the command line and in `?format=`.
    pub fn name(self) -> &'static str {
        match self {
            Self::Json => "json",
            Self::Ros => "ros",
            Self::Opencv => "opencv",
            Self::Kalibr => "kalibr",
            Self::Mrcal => "mrcal",
            Self::Colmap => "colmap",
            Self::Urdf => "urdf",
            Self::Tf => "tf",
            Self::Depth => "depth",
        }
    }

    /// The format with this name.
    pub fn from_name(name: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|format| format.name() == name)
    }

    fn media_type(self) -> &'static str {
        match self {
            Self::Json => "application/json",
            Self::Ros | Self::Opencv | Self::Kalibr | Self::Tf => "application/yaml",
            Self::Urdf => "application/xml",
            Self::Mrcal | Self::Colmap | Self::Depth => "text/plain; charset=utf-8",
        }
    }

    fn file_name(self, camera: &str) -> String {
        match self {
            Self::Json => format!("{camera}.json"),
            Self::Ros => format!("{camera}.yaml"),
            Self::Opencv => format!("{camera}-opencv.yaml"),
            Self::Kalibr => format!("{camera}-camchain.yaml"),
            Self::Mrcal => format!("{camera}.cameramodel"),
            Self::Colmap => "cameras.txt".to_owned(),
            Self::Urdf => format!("{camera}.urdf"),
            Self::Tf => format!("{camera}-tf.yaml"),
            Self::Depth => format!("{camera}-depth.txt"),
        }
    }
}

impl std::fmt::Display for Format {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(self.name())
    }
}

/// A calibration, written.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Exported {
    /// The file's content.
    pub bytes: Vec<u8>,
    /// Its media type.
    pub media_type: &'static str,
    /// What to call it.
    pub file_name: String,
    /// What the reader must know: that the lens was refitted, and how well.
    pub note: Option<String>,
}

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
        instead: &'static str,
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
        instead: &'static str,
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
        "this calibration has no picture sensor, which is what the {format} format holds; export to json"
    )]
    NoSensor {
        /// The format.
        format: Format,
    },
    /// The document could not be written.
    #[error("the calibration cannot be written as JSON: {reason}")]
    Json {
        /// Why.
        reason: String,
    },
}

/// What of a calibration is written.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct ExportOptions {
    /// The sensor, for formats that hold one, by its name in documents (`color`, `left.infrared`).
    /// Default: the only one, or color's.
    pub sensor: Option<String>,
}

/// Writes `calibration` in `format`.
///
/// # Errors
/// [`ExportError`] where the format cannot hold it.
pub fn export(
    calibration: &Calibration,
    format: Format,
    options: &ExportOptions,
) -> Result<Exported, ExportError> {
    let camera = calibration.camera.as_deref().unwrap_or("camera");
    let one = || one_sensor(calibration, format, options.sensor.as_deref());
    let (text, file, note) = match format {
        Format::Json => (json(calibration)?, camera.to_owned(), None),
        Format::Ros | Format::Opencv | Format::Mrcal => {
            let (sensor, note) = one()?;
            let text = match format {
                Format::Ros => ros::camera_info(&sensor.frame_name(camera), &sensor)?,
                Format::Opencv => opencv::file_storage(calibration, &sensor)?,
                _ => mrcal::camera_model(&sensor)?,
            };
            (text, sensor.frame_name(camera), note)
        }
        Format::Kalibr => {
            let (text, note) = match &options.sensor {
                Some(_) => kalibr::camera_chain(camera, &[one()?.0])?,
                None => kalibr::camera_chain(camera, &kalibr::chain_of(calibration)?)?,
            };
            (text, camera.to_owned(), note)
        }
        Format::Colmap => {
            (colmap::cameras(&sensors::pictures(calibration))?, camera.to_owned(), None)
        }
        Format::Urdf | Format::Tf => {
            let (placed, note) = placed_sensors(calibration, format)?;
            let write = if format == Format::Urdf { transforms::urdf } else { transforms::stamped };
            (write(camera, &placed), camera.to_owned(), note)
        }
        Format::Depth => {
            let (sensor, depth) = depth_sensor(calibration, options.sensor.as_deref())?;
            let camera = sensor.id.camera.as_deref().unwrap_or(camera);
            (depth::correction_file(camera, depth), camera.to_owned(), None)
        }
    };
    let file_name = format.file_name(&file);
    Ok(Exported { bytes: text.into_bytes(), media_type: format.media_type(), file_name, note })
}

fn json(calibration: &Calibration) -> Result<String, ExportError> {
    let document = CalibrationDocument::from(calibration);
    to_json_pretty(&document).map_err(|error| ExportError::Json { reason: error.to_string() })
}

fn without_skew(sensor: &Sensor<'_>, format: Format) -> Result<(), ExportError> {
    match sensor.lens.matrix.skew {
        0.0 => Ok(()),
        skew_px => Err(ExportError::Skew { format, skew_px }),
    }
}

#[cfg(test)]
#[path = "export_tests.rs"]
mod tests;
