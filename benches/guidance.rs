//! The next view, and the sessions of simulated operators who follow it or do not.
//!
//!     cargo bench --bench guidance -- [SEEDS] [FIRST] ["IMAGES*.jpg:BOARD" …]
//!
//! BOARD is COLSxROWS or the file of a target.
//!
//! Times one decision (which view to ask for next, of one camera and of two) on one core for three
//! lenses; runs SEEDS sessions (9 unless said, from seed FIRST, 1000 unless said; three lenses,
//! three boards) for each operator until the worst projection uncertainty in the image reaches its
//! goal; and replays pools of photographs: how many images each order needs for 1.2 times the
//! uncertainty of all of them, in the order of `plumb calibrate --order` and in 200 random ones.
//! With 0 for SEEDS there are only the pools.

#![expect(
    clippy::print_stdout,
    clippy::unwrap_used,
    reason = "a benchmark prints what it measures"
)]

use std::hint::black_box;
use std::path::PathBuf;
use std::time::Instant;

use plumb::calibration::information::candidate_views::{
    BoardPoints, CandidateSpace, PlacementInImage,
};
use plumb::calibration::information::corner_noise::CornerNoise;
use plumb::calibration::information::lens_information::LensInformation;
use plumb::calibration::information::next_shared_view::suggest_shared_view;
use plumb::calibration::information::next_view::suggest_view;
use plumb::calibration::information::pair_information::PairInformation;
use plumb::calibration::information::pool::Pool;
use plumb::calibration::information::projection_goal::{GoalFigure, ProjectionGoal};
use plumb::calibration::information::transfer_goal::TransferGoal;
use plumb::calibration::information::view_information::{ViewNormal, view_information};
use plumb::calibration::view::{FrameFacts, View, target_as_seen};
use plumb::cli::simulate::operated::{OperatedSession, OperatorName};
use plumb::cli::simulate::operated_outcome::{OperatedOutcome, summary};
use plumb::detection::board_detection::DetectOptions;
use plumb::detection::finder::TargetFinder;
use plumb::document::target_file::target_from_text;
use plumb::estimation::camera::{CameraOptions, calibrate_camera};
use plumb::estimation::problem::CameraProblem;
use plumb::geometry::board::{BoardSize, Chessboard};
use plumb::geometry::lens::{Lens, LensModel};
use plumb::geometry::pixel::ImageSize;
use plumb::geometry::pose::Pose;
use plumb::geometry::target::Target;
use rand::SeedableRng;
use rand::seq::SliceRandom;
use rand_chacha::ChaCha8Rng;

/// The worst projection uncertainty over the image to reach, in pixels.
const GOAL_PX: f64 = 0.4;
const ORDERS: u64 = 200;
const ENOUGH: f64 = 1.2;
/// Subsets of a pool that are tried: a minute of one core.
const MOST_SUBSETS: f64 = 300_000.0;

fn main() {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let mut numbers = arguments.iter().filter_map(|argument| argument.parse().ok());
    let (seeds, first) = (numbers.next().unwrap_or(9), numbers.next().unwrap_or(1000));
    if seeds > 0 {
        for (setting, lens) in [(0, None), (2, None), (1, Some(rational()))] {
            in_setting(setting, lens, decision);
            in_setting(setting, lens, shared_decision);
        }
        operators(first, seeds);
    }
    let pools = arguments.iter().filter_map(|argument| argument.rsplit_once(':'));
    pools.for_each(|(images, board)| pool(images, board));
}

fn rational() -> Lens {
    let parameters =
        [540.0, 541.0, 639.5, 359.5, 0.0, 0.6, 0.2, 3e-4, -2e-4, 0.01, 0.9, 0.35, 0.05];
    Lens::from_parameters(LensModel::Rational, &parameters).unwrap()
}

/// The views that can be asked for in the setting of a seed, or with another lens in it.
fn in_setting(seed: u64, lens: Option<Lens>, then: fn(&CandidateSpace<'_>)) {
    let session = OperatedSession::of_seed(seed, OperatorName::Follows, (GOAL_PX, true));
    let lens = lens.unwrap_or(session.lens);
    let (board, noise) = (BoardPoints::of_chessboard(&session.board), CornerNoise::default());
    let space = CandidateSpace {
        lens: &lens,
        size: session.size,
        board: &board,
        noise: &noise,
        base: nalgebra::UnitQuaternion::identity(),
        avoided: &[],
    };
    then(&space);
}

/// One decision after 25 views.
fn decision(space: &CandidateSpace<'_>) {
    let (lens, size) = (*space.lens, space.size);
    let views: Vec<_> =
        (0..400).filter_map(|k| space.view(&PlacementInImage::of_sequence(k))).take(25).collect();
    let mut known = LensInformation::prior(lens, size);
    for view in &views {
        let free = known.free.clone();
        let taught = view_information(&lens, &free, &view.camera_from_board, &view.corners);
        known = known.with(&taught.unwrap());
    }
    let goal = ProjectionGoal::new(&lens, size, GoalFigure::Worst);
    let from = Some(&views[7].camera_from_board);
    let what = format!("one decision after {} views, {}", views.len(), lens.model().name());
    timed(&what, || {
        black_box(suggest_view(&known, &goal, space, from, Some(0.5 * GOAL_PX)));
    });
}

/// One decision which view two cameras should share, 12 cm from each other, with 25 views of each
/// of which both see up to 25; and what these views say of both, summed up anew.
fn shared_decision(space: &CandidateSpace<'_>) {
    let (lens, size) = (*space.lens, space.size);
    let b_from_a = Pose::from_axis_angle(
        nalgebra::Vector3::new(0.0, -0.1, 0.0),
        nalgebra::Vector3::new(-0.12, 0.0, 0.0),
    );
    let prior = LensInformation::prior(lens, size);
    let normals: Vec<[ViewNormal; 2]> = (0..400)
        .filter_map(|k| {
            let placement = PlacementInImage::of_sequence(k);
            let own = space.view(&placement)?;
            let other = space.view_at(&placement, b_from_a * own.camera_from_board)?;
            Some(
                [own, other]
                    .map(|view| ViewNormal::of(&lens, &view.camera_from_board, &view.corners)),
            )
        })
        .take(25)
        .collect();
    let sum = || {
        let mut known = PairInformation::of_lenses([&prior, &prior], b_from_a);
        for [own, other] in &normals {
            let view = known.of_view([own, other]).unwrap();
            known.matrix += view;
        }
        known
    };
    let known = sum();
    let images = [(&lens, size), (&lens, size)];
    let goal = TransferGoal::new(&known, images, 0.6, GoalFigure::Worst).unwrap();
    let name = lens.model().name();
    timed(&format!("summing up {} shared views, {name}", normals.len()), || {
        black_box(sum());
    });
    timed(&format!("one shared decision after {} views, {name}", normals.len()), || {
        let open = (None, Some(0.5 * GOAL_PX));
        black_box(suggest_shared_view(&known, &goal, [space, space], open));
    });
}

fn timed(what: &str, mut once: impl FnMut()) {
    let mut times_ms: Vec<f64> = (0..50)
        .map(|_| {
            let started = Instant::now();
            once();
            started.elapsed().as_secs_f64() * 1e3
        })
        .collect();
    times_ms.sort_unstable_by(f64::total_cmp);
    println!(
        "{what}: fastest {:.1} ms, median {:.1} ms, slowest {:.1} ms",
        times_ms[0], times_ms[25], times_ms[49]
    );
}

fn operators(first: u64, seeds: u64) {
    let operators =
        [OperatorName::Follows, OperatorName::List, OperatorName::Bars, OperatorName::Wanders];
    for operator in operators {
        let session = |seed: u64| OperatedSession::of_seed(seed, operator, (GOAL_PX, true)).run();
        let outcomes: Vec<OperatedOutcome> = (first..first + seeds).filter_map(session).collect();
        println!("{operator:?}: {}", summary(&outcomes));
    }
}

/// Images of a pool needed to reach 1.2 times the uncertainty of all, by the pool's order and
/// by random ones.
fn pool(images: &str, board: &str) {
    let target = match board.parse::<BoardSize>() {
        Ok(size) => Target::Chessboard(Chessboard::new(size, 0.03).unwrap()),
        Err(_) => target_from_text(&std::fs::read_to_string(board).unwrap()).unwrap(),
    };
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
            "{images}: {} images, {figure:?} {:.3} px: ordered {}, chosen {}, any subset {}, random median {}",
            order.len(),
            goal_px / ENOUGH,
            needed(&order).unwrap_or(0),
            by_choice.unwrap_or(0),
            fewest(&pool, &order, goal_px),
            random[random.len() / 2]
        );
    }
}

/// The fewest images of any subset that reach the goal, all of them tried; "at least" where they
/// are too many to try.
fn fewest(pool: &Pool, images: &[usize], goal_px: f64) -> String {
    for count in 1..=images.len() {
        let subsets = (0..count).fold(1.0, |n, k| n * (images.len() - k) as f64 / (k + 1) as f64);
        if subsets > MOST_SUBSETS {
            return format!("at least {count}");
        }
        let mut places: Vec<usize> = (0..count).collect();
        loop {
            let subset: Vec<usize> = places.iter().map(|place| images[*place]).collect();
            if pool.uncertainty_px(&subset) <= goal_px {
                return count.to_string();
            }
            // The next combination in order.
            let Some(at) = (0..count).rev().find(|at| places[*at] < images.len() - count + at)
            else {
                break;
            };
            places[at] += 1;
            (at + 1..count).for_each(|next| places[next] = places[next - 1] + 1);
        }
    }
    images.len().to_string()
}

fn problem_of(images: &str, target: &Target) -> CameraProblem {
    let mut paths: Vec<PathBuf> = glob::glob(images).unwrap().map(|entry| entry.unwrap()).collect();
    paths.sort();
    let (mut views, mut image_size) = (Vec::new(), ImageSize::new(0, 0));
    let mut finder = TargetFinder::new(target);
    for path in paths {
        let image = image::open(&path).unwrap().to_luma8();
        let size = ImageSize::new(image.width(), image.height());
        let (width, height) = (size.width as usize, size.height as usize);
        let gray = plumb::GrayImage::from_pixels(width, height, image.into_raw()).unwrap();
        let Ok(detection) = finder.find(gray.view(), &DetectOptions::default()) else { continue };
        image_size = size;
        let frame = FrameFacts {
            sequence: 0,
            name: Some(path.display().to_string()),
            host_time_ns: 0,
            device_time_ns: None,
            image_size,
        };
        views.push(View { number: 0, frame, detection });
    }
    let target = target_as_seen(target, &views);
    let views = views.iter().map(|view| view.to_board_view(&target)).collect();
    CameraProblem { image_size, views }
}
