use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};

use super::*;
use crate::detection::refine::print::BoardPrint;
use crate::detection::refine::print_blur::PrintBlur;
use crate::geometry::pixel::Pixel;
use crate::imaging::gray::GrayImage;

/// A chessboard of cells of ten pixels, slightly rotated, with a crossing at `corner`.
struct Cells {
    corner: [f64; 2],
}

const CELL_PX: f64 = 10.0;
const ROTATION: [f64; 2] = [0.955, 0.296];

/// The integral of the square wave of period 2 that is 1 from 0 to 1 and −1 from there to 2.
fn integral(x: f64) -> f64 {
    1.0 - (x.rem_euclid(2.0) - 1.0).abs()
}

impl BoardPrint for Cells {
    fn put(&mut self, _: &[Option<Pixel>]) {}

    fn place_of(&self, _: usize, pixel: [f64; 2]) -> Option<[f64; 2]> {
        let [x, y] = [0, 1].map(|k| (pixel[k] - self.corner[k]) / CELL_PX);
        let [cos, sin] = ROTATION;
        Some([cos * x + sin * y, cos * y - sin * x])
    }

    fn mean(&self, place: [f64; 2], half: [f64; 2]) -> f32 {
        let wave = |k: usize| {
            (integral(place[k] + half[k]) - integral(place[k] - half[k])) / (2.0 * half[k])
        };
        (wave(0) * wave(1)) as f32
    }

    fn mean_of_edges(&self, _: usize, _: [f64; 2], _: [f64; 2]) -> f32 {
        0.0
    }

    fn expected(&self, _: usize) -> Option<[f64; 2]> {
        Some(self.corner)
    }

    fn room(&self) -> f64 {
        1.0
    }
}

fn window(origin: [f64; 2], reach_px: f64) -> Window {
    Window {
        origin,
        axes: [[1.0, 0.0], [0.0, 1.0]],
        extent: [reach_px; 2],
        strip_px: f64::INFINITY,
        bin: 1,
    }
}

const BLUR_PX: f64 = 3.0;
const POWER: f64 = 2.2;
const NOISE: f64 = 2.0;

fn normal(rng: &mut ChaCha8Rng) -> f64 {
    StandardNormal.sample(rng)
}

/// The cells around `corner`, through a camera with a gamma, with noise.
fn image_of(corner: [f64; 2], rng: &mut ChaCha8Rng) -> GrayImage {
    let mut patch = PrintPatch::default();
    patch.draw(&Cells { corner }, 0, &window([26.0; 2], 25.0), PrintBlur::round(BLUR_PX));
    let mut image = GrayImage::filled(53, 53, 0);
    for (at, pixel) in image.pixels_mut().iter_mut().enumerate() {
        let (i, j) = ((at % 53) as i64 - 26, (at / 53) as i64 - 26);
        let [black, white] = [60.0_f64, 200.0].map(|gray| gray.powf(POWER));
        let light = (white + black) / 2.0 + (white - black) / 2.0 * patch.full(i, j);
        *pixel = (light.powf(1.0 / POWER) + NOISE * normal(rng)).round() as u8;
    }
    image
}

fn light() -> PrintLight {
    PrintLight {
        power: POWER,
        noise: [NOISE; 2],
        gradient: [0.0; 2],
        tolerance: (4.0, [0.4, 0.08]),
    }
}

fn aligned(image: &GrayImage, placed: [f64; 2]) -> Alignment {
    let window = window(placed, 3.5 * BLUR_PX);
    let mut patch = PrintPatch::default();
    patch.draw(&Cells { corner: placed }, 0, &window, PrintBlur::round(BLUR_PX));
    let mut samples = AlignedSamples::default();
    assert!(samples.gather(image.view(), &patch, &window, &light()) > 0.99);
    samples.align(&light()).unwrap()
}

#[test]
fn a_corner_among_others_is_found_as_exactly_as_it_says() {
    let mut rng = ChaCha8Rng::seed_from_u64(7);
    let truth = [26.3, 25.8];
    let (mut sum, mut squares, mut predicted) = ([0.0; 2], 0.0, 0.0);
    const IMAGES: usize = 400;
    for _ in 0..IMAGES {
        let image = image_of(truth, &mut rng);
        // The start is accurate to two tenths of a pixel.
        let placed = [0, 1].map(|k| truth[k] + 0.1 * normal(&mut rng));
        let found = aligned(&image, placed);
        let off = [0, 1].map(|k| placed[k] + found.offset[k] - truth[k]);
        sum = [sum[0] + off[0], sum[1] + off[1]];
        squares += off[0] * off[0] + off[1] * off[1];
        predicted += (found.covariance[0] + found.covariance[2]) * found.mean_square;
        assert!(found.inlier_ratio > 0.9, "{found:?}");
    }
    let rms = (squares / IMAGES as f64).sqrt();
    let ratio = (squares / predicted).sqrt();
    let bias = sum.map(|v| (v / IMAGES as f64).abs());
    assert!(rms < 0.03 && (0.9..1.1).contains(&ratio), "{rms} px, {ratio} of what was predicted");
    assert!(bias[0].max(bias[1]) < 4.0 * rms / (2.0 * IMAGES as f64).sqrt(), "{bias:?}");
}

/// Instead of the noise of `image_of`: noise of the same standard deviation that is common to 3 × 3
/// pixels, as after a camera's noise reduction.
fn with_shared_noise(corner: [f64; 2], rng: &mut ChaCha8Rng) -> GrayImage {
    let mut still = image_of(corner, &mut ChaCha8Rng::seed_from_u64(0));
    let own: Vec<f64> = (0..53 * 53).map(|_| normal(rng)).collect();
    let mut calm = vec![0.0; 53 * 53];
    const IMAGES: u64 = 64;
    for seed in 0..IMAGES {
        let image = image_of(corner, &mut ChaCha8Rng::seed_from_u64(seed));
        for (sum, pixel) in calm.iter_mut().zip(image.pixels()) {
            *sum += f64::from(*pixel) / IMAGES as f64;
        }
    }
    for (at, pixel) in still.pixels_mut().iter_mut().enumerate() {
        let (x, y) = (at % 53, at / 53);
        let (x, y) = (x.clamp(1, 51), y.clamp(1, 51));
        let shared: f64 =
            (0..9).map(|k| own[(y + k / 3 - 1) * 53 + x + k % 3 - 1]).sum::<f64>() / 3.0;
        *pixel = (calm[at] + NOISE * shared).round() as u8;
    }
    still
}

/// The rms error relative to its prediction, without and with the disagreement of the inner and the
/// outer samples over all images; and the mean square of that disagreement.
fn honesty(of: impl Fn([f64; 2], &mut ChaCha8Rng) -> GrayImage, images: usize) -> [f64; 3] {
    let mut rng = ChaCha8Rng::seed_from_u64(11);
    let truth = [26.3, 25.8];
    let (mut squares, mut predicted, mut difference) = (0.0, 0.0, 0.0);
    for _ in 0..images {
        let found = aligned(&of(truth, &mut rng), truth);
        squares += found.offset[0].powi(2) + found.offset[1].powi(2);
        predicted += (found.covariance[0] + found.covariance[2]) * found.mean_square;
        let [a, b] = found.disagreements.unwrap();
        difference += (a + b) / found.mean_square / 2.0 / images as f64;
    }
    [(squares / predicted).sqrt(), (squares / predicted / difference).sqrt(), difference]
}

#[test]
fn noise_that_pixels_share_shows_between_inner_and_outer_samples() {
    let [ratio, _, difference] = honesty(image_of, 400);
    assert!(
        (0.9..1.1).contains(&ratio) && (0.85..1.15).contains(&difference),
        "{ratio}, {difference}"
    );
    let [alone, ratio, difference] = honesty(with_shared_noise, 100);
    assert!(alone > 2.0 && difference > 3.0, "{alone}, {difference}");
    assert!((0.7..1.4).contains(&ratio), "{ratio}");
}

#[test]
fn an_occluder_is_seen_in_the_residuals() {
    let mut rng = ChaCha8Rng::seed_from_u64(9);
    let truth = [26.3, 25.8];
    let mut image = image_of(truth, &mut rng);
    // A gray bar that begins four pixels beside the corner.
    for (at, pixel) in image.pixels_mut().iter_mut().enumerate() {
        if at % 53 > 30 {
            *pixel = 130;
        }
    }
    let found = aligned(&image, truth);
    let off = found.offset[0].hypot(found.offset[1]);
    assert!(found.inlier_ratio < 0.9 || found.mean_square > 2.0, "{found:?}");
    assert!(off < 1.0, "{found:?}");
}

#[test]
fn what_shows_no_print_is_not_aligned() {
    let flat = GrayImage::filled(53, 53, 90);
    let window = window([26.0; 2], 3.5 * BLUR_PX);
    let mut patch = PrintPatch::default();
    patch.draw(&Cells { corner: [26.0; 2] }, 0, &window, PrintBlur::round(BLUR_PX));
    let mut samples = AlignedSamples::default();
    samples.gather(flat.view(), &patch, &window, &light());
    let contrast = samples.align(&light()).map_or(0.0, |it| it.grays[1] - it.grays[0]);
    assert!(contrast < 1.0, "{contrast}");
}
