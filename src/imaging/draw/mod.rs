//! Drawing over an image: what was found in it, and where the board should be next. Edges are
//! smoothed; what lies outside the image is left out. With it, the images that are drawings as a
//! whole: a measured board, maps of errors and uncertainty, depth as shades.

pub mod board_drawing;
pub mod depth_shading;
pub mod error_drawing;
pub mod heat_map;
pub mod lettering;

use image::{Rgb, RgbImage};

use crate::geometry::pixel::Pixel;

/// A color.
pub type Color = Rgb<u8>;

/// Where corners were found.
pub const FOUND: Color = Rgb([77, 255, 157]);
/// The first corner.
pub const FIRST: Color = Rgb([255, 93, 122]);
/// Where the board should be.
pub const SUGGESTED: Color = Rgb([255, 216, 77]);

/// From dark to bright in equal steps for the eye, also for one that sees no red or green (after
/// "viridis").
const SHADES: [[u8; 3]; 8] = [
    [68, 1, 84],
    [70, 50, 126],
    [54, 92, 141],
    [39, 127, 142],
    [31, 161, 135],
    [74, 193, 109],
    [160, 218, 57],
    [253, 231, 37],
];

/// The color of a value between 0, the darkest, and 1, the brightest; beyond them, theirs.
pub fn shade(value: f32) -> Color {
    let steps = (SHADES.len() - 1) as f32;
    let along = if value.is_finite() { (value * steps).clamp(0.0, steps) } else { 0.0 };
    let first = (along as usize).min(SHADES.len() - 2);
    let part = along - first as f32;
    let channel = |i: usize| {
        let (from, to) = (f32::from(SHADES[first][i]), f32::from(SHADES[first + 1][i]));
        (from + (to - from) * part).round() as u8
    };
    Rgb([channel(0), channel(1), channel(2)])
}

/// How a line is drawn.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Pen {
    /// Its color.
    pub color: Color,
    /// Its width, in pixels.
    pub width_px: f64,
}

impl Pen {
    /// A pen whose lines are as wide, compared with the image, as one of 1.5 px is in an image
    /// 640 px wide.
    pub fn fitting(image: &RgbImage, color: Color) -> Self {
        let longer_side = f64::from(image.width().max(image.height()));
        Self { color, width_px: (longer_side / 640.0 * 1.5).max(1.0) }
    }
}

/// Draws the corners of a board: a line through them in their order and a ring around each, the
/// first larger and in another color. A corner that is not finite is left out.
pub fn draw_corners(image: &mut RgbImage, corners: &[Pixel]) {
    let pen = Pen::fitting(image, FOUND);
    let thin = Pen { width_px: pen.width_px * 0.6, ..pen };
    for pair in corners.windows(2) {
        draw_line(image, pair[0], pair[1], thin);
    }
    for (i, corner) in corners.iter().enumerate() {
        let (pen, radius) = match i {
            0 => (Pen { color: FIRST, ..pen }, 4.0),
            _ => (pen, 2.7),
        };
        draw_ring(image, *corner, radius * pen.width_px, pen);
    }
}

/// Draws the outline of a polygon.
pub fn draw_polygon(image: &mut RgbImage, corners: &[Pixel], pen: Pen) {
    let next = corners.iter().cycle().skip(1);
    for (from, to) in corners.iter().zip(next) {
        draw_line(image, *from, *to, pen);
    }
}

/// Draws a line from `from` to `to`.
pub fn draw_line(image: &mut RgbImage, from: Pixel, to: Pixel, pen: Pen) {
    if !(from.is_finite() && to.is_finite()) {
        return;
    }
    let along = to.to_vector() - from.to_vector();
    let length2 = along.norm_squared();
    let distance = |x: f64, y: f64| {
        let part = if length2 > 0.0 {
            ((x - from.x) * along.x + (y - from.y) * along.y) / length2
        } else {
            0.0
        };
        let part = part.clamp(0.0, 1.0);
        (x - from.x - part * along.x).hypot(y - from.y - part * along.y)
    };
    let reach = pen.width_px / 2.0 + 1.0;
    let (width, height) = (f64::from(image.width()), f64::from(image.height()));
    // Only the pixels near the line are visited: row by row for a steep one, column by column for
    // a flat one.
    let steep = along.y.abs() > along.x.abs();
    let (first, last, limit) = if steep { (from.y, to.y, height) } else { (from.x, to.x, width) };
    let slope = match (steep, length2 > 0.0) {
        (_, false) => 0.0,
        (true, true) => along.x / along.y,
        (false, true) => along.y / along.x,
    };
    // Across a line at 45 degrees its reach is longer by √2.
    let across = reach * std::f64::consts::SQRT_2;
    for major in range(first.min(last) - reach, first.max(last) + reach, limit) {
        let on_line = f64::from(major).max(first.min(last)).min(first.max(last));
        let middle = if steep {
            from.x + slope * (on_line - from.y)
        } else {
            from.y + slope * (on_line - from.x)
        };
        for minor in range(middle - across, middle + across, if steep { width } else { height }) {
            let (x, y) = if steep { (minor, major) } else { (major, minor) };
            let coverage = pen.width_px / 2.0 + 0.5 - distance(f64::from(x), f64::from(y));
            blend(image, x, y, pen.color, coverage);
        }
    }
}

/// Draws a circle line around `center`.
pub fn draw_ring(image: &mut RgbImage, center: Pixel, radius_px: f64, pen: Pen) {
    if !center.is_finite() {
        return;
    }
    let reach = radius_px + pen.width_px / 2.0 + 1.0;
    let (width, height) = (f64::from(image.width()), f64::from(image.height()));
    for y in range(center.y - reach, center.y + reach, height) {
        for x in range(center.x - reach, center.x + reach, width) {
            let distance = (f64::from(x) - center.x).hypot(f64::from(y) - center.y);
            let coverage = pen.width_px / 2.0 + 0.5 - (distance - radius_px).abs();
            blend(image, x, y, pen.color, coverage);
        }
    }
}

/// The whole numbers from `first` to `last` that lie in an image of `length`.
fn range(first: f64, last: f64, length: f64) -> std::ops::Range<u32> {
    // `max` and `min` pass over what is not a number, as coordinates far outside may make it;
    // `clamp` would panic.
    let first = first.ceil().max(0.0).min(length);
    let last = (last.floor() + 1.0).max(first).min(length);
    first as u32..last as u32
}

fn blend(image: &mut RgbImage, x: u32, y: u32, color: Color, coverage: f64) {
    let coverage = coverage.clamp(0.0, 1.0);
    let Some(pixel) = image.get_pixel_mut_checked(x, y).filter(|_| coverage > 0.0) else {
        return;
    };
    for (channel, wanted) in pixel.0.iter_mut().zip(color.0) {
        let mixed = f64::from(*channel) + (f64::from(wanted) - f64::from(*channel)) * coverage;
        *channel = mixed.round() as u8;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const PEN: Pen = Pen { color: Rgb([255, 255, 255]), width_px: 1.0 };

    fn lit(image: &RgbImage) -> Vec<(u32, u32)> {
        image
            .enumerate_pixels()
            .filter(|(_, _, pixel)| pixel.0[0] > 127)
            .map(|(x, y, _)| (x, y))
            .collect()
    }

    #[test]
    fn a_line_lights_the_pixels_it_runs_through() {
        for (to, expected) in [
            (Pixel::new(5.0, 2.0), vec![(2, 2), (3, 2), (4, 2), (5, 2)]),
            (Pixel::new(2.0, 5.0), vec![(2, 2), (2, 3), (2, 4), (2, 5)]),
            (Pixel::new(4.0, 4.0), vec![(2, 2), (3, 3), (4, 4)]),
            (Pixel::new(2.0, 2.0), vec![(2, 2)]),
        ] {
            let mut image = RgbImage::new(8, 8);
            draw_line(&mut image, Pixel::new(2.0, 2.0), to, PEN);
            assert_eq!(lit(&image), expected);
            let mut backwards = RgbImage::new(8, 8);
            draw_line(&mut backwards, to, Pixel::new(2.0, 2.0), PEN);
            assert_eq!(backwards, image);
        }
    }

    #[test]
    fn a_line_is_the_same_steep_or_flat() {
        let mut flat = RgbImage::new(40, 40);
        draw_line(
            &mut flat,
            Pixel::new(3.0, 5.0),
            Pixel::new(33.0, 21.0),
            Pen { width_px: 3.0, ..PEN },
        );
        let mut steep = RgbImage::new(40, 40);
        draw_line(
            &mut steep,
            Pixel::new(5.0, 3.0),
            Pixel::new(21.0, 33.0),
            Pen { width_px: 3.0, ..PEN },
        );
        assert!(flat.enumerate_pixels().all(|(x, y, pixel)| steep.get_pixel(y, x) == pixel));
    }

    #[test]
    fn what_lies_outside_is_left_out() {
        let mut image = RgbImage::new(4, 4);
        let far = [
            Pixel::new(-1e9, -1e9),
            Pixel::new(1e9, -7.0),
            Pixel::new(f64::NAN, 1.0),
            Pixel::new(2.0, f64::INFINITY),
        ];
        draw_polygon(&mut image, &far[2..], PEN);
        draw_line(&mut image, far[0], far[1], PEN);
        draw_corners(&mut image, &far);
        let beyond =
            [Pixel::new(-1e308, 1e308), Pixel::new(1e308, 1e308), Pixel::new(1e308, -1e308)];
        draw_polygon(&mut image, &beyond, PEN);
        draw_ring(&mut image, beyond[0], 3.0, PEN);
        assert_eq!(lit(&image), []);
        draw_line(&mut image, Pixel::new(-100.0, 1.0), Pixel::new(100.0, 1.0), PEN);
        assert_eq!(lit(&image), [(0, 1), (1, 1), (2, 1), (3, 1)]);
        draw_ring(&mut RgbImage::new(0, 0), Pixel::new(0.0, 0.0), 3.0, PEN);
    }

    #[test]
    fn the_first_corner_stands_out() {
        let mut image = RgbImage::new(640, 480);
        draw_corners(&mut image, &[Pixel::new(100.0, 100.0), Pixel::new(200.0, 100.0)]);
        assert_eq!(image.get_pixel(100, 94), &FIRST);
        assert_eq!(image.get_pixel(200, 96), &FOUND);
    }
}
