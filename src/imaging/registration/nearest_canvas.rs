//! An image of the nearest of many depths, each of which covers a small square.
//!
//! Neighboring squares have one of two sides, n and n − 1 pixels, according to where their centers
//! fall. So each is put down as a single pixel, its first, in one of four planes, by its columns
//! and rows; what all of them cover is then the least value within those reaches, computed once for
//! the whole image.

use crate::geometry::pixel::ImageSize;

/// A depth as a canvas holds it.
pub(crate) trait HeldDepth: Copy + PartialOrd {
    /// What is held where there is none: beyond every other.
    const NONE: Self;

    /// A depth in meters; beyond every other where it is none, or does not fit.
    fn held(depth_m: f32, per_unit: f32) -> Self;

    /// Whether a depth that there is can be held.
    fn fits(depth_m: f32, per_unit: f32) -> bool;

    /// What stands for it in images: 0 for none.
    fn shown(self) -> Self;

    /// The nearer of two.
    #[inline(always)]
    fn nearer(self, other: Self) -> Self {
        if other < self { other } else { self }
    }
}

/// In meters.
impl HeldDepth for f32 {
    const NONE: Self = f32::INFINITY;

    #[inline(always)]
    fn held(depth_m: f32, _: f32) -> Self {
        if depth_m > 0.0 { depth_m } else { Self::NONE }
    }

    #[inline(always)]
    fn fits(_: f32, _: f32) -> bool {
        true
    }

    #[inline(always)]
    fn shown(self) -> Self {
        if self < f32::INFINITY { self } else { 0.0 }
    }
}

/// One more than the largest reading of 16 bits.
const TOO_MANY_UNITS: f32 = 65536.0;

/// In whole units, less one: so that none, 0 units, is beyond every other.
impl HeldDepth for u16 {
    const NONE: Self = u16::MAX;

    #[inline(always)]
    fn held(depth_m: f32, per_unit: f32) -> Self {
        let units = (depth_m * per_unit).clamp(0.0, TOO_MANY_UNITS);
        (whole(units) as u16).wrapping_sub(1)
    }

    #[inline(always)]
    fn fits(depth_m: f32, per_unit: f32) -> bool {
        depth_m * per_unit < TOO_MANY_UNITS - 0.5
    }

    #[inline(always)]
    fn shown(self) -> Self {
        self.wrapping_add(1)
    }
}

/// Depths by pixel, with a border so wide that what reaches over the image's edge needs no care.
#[derive(Debug)]
pub(crate) struct NearestCanvas<T> {
    size: ImageSize,
    /// n: the side of most squares, or one more than it; at least 2.
    side: usize,
    border: usize,
    stride: usize,
    rows: usize,
    /// First pixels of squares of n − 1 columns and rows; of n columns; of n rows; of n both.
    planes: Vec<T>,
    /// Squares of other sides, pixel by pixel; empty before there are any.
    others: Vec<T>,
}

/// Squares of a row, kept from row to row.
#[derive(Debug, Default)]
pub(crate) struct SquareRow {
    /// The centers along x and y.
    pub(crate) center: [Vec<f32>; 2],
    /// How far they reach to each side.
    pub(crate) half: Vec<f32>,
    /// The depths in meters; 0 for none.
    pub(crate) depth: Vec<f32>,
    first: Vec<u32>,
}

impl SquareRow {
    /// Of `length` squares.
    pub(crate) fn new(length: usize) -> Self {
        let zeros = || vec![0.0; length];
        Self { center: [zeros(), zeros()], half: zeros(), depth: zeros(), first: vec![0; length] }
    }
}

/// Stands for the place of a square of another side than most.
const OTHER: u32 = u32::MAX;

impl<T: HeldDepth> NearestCanvas<T> {
    /// For squares that reach about `half` pixels to each side.
    pub(crate) fn new(size: ImageSize, half: f32) -> Self {
        let side = ((2.0 * half) as usize + 1).clamp(2, 64);
        let border = side + 2;
        let (stride, rows) = (size.width as usize + 2 * border, size.height as usize + 2 * border);
        Self {
            size,
            side,
            border,
            stride,
            rows,
            planes: vec![T::NONE; 4 * stride * rows],
            others: Vec::new(),
        }
    }

    /// Puts the depth of each square wherever nothing nearer is, at the pixels whose centers lie
    /// within its `half` of its `center` along both axes, at least half a pixel and at most one
    /// less than the border's width. A `center` that is not a number, or beyond the border, covers
    /// nothing.
    #[inline(always)]
    pub(crate) fn cover(&mut self, row: &mut SquareRow, per_unit: f32) {
        self.place(row);
        let squares = row.first.iter().zip(&row.depth);
        for (k, (first, depth)) in squares.enumerate() {
            let held = T::held(*depth, per_unit);
            match self.planes.get_mut(*first as usize) {
                Some(nearest) => *nearest = nearest.nearer(held),
                None => self.cover_other(row, k, held),
            }
        }
    }

    /// Finds in which plane each square of a row is put down, and where: nowhere is the first pixel
    /// of all, in the border.
    #[inline(always)]
    fn place(&self, row: &mut SquareRow) {
        let SquareRow { center: [x, y], half, depth, first } = row;
        let (border, side, stride) = (self.border as f32, self.side as u32, self.stride as u32);
        let (across, down) = (self.stride as f32, self.rows as f32);
        let plane = stride * self.rows as u32;
        let squares = x.iter().zip(y.iter()).zip(half.iter()).zip(depth.iter_mut());
        for ((((x, y), half), depth), first) in squares.zip(first) {
            let half = half.max(0.5).min(border - 1.0);
            let (x, y) = (x + border, y + border);
            let inside =
                (x > half) & (y > half) & (x < across - half) & (y < down - half) & (*depth > 0.0);
            let [left, top, right, bottom] = [x - half, y - half, x + half, y + half].map(ceil);
            let (columns, rows) = (right.wrapping_sub(left), bottom.wrapping_sub(top));
            let (wide, high) = (columns == side, rows == side);
            let common = (wide | (columns + 1 == side)) & (high | (rows + 1 == side));
            let of = u32::from(wide) * plane + u32::from(high) * 2 * plane;
            let place = if common {
                top.wrapping_mul(stride).wrapping_add(left).wrapping_add(of)
            } else {
                OTHER
            };
            *first = if inside { place } else { 0 };
            *depth = if inside { *depth } else { 0.0 };
        }
    }

    #[cold]
    fn cover_other(&mut self, row: &SquareRow, square: usize, held: T) {
        self.others.resize(self.stride * self.rows, T::NONE);
        let border = self.border as f32;
        let Some(half) = row.half.get(square).map(|half| half.max(0.5).min(border - 1.0)) else {
            return;
        };
        let [(left, right), (top, bottom)] = row.center.each_ref().map(|at| {
            let at = at.get(square).copied().unwrap_or(0.0) + border;
            (ceil(at - half) as usize, ceil(at + half) as usize)
        });
        for y in top..bottom {
            let row = self
                .others
                .get_mut(y * self.stride + left..y * self.stride + right)
                .unwrap_or_default();
            row.iter_mut().for_each(|nearest| *nearest = nearest.nearer(held));
        }
    }

    /// Pixel by pixel of the image; 0 for none.
    #[inline(always)]
    pub(crate) fn into_depths(self) -> Vec<T> {
        let (width, height) = (self.size.width.max(1) as usize, self.size.height as usize);
        let mut nearest = vec![T::NONE; width * height];
        let (mut most, mut all) = (vec![T::NONE; width], vec![T::NONE; width]);
        for row in 0..self.rows {
            self.along(row, false, &mut all);
            self.along(row, true, &mut most);
            all.iter_mut().zip(&most).for_each(|(all, most)| *all = all.nearer(*most));
            // Squares that begin in this row end with it, or up to n − 1 rows below.
            for down in 0..self.side {
                let Some(y) = (row + down).checked_sub(self.border).filter(|y| *y < height) else {
                    continue;
                };
                let into = nearest.get_mut(y * width..(y + 1) * width).unwrap_or_default();
                let covers = if down + 1 < self.side { &all } else { &most };
                into.iter_mut().zip(covers).for_each(|(into, covers)| *into = into.nearer(*covers));
            }
        }
        for (y, into) in nearest.chunks_exact_mut(width).enumerate() {
            if !self.others.is_empty() {
                let others = self.inside(&self.others, y + self.border, 0);
                into.iter_mut().zip(others).for_each(|(into, other)| *into = into.nearer(*other));
            }
            into.iter_mut().for_each(|depth| *depth = depth.shown());
        }
        nearest
    }

    /// What the squares that begin in a row, with n rows or with n − 1, cover of it.
    #[inline(always)]
    fn along(&self, row: usize, high: bool, covered: &mut [T]) {
        let plane = self.stride * self.rows;
        let narrow = self.planes.get(if high { 2 * plane } else { 0 }..).unwrap_or_default();
        let wide = narrow.get(plane..).unwrap_or_default();
        let last = self.inside(wide, row, self.side - 1);
        covered.copy_from_slice(last);
        for back in 0..self.side - 1 {
            let (narrow, wide) = (self.inside(narrow, row, back), self.inside(wide, row, back));
            for ((covered, narrow), wide) in covered.iter_mut().zip(narrow).zip(wide) {
                *covered = covered.nearer(*narrow).nearer(*wide);
            }
        }
    }

    /// A row of a plane, as wide as the image, `back` pixels to its left.
    #[inline(always)]
    fn inside<'a>(&self, plane: &'a [T], row: usize, back: usize) -> &'a [T] {
        let from = row * self.stride + self.border - back;
        plane.get(from..from + self.size.width as usize).unwrap_or_default()
    }
}

/// Added to 2²³, a value from 0 to 2²² is rounded to a whole number, which is then the low bits of
/// the sum. It costs less than a conversion that minds what does not fit.
#[inline(always)]
fn whole(value: f32) -> u32 {
    const BINARY_PLACES: u32 = 23;
    const MAGNITUDE: f32 = (1 << BINARY_PLACES) as f32;
    (value + MAGNITUDE).to_bits() & ((1 << BINARY_PLACES) - 1)
}

/// The least whole number that is not less than a `value` from 0 to 2²², to within rounding of the
/// value.
#[inline(always)]
fn ceil(value: f32) -> u32 {
    const NEARLY_HALF: f32 = 0.499_999_97;
    whole(value + NEARLY_HALF)
}

#[cfg(test)]
mod tests {
    use super::*;

    const SIZE: ImageSize = ImageSize::new(9, 7);

    /// The image by its definition.
    fn expected(squares: &[([f32; 2], f32, f32)]) -> Vec<f32> {
        let nearest = |k: u32| {
            let (x, y) = ((k % SIZE.width) as f32, (k / SIZE.width) as f32);
            let covers = |from: f32, half: f32, at: f32| at >= from - half && at < from + half;
            let here = squares
                .iter()
                .filter(|(at, half, _)| covers(at[0], *half, x) && covers(at[1], *half, y));
            here.map(|(_, _, z)| *z).reduce(f32::min).unwrap_or(0.0)
        };
        (0..SIZE.width * SIZE.height).map(nearest).collect()
    }

    fn row(squares: &[([f32; 2], f32, f32)]) -> SquareRow {
        let mut row = SquareRow::new(squares.len());
        for (k, (center, half, z)) in squares.iter().enumerate() {
            (row.center[0][k], row.center[1][k], row.half[k], row.depth[k]) =
                (center[0], center[1], *half, *z);
        }
        row
    }

    #[test]
    fn each_square_covers_the_pixels_whose_centers_it_holds() {
        for half in [0.5_f32, 0.8, 1.0, 1.3, 1.9, 2.6] {
            let mut squares = Vec::new();
            for k in 0..60_u16 {
                let k = f32::from(k);
                let own = half * if k % 7.0 == 0.0 { 1.2 } else { 1.0 };
                let own = if k % 11.0 == 0.0 { half + 1.1 } else { own };
                squares.push((
                    [k * 3.7 % 13.0 - 2.03, k * 2.3 % 11.0 - 2.03],
                    own,
                    1.0 + k * 0.61 % 3.0,
                ));
            }
            let expected = expected(&squares);
            let mut canvas = NearestCanvas::<f32>::new(SIZE, half);
            squares.chunks(15).for_each(|squares| canvas.cover(&mut row(squares), 1.0));
            assert_eq!(canvas.into_depths(), expected, "half {half}");
            let mut canvas = NearestCanvas::<u16>::new(SIZE, half);
            squares.chunks(15).for_each(|squares| canvas.cover(&mut row(squares), 1e4));
            let in_units: Vec<u16> = expected.iter().map(|z| (z * 1e4).round() as u16).collect();
            assert_eq!(canvas.into_depths(), in_units, "half {half}");
        }
    }

    #[test]
    fn what_lies_outside_covers_nothing() {
        let mut canvas = NearestCanvas::<f32>::new(SIZE, 1.0);
        for far in [f32::NAN, f32::INFINITY, f32::NEG_INFINITY, 1e9, -1e9, 40.0, -40.0] {
            canvas.cover(
                &mut row(&[([far, 3.0], 1.0, 1.0), ([3.0, far], 1.0, 1.0), ([3.0, 3.0], 1.0, 0.0)]),
                1.0,
            );
        }
        assert_eq!(canvas.into_depths(), [0.0; 63]);
    }

    #[test]
    fn a_depth_that_does_not_fit_is_none() {
        for (depth_m, shown) in
            [(0.0, 0), (0.4, 0), (0.6, 1), (1.0, 1), (65_535.0, 65_535), (65_535.6, 0), (1e30, 0)]
        {
            assert_eq!(u16::held(depth_m, 1.0).shown(), shown, "{depth_m}");
            assert_eq!(u16::fits(depth_m, 1.0), depth_m < 65_535.5, "{depth_m}");
        }
    }
}
