//! A board followed from image to image, beside the same images each searched: what live use
//! saves.
//!
//!     cargo bench --bench tracking -- [FRAMES [FPS]]
//!
//! Simulated walks of a 9×6 board, one thread. For each size: the median time of a search and of
//! following, in milliseconds, their ratio, and how many images were followed; the others were
//! searched in the same call, and count as well.

#![expect(clippy::print_stdout, reason = "a benchmark prints what it measures")]

use std::time::Instant;

use plumb::detection::board_detection::DetectOptions;
use plumb::detection::detector::Detector;
use plumb::geometry::pixel::ImageSize;
use plumb::imaging::gray::GrayImage;
use plumb::simulation::{World, WorldOptions};

/// Each image is searched this often; the fastest counts.
const REPEATS: usize = 15;

fn main() {
    let mut numbers = std::env::args().skip(1).filter_map(|argument| argument.parse::<u32>().ok());
    let (frames, fps) = (numbers.next().unwrap_or(24), numbers.next().unwrap_or(30));
    println!("size        search ms  follow ms  ratio  followed");
    for (width, height) in [(640, 480), (1280, 720), (1920, 1080), (3840, 2160)] {
        let options = WorldOptions {
            fps: f64::from(fps),
            ..WorldOptions::new(5, ImageSize::new(width, height))
        };
        let mut world = World::new(&options);
        let images: Vec<GrayImage> =
            (0..u64::from(frames)).map(|index| world.frame(index).image).collect();
        let board = world.board().size;
        let (mut searcher, mut warm) = (Detector::new(board), Detector::new(board));
        let (mut searched, mut tracked, mut followed) = (Vec::new(), Vec::new(), 0);
        for pair in images.windows(2) {
            let [before, now] = pair else { continue };
            searched.push(fastest_ms(|| {
                let started = Instant::now();
                let _ = searcher.find_board(now.view(), &DetectOptions::default());
                started.elapsed().as_secs_f64()
            }));
            let mut was_followed = false;
            tracked.push(fastest_ms(|| {
                // Each time anew from the image before, which is not counted.
                let _ = warm.track_board(before.view(), &DetectOptions::default());
                let started = Instant::now();
                was_followed = warm
                    .track_board(now.view(), &DetectOptions::default())
                    .is_ok_and(|tracked| tracked.followed);
                started.elapsed().as_secs_f64()
            }));
            followed += u32::from(was_followed);
        }
        let (searched, tracked) = (median(&mut searched), median(&mut tracked));
        let size = format!("{width}x{height}");
        println!(
            "{size:<11} {searched:>9.3} {tracked:>10.3} {:>6.3}  {followed}/{}",
            tracked / searched,
            frames - 1
        );
    }
}

fn fastest_ms(mut search: impl FnMut() -> f64) -> f64 {
    (0..REPEATS).map(|_| search()).fold(f64::MAX, f64::min) * 1e3
}

fn median(times: &mut [f64]) -> f64 {
    times.sort_unstable_by(f64::total_cmp);
    times.get(times.len() / 2).copied().unwrap_or(f64::NAN)
}
