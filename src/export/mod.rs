//! Calibrations in other programs' formats, one file a format. Uses geometry, calibration and document.
//!
//! **Never truncates.** A lens that a format cannot hold exactly is refused by name ([`ExportError::Lens`],
//! [`ExportError::Skew`]), or refitted where the format's users would otherwise have nothing, with the refit's error stated
//! in the file and in [`Exported::note`]. Numbers are written with every digit of their double.

pub mod at_size;
mod colmap;
mod kalibr;
mod mrcal;
mod number;
mod opencv;
mod refit;
mod ros;

use crate::calibration::calibration::{Calibration, SensorCalibration};
use crate::document::calibration::CalibrationDocument;
use crate::document::reading::to_json_pretty;
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
}

impl Format {
    /// Every format.
    pub const ALL: [Self; 6] = [Self::Json, Self::Ros, Self::Opencv, Self::Kalibr, Self::Mrcal, Self::Colmap];

    /// Its name on the command line and in `?format=`.
    pub fn name(self) -> &'static str {
        match self {
            Self::Json => "json",
            Self::Ros => "ros",
            Self::Opencv => "opencv",
            Self::Kalibr => "kalibr",
            Self::Mrcal => "mrcal",
            Self::Colmap => "colmap",
        }
    }

    /// The format with this name.
    pub fn from_name(name: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|format| format.name() == name)
    }

    fn media_type(self) -> &'static str {
        match self {
            Self::Json => "application/json",
            Self::Ros | Self::Opencv | Self::Kalibr => "application/yaml",
            Self::Mrcal | Self::Colmap => "text/plain; charset=utf-8",
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
    #[error("the {format} format holds one sensor, and this calibration has color and infrared; ask for one of them")]
    SeveralSensors {
        /// The format.
        format: Format,
    },
    /// There is nothing to write.
    #[error("this calibration has no picture sensor, which is what the {format} format holds; export to json")]
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

/// Writes `calibration` in `format`.
///
/// # Errors
/// [`ExportError`] where the format cannot hold it.
pub fn export(calibration: &Calibration, format: Format) -> Result<Exported, ExportError> {
    let camera = calibration.camera.as_deref().unwrap_or("camera");
    let (text, note) = match format {
        Format::Json => (json(calibration)?, None),
        Format::Ros => (ros::camera_info(camera, only_sensor(calibration, format)?.1)?, None),
        Format::Opencv => (opencv::file_storage(calibration, only_sensor(calibration, format)?.1)?, None),
        Format::Kalibr => {
            let (sensor_name, sensor) = only_sensor(calibration, format)?;
            kalibr::camera_chain(camera, sensor_name, sensor)?
        }
        Format::Mrcal => (mrcal::camera_model(only_sensor(calibration, format)?.1)?, None),
        Format::Colmap => (colmap::cameras(&sensors(calibration))?, None),
    };
    let file_name = format.file_name(camera);
    Ok(Exported { bytes: text.into_bytes(), media_type: format.media_type(), file_name, note })
}

fn json(calibration: &Calibration) -> Result<String, ExportError> {
    let document = CalibrationDocument::from(calibration);
    to_json_pretty(&document).map_err(|error| ExportError::Json { reason: error.to_string() })
}

/// The picture sensors with their names, in the order of documents.
fn sensors(calibration: &Calibration) -> Vec<(&'static str, &SensorCalibration)> {
    let named = [("color", &calibration.color), ("infrared", &calibration.infrared)];
    named.into_iter().filter_map(|(name, sensor)| Some((name, sensor.as_ref()?))).collect()
}

fn only_sensor(calibration: &Calibration, format: Format) -> Result<(&'static str, &SensorCalibration), ExportError> {
    match sensors(calibration).as_slice() {
        [] => Err(ExportError::NoSensor { format }),
        [only] => Ok(*only),
        _ => Err(ExportError::SeveralSensors { format }),
    }
}

fn without_skew(sensor: &SensorCalibration, format: Format) -> Result<(), ExportError> {
    match sensor.lens.matrix.skew {
        0.0 => Ok(()),
        skew_px => Err(ExportError::Skew { format, skew_px }),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::document::calibration::tests::example;
    use crate::geometry::lens::Lens;

    fn with_lens(model: LensModel, parameters: &[f64]) -> Calibration {
        let mut calibration = example();
        let sensor = calibration.color.as_mut().unwrap();
        sensor.lens = Lens::from_parameters(model, parameters).unwrap();
        sensor.lens_std = vec![0.0; parameters.len()];
        calibration
    }

    fn text(calibration: &Calibration, format: Format) -> String {
        String::from_utf8(export(calibration, format).unwrap().bytes).unwrap()
    }

    #[test]
    fn every_digit_reaches_every_format() {
        let calibration = with_lens(LensModel::Radial, &[532.123_456_789_012_3, 531.0, 319.5, 239.5, 0.0, -1e-7]);
        for format in Format::ALL {
            let text = text(&calibration, format);
            assert!(text.contains("532.1234567890123"), "{format}: {text}");
            assert!(format == Format::Json || text.contains("-0.0000001"), "{format}: {text}");
        }
    }

    #[test]
    fn what_a_format_lacks_is_refused_by_name() {
        let fisheye = with_lens(LensModel::KannalaBrandt, &[200.0, 200.0, 320.0, 240.0, 0.0, 0.01, 0.0, 0.0, 0.0]);
        let refused = export(&fisheye, Format::Mrcal).unwrap_err().to_string();
        assert!(refused.contains("mrcal") && refused.contains("kannala_brandt"), "{refused}");

        let skewed = with_lens(LensModel::Pinhole, &[470.0, 430.0, 290.0, 220.0, 8.0]);
        for format in Format::ALL.into_iter().filter(|format| *format != Format::Json) {
            assert_eq!(export(&skewed, format), Err(ExportError::Skew { format, skew_px: 8.0 }));
        }

        let two = Calibration { infrared: fisheye.color.clone(), ..example() };
        assert_eq!(export(&two, Format::Ros), Err(ExportError::SeveralSensors { format: Format::Ros }));
        assert_eq!(text(&two, Format::Colmap).lines().filter(|line| line.contains("640 480")).count(), 2);

        let none = Calibration { color: None, ..example() };
        for format in Format::ALL.into_iter().filter(|format| *format != Format::Json) {
            assert_eq!(export(&none, format), Err(ExportError::NoSensor { format }));
        }
    }

    #[test]
    fn a_refit_states_its_error_or_is_refused() {
        let parameters = [532.8, 532.9, 342.5, 233.9, 0.0, -0.281, 0.08, 0.0012, -0.0014, -0.01];
        let exported = export(&with_lens(LensModel::Brown, &parameters), Format::Kalibr).unwrap();
        let note = exported.note.unwrap();
        assert!(note.contains("px at worst"), "{note}");
        assert!(String::from_utf8(exported.bytes).unwrap().starts_with(&format!("# {note}\n")));

        let mut strong = parameters;
        strong[9] = 3.0;
        let refused = export(&with_lens(LensModel::Brown, &strong), Format::Kalibr).unwrap_err();
        assert!(matches!(refused, ExportError::Refit { worst_px, .. } if worst_px > 0.5), "{refused}");
    }

    #[test]
    fn colmap_counts_from_the_image_s_corner() {
        let calibration = with_lens(LensModel::Pinhole, &[530.0, 531.0, 319.5, 239.5, 0.0]);
        assert!(text(&calibration, Format::Colmap).ends_with("1 PINHOLE 640 480 530.0 531.0 320.0 240.0\n"));
    }
}
