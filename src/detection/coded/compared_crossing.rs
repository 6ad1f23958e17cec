//! A crossing compared with its prediction by the others of its lattice.

use crate::detection::vec2::Vec2;

/// A crossing, and its distance from where the others predict it.
#[derive(Debug, Clone, Copy)]
pub(super) struct ComparedCrossing {
    pub(super) at: (i32, i32),
    /// That distance, in narrow intervals; scaled up for a suspect crossing.
    pub(super) off: f32,
    /// The larger component of its offset along the image's axes, in pixels, not scaled.
    pub(super) off_px: f32,
    /// One unit of the lattice along each axis.
    pub(super) steps: Option<[Vec2; 2]>,
    /// The number of lines within which other crossings affect the prediction.
    pub(super) reach: i32,
    /// Whether none of these crossings was dropped since.
    pub(super) is_current: bool,
}

impl ComparedCrossing {
    /// Nothing known yet.
    pub(super) fn unknown(at: (i32, i32)) -> Self {
        Self { at, off: 0.0, off_px: 0.0, steps: None, reach: 0, is_current: false }
    }
}
