//! What affects a corner's window besides its own two edges.

use crate::detection::refine::print::BoardPrint;
use crate::detection::refine::print_blur::PrintRendering;

/// The print around the corners, and its rendering.
#[derive(Clone, Copy)]
pub(super) struct NearbyPrint<'a> {
    pub(super) print: &'a dyn BoardPrint,
    pub(super) rendering: PrintRendering,
}

/// What affects one corner's window.
#[derive(Clone, Copy)]
pub(super) struct WindowContext<'a> {
    pub(super) print: Option<(usize, NearbyPrint<'a>)>,
    /// It fits worse than the others: it may be under light of its own, or next to an occluder.
    pub(super) shaded: bool,
    /// If set, a fit with light of its own is tried too.
    pub(super) light: Option<LocalLightCriterion>,
}

/// When a fit with light of the corner's own is accepted.
#[derive(Debug, Clone, Copy)]
pub(super) struct LocalLightCriterion {
    /// The board's gray values to this power are proportional to light.
    pub(super) power: f64,
    /// Its mean square must be less than this fraction of that of the fit without it.
    pub(super) most_left: f64,
}
