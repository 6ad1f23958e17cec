//! A small window laid over the image along two edges: is this where four chessboard squares meet, and where exactly?
//!
//! The window is a parallelogram whose sides follow the board's edges, so a slanted board looks square in it. Six by six
//! samples are compared with the pattern sign(a·b); where the pattern changes sign along each side is the corner.

use nalgebra::Vector2;

use crate::imaging::gray::GrayView;

/// A position or a vector in an image, in pixels.
pub(super) type Vec2 = Vector2<f32>;

/// A parallelogram about `center`, reaching `a` and `b` to each side.
#[derive(Debug, Clone, Copy)]
pub(super) struct Window {
    /// Its middle.
    pub center: Vec2,
    /// From the middle half-way along one edge of the board.
    pub a: Vec2,
    /// From the middle half-way along the other edge.
    pub b: Vec2,
}

/// What a window shows.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Cross {
    /// Where the edges cross, in pixels.
    pub center: Vec2,
    /// Correlation with the pattern of a chessboard corner, −1 to 1 in size; positive for either polarity.
    pub score: f32,
    /// Mean brightness of the quadrants between +a and +b and between −a and −b, less that of the other two.
    pub contrast: f32,
}

/// Six lines of six samples, and in each two of no weight for the sake of eight lanes.
const LINES: usize = 6;
const SAMPLES: usize = 6;
const LANES: usize = 8;

impl Window {
    /// A window on a board whose neighbouring corners lie at ±`u` and ±`v`: `fraction` of the way to them, at most
    /// `most_px` pixels.
    pub(super) fn on_board(center: Vec2, u: Vec2, v: Vec2, fraction: f32, most_px: f32) -> Self {
        let reach = |w: Vec2| w * fraction.min(most_px / w.norm().max(1e-3));
        Self { center, a: reach(u), b: reach(v) }
    }

    /// The same window, shrunk until it lies inside `image`; `None` if less than `least` of it is left.
    pub(super) fn inside(mut self, image: GrayView<'_>, least: f32) -> Option<Self> {
        let half = Vec2::new(self.a.x.abs() + self.b.x.abs(), self.a.y.abs() + self.b.y.abs());
        let room_x = self.center.x.min((image.width() as f32 - 1.0) - self.center.x);
        let room_y = self.center.y.min((image.height() as f32 - 1.0) - self.center.y);
        let fit = (room_x / half.x.max(1e-6)).min(room_y / half.y.max(1e-6)) - 1e-4;
        if fit < least || !fit.is_finite() {
            return None;
        }
        let shrink = fit.min(1.0);
        self.a *= shrink;
        self.b *= shrink;
        Some(self)
    }

    /// Looks at the window once. `None` if it leaves the image or is flat.
    pub(super) fn look(&self, image: GrayView<'_>) -> Option<Cross> {
        self.look_for(image, 0.0)
    }

    /// Looks at the window once. `None` if it leaves the image, is flat or scores less than `least_score`.
    pub(super) fn look_for(&self, image: GrayView<'_>, least_score: f32) -> Option<Cross> {
        let inside = self.inside(image, 1.0)?;
        let lines = FixedLines::start(image, inside.center - inside.a - inside.b, inside.a * 0.4, inside.b * 0.4);
        let Sums { sums, squares, columns, rows } = pulp::Arch::new().dispatch(lines);
        let (sum, squares) = (sums.iter().sum::<f32>(), squares.iter().sum::<f32>());
        let columns: [f32; 6] = std::array::from_fn(|k| columns[k]);
        let spread = (squares - sum * sum / 36.0).max(0.0);
        if spread < 18.0 {
            return None;
        }
        let matched = rows[3] + rows[4] + rows[5] - rows[0] - rows[1] - rows[2];
        let score = matched.abs() / (36.0 * spread).sqrt();
        if score < least_score {
            return None;
        }
        let center = self.center + self.a * edge_offset(&columns) + self.b * edge_offset(&rows);
        Some(Cross { center, score, contrast: matched / 18.0 })
    }

    /// Whether the middles of the four quadrants are bright and dark by turns, and by how much: the smaller of the bright
    /// less the larger of the dark, with the sign that [`Cross::contrast`] has. `None` outside the image; 0 if not.
    pub(super) fn alternation(&self, image: GrayView<'_>) -> Option<f32> {
        let inside = self.inside(image, 1.0)?;
        let at = |p: Vec2| bilinear(image.bytes(), image.stride(), p.x, p.y);
        let (sum, difference) = (inside.a + inside.b, inside.a - inside.b);
        let (p, q) = (at(inside.center + sum), at(inside.center - sum));
        let (r, s) = (at(inside.center + difference), at(inside.center - difference));
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

/// Samples a parallelogram line by line, in fixed point: 16 bits of a pixel's fraction to place them, 8 to interpolate.
/// A struct, not a closure: all of it must be inlined to be compiled for the processor.
struct FixedLines<'a> {
    bytes: &'a [u8],
    stride: usize,
    /// The whole pixel that the first sample lies in; the rest is counted from there.
    base: usize,
    start: [i32; 2],
    along: [i32; 2],
    down: [i32; 2],
}

/// Sums over the samples of a window, by their place in the line; the lanes beyond are 0.
struct Sums {
    sums: [f32; LANES],
    squares: [f32; LANES],
    /// The three lower lines less the three upper.
    columns: [f32; LANES],
    /// By line: the three right samples less the three left.
    rows: [f32; LINES],
}

impl<'a> FixedLines<'a> {
    /// All that will be sampled must lie in 0 … size − 1.
    fn start(image: GrayView<'a>, start: Vec2, along: Vec2, down: Vec2) -> Self {
        let fixed = |v: Vec2| [(v.x * 65536.0) as i64, (v.y * 65536.0) as i64];
        let step = |v: Vec2| fixed(v).map(|v| v as i32);
        let [x, y] = fixed(start).map(|v| v.max(0));
        Self {
            bytes: image.bytes(),
            stride: image.stride(),
            base: (y >> 16) as usize * image.stride() + (x >> 16) as usize,
            start: [x, y].map(|v| (v & 0xffff) as i32),
            along: step(along),
            down: step(down),
        }
    }

    /// The two pixels at `at` and the two below, as 16 bits each. In the image's last row and column nothing beyond is read
    /// with any weight.
    #[inline(always)]
    fn four(&self, at: usize) -> [i32; 2] {
        let pair = |at: usize| match self.bytes.get(at..).and_then(|rest| rest.first_chunk()) {
            Some(pair) => i32::from(u16::from_le_bytes(*pair)),
            None => self.bytes.get(at).copied().map_or(0, i32::from),
        };
        [pair(at), pair(at + self.stride)]
    }

    /// Line `j` of six samples; the lanes beyond are 0.
    #[inline(always)]
    fn line(&self, j: i32) -> [f32; LANES] {
        let (mut at, mut fx, mut fy) = ([0i32; LANES], [0i32; LANES], [0i32; LANES]);
        let (left, top) = (
            self.start[0].wrapping_add(self.down[0].wrapping_mul(j)),
            self.start[1].wrapping_add(self.down[1].wrapping_mul(j)),
        );
        for lane in 0..LANES {
            let x = left.wrapping_add(self.along[0].wrapping_mul(lane as i32));
            let y = top.wrapping_add(self.along[1].wrapping_mul(lane as i32));
            at[lane] = (y >> 16).wrapping_mul(self.stride as i32).wrapping_add(x >> 16);
            (fx[lane], fy[lane]) = ((x >> 8) & 255, (y >> 8) & 255);
        }
        let (mut upper, mut lower) = ([0i32; LANES], [0i32; LANES]);
        for lane in 0..SAMPLES {
            [upper[lane], lower[lane]] = self.four(self.base.wrapping_add_signed(at[lane] as isize));
        }
        let mut values = [0.0; LANES];
        for lane in 0..LANES {
            let (a, b) = (upper[lane] & 255, upper[lane] >> 8);
            let (c, d) = (lower[lane] & 255, lower[lane] >> 8);
            let (upper, lower) = (a * 256 + (b - a) * fx[lane], c * 256 + (d - c) * fx[lane]);
            values[lane] = (upper * 256 + (lower - upper) * fy[lane]) as f32 * (1.0 / 65536.0);
        }
        values
    }
}

impl pulp::NullaryFnOnce for FixedLines<'_> {
    type Output = Sums;

    #[inline(always)]
    fn call(self) -> Sums {
        let mut all = Sums { sums: [0.0; LANES], squares: [0.0; LANES], columns: [0.0; LANES], rows: [0.0; LINES] };
        for j in 0..LINES {
            let values = self.line(j as i32);
            let side = if j < LINES / 2 { -1.0 } else { 1.0 };
            #[expect(clippy::needless_range_loop, reason = "lanes of one width are what the compiler vectorises")]
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

/// How far along the window the edge across it lies, from the contrast across the other edge at six places, −1 to 1.
///
/// The contrast k(t) changes sign at the edge. Its even part tells the edge's offset δ, but light that changes over the
/// window adds a constant g to it: even(t) = g − k′(t)·δ, solved by least squares. Where blur fills the window, k′ is
/// constant too and the two cannot be told apart; then g is taken as small.
fn edge_offset(k: &[f32; 6]) -> f32 {
    const SMALL: f32 = 0.3;
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
    let determinant = (3.0 + SMALL) * s2 - s1 * s1;
    if determinant <= 0.0 {
        return 0.0;
    }
    ((s1 * e1 - (3.0 + SMALL) * se) / determinant).clamp(-1.0, 1.0)
}

/// Brightness between pixels; (`x`, `y`) must lie in 0 … size − 1.
#[inline]
pub(super) fn bilinear(bytes: &[u8], stride: usize, x: f32, y: f32) -> f32 {
    let (column, row) = (x as usize, y as usize);
    let (fx, fy) = (x - column as f32, y - row as f32);
    let at = row * stride + column;
    let get = |i: usize| f32::from(bytes.get(i).copied().unwrap_or(0));
    let (p, q) = if fx > 0.0 { (get(at) + fx * (get(at + 1) - get(at)), at + stride) } else { (get(at), at + stride) };
    if fy > 0.0 {
        let lower = if fx > 0.0 { get(q) + fx * (get(q + 1) - get(q)) } else { get(q) };
        p + fy * (lower - p)
    } else {
        p
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::imaging::gray::GrayImage;

    fn slanted_cross(center: Vec2, a: Vec2, b: Vec2) -> GrayImage {
        let mut pixels = Vec::new();
        let inverse = nalgebra::Matrix2::from_columns(&[a, b]).try_inverse().expect("two directions");
        for y in 0..40 {
            for x in 0..40 {
                let mut bright = 0.0;
                for sub in 0..64 {
                    let p = Vec2::new(x as f32 - 0.5 + (sub % 8) as f32 / 8.0, y as f32 - 0.5 + (sub / 8) as f32 / 8.0);
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
        let mut window = Window { center: Vec2::new(20.5, 19.9), a: a * 2.5, b: b * 2.5 };
        let mut look = || {
            let cross = window.look(image.view()).expect("a cross");
            window.center = cross.center;
            cross
        };
        let cross = [look(), look(), look(), look()][3];
        assert!((cross.center - truth).norm() < 0.15, "{cross:?}");
        assert!(cross.score > 0.85 && cross.contrast > 100.0, "{cross:?}");
    }

    #[test]
    fn the_other_polarity_has_negative_contrast() {
        let (a, b) = (Vec2::new(1.0, 0.0), Vec2::new(0.0, 1.0));
        let image = slanted_cross(Vec2::new(20.0, 20.0), a, b);
        let window = Window { center: Vec2::new(20.0, 20.0), a: b * 3.0, b: -a * 3.0 };
        assert!(window.look(image.view()).expect("a cross").contrast < -100.0);
        assert!(window.alternation(image.view()).expect("inside") < -100.0);
    }

    #[test]
    fn a_flat_window_and_one_outside_show_nothing() {
        let flat = GrayImage::filled(40, 40, 128);
        let window = Window { center: Vec2::new(20.0, 20.0), a: Vec2::new(3.0, 0.0), b: Vec2::new(0.0, 3.0) };
        assert_eq!(window.look(flat.view()), None);
        let outside = Window { center: Vec2::new(1.0, 20.0), ..window };
        assert_eq!(outside.look(flat.view()), None);
        assert!(outside.inside(flat.view(), 0.2).is_some());
        assert!(outside.inside(flat.view(), 0.9).is_none());
        assert!(Window { center: Vec2::new(f32::NAN, 0.0), ..window }.look(flat.view()).is_none());
    }
}
