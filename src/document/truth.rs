//! What is true of a simulated recording: beside it as `….truth.json`, and inside it as the
//! metadata record [`RECORD`], whose keys are this document's and whose values are their JSON.

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};

use crate::document::calibration::ExtrinsicsDocument;
use crate::document::error::DocumentError;
use crate::document::lens::LensDocument;
use crate::document::pose::PoseDocument;
use crate::document::reading::{from_json, to_json};
use crate::document::target::TargetDocument;

/// The metadata record's name.
pub const RECORD: &str = "plumb.truth";

/// What is true of a simulated recording.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct TruthDocument {
    /// What everything random followed from.
    pub seed: u64,
    /// The board, or the scene.
    pub target: TargetDocument,
    /// Each sensor's true lens, by the sensor's name.
    pub sensors: BTreeMap<String, TrueSensorDocument>,
    /// Where the sensors truly are relative to each other, with standard deviations of 0.
    pub extrinsics: Vec<ExtrinsicsDocument>,
    /// Each frame, in the recording's order.
    pub frames: Vec<TrueFrameDocument>,
    /// How the depth camera measures, where there is one.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub depth: Option<TrueDepthDocument>,
}

/// How a simulated depth camera measures: with q the inverse of the depth along the axis, in 1/m,
/// and two fields over the image, q' = q · (1 + scale) + offset + noise, rounded to steps; a
/// reading is 1/q' in units, rounded, 0 where there is none. A field is the sum of its five
/// coefficients times 1, x, y, x² + y², sin(3x + 1) · cos(2.5y), x and y from the image's middle
/// in half widths.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct TrueDepthDocument {
    /// Meters per unit.
    pub unit_m: f64,
    /// The field `scale`.
    pub scale: [f64; 5],
    /// The field `offset`, in 1/m.
    pub offset: [f64; 5],
    /// σ of the noise, in 1/m.
    pub noise_per_m: f64,
    /// The step, in 1/m.
    pub step_per_m: f64,
    /// By how much infrared and depth are taken later than the color image they come with, in
    /// seconds.
    pub time_offset_s: f64,
}

/// A sensor as it truly is.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct TrueSensorDocument {
    /// Width and height, in pixels.
    pub image_size: [u32; 2],
    /// The lens.
    pub lens: LensDocument,
}

/// A frame as it truly is.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct TrueFrameDocument {
    /// The frame's sequence number.
    pub sequence: u64,
    /// Where the board was in the middle of the color sensor's exposure; left out without a board.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub camera_from_board: Option<PoseDocument>,
    /// Where the scene was, in meters, in a frame of its own; left out with a board.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub camera_from_scene: Option<PoseDocument>,
    /// How far the board's image moved during the exposure at most, in pixels; null where part of
    /// it was out of view.
    pub motion_px: Option<f64>,
}

impl TruthDocument {
    /// The metadata record: each key with its JSON.
    ///
    /// # Errors
    /// [`DocumentError`] never happens for a document without NaN.
    pub fn to_record(&self) -> Result<BTreeMap<String, String>, DocumentError> {
        let whole: BTreeMap<String, serde_json::Value> = from_json(to_json(self)?.as_bytes())?;
        whole.into_iter().map(|(key, value)| Ok((key, to_json(&value)?))).collect()
    }

    /// From the metadata record.
    ///
    /// # Errors
    /// [`DocumentError`] when a key is missing, unknown or damaged.
    pub fn from_record(record: &BTreeMap<String, String>) -> Result<Self, DocumentError> {
        let mut whole = serde_json::Map::new();
        for (key, value) in record {
            whole.insert(
                key.clone(),
                from_json(value.as_bytes()).map_err(|error| error.inside(key))?,
            );
        }
        from_json(to_json(&whole)?.as_bytes())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::document::pose::RotationDocument;
    use crate::geometry::target::chessboard;

    #[test]
    fn a_truth_survives_its_record_to_the_bit() {
        let rotation = RotationDocument { w: 1.0, x: 0.0, y: 0.0, z: 0.0 };
        let pose = PoseDocument { rotation, translation: [1.0 / 3.0, -0.1, 0.7] };
        let truth = TruthDocument {
            seed: u64::MAX,
            target: chessboard(9, 6, 0.1 / 3.0).unwrap().into(),
            sensors: BTreeMap::new(),
            extrinsics: Vec::new(),
            frames: vec![TrueFrameDocument {
                sequence: 3,
                camera_from_board: Some(pose),
                camera_from_scene: None,
                motion_px: None,
            }],
            depth: Some(TrueDepthDocument {
                unit_m: 0.001,
                scale: [0.1 / 3.0; 5],
                offset: [-0.1; 5],
                noise_per_m: 0.002,
                step_per_m: 0.0,
                time_offset_s: -0.01,
            }),
        };
        let record = truth.to_record().unwrap();
        assert_eq!(record["seed"], u64::MAX.to_string());
        assert_eq!(TruthDocument::from_record(&record), Ok(truth));
        let mut damaged = record.clone();
        damaged.remove("frames");
        assert_eq!(TruthDocument::from_record(&damaged).unwrap_err().path(), Some("frames"));
    }
}
