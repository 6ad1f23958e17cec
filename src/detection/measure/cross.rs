//! Measures a small window along two edges of the image: do four chessboard squares meet in it, and
//! where exactly?
//!
//! The window is a parallelogram with sides along the board's edges, so a slanted board appears
//! square in it. Six by six samples are compared with the pattern sign(a·b); the corner is where
//! the samples change sign along each side.

use crate::detection::vec2::Vec2;
use crate::imaging::gray::GrayView;

/// A parallelogram around `center`, with half sides `a` and `b`.
#[derive(Debug, Clone, Copy)]
pub(in crate::detection) struct CrossWindow {
    /// Its middle.
    pub center: Vec2,
    /// From the center to the end of the window along one edge of the board.
    pub a: Vec2,
    /// From the center to the end of the window along the other edge.
    pub b: Vec2,
}

/// The measurement of a window.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(in crate::detection) struct Cross {
    /// Where the edges cross, in pixels.
    pub center: Vec2,
    /// Correlation with the pattern of a chessboard corner, 0 to 1, for either polarity.
    pub score: f32,
    /// Mean brightness of the quadrants between +a and +b and between −a and −b, minus that of the
    /// other two.
    pub contrast: f32,
}

/// Six lines of six samples; each line has two more of zero weight, to fill eight lanes.
const LINES: usize = 6;
const SAMPLES: usize = 6;
const LANES: usize = 8;
/// How many samples a window has.
const SAMPLE_COUNT: f32 = (LINES * SAMPLES) as f32;
/// Least sum of the squared differences of a window's samples from their mean, in squared gray
/// levels; a window with less is flat. It is a standard deviation of 0.7 gray levels. Chosen, not
/// swept.
const LEAST_SPREAD: f32 = 18.0;
/// Prior weight, in samples' equations, of the constant that light adds ([`edge_offset`]). Chosen,
/// not swept.
const LIGHT_PRIOR: f32 = 0.3;
/// Least part of a window that must lie inside the image for a corner to be measured in it. Chosen,
/// not swept.
pub(in crate::detection) const LEAST_INSIDE: f32 = 0.25;
/// Relative margin between a window and the image border, for rounding.
const BORDER_MARGIN: f32 = 1e-4;

impl CrossWindow {
    /// A window on a board whose neighboring corners lie at ±`u` and ±`v`: `fraction` of the way
    /// to them, at most `most_px` pixels.
    pub(in crate::detection) fn on_board(
        center: Vec2,
        u: Vec2,
        v: Vec2,
        fraction: f32,
        most_px: f32,
    ) -> Self {
        let reach = |w: Vec2| w * fraction.min(most_px / w.norm().max(1e-3));
        Self { center, a: reach(u), b: reach(v) }
    }

    /// The same window, shrunk until it lies inside `image`; `None` if less than `least` of it is
    /// left.
    pub(in crate::detection) fn inside(mut self, image: GrayView<'_>, least: f32) -> Option<Self> {
        let (half, room) = (self.half(), self.room(image));
        let fit = (room.x / half.x.max(1e-6)).min(room.y / half.y.max(1e-6)) - BORDER_MARGIN;
        if fit < least || !fit.is_finite() {
            return None;
        }
        let shrink = fit.min(1.0);
        self.a *= shrink;
        self.b *= shrink;
        Some(self)
    }

    /// Half of its bounding box.
    fn half(&self) -> Vec2 {
        Vec2::new(self.a.x.abs() + self.b.x.abs(), self.a.y.abs() + self.b.y.abs())
    }

    /// The distance of its center from the nearest border of `image`, per axis.
    fn room(&self, image: GrayView<'_>) -> Vec2 {
        let (right, bottom) = (image.width() as f32 - 1.0, image.height() as f32 - 1.0);
        Vec2::new(
            self.center.x.min(right - self.center.x),
            self.center.y.min(bottom - self.center.y),
        )
    }

    /// Whether all of it lies inside `image`.
    fn is_inside(&self, image: GrayView<'_>) -> bool {
        let (half, room) = (self.half(), self.room(image));
        room.x >= half.x * (1.0 + BORDER_MARGIN) && room.y >= half.y * (1.0 + BORDER_MARGIN)
    }

    /// Measures the window once. `None` if it leaves the image or is flat.
    pub(in crate::detection) fn measure(&self, image: GrayView<'_>) -> Option<Cross> {
        self.measure_above(image, 0.0)
    }

    /// Measures the window once. `None` if it leaves the image, is flat or scores less than
    /// `least_score`.
    pub(in crate::detection) fn measure_above(
        &self,
        image: GrayView<'_>,
        least_score: f32,
    ) -> Option<Cross> {
        if !self.is_inside(image) {
            return None;
        }
        let lines =
            FixedLines::start(image, self.center - self.a - self.b, self.a * 0.4, self.b * 0.4);
        let WindowSums { sums, squares, columns, rows } = pulp::Arch::new().dispatch(lines);
        let (sum, squares) = (sums.iter().sum::<f32>(), squares.iter().sum::<f32>());
        let columns: [f32; 6] = std::array::from_fn(|k| columns[k]);
        let spread = (squares - sum * sum / SAMPLE_COUNT).max(0.0);
        if spread < LEAST_SPREAD {
            return None;
        }
        let matched = rows[3] + rows[4] + rows[5] - rows[0] - rows[1] - rows[2];
        let score = matched.abs() / (SAMPLE_COUNT * spread).sqrt();
        if score < least_score {
            return None;
        }
        let center = self.center + self.a * edge_offset(&columns) + self.b * edge_offset(&rows);
        Some(Cross { center, score, contrast: matched / (SAMPLE_COUNT / 2.0) })
    }

    /// Whether the centers of the four quadrants are alternately bright and dark, and by how much:
    /// the darker bright one minus the brighter dark one, with the sign of [`Cross::contrast`].
    /// `None` outside the image; 0 if they do not alternate.
    pub(in crate::detection) fn alternation(&self, image: GrayView<'_>) -> Option<f32> {
        if !self.is_inside(image) {
            return None;
        }
        let at = |p: Vec2| bilinear(image.bytes(), image.stride(), p.x, p.y);
        let (sum, difference) = (self.a + self.b, self.a - self.b);
        let (p, q) = (at(self.center + sum), at(self.center - sum));
        let (r, s) = (at(self.center + difference), at(self.center - difference));
        let (bright, dark) = (p.min(q) - r.max(s), r.min(s) - p.max(q));
        Some(if bright > 0.0 {
            bright
        } else if dark > 0.0 {
            -dark
        } else {
            0.0
        })
    }
}

/// Samples a parallelogram line by line, in fixed point: 16 fractional bits for positions, 8 for
/// interpolation. A struct, not a closure: all of it must be inlined to be compiled for the
/// processor.
struct FixedLines<'a> {
    /// The image from the first pixel of the parallelogram's bounding box on, and the same from one
    /// row below, both of the same length.
    upper: &'a [u8],
    lower: &'a [u8],
    stride: i32,
    /// The first sample, relative to that pixel.
    start: [i32; 2],
    along: [i32; 2],
    down: [i32; 2],
}

/// Sums over the samples of a window, by their place in the line; the padding lanes are 0.
struct WindowSums {
    sums: [f32; LANES],
    squares: [f32; LANES],
    /// The three lower lines minus the three upper ones.
    columns: [f32; LANES],
    /// For each line: the three right samples minus the three left ones.
    rows: [f32; LINES],
}

impl<'a> FixedLines<'a> {
    /// All samples must lie in 0 … size − 1; positions that rounding moves outside are moved back.
    fn start(image: GrayView<'a>, start: Vec2, along: Vec2, down: Vec2) -> Self {
        let fixed = |v: f32| (v * 65536.0) as i64;
        let place = |start: f32, along: f32, down: f32, size: usize| {
            let (start, along, down) = (fixed(start), fixed(along), fixed(down));
            let far = (SAMPLES - 1) as i64;
            let (before, after) =
                (far * (along.min(0) + down.min(0)), far * (along.max(0) + down.max(0)));
            let first =
                (start + before).min(((size as i64 - 1) << 16) - 1 - (after - before)).max(0);
            (first >> 16, [(first & 0xffff) - before, along, down].map(|v| v as i32))
        };
        let (left, x) = place(start.x, along.x, down.x, image.width());
        let (top, y) = place(start.y, along.y, down.y, image.height());
        let base = top as usize * image.stride() + left as usize;
        let lower = image.bytes().get(base + image.stride()..).unwrap_or_default();
        let upper = image.bytes().get(base..base + lower.len()).unwrap_or_default();
        let [start, along, down] = std::array::from_fn(|k| [x[k], y[k]]);
        Self { upper, lower, stride: image.stride() as i32, start, along, down }
    }

    /// The position of each sample: the pixel, and eight fractional bits of the way to the next.
    #[inline(always)]
    fn places(&self) -> ([u32; LINES * LANES], [u32; LINES * LANES]) {
        let (mut at, mut fractions) = ([0; LINES * LANES], [0; LINES * LANES]);
        for (k, (at, fractions)) in at.iter_mut().zip(&mut fractions).enumerate() {
            let (i, j) = ((k % LANES).min(SAMPLES - 1) as i32, (k / LANES) as i32);
            let [x, y] = std::array::from_fn(|axis| {
                let (along, down) =
                    (self.along[axis].wrapping_mul(i), self.down[axis].wrapping_mul(j));
                self.start[axis].wrapping_add(along).wrapping_add(down)
            });
            *at = (y >> 16).wrapping_mul(self.stride).wrapping_add(x >> 16) as u32;
            *fractions = ((x >> 8) & 255 | (y << 8) & 0xff0000) as u32;
        }
        (at, fractions)
    }

    /// The four pixels around each sample, two of a row in 16 bits.
    #[inline(always)]
    fn fours(&self, at: &[u32; LINES * LANES]) -> [u32; LINES * LANES] {
        let mut fours = [0; LINES * LANES];
        for (fours, at) in fours.chunks_exact_mut(LANES).zip(at.chunks_exact(LANES)) {
            for lane in 0..SAMPLES {
                let pair = at[lane] as usize..at[lane] as usize + 2;
                if let (Some(&[a, b]), Some(&[c, d])) =
                    (self.upper.get(pair.clone()), self.lower.get(pair))
                {
                    let row = |pair| u32::from(u16::from_le_bytes(pair));
                    fours[lane] = row([a, b]) | row([c, d]) << 16;
                }
            }
        }
        fours
    }
}

impl pulp::NullaryFnOnce for FixedLines<'_> {
    type Output = WindowSums;

    #[inline(always)]
    fn call(self) -> WindowSums {
        let (at, fractions) = self.places();
        let fours = self.fours(&at);
        let mut all = WindowSums {
            sums: [0.0; LANES],
            squares: [0.0; LANES],
            columns: [0.0; LANES],
            rows: [0.0; LINES],
        };
        for j in 0..LINES {
            let mut values = [0.0; LANES];
            for lane in 0..LANES {
                let (four, fraction) = (fours[j * LANES + lane], fractions[j * LANES + lane]);
                let byte = |n: u32| ((four >> (8 * n)) & 255) as i32;
                let (fx, fy) = ((fraction & 255) as i32, (fraction >> 16) as i32);
                let upper = byte(0) * 256 + (byte(1) - byte(0)) * fx;
                let lower = byte(2) * 256 + (byte(3) - byte(2)) * fx;
                values[lane] = (upper * 256 + (lower - upper) * fy) as f32 * (1.0 / 65536.0);
            }
            let side = if j < LINES / 2 { -1.0 } else { 1.0 };
            #[expect(
                clippy::needless_range_loop,
                reason = "lanes of one width are what the compiler vectorises"
            )]
            for lane in 0..LANES {
                all.sums[lane] += values[lane];
                all.squares[lane] += values[lane] * values[lane];
                all.columns[lane] += side * values[lane];
            }
            all.rows[j] = values[3] + values[4] + values[5] - values[0] - values[1] - values[2];
        }
        all
    }
}

/// The position of the edge across a window's side, from the contrast across the other edge at six
/// positions, −1 to 1.
///
/// The contrast k(t) changes sign at the edge. Its even part gives the edge's offset δ, but light
/// that varies over the window adds a constant g: even(t) = g − k′(t)·δ, solved by least squares.
/// Where blur fills the window, k′ is constant too and the two terms are collinear; a prior keeps g
/// small then.
fn edge_offset(k: &[f32; 6]) -> f32 {
    let even = [3, 4, 5].map(|n: usize| 0.5 * (k[n] + k[5 - n]));
    let odd = [3, 4, 5].map(|n: usize| 0.5 * (k[n] - k[5 - n]));
    let slope = [(odd[1] + odd[0]) / 0.8, (odd[2] - odd[0]) / 0.8, (odd[2] - odd[1]) / 0.4];
    let (mut s1, mut s2, mut e1, mut se) = (0.0, 0.0, 0.0, 0.0);
    for (s, e) in slope.into_iter().zip(even) {
        s1 += s;
        s2 += s * s;
        e1 += e;
        se += s * e;
    }
    let determinant = (3.0 + LIGHT_PRIOR) * s2 - s1 * s1;
    if determinant <= 0.0 {
        return 0.0;
    }
    ((s1 * e1 - (3.0 + LIGHT_PRIOR) * se) / determinant).clamp(-1.0, 1.0)
}

/// Bilinear interpolation; (`x`, `y`) must lie in 0 … size − 1.
#[inline]
pub(in crate::detection) fn bilinear(bytes: &[u8], stride: usize, x: f32, y: f32) -> f32 {
    let (column, row) = (x as i32, y as i32);
    let (fx, fy) = (x - column as f32, y - row as f32);
    let at = row as usize * stride + column as usize;
    // In the last row and column the pixels beyond have weight 0.
    let pair = |at: usize| match bytes.get(at..).and_then(|rest| rest.first_chunk()) {
        Some(&[p, q]) => (f32::from(p), f32::from(q)),
        None => bytes.get(at).map_or((0.0, 0.0), |&p| (f32::from(p), f32::from(p))),
    };
    let ((p, q), (r, s)) = (pair(at), pair(at + stride));
    let (upper, lower) = (p + fx * (q - p), r + fx * (s - r));
    upper + fy * (lower - upper)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::imaging::gray::GrayImage;

    fn slanted_cross(center: Vec2, a: Vec2, b: Vec2) -> GrayImage {
        let mut pixels = Vec::new();
        let inverse =
            nalgebra::Matrix2::from_columns(&[a, b]).try_inverse().expect("two directions");
        for y in 0..40 {
            for x in 0..40 {
                let mut bright = 0.0;
                for sub in 0..64 {
                    let p = Vec2::new(
                        x as f32 - 0.5 + (sub % 8) as f32 / 8.0,
                        y as f32 - 0.5 + (sub / 8) as f32 / 8.0,
                    );
                    let q = inverse * (p + Vec2::repeat(1.0 / 16.0) - center);
                    bright += if q.x * q.y > 0.0 { 200.0 / 64.0 } else { 50.0 / 64.0 };
                }
                pixels.push(bright as u8);
            }
        }
        GrayImage::from_pixels(40, 40, pixels).expect("1600 pixels")
    }

    #[test]
    fn the_saddle_of_a_slanted_cross_is_found() {
        let (a, b) = (Vec2::new(0.9, 0.3), Vec2::new(-0.1, 1.0));
        let truth = Vec2::new(19.3, 20.6);
        let image = slanted_cross(truth, a, b);
        let mut window = CrossWindow { center: Vec2::new(20.5, 19.9), a: a * 2.5, b: b * 2.5 };
        let mut measure = || {
            let cross = window.measure(image.view()).expect("a cross");
            window.center = cross.center;
            cross
        };
        let cross = [measure(), measure(), measure(), measure()][3];
        assert!((cross.center - truth).norm() < 0.15, "{cross:?}");
        assert!(cross.score > 0.85 && cross.contrast > 100.0, "{cross:?}");
    }

    #[test]
    fn the_other_polarity_has_negative_contrast() {
        let (a, b) = (Vec2::new(1.0, 0.0), Vec2::new(0.0, 1.0));
        let image = slanted_cross(Vec2::new(20.0, 20.0), a, b);
        let window = CrossWindow { center: Vec2::new(20.0, 20.0), a: b * 3.0, b: -a * 3.0 };
        assert!(window.measure(image.view()).expect("a cross").contrast < -100.0);
        assert!(window.alternation(image.view()).expect("inside") < -100.0);
    }

    #[test]
    fn a_flat_window_and_one_outside_show_nothing() {
        let flat = GrayImage::filled(40, 40, 128);
        let window = CrossWindow {
            center: Vec2::new(20.0, 20.0),
            a: Vec2::new(3.0, 0.0),
            b: Vec2::new(0.0, 3.0),
        };
        assert_eq!(window.measure(flat.view()), None);
        let outside = CrossWindow { center: Vec2::new(1.0, 20.0), ..window };
        assert_eq!(outside.measure(flat.view()), None);
        assert!(outside.inside(flat.view(), 0.2).is_some());
        assert!(outside.inside(flat.view(), 0.9).is_none());
        assert!(
            CrossWindow { center: Vec2::new(f32::NAN, 0.0), ..window }
                .measure(flat.view())
                .is_none()
        );
    }
}
