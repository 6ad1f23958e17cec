//! A board followed from image to image, beside the same images each searched: what live use
//! saves.
//!
//!     cargo bench --bench tracking -- [FRAMES [FPS]]
//!
//! Walks of a 9×6 chessboard, an 8×6 ChArUco board and a 6×6 AprilGrid, one thread. For each size:
//! the median time of a search and of following, in milliseconds, their ratio, and how many images
//! were followed; the others were searched in the same call, and count as well.

#![expect(clippy::print_stdout, reason = "a benchmark prints what it measures")]

#[path = "../tests/golden/printed_images.rs"]
mod printed_images;

use std::error::Error;
use std::time::Instant;

use nalgebra::{Matrix3, Vector2};
use plumb::detection::board_detection::DetectOptions;
use plumb::detection::finder::TargetFinder;
use plumb::geometry::dictionary::Dictionary;
use plumb::geometry::pixel::ImageSize;
use plumb::geometry::printed_board::PrintedBoard;
use plumb::geometry::target::{AprilGrid, CharucoBoard, Target};
use plumb::imaging::gray::GrayImage;
use plumb::simulation::{World, WorldOptions};
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;

use crate::printed_images::rendered;

/// Each image is searched this often; the fastest counts.
const REPEATS: usize = 15;

fn main() -> Result<(), Box<dyn Error>> {
    let mut numbers = std::env::args().skip(1).filter_map(|argument| argument.parse::<u32>().ok());
    let (frames, fps) = (numbers.next().unwrap_or(24), numbers.next().unwrap_or(30));
    let (frames, fps) = (u64::from(frames), f64::from(fps));
    println!("board       size        search ms  follow ms  ratio  followed");
    for (width, height) in [(640, 480), (1280, 720), (1920, 1080), (3840, 2160)] {
        let options = WorldOptions { fps, ..WorldOptions::new(5, ImageSize::new(width, height)) };
        let mut world = World::new(&options);
        let board = Target::Chessboard(world.board());
        let images: Vec<GrayImage> = (0..frames).map(|index| world.frame(index).image).collect();
        compare(&board, &images);
    }
    for board in [charuco()?, april_grid()?] {
        for size in [[640, 480], [1280, 720], [1920, 1080]] {
            compare(&board, &printed_walk(&board, size, frames, fps));
        }
    }
    Ok(())
}

fn charuco() -> Result<Target, Box<dyn Error>> {
    let dictionary = Dictionary::named("DICT_5X5_100")?;
    let (square_m, marker_m) = (0.04, 0.03);
    let board = CharucoBoard {
        cols: 8,
        rows: 6,
        square_m,
        marker_m,
        dictionary,
        first_id: 0,
        legacy: None,
    };
    Ok(Target::Charuco(board))
}

fn april_grid() -> Result<Target, Box<dyn Error>> {
    Ok(Target::AprilGrid(AprilGrid {
        cols: 6,
        rows: 6,
        tag_m: 0.04,
        spacing: 0.3,
        family: Dictionary::named("tag36h11")?,
        border_bits: None,
        first_id: 0,
    }))
}

/// Images of `board`, which sways before the camera.
fn printed_walk(
    board: &Target,
    [width, height]: [usize; 2],
    frames: u64,
    fps: f64,
) -> Vec<GrayImage> {
    let print = PrintedBoard::of(board);
    let middle =
        Matrix3::new_translation(&Vector2::new(-print.width_m / 2.0, -print.height_m / 2.0));
    let fit = (width as f64 / print.width_m).min(height as f64 / print.height_m);
    let mut rng = ChaCha8Rng::seed_from_u64(5);
    let images = (0..frames).map(|index| {
        let sway = |period_s: f64| (std::f64::consts::TAU * index as f64 / fps / period_s).sin();
        let scale = fit * (0.7 + 0.05 * sway(2.3));
        let (s, c) = (0.15 * sway(3.1)).sin_cos();
        let (a, b) = (scale * c, scale * s);
        let slanted = Matrix3::new(a, -b, 0.0, b, a, 0.0, 0.4 * sway(1.9), 0.4 * sway(2.7), 1.0);
        let at = [(width, 1.7), (height, 2.9)]
            .map(|(side, period_s)| side as f64 * (0.5 + 0.05 * sway(period_s)));
        let place = Matrix3::new_translation(&Vector2::from(at)) * slanted * middle;
        rendered(&print, [width, height], &[place], &mut rng)
    });
    images.collect()
}

/// Searches and follows `board` in `images`.
fn compare(board: &Target, images: &[GrayImage]) {
    let (mut searcher, mut warm) = (TargetFinder::new(board), TargetFinder::new(board));
    let (mut searched, mut tracked, mut followed) = (Vec::new(), Vec::new(), 0);
    for pair in images.windows(2) {
        let [before, now] = pair else { continue };
        searched.push(fastest_ms(|| {
            let started = Instant::now();
            let _ = searcher.find(now.view(), &DetectOptions::default());
            started.elapsed().as_secs_f64()
        }));
        let mut was_followed = false;
        tracked.push(fastest_ms(|| {
            // Each time anew from the image before, which is not counted.
            let _ = warm.track(before.view(), &DetectOptions::default());
            let started = Instant::now();
            was_followed = warm
                .track(now.view(), &DetectOptions::default())
                .is_ok_and(|tracked| tracked.followed);
            started.elapsed().as_secs_f64()
        }));
        followed += u32::from(was_followed);
    }
    let (searched, tracked) = (median(&mut searched), median(&mut tracked));
    let size =
        images.first().map_or_else(String::new, |it| format!("{}x{}", it.width(), it.height()));
    println!(
        "{:<11} {size:<11} {searched:>9.3} {tracked:>10.3} {:>6.3}  {followed}/{}",
        board.kind(),
        tracked / searched,
        images.len() - 1
    );
}

fn fastest_ms(mut search: impl FnMut() -> f64) -> f64 {
    (0..REPEATS).map(|_| search()).fold(f64::MAX, f64::min) * 1e3
}

fn median(times: &mut [f64]) -> f64 {
    times.sort_unstable_by(f64::total_cmp);
    times.get(times.len() / 2).copied().unwrap_or(f64::NAN)
}
