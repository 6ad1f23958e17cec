//! An image pyramid: each pixel of a level is the mean of 2×2 of the level below.
//!
//! The coarse level is searched first: it takes a fraction of the time, and blur, motion and noise
//! are smaller there. Level 0 is the image itself, which is never copied.

use crate::geometry::pixel::ImageSize;
use crate::imaging::gray::GrayView;

/// The levels above the image. Buffers are reused from image to image.
#[derive(Debug, Default)]
pub(in crate::detection) struct Pyramid {
    levels: Vec<LevelPixels>,
    built: usize,
}

#[derive(Debug, Default)]
struct LevelPixels {
    width: usize,
    height: usize,
    pixels: Vec<u8>,
}

impl LevelPixels {
    fn view(&self) -> Option<GrayView<'_>> {
        GrayView::new(self.width, self.height, self.width, &self.pixels)
    }
}

impl Pyramid {
    /// Builds the levels 1 to `coarsest` of `image`.
    pub(in crate::detection) fn build(&mut self, image: GrayView<'_>, coarsest: usize) {
        self.built = 0;
        self.extend(image, coarsest);
    }

    /// Builds the levels up to `coarsest` that are not built yet; `image` must be that of the other
    /// levels.
    pub(in crate::detection) fn extend(&mut self, image: GrayView<'_>, coarsest: usize) {
        if self.levels.len() < coarsest {
            self.levels.resize_with(coarsest, LevelPixels::default);
        }
        let built = self.built;
        self.built = built.max(coarsest);
        for level in built..coarsest {
            let (below, from) = self.levels.split_at_mut(level);
            let source = below.last().and_then(LevelPixels::view).unwrap_or(image);
            if let Some(plane) = from.first_mut() {
                halve(source, plane);
            }
        }
    }

    /// Level `level` of the image the pyramid was built from; 0 is `image` itself.
    pub(in crate::detection) fn level<'a>(
        &'a self,
        image: GrayView<'a>,
        level: usize,
    ) -> GrayView<'a> {
        let level = level.min(self.built);
        level
            .checked_sub(1)
            .and_then(|above| self.levels.get(above))
            .and_then(LevelPixels::view)
            .unwrap_or(image)
    }
}

/// The coarsest level: its longer side has at least about 150 pixels, and at least `cells` × 7.
pub(in crate::detection) fn coarsest_level(size: ImageSize, cells: usize) -> usize {
    let longer = size.width.max(size.height) as usize;
    let least = 150.max(cells * 7);
    (0..12).take_while(|level| longer >> level >= least).last().unwrap_or(0)
}

fn halve(source: GrayView<'_>, into: &mut LevelPixels) {
    (into.width, into.height) = (source.width() / 2, source.height() / 2);
    into.pixels.resize(into.width * into.height, 0);
    pulp::Arch::new().dispatch(Halve { source, width: into.width, pixels: &mut into.pixels });
}

/// A struct, not a closure: all of it must be inlined to be compiled for the processor.
struct Halve<'a> {
    source: GrayView<'a>,
    width: usize,
    pixels: &'a mut [u8],
}

impl pulp::NullaryFnOnce for Halve<'_> {
    type Output = ();

    #[inline(always)]
    fn call(self) {
        for (y, out) in self.pixels.chunks_exact_mut(self.width.max(1)).enumerate() {
            halve_rows(self.source.row(2 * y), self.source.row(2 * y + 1), out);
        }
    }
}

#[inline(always)]
fn halve_rows(upper: &[u8], lower: &[u8], out: &mut [u8]) {
    for ((out, a), b) in out.iter_mut().zip(upper.chunks_exact(2)).zip(lower.chunks_exact(2)) {
        *out = ((pair(a) + pair(b) + 2) >> 2) as u8;
    }
}

#[inline(always)]
fn pair(p: &[u8]) -> u16 {
    let both = u16::from_le_bytes([p[0], p[1]]);
    (both & 0xff) + (both >> 8)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::imaging::gray::GrayImage;

    #[test]
    fn a_level_is_the_rounded_mean_of_four() {
        let image =
            GrayImage::from_pixels(5, 4, (0..20).map(|i| i * 7).collect()).expect("twenty pixels");
        let mut pyramid = Pyramid::default();
        pyramid.build(image.view(), 2);
        let half = pyramid.level(image.view(), 1);
        assert_eq!((half.width(), half.height()), (2, 2));
        let mean = |a: u16, b: u16, c: u16, d: u16| ((a + b + c + d + 2) / 4) as u8;
        assert_eq!(half.row(0), [mean(0, 7, 35, 42), mean(14, 21, 49, 56)]);
        let quarter = pyramid.level(image.view(), 2);
        assert_eq!((quarter.width(), quarter.height()), (1, 1));
        assert_eq!(pyramid.level(image.view(), 0).row(3), image.row(3));
    }

    #[test]
    fn levels_that_are_built_later_are_those_of_the_same_image() {
        let filled = |value: u8| GrayImage::filled(8, 8, value);
        let (before, image) = (filled(9), filled(70));
        let mut pyramid = Pyramid::default();
        pyramid.build(before.view(), 3);
        pyramid.build(image.view(), 0);
        assert_eq!(pyramid.level(image.view(), 2).width(), 8);
        pyramid.extend(image.view(), 1);
        pyramid.extend(image.view(), 2);
        pyramid.extend(image.view(), 1);
        let quarter = pyramid.level(image.view(), 2);
        assert_eq!((quarter.width(), quarter.row(0)), (2, &[70, 70][..]));
    }

    #[test]
    fn the_coarsest_level_leaves_room_for_the_board() {
        let level = |w, h, cells| coarsest_level(ImageSize::new(w, h), cells);
        assert_eq!(level(640, 480, 10), 2);
        assert_eq!(level(3840, 2160, 10), 4);
        assert_eq!(level(640, 480, 60), 0);
        assert_eq!(level(2, 1, 10), 0);
    }
}
