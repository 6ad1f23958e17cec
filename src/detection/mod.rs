#![doc = include_str!("README.md")]
//!
//! # Interface
//!
//! Pure; uses geometry and imaging. [`detect`] searches one image for a chessboard; a [`Detector`]
//! reuses its buffers from image to image, and tracks the board ([`tracking`]).

pub mod board_detection;
pub mod coded;
pub mod depth;
pub mod detector;
pub mod finder;
mod grid;
mod measure;
mod reasons;
pub mod refine;
mod report;
mod search;
#[cfg(test)]
mod stage_drawings;
pub mod stated_board;
pub mod target_in_view;
pub mod thresholds;
pub mod tracking;
mod vec2;
mod verify;

pub use crate::detection::depth::{board_plane, plane_growth};

use crate::detection::board_detection::{DetectOptions, Detection, NoBoard};
use crate::detection::detector::Detector;
use crate::geometry::board::BoardSize;
use crate::imaging::gray::GrayView;

/// Finds the whole of `board` in one luma image: every inner corner in pixels, with its standard
/// deviation. For partial boards, or many images, keep a [`Detector`].
///
/// # Errors
/// [`NoBoard`], with the reason why no board is reported.
pub fn detect(image: GrayView<'_>, board: BoardSize) -> Result<Detection, NoBoard> {
    Detector::new(board).find_board(image, &DetectOptions::default())
}
