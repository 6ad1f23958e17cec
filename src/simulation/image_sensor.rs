//! A camera's sensor: its lens, and the conversion of light to gray values.

use rand::RngExt;
use rand_distr::StandardNormal;

use crate::geometry::lens::Lens;
use crate::geometry::pixel::ImageSize;
use crate::imaging::gray::GrayImage;
use crate::simulation::noise::{Purpose, stream};

/// An 8-bit gray sensor behind a lens.
#[derive(Debug, Clone, PartialEq)]
pub struct ImageSensor {
    /// Its size in pixels.
    pub size: ImageSize,
    /// Its optics.
    pub lens: Lens,
    /// σ of the optical blur, in pixels.
    pub blur_px: f64,
    /// How long the shutter is open, in seconds: motion during this time blurs the image.
    pub exposure_s: f64,
    /// The brightness of the image: a surface that reflects all light has this part of full scale.
    pub exposure_gain: f64,
    /// Electrons at full scale: the standard deviation of shot noise is the square root of their
    /// number.
    pub full_well_e: f64,
    /// σ of a pixel's read noise, in electrons.
    pub read_noise_e: f64,
    /// Gray values are light to the power 1/gamma.
    pub gamma: f64,
    /// The part of the light that is lost in the corners of the image, 0 to 1.
    pub vignetting: f64,
}

impl ImageSensor {
    /// A good machine-vision camera: blur 0.7 px, 4 ms, 10 000 electrons, 6 e⁻ read noise, gamma
    /// 2.2, 25 % vignetting.
    pub fn new(size: ImageSize, lens: Lens) -> Self {
        Self {
            size,
            lens,
            blur_px: 0.7,
            exposure_s: 0.004,
            exposure_gain: 0.9,
            full_well_e: 10_000.0,
            read_noise_e: 6.0,
            gamma: 2.2,
            vignetting: 0.25,
        }
    }

    /// The image of `light` (one value for each pixel; 1 is the light that a perfect white
    /// reflects), with the noise of the `index`-th image of `seed`.
    pub fn develop(&self, light: &[f32], seed: u64, index: u64) -> GrayImage {
        let (width, height) = (self.size.width as usize, self.size.height as usize);
        let mut image = GrayImage::filled(width, height, 0);
        let mut rng = stream(seed, Purpose::Image, index);
        let tone = ToneCurve::new(self.gamma);
        let center = self.size.center();
        let corner2 = center.x.powi(2) + center.y.powi(2);
        for (k, (value, light)) in image.pixels_mut().iter_mut().zip(light).enumerate() {
            let [dx, dy] = [(k % width) as f64 - center.x, (k / width) as f64 - center.y];
            let shading = 1.0 - self.vignetting * (dx * dx + dy * dy) / corner2.max(1.0);
            let electrons =
                (f64::from(*light) * shading * self.exposure_gain * self.full_well_e).max(0.0);
            let sigma = (electrons + self.read_noise_e * self.read_noise_e).sqrt();
            let normal: f64 = rng.sample(StandardNormal);
            *value = tone.value((electrons + sigma * normal) / self.full_well_e);
        }
        image
    }
}

/// Light to 8 bits, by a table: the same on every machine except for the rounding of the table
/// itself.
struct ToneCurve {
    table: Vec<f32>,
}

impl ToneCurve {
    // Sixteen to a gray level: interpolated between, the curve is exact to far less than one.
    const STEPS: usize = 4096;

    fn new(gamma: f64) -> Self {
        let value =
            |step: usize| (255.0 * (step as f64 / Self::STEPS as f64).powf(1.0 / gamma)) as f32;
        Self { table: (0..=Self::STEPS).map(value).collect() }
    }

    fn value(&self, light: f64) -> u8 {
        let at = light.clamp(0.0, 1.0) * Self::STEPS as f64;
        let step = (at as usize).min(Self::STEPS - 1);
        let part = (at - step as f64) as f32;
        (self.table[step] + part * (self.table[step + 1] - self.table[step])).round() as u8
    }
}
