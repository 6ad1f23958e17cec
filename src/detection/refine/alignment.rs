//! Locates a corner by everything that is printed around it: the print is rendered where the
//! board's other corners place it, and moved until it matches the image best.
//!
//! Where blur merges a corner's edges with the next ones, the window hardly determines the width of
//! the blur, the gray values of black and white and the directions of the edges in addition to the
//! position. But blur and gamma are common to the board, and the neighbors determine how the print
//! lies around the corner. So a corner's own unknowns are its position, its black and its white.
//! These four are fitted by weighted linear least squares, in light (gray values to a power), where
//! blur is linear (B. D. Lucas and T. Kanade: An iterative image registration technique, 1981).

use nalgebra::{Matrix2, Matrix4, Vector2, Vector4};

use crate::detection::refine::print::PrintPatch;
use crate::detection::refine::window::Window;
use crate::imaging::gray::GrayView;

/// The most linearizations, and how many of them have the larger tolerance. The iteration ends when
/// a step is below a hundredth of a sample: convergence is quadratic, so the next step would be its
/// square.
const ITERATIONS: usize = 5;
const PATIENT_ITERATIONS: usize = 2;
const ENOUGH_STEP: f64 = 0.01;
/// The darkest gray level that is raised to a power: one step of eight bits. At 0 the power's slope
/// is 0, and so would be the noise in light.
const DARKEST: f64 = 1.0;
/// Least sum of weights, in samples: three for each of the four unknowns.
const LEAST_SAMPLES: f64 = 12.0;
/// Samples with more weight than this are the inner half: they have half of the window's Gaussian.
const HALF_WEIGHT: f64 = 0.5;

/// Priors of how an image shows the print around a corner.
#[derive(Debug, Clone, Copy)]
pub(super) struct PrintLight {
    /// Gray values to this power are proportional to light.
    pub power: f64,
    /// Standard deviation of a sample in gray levels, where the print is black and where it is
    /// white.
    pub noise: [f64; 2],
    /// Relative change of gray values per sample.
    pub gradient: [f64; 2],
    /// A residual of this many standard deviations of the noise plus this fraction of the contrast
    /// is as likely an outlier as an inlier. The first of the two fractions holds for the first
    /// linearizations.
    pub tolerance: (f64, [f64; 2]),
}

/// The alignment of the print at one corner.
#[derive(Debug, Clone, Copy)]
pub(super) struct Alignment {
    /// How far the print is to be moved, in samples.
    pub offset: [f64; 2],
    /// Covariance of `offset` per unit of noise: xx, xy, yy, in squared samples.
    pub covariance: [f64; 3],
    /// Mean square of the residuals in units of the noise, corrected for the unknowns.
    pub mean_square: f64,
    /// Sum of the samples' weights, each times its robust weight.
    pub samples: f64,
    /// Inlier ratio: that sum relative to the sum without the robust weights.
    pub inlier_ratio: f64,
    /// Black and white, in gray levels.
    pub grays: [f64; 2],
    /// How far the last step changed `offset`, in samples.
    pub last_step: f64,
    /// The difference between the offsets from the inner and from the outer samples, as squares of
    /// two independent components in units of the variance from white noise.
    pub disagreements: Option<[f64; 2]>,
}

/// The samples that are compared with a rendered print.
#[derive(Debug, Default)]
pub(super) struct AlignedSamples {
    samples: Vec<AlignedSample>,
    /// The 256 gray values to `power`.
    lights: Vec<f64>,
    power: f64,
}

/// One sample of the image, with the rendered print there.
#[derive(Debug, Clone, Copy)]
struct AlignedSample {
    gray: f64,
    light: f64,
    /// The print, −1 … 1, and its change per sample.
    print: f64,
    slope: [f64; 2],
    /// The light relative to that at the window's origin.
    lit: f64,
    /// The window's weight.
    weight: f64,
}

impl AlignedSamples {
    /// Gathers the pixels of `image` where `patch` is rendered in `window`, weighted by a Gaussian
    /// whose standard deviation is half of the window's extent. Returns the fraction of that weight
    /// inside the image.
    pub fn gather(
        &mut self,
        image: GrayView<'_>,
        patch: &PrintPatch,
        window: &Window,
        light: &PrintLight,
    ) -> f64 {
        let bin = window.bin;
        let spread = window.extent[0] / bin as f64 / 2.0;
        let half = (bin as f64 - 1.0) / 2.0;
        let offset = patch.offset();
        let reach = patch.reach() - 1;
        let (mut all, mut inside) = (0.0, 0.0);
        self.samples.clear();
        self.set_power(light.power);
        for j in -reach..=reach {
            for i in -reach..=reach {
                let at = [i as f64 + offset[0], j as f64 + offset[1]];
                let weight = (-0.5 * (at[0] * at[0] + at[1] * at[1]) / (spread * spread)).exp();
                all += weight;
                let first = [0, 1].map(|k| window.origin[k] + bin as f64 * at[k] - half);
                let first = first.map(f64::round);
                let Some(mean_light) = mean_of(image, first, bin, &self.lights) else { continue };
                let gray = match bin {
                    1 => f64::from(image.row(first[1] as usize)[first[0] as usize]),
                    _ => mean_light.powf(1.0 / light.power),
                };
                inside += weight;
                let lit =
                    1.0 + light.power * (light.gradient[0] * at[0] + light.gradient[1] * at[1]);
                self.samples.push(AlignedSample {
                    gray,
                    light: mean_light,
                    print: patch.full(i, j),
                    slope: [
                        (patch.full(i + 1, j) - patch.full(i - 1, j)) / 2.0,
                        (patch.full(i, j + 1) - patch.full(i, j - 1)) / 2.0,
                    ],
                    lit: lit.clamp(0.1, 10.0),
                    weight,
                });
            }
        }
        inside / all
    }

    /// The offset of the print, black and white that fit the gathered samples best. `None` where
    /// the samples do not determine them, or white is not brighter than black.
    pub fn align(&self, light: &PrintLight) -> Option<Alignment> {
        let mut found: Option<(Vector4<f64>, Alignment)> = None;
        for iteration in 0..ITERATIONS {
            let part = light.tolerance.1[usize::from(iteration >= PATIENT_ITERATIONS)];
            let before = found.as_ref().map(|(unknowns, it)| (unknowns, it.grays));
            let (unknowns, aligned) = self.step(light, part, before)?;
            let last = found.map_or([0.0; 2], |(_, it)| it.offset);
            let moved = [aligned.offset[0] - last[0], aligned.offset[1] - last[1]];
            let last_step = (moved[0] * moved[0] + moved[1] * moved[1]).sqrt();
            found = Some((unknowns, Alignment { last_step, ..aligned }));
            if iteration >= PATIENT_ITERATIONS && last_step < ENOUGH_STEP {
                break;
            }
        }
        found.map(|(_, aligned)| aligned)
    }

    /// Mean square of the residuals in units of the noise, without robust weights; `None` as for
    /// [`Self::align`].
    pub fn mean_square_of_all(&self, light: &PrintLight) -> Option<f64> {
        let [part, _] = light.tolerance.1;
        self.step(light, part, None).map(|(_, aligned)| aligned.mean_square)
    }

    /// Sets the power that makes gray values proportional to light.
    fn set_power(&mut self, power: f64) {
        if self.power != power {
            self.power = power;
            self.lights.clear();
            self.lights.extend((0..=255).map(|gray| f64::from(gray).max(DARKEST).powf(power)));
        }
    }

    /// Weighted least squares, with the robust weights from the unknowns `before`.
    fn step(
        &self,
        light: &PrintLight,
        part: f64,
        before: Option<(&Vector4<f64>, [f64; 2])>,
    ) -> Option<(Vector4<f64>, Alignment)> {
        let [mut inner, mut outer] = [AlignmentSums::default(), AlignmentSums::default()];
        for sample in &self.samples {
            let row = sample.row();
            let (noise, trust) = match before {
                None => (light.noise_of_light(sample.gray, 0.0), 1.0),
                Some((unknowns, [black, white])) => {
                    let predicted = row.dot(unknowns).max(0.0).powf(1.0 / light.power);
                    let (most, noise) = (light.tolerance.0, light.noise_of_gray(sample.print));
                    let tolerance = most * noise + part * (white - black) / 2.0;
                    let off = (sample.gray - predicted) / tolerance;
                    let trust = 1.0 / (1.0 + off * off);
                    (light.noise_of_light(predicted, sample.print), trust * trust)
                }
            };
            let half = if sample.weight > HALF_WEIGHT { &mut inner } else { &mut outer };
            half.add(&row, sample.light, sample.weight, trust, noise);
        }
        let halves = [inner.offset(), outer.offset()];
        let sums = inner.with(&outer);
        if sums.trusted < LEAST_SAMPLES {
            return None;
        }
        let inverse = sums.normal.try_inverse()?;
        let unknowns = inverse * sums.right;
        let contrast = unknowns[1];
        let grays = [unknowns[0] - contrast, unknowns[0] + contrast]
            .map(|light_there| light_there.max(0.0).powf(1.0 / light.power));
        if !(contrast > 0.0 && grays[1].is_finite()) {
            return None;
        }
        let spread = inverse * sums.squared * inverse / (contrast * contrast);
        let squares = sums.squares - unknowns.dot(&sums.right);
        let free = sums.trusted - (inverse * sums.squared).trace();
        let noise = light.noise[0].max(light.noise[1]);
        let tolerance = light.tolerance.0 * noise + part * (grays[1] - grays[0]) / 2.0;
        let loss = 4.0 * noise * noise / (tolerance * tolerance);
        let aligned = Alignment {
            offset: [unknowns[2] / contrast, unknowns[3] / contrast],
            covariance: [spread[(2, 2)], spread[(2, 3)], spread[(3, 3)]],
            mean_square: squares.max(0.0) / free.max(1.0) * (1.0 + loss),
            samples: sums.trusted,
            inlier_ratio: sums.trusted / sums.weights,
            grays,
            last_step: 0.0,
            disagreements: halves[0].zip(halves[1]).and_then(|(a, b)| a.disagreements(&b)),
        };
        Some((unknowns, aligned))
    }
}

impl AlignedSample {
    /// The derivatives of its light by the mean of black and white, by half their difference, and
    /// by that times each of the two offsets.
    fn row(&self) -> Vector4<f64> {
        let [x, y] = self.slope;
        Vector4::new(1.0, self.print, -x, -y) * self.lit
    }
}

impl PrintLight {
    /// Standard deviation of a sample in gray levels where the print has this value.
    fn noise_of_gray(&self, print: f64) -> f64 {
        let [black, white] = self.noise;
        (black + white) / 2.0 + (white - black) / 2.0 * print.clamp(-1.0, 1.0)
    }

    /// The same in units of light, at this gray value.
    fn noise_of_light(&self, gray: f64, print: f64) -> f64 {
        let slope = self.power * gray.max(DARKEST).powf(self.power - 1.0);
        self.noise_of_gray(print) * slope
    }
}

/// The sums of a linearization.
#[derive(Default)]
struct AlignmentSums {
    normal: Matrix4<f64>,
    right: Vector4<f64>,
    /// As `normal`, with the squares of the weights.
    squared: Matrix4<f64>,
    /// Of the samples' squares.
    squares: f64,
    /// Of the weights, and of the weights times the robust weights.
    weights: f64,
    trusted: f64,
}

/// The offset of the print from one half of the samples.
#[derive(Debug, Clone, Copy)]
struct HalfOffset {
    offset: Vector2<f64>,
    /// Per unit of noise.
    covariance: Matrix2<f64>,
}

impl HalfOffset {
    fn disagreements(&self, other: &Self) -> Option<[f64; 2]> {
        let factors = (self.covariance + other.covariance).cholesky()?;
        let difference = factors.l().solve_lower_triangular(&(self.offset - other.offset))?;
        Some([difference.x * difference.x, difference.y * difference.y])
    }
}

impl AlignmentSums {
    fn with(&self, other: &Self) -> Self {
        Self {
            normal: self.normal + other.normal,
            right: self.right + other.right,
            squared: self.squared + other.squared,
            squares: self.squares + other.squares,
            weights: self.weights + other.weights,
            trusted: self.trusted + other.trusted,
        }
    }

    /// The offset from these sums alone; `None` where they do not determine it.
    fn offset(&self) -> Option<HalfOffset> {
        let inverse = self.normal.try_inverse()?;
        let unknowns = inverse * self.right;
        let contrast = unknowns[1];
        let spread = inverse * self.squared * inverse / (contrast * contrast);
        (contrast > 0.0).then(|| HalfOffset {
            offset: Vector2::new(unknowns[2], unknowns[3]) / contrast,
            covariance: spread.fixed_view::<2, 2>(2, 2).into_owned(),
        })
    }

    fn add(&mut self, row: &Vector4<f64>, light: f64, weight: f64, trust: f64, noise: f64) {
        let trusted = weight * trust;
        let certainty = trusted / (noise * noise);
        let outer = row * row.transpose();
        self.normal += outer * certainty;
        self.squared += outer * (certainty * trusted);
        self.right += row * (light * certainty);
        self.squares += light * light * certainty;
        self.weights += weight;
        self.trusted += trusted;
    }
}

/// The mean of the `lights` of `bin` × `bin` pixels from `first` on; `None` outside the image.
fn mean_of(image: GrayView<'_>, first: [f64; 2], bin: usize, lights: &[f64]) -> Option<f64> {
    let [x, y] = first;
    if x < 0.0 || y < 0.0 {
        return None;
    }
    let (x, y) = (x as usize, y as usize);
    if x + bin > image.width() || y + bin > image.height() {
        return None;
    }
    let rows = (y..y + bin).map(|row| &image.row(row)[x..x + bin]);
    let sum: f64 = rows.flatten().map(|&pixel| lights[usize::from(pixel)]).sum();
    Some(sum / (bin * bin) as f64)
}

#[cfg(test)]
#[path = "alignment_tests.rs"]
mod tests;
