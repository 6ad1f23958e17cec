//! An image of 32-bit floats, and its Gaussian blur.

/// Rows of floats without padding.
#[derive(Debug, Clone, Default)]
pub(super) struct Plane {
    pub width: usize,
    pub height: usize,
    pub values: Vec<f32>,
}

/// A Gaussian is cut off at this many standard deviations: 5e-4 of its weight lies beyond.
const REACH_SIGMAS: f64 = 3.5;

impl Plane {
    pub fn zeros(width: usize, height: usize) -> Self {
        Self { width, height, values: vec![0.0; width * height] }
    }

    pub fn row(&self, y: usize) -> &[f32] {
        &self.values[y * self.width..(y + 1) * self.width]
    }

    pub fn at(&self, x: usize, y: usize) -> f32 {
        self.values[y * self.width + x]
    }

    /// Every second pixel of every second row.
    pub fn halved(&self) -> Self {
        let (width, height) = (self.width / 2, self.height / 2);
        let rows = (0..height).flat_map(|y| self.row(2 * y).iter().step_by(2).take(width));
        Self { width, height, values: rows.copied().collect() }
    }

    /// Twice as many pixels each way by linear interpolation: pixel (x, y) is at (2 x, 2 y).
    pub fn doubled(&self) -> Self {
        let (width, height) = (2 * self.width, 2 * self.height);
        let mut doubled = Self::zeros(width, height);
        for (y, row) in doubled.values.chunks_exact_mut(width.max(1)).enumerate() {
            let (above, below) = (self.row(y / 2), self.row(y.div_ceil(2).min(self.height - 1)));
            for (x, value) in row.iter_mut().enumerate() {
                let (left, right) = (x / 2, x.div_ceil(2).min(self.width - 1));
                *value = 0.25 * (above[left] + above[right] + below[left] + below[right]);
            }
        }
        doubled
    }

    /// Blurred with a Gaussian of standard deviation `sigma` pixels; edge pixels are repeated.
    pub fn blurred(&self, sigma: f64) -> Self {
        let mut blurred = Self::zeros(self.width, self.height);
        let kernel = kernel(sigma);
        pulp::Arch::new().dispatch(Blur { source: self, kernel: &kernel, into: &mut blurred });
        blurred
    }
}

/// Half of a normalized Gaussian: the center, then the weights 1, 2, … pixels from it.
fn kernel(sigma: f64) -> Vec<f32> {
    let radius = (REACH_SIGMAS * sigma).ceil().max(1.0) as usize;
    let weight = |k: usize| (-0.5 * (k as f64 / sigma).powi(2)).exp();
    let sum: f64 = 1.0 + 2.0 * (1..=radius).map(weight).sum::<f64>();
    (0..=radius).map(|k| (weight(k) / sum) as f32).collect()
}

struct Blur<'a> {
    source: &'a Plane,
    kernel: &'a [f32],
    into: &'a mut Plane,
}

impl pulp::NullaryFnOnce for Blur<'_> {
    type Output = ();

    #[inline(always)]
    fn call(self) {
        let Self { source, kernel, into } = self;
        let (width, height, radius) = (source.width, source.height, kernel.len() - 1);
        let mut padded = vec![0.0_f32; width + 2 * radius];
        for (y, out) in into.values.chunks_exact_mut(width.max(1)).enumerate() {
            // Down the columns first, a whole row at a time, into the padded row.
            let middle = &mut padded[radius..radius + width];
            let above = |k: usize| source.row(y.saturating_sub(k));
            let below = |k: usize| source.row((y + k).min(height - 1));
            sums(kernel, above, below, middle);
            let (first, last) = (padded[radius], padded[radius + width - 1]);
            padded[..radius].fill(first);
            padded[radius + width..].fill(last);
            sums(kernel, |k| &padded[radius - k..], |k| &padded[radius + k..], out);
        }
    }
}

/// The sums of the values `k` pixels before and behind, weighted by the kernel.
#[inline(always)]
fn sums<'a>(
    kernel: &[f32],
    before: impl Fn(usize) -> &'a [f32],
    behind: impl Fn(usize) -> &'a [f32],
    out: &mut [f32],
) {
    for (sum, value) in out.iter_mut().zip(before(0)) {
        *sum = kernel[0] * value;
    }
    let mut k = 1;
    // Two weights at a time: each sum is read and written half as often.
    while let Some([weight, next]) = kernel.get(k..k + 2) {
        let near = before(k).iter().zip(behind(k));
        let far = before(k + 1).iter().zip(behind(k + 1));
        for ((sum, (a, b)), (c, d)) in out.iter_mut().zip(near).zip(far) {
            *sum = (*sum + weight * (a + b)) + next * (c + d);
        }
        k += 2;
    }
    if let Some(weight) = kernel.get(k) {
        for ((sum, a), b) in out.iter_mut().zip(before(k)).zip(behind(k)) {
            *sum += weight * (a + b);
        }
    }
}
