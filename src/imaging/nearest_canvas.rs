//! A picture of the nearest of many depths, each of which covers a small square.

use crate::geometry::pixel::ImageSize;

/// Depths by pixel, with a border so wide that what reaches over the picture's edge needs no care.
#[derive(Debug)]
pub(crate) struct NearestCanvas {
    size: ImageSize,
    /// The side of most squares, or one more than it.
    side: usize,
    border: usize,
    stride: usize,
    /// Width and height with the border.
    reach: [f32; 2],
    depths: Vec<f32>,
}

impl NearestCanvas {
    /// For squares that reach about `half` pixels to each side.
    pub(crate) fn new(size: ImageSize, half: f32) -> Self {
        let side = ((2.0 * half) as usize + 1).clamp(1, 64);
        let border = side + 2;
        let (stride, rows) = (size.width as usize + 2 * border, size.height as usize + 2 * border);
        Self {
            size,
            side,
            border,
            stride,
            reach: [stride as f32, rows as f32],
            depths: vec![f32::INFINITY; stride * rows],
        }
    }

    /// Puts `z` wherever nothing nearer is, at the pixels whose centres lie within `half` of `center` along both axes, at least
    /// half a pixel and at most one less than the border's width. A `center` that is not a number, or beyond the border, covers nothing.
    #[inline]
    pub(crate) fn cover(&mut self, center: [f32; 2], half: f32, z: f32) {
        let border = self.border as f32;
        let half = half.max(0.5).min(border - 1.0);
        let [x, y] = center.map(|at| at + border);
        if !(x > half && y > half && x < self.reach[0] - half && y < self.reach[1] - half) {
            return;
        }
        let [left, top, right, bottom] = [x - half, y - half, x + half, y + half].map(ceil);
        let (columns, rows) = (right - left, bottom - top);
        let start = top * self.stride + left;
        // Neighbouring squares have one of two sides, in no order that a processor could foresee: to fill the larger one always,
        // with nothing in its last row or column, is faster than to choose.
        let usual = |length: usize| length == self.side || length + 1 == self.side;
        match self.side {
            2 if usual(columns) && usual(rows) => self.cover_usual::<2>(start, columns, rows, z),
            3 if usual(columns) && usual(rows) => self.cover_usual::<3>(start, columns, rows, z),
            4 if usual(columns) && usual(rows) => self.cover_usual::<4>(start, columns, rows, z),
            _ => self.cover_any(start, columns, rows, z),
        }
    }

    #[inline]
    fn cover_usual<const SIDE: usize>(&mut self, start: usize, columns: usize, rows: usize, z: f32) {
        let last_column = if columns == SIDE { z } else { f32::INFINITY };
        let last_row = if rows == SIDE { z } else { f32::INFINITY };
        let corner = if columns == SIDE { last_row } else { f32::INFINITY };
        for y in 0..SIDE {
            let Some(row) =
                self.depths.get_mut(start + y * self.stride..).and_then(|rest| rest.first_chunk_mut::<SIDE>())
            else {
                return;
            };
            let (z, end) = if y + 1 < SIDE { (z, last_column) } else { (last_row, corner) };
            for (x, held) in row.iter_mut().enumerate() {
                let z = if x + 1 < SIDE { z } else { end };
                *held = if z < *held { z } else { *held };
            }
        }
    }

    fn cover_any(&mut self, start: usize, columns: usize, rows: usize, z: f32) {
        for y in 0..rows {
            let start = start + y * self.stride;
            for held in self.depths.get_mut(start..start + columns).unwrap_or_default() {
                *held = if z < *held { z } else { *held };
            }
        }
    }

    /// Pixel by pixel of the picture; 0 for none.
    pub(crate) fn into_depths(self) -> Vec<f32> {
        let (width, height) = (self.size.width as usize, self.size.height as usize);
        let mut inside = Vec::with_capacity(width * height);
        for row in self.depths.chunks_exact(self.stride).skip(self.border).take(height) {
            let row = row.get(self.border..self.border + width).unwrap_or_default();
            inside.extend(row.iter().map(|depth| if *depth < f32::INFINITY { *depth } else { 0.0 }));
        }
        inside
    }
}

/// The least whole number that is not less than a `value` from 0 to 2²², to within rounding of the value: `f32::ceil` is a call
/// into the C library on processors without SSE 4.1, and added to 2²³ a value has no binary places left.
#[inline]
fn ceil(value: f32) -> usize {
    const BINARY_PLACES: u32 = 23;
    const MAGNITUDE: f32 = (1 << BINARY_PLACES) as f32;
    const NEARLY_HALF: f32 = 0.499_999_97;
    (((value + NEARLY_HALF) + MAGNITUDE).to_bits() & ((1 << BINARY_PLACES) - 1)) as usize
}

#[cfg(test)]
mod tests {
    use super::*;

    const SIZE: ImageSize = ImageSize::new(9, 7);

    /// The picture by its definition.
    fn expected(squares: &[([f32; 2], f32, f32)]) -> Vec<f32> {
        let nearest = |k: u32| {
            let (x, y) = ((k % SIZE.width) as f32, (k / SIZE.width) as f32);
            let covers = |from: f32, half: f32, at: f32| at >= from - half && at < from + half;
            let here = squares.iter().filter(|(at, half, _)| covers(at[0], *half, x) && covers(at[1], *half, y));
            here.map(|(_, _, z)| *z).reduce(f32::min).unwrap_or(0.0)
        };
        (0..SIZE.width * SIZE.height).map(nearest).collect()
    }

    #[test]
    fn each_square_covers_the_pixels_whose_centres_it_holds() {
        for half in [0.5, 0.8, 1.0, 1.3, 1.9, 2.6] {
            let mut squares = Vec::new();
            let mut canvas = NearestCanvas::new(SIZE, half);
            for k in 0..60_u16 {
                let k = f32::from(k);
                let own = half * if k % 7.0 == 0.0 { 1.2 } else { 1.0 };
                squares.push(([k * 3.7 % 13.0 - 2.03, k * 2.3 % 11.0 - 2.03], own, 1.0 + k * 0.61 % 3.0));
            }
            for (center, half, z) in &squares {
                canvas.cover(*center, *half, *z);
            }
            assert_eq!(canvas.into_depths(), expected(&squares), "half {half}");
        }
    }

    #[test]
    fn what_lies_outside_covers_nothing() {
        let mut canvas = NearestCanvas::new(SIZE, 1.0);
        for far in [f32::NAN, f32::INFINITY, f32::NEG_INFINITY, 1e9, -1e9, 40.0, -40.0] {
            canvas.cover([far, 3.0], 1.0, 1.0);
            canvas.cover([3.0, far], 1.0, 1.0);
        }
        assert_eq!(canvas.into_depths(), [0.0; 63]);
    }
}
