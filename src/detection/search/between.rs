//! Copies of an image at scales that its [`Pyramid`] lacks: two thirds of each level, and twice the
//! image.
//!
//! A measurement has a window of fixed size in pixels, and finds a corner only at some scales. Two
//! thirds of a level lie halfway between it and the next one. Twice the image shows corners that
//! are closer than that window: a gap of 3 px becomes one of 6 px.

use crate::detection::search::pyramid::Pyramid;
use crate::imaging::gray::{GrayImage, GrayView};

/// Two thirds of an image with the levels above it, or twice the image. Buffers are reused.
#[derive(Debug, Default)]
pub(in crate::detection) struct BetweenLevels {
    base: GrayImage,
    pyramid: Pyramid,
    mixed: Vec<u16>,
}

/// One such copy.
#[derive(Debug, Clone, Copy)]
pub(in crate::detection) struct BetweenLevel<'a> {
    pub view: GrayView<'a>,
    /// The level of the image's own pyramid that is the next finer one, or the image itself.
    pub finer: usize,
    /// Pixels of that level for each pixel of this copy.
    pub scale: f32,
}

impl BetweenLevels {
    /// Two thirds of the levels 0 to `coarsest` of `image`.
    pub(in crate::detection) fn two_thirds(
        &mut self,
        image: GrayView<'_>,
        coarsest: usize,
    ) -> impl Iterator<Item = BetweenLevel<'_>> {
        reduce_by_a_third(image, &mut self.base);
        self.pyramid.build(self.base.view(), coarsest);
        let Self { base, pyramid, .. } = self;
        (0..=coarsest).map(|finer| BetweenLevel {
            view: pyramid.level(base.view(), finer),
            finer,
            scale: 1.5,
        })
    }

    /// Twice the size of `image`.
    pub(in crate::detection) fn doubled(&mut self, image: GrayView<'_>) -> BetweenLevel<'_> {
        double(image, &mut self.base, &mut self.mixed);
        BetweenLevel { view: self.base.view(), finer: 0, scale: 0.5 }
    }
}

/// Each pixel is the mean of the 1.5×1.5 pixels that it covers: two thirds of one and a third of
/// the next. The center is off by up to a twelfth of a pixel of the image.
fn reduce_by_a_third(image: GrayView<'_>, into: &mut GrayImage) {
    into.reshape(image.width() / 3 * 2, image.height() / 3 * 2);
    pulp::Arch::new().dispatch(ReduceByAThird { image, into });
}

/// A struct, not a closure: all of it must be inlined to be compiled for the processor.
struct ReduceByAThird<'a> {
    image: GrayView<'a>,
    into: &'a mut GrayImage,
}

impl pulp::NullaryFnOnce for ReduceByAThird<'_> {
    type Output = ();

    #[inline(always)]
    fn call(self) {
        let width = self.into.width();
        let rows = self.into.pixels_mut().chunks_exact_mut((2 * width).max(1));
        for (y, out) in rows.enumerate() {
            let (upper, lower) = out.split_at_mut(width);
            let middle = self.image.row(3 * y + 1);
            thirds(self.image.row(3 * y), middle, upper);
            thirds(self.image.row(3 * y + 2), middle, lower);
        }
    }
}

/// Each two of `out` from three pixels of the `outer` row and half of those of the `middle` row.
#[inline(always)]
fn thirds(outer: &[u8], middle: &[u8], out: &mut [u8]) {
    let pixels = outer.chunks_exact(3).zip(middle.chunks_exact(3));
    for ((outer, middle), out) in pixels.zip(out.chunks_exact_mut(2)) {
        let column = |at: usize| 2 * u16::from(outer[at]) + u16::from(middle[at]);
        let shared = column(1);
        out[0] = ((2 * column(0) + shared + 4) / 9) as u8;
        out[1] = ((2 * column(2) + shared + 4) / 9) as u8;
    }
}

/// Bilinear: nine sixteenths of the pixel that it lies in, and three, three and one of the adjacent
/// ones.
fn double(image: GrayView<'_>, into: &mut GrayImage, mixed: &mut Vec<u16>) {
    into.reshape(2 * image.width(), 2 * image.height());
    pulp::Arch::new().dispatch(Double { image, into, mixed });
}

/// A struct, not a closure: all of it must be inlined to be compiled for the processor.
struct Double<'a> {
    image: GrayView<'a>,
    into: &'a mut GrayImage,
    /// Scratch: four times a row between two rows, with its ends repeated.
    mixed: &'a mut Vec<u16>,
}

impl pulp::NullaryFnOnce for Double<'_> {
    type Output = ();

    #[inline(always)]
    fn call(self) {
        let (width, height) = (self.image.width(), self.image.height());
        if width == 0 || height == 0 {
            return;
        }
        self.mixed.resize(width + 2, 0);
        let rows = self.into.pixels_mut().chunks_exact_mut(2 * width);
        for (y, out) in rows.enumerate() {
            let near = y / 2;
            let next = if y % 2 == 0 { near.saturating_sub(1) } else { (near + 1).min(height - 1) };
            let pixels = self.image.row(near).iter().zip(self.image.row(next));
            for (mixed, (near, next)) in self.mixed[1..=width].iter_mut().zip(pixels) {
                *mixed = 3 * u16::from(*near) + u16::from(*next);
            }
            self.mixed[0] = self.mixed[1];
            self.mixed[width + 1] = self.mixed[width];
            let (left, right) = (&self.mixed[..width], &self.mixed[2..]);
            let around = left.iter().zip(&self.mixed[1..=width]).zip(right);
            for (out, ((left, here), right)) in out.chunks_exact_mut(2).zip(around) {
                out[0] = ((3 * here + left + 8) >> 4) as u8;
                out[1] = ((3 * here + right + 8) >> 4) as u8;
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A ramp stays the ramp, where copies are said to lie.
    fn ramp(width: usize, height: usize) -> GrayImage {
        let pixels = (0..width * height).map(|i| (6 * (i % width) + 3 * (i / width)) as u8);
        GrayImage::from_pixels(width, height, pixels.collect()).expect("as many pixels")
    }

    fn check(level: BetweenLevel<'_>, size: (usize, usize), most_off_px: f32) {
        let BetweenLevel { view, scale, .. } = level;
        assert_eq!((view.width(), view.height()), size);
        for y in 2..view.height() - 2 {
            for x in 2..view.width() - 2 {
                let at = |u: usize| (u as f32 + 0.5) * scale - 0.5;
                let expected = 6.0 * at(x) + 3.0 * at(y);
                let off = f32::from(view.row(y)[x]) - expected;
                assert!(
                    off.abs() <= 0.5 + 9.0 * most_off_px + 1e-3,
                    "({x}, {y}): {off} gray values off"
                );
            }
        }
    }

    #[test]
    fn a_ramp_stays_where_it_is() {
        let image = ramp(25, 16);
        let mut between = BetweenLevels::default();
        check(between.doubled(image.view()), (50, 32), 0.0);
        let levels: Vec<_> = between.two_thirds(image.view(), 0).collect();
        assert_eq!(levels.len(), 1);
        check(levels[0], (16, 10), 1.0 / 12.0);
    }
}
