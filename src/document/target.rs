//! A calibration target, as the contract writes it.

use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

use crate::calibration::target::CalibrationTarget;
use crate::document::error::DocumentError;
use crate::geometry::board::{BoardError, Chessboard};
use crate::geometry::dictionary::Dictionary;
use crate::geometry::physical::SQUARE_M;
use crate::geometry::target::{AprilGrid, CharucoBoard, Target, TargetError, chessboard};

/// What kind of target it is.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "lowercase")]
pub enum TargetKind {
    /// A plain chessboard.
    Chessboard,
    /// OpenCV's board of squares and markers.
    Charuco,
    /// Kalibr's grid of tags.
    AprilGrid,
    /// No target: a static scene that the camera moves through. It has no other field.
    Scene,
}

/// A calibration target. There is no default: count its squares and measure one.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct TargetDocument {
    /// Its kind.
    pub kind: TargetKind,
    /// Columns: inner corners of a chessboard, squares of a ChArUco board, tags of an AprilGrid.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub cols: Option<u32>,
    /// Rows of them.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub rows: Option<u32>,
    /// The side of one square of a chessboard or a ChArUco board, in meters.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub square_m: Option<f64>,
    /// The side of a ChArUco board's marker with its black border, in meters.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub marker_m: Option<f64>,
    /// The dictionary of a ChArUco board's markers, by OpenCV's name: `DICT_4X4_50`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub dictionary: Option<String>,
    /// The first marker or tag, 0 unless given.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub first_id: Option<u32>,
    /// Whether a ChArUco board has the layout of OpenCV before 4.6; detected if left out.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub legacy: Option<bool>,
    /// The side of an AprilGrid's tag with its black border, in meters.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub tag_m: Option<f64>,
    /// Gap between two tags divided by the side of a tag.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub spacing: Option<f64>,
    /// The family of an AprilGrid's tags, `tag36h11` unless given.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub family: Option<String>,
    /// Width of a tag's black border in cells, 1 or 2; detected if left out.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub border_bits: Option<u32>,
}

impl TargetDocument {
    /// One of this kind and size of which nothing else is known.
    pub(super) fn of_size(kind: TargetKind, cols: u32, rows: u32) -> Self {
        Self { cols: Some(cols), rows: Some(rows), ..Self::of_kind(kind) }
    }

    /// One of this kind of which nothing else is known.
    fn of_kind(kind: TargetKind) -> Self {
        Self {
            kind,
            cols: None,
            rows: None,
            square_m: None,
            marker_m: None,
            dictionary: None,
            first_id: None,
            legacy: None,
            tag_m: None,
            spacing: None,
            family: None,
            border_bits: None,
        }
    }

    /// The field that this kind of target does not have, if one is given.
    fn foreign_field(&self) -> Option<&'static str> {
        use TargetKind::{AprilGrid, Charuco, Chessboard};
        let boards = &[Chessboard, Charuco, AprilGrid] as &[TargetKind];
        let fields = [
            ("cols", self.cols.is_some(), boards),
            ("rows", self.rows.is_some(), boards),
            ("square_m", self.square_m.is_some(), &[Chessboard, Charuco]),
            ("marker_m", self.marker_m.is_some(), &[Charuco]),
            ("dictionary", self.dictionary.is_some(), &[Charuco]),
            ("first_id", self.first_id.is_some(), &[Charuco, AprilGrid]),
            ("legacy", self.legacy.is_some(), &[Charuco]),
            ("tag_m", self.tag_m.is_some(), &[AprilGrid]),
            ("spacing", self.spacing.is_some(), &[AprilGrid]),
            ("family", self.family.is_some(), &[AprilGrid]),
            ("border_bits", self.border_bits.is_some(), &[AprilGrid]),
        ];
        let foreign =
            |(_, given, kinds): &&(_, bool, &[TargetKind])| *given && !kinds.contains(&self.kind);
        fields.iter().find(foreign).map(|(name, ..)| *name)
    }
}

impl From<Target> for TargetDocument {
    fn from(target: Target) -> Self {
        match target {
            Target::Chessboard(Chessboard { size, square_m }) => Self {
                square_m: Some(square_m),
                ..Self::of_size(TargetKind::Chessboard, size.cols, size.rows)
            },
            Target::Charuco(board) => Self {
                square_m: Some(board.square_m),
                marker_m: Some(board.marker_m),
                dictionary: Some(board.dictionary.name().to_owned()),
                first_id: Some(board.first_id),
                legacy: board.legacy,
                ..Self::of_size(TargetKind::Charuco, board.cols, board.rows)
            },
            Target::AprilGrid(grid) => Self {
                tag_m: Some(grid.tag_m),
                spacing: Some(grid.spacing),
                family: Some(grid.family.family().unwrap_or(grid.family.name()).to_owned()),
                first_id: Some(grid.first_id),
                border_bits: grid.border_bits,
                ..Self::of_size(TargetKind::AprilGrid, grid.cols, grid.rows)
            },
        }
    }
}

impl From<Chessboard> for TargetDocument {
    fn from(board: Chessboard) -> Self {
        Target::from(board).into()
    }
}

impl TryFrom<&TargetDocument> for Target {
    type Error = DocumentError;
    fn try_from(document: &TargetDocument) -> Result<Self, DocumentError> {
        if let Some(field) = document.foreign_field() {
            let problem = "is not of this kind of target; leave it out";
            return Err(DocumentError::field(field, problem));
        }
        let size = || Ok((needed("cols", document.cols)?, needed("rows", document.rows)?));
        let first_id = document.first_id.unwrap_or(0);
        let dictionary = |field: &str, name: &str| {
            Dictionary::named(name).map_err(|error| DocumentError::field(field, error.to_string()))
        };
        let checked = match document.kind {
            TargetKind::Chessboard => {
                let (cols, rows) = size()?;
                return chessboard(cols, rows, needed("square_m", document.square_m)?)
                    .map_err(|error| in_field(&error));
            }
            TargetKind::Charuco => {
                let (cols, rows) = size()?;
                let board = CharucoBoard {
                    cols,
                    rows,
                    square_m: needed("square_m", document.square_m)?,
                    marker_m: needed("marker_m", document.marker_m)?,
                    dictionary: dictionary(
                        "dictionary",
                        needed("dictionary", document.dictionary.as_deref())?,
                    )?,
                    first_id,
                    legacy: document.legacy,
                };
                board.check().map(|()| Self::Charuco(board))
            }
            TargetKind::AprilGrid => {
                let (cols, rows) = size()?;
                let grid = AprilGrid {
                    cols,
                    rows,
                    tag_m: needed("tag_m", document.tag_m)?,
                    spacing: needed("spacing", document.spacing)?,
                    family: dictionary("family", document.family.as_deref().unwrap_or("tag36h11"))?,
                    border_bits: document.border_bits,
                    first_id,
                };
                grid.check().map(|()| Self::AprilGrid(grid))
            }
            TargetKind::Scene => {
                let problem = "is not a board; calibrate a scene with `plumb autocalibrate`, or in a session of one camera";
                return Err(DocumentError::field("kind", problem));
            }
        };
        checked.map_err(|error| in_field(&error))
    }
}

impl From<CalibrationTarget> for TargetDocument {
    fn from(target: CalibrationTarget) -> Self {
        target.board().map_or_else(|| Self::of_kind(TargetKind::Scene), Self::from)
    }
}

impl TryFrom<&TargetDocument> for CalibrationTarget {
    type Error = DocumentError;
    fn try_from(document: &TargetDocument) -> Result<Self, DocumentError> {
        match (document.kind, document.foreign_field()) {
            (TargetKind::Scene, None) => Ok(Self::Scene),
            _ => Target::try_from(document).map(Self::Board),
        }
    }
}

fn needed<T>(name: &str, value: Option<T>) -> Result<T, DocumentError> {
    value.ok_or_else(|| DocumentError::field(name, "is missing"))
}

/// The error with the field that it is about.
fn in_field(error: &TargetError) -> DocumentError {
    let field = match error {
        TargetError::Chessboard(BoardError::Size { cols, .. }) if (3..=100).contains(cols) => {
            "rows"
        }
        TargetError::Chessboard(BoardError::Square(_)) => "square_m",
        TargetError::Chessboard(_) | TargetError::Size { .. } => "cols",
        TargetError::Dictionary(_) => "dictionary",
        TargetError::Length { field, .. } => field,
        TargetError::Marker { .. } | TargetError::TinyMarker { .. } => "marker_m",
        TargetError::Spacing { .. } => "spacing",
        TargetError::Ids { .. } => "first_id",
        TargetError::Border { .. } => "border_bits",
    };
    let problem = match in_millimeters(error) {
        Some(millimeters) => format!(
            "{millimeters} m is not a plausible size of a printed target: lengths are in meters; did you mean {}?",
            (1000.0 * millimeters).round() / 1e6
        ),
        None => error.to_string(),
    };
    DocumentError::field(field, problem)
}

/// The length that was refused, where it is one if it was meant in millimeters.
fn in_millimeters(error: &TargetError) -> Option<f64> {
    let value = match error {
        TargetError::Chessboard(BoardError::Square(refused)) => refused.value,
        TargetError::Length { value, .. } => *value,
        _ => return None,
    };
    (value > *SQUARE_M.range.end() && SQUARE_M.range.contains(&(value / 1000.0))).then_some(value)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn impossible_boards_are_refused_by_field() {
        for (cols, rows, square_m, field) in [
            (2, 6, 0.03, "cols"),
            (9, 2, 0.03, "rows"),
            (9, 6, 0.0, "square_m"),
            (9, 101, 0.03, "rows"),
        ] {
            let document = TargetDocument {
                square_m: Some(square_m),
                ..TargetDocument::of_size(TargetKind::Chessboard, cols, rows)
            };
            assert_eq!(Target::try_from(&document).unwrap_err().path(), Some(field));
        }
    }

    #[test]
    fn millimeters_for_meters_are_named() {
        for (kind, field) in
            [(TargetKind::Chessboard, "square_m"), (TargetKind::AprilGrid, "tag_m")]
        {
            let document = TargetDocument {
                square_m: (kind == TargetKind::Chessboard).then_some(25.0),
                tag_m: (kind == TargetKind::AprilGrid).then_some(25.0),
                spacing: (kind == TargetKind::AprilGrid).then_some(0.3),
                ..TargetDocument::of_size(kind, 9, 6)
            };
            let refusal = Target::try_from(&document).unwrap_err();
            assert_eq!(refusal.path(), Some(field));
            assert!(refusal.to_string().ends_with("did you mean 0.025?"), "{refusal}");
        }
    }

    #[test]
    fn a_field_of_another_kind_is_refused() {
        let document = TargetDocument {
            square_m: Some(0.03),
            tag_m: Some(0.03),
            ..TargetDocument::of_size(TargetKind::Chessboard, 9, 6)
        };
        assert_eq!(Target::try_from(&document).unwrap_err().path(), Some("tag_m"));
    }
}
