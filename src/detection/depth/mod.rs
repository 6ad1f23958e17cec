//! The board's plane in a depth image: the part of detection that reads distances instead of light.
//!
//! [`board_plane`] measures the surface inside the board's outline; [`plane_growth`] extends it
//! over the plate, table or wall that the board lies on.

pub mod board_plane;
pub mod plane_growth;
