//! `auto` finds the model that made the images, and none with more parameters than they show.

use nalgebra::Vector3;
use plumb::calibration::solve::solve_views;
use plumb::estimation::camera::{CameraOptions, calibrate_camera, calibrate_with_jackknife};
use plumb::estimation::interrupt::Interrupt;
use plumb::estimation::problem::{CameraProblem, GivenParameter, LensChoice};
use plumb::geometry::lens::{Lens, LensModel};
use plumb::geometry::pixel::ImageSize;
use rand_distr::{Distribution, Normal};

use crate::misfit::rolling;
use crate::seeded_camera::{SeededCamera, worst_projection_in_stds};

#[test]
fn auto_finds_the_true_model() {
    let size = ImageSize::new(640, 480);
    let cameras = [
        SeededCamera::new(LensModel::Pinhole, size, &[560.0, 555.0, 328.0, 235.0, 0.0]),
        SeededCamera::new(LensModel::Radial, size, &[560.0, 555.0, 328.0, 235.0, 0.0, -0.2]),
        SeededCamera::ordinary(),
        SeededCamera::fisheye(),
    ];
    for camera in cameras {
        let mut rng = SeededCamera::rng(31);
        let poses = camera.poses(30, &mut rng);
        let estimate =
            calibrate_camera(&camera.problem(&poses, &mut rng), &CameraOptions::default()).unwrap();
        assert_eq!(estimate.lens.model(), camera.lens.model(), "{:?}", estimate.compared);
        assert!(estimate.compared.len() >= 3, "{:?}", estimate.compared);
    }
}

#[test]
fn auto_errs_no_more_than_it_says_and_takes_no_parameter_that_the_lens_lacks() {
    let size = ImageSize::new(640, 480);
    let rational =
        [560.0, 555.0, 328.0, 235.0, 0.0, 0.3, -0.1, 0.0008, -0.0005, 0.01, 0.52, -0.05, 0.02];
    let cameras = [
        (
            "pinhole",
            SeededCamera::new(LensModel::Pinhole, size, &[560.0, 555.0, 328.0, 235.0, 0.0]),
        ),
        (
            "radial",
            SeededCamera::new(LensModel::Radial, size, &[560.0, 555.0, 328.0, 235.0, 0.0, -0.2]),
        ),
        ("ordinary", SeededCamera::ordinary()),
        ("narrow", SeededCamera::narrow()),
        ("wide", SeededCamera::wide()),
        ("rational", SeededCamera::new(LensModel::Rational, size, &rational)),
        ("fisheye", SeededCamera::fisheye()),
    ];
    for (name, camera) in cameras {
        for (views, seed) in [(12, 0), (12, 1), (20, 2), (20, 3), (40, 4)] {
            let mut rng = SeededCamera::rng(4100 + seed);
            let poses = camera.poses(views, &mut rng);
            let estimate =
                calibrate_camera(&camera.problem(&poses, &mut rng), &CameraOptions::default())
                    .unwrap();
            let case = format!("{name}, {views} views, seed {seed}: {:?}", estimate.compared);
            let (found, truth) = (estimate.lens.parameters().len(), camera.lens.parameters().len());
            assert!(found <= truth, "{found} parameters of {truth}: {case}");
            let sigmas = worst_projection_in_stds(&camera.lens, &estimate);
            assert!(sigmas < 4.0, "{sigmas} sigma: {case}");
        }
    }
}

/// Views of a board that is bowed by `height_m` and printed a tenth of a millimeter off.
fn uneven(camera: &SeededCamera, views: usize, seed: u64, height_m: f64) -> CameraProblem {
    let mut rng = SeededCamera::rng(seed);
    let poses = camera.poses(views, &mut rng);
    let mut problem = camera.problem(&poses, &mut rng);
    let own = Normal::new(0.0, 1e-4).unwrap();
    let corners = problem.views[0].correspondences.iter().map(|seen| seen.point_in_board);
    let offsets: Vec<Vector3<f64>> = corners
        .map(|corner| {
            let [x, y] = [corner.x / 0.24, corner.y / 0.15];
            let height = height_m * ((3.0 * x).sin() + x * y - y * y);
            Vector3::new(own.sample(&mut rng), own.sample(&mut rng), height)
        })
        .collect();
    for (view, pose) in problem.views.iter_mut().zip(&poses) {
        for (seen, offset) in view.correspondences.iter_mut().zip(&offsets) {
            let of = |point| camera.lens.pixel_from_point(&(*pose * point)).unwrap();
            let [flat, there] = [of(seen.point_in_board), of(seen.point_in_board + offset)];
            seen.pixel.x += there.x - flat.x;
            seen.pixel.y += there.y - flat.y;
        }
    }
    problem
}

#[test]
fn the_order_of_views_changes_nothing() {
    let mut problem = uneven(&SeededCamera::wide(), 14, 6400, 1e-3);
    // A view that does not fit, and views that differ by more than their corners' noise: halves,
    // folds and solves without views are all compared.
    for corner in problem.views[5].correspondences.iter_mut().step_by(2) {
        corner.pixel.x += 3.0;
    }
    for (number, view) in problem.views.iter_mut().enumerate() {
        let most_px = [0.8, -0.5, 0.1, -0.9][number % 4];
        for corner in &mut view.correspondences {
            let [x, y] = [corner.pixel.x / 320.0 - 1.0, corner.pixel.y / 240.0 - 1.0];
            let radius2 = x * x + y * y;
            corner.pixel.x += most_px * x * radius2;
            corner.pixel.y += most_px * y * radius2;
        }
    }
    let solve = |problem: &CameraProblem| {
        calibrate_with_jackknife(problem, &CameraOptions::default()).unwrap()
    };
    let (estimate, check) = solve(&problem);
    assert!(estimate.variance_inflation > 1.0, "the test means to have solves without views");
    let mut rotated = problem.clone();
    rotated.views.rotate_left(5);
    let mut reversed = problem.clone();
    reversed.views.reverse();
    for other in [rotated, reversed] {
        let (mut again, check_again) = solve(&other);
        let names: Vec<&str> = again.views.iter().map(|view| view.name.as_str()).collect();
        let given: Vec<&str> = other.views.iter().map(|view| view.name.as_str()).collect();
        assert_eq!(names, given);
        let place = |name: &str| estimate.views.iter().position(|view| view.name == name);
        again.views.sort_by_key(|view| place(&view.name));
        assert_eq!(again, estimate);
        assert_eq!(check_again, check);
    }
}

#[test]
fn neither_an_uneven_board_nor_a_rolling_shutter_makes_auto_take_another_lens() {
    let precise = |camera| SeededCamera { noise_px: 0.02, ..camera };
    let cameras = [SeededCamera::ordinary(), SeededCamera::wide(), SeededCamera::fisheye()];
    let mut cases = Vec::new();
    for camera in cameras.map(precise) {
        for (views, seed) in [(12, 0), (20, 1), (30, 2)] {
            let problem = uneven(&camera, views, 6300 + seed, 1e-3);
            cases.push((format!("uneven, {views} views"), camera.clone(), problem));
        }
    }
    let (camera, problem) = rolling(12, 6303, (3e-3, 0.01));
    cases.push(("rolling, 12 views".to_owned(), camera, problem));
    for (case, camera, problem) in cases {
        let estimate = calibrate_camera(&problem, &CameraOptions::default()).unwrap();
        let case = format!("{}, {case}: {:?}", camera.lens.model(), estimate.compared);
        assert_eq!(estimate.lens.model(), camera.lens.model(), "{case}");
        let sigmas = worst_projection_in_stds(&camera.lens, &estimate);
        assert!(sigmas < 4.0, "{sigmas} sigma: {case}");
    }
}

/// Chance lets a larger lens predict views better by two standard errors once in forty times, and
/// the rational model contains the true one.
#[test]
fn a_rolling_shutter_seldom_makes_auto_take_a_larger_lens() {
    let mut others = Vec::new();
    for seed in 6304..6334 {
        let (camera, problem) = rolling(20, seed, (3e-3, 0.01));
        let estimate = calibrate_camera(&problem, &CameraOptions::default()).unwrap();
        let sigmas = worst_projection_in_stds(&camera.lens, &estimate);
        assert!(sigmas < 4.0, "seed {seed}: {sigmas} sigma: {:?}", estimate.compared);
        match estimate.lens.model() {
            LensModel::Brown => {}
            model => others.push((seed, model)),
        }
    }
    assert!(others.iter().all(|(_, model)| *model == LensModel::Rational), "{others:?}");
    assert!(others.len() <= 4, "{others:?}");
}

#[test]
fn a_stated_model_that_is_too_simple_is_reported_and_its_error_is_covered() {
    let cases = [
        (SeededCamera::ordinary(), LensModel::Pinhole, true),
        (SeededCamera::ordinary(), LensModel::Radial, true),
        (SeededCamera::wide(), LensModel::Radial, true),
        (SeededCamera::ordinary(), LensModel::Brown, false),
        (SeededCamera::ordinary(), LensModel::Rational, false),
        (SeededCamera::wide(), LensModel::Rational, false),
        (SeededCamera::fisheye(), LensModel::KannalaBrandt, false),
    ];
    for (camera, stated, too_simple) in cases {
        for (views, seed) in [(12, 0), (20, 1), (40, 2)] {
            let mut rng = SeededCamera::rng(5200 + seed);
            let poses = camera.poses(views, &mut rng);
            let lens = LensChoice::Model(stated);
            let options = CameraOptions { lens, ..CameraOptions::default() };
            let problem = camera.problem(&poses, &mut rng);
            let (estimate, check) = calibrate_with_jackknife(&problem, &options).unwrap();
            let case = format!(
                "{stated} for {}, {views} views: {:?}",
                camera.lens.model(),
                check.lens_misfit
            );
            let sigmas = worst_projection_in_stds(&camera.lens, &estimate);
            assert_eq!(check.lens_misfit.is_some(), too_simple, "{case}");
            assert!(sigmas < 5.0, "{sigmas} sigma: {case}");
        }
    }
}

#[test]
fn given_parameters_stay_and_square_pixels_are_square() {
    let camera = SeededCamera::ordinary();
    let mut rng = SeededCamera::rng(32);
    let poses = camera.poses(12, &mut rng);
    let problem = camera.problem(&poses, &mut rng);
    let lens = LensChoice::Model(LensModel::Brown);
    let given = |name: &str, value| GivenParameter { name: name.to_owned(), value };
    let given = vec![given("cx", 320.0), given("k3", 0.0)];
    let options = CameraOptions { lens, given, square_pixels: true, ..CameraOptions::default() };
    let estimate = calibrate_camera(&problem, &options).unwrap();
    let (parameters, std) = (estimate.lens.parameters(), estimate.lens_std());
    assert_eq!((parameters[2], parameters[9], std[2], std[9]), (320.0, 0.0, 0.0, 0.0));
    assert_eq!((parameters[0], std[0]), (parameters[1], std[1]));
    let unknown = CameraOptions {
        given: vec![GivenParameter { name: "k7".to_owned(), value: 0.0 }],
        ..options
    };
    let error = calibrate_camera(&problem, &unknown).unwrap_err();
    assert!(error.to_string().contains("no parameter `k7`"), "{error}");
}

/// Few views with blurred corners do not decide between models. What others would give is in the
/// covariance: errors are as it says, whether the chosen model is the true one or not.
#[test]
fn a_choice_that_views_do_not_decide_is_in_the_covariance() {
    let mild = [372.0, 371.0, 322.0, 236.0, 0.0, 0.002, 0.005, 0.002, 0.0005];
    let camera = SeededCamera {
        noise_px: 0.2,
        ..SeededCamera::new(LensModel::KannalaBrandt, ImageSize::new(640, 480), &mild)
    };
    let (mut squares, mut others, mut wider) = (Vec::new(), 0, 0);
    for seed in 0..24 {
        let mut rng = SeededCamera::rng(8600 + seed);
        let poses = camera.poses(6, &mut rng);
        let problem = camera.problem(&poses, &mut rng);
        let chosen = calibrate_camera(&problem, &CameraOptions::default()).unwrap();
        let lens = LensChoice::Model(chosen.lens.model());
        let stated =
            calibrate_camera(&problem, &CameraOptions { lens, ..CameraOptions::default() })
                .unwrap();
        let [with, without] = [&chosen, &stated].map(|estimate| estimate.lens_std()[0]);
        squares.push(((chosen.lens.matrix.fx - camera.lens.matrix.fx) / with).powi(2));
        others += usize::from(chosen.lens.model() != camera.lens.model());
        wider += usize::from(with > 1.05 * without);
    }
    let z = (squares.iter().sum::<f64>() / squares.len() as f64).sqrt();
    assert!(others > 4 && wider > 4, "{others} other models, {wider} wider");
    // Twenty-four give the rms of a deviate to 0.14.
    assert!((0.6..1.4).contains(&z), "{z}");
}

/// A plain fit to a board that is far from flat leaves a large model far from the lens.
#[test]
fn beside_a_bent_board_a_larger_model_predicts_no_worse_than_one_that_it_holds() {
    let camera = SeededCamera { noise_px: 0.05, ..SeededCamera::ordinary() };
    for seed in 0..8 {
        let problem = uneven(&camera, 20, 6900 + seed, 4e-3);
        let estimate = calibrate_camera(&problem, &CameraOptions::default()).unwrap();
        let held_out_px = |model| {
            let trial = estimate.compared.iter().find(|trial| trial.model == model);
            trial.map(|trial| trial.held_out_rms_px)
        };
        assert_eq!(estimate.lens.model(), LensModel::Brown, "{seed}: {:?}", estimate.compared);
        let brown_px = held_out_px(LensModel::Brown).unwrap();
        // With a pole in the image it is left out.
        if let Some(rational_px) = held_out_px(LensModel::Rational) {
            assert!(rational_px < 1.3 * brown_px, "{seed}: {:?}", estimate.compared);
        }
    }
}

/// Views that do not determine all coefficients of numerator and denominator let them cancel but for
/// a pole; then the denominator is a smaller one.
#[test]
fn a_rational_lens_has_no_pole_and_errs_no_more_than_it_says() {
    let cameras = [SeededCamera::ordinary(), SeededCamera::narrow(), SeededCamera::wide()];
    let options =
        CameraOptions { lens: LensChoice::Model(LensModel::Rational), ..CameraOptions::default() };
    let mut smaller = 0;
    for (k, camera) in cameras.iter().enumerate() {
        for seed in 0..6 {
            let mut rng = SeededCamera::rng(7300 + seed);
            let problem = camera.problem(&camera.poses(12, &mut rng), &mut rng);
            let solved = solve_views(&problem, &options).unwrap();
            let (lens, std) = (solved.estimate.lens, solved.estimate.lens_std());
            let case = format!("camera {k}, seed {seed}: {lens:?}");
            let reasons = solved.verdict.reasons.join("; ");
            assert!(!reasons.contains("cancel"), "{case}: {reasons}");
            let [.., k5, k6] = lens.distortion.as_rational().unwrap();
            if (k5, k6) == (0.0, 0.0) {
                assert!(std.ends_with(&[0.0, 0.0]), "{case}: {std:?}");
                smaller += 1;
            }
            let sigmas = worst_projection_in_stds(&camera.lens, &solved.estimate);
            assert!(sigmas < 4.0, "{sigmas} sigma: {case}");
        }
    }
    assert!(smaller > 0);
}

/// A lens that is given whole is what it is, however far its model is from the lens: nothing of it is
/// made more uncertain.
#[test]
fn a_lens_that_is_given_whole_has_no_deviation() {
    let size = ImageSize::new(640, 480);
    let parameters = [560.0, 555.0, 328.0, 235.0, 0.0, -0.1];
    let camera = SeededCamera::new(LensModel::Radial, size, &parameters);
    let mut rng = SeededCamera::rng(38);
    let problem = camera.problem(&camera.poses(15, &mut rng), &mut rng);
    let straight = Lens::from_parameters(LensModel::Pinhole, &parameters[..5]).unwrap();
    let options = CameraOptions::holding(&straight, &Interrupt::new());
    let solved = solve_views(&problem, &options).unwrap();
    assert!(solved.estimate.lens_covariance.iter().all(|value| *value == 0.0));
    let reasons = solved.verdict.reasons.join("; ");
    assert!(reasons.contains("pinhole is too simple for this lens"), "{reasons}");
    assert!(!reasons.contains("inf") && !reasons.contains("NaN"), "{reasons}");
    assert!(!reasons.contains("differ too much to be compared"), "{reasons}");
}
