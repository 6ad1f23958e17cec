//! Calibration without a target: are the stated standard deviations true, and is a wrong number
//! ever stated with confidence?
//!
//!     cargo bench --bench scene_coverage -- [SEEDS] [FIRST_SEED] [--lens NAME] [--each] \
//!         [--only WORD] [--keep DIR]
//!
//! SEEDS (20 unless said) seeds of five worlds and four motions, eight images of 640×480 each by a
//! lens of its own (Brown's model; principal point, aspect and distortion as cheap cameras have
//! them), every other seed with something that moves. Prints, by world and motion, what was
//! refused and how the others were graded, which part of the true fx, fy, cx and cy lies within one
//! and two standard deviations (68 and 95 % if they are true), and the root mean square of errors
//! over standard deviations. A confident failure is a result that is not graded poor and errs by
//! more than four. `--each` prints every result too, `--only` those worlds or motions alone;
//! `--keep` keeps the images in DIR, or takes them from there.

#![expect(
    clippy::print_stdout,
    clippy::unwrap_used,
    reason = "a benchmark prints what it measures"
)]

use std::path::{Path, PathBuf};
use std::time::Instant;

use plumb::calibration::result::Grade;
use plumb::calibration::scene::correspondence::SceneImage;
use plumb::calibration::scene::{SceneOptions, calibrate_scene};
use plumb::estimation::problem::LensChoice;
use plumb::geometry::lens::{Lens, LensModel};
use plumb::geometry::pixel::ImageSize;
use plumb::imaging::gray::GrayImage;
use plumb::simulation::{CameraPath, ImageSensor, Scenery, TexturedWorld, TexturedWorldOptions};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

const SIZE: ImageSize = ImageSize::new(640, 480);
const IMAGES: usize = 8;
/// What is asked: fx, fy, cx, cy.
const ASKED: usize = 4;
/// An error beyond this many standard deviations is no accident: one in 16,000.
const FAILURE: f64 = 4.0;

struct Asked {
    seeds: u64,
    first: u64,
    lens: LensChoice,
    each: bool,
    only: Option<String>,
    kept: Option<PathBuf>,
}

/// What one world gave.
enum Outcome {
    Refused(String),
    Graded { grade: Grade, errors_in_std: [f64; ASKED], summary: String },
}

fn main() {
    let asked = arguments();
    let (mut all, started) = (Vec::new(), Instant::now());
    println!("{:<10}{:<10} refused  poor usable good   1 sigma 2 sigma  rms z  failures", "", "");
    for scenery in Scenery::ALL {
        for path in CameraPath::ALL {
            let name = format!("{scenery:?} {path:?}");
            if asked.only.as_ref().is_some_and(|only| !name.contains(only.as_str())) {
                continue;
            }
            let seeds = asked.first..asked.first + asked.seeds;
            let outcomes: Vec<Outcome> =
                seeds.map(|seed| outcome(&asked, seed, scenery, path)).collect();
            print_row(&format!("{scenery:?}"), &format!("{path:?}"), &outcomes);
            all.extend(outcomes);
        }
    }
    print_row("all", "", &all);
    for grade in [Grade::Poor, Grade::Usable, Grade::Good] {
        let has = |outcome: &Outcome| matches!(outcome, Outcome::Graded { grade: own, .. } if *own == grade);
        let of_grade: Vec<Outcome> = all.extract_if(.., |outcome| has(outcome)).collect();
        print_row(grade.name(), "", &of_grade);
    }
    println!("{:.0} s", started.elapsed().as_secs_f64());
}

fn arguments() -> Asked {
    let mut numbers = Vec::new();
    let mut asked =
        Asked { seeds: 20, first: 0, lens: LensChoice::Auto, each: false, only: None, kept: None };
    let mut words = std::env::args().skip(1);
    while let Some(word) = words.next() {
        match word.as_str() {
            "--each" => asked.each = true,
            "--only" => asked.only = words.next(),
            "--keep" => asked.kept = words.next().map(PathBuf::from),
            "--lens" => {
                let name = words.next().unwrap();
                asked.lens = LensChoice::Model(LensModel::from_name(&name).unwrap());
            }
            word => numbers.extend(word.parse::<u64>()),
        }
    }
    asked.seeds = numbers.first().copied().unwrap_or(asked.seeds);
    asked.first = numbers.get(1).copied().unwrap_or(asked.first);
    asked
}

/// A lens as cheap cameras have it: 40 to 75 degrees wide.
fn lens(seed: u64) -> Lens {
    let mut random = ChaCha8Rng::seed_from_u64(seed ^ 0x1e45);
    let mut between = |low: f64, high: f64| random.random_range(low..high);
    let (width, center) = (f64::from(SIZE.width), SIZE.center());
    let fx = width * between(0.65, 1.35);
    let k1 = between(-0.25, 0.05);
    let parameters = [
        fx,
        fx * between(0.997, 1.003),
        center.x + width * between(-0.02, 0.02),
        center.y + width * between(-0.02, 0.02),
        0.0,
        k1,
        0.4 * k1 * k1 + between(-0.01, 0.03),
        between(-6e-4, 6e-4),
        between(-6e-4, 6e-4),
        0.0,
    ];
    Lens::from_parameters(LensModel::Brown, &parameters).unwrap()
}

fn outcome(asked: &Asked, seed: u64, scenery: Scenery, path: CameraPath) -> Outcome {
    let truth = lens(seed * 20 + scenery as u64 * 4 + path as u64);
    let sensor = ImageSensor::new(SIZE, truth);
    let has_mover = seed % 2 == 1;
    let options = TexturedWorldOptions { seed, scenery, path, images: IMAGES, sensor, has_mover };
    let folder =
        asked.kept.as_ref().map(|folder| folder.join(format!("{scenery:?}{path:?}{seed}")));
    let grays = world_images(&options, folder.as_deref());
    let started = Instant::now();
    let image = |(k, image): (usize, &GrayImage)| SceneImage::of(k.to_string(), image.view());
    let images: Vec<SceneImage> = grays.iter().enumerate().map(image).collect();
    let options = SceneOptions { lens: asked.lens, ..SceneOptions::default() };
    let solved = calibrate_scene(&images, &options);
    let outcome = match solved {
        Err(refusal) => Outcome::Refused(refusal.to_string()),
        Ok(found) => {
            let (lens, std) = (found.sensor.lens, found.sensor.lens_std);
            let (estimate, truth) = (lens.parameters(), truth.parameters());
            let errors: [f64; ASKED] = std::array::from_fn(|k| estimate[k] - truth[k]);
            let parts: Vec<String> =
                (0..ASKED).map(|k| format!("{:+.2}±{:.2}", errors[k], std[k])).collect();
            let summary = format!(
                "{} {:.1} s {} {:?}",
                lens.model(),
                started.elapsed().as_secs_f64(),
                parts.join(" "),
                found.verdict.reasons.first().map_or("", String::as_str)
            );
            let errors_in_std = std::array::from_fn(|k| errors[k] / std[k]);
            Outcome::Graded { grade: found.verdict.grade, errors_in_std, summary }
        }
    };
    if asked.each {
        match &outcome {
            Outcome::Refused(reason) => println!("  {scenery:?} {path:?} {seed}: {reason}"),
            Outcome::Graded { grade, errors_in_std, summary } => println!(
                "  {scenery:?} {path:?} {seed}: {} z {:.1?} f {:.0} {summary}",
                grade.name(),
                errors_in_std,
                truth.matrix.fx
            ),
        }
    }
    outcome
}

/// The world's images, from `folder` if they are there.
fn world_images(options: &TexturedWorldOptions, folder: Option<&Path>) -> Vec<GrayImage> {
    let path = |k: usize| folder.map(|folder| folder.join(format!("{k}.png")));
    let read = |k: usize| {
        let image = image::open(path(k)?).ok()?.into_luma8();
        let (width, height) = (image.width() as usize, image.height() as usize);
        GrayImage::from_pixels(width, height, image.into_raw())
    };
    if let Some(grays) = (0..options.images).map(read).collect::<Option<_>>() {
        return grays;
    }
    let world = TexturedWorld::new(options.clone());
    let grays: Vec<GrayImage> = (0..options.images).map(|k| world.image(k)).collect();
    for (k, image) in grays.iter().enumerate() {
        let Some(path) = path(k) else { continue };
        std::fs::create_dir_all(path.parent().unwrap()).unwrap();
        let (size, pixels) = (image.size(), image.pixels().to_vec());
        image::GrayImage::from_raw(size.width, size.height, pixels).unwrap().save(path).unwrap();
    }
    grays
}

fn print_row(first: &str, second: &str, outcomes: &[Outcome]) {
    let graded = |wanted: Grade| {
        let is = |o: &&Outcome| matches!(o, Outcome::Graded { grade, .. } if *grade == wanted);
        outcomes.iter().filter(is).count()
    };
    let refused = outcomes.iter().filter(|o| matches!(o, Outcome::Refused(_))).count();
    let errors: Vec<f64> = outcomes
        .iter()
        .filter_map(|o| match o {
            Outcome::Graded { errors_in_std, .. } => Some(*errors_in_std),
            Outcome::Refused(_) => None,
        })
        .flatten()
        .collect();
    let within = |limit: f64| {
        let count = errors.iter().filter(|z| z.abs() <= limit).count();
        100.0 * count as f64 / errors.len().max(1) as f64
    };
    let rms = (errors.iter().map(|z| z * z).sum::<f64>() / errors.len().max(1) as f64).sqrt();
    let is_failure = |o: &&Outcome| match o {
        Outcome::Graded { grade, errors_in_std, .. } => {
            *grade != Grade::Poor && errors_in_std.iter().any(|z| !(z.abs() <= FAILURE))
        }
        Outcome::Refused(_) => false,
    };
    println!(
        "{first:<10}{second:<10}{refused:>8}{:>6}{:>7}{:>5}{:>8.1} %{:>6.1} %{rms:>7.2}{:>10}",
        graded(Grade::Poor),
        graded(Grade::Usable),
        graded(Grade::Good),
        within(1.0),
        within(2.0),
        outcomes.iter().filter(is_failure).count()
    );
}
