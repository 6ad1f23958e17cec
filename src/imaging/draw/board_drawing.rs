//! A board as it was measured: heights as colors, offsets in its plane as arrows.

use image::{ImageFormat, Rgb, RgbImage};

use crate::geometry::pixel::Pixel;
use crate::imaging::draw::lettering::{LabelStyle, draw_label, label_size};
use crate::imaging::draw::{self, Pen, draw_line};

/// Points of a board in its own frame, with how far each is from there. Lengths in meters.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct BoardOffsets<'a> {
    /// Where each point was stated.
    pub points: &'a [[f64; 3]],
    /// How far each is from there, as x, y, and z away from the side that is seen.
    pub offsets_m: &'a [[f64; 3]],
}

/// The longer side of the drawing, in pixels.
const LONGER_SIDE: f64 = 800.0;
/// The part of it beside the points.
const MARGIN: f64 = 0.08;
/// The longest arrow, as a part of the distance between points.
const LONGEST_ARROW: f64 = 0.8;
/// Heights are the same over a square of this many pixels.
const CELL: u32 = 4;
/// Round factors that arrows are drawn longer by.
const MANTISSAS: [f64; 3] = [5.0, 2.0, 1.0];
const PAPER: Rgb<u8> = Rgb([255, 255, 255]);
const INK: Rgb<u8> = Rgb([0, 0, 0]);
/// Pixels a dot of the labels.
const LETTERING: u32 = 2;

/// Draws a board seen from its front, x to the right and y down: dark where it is nearest to the
/// camera, bright where it is farthest; arrows from where points were stated, so many times
/// longer as the caption says. `None` without two different points.
pub fn draw_board(board: BoardOffsets<'_>) -> Option<RgbImage> {
    let place = BoardOnPage::of(board.points)?;
    let heights = || board.offsets_m.iter().map(|o| o[2]);
    let (low, high) =
        (heights().fold(f64::INFINITY, f64::min), heights().fold(f64::NEG_INFINITY, f64::max));
    let shade = |height: f64| draw::shade(((height - low) / (high - low).max(1e-12)) as f32);
    let caption_height = label_size("0", LETTERING)[1];
    let (width, height) = (place.size[0], place.size[1] + 2 * caption_height);
    let mut image = RgbImage::from_pixel(width, height, PAPER);
    for (top, left) in (0..place.size[1])
        .step_by(CELL as usize)
        .flat_map(|top| (0..place.size[0]).step_by(CELL as usize).map(move |left| (top, left)))
    {
        let middle = f64::from(CELL - 1) / 2.0;
        let at = place.point(f64::from(left) + middle, f64::from(top) + middle);
        let color = shade(height_at(board, at, place.spacing));
        for (x, y) in (0..CELL).flat_map(|dy| (0..CELL).map(move |dx| (left + dx, top + dy))) {
            if let Some(pixel) = image.get_pixel_mut_checked(x, y) {
                *pixel = color;
            }
        }
    }
    let longest = board.offsets_m.iter().map(|o| o[0].hypot(o[1])).fold(0.0, f64::max);
    let factor = round_below(LONGEST_ARROW * place.spacing / longest.max(1e-9));
    let pen = Pen { color: PAPER, width_px: 1.6 };
    for (point, offset) in board.points.iter().zip(board.offsets_m) {
        let tip = [0, 1].map(|axis| point[axis] + factor * offset[axis]);
        let (from, to) = (place.pixel([point[0], point[1]]), place.pixel(tip));
        draw_arrow(&mut image, from, to, pen);
    }
    let [low, high, longest] = [low, high, longest].map(|meters| meters * 1e3);
    for (line, row) in captions([low, high], factor, longest).iter().zip(0..) {
        draw_label(
            &mut image,
            line,
            [0, place.size[1] + row * caption_height],
            LabelStyle { ink: INK, plate: PAPER, scale: LETTERING },
        );
    }
    Some(image)
}

/// What the colors and the arrows mean; heights and the longest arrow in millimeters.
fn captions([low, high]: [f64; 2], factor: f64, longest: f64) -> [String; 2] {
    [
        format!("heights {low:.3} dark to {high:.3} mm bright"),
        format!("arrows {factor:.0} times longer, at most {longest:.3} mm"),
    ]
}

/// As [`draw_board`], as a PNG file; `None` where that cannot be drawn or encoded.
pub fn board_png(board: BoardOffsets<'_>) -> Option<Vec<u8>> {
    let mut png = std::io::Cursor::new(Vec::new());
    draw_board(board)?.write_to(&mut png, ImageFormat::Png).ok()?;
    Some(png.into_inner())
}

/// Where points lie in the drawing.
struct BoardOnPage {
    low: [f64; 2],
    pixels_per_m: f64,
    margin_px: f64,
    size: [u32; 2],
    /// About the distance between neighboring points, in meters.
    spacing: f64,
}

impl BoardOnPage {
    fn of(points: &[[f64; 3]]) -> Option<Self> {
        let bound = |axis: usize, start: f64, pick: fn(f64, f64) -> f64| {
            points.iter().map(|point| point[axis]).fold(start, pick)
        };
        let low = [0, 1].map(|axis| bound(axis, f64::INFINITY, f64::min));
        let high = [0, 1].map(|axis| bound(axis, f64::NEG_INFINITY, f64::max));
        let extent = [high[0] - low[0], high[1] - low[1]];
        let longer = extent[0].max(extent[1]);
        if !(longer > 0.0 && longer.is_finite()) {
            return None;
        }
        let margin_px = MARGIN * LONGER_SIDE;
        let pixels_per_m = (LONGER_SIDE - 2.0 * margin_px) / longer;
        let size = extent.map(|length| (length * pixels_per_m + 2.0 * margin_px).round() as u32);
        let spacing = (extent[0].max(0.1 * longer) * extent[1].max(0.1 * longer)
            / points.len() as f64)
            .sqrt();
        Some(Self { low, pixels_per_m, margin_px, size, spacing })
    }

    fn pixel(&self, point: [f64; 2]) -> Pixel {
        let [x, y] =
            [0, 1].map(|axis| (point[axis] - self.low[axis]) * self.pixels_per_m + self.margin_px);
        Pixel::new(x, y)
    }

    fn point(&self, x: f64, y: f64) -> [f64; 2] {
        let along = |at: f64, low: f64| (at - self.margin_px) / self.pixels_per_m + low;
        [along(x, self.low[0]), along(y, self.low[1])]
    }
}

/// The height between points: their mean with weights that fall with the distance over `spacing`.
fn height_at(board: BoardOffsets<'_>, [x, y]: [f64; 2], spacing: f64) -> f64 {
    let (mut sum, mut weights) = (0.0, 0.0);
    for (point, offset) in board.points.iter().zip(board.offsets_m) {
        let square = ((point[0] - x).powi(2) + (point[1] - y).powi(2)) / (spacing * spacing);
        // Never 0, so that there is a value however far the nearest point is.
        let weight = (-2.0 * square).exp() + 1e-9 / (1.0 + square);
        sum += weight * offset[2];
        weights += weight;
    }
    sum / weights
}

fn draw_arrow(image: &mut RgbImage, from: Pixel, to: Pixel, pen: Pen) {
    draw_line(image, from, to, pen);
    let along = to.to_vector() - from.to_vector();
    let length = along.norm();
    if !(length > 3.0) {
        return;
    }
    let back = -along / length * (0.35 * length).min(9.0);
    for side in [-0.5, 0.5] {
        let wing = back + side * nalgebra::Vector2::new(-back.y, back.x);
        draw_line(image, to, Pixel::new(to.x + wing.x, to.y + wing.y), pen);
    }
}

/// The greatest of 1, 2, 5, 10, 20 … that is no more than `factor`; 1 at least.
fn round_below(factor: f64) -> f64 {
    let decade = 10.0_f64.powf(factor.max(1.0).log10().floor());
    MANTISSAS.into_iter().map(|m| m * decade).find(|round| *round <= factor).unwrap_or(1.0)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::imaging::draw::lettering::can_write;

    fn grid() -> Vec<[f64; 3]> {
        (0..54).map(|k| [f64::from(k % 9) * 0.025, f64::from(k / 9) * 0.025, 0.0]).collect()
    }

    #[test]
    fn far_is_bright_near_is_dark_and_arrows_run_along_the_offsets() {
        let points = grid();
        let bowed = |p: &[f64; 3]| [0.0, 0.0001, 0.001 * (p[0] / 0.1 - 1.0)];
        let offsets: Vec<[f64; 3]> = points.iter().map(bowed).collect();
        let image = draw_board(BoardOffsets { points: &points, offsets_m: &offsets }).unwrap();
        assert_eq!(image.width(), 800);
        let light =
            |x: u32, y: u32| image.get_pixel(x, y).0.iter().map(|&c| u32::from(c)).sum::<u32>();
        assert!(
            light(70, 32) < 200 && light(735, 32) > 400,
            "{} {}",
            light(70, 32),
            light(735, 32)
        );
        // 1e-4 m is drawn 200 times longer: 20 of 25 mm, 84 px, downward.
        let place = BoardOnPage::of(&points).unwrap();
        let corner = place.pixel([points[4][0], points[4][1]]);
        let white =
            |dy: f64| image.get_pixel(corner.x.round() as u32, (corner.y + dy).round() as u32);
        assert_eq!(white(30.0), &PAPER);
        assert_ne!(white(-10.0), &PAPER);
    }

    #[test]
    fn the_captions_have_all_their_letters() {
        for line in captions([-1.234, 5.678], 200.0, 0.9) {
            assert!(can_write(&line), "{line}");
        }
    }

    #[test]
    fn factors_are_round() {
        for (factor, round) in [(0.3, 1.0), (1.0, 1.0), (7.0, 5.0), (250.0, 200.0), (999.0, 500.0)]
        {
            assert_eq!(round_below(factor), round);
        }
    }

    #[test]
    fn a_single_point_is_no_board() {
        assert!(draw_board(BoardOffsets { points: &[[0.0; 3]], offsets_m: &[[0.0; 3]] }).is_none());
    }
}
