//! One camera: exact data gives exact answers, noisy data errors as predicted, bad data refusals
//! that say what to do.

use plumb::calibration::solve::solve_views;
use plumb::estimation::camera::{CameraEstimate, CameraOptions, calibrate_camera};
use plumb::estimation::error::EstimationError;
use plumb::estimation::problem::{CameraProblem, LensChoice};
use plumb::geometry::lens::LensModel;
use plumb::geometry::pixel::{ImageSize, Pixel};

use crate::seeded_camera::{SeededCamera, largest};

/// Lenses on either side of ξ = 0: parameters of two lenses that are seen 75 and 90 degrees off the
/// axis in an image of 640 × 480.
const DOUBLE_SPHERES: [[f64; 7]; 2] =
    [[330.0, 331.0, 319.0, 241.0, 0.0, 0.3, 0.4], [200.0, 201.0, 319.0, 241.0, 0.0, -0.1, 0.55]];

fn with(model: LensModel) -> CameraOptions {
    CameraOptions { lens: LensChoice::Model(model), ..CameraOptions::default() }
}

fn seeded(camera: &SeededCamera, views: usize, seed: u64) -> CameraProblem {
    let mut rng = SeededCamera::rng(seed);
    let poses = camera.poses(views, &mut rng);
    camera.problem(&poses, &mut rng)
}

fn worst_parameter_in_sigmas(camera: &SeededCamera, estimate: &CameraEstimate) -> f64 {
    let (found, truth, std) =
        (estimate.lens.parameters(), camera.lens.parameters(), estimate.lens_std());
    // A skew that is not estimated has none, and is right.
    let pairs = found.iter().zip(truth).zip(std).filter(|((found, truth), _)| *found != truth);
    largest(pairs.map(|((found, truth), std)| (found - truth).abs() / std))
}

fn refusal(problem: &CameraProblem) -> EstimationError {
    match calibrate_camera(problem, &with(LensModel::Brown)) {
        Err(error) => error,
        Ok(estimate) => panic!("accepted, with {:?} ± {:?}", estimate.lens, estimate.lens_std()),
    }
}

#[test]
fn every_lens_model_is_recovered_exactly_from_exact_corners() {
    let size = ImageSize::new(640, 480);
    let cameras = [
        SeededCamera::new(LensModel::Pinhole, size, &[560.0, 555.0, 328.0, 235.0, 0.0]),
        SeededCamera::new(LensModel::Radial, size, &[560.0, 555.0, 328.0, 235.0, 0.0, -0.2]),
        SeededCamera::ordinary(),
        SeededCamera::new(
            LensModel::Rational,
            size,
            &[560.0, 555.0, 328.0, 235.0, 0.0, 0.3, -0.1, 0.0008, -0.0005, 0.01, 0.52, -0.05, 0.02],
        ),
        SeededCamera::wide(),
        SeededCamera::fisheye(),
        SeededCamera::narrow(),
        SeededCamera::new(LensModel::Eucm, size, &[250.0, 251.0, 319.0, 241.0, 0.0, 0.6, 1.1]),
        SeededCamera::new(LensModel::DoubleSphere, size, &DOUBLE_SPHERES[0]),
        SeededCamera::new(LensModel::DoubleSphere, size, &DOUBLE_SPHERES[1]),
    ];
    let covered = |model: &LensModel| cameras.iter().any(|camera| camera.lens.model() == *model);
    assert!(LensModel::ALL.iter().all(covered));
    for mut camera in cameras {
        camera.noise_px = 0.0;
        let estimate =
            calibrate_camera(&seeded(&camera, 15, 1), &with(camera.lens.model())).unwrap();
        let model = camera.lens.model();
        assert_eq!(estimate.other_minimum, None, "{model}");
        assert!(estimate.rms_px < 1e-6, "{model}: rms {}", estimate.rms_px);
        if model != LensModel::Rational {
            let error = (estimate.lens.matrix.fx - camera.lens.matrix.fx).abs();
            assert!(error < 1e-4, "{model}: fx off by {error}");
        }
        let unused =
            estimate.views.iter().find(|view| view.fault.is_some() || view.used.contains(&false));
        assert!(unused.is_none(), "{model}: {:?}", unused.map(|view| (&view.name, view.fault)));
    }
}

/// Sides of ξ = 0 that fit alike: focal lengths differ by a third or a fourth, projections do not.
#[test]
fn double_sphere_lenses_are_off_by_as_much_as_is_stated() {
    for (parameters, seeds) in DOUBLE_SPHERES.iter().zip([100, 200]) {
        let camera =
            SeededCamera::new(LensModel::DoubleSphere, ImageSize::new(640, 480), parameters);
        let mut squares = [0.0; 3];
        for seed in seeds..seeds + SEEDS {
            let problem = seeded(&camera, 15, seed);
            let estimate = calibrate_camera(&problem, &with(LensModel::DoubleSphere)).unwrap();
            let (found, std) = (estimate.lens.parameters(), estimate.lens_std());
            for (square, index) in squares.iter_mut().zip([0, 5, 6]) {
                *square += ((found[index] - parameters[index]) / std[index]).powi(2);
            }
        }
        let in_stds = squares.map(|square| (square / SEEDS as f64).sqrt());
        println!("xi {}: errors over deviations {in_stds:?}", parameters[5]);
        assert!(in_stds.iter().all(|rms| (0.5..1.4).contains(rms)), "{in_stds:?}");
    }
}

const SEEDS: u64 = 20;

#[test]
fn noisy_corners_give_errors_as_predicted() {
    for camera in [
        SeededCamera::ordinary(),
        SeededCamera::wide(),
        SeededCamera::fisheye(),
        SeededCamera::narrow(),
    ] {
        let solved = solve_views(&seeded(&camera, 25, 2), &with(camera.lens.model())).unwrap();
        let sigmas = worst_parameter_in_sigmas(&camera, &solved.estimate);
        assert!(sigmas < 3.5, "{}: {sigmas} sigma", camera.lens.model());
        assert!((solved.estimate.noise - 0.1).abs() < 0.005, "noise {}", solved.estimate.noise);
        let ratio = solved.checks.split_half_ratio.unwrap();
        assert!((0.2..2.0).contains(&ratio), "split-half ratio {ratio}");
        let held_out = solved.checks.held_out_rms_px.unwrap();
        assert!((0.13..0.16).contains(&held_out), "held-out rms {held_out} px");
    }
}

#[test]
fn what_cannot_be_calibrated_is_refused_with_what_to_do() {
    let camera = SeededCamera::ordinary();
    let good = seeded(&camera, 10, 3);
    let refused = |change: &dyn Fn(&mut CameraProblem)| {
        let mut problem = good.clone();
        change(&mut problem);
        refusal(&problem)
    };
    let two = refused(&|problem| problem.views.truncate(2));
    assert!(matches!(two, EstimationError::TooFewViews { usable: 2, needed: 3, .. }), "{two}");
    let nan = refused(&|problem| problem.views[4].correspondences[7].pixel.x = f64::NAN);
    assert!(
        nan.to_string().contains("view `view 4`, point 7: the pixel is not a finite number"),
        "{nan}"
    );
    let spot = refused(&|problem| {
        for view in &mut problem.views[..8] {
            view.correspondences.iter_mut().for_each(|c| c.pixel = Pixel::new(320.0, 240.0));
        }
    });
    assert!(
        spot.to_string()
            .contains("view `view 0`: its corners were all seen on one line or in one place"),
        "{spot}"
    );
    let one = refused(&|problem| problem.views.truncate(1));
    assert!(matches!(one, EstimationError::TooFewViews { usable: 1, needed: 3, .. }), "{one}");
    // A board of 12 pixels, wherever it is held.
    let tiny: Vec<_> = (0..12)
        .map(|k| {
            let (a, b) = ((1.3 * f64::from(k)).sin(), (2.1 * f64::from(k)).cos());
            let middle = nalgebra::Vector3::new(3.0 * a, 2.0 * b, 11.0);
            plumb::geometry::pose::Pose::from_axis_angle(
                nalgebra::Vector3::new(0.6 * b, 0.6 * a, 0.2 * a),
                middle,
            )
        })
        .collect();
    let tiny = refusal(&camera.problem(&tiny, &mut SeededCamera::rng(5)));
    assert!(tiny.to_string().contains("let it fill more of the image"), "{tiny}");
    let empty = refused(&|problem| problem.views.clear());
    assert!(matches!(empty, EstimationError::TooFewViews { usable: 0, .. }), "{empty}");
    let size = refused(&|problem| problem.image_size = ImageSize::new(0, 480));
    assert!(matches!(size, EstimationError::ImageSize { .. }), "{size}");
    let flat = SeededCamera { tilt: 1e-9, ..SeededCamera::ordinary() };
    let parallel: Vec<_> = (0..8)
        .map(|k| {
            plumb::geometry::pose::Pose::from_axis_angle(
                nalgebra::Vector3::new(0.0, 0.0, 0.1 * f64::from(k)),
                nalgebra::Vector3::new(
                    -0.1,
                    -0.08 + 0.005 * f64::from(k),
                    0.4 + 0.02 * f64::from(k),
                ),
            )
        })
        .collect();
    for noise_px in [0.0, 0.1] {
        let flat = SeededCamera { noise_px, ..flat.clone() };
        let problem = flat.problem(&parallel, &mut SeededCamera::rng(4));
        let error = refusal(&problem);
        assert!(matches!(error, EstimationError::ParallelViews), "{error}");
    }
}
