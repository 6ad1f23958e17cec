//! What disturbs a corner's window besides its own two edges.

use crate::detection::refine::print::{BoardPrint, PrintBlur};

/// What is printed beside the corners, and how blurred it is.
#[derive(Clone, Copy)]
pub(super) struct Nearby<'a> {
    pub(super) print: &'a dyn BoardPrint,
    pub(super) blur: PrintBlur,
    /// The camera's gray values to this power are in proportion to light.
    pub(super) power: f64,
}

/// What is beside a corner.
#[derive(Clone, Copy)]
pub(super) struct Beside<'a> {
    pub(super) print: Option<(usize, Nearby<'a>)>,
    /// Light of its own.
    pub(super) shaded: bool,
}
