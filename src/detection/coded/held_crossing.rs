//! What is known of a crossing from the others of its lattice.

use crate::detection::measure::cross::Vec2;

/// A crossing held against where the others put it.
#[derive(Debug, Clone, Copy)]
pub(super) struct HeldCrossing {
    pub(super) at: (i32, i32),
    /// How far off it is, in narrow intervals, more of a suspect one.
    pub(super) off: f32,
    /// The same in pixels, along each axis of the image.
    pub(super) off_px: f32,
    /// One unit of the lattice along each axis.
    pub(super) steps: Option<[Vec2; 2]>,
    /// Within how many lines the others decide on all this.
    pub(super) reach: i32,
    /// None of these was dropped since.
    pub(super) is_current: bool,
}

impl HeldCrossing {
    /// Nothing known yet.
    pub(super) fn unknown(at: (i32, i32)) -> Self {
        Self { at, off: 0.0, off_px: 0.0, steps: None, reach: 0, is_current: false }
    }
}
