//! How much each pixel resembles the center of four chessboard squares.
//!
//! On a ring of 16 pixels around a chessboard corner, opposite pixels are alike, and the means of
//! opposite pairs differ: bright along one diagonal, dark along the other. At an edge opposite
//! pixels differ; on a stripe the middle differs from the ring. So, with a_k the mean and d_k the
//! difference of the k-th of eight opposite pairs,
//!
//! > response = (max a − min a) − mean d − 2·|middle − mean a|
//!
//! after Bennett and Lasenby, "ChESS – quick and robust detection of chess-board features" (CVIU
//! 118, 2014), with the range of the eight means in place of their sums over pairs at right angles,
//! so that a board seen at a slant, whose squares have acute angles, still responds. All in
//! saturating eight-bit arithmetic, 32 pixels per instruction with AVX2.

use crate::imaging::gray::GrayView;

/// Radius of the ring: no response is computed closer to the border than this.
pub(in crate::detection) const REACH: usize = 4;

/// Half of the ring, in order of its angle from +x towards +y; the other half is opposite.
pub(in crate::detection) const HALF_RING: [(i32, i32); 8] =
    [(4, 0), (4, 2), (3, 3), (2, 4), (0, 4), (-2, 4), (-3, 3), (-4, 2)];

/// The response at every pixel of an image, rows without padding.
#[derive(Debug, Default)]
pub(in crate::detection) struct Response {
    width: usize,
    height: usize,
    values: Vec<u8>,
}

impl Response {
    /// Computes the response of `image` in one of `every` rows; it is 0 in the others, and within
    /// [`REACH`] of the border.
    pub(in crate::detection) fn compute(&mut self, image: GrayView<'_>, every: usize) {
        (self.width, self.height) = (image.width(), image.height());
        let (width, height) = (self.width, self.height);
        // The buffer never shrinks: growing it again would write it twice.
        if self.values.len() < width * height {
            self.values.resize(width * height, 0);
        }
        let values = &mut self.values[..width * height];
        if width <= 2 * REACH || height <= 2 * REACH {
            values.fill(0);
            return;
        }
        values[..REACH * width].fill(0);
        values[(height - REACH) * width..].fill(0);
        pulp::Arch::new().dispatch(RingRows { image, values, every });
    }

    /// Columns.
    pub(in crate::detection) fn width(&self) -> usize {
        self.width
    }

    /// Rows.
    pub(in crate::detection) fn height(&self) -> usize {
        self.height
    }

    /// The responses of row `y`.
    pub(in crate::detection) fn row(&self, y: usize) -> &[u8] {
        &self.values[y * self.width..(y + 1) * self.width]
    }
}

/// The rows away from the border. A struct, not a closure: all of it must be inlined to be compiled
/// for the processor.
struct RingRows<'a> {
    image: GrayView<'a>,
    values: &'a mut [u8],
    /// One of this many rows is computed.
    every: usize,
}

impl pulp::NullaryFnOnce for RingRows<'_> {
    type Output = ();

    #[inline(always)]
    fn call(self) {
        let (width, height) = (self.image.width(), self.image.height());
        for y in REACH..height - REACH {
            let out = &mut self.values[y * width..(y + 1) * width];
            if !y.is_multiple_of(self.every) {
                out.fill(0);
                continue;
            }
            let rows = std::array::from_fn(|i| self.image.row(y + i - REACH));
            out[..REACH].fill(0);
            out[width - REACH..].fill(0);
            respond_row(&rows, &mut out[REACH..width - REACH]);
        }
    }
}

#[inline(always)]
fn mean(a: u8, b: u8) -> u8 {
    ((u16::from(a) + u16::from(b) + 1) >> 1) as u8
}

#[inline(always)]
fn absolute_difference(a: u8, b: u8) -> u8 {
    a.max(b) - a.min(b)
}

/// Folds eight values pairwise with a function of two: mean, maximum or minimum. Written out,
/// because a closure in the loop over pixels may not be inlined, and then the loop is not
/// vectorized.
macro_rules! of_eight {
    ($f:path, $v:expr) => {
        $f($f($f($v[0], $v[1]), $f($v[2], $v[3])), $f($f($v[4], $v[5]), $f($v[6], $v[7])))
    };
}

#[inline(always)]
#[expect(clippy::neg_multiply, reason = "one macro for both halves of the ring")]
fn respond_row(rows: &[&[u8]; 2 * REACH + 1], out: &mut [u8]) {
    let n = out.len();
    macro_rules! sample {
        ($dx:expr, $dy:expr) => {{
            let start = (REACH as i32 + $dx) as usize;
            &rows[(REACH as i32 + $dy) as usize][start..start + n]
        }};
    }
    macro_rules! half_ring {
        ($sign:expr) => {{
            let at: [(i32, i32); 8] = HALF_RING;
            [
                sample!($sign * at[0].0, $sign * at[0].1),
                sample!($sign * at[1].0, $sign * at[1].1),
                sample!($sign * at[2].0, $sign * at[2].1),
                sample!($sign * at[3].0, $sign * at[3].1),
                sample!($sign * at[4].0, $sign * at[4].1),
                sample!($sign * at[5].0, $sign * at[5].1),
                sample!($sign * at[6].0, $sign * at[6].1),
                sample!($sign * at[7].0, $sign * at[7].1),
            ]
        }};
    }
    let near: [&[u8]; 8] = half_ring!(1);
    let far: [&[u8]; 8] = half_ring!(-1);
    let middle = [sample!(1, 0), sample!(-1, 0), sample!(0, 1), sample!(0, -1)];
    for i in 0..n {
        macro_rules! pairs {
            ($f:path) => {
                [
                    $f(near[0][i], far[0][i]),
                    $f(near[1][i], far[1][i]),
                    $f(near[2][i], far[2][i]),
                    $f(near[3][i], far[3][i]),
                    $f(near[4][i], far[4][i]),
                    $f(near[5][i], far[5][i]),
                    $f(near[6][i], far[6][i]),
                    $f(near[7][i], far[7][i]),
                ]
            };
        }
        let means = pairs!(mean);
        let unlike = pairs!(absolute_difference);
        let range = of_eight!(u8::max, means) - of_eight!(u8::min, means);
        let center = mean(mean(middle[0][i], middle[1][i]), mean(middle[2][i], middle[3][i]));
        let offset = absolute_difference(center, of_eight!(mean, means));
        out[i] = range
            .saturating_sub(of_eight!(mean, unlike))
            .saturating_sub(offset)
            .saturating_sub(offset);
    }
}
