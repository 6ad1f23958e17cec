//! What a solve found out of the board and of the shutter.

use nalgebra::{Point3, Vector3};
use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

use crate::document::error::DocumentError;
use crate::estimation::measured_board::{MeasuredBoard, RollingShutter};

/// The measured shape of a board, as offsets from the stated corners, in meters, in the board
/// frame. A rigid motion and the mean scale are removed.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct BoardShapeDocument {
    /// Root mean square of how far the corners are from where they were stated.
    pub unevenness_m: f64,
    /// Its standard deviation.
    pub unevenness_std_m: f64,
    /// Bow at the board's middle along its x and its y, positive away from the camera.
    pub bow_m: [f64; 2],
    /// The corners as stated.
    pub points: Vec<[f64; 3]>,
    /// How far each is from there.
    pub offsets_m: Vec<[f64; 3]>,
    /// Standard deviation of each offset per axis.
    pub std_m: Vec<[f64; 3]>,
}

/// Motion while the rows of an image were read one after another.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct RollingShutterDocument {
    /// Root mean square translation of the board from the first row to the last, in meters.
    pub translation_m: f64,
    /// Root mean square rotation likewise, in radians.
    pub rotation_rad: f64,
    /// Weight of the motion in the solve: 1 where the views agree that there is a rolling shutter,
    /// otherwise the part of the evidence that is beyond chance, 0 to 1.
    #[serde(default = "agreed")]
    pub agreement: f64,
}

/// Of documents that do not say.
fn agreed() -> f64 {
    1.0
}

impl From<&MeasuredBoard> for BoardShapeDocument {
    fn from(board: &MeasuredBoard) -> Self {
        let rows = |vectors: &[Vector3<f64>]| vectors.iter().map(|v| [v.x, v.y, v.z]).collect();
        Self {
            unevenness_m: board.unevenness_m,
            unevenness_std_m: board.unevenness_std_m,
            bow_m: board.bow_m,
            points: board.points.iter().map(|p| [p.x, p.y, p.z]).collect(),
            offsets_m: rows(&board.offsets_m),
            std_m: rows(&board.std_m),
        }
    }
}

impl TryFrom<&BoardShapeDocument> for MeasuredBoard {
    type Error = DocumentError;
    fn try_from(document: &BoardShapeDocument) -> Result<Self, DocumentError> {
        let count = document.points.len();
        let fields = [("offsets_m", &document.offsets_m), ("std_m", &document.std_m)];
        for (name, rows) in fields {
            if rows.len() != count {
                let problem = format!("has {} entries for {count} points", rows.len());
                return Err(DocumentError::field(format!("board_shape.{name}"), problem));
            }
        }
        let finite = |rows: &[[f64; 3]]| rows.iter().flatten().all(|v| v.is_finite());
        if !(finite(&document.points) && finite(&document.offsets_m) && finite(&document.std_m)) {
            return Err(DocumentError::field("board_shape", "has a number that is not finite"));
        }
        let vectors = |rows: &[[f64; 3]]| rows.iter().map(|v| Vector3::from(*v)).collect();
        Ok(Self {
            points: document.points.iter().map(|p| Point3::from(*p)).collect(),
            offsets_m: vectors(&document.offsets_m),
            std_m: vectors(&document.std_m),
            unevenness_m: document.unevenness_m,
            unevenness_std_m: document.unevenness_std_m,
            bow_m: document.bow_m,
        })
    }
}

impl From<RollingShutter> for RollingShutterDocument {
    fn from(shutter: RollingShutter) -> Self {
        let RollingShutter { translation_m, rotation_rad, agreement } = shutter;
        Self { translation_m, rotation_rad, agreement }
    }
}

impl From<RollingShutterDocument> for RollingShutter {
    fn from(document: RollingShutterDocument) -> Self {
        let RollingShutterDocument { translation_m, rotation_rad, agreement } = document;
        Self { translation_m, rotation_rad, agreement }
    }
}
