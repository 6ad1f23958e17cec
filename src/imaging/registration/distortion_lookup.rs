//! A lens as a table: where it maps normalized coordinates, at a small part of the cost of its
//! formula.

use nalgebra::{Point3, Vector2};

use crate::geometry::lens::Lens;
use crate::geometry::pixel::{ImageSize, Pixel};

/// Pixels by normalized coordinates (x/z, y/z), bilinear between the nodes of a grid: within a
/// hundredth of a pixel of the lens's own for lenses of up to 100°.
#[derive(Debug, Clone)]
pub(super) struct DistortionLookup {
    low: [f32; 2],
    per_unit: [f32; 2],
    /// Of each cell, for x and y of the pixel: at its first corner, what is added along each side,
    /// and by both together.
    cells: Vec<[[f32; 4]; 2]>,
}

/// Cells along each side.
const CELLS: usize = 159;
/// The least place in cells that [`cell`] splits; what is before it is beyond the image.
const LEAST_CELL: f32 = 0.25;

impl DistortionLookup {
    /// Over what the lens sees of an image of `size`, and a little more.
    pub(crate) fn new(lens: &Lens, size: ImageSize) -> Self {
        let [low, high] = seen(lens, size);
        let node = |column: usize, row: usize| {
            let at = |low: f64, high: f64, index: usize| {
                low + (high - low) * index as f64 / CELLS as f64
            };
            let pixel = lens.pixel_from_point(&Point3::new(
                at(low.x, high.x, column),
                at(low.y, high.y, row),
                1.0,
            ));
            pixel.map_or([f64::NAN; 2], |pixel| [pixel.x, pixel.y])
        };
        let cell = |k: usize| {
            let (column, row) = (k % CELLS, k / CELLS);
            let (a, b) = (node(column, row), node(column + 1, row));
            let (c, d) = (node(column, row + 1), node(column + 1, row + 1));
            [0, 1].map(|k| {
                [a[k], b[k] - a[k], c[k] - a[k], a[k] - b[k] - c[k] + d[k]]
                    .map(|number| number as f32)
            })
        };
        let per_unit = |low: f64, high: f64| (CELLS as f64 / (high - low)) as f32;
        Self {
            low: [low.x as f32, low.y as f32],
            per_unit: [per_unit(low.x, high.x), per_unit(low.y, high.y)],
            cells: (0..CELLS * CELLS).map(cell).collect(),
        }
    }

    /// The pixel at normalized coordinates; NaN outside.
    #[inline]
    pub(crate) fn pixel(&self, x: f32, y: f32) -> [f32; 2] {
        let (u, v) = ((x - self.low[0]) * self.per_unit[0], (y - self.low[1]) * self.per_unit[1]);
        const END_CELL: f32 = CELLS as f32;
        if !(u >= LEAST_CELL && v >= LEAST_CELL && u < END_CELL && v < END_CELL) {
            return [f32::NAN; 2];
        }
        let ((column, s), (row, t)) = (cell(u), cell(v));
        let Some([across, down]) = self.cells.get(row * CELLS + column) else {
            return [f32::NAN; 2];
        };
        let at = |c: &[f32; 4]| c[0] + s * c[1] + t * (c[2] + s * c[3]);
        [at(across), at(down)]
    }
}

/// The whole part of a `value` from [`LEAST_CELL`] to 2²² and the rest of it; at a whole number
/// either the one before it and 1, or itself and 0. Half less than the value, added to 2²³, is
/// rounded to a whole number, which costs less than a conversion that minds what does not fit.
#[inline]
fn cell(value: f32) -> (usize, f32) {
    const BINARY_PLACES: u32 = 23;
    const MAGNITUDE: f32 = (1 << BINARY_PLACES) as f32;
    let whole = (value - 0.5) + MAGNITUDE;
    ((whole.to_bits() & ((1 << BINARY_PLACES) - 1)) as usize, value - (whole - MAGNITUDE))
}

/// The least and the greatest normalized coordinates of an image's border, and a little beyond
/// them.
pub(super) fn seen(lens: &Lens, size: ImageSize) -> [Vector2<f64>; 2] {
    let (mut low, mut high) = (Vector2::repeat(f64::INFINITY), Vector2::repeat(f64::NEG_INFINITY));
    for k in 0..=64 {
        let part = f64::from(k) / 64.0;
        let (x, y) = (part * f64::from(size.width) - 0.5, part * f64::from(size.height) - 0.5);
        let (right, bottom) = (f64::from(size.width) - 0.5, f64::from(size.height) - 0.5);
        for pixel in
            [Pixel::new(x, -0.5), Pixel::new(x, bottom), Pixel::new(-0.5, y), Pixel::new(right, y)]
        {
            if let Some(bearing) = lens.bearing_from_pixel(pixel).filter(|b| b.z > 0.05) {
                let at = Vector2::new(bearing.x / bearing.z, bearing.y / bearing.z);
                (low, high) = (low.inf(&at), high.sup(&at));
            }
        }
    }
    if !(low.x < high.x && low.y < high.y) {
        return [Vector2::repeat(-1.0), Vector2::repeat(1.0)];
    }
    let margin = (high - low) * 0.05;
    [low - margin, high + margin]
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::lens::LensModel;

    #[test]
    fn places_are_split_from_the_least_one_on() {
        for (value, expected) in [
            (LEAST_CELL, (0, LEAST_CELL)),
            (0.75, (0, 0.75)),
            (1.25, (1, 0.25)),
            (158.5, (158, 0.5)),
            (4_194_303.5, (4_194_303, 0.5)),
        ] {
            assert_eq!(cell(value), expected, "{value}");
        }
        // Half less than it, added to 2²³, is below that: the bits are no index.
        assert!(cell(0.24).0 > CELLS);
    }

    #[test]
    fn the_lookup_is_the_lens() {
        let lens = Lens::from_parameters(
            LensModel::Brown,
            &[110.0, 110.0, 63.0, 47.0, 0.0, -0.05, 0.01, 0.0, 0.0, 0.0],
        )
        .unwrap();
        let lookup = DistortionLookup::new(&lens, ImageSize::new(128, 96));
        for k in 0..500 {
            let pixel = Pixel::new(f64::from(k % 25) * 5.0, f64::from(k / 25) * 4.7);
            let bearing = lens.bearing_from_pixel(pixel).unwrap();
            let [x, y] =
                lookup.pixel((bearing.x / bearing.z) as f32, (bearing.y / bearing.z) as f32);
            assert!(
                pixel.distance_px(Pixel::new(f64::from(x), f64::from(y))) < 0.01,
                "{pixel:?} {x} {y}"
            );
        }
        for outside in
            [[-9.0, 0.0], [0.0, 9.0], [f32::NAN, 0.0], [f32::INFINITY, f32::NEG_INFINITY]]
        {
            assert!(lookup.pixel(outside[0], outside[1])[0].is_nan(), "{outside:?}");
        }
    }
}
