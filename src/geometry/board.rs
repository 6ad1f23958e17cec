//! The chessboard: its number of inner corners, the size of its squares, and the corners' positions
//! in the board frame.

use nalgebra::{Point3, Vector3};

use crate::geometry::physical::{SQUARE_M, Unphysical};
use crate::geometry::pose::Pose;

/// The number of inner corners of a chessboard: `cols` along a row, `rows` rows. Each is at least
/// 3.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub struct BoardSize {
    /// Inner corners along a row.
    pub cols: u32,
    /// Rows of inner corners.
    pub rows: u32,
}

/// A board that cannot be used for calibration.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum BoardError {
    /// Not of the form `9x6`.
    #[error(
        "board `{text}` is not COLSxROWS: give the inner corners of a row, an x, and the number of rows, as in 9x6"
    )]
    Malformed {
        /// What was given.
        text: String,
    },
    /// Fewer than 3 or more than 100 corners in a direction.
    #[error(
        "a board of {cols}x{rows} inner corners cannot be used: each side needs 3 to 100 (count the inner corners, where four squares meet, not the squares)"
    )]
    Size {
        /// Inner corners along a row.
        cols: u32,
        /// Rows of inner corners.
        rows: u32,
    },
    /// A square whose side is outside [`SQUARE_M`].
    #[error("{0}; give the side of one square with its unit, as in 25mm")]
    Square(Unphysical),
}

impl BoardSize {
    /// A board of `cols` × `rows` inner corners.
    ///
    /// # Errors
    /// [`BoardError::Size`] unless each is 3 to 100.
    pub fn new(cols: u32, rows: u32) -> Result<Self, BoardError> {
        let fits = |n: u32| (3..=100).contains(&n);
        if fits(cols) && fits(rows) {
            Ok(Self { cols, rows })
        } else {
            Err(BoardError::Size { cols, rows })
        }
    }

    /// Number of inner corners.
    pub fn corner_count(self) -> usize {
        self.cols as usize * self.rows as usize
    }

    /// Whether the pattern maps to itself under a half turn, so that no image determines which
    /// corner is first: `cols` + `rows` is even.
    pub fn orientation_ambiguous(self) -> bool {
        (self.cols + self.rows).is_multiple_of(2)
    }
}

impl std::str::FromStr for BoardSize {
    type Err = BoardError;
    fn from_str(text: &str) -> Result<Self, BoardError> {
        let malformed = || BoardError::Malformed { text: text.to_owned() };
        let (cols, rows) = text.split_once(['x', 'X', '×']).ok_or_else(malformed)?;
        let number = |s: &str| s.trim().parse().map_err(|_| malformed());
        Self::new(number(cols)?, number(rows)?)
    }
}

impl std::fmt::Display for BoardSize {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "{}x{}", self.cols, self.rows)
    }
}

/// A chessboard with its physical size.
///
/// Board frame: origin at the first inner corner, x along a row, y along the columns, z = x × y,
/// which points away from a camera that sees the front.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Chessboard {
    /// Its inner corners.
    pub size: BoardSize,
    /// The side of one square, in meters.
    pub square_m: f64,
}

impl Chessboard {
    /// A board of `size` with squares of `square_m` meters.
    ///
    /// # Errors
    /// [`BoardError::Square`] for a side outside [`SQUARE_M`].
    pub fn new(size: BoardSize, square_m: f64) -> Result<Self, BoardError> {
        let square_m = SQUARE_M.check(square_m).map_err(BoardError::Square)?;
        Ok(Self { size, square_m })
    }

    /// The corner (`col`, `row`) in the board frame, in meters. Indices outside the board are
    /// allowed: the outer border of the squares is at −1 and `cols`.
    pub fn corner_in_board(&self, col: i32, row: i32) -> Point3<f64> {
        Point3::new(f64::from(col) * self.square_m, f64::from(row) * self.square_m, 0.0)
    }

    /// The motions that map the board's lattice of corners to itself where no image determines the
    /// first corner, as `board_from_board`: the identity first, then the half turn, and the
    /// quarter turns of a square board. With an odd number of corners a side, quarter turns
    /// exchange dark and light squares.
    pub fn symmetries(&self) -> Vec<Pose> {
        if !self.size.orientation_ambiguous() {
            return vec![Pose::identity()];
        }
        let far = self.corner_in_board(self.size.cols as i32 - 1, self.size.rows as i32 - 1);
        let quarter = |quarters: i32, translation: Vector3<f64>| {
            Pose::from_axis_angle(
                Vector3::z() * (f64::from(quarters) * std::f64::consts::FRAC_PI_2),
                translation,
            )
        };
        let mut symmetries = vec![Pose::identity(), quarter(2, far.coords)];
        if self.size.cols == self.size.rows {
            symmetries.push(quarter(1, Vector3::new(far.x, 0.0, 0.0)));
            symmetries.push(quarter(3, Vector3::new(0.0, far.y, 0.0)));
        }
        symmetries
    }

    /// All corners in row-major order, in meters in the board frame.
    pub fn corners_in_board(&self) -> Vec<Point3<f64>> {
        (0..self.size.rows as i32)
            .flat_map(|row| (0..self.size.cols as i32).map(move |col| (col, row)))
            .map(|(col, row)| self.corner_in_board(col, row))
            .collect()
    }
}
