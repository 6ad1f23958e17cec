//! Calibration targets: a chessboard, or a board whose markers identify its corners.

use nalgebra::Point3;

use crate::geometry::board::{BoardError, BoardSize, Chessboard};
use crate::geometry::dictionary::{Dictionary, UnknownDictionary};
use crate::geometry::physical::SQUARE_M;
use crate::geometry::pose::Pose;

/// A calibration target.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Target {
    /// A plain chessboard.
    Chessboard(Chessboard),
    /// A chessboard with a marker in every white square.
    Charuco(CharucoBoard),
    /// A grid of tags with a black square in every crossing of the gaps.
    AprilGrid(AprilGrid),
}

/// OpenCV's `CharucoBoard`.
///
/// Board frame: origin at the board's outer upper left corner, x along a row, y down the columns, z
/// = x × y, away from a camera that sees the front. Corner ids count the inner corners row by row;
/// markers are numbered row by row from `first_id`.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct CharucoBoard {
    /// Squares along a row.
    pub cols: u32,
    /// Rows of squares.
    pub rows: u32,
    /// The side of a square, in meters.
    pub square_m: f64,
    /// The side of a marker with its black border, in meters.
    pub marker_m: f64,
    /// The dictionary of its markers.
    pub dictionary: Dictionary,
    /// The number of the first marker.
    pub first_id: u32,
    /// Whether the layout is that of OpenCV before 4.6, in which a board with an even number of
    /// rows starts with a white square; `None` if it is to be detected.
    pub legacy: Option<bool>,
}

/// Kalibr's grid of AprilTags.
///
/// Board frame: origin at the lower left corner of the first tag, x right, y up, z towards a camera
/// that sees the front. Tags are numbered row by row from the lower left from `first_id`; corner
/// ids are 4·tag + k, k = 0 lower left, 1 lower right, 2 upper right, 3 upper left.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct AprilGrid {
    /// Tags along a row.
    pub cols: u32,
    /// Rows of tags.
    pub rows: u32,
    /// The side of a tag with its black border, in meters.
    pub tag_m: f64,
    /// The gap between two tags as a part of a tag's side.
    pub spacing: f64,
    /// The tags' family.
    pub family: Dictionary,
    /// Cells of black around a tag's payload: 2 as in Kalibr's print, 1 as in AprilTag's own
    /// library; `None` if it is to be detected.
    pub border_bits: Option<u32>,
    /// The number of the first tag.
    pub first_id: u32,
}

/// A target that cannot be used.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum TargetError {
    /// The chessboard is not valid.
    #[error(transparent)]
    Chessboard(#[from] BoardError),
    /// Not one of the dictionaries.
    #[error(transparent)]
    Dictionary(#[from] UnknownDictionary),
    /// Too few or too many squares or tags.
    #[error("a board of {cols}x{rows} {of} cannot be used: give {least} to 50 each way")]
    Size {
        /// Along a row.
        cols: u32,
        /// Rows.
        rows: u32,
        /// What is counted.
        of: &'static str,
        /// Fewest each way.
        least: u32,
    },
    /// A length outside [`SQUARE_M`].
    #[error("`{field}` is {value:e} m: give a length of 0.01 mm to 10 m")]
    Length {
        /// Which.
        field: &'static str,
        /// What was given.
        value: f64,
    },
    /// The markers do not fit into their squares.
    #[error(
        "a marker of {marker_m} m does not fit into a square of {square_m} m: give both sides, the marker's with its black border, as they measure on the board"
    )]
    Marker {
        /// The marker's side.
        marker_m: f64,
        /// The square's side.
        square_m: f64,
    },
    /// The markers are too small in their squares.
    #[error(
        "a marker of {marker_m} m is less than a fifth of its square of {square_m} m: give both sides in meters, the marker's with its black border, as they measure on the board"
    )]
    TinyMarker {
        /// The marker's side.
        marker_m: f64,
        /// The square's side.
        square_m: f64,
    },
    /// A gap outside the range of such grids.
    #[error(
        "a spacing of {spacing} cannot be used: give the gap between two tags over a tag's side, 0.05 to 1"
    )]
    Spacing {
        /// What was given.
        spacing: f64,
    },
    /// More markers than the dictionary has.
    #[error(
        "the board's markers are {first} to {last}, but {dictionary} has 0 to {}: give another dictionary, size or first_id", count - 1
    )]
    Ids {
        /// The board's first.
        first: u64,
        /// The board's last.
        last: u64,
        /// Whose markers.
        dictionary: &'static str,
        /// How many it has.
        count: usize,
    },
    /// A border that is not supported.
    #[error(
        "a border of {bits} cells cannot be used: give 1 or 2, or leave it out to have it found"
    )]
    Border {
        /// What was given.
        bits: u32,
    },
}

fn check_length(field: &'static str, value: f64) -> Result<(), TargetError> {
    if SQUARE_M.range.contains(&value) { Ok(()) } else { Err(TargetError::Length { field, value }) }
}

fn check_ids(dictionary: &Dictionary, first: u32, count: u64) -> Result<(), TargetError> {
    let last = u64::from(first) + count.saturating_sub(1);
    if last < dictionary.count() as u64 {
        return Ok(());
    }
    let (dictionary, of) = (dictionary.name(), dictionary.count());
    Err(TargetError::Ids { first: u64::from(first), last, dictionary, count: of })
}

impl CharucoBoard {
    /// Checks that such a board is possible.
    ///
    /// # Errors
    /// [`TargetError`] states what is wrong with it.
    pub fn check(&self) -> Result<(), TargetError> {
        let Self { cols, rows, square_m, marker_m, .. } = *self;
        if !(3..=50).contains(&cols) || !(3..=50).contains(&rows) {
            return Err(TargetError::Size { cols, rows, of: "squares", least: 3 });
        }
        check_length("square_m", square_m)?;
        check_length("marker_m", marker_m)?;
        if marker_m >= square_m {
            return Err(TargetError::Marker { marker_m, square_m });
        }
        if marker_m < 0.2 * square_m {
            return Err(TargetError::TinyMarker { marker_m, square_m });
        }
        let most = [false, true].map(|legacy| self.markers(legacy).len());
        let needed = self.legacy.map_or(most[0].min(most[1]), |legacy| most[usize::from(legacy)]);
        check_ids(&self.dictionary, self.first_id, needed as u64)
    }

    /// The squares with markers, (column, row), in the order of the markers' numbers.
    pub fn markers(&self, legacy: bool) -> Vec<(u32, u32)> {
        let first_is_white = legacy && self.rows.is_multiple_of(2);
        (0..self.rows)
            .flat_map(|row| (0..self.cols).map(move |col| (col, row)))
            .filter(|(col, row)| (col + row).is_multiple_of(2) == first_is_white)
            .collect()
    }

    /// Number of inner corners.
    pub fn corner_count(&self) -> usize {
        (self.cols as usize - 1) * (self.rows as usize - 1)
    }
}

impl AprilGrid {
    /// Checks that such a grid is possible.
    ///
    /// # Errors
    /// [`TargetError`] states what is wrong with it.
    pub fn check(&self) -> Result<(), TargetError> {
        let Self { cols, rows, tag_m, spacing, .. } = *self;
        if !(1..=50).contains(&cols) || !(1..=50).contains(&rows) || cols * rows < 2 {
            return Err(TargetError::Size { cols, rows, of: "tags", least: 1 });
        }
        check_length("tag_m", tag_m)?;
        if !(0.05..=1.0).contains(&spacing) {
            return Err(TargetError::Spacing { spacing });
        }
        if let Some(bits) = self.border_bits.filter(|bits| !(1..=2).contains(bits)) {
            return Err(TargetError::Border { bits });
        }
        check_ids(&self.family, self.first_id, u64::from(cols) * u64::from(rows))
    }
}

impl Target {
    /// Its name in documents.
    pub fn kind(&self) -> &'static str {
        match self {
            Self::Chessboard(_) => "chessboard",
            Self::Charuco(_) => "charuco",
            Self::AprilGrid(_) => "aprilgrid",
        }
    }

    /// Number of corners along each of the two axes.
    pub fn corners_each_way(&self) -> [u32; 2] {
        match self {
            Self::Chessboard(board) => [board.size.cols, board.size.rows],
            Self::Charuco(board) => [board.cols - 1, board.rows - 1],
            Self::AprilGrid(grid) => [2 * grid.cols, 2 * grid.rows],
        }
    }

    /// Number of corners.
    pub fn corner_count(&self) -> usize {
        self.lattice().corner_count()
    }

    /// Its corners as columns and rows of the printed sheet, from the upper left one.
    pub fn lattice(&self) -> BoardSize {
        let [cols, rows] = self.corners_each_way();
        BoardSize { cols, rows }
    }

    /// Its name with the proportions that are visible in an image: the size of markers in their
    /// squares, or of gaps between tags.
    pub fn with_proportions(&self) -> String {
        match self {
            Self::Chessboard(_) => self.to_string(),
            Self::Charuco(board) => {
                format!("{self}, markers {:.2} of a square", board.marker_m / board.square_m)
            }
            Self::AprilGrid(grid) => format!("{self}, gaps {:.2} of a tag", grid.spacing),
        }
    }

    /// Whether no image of it determines which corner is first. Markers do determine it.
    pub fn orientation_ambiguous(&self) -> bool {
        matches!(self, Self::Chessboard(board) if board.size.orientation_ambiguous())
    }

    /// The motions that map its corners to themselves where no image determines the first one, as
    /// `board_from_board`, the identity first: only a plain chessboard has others.
    pub fn symmetries(&self) -> Vec<Pose> {
        match self {
            Self::Chessboard(board) => board.symmetries(),
            Self::Charuco(_) | Self::AprilGrid(_) => vec![Pose::identity()],
        }
    }

    /// The id of the corner in this column and row of the sheet.
    pub fn corner_id(&self, col: u32, row: u32) -> u32 {
        match self {
            Self::AprilGrid(grid) => {
                let up = 2 * grid.rows - 1 - row;
                let tag = up / 2 * grid.cols + col / 2;
                let corner = [[0, 1], [3, 2]][(up % 2) as usize][(col % 2) as usize];
                4 * (grid.first_id + tag) + corner
            }
            Self::Charuco(board) => row * (board.cols - 1) + col,
            Self::Chessboard(board) => row * board.size.cols + col,
        }
    }

    /// The position in the board frame of the corner in this column and row of the sheet, in
    /// meters; `None` outside a board with markers.
    pub fn corner_at(&self, col: i32, row: i32) -> Option<Point3<f64>> {
        if let Self::Chessboard(board) = self {
            return Some(board.corner_in_board(col, row));
        }
        let size = self.lattice();
        let (col, row) = (u32::try_from(col).ok()?, u32::try_from(row).ok()?);
        let inside = col < size.cols && row < size.rows;
        inside.then(|| self.corner_in_board(self.corner_id(col, row))).flatten()
    }

    /// A chessboard whose corners span the same area as this target's, for uses that only need a
    /// board's extent. For an AprilGrid its width is exact, and its height approximate.
    pub fn spanned_chessboard(&self) -> Chessboard {
        let size = self.lattice();
        let square_m = match self {
            Self::Chessboard(board) => board.square_m,
            Self::Charuco(board) => board.square_m,
            Self::AprilGrid(grid) => {
                let tags = f64::from(grid.cols);
                grid.tag_m * (tags + (tags - 1.0) * grid.spacing) / (2.0 * tags - 1.0)
            }
        };
        Chessboard { size, square_m }
    }

    /// The minimum and the maximum of x and y over the corners in the board frame, in meters.
    pub fn extent(&self) -> [Point3<f64>; 2] {
        let size = self.lattice();
        let first = self.corner_at(0, 0).unwrap_or_default();
        let last = self.corner_at(size.cols as i32 - 1, size.rows as i32 - 1).unwrap_or_default();
        [first.inf(&last), first.sup(&last)]
    }

    /// The position of the corner `id` in the board frame, in meters; `None` if there is no such
    /// corner.
    pub fn corner_in_board(&self, id: u32) -> Option<Point3<f64>> {
        let [across, _] = self.corners_each_way();
        match self {
            Self::Chessboard(board) => ((id as usize) < self.corner_count())
                .then(|| board.corner_in_board((id % across) as i32, (id / across) as i32)),
            Self::Charuco(board) => ((id as usize) < self.corner_count()).then(|| {
                let at = |k: u32| f64::from(k + 1) * board.square_m;
                Point3::new(at(id % across), at(id / across), 0.0)
            }),
            Self::AprilGrid(grid) => {
                let tag = (id / 4).checked_sub(grid.first_id)?;
                let (col, row) = (tag % grid.cols, tag / grid.cols);
                let (right, up) = [(0, 0), (1, 0), (1, 1), (0, 1)][id as usize % 4];
                let at = |k: u32, far: u32| {
                    grid.tag_m * (f64::from(k) * (1.0 + grid.spacing) + f64::from(far))
                };
                (row < grid.rows).then(|| Point3::new(at(col, right), at(row, up), 0.0))
            }
        }
    }
}

impl From<Chessboard> for Target {
    fn from(board: Chessboard) -> Self {
        Self::Chessboard(board)
    }
}

impl std::fmt::Display for Target {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::Chessboard(board) => write!(f, "{} chessboard", board.size),
            Self::Charuco(board) => {
                write!(
                    f,
                    "{}x{} ChArUco board ({}",
                    board.cols,
                    board.rows,
                    board.dictionary.name()
                )?;
                if board.first_id > 0 {
                    write!(f, " from {}", board.first_id)?;
                }
                if board.legacy == Some(true) {
                    write!(f, ", legacy layout")?;
                }
                write!(f, ")")
            }
            Self::AprilGrid(grid) => {
                let family = grid.family.family().unwrap_or(grid.family.name());
                write!(f, "{}x{} AprilGrid ({family}", grid.cols, grid.rows)?;
                if grid.first_id > 0 {
                    write!(f, " from {}", grid.first_id)?;
                }
                write!(f, ")")
            }
        }
    }
}

/// A chessboard with this number of inner corners and squares of this side.
///
/// # Errors
/// As [`BoardSize::new`] and [`Chessboard::new`].
pub fn chessboard(cols: u32, rows: u32, square_m: f64) -> Result<Target, TargetError> {
    Ok(Target::Chessboard(Chessboard::new(BoardSize::new(cols, rows)?, square_m)?))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn charuco() -> CharucoBoard {
        CharucoBoard {
            cols: 8,
            rows: 6,
            square_m: 0.03,
            marker_m: 0.0225,
            dictionary: Dictionary::named("DICT_4X4_50").expect("a dictionary"),
            first_id: 0,
            legacy: None,
        }
    }

    #[test]
    fn corners_lie_where_opencv_and_kalibr_have_them() {
        let board = charuco();
        assert_eq!(board.markers(false)[..2], [(1, 0), (3, 0)]);
        assert_eq!(board.markers(true)[..2], [(0, 0), (2, 0)]);
        let target = Target::Charuco(board);
        assert_eq!(target.corner_count(), 35);
        assert_eq!(target.corner_in_board(8), Some(Point3::new(0.06, 0.06, 0.0)));
        assert_eq!(target.corner_in_board(35), None);
        let grid = AprilGrid {
            cols: 6,
            rows: 5,
            tag_m: 0.1,
            spacing: 0.3,
            family: Dictionary::named("tag36h11").expect("a family"),
            border_bits: None,
            first_id: 3,
        };
        let target = Target::AprilGrid(grid);
        assert_eq!(target.corner_count(), 120);
        let corner = target.corner_in_board(4 * (3 + 7) + 2).expect("the eighth tag's");
        assert!((corner - Point3::new(0.23, 0.23, 0.0)).norm() < 1e-12);
        assert_eq!((target.corner_in_board(11), target.corner_in_board(4 * 33)), (None, None));
    }

    #[test]
    fn what_cannot_be_is_said_in_a_line() {
        let said = |change: fn(&mut CharucoBoard)| {
            let mut board = charuco();
            change(&mut board);
            board.check().map_err(|error| error.to_string()).unwrap_err()
        };
        assert_eq!(charuco().check(), Ok(()));
        assert!(said(|b| b.marker_m = 0.04).contains("does not fit into a square"));
        assert!(said(|b| b.marker_m = 1e-4).contains("less than a fifth of its square"));
        assert!(said(|b| b.first_id = 40).contains("40 to 63, but DICT_4X4_50 has 0 to 49"));
        assert!(said(|b| b.cols = 2).contains("give 3 to 50"));
        assert!(said(|b| b.square_m = f64::NAN).contains("square_m"));
    }
}
