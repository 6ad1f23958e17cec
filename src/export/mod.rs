//! Calibrations in other programs' formats, one file a format. Uses geometry, calibration and document.
//!
//! **Never truncates.** A lens that a format cannot hold exactly is refused by name ([`ExportError::Lens`],
//! [`ExportError::Skew`]), or refitted where the format's users would otherwise have nothing, with the refit's error stated
//! in the file and in [`Exported::note`]. Numbers are written with every digit of their double.
//!
//! A calibration of several sensors goes whole into the formats that hold several; of the others, it is one sensor's:
//! colour's unless [`ExportOptions::sensor`] says another.

pub mod at_size;
mod colmap;
mod depth;
mod kalibr;
mod mrcal;
mod number;
mod opencv;
mod refit;
mod ros;
mod sensors;
mod transforms;

use crate::calibration::calibration::Calibration;
use crate::document::calibration::CalibrationDocument;
use crate::document::reading::to_json_pretty;
use crate::export::sensors::{Sensor, one_sensor, placed_sensors};
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
    /// The meaning and the correction of a depth sensor's readings; docs/depth-correction has readers of it.
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
    #[error("the {format} format holds one sensor, and this calibration has several: ask for one of {known}")]
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
        "the {format} format says where sensors are, and this calibration has no two whose places are known: calibrate a camera with colour and depth, or a rig"
    )]
    NoPlaces {
        /// The format.
        format: Format,
    },
    /// There is no depth.
    #[error("the depth format is for depth sensors, and this calibration has none")]
    NoDepth,
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

/// What of a calibration is written.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct ExportOptions {
    /// The sensor, for formats that hold one: `color`, `infrared`, `depth` or a camera of a rig. Default: the only one, or
    /// colour's.
    pub sensor: Option<String>,
}

/// Writes `calibration` in `format`.
///
/// # Errors
/// [`ExportError`] where the format cannot hold it.
pub fn export(calibration: &Calibration, format: Format, options: &ExportOptions) -> Result<Exported, ExportError> {
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
        Format::Colmap => (colmap::cameras(&sensors::pictures(calibration))?, camera.to_owned(), None),
        Format::Urdf | Format::Tf => {
            let (placed, note) = placed_sensors(calibration, format)?;
            let write = if format == Format::Urdf { transforms::urdf } else { transforms::stamped };
            (write(camera, &placed), camera.to_owned(), note)
        }
        Format::Depth => {
            let depth = calibration.depth.as_ref().ok_or(ExportError::NoDepth)?;
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
mod tests {
    use std::f64::consts::FRAC_PI_2;

    use nalgebra::Vector3;

    use super::*;
    use crate::calibration::calibration::{Extrinsics, RigCamera};
    use crate::document::calibration::tests::example;
    use crate::geometry::lens::Lens;
    use crate::geometry::pose::Pose;

    fn with_lens(model: LensModel, parameters: &[f64]) -> Calibration {
        let mut calibration = example();
        let sensor = calibration.color.as_mut().unwrap();
        sensor.lens = Lens::from_parameters(model, parameters).unwrap();
        sensor.lens_std = vec![0.0; parameters.len()];
        calibration
    }

    fn text(calibration: &Calibration, format: Format) -> String {
        String::from_utf8(export(calibration, format, &ExportOptions::default()).unwrap().bytes).unwrap()
    }

    fn refused(calibration: &Calibration, format: Format) -> ExportError {
        export(calibration, format, &ExportOptions::default()).unwrap_err()
    }

    /// Those that hold a lens.
    fn lens_formats() -> impl Iterator<Item = Format> {
        Format::ALL.into_iter().filter(|format| !matches!(format, Format::Urdf | Format::Tf | Format::Depth))
    }

    #[test]
    fn every_digit_reaches_every_format() {
        let calibration = with_lens(LensModel::Radial, &[532.123_456_789_012_3, 531.0, 319.5, 239.5, 0.0, -1e-7]);
        for format in lens_formats() {
            let text = text(&calibration, format);
            assert!(text.contains("532.1234567890123"), "{format}: {text}");
            assert!(format == Format::Json || text.contains("-0.0000001"), "{format}: {text}");
        }
    }

    #[test]
    fn what_a_format_lacks_is_refused_by_name() {
        let fisheye = with_lens(LensModel::KannalaBrandt, &[200.0, 200.0, 320.0, 240.0, 0.0, 0.01, 0.0, 0.0, 0.0]);
        let line = refused(&fisheye, Format::Mrcal).to_string();
        assert!(line.contains("mrcal") && line.contains("kannala_brandt"), "{line}");

        let skewed = with_lens(LensModel::Pinhole, &[470.0, 430.0, 290.0, 220.0, 8.0]);
        for format in lens_formats().filter(|format| *format != Format::Json) {
            assert_eq!(refused(&skewed, format), ExportError::Skew { format, skew_px: 8.0 });
        }

        let two = Calibration { infrared: fisheye.color.clone(), ..example() };
        assert_eq!(text(&two, Format::Colmap).lines().filter(|line| line.contains("640 480")).count(), 2);

        let none = Calibration { color: None, ..example() };
        for format in lens_formats().filter(|format| *format != Format::Json) {
            assert_eq!(refused(&none, format), ExportError::NoSensor { format });
        }
    }

    #[test]
    fn a_refit_states_its_error_or_is_refused() {
        let parameters = [532.8, 532.9, 342.5, 233.9, 0.0, -0.281, 0.08, 0.0012, -0.0014, -0.01];
        let brown = with_lens(LensModel::Brown, &parameters);
        let exported = export(&brown, Format::Kalibr, &ExportOptions::default()).unwrap();
        let note = exported.note.unwrap();
        assert!(note.contains("px at worst"), "{note}");
        assert!(String::from_utf8(exported.bytes).unwrap().starts_with(&format!("# {note}\n")));

        let mut strong = parameters;
        strong[9] = 3.0;
        let line = refused(&with_lens(LensModel::Brown, &strong), Format::Kalibr);
        assert!(matches!(line, ExportError::Refit { worst_px, .. } if worst_px > 0.5), "{line}");
    }

    /// Two cameras of a rig, a quarter of a metre apart.
    fn rig() -> Calibration {
        let camera = |name: &str| RigCamera { name: name.into(), sensor: example().color.unwrap() };
        let target_from_source = Pose::from_axis_angle(Vector3::z() * FRAC_PI_2, Vector3::new(0.25, 0.0, -0.5));
        let name = "left_from_right".into();
        let extrinsics = Extrinsics { name, target_from_source, rotation_std: [0.0; 3], translation_std_m: [0.0; 3] };
        let cameras = vec![camera("left"), camera("right"), camera("lonely")];
        Calibration { camera: Some("head".into()), color: None, cameras, extrinsics: vec![extrinsics], ..example() }
    }

    #[test]
    fn one_sensor_of_several_is_asked_for_by_name() {
        let of = |sensor: &str| ExportOptions { sensor: Some(sensor.into()) };
        let known = || "left, right, lonely".to_owned();
        let several = ExportError::SeveralSensors { format: Format::Ros, known: known() };
        assert_eq!(refused(&rig(), Format::Ros), several);
        let ros = export(&rig(), Format::Ros, &of("right")).unwrap();
        assert!(String::from_utf8(ros.bytes).unwrap().contains("camera_name: \"right\""));
        assert_eq!(ros.file_name, "right.yaml");
        let unknown = ExportError::UnknownSensor { sensor: "rear".into(), known: known() };
        assert_eq!(export(&rig(), Format::Opencv, &of("rear")), Err(unknown));

        let two = Calibration { infrared: example().color, ..example() };
        let color = export(&two, Format::Ros, &ExportOptions::default()).unwrap();
        assert!(color.note.unwrap().contains("color, infrared"), "what is left out is told");
        let infrared = export(&two, Format::Ros, &of("infrared")).unwrap();
        assert!(String::from_utf8(infrared.bytes).unwrap().contains("camera_name: \"front_infrared\""));
    }

    #[test]
    fn places_are_written_from_the_first_sensor_and_what_has_none_is_told() {
        let urdf = export(&rig(), Format::Urdf, &ExportOptions::default()).unwrap();
        assert!(urdf.note.as_ref().unwrap().contains("lonely"), "{urdf:?}");
        let text = String::from_utf8(urdf.bytes).unwrap();
        assert!(text.contains("<parent link=\"left_optical_frame\"/>"), "{text}");
        assert!(text.contains("<child link=\"right_optical_frame\"/>"), "{text}");
        let numbers = |start: &str| -> Vec<f64> {
            let rest = text.split_once(start).unwrap().1;
            rest.split_once('"').unwrap().0.split(' ').map(|number| number.parse().unwrap()).collect()
        };
        assert_eq!(numbers("xyz=\""), [0.25, 0.0, -0.5]);
        assert!((numbers("rpy=\"")[2] - FRAC_PI_2).abs() < 1e-12, "{text}");
        let tf = self::text(&rig(), Format::Tf);
        assert!(tf.contains("child_frame_id: \"right_optical_frame\""), "{tf}");
        assert_eq!(refused(&example(), Format::Urdf), ExportError::NoPlaces { format: Format::Urdf });
    }

    #[test]
    fn a_chain_says_where_each_camera_is_from_the_one_before() {
        let two = Calibration { cameras: rig().cameras[..2].to_vec(), ..rig() };
        let chain = text(&two, Format::Kalibr);
        let cam1 = chain.split_once("cam1:").unwrap().1;
        assert!(cam1.contains("rostopic: \"/right/color\""), "{chain}");
        let rows: Vec<Vec<f64>> = cam1
            .lines()
            .filter_map(|line| line.trim().strip_prefix("- [")?.strip_suffix(']'))
            .map(|row| row.split(", ").map(|number| number.parse().unwrap()).collect())
            .collect();
        // right_from_left: a point at the right camera's place in the left one's frame is its origin.
        let at = |row: &[f64]| row[0] * 0.25 + row[2] * -0.5 + row[3];
        assert!(rows.len() == 4 && rows[..3].iter().all(|row| at(row).abs() < 1e-12), "{chain}");
        assert_eq!(rows[3], [0.0, 0.0, 0.0, 1.0]);
    }

    #[test]
    fn colmap_counts_from_the_image_s_corner() {
        let calibration = with_lens(LensModel::Pinhole, &[530.0, 531.0, 319.5, 239.5, 0.0]);
        assert!(text(&calibration, Format::Colmap).ends_with("1 PINHOLE 640 480 530.0 531.0 320.0 240.0\n"));
    }
}
