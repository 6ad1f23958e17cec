//! The result of a search for a target with markers.

use crate::detection::board_detection::{BoardMarkers, DetectedCorner, Detection, GridIndex};
use crate::geometry::board::BoardSize;
use crate::geometry::pixel::Pixel;

/// A corner of a target that was found.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct LabeledCorner {
    /// Its number, as [`Target::corner_in_board`](crate::geometry::target::Target::corner_in_board)
    /// counts.
    pub id: u32,
    /// Its column and row on the sheet.
    pub index: GridIndex,
    /// Its position in the image.
    pub pixel: Pixel,
    /// Predicted standard deviation of `pixel`, per axis, in pixels.
    pub std_px: f64,
}

/// A target that was found.
#[derive(Debug, Clone, PartialEq)]
pub struct TargetDetection {
    /// The corners, by ascending id.
    pub corners: Vec<LabeledCorner>,
    /// Whether some of its corners were not found.
    pub partial: bool,
    /// What its markers show besides.
    pub markers: BoardMarkers,
    /// Width of the blur at the crossings, as a Gaussian's standard deviation in pixels.
    pub blur_px: f64,
}

impl TargetDetection {
    /// Converts it to the detection of a board, for a target with corners in this many columns and
    /// rows.
    pub fn into_detection(mut self, board: BoardSize) -> Detection {
        self.corners.sort_unstable_by_key(|corner| (corner.index.row, corner.index.col));
        let corners = self.corners.iter().map(|corner| DetectedCorner {
            index: corner.index,
            pixel: corner.pixel,
            std_px: corner.std_px,
        });
        Detection {
            board,
            corners: corners.collect(),
            partial: self.partial,
            position_known: true,
            orientation_ambiguous: false,
            blur_px: self.blur_px,
            markers: Some(self.markers),
        }
    }
}
