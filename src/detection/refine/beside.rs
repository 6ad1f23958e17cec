//! What disturbs a corner's window besides its own two edges.

use crate::detection::refine::print::BoardPrint;
use crate::detection::refine::print_blur::PrintRendering;

/// What is printed beside the corners, and how the image shows it.
#[derive(Clone, Copy)]
pub(super) struct Nearby<'a> {
    pub(super) print: &'a dyn BoardPrint,
    pub(super) rendering: PrintRendering,
}

/// What is beside a corner.
#[derive(Clone, Copy)]
pub(super) struct Beside<'a> {
    pub(super) print: Option<(usize, Nearby<'a>)>,
    /// Light of its own.
    pub(super) shaded: bool,
}
