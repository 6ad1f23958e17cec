//! The next view, and the sessions of simulated operators who follow it or do not.
//!
//!     cargo bench --bench guidance -- [SEEDS] ["IMAGES*.jpg:COLSxROWS" …]
//!
//! Times one decision (which view to ask for next) on one core; runs SEEDS sessions (9 unless said;
//! three lenses, three boards) for each operator until the median projection uncertainty reaches
//! its goal; and replays pools of photographs: how many images each order needs for 1.2 times the
//! uncertainty of all of them, in the order of `plumb calibrate --order` and in 200 random ones.

#![expect(
    clippy::print_stdout,
    clippy::unwrap_used,
    reason = "a benchmark prints what it measures"
)]

use std::hint::black_box;
use std::path::PathBuf;
use std::time::Instant;

use plumb::calibration::information::candidate_views::{BoardPoints, CandidateSpace, Holding};
use plumb::calibration::information::corner_noise::CornerNoise;
use plumb::calibration::information::lens_information::LensInformation;
use plumb::calibration::information::next_view::suggest_view;
use plumb::calibration::information::pool::Pool;
use plumb::calibration::information::projection_goal::{GoalFigure, ProjectionGoal};
use plumb::calibration::information::view_information::view_information;
use plumb::calibration::view::{FrameFacts, View};
use plumb::cli::simulate::operated::{OperatedOutcome, OperatedSession, OperatorName, summary};
use plumb::estimation::camera::{CameraOptions, calibrate_camera};
use plumb::estimation::problem::CameraProblem;
use plumb::geometry::board::{BoardSize, Chessboard};
use plumb::geometry::pixel::ImageSize;
use rand::SeedableRng;
use rand::seq::SliceRandom;
use rand_chacha::ChaCha8Rng;

/// The median projection uncertainty to reach, in pixels.
const GOAL_PX: f64 = 0.08;
const ORDERS: u64 = 200;
const ENOUGH: f64 = 1.2;

fn main() {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let seeds = arguments.iter().find_map(|argument| argument.parse().ok()).unwrap_or(9);
    decision();
    operators(seeds);
    arguments.iter().filter_map(|argument| argument.rsplit_once(':')).for_each(pool);
}

/// One decision after eight views.
fn decision() {
    let session = OperatedSession::of_seed(3, OperatorName::Follows, (GOAL_PX, false));
    let (board, noise) = (BoardPoints::of_chessboard(&session.board), CornerNoise::default());
    let space = CandidateSpace {
        lens: &session.lens,
        size: session.size,
        board: &board,
        noise: &noise,
        base: nalgebra::UnitQuaternion::identity(),
    };
    let views: Vec<_> =
        (0..40).filter_map(|k| space.view(&Holding::of_sequence(k))).take(8).collect();
    let mut known = LensInformation::prior(session.lens, session.size);
    for view in &views {
        let (lens, free) = (session.lens, known.free.clone());
        let taught = view_information(&lens, &free, &view.camera_from_board, &view.corners);
        known = known.with(&taught.unwrap());
    }
    let goal = ProjectionGoal::new(&session.lens, session.size, GoalFigure::Median);
    let from = Some(&views[7].camera_from_board);
    let mut times_ms: Vec<f64> = (0..50)
        .map(|_| {
            let started = Instant::now();
            black_box(suggest_view(&known, &goal, &space, (from, Some(GOAL_PX))));
            started.elapsed().as_secs_f64() * 1e3
        })
        .collect();
    times_ms.sort_unstable_by(f64::total_cmp);
    println!("one decision: fastest {:.1} ms, median {:.1} ms", times_ms[0], times_ms[25]);
}

fn operators(seeds: u64) {
    let operators =
        [OperatorName::Follows, OperatorName::List, OperatorName::Bars, OperatorName::Wanders];
    for operator in operators {
        let session = |seed: u64| OperatedSession::of_seed(seed, operator, (GOAL_PX, false)).run();
        let outcomes: Vec<OperatedOutcome> = (1000..1000 + seeds).filter_map(session).collect();
        println!("{operator:?}: {}", summary(&outcomes));
    }
}

/// Images of a pool needed to reach 1.2 times the uncertainty of all, by the pool's order and
/// by random ones.
fn pool((images, board): (&str, &str)) {
    let size: BoardSize = board.parse().unwrap();
    let target = Chessboard::new(size, 0.03).unwrap();
    let problem = problem_of(images, &target);
    let estimate = calibrate_camera(&problem, &CameraOptions::default()).unwrap();
    for figure in [GoalFigure::Worst, GoalFigure::Median] {
        let pool = Pool::of(&problem, &estimate, figure);
        let order: Vec<usize> = pool.order().iter().map(|step| step.view).collect();
        let goal_px = ENOUGH * pool.uncertainty_px(&order);
        let needed = |order: &[usize]| {
            (1..=order.len()).find(|count| pool.uncertainty_px(&order[..*count]) <= goal_px)
        };
        let by_choice =
            (1..=order.len()).find(|n| pool.uncertainty_px(&pool.choose(*n)) <= goal_px);
        let mut random: Vec<usize> = (0..ORDERS)
            .map(|seed| {
                let mut shuffled = order.clone();
                shuffled.shuffle(&mut ChaCha8Rng::seed_from_u64(seed));
                needed(&shuffled).unwrap_or(order.len())
            })
            .collect();
        random.sort_unstable();
        println!(
            "{images}: {} images, {figure:?} {:.3} px: ordered {}, chosen {}, random median {}",
            order.len(),
            goal_px / ENOUGH,
            needed(&order).unwrap_or(0),
            by_choice.unwrap_or(0),
            random[random.len() / 2]
        );
    }
}

fn problem_of(images: &str, target: &Chessboard) -> CameraProblem {
    let mut paths: Vec<PathBuf> = glob::glob(images).unwrap().map(|entry| entry.unwrap()).collect();
    paths.sort();
    let (mut views, mut image_size) = (Vec::new(), ImageSize::new(0, 0));
    for path in paths {
        let image = image::open(&path).unwrap().to_luma8();
        let size = ImageSize::new(image.width(), image.height());
        let (width, height) = (size.width as usize, size.height as usize);
        let gray = plumb::GrayImage::from_pixels(width, height, image.into_raw()).unwrap();
        let Ok(detection) = plumb::detect(gray.view(), target.size) else { continue };
        image_size = size;
        let frame = FrameFacts {
            sequence: 0,
            name: Some(path.display().to_string()),
            host_time_ns: 0,
            device_time_ns: None,
            image_size,
        };
        views.push(View { number: 0, frame, detection }.to_board_view(&(*target).into()));
    }
    CameraProblem { image_size, views }
}
