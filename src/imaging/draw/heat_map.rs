//! A quantity over an image as colors, with contours that say their values.

use image::{ImageFormat, Rgb, RgbImage};

use crate::geometry::pixel::ImageSize;
use crate::imaging::draw;
use crate::imaging::draw::lettering::{LabelStyle, draw_label, label_size};

/// A positive quantity on a grid of pixels that spans an image from corner to corner, row by row;
/// `None` where there is none.
#[derive(Debug, Clone, PartialEq)]
pub struct GridValues<'a> {
    /// The image's size.
    pub size: ImageSize,
    /// Columns of the grid, at least 2.
    pub cols: usize,
    /// Rows of the grid, at least 2.
    pub rows: usize,
    /// The values.
    pub values: &'a [Option<f64>],
}

/// The caption of a map of standard deviations, in pixels.
pub const ONE_SIGMA_PX: &str = "1 sigma px";

/// The longer side of the drawing, in pixels.
const LONGER_SIDE: u32 = 800;
/// The values of the darkest and the brightest color: the same for all drawings, so that they can
/// be compared.
const COLORED_RANGE: [f64; 2] = [0.01, 2.0];
/// Where there is no value.
const NO_VALUE: Rgb<u8> = Rgb([128, 128, 128]);
const CONTOUR: Rgb<u8> = Rgb([255, 255, 255]);
const INK: Rgb<u8> = Rgb([0, 0, 0]);
/// Steps of a decade that contours may lie at: the first with which enough of them cross the
/// image.
const STEPS: [&[f64]; 4] = [
    &[1.0, 2.0, 5.0],
    &[1.0, 1.5, 2.0, 3.0, 5.0, 7.0],
    &[1.0, 1.2, 1.4, 1.6, 1.8, 2.0, 2.5, 3.0, 3.5, 4.0, 5.0, 6.0, 7.0, 8.0, 9.0],
    &[
        1.0, 1.1, 1.2, 1.3, 1.4, 1.5, 1.6, 1.7, 1.8, 1.9, 2.0, 2.2, 2.4, 2.6, 2.8, 3.0, 3.5, 4.0,
        4.5, 5.0, 5.5, 6.0,
    ],
];
/// The number of contours that are enough. Chosen.
const ENOUGH_CONTOURS: usize = 4;
/// Pixels a dot of the labels.
const LETTERING: u32 = 2;
const LABEL: LabelStyle = LabelStyle { ink: INK, plate: CONTOUR, scale: LETTERING };

/// Draws the values: dark for 0.01 and less, bright for 2 and more, in steps of the logarithm
/// between; contours at round values, each with its label, and below what the values are
/// (`caption`).
pub fn draw_heat_map(map: &GridValues<'_>, caption: &str) -> RgbImage {
    let scale = f64::from(LONGER_SIDE) / f64::from(map.size.width.max(map.size.height).max(1));
    let side = |length: u32| ((f64::from(length) * scale).round() as u32).max(1);
    let (width, height) = (side(map.size.width), side(map.size.height));
    let value = |x: u32, y: u32| {
        let part = |place: u32, length: u32| {
            f64::from(place.min(length - 1)) / f64::from((length - 1).max(1))
        };
        interpolated(map, part(x, width), part(y, height))
    };
    let levels = levels(map);
    let band = |value: f64| levels.iter().filter(|level| **level <= value).count();
    let mut crossings: Vec<Vec<(u32, u32)>> = vec![Vec::new(); levels.len()];
    let mut image = RgbImage::from_fn(width, height, |x, y| {
        let Some(here) = value(x, y) else { return NO_VALUE };
        let neighbors = [value(x + 1, y), value(x, y + 1)].into_iter().flatten();
        let Some(other) = neighbors.map(band).find(|other| *other != band(here)) else {
            return color(here);
        };
        crossings[other.max(band(here)) - 1].push((x, y));
        CONTOUR
    });
    let mut taken: Vec<(u32, u32)> = Vec::new();
    let caption_size = label_size(caption, LETTERING);
    for (level, crossing) in levels.iter().zip(&crossings) {
        write_on_contour(&mut image, &short(*level), crossing, caption_size, &mut taken);
    }
    let top = height.saturating_sub(caption_size[1]);
    draw_label(&mut image, caption, [0, top], LABEL);
    image
}

/// As [`draw_heat_map`], as a PNG file; `None` where that cannot be encoded.
pub fn heat_map_png(map: &GridValues<'_>, caption: &str) -> Option<Vec<u8>> {
    let mut png = std::io::Cursor::new(Vec::new());
    draw_heat_map(map, caption).write_to(&mut png, ImageFormat::Png).ok()?;
    Some(png.into_inner())
}

/// The value at a place given as parts of the width and height, 0 to 1, between the grid's points.
fn interpolated(map: &GridValues<'_>, across: f64, down: f64) -> Option<f64> {
    let (x, y) = (across * (map.cols - 1) as f64, down * (map.rows - 1) as f64);
    let (col, row) = ((x as usize).min(map.cols - 2), (y as usize).min(map.rows - 2));
    let (right, below) = (x - col as f64, y - row as f64);
    let at = |col: usize, row: usize| map.values.get(row * map.cols + col).copied().flatten();
    let (a, b, c, d) = (at(col, row)?, at(col + 1, row)?, at(col, row + 1)?, at(col + 1, row + 1)?);
    Some((a * (1.0 - right) + b * right) * (1.0 - below) + (c * (1.0 - right) + d * right) * below)
}

/// Round values between the least and the greatest.
fn levels(map: &GridValues<'_>) -> Vec<f64> {
    let seen =
        || map.values.iter().flatten().copied().filter(|value| value.is_finite() && *value > 0.0);
    let (least, greatest) = (seen().fold(f64::INFINITY, f64::min), seen().fold(0.0, f64::max));
    if !(least < greatest) {
        return Vec::new();
    }
    let decades = least.log10().floor() as i32..=greatest.log10().floor() as i32;
    let crossing = |steps: &[f64]| -> Vec<f64> {
        let all = decades
            .clone()
            .flat_map(|decade| steps.iter().map(move |step| step * 10_f64.powi(decade)));
        all.filter(|level| *level > least && *level <= greatest).collect()
    };
    STEPS
        .into_iter()
        .map(crossing)
        .find(|levels| levels.len() >= ENOUGH_CONTOURS)
        .unwrap_or_else(|| crossing(STEPS[3]))
}

/// A level without the digits that it has from its powers of ten.
fn short(level: f64) -> String {
    let digits = (1 - level.log10().floor() as i32).clamp(0, 6) as usize;
    let text = format!("{level:.digits$}");
    if text.contains('.') {
        text.trim_end_matches('0').trim_end_matches('.').to_owned()
    } else {
        text
    }
}

/// Writes a label where its contour is farthest from those that are written already, wholly inside
/// the image and clear of the caption, which has the lower left corner.
fn write_on_contour(
    image: &mut RgbImage,
    text: &str,
    contour: &[(u32, u32)],
    caption_size: [u32; 2],
    taken: &mut Vec<(u32, u32)>,
) {
    let [width, height] = label_size(text, LETTERING);
    let fits = |at: u32, length: u32, of: u32| at >= length / 2 && at - length / 2 + length <= of;
    let inside = |place: &&(u32, u32)| {
        fits(place.0, width, image.width()) && fits(place.1, height, image.height())
    };
    let beside_caption = |place: &&(u32, u32)| {
        let (left, bottom) = (place.0 - width / 2, place.1 - height / 2 + height);
        left >= caption_size[0] || bottom + caption_size[1] <= image.height()
    };
    let distance = |place: &(u32, u32)| {
        let far = |other: &(u32, u32)| {
            place.0.abs_diff(other.0).pow(2) + place.1.abs_diff(other.1).pow(2)
        };
        taken.iter().map(far).min().unwrap_or(u32::MAX)
    };
    // The first of those that are equally far.
    let free = contour.iter().filter(inside).filter(beside_caption);
    let best = free.rev().max_by_key(|place| distance(place)).copied();
    let clear = |place: &(u32, u32)| {
        taken
            .iter()
            .all(|other| place.0.abs_diff(other.0) > width || place.1.abs_diff(other.1) > height)
    };
    let Some(place) = best.filter(clear) else { return };
    draw_label(image, text, [place.0 - width / 2, place.1 - height / 2], LABEL);
    taken.push(place);
}

/// Dark is small, bright is large.
fn color(value: f64) -> Rgb<u8> {
    let [dark, bright] = COLORED_RANGE;
    draw::shade(((value / dark).max(1e-6).ln() / f64::ln(bright / dark)) as f32)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::imaging::draw::lettering::can_write;

    fn map(values: &[Option<f64>]) -> GridValues<'_> {
        GridValues { size: ImageSize::new(640, 480), cols: 9, rows: 7, values }
    }

    fn rising(from: f64, to: f64) -> Vec<Option<f64>> {
        (0..63).map(|k| Some(from + (to - from) * f64::from(k % 9) / 8.0)).collect()
    }

    #[test]
    fn contours_are_round_values_between_the_least_and_the_greatest() {
        assert_eq!(levels(&map(&rising(0.012, 1.5))), [0.02, 0.05, 0.1, 0.2, 0.5, 1.0]);
        let narrow = levels(&map(&rising(0.031, 0.062)));
        assert_eq!(narrow, [0.035, 0.04, 0.05, 0.06]);
        assert!(levels(&map(&rising(0.3, 0.3))).is_empty());
        assert!(levels(&map(&[None; 63])).is_empty());
    }

    #[test]
    fn labels_are_as_short_as_their_values() {
        let table = [
            (0.02, "0.02"),
            (0.035, "0.035"),
            (1.0, "1"),
            (1.5, "1.5"),
            (20.0, "20"),
            (0.1, "0.1"),
            (300.0, "300"),
        ];
        assert!(can_write(ONE_SIGMA_PX));
        for (level, text) in table {
            assert_eq!(short(level), text);
            assert!(can_write(text), "{text}");
        }
    }

    #[test]
    fn the_image_is_dark_where_the_value_is_small_with_labeled_contours_between() {
        let values = rising(0.012, 1.5);
        let image = draw_heat_map(&map(&values), ONE_SIGMA_PX);
        assert_eq!(image.dimensions(), (800, 600));
        let light = |x: u32| image.get_pixel(x, 300).0.iter().map(|&c| u32::from(c)).sum::<u32>();
        assert!(light(2) < 250 && light(798) > 400, "{} {}", light(2), light(798));
        assert!((0..800).any(|x| image.get_pixel(x, 300) == &CONTOUR));
        assert!(image.pixels().filter(|pixel| **pixel == INK).count() > 500, "labels");
    }

    #[test]
    fn a_contour_below_the_caption_has_its_label_beside_it() {
        let mut image = RgbImage::from_pixel(200, 100, NO_VALUE);
        let caption_size = label_size(ONE_SIGMA_PX, LETTERING);
        let [width, height] = label_size("0.05", LETTERING);
        let beside = (caption_size[0] + width / 2, 100 - height + height / 2);
        let mut taken = Vec::new();
        let mut write = |contour: &[(u32, u32)]| {
            write_on_contour(&mut image, "0.05", contour, caption_size, &mut taken);
            taken.clone()
        };
        assert!(write(&[(beside.0 - 1, beside.1)]).is_empty());
        assert_eq!(write(&[(beside.0 - 1, beside.1), beside]), [beside]);
        let above = (width / 2, 99 - caption_size[1] - height);
        assert_eq!(write(&[above]), [beside, above]);
    }

    #[test]
    fn where_there_is_no_value_there_is_no_color() {
        let image = draw_heat_map(&map(&[None; 63]), "");
        assert!(
            image
                .enumerate_pixels()
                .filter(|(_, y, _)| *y < 500)
                .all(|(_, _, pixel)| *pixel == NO_VALUE)
        );
    }
}
