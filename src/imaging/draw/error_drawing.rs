//! Errors of depth as colors, before and after correction beside each other: blue is too near, red
//! too far, white right.

use image::{Rgb, RgbImage};

use crate::geometry::pixel::ImageSize;
use crate::imaging::draw::lettering::{LabelStyle, draw_label, label_size};

/// Drawings are enlarged by whole factors up to this longer side, in pixels; larger ones stay.
const LONGER_SIDE: u32 = 400;
/// Between the drawings and around them.
const GAP: u32 = 16;
/// Pixels a dot of the labels.
const LETTERING: u32 = 2;
/// A limit that is missed by this part is kept all the same.
const LIMIT_ROUNDING_PART: f64 = 1e-3;
const GROUND: Rgb<u8> = Rgb([200, 200, 200]);
const INK: Rgb<u8> = Rgb([0, 0, 0]);
const LABEL: LabelStyle = LabelStyle { ink: INK, plate: GROUND, scale: LETTERING };
const TOO_NEAR: [f32; 3] = [33.0, 102.0, 172.0];
const RIGHT: [f32; 3] = [247.0, 247.0, 247.0];
const TOO_FAR: [f32; 3] = [178.0, 24.0, 43.0];
/// Colors reach so far that no more than this part of the errors before are beyond.
const BEYOND_PART: f64 = 0.05;

/// Draws what `before` and `after` (meters, row by row of an image of `size`; not finite for none)
/// differ from 0 by: the part of the image that has errors, on one scale for both, with a label
/// each and the scale below. `None` without errors.
pub fn draw_errors(
    [before, after]: [&[f32]; 2],
    size: ImageSize,
    labels: [&str; 2],
) -> Option<RgbImage> {
    let (low, high) = bounds(before, size)?;
    let limit_mm = limit_mm(before)?;
    let [wide, tall] = [high[0] - low[0] + 1, high[1] - low[1] + 1];
    let scale = (LONGER_SIDE / wide.max(tall)).max(1);
    let [line, panel] = [label_size("0", LETTERING)[1], wide * scale];
    let below = GAP + line + GAP + tall * scale + GAP;
    let mut image = RgbImage::from_pixel(2 * panel + 3 * GAP, below + line + GAP, GROUND);
    for (place, (errors, label)) in (0..).zip([before, after].into_iter().zip(labels)) {
        let left = GAP + place * (panel + GAP);
        draw_label(&mut image, label, [left, GAP], LABEL);
        for (x, y) in (0..tall * scale).flat_map(|y| (0..panel).map(move |x| (x, y))) {
            let at = (low[1] + y / scale) * size.width + low[0] + x / scale;
            let error = errors.get(at as usize).copied().filter(|error| error.is_finite());
            let color = error.map_or(GROUND, |error| color(1e3 * error / limit_mm));
            image.put_pixel(left + x, GAP + line + GAP + y, color);
        }
    }
    draw_scale(&mut image, limit_mm, below);
    Some(image)
}

/// From too near to too far, with their numbers at both ends.
fn draw_scale(image: &mut RgbImage, limit_mm: f32, top: u32) {
    let [near, far] = scale_ends(limit_mm);
    let ([near_wide, line], far_wide) =
        (label_size(&near, LETTERING), label_size(&far, LETTERING)[0]);
    let (from, to) = (2 * GAP + near_wide, image.width().saturating_sub(2 * GAP + far_wide));
    for (x, y) in (from..to).flat_map(|x| (top..top + line).map(move |y| (x, y))) {
        let along = (x - from) as f32 / (to - from) as f32;
        image.put_pixel(x, y, color(2.0 * along - 1.0));
    }
    draw_label(image, &near, [GAP, top], LABEL);
    draw_label(image, &far, [to + GAP, top], LABEL);
}

fn scale_ends(limit_mm: f32) -> [String; 2] {
    [format!("-{limit_mm} mm"), format!("{limit_mm} mm")]
}

/// The first and the last column and row that have errors.
fn bounds(errors: &[f32], size: ImageSize) -> Option<([u32; 2], [u32; 2])> {
    let known = errors.iter().zip(0_u32..).filter(|(error, _)| error.is_finite());
    let mut all = known.map(|(_, k)| [k % size.width, k / size.width]);
    let first = all.next()?;
    Some(all.fold((first, first), |(low, high), at| {
        ([low[0].min(at[0]), low[1].min(at[1])], [high[0].max(at[0]), high[1].max(at[1])])
    }))
}

/// A round number of millimeters that most errors are within.
fn limit_mm(errors: &[f32]) -> Option<f32> {
    let mut sizes: Vec<f64> = errors
        .iter()
        .filter(|error| error.is_finite())
        .map(|error| 1e3 * f64::from(error.abs()))
        .collect();
    sizes.sort_unstable_by(f64::total_cmp);
    let most = *sizes.get(((1.0 - BEYOND_PART) * sizes.len() as f64) as usize)?;
    let decade = 10_f64.powf(most.max(0.01).log10().floor());
    let steps = [1.0, 1.5, 2.0, 3.0, 5.0, 7.0, 10.0];
    let round = steps
        .into_iter()
        .map(|step| step * decade)
        .find(|limit| *limit >= (1.0 - LIMIT_ROUNDING_PART) * most);
    Some(round.unwrap_or(10.0 * decade) as f32)
}

/// Of an error as a part of the scale's end.
fn color(part: f32) -> Rgb<u8> {
    let end = if part < 0.0 { TOO_NEAR } else { TOO_FAR };
    let strength = part.abs().min(1.0);
    let channel = |k: usize| (RIGHT[k] + strength * (end[k] - RIGHT[k])).round() as u8;
    Rgb([channel(0), channel(1), channel(2)])
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::imaging::draw::lettering::can_write;

    #[test]
    fn errors_are_drawn_where_they_are_on_one_scale() {
        let size = ImageSize::new(40, 30);
        let on_board = |k: u32| (10..30).contains(&(k % 40)) && (10..20).contains(&(k / 40));
        let errors = |error: f32| -> Vec<f32> {
            (0..40 * 30).map(|k| if on_board(k) { error } else { f32::NAN }).collect()
        };
        let image =
            draw_errors([&errors(0.0042), &errors(-0.0005)], size, ["4.2 mm", "0.5 mm"]).unwrap();
        assert_eq!(image.width(), 2 * 400 + 3 * GAP, "20 columns of 20 pixels");
        let (y, left) = (image.height() / 2, GAP + 200);
        let [before, after] = [left, left + 400 + GAP].map(|x| image.get_pixel(x, y).0);
        assert!(before[0] > 150 && before[2] < 100, "red: {before:?}");
        assert!(after[2] > 200 && after[0] > 200 && after[2] > after[0], "a light blue: {after:?}");
        assert_eq!(draw_errors([&errors(f32::NAN), &errors(1.0)], size, ["", ""]), None);
    }

    #[test]
    fn the_scale_ends_at_a_round_number() {
        for (error_m, limit) in
            [(0.0042_f32, 5.0), (0.0101, 15.0), (0.000_7, 0.7), (-0.05, 50.0), (0.0, 0.01)]
        {
            assert_eq!(limit_mm(&[error_m; 9]), Some(limit), "{error_m}");
            assert!(scale_ends(limit).iter().all(|text| can_write(text)), "{limit}");
        }
    }
}
