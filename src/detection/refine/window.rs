//! The window of pixels that a corner is fitted to.

use crate::detection::refine::corner_model::length;

/// Variance of a square pixel's own width.
pub(super) const PIXEL_VARIANCE: f64 = 1.0 / 12.0;

// Chosen while refinement was built, and not swept.

/// Standard deviations of an edge's blur that a window ends short of the next edge.
const SHORT_STDS: f64 = 2.3;
/// But a window reaches this part of the way to the next edge at least, and at most.
const PART_OF_WAY: [f64; 2] = [0.45, 0.85];
/// From these standard deviations of an edge on, in pixels, four and two pixels a side make one
/// sample: an edge's standard deviation is then 0.75 samples at least.
const FOUR_PIXELS_STD_PX: f64 = 3.0;
const TWO_PIXELS_STD_PX: f64 = 1.5;
/// A window ends at its largest reach, or at this many standard deviations of an edge if that is
/// farther.
const REACH_STDS: f64 = 3.0;
/// Half the width of the strip along an edge that determines it, in its standard deviations, and in
/// pixels in addition.
const STRIP_STDS: f64 = 2.7;
const STRIP_PX: f64 = 0.3;

/// Where to gather samples.
#[derive(Debug, Clone, Copy)]
pub(super) struct Window {
    /// The window's origin, in image pixels.
    pub origin: [f64; 2],
    /// From the corner to its neighbors along the two edges, in image pixels.
    pub axes: [[f64; 2]; 2],
    /// Half the window's extent along each axis, as a fraction of the axis.
    pub extent: [f64; 2],
    /// Only pixels within this distance of one of the axes, in image pixels.
    pub strip_px: f64,
    /// Side of the squares of image pixels that are averaged into one sample: 1, 2 or 4.
    pub bin: usize,
}

impl Window {
    /// A window that ends short of the next edges, which lie at the fraction `free` of the axes. It
    /// reaches at most `reach` samples along each axis; the bins match the resolution that the blur
    /// leaves.
    pub fn new(origin: [f64; 2], axes: [[f64; 2]; 2], blur_px: f64, reach: f64, free: f64) -> Self {
        let sigma = sigma_px(blur_px);
        let area = (axes[0][0] * axes[1][1] - axes[0][1] * axes[1][0]).abs();
        let lengths = axes.map(length);
        // The distance from the corner to the next edge that runs along the other axis.
        let room = [area / lengths[1], area / lengths[0]];
        let [least, most] = PART_OF_WAY;
        let fraction =
            room.map(|room| free * (1.0 - SHORT_STDS * sigma / (free * room)).clamp(least, most));
        let wanted = f64::max(fraction[0] * lengths[0], fraction[1] * lengths[1]);
        let bin = match sigma {
            s if s > FOUR_PIXELS_STD_PX && wanted > 2.0 * reach => 4,
            s if s > TWO_PIXELS_STD_PX && wanted > reach => 2,
            _ => 1,
        };
        let most = lengths.map(|cell| f64::max(reach * bin as f64, REACH_STDS * sigma) / cell);
        let extent = [fraction[0].min(most[0]), fraction[1].min(most[1])];
        Self { origin, axes, extent, strip_px: f64::INFINITY, bin }
    }

    /// The same window in bins `times` as large, but no larger than can be gathered.
    pub fn coarsened(self, times: usize) -> Self {
        Self { bin: (times * self.bin).min(4), ..self }
    }

    /// The same window along edges whose directions are now known, without the pixels far from both
    /// edges: these determine black and white, which are known well enough, but not the edges.
    pub fn along_edges(self, along: [[f64; 2]; 2], blur_px: f64) -> Self {
        let axes = [0, 1].map(|k| along[k].map(|v| v * length(self.axes[k])));
        Self { axes, strip_px: STRIP_STDS * sigma_px(blur_px) + STRIP_PX, ..self }
    }
}

/// Standard deviation across an edge, including the pixel's own width.
fn sigma_px(blur_px: f64) -> f64 {
    (blur_px * blur_px + PIXEL_VARIANCE).sqrt()
}
