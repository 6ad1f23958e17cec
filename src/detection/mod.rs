//! One luma image → a chessboard, or the reason why not. Pure; uses geometry and imaging.
//!
//! **May miss, never mislabels.**

pub mod board_detection;
pub mod refine;
