//! The predicted uncertainty is the scatter that is observed: 200 seeded runs of each camera.

use plumb::calibration::solve::solve_views;
use plumb::estimation::camera::{CameraOptions, CameraStart, calibrate_camera};
use plumb::estimation::problem::{BoardShape, LensChoice};
use plumb::estimation::uncertainty::{
    Distance, PixelGrid, projection_difference, projection_uncertainty,
};
use plumb::geometry::lens::LensModel;

use crate::seeded_camera::SeededCamera;

const RUNS: u64 = 200;

fn with(model: LensModel) -> CameraOptions {
    CameraOptions { lens: LensChoice::Model(model), ..CameraOptions::default() }
}

struct Scatter {
    /// Observed over predicted rms projection error over the image.
    projection: f64,
    /// Observed over predicted standard deviation of each estimated parameter.
    parameters: Vec<f64>,
    /// Each parameter's mean error in standard deviations of that mean.
    bias: Vec<f64>,
    /// Part of the parameters within 1 and 2 standard deviations of the truth.
    within: [f64; 2],
}

/// The same poses in every run, other noise.
fn scatter(camera: &SeededCamera, views: usize) -> Scatter {
    let poses = camera.poses(views, &mut SeededCamera::rng(77));
    let grid = PixelGrid::over(camera.size, 10);
    let truth = camera.lens.parameters();
    let (mut observed, mut predicted) = (0.0, 0.0);
    let mut squares = vec![[0.0; 3]; truth.len()];
    let (mut within, mut count) = ([0.0; 2], 0.0);
    for run in 0..RUNS {
        let problem = camera.problem(&poses, &mut SeededCamera::rng(1000 + run));
        let estimate = calibrate_camera(&problem, &with(camera.lens.model())).unwrap();
        let map = projection_uncertainty(
            &estimate.lens,
            &estimate.lens_covariance,
            grid,
            Distance::Infinity,
        )
        .unwrap();
        let difference = projection_difference(&camera.lens, &estimate.lens, grid, &map.weights);
        let seen: Vec<_> = difference.into_iter().flatten().collect();
        observed += seen.iter().map(|[x, y]| x * x + y * y).sum::<f64>() / seen.len() as f64;
        predicted += map.mean_square_px2();
        for ((sums, truth), (found, std)) in squares
            .iter_mut()
            .zip(&truth)
            .zip(estimate.lens.parameters().iter().zip(estimate.lens_std()))
        {
            let error = found - truth;
            *sums = [sums[0] + error, sums[1] + error * error, sums[2] + std * std];
            if std > 0.0 {
                count += 1.0;
                within[0] += f64::from(u8::from(error.abs() < std));
                within[1] += f64::from(u8::from(error.abs() < 2.0 * std));
            }
        }
    }
    let estimated: Vec<_> = squares.iter().filter(|sums| sums[2] > 0.0).collect();
    Scatter {
        projection: (observed / predicted).sqrt(),
        parameters: estimated
            .iter()
            .map(|[_, square, predicted]| (square / predicted).sqrt())
            .collect(),
        bias: estimated.iter().map(|[sum, _, predicted]| sum / predicted.sqrt()).collect(),
        within: within.map(|n| n / count * 100.0),
    }
}

#[test]
fn predicted_and_observed_scatter_agree() {
    let cameras = [
        ("ordinary", SeededCamera::ordinary(), 25),
        ("narrow", SeededCamera::narrow(), 25),
        ("wide", SeededCamera::wide(), 25),
        ("fisheye", SeededCamera::fisheye(), 25),
        ("few views", SeededCamera::ordinary(), 6),
    ];
    for (name, camera, views) in cameras {
        let Scatter { projection, parameters, bias, within } = scatter(&camera, views);
        println!(
            "{name}: projection {projection:.3}, within {within:.1?} %, bias {bias:.2?}, parameters {parameters:.3?}"
        );
        assert!(
            (0.85..1.15).contains(&projection),
            "{name}: observed/predicted projection error {projection}"
        );
        for (ratio, bias) in parameters.iter().zip(&bias) {
            assert!((0.85..1.15).contains(ratio), "{name}: observed/predicted {parameters:?}");
            assert!(bias.abs() < 3.5, "{name}: bias in its standard deviations {bias:?}");
        }
        assert!(
            (within[0] - 68.3).abs() < 4.0 && (within[1] - 95.4).abs() < 4.0,
            "{name}: {within:?} %"
        );
    }
}

#[test]
fn a_wrong_model_is_named() {
    let fisheye = SeededCamera::fisheye();
    let mut rng = SeededCamera::rng(5);
    let poses = fisheye.poses(40, &mut rng);
    let problem = fisheye.problem(&poses, &mut rng);
    let right = solve_views(&problem, &with(LensModel::KannalaBrandt)).unwrap();
    let ratio = right.checks.split_half_ratio.unwrap();
    assert!((0.3..2.0).contains(&ratio), "split-half ratio {ratio} with the right model");
    assert!(
        !right.verdict.reasons.iter().any(|reason| reason.contains("does not fit")),
        "{:?}",
        right.verdict
    );
    let mut named = 0;
    for model in [LensModel::Pinhole, LensModel::Radial] {
        // A refusal is as good an answer.
        let Ok(wrong) = solve_views(&problem, &with(model)) else { continue };
        named += 1;
        let reasons = &wrong.verdict.reasons;
        assert!(
            reasons.iter().any(|reason| reason.contains("the model does not fit")),
            "{model}: {reasons:?}"
        );
    }
    assert!(named > 0, "both are refused: nothing was judged");
}

#[test]
fn going_on_from_an_estimate_gives_the_same_answer() {
    let camera = SeededCamera::ordinary();
    let mut rng = SeededCamera::rng(6);
    let poses = camera.poses(31, &mut rng);
    let all = camera.problem(&poses, &mut rng);
    let mut earlier = all.clone();
    earlier.views.pop();
    let options = with(LensModel::Brown);
    let start: CameraStart = calibrate_camera(&earlier, &options).unwrap().to_start();
    let anew = calibrate_camera(&all, &options).unwrap();
    let warm = calibrate_camera(&all, &CameraOptions { start: Some(start), ..options }).unwrap();
    for ((warm, anew), std) in
        warm.lens.parameters().iter().zip(anew.lens.parameters()).zip(anew.lens_std())
    {
        assert!((warm - anew).abs() <= 0.01 * std, "{warm} {anew} ± {std}");
    }
}

#[test]
fn a_bent_board_is_named_and_its_bow_can_be_estimated() {
    let camera = SeededCamera::ordinary();
    let mut rng = SeededCamera::rng(7);
    let poses = camera.poses(30, &mut rng);
    let mut problem = camera.problem(&poses, &mut rng);
    // Two millimeters at the middle along x, none at the edges.
    let half_m = 0.12;
    for (view, pose) in problem.views.iter_mut().zip(&poses) {
        for corner in &mut view.correspondences {
            let mut point = corner.point_in_board;
            point.z = 0.002 * (1.0 - ((point.x - half_m) / half_m).powi(2));
            let [flat, bent] = [corner.point_in_board, point]
                .map(|p| camera.lens.pixel_from_point(&(*pose * p)).unwrap());
            corner.pixel.x += bent.x - flat.x;
            corner.pixel.y += bent.y - flat.y;
        }
    }
    let flat = CameraOptions { board_shape: BoardShape::Flat, ..with(LensModel::Brown) };
    let flat = solve_views(&problem, &flat).unwrap();
    assert!(
        flat.verdict.reasons.iter().any(|reason| reason.contains("bent")),
        "{:?}",
        flat.verdict
    );
    let bowed = solve_views(&problem, &with(LensModel::Brown)).unwrap();
    let [x, y] = bowed.estimate.board_shape.as_ref().unwrap().bow_m;
    assert!((x - 0.002).abs() < 1e-4 && y.abs() < 1e-4, "bow of {x} {y} m");
    assert!((bowed.estimate.noise - 0.1).abs() < 0.005, "noise {}", bowed.estimate.noise);
    assert!(
        bowed.verdict.reasons.iter().any(|reason| reason.contains("corrected for")),
        "{:?}",
        bowed.verdict
    );
    assert!(
        !bowed.verdict.reasons.iter().any(|reason| reason.contains("bent")),
        "{:?}",
        bowed.verdict
    );
}
