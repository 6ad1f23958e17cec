//! The pixels that a corner is fitted to: a window along the cells' own axes, in pixels or in
//! averages of 2×2 or 4×4 pixels.

use pulp::{Simd, WithSimd};

use crate::detection::refine::corner_model::length;
use crate::detection::refine::window::Window;
use crate::imaging::gray::GrayView;

/// Vectors are filled up to a multiple of this with samples of weight 0.
const PADDING: usize = 16;
/// Pixels read at once, and rows whose extent in the window is computed at once.
const RUN: usize = 8;
const ROWS: usize = 8;

/// Samples of an image, relative to the window's origin and in units of the bin. The buffers only
/// ever grow: values beyond the padding are from earlier windows.
#[derive(Debug, Default)]
pub(super) struct Samples {
    x: Vec<f32>,
    y: Vec<f32>,
    value: Vec<f32>,
    weight: Vec<f32>,
    /// How many samples there are, without the padding.
    pub count: usize,
    /// The start of the padding, where the weight is 0; everywhere else it is 1.
    padded_from: usize,
}

impl Samples {
    /// Gathers the samples of `window`, those whose pixels all lie in `image`. Returns the fraction
    /// of the window that does.
    pub fn gather(&mut self, image: GrayView<'_>, window: &Window) -> f64 {
        pulp::Arch::new().dispatch(Gather {
            samples: self,
            image,
            rows: WindowRows::new(window),
            window,
        })
    }

    /// Positions x and y, gray values 0 … 255, and weights, in whole vectors: beyond the last
    /// sample weights and values are 0.
    #[inline(always)]
    pub fn vectors<S: Simd>(&self) -> [&[S::f32s]; 4] {
        let length = self.count.next_multiple_of(S::F32_LANES);
        [&self.x, &self.y, &self.value, &self.weight].map(|lane| S::as_simd_f32s(&lane[..length]).0)
    }

    /// The positions of the samples relative to the window's origin: all x, then all y.
    #[inline(always)]
    pub fn places(&self) -> [&[f32]; 2] {
        [&self.x[..self.count], &self.y[..self.count]]
    }

    /// Replaces each value by `change` of its position and value.
    pub fn change(&mut self, mut change: impl FnMut(f32, f32, f32) -> f32) {
        let Self { x, y, value, count, .. } = self;
        let places = x[..*count].iter().zip(&y[..*count]);
        for ((&x, &y), value) in places.zip(&mut value[..*count]) {
            *value = change(x, y, *value);
        }
    }

    /// Mean gray value where the product of the distances to two lines through the origin is
    /// negative, and where it is positive.
    pub fn quarter_means(&self, along: [[f64; 2]; 2]) -> [f64; 2] {
        pulp::Arch::new()
            .dispatch(QuarterMeans { samples: self, along: along.map(|d| d.map(|v| v as f32)) })
    }

    /// Makes room for `more` samples, plus whole vectors and the padding after them.
    #[inline(always)]
    fn make_room(&mut self, more: usize) {
        let room = self.count + more + RUN + PADDING;
        if self.x.len() < room {
            for lane in [&mut self.x, &mut self.y, &mut self.value] {
                lane.resize(2 * room, 0.0);
            }
            self.weight.resize(2 * room, 1.0);
        }
    }

    /// Appends `length` values of `bytes` from `at` on, at `y` and from `x` on; there must be room.
    /// Whole vectors are written: the next run, or the padding, overwrites the excess.
    #[inline(always)]
    fn push_run(&mut self, [x, y]: [f32; 2], bytes: &[u8], at: usize, length: usize) {
        const STEPS: [f32; RUN] = [0.0, 1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0];
        let mut start = 0;
        while start < length {
            let seen: [u8; RUN] = match bytes.get(at + start..).and_then(|rest| rest.first_chunk())
            {
                Some(seen) => *seen,
                None => std::array::from_fn(|i| bytes.get(at + start + i).copied().unwrap_or(0)),
            };
            let to = self.count + start..self.count + start + RUN;
            let from = x + start as f32;
            self.value[to.clone()].copy_from_slice(&seen.map(f32::from));
            self.x[to.clone()].copy_from_slice(&STEPS.map(|step| from + step));
            self.y[to].copy_from_slice(&[y; RUN]);
            start += RUN;
        }
        self.count += length;
    }

    /// Appends averages of `BIN` × `BIN` pixels.
    #[inline(always)]
    fn push_binned<const BIN: usize>(
        &mut self,
        [x, y]: [f32; 2],
        rows: [&[u8]; BIN],
        length: usize,
    ) {
        for i in 0..length {
            let mut sum = 0;
            for row in rows {
                for &pixel in &row[i * BIN..(i + 1) * BIN] {
                    sum += u32::from(pixel);
                }
            }
            self.value[self.count + i] = sum as f32 / (BIN * BIN) as f32;
            self.x[self.count + i] = x + i as f32;
            self.y[self.count + i] = y;
        }
        self.count += length;
    }

    /// Sets the weight beyond the last sample to 0, and restores it where the previous window
    /// ended.
    #[inline(always)]
    fn pad(&mut self) {
        self.make_room(0);
        let ended = self.padded_from;
        self.weight[ended..ended + PADDING].fill(1.0);
        self.weight[self.count..self.count + PADDING].fill(0.0);
        self.value[self.count..self.count + PADDING].fill(0.0);
        self.padded_from = self.count;
    }
}

struct QuarterMeans<'a> {
    samples: &'a Samples,
    along: [[f32; 2]; 2],
}

impl WithSimd for QuarterMeans<'_> {
    type Output = [f64; 2];

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) -> [f64; 2] {
        let [x, y, value, weight] = self.samples.vectors::<S>();
        let count = x.len();
        let (y, value, weight) = (&y[..count], &value[..count], &weight[..count]);
        let [[ax, ay], [bx, by]] = self.along;
        let (ax, ay, bx, by) =
            (simd.splat_f32s(ax), simd.splat_f32s(ay), simd.splat_f32s(bx), simd.splat_f32s(by));
        let zero = simd.splat_f32s(0.0);
        let mut sums = [zero; 4];
        for i in 0..count {
            // No closure: only inlined code is compiled for the processor.
            let a = simd.sub_f32s(simd.mul_f32s(ax, y[i]), simd.mul_f32s(ay, x[i]));
            let b = simd.sub_f32s(simd.mul_f32s(bx, y[i]), simd.mul_f32s(by, x[i]));
            let positive = simd.less_than_f32s(zero, simd.mul_f32s(a, b));
            sums[0] = simd.add_f32s(sums[0], value[i]);
            sums[1] = simd.add_f32s(sums[1], weight[i]);
            sums[2] = simd.add_f32s(sums[2], simd.select_f32s(positive, value[i], zero));
            sums[3] = simd.add_f32s(sums[3], simd.select_f32s(positive, weight[i], zero));
        }
        let [all, count, plus, plus_count] = sums.map(|sum| f64::from(simd.reduce_sum_f32s(sum)));
        [(all - plus) / (count - plus_count).max(1.0), plus / plus_count.max(1.0)]
    }
}

struct Gather<'a> {
    samples: &'a mut Samples,
    image: GrayView<'a>,
    rows: WindowRows,
    window: &'a Window,
}

impl WithSimd for Gather<'_> {
    type Output = f64;

    #[inline(always)]
    fn with_simd<S: Simd>(self, _: S) -> f64 {
        let Self { samples, image, rows, window } = self;
        samples.count = 0;
        let bin = window.bin as i64;
        let half = (window.bin as f64 - 1.0) / 2.0;
        let first = window.origin.map(|o| (o - half).round());
        let offset =
            [0, 1].map(|k| ((first[k] + half - window.origin[k]) / window.bin as f64) as f32);
        let first = first.map(|o| o as i64);
        // The columns and rows of bins that lie in the image.
        let size = [image.width() as i64, image.height() as i64];
        let inside =
            [0, 1].map(|k| [-first[k].div_euclid(bin), (size[k] - bin - first[k]).div_euclid(bin)]);
        let mut wanted = 0;
        let mut above = -rows.reach;
        while above <= rows.reach {
            let runs =
                rows.runs(above as f32 + offset[1], offset[0], inside[0].map(|end| end as f32));
            wanted += runs.wanted;
            samples.make_room(runs.lengths.iter().flatten().sum::<i32>() as usize);
            for (k, row) in (above..=rows.reach).enumerate().take(ROWS) {
                if row < inside[1][0] || row > inside[1][1] {
                    continue;
                }
                let top = (first[1] + row * bin) as usize;
                for (from, lengths) in runs.from.iter().zip(&runs.lengths) {
                    let length = lengths[k] as usize;
                    if length == 0 {
                        continue;
                    }
                    let at = [from[k] as f32 + offset[0], row as f32 + offset[1]];
                    let left = (first[0] + i64::from(from[k]) * bin) as usize;
                    match window.bin {
                        1 => {
                            samples.push_run(
                                at,
                                image.bytes(),
                                top * image.stride() + left,
                                length,
                            );
                        }
                        2 => samples.push_binned(at, rows_from::<2>(image, top, left), length),
                        _ => samples.push_binned(at, rows_from::<4>(image, top, left), length),
                    }
                }
            }
            above += ROWS as i64;
        }
        samples.pad();
        samples.count as f64 / f64::from(wanted.max(1))
    }
}

/// The `COUNT` rows of `image` from `top` on, from the column `left` on.
#[inline(always)]
fn rows_from<'a, const COUNT: usize>(
    image: GrayView<'a>,
    top: usize,
    left: usize,
) -> [&'a [u8]; COUNT] {
    std::array::from_fn(|k| &image.row(top + k)[left..])
}

/// The extent of a window in each row: a run of a parallelogram, or the parts of it near an edge.
/// In bins.
struct WindowRows {
    /// Center per row, and half width, of four bands: the intersection of the first two is the
    /// window, the other two are along the edges.
    bands: [[f32; 2]; 4],
    /// Rows −reach … reach may be non-empty.
    reach: i64,
}

/// The runs of some rows, two in each, either of which may be empty: their starts and lengths.
struct Runs {
    from: [[i32; ROWS]; 2],
    lengths: [[i32; ROWS]; 2],
    /// Their total length in an unbounded image.
    wanted: i32,
}

impl WindowRows {
    fn new(window: &Window) -> Self {
        let bin = window.bin as f64;
        let axes = window.axes.map(|[x, y]| [x / bin, y / bin]);
        let det = axes[0][0] * axes[1][1] - axes[0][1] * axes[1][0];
        let dual = [[axes[1][1] / det, -axes[1][0] / det], [-axes[0][1] / det, axes[0][0] / det]];
        let within = [0, 1].map(|k| dual[k].map(|v| v / window.extent[k]));
        let near = axes.map(|[x, y]| {
            let width = length([x, y]) * window.strip_px / bin;
            [-y / width, x / width]
        });
        let reach = window.extent[0] * axes[0][1].abs() + window.extent[1] * axes[1][1].abs();
        // Where |a·x + b·y| ≤ 1.
        let bands = [within[0], within[1], near[0], near[1]].map(|[a, b]| {
            let slope = if a.abs() < 1e-6 { 1e-6 } else { a };
            [(-b / slope) as f32, (1.0 / slope.abs()) as f32]
        });
        Self { bands, reach: (reach + 0.5) as i64 }
    }

    /// The runs of integer positions, counted from `offset`, in the rows from `y` on, as far as
    /// they are `inside` the image. Eight rows at once, with arithmetic only, so that it is
    /// vectorized.
    #[inline(always)]
    fn runs(&self, y: f32, offset: f32, inside: [f32; 2]) -> Runs {
        let mut runs = Runs { from: [[0; ROWS]; 2], lengths: [[0; ROWS]; 2], wanted: 0 };
        let mut wanted = [0.0; ROWS];
        #[expect(
            clippy::needless_range_loop,
            reason = "lanes of one width are what the compiler vectorises"
        )]
        for k in 0..ROWS {
            let y = y + k as f32;
            let (a, b) = (band(self.bands[0], y), band(self.bands[1], y));
            let (near, other) = (band(self.bands[2], y), band(self.bands[3], y));
            let within = [most(a[0], b[0]), least(a[1], b[1])];
            let (left, right) = (
                [least(near[0], other[0]), if near[0] < other[0] { near[1] } else { other[1] }],
                [most(near[0], other[0]), if near[0] < other[0] { other[1] } else { near[1] }],
            );
            let together = right[0] <= left[1];
            let first_end = if together { most(left[1], right[1]) } else { left[1] };
            let second_end = if together { right[0] - 2.0 } else { right[1] };
            let ends = [[left[0], first_end], [right[0], second_end]].map(|[start, end]| {
                [(most(within[0], start) - offset).ceil(), (least(within[1], end) - offset).floor()]
            });
            for (run, [from, to]) in ends.into_iter().enumerate() {
                wanted[k] += most(to - from + 1.0, 0.0);
                let from = most(from, inside[0]);
                runs.from[run][k] = whole(from);
                runs.lengths[run][k] = whole(most(least(to, inside[1]) - from + 1.0, 0.0));
            }
        }
        runs.wanted = whole(wanted.iter().sum());
        runs
    }
}

/// Converts an integer below four million; larger ones give an unspecified result. Skips the checks
/// of `as`.
#[inline(always)]
fn whole(value: f32) -> i32 {
    // At this magnitude, the last bit of a number counts ones.
    const ONES: f32 = 12_582_912.0;
    (value + ONES).to_bits() as i32 - ONES.to_bits() as i32
}

/// The interval of a band in row `y`.
#[inline(always)]
fn band([middle, half]: [f32; 2], y: f32) -> [f32; 2] {
    [middle * y - half, middle * y + half]
}

/// The larger of two numbers, neither of which is NaN: one instruction.
#[inline(always)]
fn most(a: f32, b: f32) -> f32 {
    if a > b { a } else { b }
}

/// The smaller of two numbers, neither of which is NaN.
#[inline(always)]
fn least(a: f32, b: f32) -> f32 {
    if a < b { a } else { b }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::imaging::gray::GrayImage;

    fn image() -> GrayImage {
        let pixels =
            (0..90 * 70).map(|i: u32| (i.wrapping_mul(2_654_435_761) >> 24) as u8).collect();
        GrayImage::from_pixels(90, 70, pixels).expect("as many pixels")
    }

    /// Position and mean of every bin of `window` that `image` holds, and how many there are with
    /// those beyond it.
    fn all(image: &GrayImage, window: &Window) -> (Vec<[f32; 3]>, usize) {
        let (bin, size) = (window.bin as f64, window.bin as i64);
        let first = window.origin.map(|o| (o - (bin - 1.0) / 2.0).round());
        let [a, b] = window.axes;
        let cross = |[ax, ay]: [f64; 2], [bx, by]: [f64; 2]| ax * by - ay * bx;
        let (mut seen, mut wanted) = (Vec::new(), 0);
        for (j, i) in (-60..60_i64).flat_map(|j| (-60..60_i64).map(move |i| (j, i))) {
            let corner = [first[0] as i64 + i * size, first[1] as i64 + j * size];
            let p = [0, 1].map(|k| corner[k] as f64 + (bin - 1.0) / 2.0 - window.origin[k]);
            let within = (cross(p, b) / cross(a, b)).abs() <= window.extent[0]
                && (cross(a, p) / cross(a, b)).abs() <= window.extent[1];
            if !within
                || [a, b].iter().all(|axis| cross(*axis, p).abs() > window.strip_px * length(*axis))
            {
                continue;
            }
            wanted += 1;
            if corner[0] < 0 || corner[1] < 0 || corner[0] + size > 90 || corner[1] + size > 70 {
                continue;
            }
            let pixels =
                (0..size).flat_map(|y| (0..size).map(move |x| [corner[0] + x, corner[1] + y]));
            let sum: u32 = pixels.map(|[x, y]| u32::from(image.row(y as usize)[x as usize])).sum();
            seen.push([(p[0] / bin) as f32, (p[1] / bin) as f32, sum as f32 / (bin * bin) as f32]);
        }
        (seen, wanted)
    }

    #[test]
    fn a_window_s_pixels_are_gathered_and_no_others() {
        let image = image();
        let mut samples = Samples::default();
        for (case, bin) in (0..240).zip([1, 2, 4].into_iter().cycle()) {
            let angle = 0.0371 * f64::from(case);
            let across = angle + 1.2 + 0.003 * f64::from(case);
            let window = Window {
                origin: [2.3 + 0.36 * f64::from(case), 67.8 - 0.27 * f64::from(case)],
                axes: [
                    [21.0 * angle.cos(), 21.0 * angle.sin()],
                    [17.0 * across.cos(), 17.0 * across.sin()],
                ],
                extent: [0.713, 0.629],
                strip_px: if case % 2 == 0 { f64::INFINITY } else { 3.17 },
                bin,
            };
            let share = samples.gather(image.view(), &window);
            let (expected, wanted) = all(&image, &window);
            let [xs, ys, values, weights] =
                [&samples.x, &samples.y, &samples.value, &samples.weight];
            assert_eq!(samples.count, expected.len(), "case {case}");
            assert!((share - expected.len() as f64 / f64::from(wanted as u32)).abs() < 1e-9);
            for (i, [x, y, value]) in expected.into_iter().enumerate() {
                assert!(
                    (xs[i] - x).abs() < 1e-4
                        && (ys[i] - y).abs() < 1e-4
                        && (values[i] - value).abs() < 1e-4
                );
                assert_eq!(weights[i], 1.0);
            }
            assert!(
                weights[samples.count..samples.count + PADDING].iter().all(|&weight| weight == 0.0)
            );
        }
    }

    #[test]
    fn an_image_narrower_than_a_bin_holds_no_sample() {
        let image = GrayImage::filled(3, 40, 100);
        let axes = [[20.0, 1.0], [-1.0, 20.0]];
        let window =
            Window { origin: [1.0, 20.0], axes, extent: [0.5; 2], strip_px: f64::INFINITY, bin: 4 };
        assert_eq!(Samples::default().gather(image.view(), &window), 0.0);
    }
}
