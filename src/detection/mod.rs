//! One luma image → a chessboard, or the reason why not. Pure; uses geometry and imaging.
//!
//! **May miss, never mislabels.** `README.md` beside this file has the table of stages, what was
//! measured, and what was tried.

mod bend;
pub mod board_detection;
pub mod board_plane;
mod candidates;
mod cross;
pub mod detector;
mod edges;
mod ends;
mod following;
mod grid;
mod growth;
mod perspective;
mod placement;
pub mod plane_growth;
mod pyramid;
mod reasons;
pub mod refine;
mod report;
mod response;
mod seeds;
pub mod tracking;
mod verification;
