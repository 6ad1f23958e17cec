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
    /// It fits worse than the others: under light of its own, or beside an occluder.
    pub(super) shaded: bool,
    /// Under which light it may be fitted besides the board's.
    pub(super) light: Option<LightOfItsOwn>,
}

/// What makes a fit with light of a corner's own believed.
#[derive(Debug, Clone, Copy)]
pub(super) struct LightOfItsOwn {
    /// The power of the board's gray values that is in proportion to light.
    pub(super) power: f64,
    /// It must leave less than this part of the mean square that the fit without it leaves.
    pub(super) most_left: f64,
}
