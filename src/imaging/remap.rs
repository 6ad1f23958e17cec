//! Images through a map: for every pixel of the result, where in the source its light is.

use image::RgbImage;

use crate::geometry::pixel::{ImageSize, Pixel};
use crate::imaging::gray::{Gray16Image, GrayImage, GrayView};

/// How values between pixels are found.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Interpolation {
    /// From the nearest 2×2 pixels: fast, and what previews need.
    #[default]
    Bilinear,
    /// From the nearest 4×4 pixels, Keys' kernel with a = −1/2 (*Cubic convolution interpolation*,
    /// IEEE ASSP 1981): sharp.
    Bicubic,
}

/// A pixel's value in one channel, of 8 or 16 bits.
trait ChannelValue: Copy + Into<u32> + Into<f32> {
    /// White.
    const MOST: f32;
    /// `value`, which is at most [`Self::MOST`].
    fn of(value: u32) -> Self;
}

impl ChannelValue for u8 {
    const MOST: f32 = 255.0;
    fn of(value: u32) -> Self {
        value as Self
    }
}

impl ChannelValue for u16 {
    const MOST: f32 = 65_535.0;
    fn of(value: u32) -> Self {
        value as Self
    }
}

/// Sub-pixel steps that a map resolves between two pixels.
const STEPS: usize = 256;
/// Stands for a pixel that shows no part of the source image.
const NOWHERE: u32 = u32::MAX;

/// Where in a source image each pixel of a result is seen.
#[derive(Debug, Clone)]
pub struct PixelMap {
    source: ImageSize,
    target: ImageSize,
    entries: Vec<Entry>,
    /// Keys' four weights at each step.
    cubic: Vec<[f32; 4]>,
}

/// The upper left of the four pixels around a place, and how far the place is from it, in steps.
#[derive(Debug, Clone, Copy)]
struct Entry {
    first: u32,
    part: [u16; 2],
}

impl PixelMap {
    /// The map whose pixel at a place of the `target` is what the `source` shows at
    /// `source_from_target`(that place), if there is such a place inside the source.
    pub fn new(
        source: ImageSize,
        target: ImageSize,
        source_from_target: impl Fn(Pixel) -> Option<Pixel>,
    ) -> Self {
        let entry = |at: Pixel| source_from_target(at).and_then(|place| Entry::new(place, source));
        let nowhere = Entry { first: NOWHERE, part: [0; 2] };
        let entries = (0..target.height)
            .flat_map(|y| (0..target.width).map(move |x| Pixel::new(f64::from(x), f64::from(y))))
            .map(|at| entry(at).unwrap_or(nowhere))
            .collect();
        Self {
            source,
            target,
            entries,
            cubic: (0..=STEPS).map(|step| keys(step as f32 / STEPS as f32)).collect(),
        }
    }

    /// The size of the images it is for.
    pub fn source_size(&self) -> ImageSize {
        self.source
    }

    /// The size of the images it makes.
    pub fn target_size(&self) -> ImageSize {
        self.target
    }

    /// Whether the source shows what is at pixel (`x`, `y`) of the result.
    pub fn is_seen(&self, x: usize, y: usize) -> bool {
        self.entries
            .get(y * self.target.width as usize + x)
            .is_some_and(|entry| entry.first != NOWHERE)
    }

    /// The part of the result that the source shows, 0 to 1.
    pub fn seen_fraction(&self) -> f64 {
        let seen = self.entries.iter().filter(|entry| entry.first != NOWHERE).count();
        seen as f64 / self.entries.len().max(1) as f64
    }

    /// A gray image through the map, black where the source shows nothing; `None` if `source` has
    /// another size than the map's.
    pub fn gray(&self, source: GrayView<'_>, interpolation: Interpolation) -> Option<GrayImage> {
        let rows: Vec<&[u8]> = (0..source.height()).map(|y| source.row(y)).collect();
        if source.size() != self.source {
            return None;
        }
        let mut result =
            GrayImage::filled(self.target.width as usize, self.target.height as usize, 0);
        self.apply::<u8, 1>(&rows, result.pixels_mut(), interpolation);
        Some(result)
    }

    /// As [`Self::gray`], of 16 bits.
    pub fn gray16(
        &self,
        source: &Gray16Image,
        interpolation: Interpolation,
    ) -> Option<Gray16Image> {
        if ImageSize::new(source.width(), source.height()) != self.source {
            return None;
        }
        let rows: Vec<&[u16]> =
            source.as_raw().chunks_exact((source.width() as usize).max(1)).collect();
        let mut result = Gray16Image::new(self.target.width, self.target.height);
        self.apply::<u16, 1>(&rows, &mut result, interpolation);
        Some(result)
    }

    /// As [`Self::gray`], in color.
    pub fn rgb(&self, source: &RgbImage, interpolation: Interpolation) -> Option<RgbImage> {
        if ImageSize::new(source.width(), source.height()) != self.source {
            return None;
        }
        let rows: Vec<&[u8]> =
            source.as_raw().chunks_exact(3 * (source.width() as usize).max(1)).collect();
        let mut result = RgbImage::new(self.target.width, self.target.height);
        self.apply::<u8, 3>(&rows, &mut result, interpolation);
        Some(result)
    }

    fn apply<T: ChannelValue, const CHANNELS: usize>(
        &self,
        rows: &[&[T]],
        out: &mut [T],
        interpolation: Interpolation,
    ) {
        let width = self.source.width.max(1);
        for (entry, out) in self.entries.iter().zip(out.chunks_exact_mut(CHANNELS)) {
            if entry.first == NOWHERE {
                continue;
            }
            let at = [(entry.first % width) as usize, (entry.first / width) as usize];
            match interpolation {
                Interpolation::Bilinear => bilinear::<T, CHANNELS>(rows, at, entry.part, out),
                Interpolation::Bicubic => {
                    let weights = entry.part.map(|part| self.cubic[usize::from(part)]);
                    bicubic::<T, CHANNELS>(rows, at, weights, out);
                }
            }
        }
    }
}

impl Entry {
    /// `None` outside the centers of the outermost pixels, where there is nothing to interpolate
    /// between.
    fn new(place: Pixel, source: ImageSize) -> Option<Self> {
        let steps = STEPS as f64;
        let along = |value: f64, length: u32| {
            let step = (value * steps).round();
            let last = (f64::from(length) - 1.0) * steps;
            (length >= 2 && step >= 0.0 && step <= last).then(|| {
                let first = ((step / steps) as u32).min(length - 2);
                (first, (step - f64::from(first) * steps) as u16)
            })
        };
        let (x, x_part) = along(place.x, source.width)?;
        let (y, y_part) = along(place.y, source.height)?;
        Some(Self { first: y.checked_mul(source.width)?.checked_add(x)?, part: [x_part, y_part] })
    }
}

fn bilinear<T: ChannelValue, const CHANNELS: usize>(
    rows: &[&[T]],
    [x, y]: [usize; 2],
    part: [u16; 2],
    out: &mut [T],
) {
    let [s, t] = part.map(u32::from);
    let [upper, lower] = [y, y + 1].map(|y| &rows[y][x * CHANNELS..(x + 2) * CHANNELS]);
    let whole = STEPS as u32;
    for (channel, out) in out.iter_mut().enumerate() {
        let across = |row: &[T]| {
            let [left, right]: [u32; 2] = [row[channel].into(), row[channel + CHANNELS].into()];
            left * (whole - s) + right * s
        };
        // At most (2^16 - 1) 2^16 + 2^15: it fits.
        *out = T::of((across(upper) * (whole - t) + across(lower) * t + (1 << 15)) >> 16);
    }
}

fn bicubic<T: ChannelValue, const CHANNELS: usize>(
    rows: &[&[T]],
    [x, y]: [usize; 2],
    weights: [[f32; 4]; 2],
    out: &mut [T],
) {
    let width = rows[0].len() / CHANNELS;
    let columns: [usize; 4] = std::array::from_fn(|i| (x + i).saturating_sub(1).min(width - 1));
    for (channel, out) in out.iter_mut().enumerate() {
        let mut sum = 0.0;
        for (j, weight) in weights[1].iter().enumerate() {
            let row = rows[(y + j).saturating_sub(1).min(rows.len() - 1)];
            let across: f32 = columns
                .iter()
                .zip(weights[0])
                .map(|(x, weight)| {
                    let value: f32 = row[x * CHANNELS + channel].into();
                    weight * value
                })
                .sum();
            sum += weight * across;
        }
        *out = T::of(sum.round().clamp(0.0, T::MOST) as u32);
    }
}

/// The weights of the pixels at −1, 0, 1, 2 for a place at `t`.
fn keys(t: f32) -> [f32; 4] {
    let near = |d: f32| (1.5 * d - 2.5) * d * d + 1.0;
    let far = |d: f32| ((-0.5 * d + 2.5) * d - 4.0) * d + 2.0;
    [far(1.0 + t), near(t), near(1.0 - t), far(2.0 - t)]
}

#[cfg(test)]
mod tests {
    use super::*;

    fn wavy(size: ImageSize, at: impl Fn(f64, f64) -> f64) -> GrayImage {
        let (width, height) = (size.width as usize, size.height as usize);
        let pixels = (0..width * height)
            .map(|k| at((k % width) as f64, (k / width) as f64).round() as u8)
            .collect();
        GrayImage::from_pixels(width, height, pixels).unwrap()
    }

    fn waves(x: f64, y: f64) -> f64 {
        128.0 + 60.0 * (0.4 * x).sin() + 50.0 * (0.3 * y + 0.1 * x).cos()
    }

    #[test]
    fn the_identity_changes_nothing_to_the_last_pixel() {
        let size = ImageSize::new(13, 9);
        let image = wavy(size, waves);
        let map = PixelMap::new(size, size, Some);
        assert_eq!(map.seen_fraction(), 1.0);
        for interpolation in [Interpolation::Bilinear, Interpolation::Bicubic] {
            assert_eq!(map.gray(image.view(), interpolation).unwrap(), image);
        }
    }

    #[test]
    fn between_pixels_it_is_the_wave() {
        let size = ImageSize::new(60, 40);
        let image = wavy(size, waves);
        let moved = |p: Pixel| Some(Pixel::new(0.9 * p.x + 3.3, 0.8 * p.y + 2.6));
        let map = PixelMap::new(size, ImageSize::new(50, 40), moved);
        for (interpolation, most) in [(Interpolation::Bilinear, 4), (Interpolation::Bicubic, 1)] {
            let result = map.gray(image.view(), interpolation).unwrap();
            for y in 2..38 {
                for x in 2..48 {
                    let place = moved(Pixel::new(x as f64, y as f64)).unwrap();
                    let expected = waves(place.x, place.y).round() as u8;
                    let found = result.row(y)[x];
                    assert!(
                        found.abs_diff(expected) <= most,
                        "{found} not {expected} at {x} {y}, {interpolation:?}"
                    );
                }
            }
        }
    }

    #[test]
    fn sixteen_bits_stay_sixteen_bits() {
        let size = ImageSize::new(60, 40);
        let deep = |x: f64, y: f64| 257.0 * waves(x, y);
        let image = Gray16Image::from_fn(60, 40, |x, y| {
            image::Luma([deep(f64::from(x), f64::from(y)).round() as u16])
        });
        let same = PixelMap::new(size, size, Some);
        let moved = |p: Pixel| Some(Pixel::new(0.9 * p.x + 3.3, 0.8 * p.y + 2.6));
        let map = PixelMap::new(size, ImageSize::new(50, 40), moved);
        // Of 65535, where the steps of 8 bits are 257.
        for (interpolation, most) in [(Interpolation::Bilinear, 900), (Interpolation::Bicubic, 60)]
        {
            assert_eq!(same.gray16(&image, interpolation).unwrap(), image);
            let result = map.gray16(&image, interpolation).unwrap();
            for (x, y, found) in result.enumerate_pixels() {
                if !(2..48).contains(&x) || !(2..38).contains(&y) {
                    continue;
                }
                let place = moved(Pixel::new(f64::from(x), f64::from(y))).unwrap();
                let expected = deep(place.x, place.y).round() as u16;
                assert!(
                    found.0[0].abs_diff(expected) <= most,
                    "{found:?} not {expected} at {x} {y}, {interpolation:?}"
                );
            }
            let white = Gray16Image::from_pixel(60, 40, image::Luma([u16::MAX]));
            let result = map.gray16(&white, interpolation).unwrap();
            let seen = |(x, y, _): &(u32, u32, _)| map.is_seen(*x as usize, *y as usize);
            assert!(result.enumerate_pixels().filter(seen).all(|(.., p)| p.0 == [u16::MAX]));
        }
        assert!(map.gray16(&Gray16Image::new(9, 9), Interpolation::Bicubic).is_none());
    }

    #[test]
    fn colors_go_as_gray_does_and_what_is_not_seen_is_black() {
        let size = ImageSize::new(20, 10);
        let image = wavy(size, waves);
        let rgb = RgbImage::from_fn(20, 10, |x, y| {
            let value = image.row(y as usize)[x as usize];
            image::Rgb([value, 255 - value, 7])
        });
        let map =
            PixelMap::new(size, ImageSize::new(25, 10), |p| Some(Pixel::new(p.x - 2.25, p.y)));
        let (gray, rgb) = (
            map.gray(image.view(), Interpolation::Bilinear).unwrap(),
            map.rgb(&rgb, Interpolation::Bilinear),
        );
        let rgb = rgb.unwrap();
        for (k, pixel) in rgb.pixels().enumerate() {
            let (x, y) = (k % 25, k / 25);
            if map.is_seen(x, y) {
                assert_eq!((pixel[0], pixel[2]), (gray.row(y)[x], 7));
            } else {
                assert_eq!((pixel.0, gray.row(y)[x]), ([0; 3], 0));
            }
        }
        assert!(
            !map.is_seen(2, 0) && map.is_seen(3, 0) && map.is_seen(21, 0) && !map.is_seen(22, 0)
        );
        assert!(map.gray(GrayImage::filled(9, 9, 1).view(), Interpolation::Bilinear).is_none());
    }

    #[test]
    fn a_place_that_is_no_number_is_nowhere() {
        let size = ImageSize::new(4, 4);
        let map = PixelMap::new(size, size, |_| Some(Pixel::new(f64::NAN, f64::INFINITY)));
        assert_eq!(map.seen_fraction(), 0.0);
        let line = PixelMap::new(ImageSize::new(4, 1), size, Some);
        assert_eq!(line.seen_fraction(), 0.0);
    }
}
