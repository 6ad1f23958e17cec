//! The pixels that a corner is fitted to: a window along the cells' own axes, in pixels or in sums of 2×2 or 4×4.

use pulp::{Simd, WithSimd};

use crate::detection::refine::corner_model::length;
use crate::detection::refine::window::Window;
use crate::imaging::gray::GrayView;

/// Lanes are filled up to a multiple of this with samples of no weight.
const PADDING: usize = 16;
/// Pixels that are read at once.
const RUN: usize = 8;

/// Samples of an image, relative to the window's origin and in units of the bin.
#[derive(Debug, Default)]
pub(super) struct Samples {
    /// Positions, x.
    pub x: Vec<f32>,
    /// Positions, y.
    pub y: Vec<f32>,
    /// Grey values, 0 … 255.
    pub value: Vec<f32>,
    /// 1, and 0 for the padding.
    pub weight: Vec<f32>,
    /// How many samples there are, without the padding.
    pub count: usize,
}

impl Samples {
    /// Gathers the samples of `window`, those whose pixels all lie in `image`. Returns the fraction of the window that
    /// does.
    pub fn gather(&mut self, image: GrayView<'_>, window: &Window) -> f64 {
        pulp::Arch::new().dispatch(Gather { samples: self, image, rows: Rows::new(window), window })
    }

    /// Mean grey value where the product of the distances to two lines through the origin is negative, and where it is
    /// positive.
    pub fn quarter_means(&self, along: [[f64; 2]; 2]) -> [f64; 2] {
        pulp::Arch::new().dispatch(QuarterMeans { samples: self, along: along.map(|d| d.map(|v| v as f32)) })
    }

    #[inline(always)]
    fn make_room(&mut self, more: usize) {
        let room = (self.count + more).next_multiple_of(PADDING);
        if self.x.len() < room {
            for lane in [&mut self.x, &mut self.y, &mut self.value, &mut self.weight] {
                lane.resize(room, 0.0);
            }
        }
    }

    /// Appends `length` values of `row` at `y`, from `x` on. Whole lanes are written: what is too much is overwritten by the
    /// next run, or by the padding.
    #[inline(always)]
    fn push_run(&mut self, x: f32, y: f32, row: &[u8], length: usize) {
        self.make_room(length + RUN);
        let steps: [f32; RUN] = std::array::from_fn(|i| i as f32);
        for start in (0..length).step_by(RUN) {
            let bytes: [u8; RUN] = match row.get(start..start + RUN).and_then(|chunk| chunk.try_into().ok()) {
                Some(bytes) => bytes,
                None => std::array::from_fn(|i| row.get(start + i).copied().unwrap_or(0)),
            };
            let lanes = self.count + start..self.count + start + RUN;
            let from = x + start as f32;
            self.value[lanes.clone()].copy_from_slice(&bytes.map(f32::from));
            self.x[lanes.clone()].copy_from_slice(&steps.map(|step| from + step));
            self.y[lanes].copy_from_slice(&[y; RUN]);
        }
        self.count += length;
    }

    /// Appends averages of `BIN` × `BIN` pixels.
    #[inline(always)]
    fn push_binned<const BIN: usize>(&mut self, x: f32, y: f32, rows: [&[u8]; BIN], length: usize) {
        self.make_room(length);
        for i in 0..length {
            let sum: u32 = rows.iter().flat_map(|row| &row[i * BIN..(i + 1) * BIN]).map(|&v| u32::from(v)).sum();
            self.value[self.count + i] = sum as f32 / (BIN * BIN) as f32;
            self.x[self.count + i] = x + i as f32;
            self.y[self.count + i] = y;
        }
        self.count += length;
    }

    #[inline(always)]
    fn pad(&mut self) {
        self.make_room(0);
        let padded = self.count.next_multiple_of(PADDING);
        for lane in [&mut self.x, &mut self.y, &mut self.value, &mut self.weight] {
            lane.truncate(padded);
            lane[self.count..].fill(0.0);
        }
        self.weight[..self.count].fill(1.0);
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
        let lanes = |values| S::as_simd_f32s(values).0;
        let Samples { x, y, value, weight, .. } = self.samples;
        let (x, y, value, weight) = (lanes(x), lanes(y), lanes(value), lanes(weight));
        let along = self.along.map(|d| d.map(|v| simd.splat_f32s(v)));
        let zero = simd.splat_f32s(0.0);
        let mut sums = [zero; 4];
        for i in 0..x.len() {
            let [a, b] = along.map(|[ax, ay]| simd.sub_f32s(simd.mul_f32s(ax, y[i]), simd.mul_f32s(ay, x[i])));
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
    rows: Rows,
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
        let offset = [0, 1].map(|k| (first[k] + half - window.origin[k]) / bin as f64);
        // The columns of bins that lie in the image.
        let inside =
            [-(first[0] as i64).div_euclid(bin), (image.width() as i64 - bin - first[0] as i64).div_euclid(bin)];
        let mut wanted = 0;
        for j in -rows.reach..=rows.reach {
            let y = j as f64 + offset[1];
            let top = first[1] as i64 + j * bin;
            let in_image = top >= 0 && top + bin <= image.height() as i64;
            for run in rows.runs(y) {
                let (from, to) = ((run[0] - offset[0]).ceil() as i64, (run[1] - offset[0]).floor() as i64);
                wanted += (to - from + 1).max(0);
                let (from, to) = (from.max(inside[0]), to.min(inside[1]));
                if !in_image || from > to {
                    continue;
                }
                let x = (from as f64 + offset[0]) as f32;
                let (left, length) = ((first[0] as i64 + from * bin) as usize, (to - from + 1) as usize);
                let row = |k: usize| &image.row(top as usize + k)[left..];
                match window.bin {
                    1 => samples.push_run(x, y as f32, row(0), length),
                    2 => samples.push_binned(x, y as f32, [row(0), row(1)], length),
                    _ => samples.push_binned(x, y as f32, [row(0), row(1), row(2), row(3)], length),
                }
            }
        }
        samples.pad();
        samples.count as f64 / (wanted as f64).max(1.0)
    }
}

/// What each row of a window holds: a parallelogram's run, or what of it is near an edge. In bins.
struct Rows {
    /// Middle per row, and half width, of four bands: two whose meet is the window, two that are near an edge.
    bands: [[f64; 2]; 4],
    /// Rows −reach … reach may hold something.
    reach: i64,
}

impl Rows {
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
            [-b / slope, 1.0 / slope.abs()]
        });
        Self { bands, reach: reach.ceil() as i64 + 1 }
    }

    /// The parts of row `y`: two runs from … to, either of which may be empty.
    #[inline(always)]
    fn runs(&self, y: f64) -> [[f64; 2]; 2] {
        let [a, b, near, other] = self.bands.map(|[middle, half]| [middle * y - half, middle * y + half]);
        let meet = |p: [f64; 2], q: [f64; 2]| [p[0].max(q[0]), p[1].min(q[1])];
        let inside = meet(a, b);
        let (left, right) = if near[0] < other[0] { (near, other) } else { (other, near) };
        if right[0] <= left[1] {
            return [meet(inside, [left[0], left[1].max(right[1])]), [0.0, -2.0]];
        }
        [meet(inside, left), meet(inside, right)]
    }
}
