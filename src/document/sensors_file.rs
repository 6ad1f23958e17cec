//! `sensors.toml` beside the subfolders of an RGB-D recording: what its depth images' numbers
//! mean, and what the factory says of the sensors, in the shapes of the calibration document.

use serde::Deserialize;

use crate::document::depth::{DepthKind, DisparityDocument};
use crate::document::error::DocumentError;
use crate::document::lens::LensDocument;
use crate::document::pose::{PoseDocument, RotationDocument};
use crate::geometry::depth_camera::DepthReading;
use crate::geometry::lens::Lens;
use crate::geometry::pose::Pose;

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
        file.depth.reading()?;
        Ok(file)
    }

    /// The image sensors whose lens is stated, and not used.
    pub fn unused_lenses(&self) -> Vec<&'static str> {
        let sensors = [("color", &self.color), ("infrared", &self.infrared)];
        let has_lens = |stated: &Option<StatedImageSensor>| {
            stated.as_ref().is_some_and(|stated| stated.lens.is_some())
        };
        sensors.into_iter().filter(|(_, stated)| has_lens(stated)).map(|(name, _)| name).collect()
    }

    /// The factory's lens and pose of the depth sensor, where both are stated.
    ///
    /// # Errors
    /// [`DocumentError::Field`] for a lens or pose that cannot be.
    pub fn factory(&self) -> Result<Option<(Lens, Pose)>, DocumentError> {
        let stated =
            self.extrinsics.iter().find(|extrinsics| extrinsics.name == "color_from_depth");
        let (Some(lens), Some(extrinsics)) = (&self.depth.lens, stated) else { return Ok(None) };
        let lens = Lens::try_from(lens).map_err(|e| e.inside("depth.lens"))?;
        let stated =
            PoseDocument { rotation: extrinsics.rotation, translation: extrinsics.translation };
        let color_from_depth = Pose::try_from(&stated).map_err(|e| e.inside("extrinsics"))?;
        Ok(Some((lens, color_from_depth.inverse())))
    }
}

impl StatedDepth {
    /// What the numbers mean; `None` for disparity of unknown meaning.
    ///
    /// # Errors
    /// [`DocumentError::Field`] for depth without its unit.
    pub fn reading(&self) -> Result<Option<DepthReading>, DocumentError> {
        match (self.kind, self.unit_m, self.disparity) {
            (DepthKind::Depth, Some(unit_m), _) if unit_m > 0.0 && unit_m < 1.0 => {
                Ok(Some(DepthReading::Metric { unit_m }))
            }
            (DepthKind::Depth, None, _) => Err(DocumentError::field(
                "depth.unit_m",
                "is missing: say how many meters one unit is, as in unit_m = 0.001",
            )),
            (DepthKind::Depth, ..) => {
                Err(DocumentError::field("depth.unit_m", "must be above 0 and below 1 m"))
            }
            (DepthKind::Disparity, _, Some(DisparityDocument { offset, slope })) => {
                Ok(Some(DepthReading::Disparity { offset, slope }))
            }
            (DepthKind::Disparity, _, None) => Ok(None),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_a_folder_states_is_read_and_what_is_missing_named() {
        let kinect =
            SensorsFile::from_toml("[depth]\nkind = \"disparity\"\ninvalid = 2047").unwrap();
        assert_eq!((kinect.depth.reading().unwrap(), kinect.depth.invalid), (None, Some(2047)));
        assert_eq!(kinect.factory().unwrap(), None);
        let metric = SensorsFile::from_toml(
            "[depth]\nkind = \"depth\"\nunit_m = 0.001\nlens = { model = \"pinhole\", fx = 580.0, fy = 580.0, cx = 320.0, cy = 240.0 }\n\
             [[extrinsics]]\nname = \"color_from_depth\"\nrotation = { w = 1.0, x = 0.0, y = 0.0, z = 0.0 }\ntranslation = [0.025, 0.0, 0.0]",
        )
        .unwrap();
        let (lens, depth_from_color) = metric.factory().unwrap().unwrap();
        assert_eq!((lens.matrix.fx, depth_from_color.translation().x), (580.0, -0.025));
        assert_eq!(metric.unused_lenses(), [""; 0]);
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
