//! The rays of the corners of a sensor's pixels: one table for each lens, computed once.

use nalgebra::Vector3;

use crate::geometry::lens::Lens;
use crate::geometry::pixel::{ImageSize, Pixel};

/// Sub-pixels along a side of a pixel. Light is integrated exactly over each, and then taken to be
/// at its middle: with four, the error of an edge's position is about 0.0005 px.
pub(super) const SUBPIXELS: usize = 4;

/// The rays through the corners of all pixels of an image and of `pad` pixels around it.
///
/// Inside a pixel, rays are interpolated bilinearly: with the strongest distortion, the error is
/// some 1e-4 px.
#[derive(Debug, Clone)]
pub(super) struct RayTable {
    /// Pixels along x, the pad included.
    pub columns: usize,
    /// Pixels along y, the pad included.
    pub rows: usize,
    /// Pixels around the image whose light reaches it through the blur.
    pub pad: usize,
    /// (columns + 1) · (rows + 1) unit directions; NaN where the lens has no ray.
    nodes: Vec<Vector3<f64>>,
}

impl RayTable {
    pub(super) fn new(lens: &Lens, size: ImageSize, pad: usize) -> Self {
        let columns = size.width as usize + 2 * pad;
        let rows = size.height as usize + 2 * pad;
        let nothing = Vector3::repeat(f64::NAN);
        let position = |node: usize| node as f64 - pad as f64 - 0.5;
        let nodes = (0..=rows)
            .flat_map(|j| (0..=columns).map(move |i| Pixel::new(position(i), position(j))))
            .map(|pixel| lens.bearing_from_pixel(pixel).map_or(nothing, nalgebra::Unit::into_inner))
            .collect();
        Self { columns, rows, pad, nodes }
    }

    /// The rays through the upper corners of pixel row `row`; row `rows` has the lower corners of
    /// the last pixel row.
    pub(super) fn node_row(&self, row: usize) -> &[Vector3<f64>] {
        let width = self.columns + 1;
        &self.nodes[row * width..(row + 1) * width]
    }

    /// The ray at (`s`, `t`), each 0 to 1, inside the padded pixel (`x`, `y`).
    pub(super) fn ray_inside(&self, [x, y]: [usize; 2], [s, t]: [f64; 2]) -> Vector3<f64> {
        let (upper, lower) = (self.node_row(y), self.node_row(y + 1));
        upper[x].lerp(&upper[x + 1], s).lerp(&lower[x].lerp(&lower[x + 1], s), t)
    }
}
