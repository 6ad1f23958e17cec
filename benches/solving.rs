//! The solve of one camera: how it grows with the views, and what one more view costs.
//!
//!     cargo bench --bench solving -- [VIEWS …]
//!
//! Seeded views of an 11×8 board, one thread, everything that `plumb solve` times: lens, poses,
//! covariance, halves, verdict. The first solve of the process is what a command pays; the fastest
//! of many what a daemon does. Then a session of 50 solved views to which one is added: its running
//! estimate with uncertainty, warm and anew.

#![expect(
    clippy::print_stdout,
    clippy::unwrap_used,
    reason = "a benchmark prints what it measures"
)]

use std::hint::black_box;
use std::time::Instant;

use plumb::calibration::solve::{estimate_views, solve_views};
use plumb::estimation::camera::CameraOptions;
use plumb::estimation::problem::{CameraProblem, LensChoice};
use plumb::geometry::board::{BoardSize, Chessboard};
use plumb::geometry::lens::LensModel;

#[expect(dead_code, reason = "shared with the tests, which use all of it")]
#[path = "../tests/golden/seeded_camera.rs"]
mod seeded_camera;
use seeded_camera::SeededCamera;

fn problem(views: usize) -> CameraProblem {
    let board = Chessboard::new(BoardSize::new(11, 8).unwrap(), 0.03).unwrap();
    let camera = SeededCamera { board, ..SeededCamera::ordinary() };
    let mut rng = SeededCamera::rng(views as u64);
    let poses = camera.poses(views, &mut rng);
    camera.problem(&poses, &mut rng)
}

fn main() {
    let asked: Vec<usize> =
        std::env::args().skip(1).filter_map(|argument| argument.parse().ok()).collect();
    let sizes = if asked.is_empty() { vec![10, 30, 100, 300, 1000] } else { asked };
    let options =
        CameraOptions { lens: LensChoice::Model(LensModel::Brown), ..CameraOptions::default() };
    println!("views  first ms  fastest ms  fastest ms/view");
    for views in sizes {
        let problem = problem(views);
        let solve = || solve_views(&problem, &options).unwrap();
        let first = once_ms(solve);
        let fastest = (0..2000 / views + 3).map(|_| once_ms(solve)).fold(f64::MAX, f64::min);
        println!("{views:>5} {first:>9.3} {fastest:>11.3} {:>16.4}", fastest / views as f64);
    }
    let all = problem(51);
    let earlier = CameraProblem { views: all.views[..50].to_vec(), ..all.clone() };
    let (solved, _) = estimate_views(&earlier, &options).unwrap();
    let warm = CameraOptions { start: Some(solved.to_start()), ..options.clone() };
    let times = |options: &CameraOptions| {
        let mut times: Vec<f64> =
            (0..100).map(|_| once_ms(|| estimate_views(&all, options).unwrap())).collect();
        times.sort_unstable_by(f64::total_cmp);
        (times[0], times[times.len() / 2])
    };
    let (warm, anew) = (times(&warm), times(&options));
    println!(
        "one more view than 50: fastest {:.3} ms, median {:.3}; anew {:.3}, {:.3}",
        warm.0, warm.1, anew.0, anew.1
    );
}

fn once_ms<T>(solve: impl Fn() -> T) -> f64 {
    let started = Instant::now();
    black_box(solve());
    started.elapsed().as_secs_f64() * 1e3
}
