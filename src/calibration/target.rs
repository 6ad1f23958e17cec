//! The basis of a calibration: a target of known shape, or none.

use crate::geometry::board::Chessboard;
use crate::geometry::target::Target;

/// What the camera is shown.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum CalibrationTarget {
    /// A target of known shape.
    Board(Target),
    /// No target: a static scene that the camera moves through.
    Scene,
}

impl CalibrationTarget {
    /// The target of known shape, if there is one.
    pub fn board(&self) -> Option<Target> {
        match self {
            Self::Board(target) => Some(*target),
            Self::Scene => None,
        }
    }

    /// Whether there is none.
    pub fn is_scene(&self) -> bool {
        *self == Self::Scene
    }
}

impl From<Target> for CalibrationTarget {
    fn from(target: Target) -> Self {
        Self::Board(target)
    }
}

impl From<Chessboard> for CalibrationTarget {
    fn from(board: Chessboard) -> Self {
        Self::Board(board.into())
    }
}
