//! The estimate that a session shows while it collects: gone on from view to view, it is what a
//! solve of the same views from nothing gives.

use nalgebra::{Point3, Vector3};
use plumb::calibration::running_estimate::{EstimateSoFar, estimate_so_far};
use plumb::calibration::solve::estimate_views;
use plumb::estimation::camera::CameraOptions;
use plumb::estimation::problem::{BoardView, CameraProblem, Correspondence, LensChoice};
use plumb::geometry::board::{BoardSize, Chessboard};
use plumb::geometry::lens::LensModel;
use plumb::geometry::pixel::Pixel;
use plumb::geometry::pose::Pose;
use rand_distr::{Distribution, StandardNormal};

use crate::seeded_camera::SeededCamera;

/// The estimates of the first three views of `problem`, of four, and so on; `None` where there is
/// none.
fn walk(
    problem: &CameraProblem,
    board_from_labels: &[Pose],
    lens: LensChoice,
) -> Vec<(CameraProblem, Option<EstimateSoFar>)> {
    let mut newest: Option<EstimateSoFar> = None;
    let estimates = (3..=problem.views.len()).map(|views| {
        let so_far = CameraProblem { views: problem.views[..views].to_vec(), ..problem.clone() };
        let continuation = newest.as_ref().and_then(|newest| newest.continuation.as_ref());
        let estimate = estimate_so_far(&so_far, board_from_labels, lens, continuation).ok();
        newest = estimate.clone().or_else(|| newest.take());
        (so_far, estimate)
    });
    estimates.collect()
}

/// How far the estimates of a walk are from those made anew with the same lens model at most: in
/// standard deviations of the lens's parameters, and as a part of the predicted uncertainty.
fn furthest_from_anew(walk: &[(CameraProblem, Option<EstimateSoFar>)]) -> [f64; 2] {
    let mut furthest = [0.0; 2];
    for (problem, estimate) in walk {
        let Some(EstimateSoFar { running, .. }) = estimate else { continue };
        let lens = LensChoice::Model(running.lens.model());
        let (anew, uncertainty_px) =
            estimate_views(problem, &CameraOptions { lens, ..CameraOptions::default() }).unwrap();
        let used = anew.views.iter().filter(|view| view.fault.is_none()).count();
        assert_eq!(running.views as usize, used, "of {} views", problem.views.len());
        let parameters =
            running.lens.parameters().into_iter().zip(anew.lens.parameters()).zip(anew.lens_std());
        for ((running, anew), std) in parameters.filter(|(_, std)| *std > 0.0) {
            furthest[0] = f64::max(furthest[0], (running - anew).abs() / std);
        }
        furthest[1] = f64::max(
            furthest[1],
            (running.uncertainty_px.median / uncertainty_px.median - 1.0).abs(),
        );
    }
    furthest
}

fn problem_of(camera: &SeededCamera, views: usize, seed: u64) -> CameraProblem {
    let mut rng = SeededCamera::rng(seed);
    let poses = camera.poses(views, &mut rng);
    camera.problem(&poses, &mut rng)
}

#[test]
fn it_is_what_a_solve_from_nothing_gives_after_every_view() {
    let cameras = [
        ("ordinary", SeededCamera::ordinary(), LensModel::Brown),
        ("narrow", SeededCamera::narrow(), LensModel::Brown),
        ("wide", SeededCamera::wide(), LensModel::Rational),
        ("fisheye", SeededCamera::fisheye(), LensModel::KannalaBrandt),
    ];
    for (name, camera, model) in cameras {
        let problem = problem_of(&camera, 40, 31);
        let walk = walk(&problem, &[], LensChoice::Model(model));
        let [lens, uncertainty] = furthest_from_anew(&walk);
        println!("{name}: {lens:.1e} standard deviations, {uncertainty:.1e} of the uncertainty");
        assert!(lens < 0.02 && uncertainty < 1e-3, "{name}: {lens} std, {uncertainty}");
        let continued = walk.iter().filter(|(_, estimate)| {
            let continuation =
                estimate.as_ref().and_then(|estimate| estimate.continuation.as_ref());
            continuation.is_some_and(|continuation| !continuation.is_from_scratch())
        });
        let continued = continued.count();
        assert!(continued >= 25, "{name}: gone on {continued} times of 38, where nothing is wrong");
        assert!(
            self::walk(&problem, &[], LensChoice::Model(model)) == walk,
            "{name}: the same views, another estimate"
        );
    }
}

#[test]
fn a_bad_view_on_the_way_is_rejected_as_in_a_solve_from_nothing() {
    let camera = SeededCamera::ordinary();
    let mut problem = problem_of(&camera, 30, 32);
    for corner in &mut problem.views[14].correspondences {
        corner.pixel.x += 40.0 * corner.point_in_board.x;
    }
    let pixels: Vec<_> =
        problem.views[20].correspondences.iter().map(|corner| corner.pixel).collect();
    for (corner, pixel) in problem.views[20].correspondences.iter_mut().zip(pixels.iter().rev()) {
        corner.pixel.x = pixel.x;
    }
    let walk = walk(&problem, &[], LensChoice::Model(LensModel::Brown));
    let [lens, uncertainty] = furthest_from_anew(&walk);
    assert!(lens < 0.02 && uncertainty < 1e-3, "{lens} std, {uncertainty}");
    assert!(walk.iter().skip(2).all(|(_, estimate)| estimate.is_some()), "five views are enough");
    let last = walk.last().and_then(|(_, estimate)| estimate.as_ref()).unwrap();
    assert_eq!(last.running.views, 28, "two of 30 are wrong");
}

#[test]
fn the_lens_model_is_chosen_again_as_views_double() {
    let camera = SeededCamera::wide();
    let problem = problem_of(&camera, 26, 33);
    let walk = walk(&problem, &[], LensChoice::Auto);
    let [lens, _] = furthest_from_anew(&walk);
    assert!(lens < 0.02, "{lens} std");
    let chosen = |views: usize| walk[views - 3].1.as_ref().unwrap().running.lens.model();
    let anew = |views: usize| {
        let problem = CameraProblem { views: problem.views[..views].to_vec(), ..problem.clone() };
        estimate_views(&problem, &CameraOptions::default()).unwrap().0.lens.model()
    };
    assert_eq!([chosen(6), chosen(12), chosen(24)], [anew(6), anew(12), anew(24)]);
}

/// An 8x6 board that is uneven by 0.1 mm, in the same poses: with every third view labeled from the
/// other end, and with all views labeled alike.
fn labeled_from_both_ends() -> [CameraProblem; 2] {
    let mut camera = SeededCamera::ordinary();
    camera.board = Chessboard::new(BoardSize::new(8, 6).unwrap(), 0.03).unwrap();
    let mut rng = SeededCamera::rng(34);
    let poses = camera.poses(14, &mut rng);
    let stated = camera.board.corners_in_board();
    let mut normal = || Vector3::from_fn(|_, _| StandardNormal.sample(&mut rng));
    let uneven: Vec<Point3<f64>> = stated.iter().map(|point| point + 1e-4 * normal()).collect();
    let noise: Vec<Vec<Vector3<f64>>> =
        poses.iter().map(|_| stated.iter().map(|_| 0.05 * normal()).collect()).collect();
    let symmetries = camera.board.symmetries();
    let problem = |symmetry_of: &dyn Fn(usize) -> usize| {
        let view = |(k, pose): (usize, &Pose)| {
            let seen = stated.iter().zip(&uneven).zip(&noise[k]);
            let corner =
                |((stated, uneven), noise): ((&Point3<f64>, &Point3<f64>), &Vector3<f64>)| {
                    let exact = camera.lens.pixel_from_point(&(*pose * *uneven)).unwrap();
                    Correspondence {
                        point_in_board: symmetries[symmetry_of(k)] * *stated,
                        pixel: Pixel::new(exact.x + noise.x, exact.y + noise.y),
                        std_px: 0.05,
                    }
                };
            BoardView { name: k.to_string(), correspondences: seen.map(corner).collect() }
        };
        let views = poses.iter().enumerate().map(view).collect();
        CameraProblem { image_size: camera.size, views }
    };
    [problem(&|k| usize::from(k % 3 == 2)), problem(&|_| 0)]
}

#[test]
fn views_of_a_symmetric_board_count_as_if_they_were_labeled_alike() {
    let [both_ends, alike] = labeled_from_both_ends();
    let symmetries = Chessboard::new(BoardSize::new(8, 6).unwrap(), 0.03).unwrap().symmetries();
    let lens = LensChoice::Model(LensModel::Brown);
    let walk = walk(&both_ends, &symmetries, lens);
    let (_, last) = walk.last().unwrap();
    let last = last.as_ref().unwrap();
    assert!(!last.continuation.as_ref().unwrap().is_from_scratch(), "continued");
    let options = CameraOptions { lens, ..CameraOptions::default() };
    let (estimate, uncertainty_px) = estimate_views(&alike, &options).unwrap();
    let pairs = last.running.lens.parameters().into_iter().zip(estimate.lens.parameters());
    for ((running, alike), std) in pairs.zip(estimate.lens_std()).filter(|(_, std)| *std > 0.0) {
        assert!((running - alike).abs() < 0.05 * std, "{running}, {alike} ± {std}");
    }
    assert!((last.running.uncertainty_px.median / uncertainty_px.median - 1.0).abs() < 0.02);
}
