//! Tests of seeded scenes with exact ground truth: errors compared with their predictions, and
//! refusals.

use nalgebra::{Point2, Point3, Vector2, Vector3};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

use super::conditions::SceneConditions;
use super::correspondence::SceneImage;
use super::fitted_lens::LensFit;
use super::lens_differences::{self, OwnLensDifference, other_lenses};
use super::lens_fit::fit_lens;
use super::{SceneOptions, SceneRefusal, calibrate_scene};
use crate::estimation::interrupt::Interrupt;
use crate::estimation::problem::LensChoice;
use crate::estimation::scene::hypotheses::reconstruct_best;
use crate::estimation::scene::problem::{SceneProblem, TrackPoint};
use crate::estimation::scene::reconstruction::ImagePair;
use crate::estimation::two_view::PointPair;
use crate::estimation::two_view::fundamental::fundamental_from_many;
use crate::geometry::lens::{Lens, LensModel};
use crate::geometry::pixel::{ImageSize, Pixel};
use crate::geometry::pose::Pose;
use crate::imaging::gray::GrayImage;

const SIZE: ImageSize = ImageSize::new(1280, 960);
const NOISE_PX: f64 = 0.4;

/// The camera's motion.
#[derive(Clone, Copy)]
enum Motion {
    Orbit,
    Forward,
}

struct Seeded {
    random: ChaCha8Rng,
}

impl Seeded {
    fn uniform(&mut self, reach: f64) -> f64 {
        self.random.random_range(-reach..reach)
    }

    fn gauss(&mut self) -> f64 {
        (0..12).map(|_| self.uniform(0.5)).sum()
    }
}

fn truth() -> Lens {
    Lens::from_parameters(LensModel::Radial, &[1150.0, 1150.0, 652.0, 471.0, 0.0, -0.08]).unwrap()
}

fn cameras(motion: Motion, seeded: &mut Seeded) -> Vec<Pose> {
    let camera = |k: i32, seeded: &mut Seeded| {
        let part = f64::from(k) / 7.0 - 0.5;
        let (rotation, center) = match motion {
            Motion::Orbit => (
                Vector3::new(seeded.uniform(0.15), 0.9 * part, if k % 3 == 0 { 1.3 } else { 0.0 }),
                Point3::new(
                    6.0 * f64::sin(0.9 * part),
                    seeded.uniform(0.8),
                    -6.0 * f64::cos(0.9 * part),
                ),
            ),
            Motion::Forward => (
                Vector3::new(seeded.uniform(0.01), seeded.uniform(0.01), seeded.uniform(0.01)),
                Point3::new(seeded.uniform(0.02), seeded.uniform(0.02), -8.0 + 3.0 * part),
            ),
        };
        // The roll comes last: the camera keeps pointing at the scene.
        let pan =
            Pose::from_axis_angle(Vector3::new(rotation.x, rotation.y, 0.0), Vector3::zeros());
        let roll = Pose::from_axis_angle(Vector3::new(0.0, 0.0, rotation.z), Vector3::zeros());
        let rotation = roll * pan;
        Pose::new(rotation.rotation(), -(rotation * center.coords))
    };
    (0..8).map(|k| camera(k, seeded)).collect()
}

fn scene(seed: u64, motion: Motion) -> (SceneProblem, Vec<ImagePair>) {
    let mut seeded = Seeded { random: ChaCha8Rng::seed_from_u64(seed) };
    let (lens, poses) = (truth(), cameras(motion, &mut seeded));
    let mut tracks = Vec::new();
    for _ in 0..500 {
        let point = Point3::new(seeded.uniform(2.5), seeded.uniform(2.0), seeded.uniform(1.5));
        let mut track = Vec::new();
        for (image, pose) in poses.iter().enumerate() {
            let Some(pixel) = lens.pixel_from_point(&(*pose * point)) else { continue };
            let (dx, dy) = (NOISE_PX * seeded.gauss(), NOISE_PX * seeded.gauss());
            if SIZE.contains(pixel) && seeded.uniform(1.0) < 0.2 {
                let pixel = Pixel::new(pixel.x + dx, pixel.y + dy);
                track.push(TrackPoint { image, pixel, scale_px: 2.0, std_px: 0.2 });
            }
        }
        if track.len() >= 2 {
            tracks.push(track);
        }
    }
    let interrupt = Interrupt::default();
    let problem = SceneProblem { image_size: SIZE, images: 8, tracks, interrupt };
    let pairs = pairs(&problem);
    (problem, pairs)
}

fn pairs(problem: &SceneProblem) -> Vec<ImagePair> {
    let pairs = (0..8).flat_map(|i| (i + 1..8).map(move |j| (i, j)));
    pairs.filter_map(|(i, j)| pair(problem, i, j)).collect()
}

fn pair(problem: &SceneProblem, first: usize, second: usize) -> Option<ImagePair> {
    let at = |track: &[TrackPoint], image: usize| {
        let seen = track.iter().find(|seen| seen.image == image)?;
        Some(Point2::new(seen.pixel.x, seen.pixel.y))
    };
    let matches: Vec<PointPair> = problem
        .tracks
        .iter()
        .filter_map(|track| {
            Some(PointPair { first: at(track, first)?, second: at(track, second)? })
        })
        .collect();
    let fundamental = fundamental_from_many(&matches)?;
    Some(ImagePair { first, second, fundamental, matches })
}

fn fitted(seed: u64, motion: Motion, model: LensModel) -> LensFit {
    let (problem, pairs) = scene(seed, motion);
    let start = reconstruct_best(&problem, &pairs, None).unwrap();
    assert_eq!(start.images.len(), 8);
    fit_lens(&start, LensChoice::Model(model), &[]).unwrap()
}

#[test]
fn errors_are_as_large_as_predicted() {
    let (mut sum, mut count, mut within) = (0.0, 0, 0);
    for seed in 0..6 {
        let found = fitted(seed, Motion::Orbit, LensModel::Radial);
        let (estimate, truth) = (found.fit.state.lens.parameters(), truth().parameters());
        for (k, parameter) in found.fit.bundle.free.iter().enumerate() {
            let std = found.covariance.matrix[(k, k)].sqrt();
            let z = (estimate[*parameter] - truth[*parameter]) / std;
            sum += z * z;
            count += 1;
            within += usize::from(z.abs() < 2.0);
        }
        let noise_px = found.fit.noise_factor * 0.2;
        assert!((noise_px / NOISE_PX - 1.0).abs() < 0.1, "{noise_px}");
        let focal_error = estimate[0] / truth[0] - 1.0;
        assert!(focal_error.abs() < 0.004, "seed {seed}: {focal_error}");
    }
    // The errors of the five parameters of one scene are correlated.
    let rms = f64::sqrt(sum / f64::from(count));
    assert!((0.5..1.5).contains(&rms) && within * 100 >= 80 * count as usize, "{rms} {within}");
}

#[test]
fn more_coefficients_than_needed_do_no_harm() {
    for model in [LensModel::Brown, LensModel::KannalaBrandt] {
        let found = fitted(3, Motion::Orbit, model);
        let matrix = found.fit.state.lens.matrix;
        let std = found.covariance.matrix[(0, 0)].sqrt();
        assert!((matrix.fx - 1150.0).abs() < 3.0 * std && std < 12.0, "{model} {matrix:?} {std}");
    }
}

#[test]
fn images_rotated_by_half_a_circle_are_named() {
    for seed in 0..3 {
        for rotates in [false, true] {
            let (mut problem, _) = scene(seed, Motion::Orbit);
            for seen in problem.tracks.iter_mut().flatten() {
                if rotates && seen.image % 2 == 1 {
                    let (right, bottom) = (f64::from(SIZE.width - 1), f64::from(SIZE.height - 1));
                    seen.pixel = Pixel::new(right - seen.pixel.x, bottom - seen.pixel.y);
                }
            }
            let start = reconstruct_best(&problem, &pairs(&problem), None).unwrap();
            let mut fit = fit_lens(&start, LensChoice::Model(LensModel::Radial), &[]).unwrap();
            let others = other_lenses(&start, &fit);
            assert_eq!(!others.is_empty(), rotates, "seed {seed}: {others:?}");
            let Some(others) = others.into_iter().next() else { continue };
            let OwnLensDifference::Center { offset_px, .. } = others.difference else {
                panic!("{others:?}");
            };
            // The principal point is 12.5 px to the right of the middle and 8.5 px above it.
            let is_odd = others.poses.iter().all(|pose| start.images[*pose] % 2 == 1);
            let expected = Vector2::new(-25.0, 17.0) * if is_odd { 1.0 } else { -1.0 };
            assert!((offset_px - expected).norm() < 3.0, "seed {seed}: {others:?}");
            lens_differences::widen(&mut fit, &others);
            let (found, truth) = (fit.fit.state.lens.parameters(), truth().parameters());
            for k in [Lens::CX, Lens::CY] {
                let std = fit.covariance.matrix[(k, k)].sqrt();
                assert!((found[k] - truth[k]).abs() < 2.0 * std, "{} ± {std}", found[k]);
            }
        }
    }
}

#[test]
fn pixels_that_are_not_square_are_found() {
    const ASPECT: f64 = 1.067;
    for seed in 0..3 {
        let (mut problem, pairs) = scene(seed, Motion::Orbit);
        let square = reconstruct_best(&problem, &pairs, None).unwrap();
        let fit = fit_lens(&square, LensChoice::Model(LensModel::Radial), &[]).unwrap();
        assert!(fit.stretched < 0.01, "seed {seed}: {}", fit.stretched);
        problem.image_size = ImageSize::new(1200, 960);
        let narrowed = |x: f64| (x + 0.5) / ASPECT - 0.5;
        for seen in problem.tracks.iter_mut().flatten() {
            seen.pixel = Pixel::new(narrowed(seen.pixel.x), seen.pixel.y);
        }
        let start = reconstruct_best(&problem, &self::pairs(&problem), None).unwrap();
        let fit = fit_lens(&start, LensChoice::Model(LensModel::Radial), &[]).unwrap();
        assert!(fit.stretched > 0.99, "seed {seed}: {}", fit.stretched);
        let (found, matrix) = (fit.fit.state.lens.parameters(), truth().matrix);
        let expected = [matrix.fx / ASPECT, matrix.fy, narrowed(matrix.cx), matrix.cy];
        for (k, expected) in expected.into_iter().enumerate() {
            let std = fit.covariance.matrix[(k, k)].sqrt();
            assert!((found[k] - expected).abs() < 3.0 * std, "{k}: {} ± {std}", found[k]);
        }
    }
}

#[test]
fn forward_motion_is_seen_as_such() {
    let (problem, pairs) = scene(1, Motion::Forward);
    let start = reconstruct_best(&problem, &pairs, None).unwrap();
    let found = fit_lens(&start, LensChoice::Model(LensModel::Radial), &[]).unwrap();
    let conditions = SceneConditions::of(&found.fit.bundle, &found.fit.state);
    assert!(conditions.sideways_deg < 20.0 && conditions.rolled_deg < 45.0, "{conditions:?}");
}

#[test]
fn what_cannot_be_calibrated_is_refused_by_name() {
    let image = |name: &str, gray: &GrayImage| SceneImage::of(name.to_owned(), gray.view());
    let options = SceneOptions::default();
    let textured = |width: usize, height: usize| {
        let mut random = ChaCha8Rng::seed_from_u64(9);
        let blocks: Vec<u8> = (0..width * height).map(|_| random.random_range(0..255)).collect();
        let at = |k: usize| blocks[(k / width / 5 * width) + (k % width) / 5];
        GrayImage::from_pixels(width, height, (0..width * height).map(at).collect()).unwrap()
    };
    let (texture, other) = (textured(320, 240), textured(240, 320));
    let ended = SceneOptions { interrupt: Interrupt::new(), ..SceneOptions::default() };
    ended.interrupt.request();
    let three = [image("a", &texture), image("b", &texture), image("c", &texture)];
    assert_eq!(calibrate_scene(&three, &ended), Err(SceneRefusal::Interrupted));
    let two = [image("a", &texture), image("b", &texture)];
    assert_eq!(calibrate_scene(&two, &options), Err(SceneRefusal::TooFewImages { images: 2 }));
    let same = [image("a", &texture), image("b", &texture), image("c", &texture)];
    assert_eq!(calibrate_scene(&same, &options), Err(SceneRefusal::Still));
    let mirrored: Vec<u8> = texture.pixels().iter().rev().copied().collect();
    let mirrored = GrayImage::from_pixels(320, 240, mirrored).unwrap();
    let copied = [image("a", &texture), image("b", &texture), image("c", &mirrored)];
    let few = SceneRefusal::TooFewViews { images: 3, views: 2 };
    assert_eq!(calibrate_scene(&copied, &options), Err(few));
    let mixed = [image("a", &texture), image("odd", &other), image("c", &texture)];
    let refused = calibrate_scene(&mixed, &options).unwrap_err();
    assert!(refused.to_string().starts_with("`odd` is 240x320"), "{refused}");
    let flat = GrayImage::filled(320, 240, 90);
    let blank = [image("a", &flat), image("b", &flat), image("c", &flat)];
    assert_eq!(calibrate_scene(&blank, &options), Err(SceneRefusal::NoTexture { median: 0 }));
    let tiny = GrayImage::filled(3, 2, 90);
    let tiny = [image("a", &tiny), image("b", &tiny), image("c", &tiny)];
    assert!(calibrate_scene(&tiny, &options).is_err());
}

#[test]
fn a_time_stamp_on_images_that_share_nothing_is_no_camera_that_stood_still() {
    const STAMP: usize = 48;
    let blocks = |seed: u64| {
        let mut random = ChaCha8Rng::seed_from_u64(seed);
        let blocks: Vec<u8> = (0..64 * 48).map(|_| random.random_range(0..255)).collect();
        move |row: usize, column: usize| blocks[row / 5 * 64 + column / 5]
    };
    let image = |seed: u64| {
        let (stamp, scene) = (blocks(99), blocks(seed));
        let at = |k: usize| {
            let (row, column) = (k / 320, k % 320);
            if row < STAMP { stamp(row, column) } else { scene(row, column) }
        };
        let gray = GrayImage::from_pixels(320, 240, (0..320 * 240).map(at).collect()).unwrap();
        SceneImage::of(seed.to_string(), gray.view())
    };
    let images = [image(1), image(2), image(3)];
    let refused = calibrate_scene(&images, &SceneOptions::default());
    assert_eq!(refused, Err(SceneRefusal::OnlyWhatStays { pairs: 3 }));
}

#[test]
fn a_texture_that_repeats_is_named() {
    const PERIOD: usize = 40;
    let mut random = ChaCha8Rng::seed_from_u64(10);
    let blocks: Vec<u8> = (0..100).map(|_| random.random_range(0..255)).collect();
    let image = |name: &str, [right, down]: [usize; 2]| {
        let at = |k: usize| {
            let (x, y) = ((k % 320 + right) % PERIOD, (k / 320 + down) % PERIOD);
            blocks[y / 4 * 10 + x / 4]
        };
        let gray = GrayImage::from_pixels(320, 240, (0..320 * 240).map(at).collect()).unwrap();
        SceneImage::of(name.to_owned(), gray.view())
    };
    let images = [image("a", [0, 0]), image("b", [13, 6]), image("c", [27, 15])];
    let refused = calibrate_scene(&images, &SceneOptions::default()).unwrap_err();
    assert!(refused.to_string().starts_with("the texture repeats: "), "{refused}");
}
