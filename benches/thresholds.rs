//! Each threshold of the detector changed by a fifth, and what that costs.
//!
//!     cargo bench --bench thresholds -- --seed 1 --images 160 > docs/detection/thresholds.md
//!
//! The images are drawn at random from hard conditions: tilt, blur, noise, small squares, strong
//! distortion, JPEG, an occluder, a board cut off by the border, another board. Each board is
//! searched for, and then tracked into a second image in which it has moved. Printed for each
//! threshold: corners found of those to be seen, images answered wrongly (a corner more than 1.5 px
//! off), the error of the corners, and boards tracked.

#![expect(clippy::print_stdout, reason = "a benchmark prints what it measures")]

#[path = "hard_cases.rs"]
mod hard_cases;
#[path = "marker_scenes.rs"]
mod marker_scenes;

use std::error::Error;

use plumb::detection::board_detection::DetectOptions;
use plumb::detection::detector::Detector;
use plumb::detection::thresholds::{ThresholdOrigin, Thresholds};
use plumb::geometry::board::{BoardSize, Chessboard};
use plumb::geometry::pixel::Pixel;
use plumb::imaging::gray::GrayImage;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

use crate::hard_cases::{Case, SQUARE_M, is_seen, render};
use crate::marker_scenes::{MarkerScene, draw_marker_scene};

/// A corner farther off than this is wrong, in pixels.
const WRONG_PX: f64 = 1.5;
/// How far the board moves from an image to the next, as a part of its distance.
const STEP: f64 = 0.006;

const CONDITIONS: [&str; 8] = [
    " tilted",
    " blurred",
    " noisy",
    " small",
    " distorted",
    " compressed",
    " occluded",
    " cut off",
];

/// Two images of one scene, where the corners are in the first, and which are to be seen.
struct Scene {
    /// Its conditions.
    name: String,
    board: BoardSize,
    /// Whether the board searched for is the one in the image.
    same_size: bool,
    images: [GrayImage; 2],
    corners: Vec<Pixel>,
    seen: usize,
}

/// What was found in scenes of one kind.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct Score {
    /// Corners of boards that were searched for.
    pub found: usize,
    /// Images answered wrongly.
    pub wrong: usize,
    /// Boards tracked into a second image.
    pub tracked: usize,
    /// Sum of the squares of the corners' errors, in pixels squared.
    pub squares: f64,
}

impl Score {
    fn rms_px(&self) -> f64 {
        (self.squares / (self.found.max(1)) as f64).sqrt()
    }
}

/// A case of the hardest conditions, one or two at a time.
fn draw_case(random: &mut ChaCha8Rng) -> Case {
    let mut case = Case {
        cell_px: random.random_range(16.0..44.0),
        tilt_deg: random.random_range(0.0..45.0),
        roll_deg: random.random_range(-180.0..180.0),
        blur_px: random.random_range(0.5..1.2),
        aside: [random.random_range(-0.12..0.12), random.random_range(-0.1..0.1)],
        board: [[9, 6], [8, 5], [7, 7], [11, 8]][random.random_range(0..4)],
        ..Case::new("")
    };
    for _ in 0..random.random_range(1..3) {
        let condition = random.random_range(0..CONDITIONS.len());
        case.name += CONDITIONS[condition];
        match condition {
            0 => case.tilt_deg = random.random_range(55.0..75.0),
            1 => case.blur_px = random.random_range(2.0..4.5),
            2 => case.full_well_e = random.random_range(50.0..300.0),
            3 => case.cell_px = random.random_range(6.0..10.0),
            4 => case.distortion = random.random_range(-0.35..0.1),
            5 => case.jpeg = Some(random.random_range(8..35)),
            6 => {
                let (left, top) = (random.random_range(120..420), random.random_range(60..320));
                let (wide, high) = (random.random_range(20..160), random.random_range(20..160));
                case.bar = Some([left, top, left + wide, top + high]);
            }
            _ => case.aside = [random.random_range(0.25..0.5), random.random_range(-0.3..0.3)],
        }
    }
    case
}

fn gray(case: &Case, board: Chessboard) -> Result<(GrayImage, Vec<Pixel>), Box<dyn Error>> {
    let (image, corners) = render(case, board)?;
    let (width, height) = (case.size.width as usize, case.size.height as usize);
    Ok((GrayImage::from_pixels(width, height, image.into_raw()).ok_or("size")?, corners))
}

fn draw_scene(random: &mut ChaCha8Rng) -> Result<Scene, Box<dyn Error>> {
    let mut case = draw_case(random);
    let [cols, rows] = case.board;
    let board = Chessboard::new(BoardSize::new(cols, rows)?, SQUARE_M)?;
    let (first, corners) = gray(&case, board)?;
    let seen = corners.iter().filter(|corner| is_seen(&case, **corner)).count();
    case.aside = case.aside.map(|at| at + STEP);
    let (second, _) = gray(&case, board)?;
    let same_size = random.random_range(0..8) > 0;
    let searched = if same_size { board.size } else { BoardSize::new(cols + 2, rows + 1)? };
    let name = case.name;
    Ok(Scene { name, board: searched, same_size, images: [first, second], corners, seen })
}

/// Adds what a detector with these thresholds finds in `scene`.
fn search(scene: &Scene, thresholds: Thresholds, score: &mut Score) {
    let mut detector = Detector::with_thresholds(scene.board, thresholds);
    let options = DetectOptions { allow_partial: true };
    let Ok(first) = detector.track_board(scene.images[0].view(), &options) else { return };
    let nearest = |pixel: Pixel| {
        scene.corners.iter().map(|corner| corner.distance_px(pixel)).fold(f64::MAX, f64::min)
    };
    let off = first.detection.corners.iter().map(|corner| nearest(corner.pixel));
    let (mut squares, mut count, mut wrong) =
        (0.0, 0, !scene.same_size && !first.detection.partial);
    for off in off {
        wrong |= off > WRONG_PX;
        squares += off * off;
        count += 1;
    }
    score.wrong += usize::from(wrong);
    if wrong && thresholds == Thresholds::DEFAULT {
        eprintln!("answered wrongly:{}", scene.name);
    }
    if !wrong && scene.same_size {
        score.found += count;
        score.squares += squares;
    }
    let second = detector.track_board(scene.images[1].view(), &options);
    score.tracked += usize::from(second.is_ok_and(|tracked| tracked.followed));
}

/// What is searched: chessboards, and boards with markers.
struct Scenes {
    chessboards: Vec<Scene>,
    markers: Vec<MarkerScene>,
}

impl Scenes {
    fn draw(seed: u64, [images, with_markers]: [u64; 2]) -> Result<Self, Box<dyn Error>> {
        let mut random = ChaCha8Rng::seed_from_u64(seed);
        let chessboards = (0..images).map(|_| draw_scene(&mut random)).collect::<Result<_, _>>()?;
        let markers =
            (0..with_markers).map(|_| draw_marker_scene(&mut random)).collect::<Result<_, _>>()?;
        Ok(Self { chessboards, markers })
    }

    /// Corners to be seen of each kind.
    fn to_be_seen(&self) -> [usize; 2] {
        let own = self.chessboards.iter().filter(|scene| scene.same_size).map(|scene| scene.seen);
        [own.sum(), self.markers.iter().map(MarkerScene::to_be_seen).sum()]
    }

    /// What these thresholds find of each kind.
    fn scores(&self, thresholds: Thresholds) -> [Score; 2] {
        let mut scores = [Score::default(); 2];
        self.chessboards.iter().for_each(|scene| search(scene, thresholds, &mut scores[0]));
        self.markers.iter().for_each(|scene| scene.search(thresholds, &mut scores[1]));
        scores
    }
}

/// The change from `base`, as cells of a table; empty: no change.
fn change(now: Score, base: Score) -> String {
    let count = |now: usize, before: usize| match now as i64 - before as i64 {
        0 => String::new(),
        change => format!("{change:+}"),
    };
    let rms_px = now.rms_px() - base.rms_px();
    let rms_px = if rms_px.abs() < 5e-5 { String::new() } else { format!("{rms_px:+.4}") };
    format!(
        " | {} | {} | {rms_px} | {}",
        count(now.found, base.found),
        count(now.wrong, base.wrong),
        count(now.tracked, base.tracked)
    )
}

fn argument(name: &str, default: u64) -> u64 {
    let mut arguments = std::env::args().skip_while(|argument| argument != name).skip(1);
    arguments.next().and_then(|value| value.parse().ok()).unwrap_or(default)
}

fn main() -> Result<(), Box<dyn Error>> {
    let (seed, images) = (argument("--seed", 1), argument("--images", 160));
    let with_markers = argument("--with-markers", 40);
    let scenes = Scenes::draw(seed, [images, with_markers])?;
    let seen = scenes.to_be_seen();
    let base = scenes.scores(Thresholds::DEFAULT);
    println!("# Thresholds of the detector, each changed by a fifth\n");
    println!(
        "`cargo bench --bench thresholds -- --seed {seed} --images {images} --with-markers\n\
         {with_markers}`: hard conditions drawn at random. As they are:\n"
    );
    for (kind, seen, score) in
        [("chessboards", seen[0], base[0]), ("boards with markers", seen[1], base[1])]
    {
        println!(
            "- {kind}: {} of {seen} corners found, {} images answered wrongly, {:.4} px rms, \
             {} tracked",
            score.found,
            score.wrong,
            score.rms_px(),
            score.tracked
        );
    }
    println!(
        "\nThe columns are the change of that, of chessboards and then of boards with markers\n\
         (m.); empty: no change.\n"
    );
    let columns = "corners | wrong | rms, px | tracked | \
                   m. corners | m. wrong | m. rms, px | m. tracked";
    println!("| threshold | value | origin | × 0.8: {columns} | × 1.25: {columns} |");
    println!("|{}", " --- |".repeat(19));
    for entry in Thresholds::entries() {
        let mut row = format!("| `{}` | {} {} | ", entry.name, entry.value, entry.unit);
        row += match entry.origin {
            ThresholdOrigin::Derived(from) => from,
            ThresholdOrigin::Swept => "swept",
        };
        for factor in [0.8, 1.25] {
            let thresholds = Thresholds::DEFAULT.scaled(&entry.name, factor).ok_or("its name")?;
            let changed = scenes.scores(thresholds);
            row += &change(changed[0], base[0]);
            row += &change(changed[1], base[1]);
        }
        println!("{row} |");
    }
    Ok(())
}
