//! `sensors.toml` beside the subfolders of an RGB-D recording: what its depth images' numbers
//! mean, and what the factory says of the sensors, in the shapes of the calibration document.

use std::fs;
use std::path::Path;

use serde::Deserialize;

use crate::document::depth::{DepthKind, DisparityDocument};
use crate::document::depth_encoding::DepthEncodingDocument;
use crate::document::error::DocumentError;
use crate::document::lens::LensDocument;
use crate::document::pose::{PoseDocument, RotationDocument};
use crate::geometry::depth_camera::PosedDepthLens;
use crate::geometry::lens::Lens;
use crate::geometry::pixel::ImageSize;
use crate::geometry::pose::Pose;
use crate::imaging::depth_encoding::DepthEncoding;
use crate::imaging::factory::{FactoryCalibration, FactorySensor, StatedLens};
use crate::imaging::frame::SensorKind;

/// The file's name.
pub const FILE_NAME: &str = "sensors.toml";

/// What a folder's depth images are.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SensorsFile {
    /// The depth sensor.
    pub depth: StatedDepth,
    /// The color sensor, where anything is stated of it. Its lens is always estimated:
    /// corners determine it better than a factory's statement.
    pub color: Option<StatedImageSensor>,
    /// The infrared sensor, where anything is stated of it.
    pub infrared: Option<StatedImageSensor>,
    /// Where the sensors are relative to each other, as the factory says.
    #[serde(default)]
    pub extrinsics: Vec<StatedExtrinsics>,
}

/// What is stated of the depth sensor.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct StatedDepth {
    /// Distances or disparities.
    pub kind: DepthKind,
    /// Meters per unit, for distances.
    pub unit_m: Option<f64>,
    /// What a disparity means, where that is known.
    pub disparity: Option<DisparityDocument>,
    /// The reading that means none.
    pub invalid: Option<u16>,
    /// The factory's lens.
    pub lens: Option<LensDocument>,
}

/// What is stated of an image sensor.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct StatedImageSensor {
    /// The factory's lens.
    pub lens: Option<LensDocument>,
}

/// Where one sensor is relative to another.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct StatedExtrinsics {
    /// What it maps, as in `color_from_depth`.
    pub name: String,
    /// The rotation.
    pub rotation: RotationDocument,
    /// The translation, in meters.
    pub translation: [f64; 3],
}

impl SensorsFile {
    /// Reads the file's text.
    ///
    /// # Errors
    /// [`DocumentError::Field`] with what is missing or wrong.
    pub fn from_toml(text: &str) -> Result<Self, DocumentError> {
        let file: Self = toml::from_str(text)
            .map_err(|error| DocumentError::field(FILE_NAME, error.message().to_owned()))?;
        file.depth.encoding()?;
        Ok(file)
    }

    /// Reads the file of the folder of a recording; `None` for a folder without depth, which needs
    /// none.
    ///
    /// # Errors
    /// [`DocumentError::Field`] with the file and what is missing or wrong.
    pub fn of_folder(folder: &Path) -> Result<Option<Self>, DocumentError> {
        let file = folder.join(FILE_NAME);
        let named = |problem: String| DocumentError::field(file.display().to_string(), problem);
        let has_depth = folder.join(SensorKind::Depth.name()).is_dir();
        let text = match fs::read_to_string(&file) {
            Ok(text) => text,
            Err(_) if !has_depth => return Ok(None),
            Err(error) => {
                return Err(named(format!(
                    "cannot be read ({error}): a folder with depth/ needs this file, with [depth] kind = \"depth\" and unit_m, or kind = \"disparity\""
                )));
            }
        };
        Self::from_toml(&text).map(Some).map_err(|error| named(error.to_string()))
    }

    /// Says which lenses the file in `folder` states for nothing.
    pub fn warn_of_unused(&self, folder: &Path) {
        for sensor in self.unused_lenses() {
            tracing::warn!(
                "{}: {sensor}.lens is not used: the board's corners determine it better than the factory calibration",
                folder.join(FILE_NAME).display()
            );
        }
    }

    /// What the file states, of sensors with images of these sizes.
    ///
    /// # Errors
    /// [`DocumentError::Field`] for an invalid lens or pose.
    pub fn factory(
        &self,
        image_size: impl Fn(SensorKind) -> Option<ImageSize>,
    ) -> Result<FactoryCalibration, DocumentError> {
        let lens_of = |stated: &Option<StatedImageSensor>| stated.as_ref()?.lens.clone();
        let lenses = [
            (SensorKind::Color, lens_of(&self.color)),
            (SensorKind::Infrared, lens_of(&self.infrared)),
            (SensorKind::Depth, self.depth.lens.clone()),
        ];
        let mut sensors = Vec::new();
        for (sensor, stated) in lenses {
            let Some((document, image_size)) = stated.zip(image_size(sensor)) else { continue };
            let field = format!("{}.lens", sensor.name());
            let lens = Lens::try_from(&document).map_err(|error| error.inside(&field))?;
            let pose = match sensor {
                SensorKind::Color => Some(Pose::identity()),
                other => self.color_from(other)?,
            };
            sensors.push(FactorySensor {
                sensor,
                image_size,
                stated: stated_lens(&lens),
                lens: Some(lens),
                color_from_sensor: pose,
            });
        }
        Ok(FactoryCalibration { sensors, depth_encoding: Some(self.depth.encoding()?) })
    }

    /// The image sensors whose lens is stated, and not used.
    fn unused_lenses(&self) -> Vec<&'static str> {
        let sensors = [("color", &self.color), ("infrared", &self.infrared)];
        let has_lens = |stated: &Option<StatedImageSensor>| {
            stated.as_ref().is_some_and(|stated| stated.lens.is_some())
        };
        sensors.into_iter().filter(|(_, stated)| has_lens(stated)).map(|(name, _)| name).collect()
    }

    fn color_from(&self, sensor: SensorKind) -> Result<Option<Pose>, DocumentError> {
        let name = format!("color_from_{}", sensor.name());
        let stated = self.extrinsics.iter().find(|extrinsics| extrinsics.name == name);
        let pose = stated.map(|stated| {
            let (rotation, translation) = (stated.rotation, stated.translation);
            Pose::try_from(&PoseDocument { rotation, translation })
        });
        pose.transpose().map_err(|error| error.inside("extrinsics"))
    }

    /// The factory's lens and pose of the depth sensor, where both are stated.
    ///
    /// # Errors
    /// [`DocumentError::Field`] for an invalid lens or pose.
    pub fn depth_factory(&self) -> Result<Option<PosedDepthLens>, DocumentError> {
        let color_from_depth = self.color_from(SensorKind::Depth)?;
        let Some((lens, color_from_depth)) = self.depth.lens.as_ref().zip(color_from_depth) else {
            return Ok(None);
        };
        let lens = Lens::try_from(lens).map_err(|error| error.inside("depth.lens"))?;
        Ok(Some(PosedDepthLens { lens, depth_from_color: color_from_depth.inverse() }))
    }
}

impl StatedDepth {
    /// What the readings mean.
    ///
    /// # Errors
    /// [`DocumentError::Field`] for depth without its unit.
    pub fn encoding(&self) -> Result<DepthEncoding, DocumentError> {
        let Self { kind, unit_m, disparity, invalid, .. } = *self;
        let document = DepthEncodingDocument { kind, unit_m, disparity, invalid };
        DepthEncoding::try_from(&document).map_err(|error| error.inside("depth"))
    }
}

/// The lens in the file's own terms.
fn stated_lens(lens: &Lens) -> StatedLens {
    let matrix = &lens.matrix;
    StatedLens {
        model: lens.model().name().to_owned(),
        focal_px: [matrix.fx, matrix.fy],
        principal_px: [matrix.cx, matrix.cy],
        coefficients: lens.distortion.coefficients().to_vec(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_a_folder_states_is_read_and_what_is_missing_named() {
        let kinect =
            SensorsFile::from_toml("[depth]\nkind = \"disparity\"\ninvalid = 2047").unwrap();
        let raw = DepthEncoding { reading: None, invalid: Some(2047) };
        assert_eq!(kinect.depth.encoding().unwrap(), raw);
        assert_eq!(kinect.depth_factory().unwrap(), None);
        let metric = SensorsFile::from_toml(
            "[depth]\nkind = \"depth\"\nunit_m = 0.001\nlens = { model = \"pinhole\", fx = 580.0, fy = 580.0, cx = 320.0, cy = 240.0 }\n\
             [[extrinsics]]\nname = \"color_from_depth\"\nrotation = { w = 1.0, x = 0.0, y = 0.0, z = 0.0 }\ntranslation = [0.025, 0.0, 0.0]",
        )
        .unwrap();
        let PosedDepthLens { lens, depth_from_color } = metric.depth_factory().unwrap().unwrap();
        assert_eq!((lens.matrix.fx, depth_from_color.translation().x), (580.0, -0.025));
        assert_eq!(metric.unused_lenses(), [""; 0]);
        let size = ImageSize::new(640, 480);
        let factory = metric.factory(|_| Some(size)).unwrap();
        assert_eq!(
            factory.depth_encoding,
            Some(DepthEncoding { invalid: None, ..DepthEncoding::ORDINARY })
        );
        let stated = factory.sensor(SensorKind::Depth).unwrap();
        assert_eq!((stated.image_size, stated.lens), (size, Some(lens)));
        assert_eq!(stated.color_from_sensor.map(|pose| pose.translation().x), Some(0.025));
        let lens =
            "[color]\nlens = { model = \"pinhole\", fx = 5.0, fy = 5.0, cx = 3.0, cy = 2.0 }";
        let color = format!("{lens}\n[depth]\nkind = \"disparity\"\n[infrared]\n");
        assert_eq!(SensorsFile::from_toml(&color).unwrap().unused_lenses(), ["color"]);
        for (text, word) in [
            ("[depth]\nkind = \"depth\"", "unit_m"),
            ("[depth]\nkind = \"meters\"", "meters"),
            ("[color]", "depth"),
            ("[depth]\nkind = \"disparity\"\ninavlid = 2047", "inavlid"),
            ("[depth]\nkind = \"disparity\"\n[dept]", "dept"),
        ] {
            let line = SensorsFile::from_toml(text).unwrap_err().to_string();
            assert!(line.contains(word) && !line.contains('\n'), "{line}");
        }
    }
}
