//! The pixels that a corner is fitted to: a window along the cells' own axes, in pixels or in sums of 2×2 or 4×4.

use crate::imaging::gray::GrayView;

/// Lanes are filled up to a multiple of this with samples of no weight.
const PADDING: usize = 16;

/// Where to gather samples.
#[derive(Debug, Clone, Copy)]
pub(super) struct Window {
    /// The window's origin, in image pixels.
    pub origin: [f64; 2],
    /// From the corner to its neighbours along the two edges, in image pixels.
    pub axes: [[f64; 2]; 2],
    /// Half the window's extent along each axis, as a fraction of the axis.
    pub extent: [f64; 2],
    /// Side of the squares of image pixels that are averaged into one sample: 1, 2 or 4.
    pub bin: usize,
}

/// Samples of an image, relative to the window's origin and in units of the bin.
#[derive(Debug, Default)]
pub(super) struct Samples {
    /// Positions, x.
    pub x: Vec<f32>,
    /// Positions, y.
    pub y: Vec<f32>,
    /// Grey values, 0 … 255.
    pub value: Vec<f32>,
    /// Square roots of the weights: 1 inside, falling to 0 over the last pixel of the window.
    pub weight: Vec<f32>,
    /// How many samples there are, without the padding.
    pub count: usize,
}

impl Samples {
    /// Gathers the samples of `window`, those whose pixels all lie in `image`. Returns the fraction of the window that
    /// does.
    pub fn gather(&mut self, image: GrayView<'_>, window: &Window) -> f64 {
        self.clear();
        let bin = window.bin as f64;
        let axes = window.axes.map(|[x, y]| [x / bin, y / bin]);
        let det = axes[0][0] * axes[1][1] - axes[0][1] * axes[1][0];
        let dual = [[axes[1][1] / det, -axes[1][0] / det], [-axes[0][1] / det, axes[0][0] / det]];
        // A step of one bin along the dual direction is this much of the axis: the width of the soft border.
        let border = dual.map(|[x, y]| x.hypot(y));
        let reach = |k: usize| {
            (window.extent[0] + border[0]) * axes[0][k].abs() + (window.extent[1] + border[1]) * axes[1][k].abs()
        };
        let (reach_x, reach_y) = (reach(0).ceil() as i64, reach(1).ceil() as i64);
        let half = (bin - 1.0) / 2.0;
        let first = window.origin.map(|o| (o - half).round());
        let (mut inside, mut all) = (0.0, 0.0);
        for j in -reach_y..=reach_y {
            let top = first[1] as i64 + j * window.bin as i64;
            let y = (top as f64 + half - window.origin[1]) / bin;
            for i in -reach_x..=reach_x {
                let left = first[0] as i64 + i * window.bin as i64;
                let x = (left as f64 + half - window.origin[0]) / bin;
                let mut weight = 1.0;
                for k in 0..2 {
                    let along = (dual[k][0] * x + dual[k][1] * y).abs();
                    weight *= ((window.extent[k] - along) / border[k] + 0.5).clamp(0.0, 1.0);
                }
                if weight > 0.0 {
                    all += weight;
                    if let Some(value) = binned(image, left, top, window.bin) {
                        inside += weight;
                        self.push(x as f32, y as f32, value, weight.sqrt() as f32);
                    }
                }
            }
        }
        self.pad();
        inside / f64::max(all, 1.0)
    }

    fn clear(&mut self) {
        for lane in [&mut self.x, &mut self.y, &mut self.value, &mut self.weight] {
            lane.clear();
        }
    }

    fn push(&mut self, x: f32, y: f32, value: f32, weight: f32) {
        self.x.push(x);
        self.y.push(y);
        self.value.push(value);
        self.weight.push(weight);
    }

    fn pad(&mut self) {
        self.count = self.x.len();
        let padded = self.count.next_multiple_of(PADDING);
        for lane in [&mut self.x, &mut self.y, &mut self.value, &mut self.weight] {
            lane.resize(padded, 0.0);
        }
    }
}

fn binned(image: GrayView<'_>, left: i64, top: i64, bin: usize) -> Option<f32> {
    let (left, top) = (usize::try_from(left).ok()?, usize::try_from(top).ok()?);
    if left + bin > image.width() || top + bin > image.height() {
        return None;
    }
    let mut sum = 0;
    for row in top..top + bin {
        sum += image.row(row)[left..left + bin].iter().map(|&v| u32::from(v)).sum::<u32>();
    }
    Some(sum as f32 / (bin * bin) as f32)
}
