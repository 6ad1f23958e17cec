//! A detection, as it is stored with its view.

use serde::{Deserialize, Serialize};

use crate::detection::board_detection::{BoardMarkers, DetectedCorner, Detection, GridIndex};
use crate::document::error::DocumentError;
use crate::geometry::board::BoardSize;
use crate::geometry::pixel::Pixel;

/// A board that was found.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct DetectionDocument {
    /// Inner corners along a row.
    pub cols: u32,
    /// Rows of inner corners.
    pub rows: u32,
    /// Some of the board's corners were not seen.
    pub partial: bool,
    /// The indices count from the board's first corner.
    pub position_known: bool,
    /// The board's pattern is the same after half a turn: no image determines its orientation.
    pub orientation_ambiguous: bool,
    /// Width of the blur at the board's edges, in pixels.
    pub blur_px: f64,
    /// Which corners: `[col, row]`.
    pub indices: Vec<[i32; 2]>,
    /// Where each is seen, in pixels.
    pub corners: Vec<[f64; 2]>,
    /// Predicted standard deviation of each, per axis, in pixels.
    pub std_px: Vec<f64>,
    /// Results from the board's markers; left out for a plain chessboard.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub markers: Option<BoardMarkersDocument>,
}

/// Results from a board's markers, besides the corner ids.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub struct BoardMarkersDocument {
    /// Markers whose code was read.
    pub read: usize,
    /// For a ChArUco board whose two layouts differ: whether its layout is the legacy one.
    pub legacy: Option<bool>,
    /// Of an AprilGrid: the cells of black around a tag's payload.
    pub border_bits: Option<u32>,
    /// Black and white are inverted.
    pub inverted: bool,
}

impl From<BoardMarkers> for BoardMarkersDocument {
    fn from(markers: BoardMarkers) -> Self {
        let BoardMarkers { read, legacy, border_bits, inverted } = markers;
        Self { read, legacy, border_bits, inverted }
    }
}

impl From<BoardMarkersDocument> for BoardMarkers {
    fn from(document: BoardMarkersDocument) -> Self {
        let BoardMarkersDocument { read, legacy, border_bits, inverted } = document;
        Self { read, legacy, border_bits, inverted }
    }
}

impl From<&Detection> for DetectionDocument {
    fn from(detection: &Detection) -> Self {
        let corners = || detection.corners.iter();
        Self {
            cols: detection.board.cols,
            rows: detection.board.rows,
            partial: detection.partial,
            position_known: detection.position_known,
            orientation_ambiguous: detection.orientation_ambiguous,
            blur_px: detection.blur_px,
            indices: corners().map(|corner| [corner.index.col, corner.index.row]).collect(),
            corners: corners().map(|corner| [corner.pixel.x, corner.pixel.y]).collect(),
            std_px: corners().map(|corner| corner.std_px).collect(),
            markers: detection.markers.map(BoardMarkersDocument::from),
        }
    }
}

impl TryFrom<&DetectionDocument> for Detection {
    type Error = DocumentError;
    fn try_from(document: &DetectionDocument) -> Result<Self, DocumentError> {
        let board = match document.markers {
            // One or two columns are enough where markers say which.
            Some(_) => Ok(BoardSize { cols: document.cols, rows: document.rows }),
            None => BoardSize::new(document.cols, document.rows),
        };
        let count = document.corners.len();
        if document.indices.len() != count || document.std_px.len() != count {
            return Err(DocumentError::field(
                "corners",
                "has another length than `indices` or `std_px`",
            ));
        }
        let places = document.indices.iter().zip(&document.corners);
        let corner = |((&[col, row], &[x, y]), &std_px): ((&[i32; 2], &[f64; 2]), &f64)| {
            DetectedCorner { index: GridIndex { col, row }, pixel: Pixel::new(x, y), std_px }
        };
        Ok(Self {
            board: board.map_err(|e| DocumentError::field("cols", e.to_string()))?,
            corners: places.zip(&document.std_px).map(corner).collect(),
            partial: document.partial,
            position_known: document.position_known,
            orientation_ambiguous: document.orientation_ambiguous,
            blur_px: document.blur_px,
            markers: document.markers.map(BoardMarkers::from),
        })
    }
}

#[cfg(test)]
pub(crate) mod tests {
    use super::*;
    use crate::document::reading::{from_json, to_json};

    /// A detection of a whole board whose numbers have no short decimals.
    pub(crate) fn example() -> Detection {
        let board = BoardSize::new(4, 3).unwrap();
        let corner = |i: i32| DetectedCorner {
            index: GridIndex { col: i % 4, row: i / 4 },
            pixel: Pixel::new(100.0 / 3.0 + f64::from(i).sqrt(), 200.0 / 7.0 - f64::from(i).sin()),
            std_px: 0.1 / f64::from(i + 3),
        };
        Detection {
            board,
            corners: (0..12).map(corner).collect(),
            partial: false,
            position_known: true,
            orientation_ambiguous: false,
            blur_px: 2.0 / 3.0,
            markers: None,
        }
    }

    #[test]
    fn a_detection_survives_to_the_bit() {
        let detection = example();
        let json = to_json(&DetectionDocument::from(&detection)).unwrap();
        let back: DetectionDocument = from_json(json.as_bytes()).unwrap();
        assert_eq!(Detection::try_from(&back), Ok(detection));
    }

    #[test]
    fn lists_of_different_lengths_are_refused() {
        let mut document = DetectionDocument::from(&example());
        document.std_px.pop();
        assert_eq!(Detection::try_from(&document).unwrap_err().path(), Some("corners"));
    }
}
