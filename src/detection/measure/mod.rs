//! Measurements of one corner or one edge in the image, shared by search, verification and
//! tracking.

pub(in crate::detection) mod cross;
pub(in crate::detection) mod edges;
pub(in crate::detection) mod prediction;

use crate::detection::thresholds::Thresholds;
use crate::imaging::gray::GrayView;

/// An image, with the thresholds for measurements in it.
#[derive(Debug, Clone, Copy)]
pub(in crate::detection) struct Probe<'a> {
    /// The image, or a level of it.
    pub image: GrayView<'a>,
    /// The thresholds.
    pub thresholds: &'a Thresholds,
}

impl<'a> Probe<'a> {
    /// The same thresholds in another level of the image.
    pub(in crate::detection) fn at(self, image: GrayView<'a>) -> Self {
        Self { image, ..self }
    }
}
