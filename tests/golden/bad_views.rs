//! Wrong corners and wrong views: they change nothing, and are named.

use plumb::calibration::solve::solve_views;
use plumb::estimation::camera::{CameraOptions, calibrate_camera};
use plumb::estimation::problem::{CameraProblem, LensChoice};
use plumb::estimation::view_fault::{GridLine, ViewFault};
use plumb::geometry::lens::LensModel;
use plumb::geometry::pixel::Pixel;
use rand::RngExt;

use crate::seeded_camera::{SeededCamera, worst_projection_in_stds};

const COLS: usize = 9;
const ROWS: usize = 6;

fn options() -> CameraOptions {
    CameraOptions { lens: LensChoice::Model(LensModel::Brown), ..CameraOptions::default() }
}

fn problem() -> (SeededCamera, CameraProblem) {
    let camera = SeededCamera::ordinary();
    let mut rng = SeededCamera::rng(21);
    let poses = camera.poses(30, &mut rng);
    let problem = camera.problem(&poses, &mut rng);
    (camera, problem)
}

#[test]
fn a_tenth_of_the_corners_twenty_pixels_off_change_nothing() {
    let (camera, clean) = problem();
    for (part, offset_px) in [(0.05, 5.0), (0.1, 20.0)] {
        let mut problem = clean.clone();
        let mut rng = SeededCamera::rng(22);
        let mut wrong = 0;
        for corner in problem.views.iter_mut().flat_map(|view| &mut view.correspondences) {
            if rng.random::<f64>() < part {
                let angle: f64 = rng.random_range(0.0..std::f64::consts::TAU);
                corner.pixel.x += offset_px * angle.cos();
                corner.pixel.y += offset_px * angle.sin();
                wrong += 1;
            }
        }
        let estimate = calibrate_camera(&problem, &options()).unwrap();
        let sigmas = worst_projection_in_stds(&camera.lens, &estimate);
        assert!(sigmas < 3.0, "{part} of the corners {offset_px} px off: {sigmas} sigma");
        assert!((estimate.noise - camera.noise_px).abs() < 0.005, "noise {}", estimate.noise);
        let unused =
            estimate.views.iter().flat_map(|view| &view.used).filter(|used| !**used).count();
        assert!(unused >= wrong && unused <= wrong + 2, "{unused} rejected of {wrong} wrong ones");
    }
}

#[test]
fn a_wrong_view_is_named_and_changes_nothing() {
    let (camera, clean) = problem();
    let grid = |place: &dyn Fn(usize, usize) -> (usize, usize)| -> Vec<usize> {
        (0..COLS * ROWS)
            .map(|k| place(k % COLS, k / COLS))
            .map(|(col, row)| row * COLS + col)
            .collect()
    };
    let listed = |k: usize| k % ROWS * COLS + k / ROWS;
    let relabeled: [(&str, Vec<usize>, Option<ViewFault>); 6] = [
        ("mirrored", grid(&|c, r| (COLS - 1 - c, r)), Some(ViewFault::Mirrored)),
        (
            "shifted by a column",
            grid(&|c, r| ((c + 1) % COLS, r)),
            Some(ViewFault::Shifted(GridLine::Column)),
        ),
        (
            "shifted by a row",
            grid(&|c, r| (c, (r + ROWS - 1) % ROWS)),
            Some(ViewFault::Shifted(GridLine::Row)),
        ),
        ("transposed", (0..COLS * ROWS).map(listed).collect(), Some(ViewFault::Transposed)),
        ("rotated by half a turn", grid(&|c, r| (COLS - 1 - c, ROWS - 1 - r)), None),
        ("shuffled", (0..COLS * ROWS).map(|k| k * 31 % (COLS * ROWS)).collect(), None),
    ];
    for (name, order, fault) in relabeled {
        let mut problem = clean.clone();
        let pixels: Vec<Pixel> = problem.views[7].correspondences.iter().map(|c| c.pixel).collect();
        for (corner, from) in problem.views[7].correspondences.iter_mut().zip(order) {
            corner.pixel = pixels[from];
        }
        let solved = solve_views(&problem, &options()).unwrap();
        let found = solved.estimate.views[7].fault;
        match name {
            "shuffled" => assert!(matches!(found, Some(ViewFault::NoPose { .. })), "{found:?}"),
            _ => assert_eq!(found, fault, "{name}"),
        }
        let others = solved.estimate.views.iter().enumerate().filter(|(index, _)| *index != 7);
        assert!(
            others.into_iter().all(|(_, view)| view.fault.is_none()),
            "{name}: another view was blamed"
        );
        let sigmas = worst_projection_in_stds(&camera.lens, &solved.estimate);
        assert!(sigmas < 3.0, "{name}: {sigmas} sigma");
        if found.is_some() {
            assert!(
                solved.verdict.reasons.iter().any(|reason| reason.contains("`view 7`")),
                "{:?}",
                solved.verdict
            );
        }
    }
}

#[test]
fn a_view_seen_in_one_place_is_named_and_changes_nothing() {
    let (camera, mut problem) = problem();
    for corner in &mut problem.views[7].correspondences {
        corner.pixel = Pixel::new(320.0, 240.0);
    }
    let estimate = calibrate_camera(&problem, &options()).unwrap();
    assert_eq!(estimate.views[7].fault, Some(ViewFault::PixelsOnLine));
    assert!(worst_projection_in_stds(&camera.lens, &estimate) < 3.0);
}

#[test]
fn views_of_no_or_few_corners_are_named_and_change_nothing() {
    let (camera, mut problem) = problem();
    problem.views[3].correspondences.clear();
    problem.views[7].correspondences.truncate(5);
    let estimate = calibrate_camera(&problem, &options()).unwrap();
    assert_eq!(estimate.views[3].fault, Some(ViewFault::TooFewPoints { points: 0, needed: 6 }));
    assert_eq!(estimate.views[7].fault, Some(ViewFault::TooFewPoints { points: 5, needed: 6 }));
    assert!(worst_projection_in_stds(&camera.lens, &estimate) < 3.0);
}

#[test]
fn a_copy_is_named_after_the_first_view_that_it_equals() {
    let (camera, mut problem) = problem();
    problem.views.insert(20, problem.views[3].clone());
    problem.views.push(problem.views[3].clone());
    let estimate = calibrate_camera(&problem, &options()).unwrap();
    for (number, view) in estimate.views.iter().enumerate() {
        let copied = [20, 31].contains(&number).then_some(ViewFault::Copied { number: 4 });
        assert_eq!(view.fault, copied, "view {number}");
    }
    assert!(worst_projection_in_stds(&camera.lens, &estimate) < 3.0);
}
