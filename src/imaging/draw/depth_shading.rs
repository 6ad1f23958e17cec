//! Depth made visible: near is bright, far is dark, nothing measured is black; and where it jumps.

use image::{Rgb, RgbImage};

use crate::geometry::pixel::ImageSize;
use crate::imaging::draw::shade;

/// The distances between which shades change, in meters: equal ratios are equal steps.
const NEAR_M: f32 = 0.25;
const FAR_M: f32 = 8.0;
/// Depth jumps where it grows by this part from one pixel to the next. Chosen, not swept.
const JUMP_PART: f32 = 0.04;
/// This many empty pixels are skipped to reach what lies behind an edge: a stereo camera measures
/// nothing in its shadow. Chosen, not swept.
const MOST_GAP_PX: usize = 64;

/// An image of `size` from depths in meters, row by row; 0 for none.
pub fn shaded(depths: &[f32], size: ImageSize) -> RgbImage {
    let color = |depth: f32| match depth {
        depth if depth > 0.0 => shade(1.0 - (depth / NEAR_M).ln() / (FAR_M / NEAR_M).ln()),
        _ => Rgb([0; 3]),
    };
    let width = size.width as usize;
    RgbImage::from_fn(size.width, size.height, |x, y| {
        color(depths.get(y as usize * width + x as usize).copied().unwrap_or_default())
    })
}

/// Whether each pixel is the near side of an edge: what is measured next beside it lies farther
/// away by a jump. A hole in a surface, the far side of a shadow and the end of what is measured
/// are no edges.
pub fn edges(depths: &[f32], size: ImageSize) -> Vec<bool> {
    let (width, height) = (size.width as usize, size.height as usize);
    let at = |x: usize, y: usize| depths.get(y * width + x).copied().unwrap_or_default();
    let drops = |here: f32, ahead: &mut dyn Iterator<Item = f32>| {
        ahead
            .take(MOST_GAP_PX)
            .find(|other| *other > 0.0)
            .is_some_and(|other| other > here * (1.0 + JUMP_PART))
    };
    let is_edge = |x: usize, y: usize| {
        let here = at(x, y);
        here > 0.0
            && (drops(here, &mut (x + 1..width).map(|x| at(x, y)))
                || drops(here, &mut (0..x).rev().map(|x| at(x, y)))
                || drops(here, &mut (y + 1..height).map(|y| at(x, y)))
                || drops(here, &mut (0..y).rev().map(|y| at(x, y))))
    };
    (0..height).flat_map(|y| (0..width).map(move |x| (x, y))).map(|(x, y)| is_edge(x, y)).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    const SIZE: ImageSize = ImageSize::new(40, 30);

    /// A box at 1 m before a wall at 2 m, with a shadow of `shadow` pixels at the box's left and
    /// one hole in it.
    fn scene(shadow: usize) -> Vec<f32> {
        let depth = |x: usize, y: usize| match (x, y) {
            (20, 15) => 0.0,
            (15..30, 10..20) => 1.0,
            (x, 10..20) if x < 15 && x + shadow >= 15 => 0.0,
            _ => 2.0,
        };
        (0..30).flat_map(|y| (0..40).map(move |x| (x, y))).map(|(x, y)| depth(x, y)).collect()
    }

    #[test]
    fn the_outline_of_what_is_near_is_drawn_and_holes_are_not() {
        for shadow in [0, 2, 6] {
            let edges = edges(&scene(shadow), SIZE);
            let on = |x: usize, y: usize| edges[y * 40 + x];
            for y in 10..20 {
                for x in 15..30 {
                    let outline = x == 15 || x == 29 || y == 10 || y == 19;
                    assert_eq!(on(x, y), outline, "{x} {y} with a shadow of {shadow}");
                }
            }
            let elsewhere = (0..40 * 30)
                .filter(|k| !(15..30).contains(&(k % 40)) || !(10..20).contains(&(k / 40)));
            assert!(
                elsewhere.clone().all(|k| !edges[k]),
                "nothing on the wall with a shadow of {shadow}"
            );
        }
    }

    #[test]
    fn near_is_brighter_than_far_and_nothing_is_black() {
        let image = shaded(&[0.3, 1.0, 7.0, 0.0], ImageSize::new(4, 1));
        let light = |x: u32| image.get_pixel(x, 0).0.iter().map(|c| u32::from(*c)).sum::<u32>();
        assert!(light(0) > light(1) && light(1) > light(2) && light(2) > light(3), "{image:?}");
        assert_eq!(light(3), 0);
    }
}
