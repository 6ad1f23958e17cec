//! What the corners' own standard deviations are worth: weights follow them as far as the residuals
//! bear them out.

use plumb::estimation::camera::{CameraEstimate, CameraOptions, calibrate_camera};
use plumb::estimation::problem::{CameraProblem, LensChoice};
use plumb::geometry::lens::LensModel;
use plumb::geometry::pixel::Pixel;
use rand_distr::{Distribution, Normal};

use crate::seeded_camera::SeededCamera;

const SEEDS: u64 = 40;

fn solve(problem: &CameraProblem) -> CameraEstimate {
    let options =
        CameraOptions { lens: LensChoice::Model(LensModel::Brown), ..CameraOptions::default() };
    calibrate_camera(problem, &options).unwrap()
}

fn equally_weighted(problem: &CameraProblem) -> CameraProblem {
    let mut equal = problem.clone();
    equal
        .views
        .iter_mut()
        .flat_map(|view| &mut view.correspondences)
        .for_each(|corner| corner.std_px = 1.0);
    equal
}

/// Over seeded views of which each corner errs by `noise_px` and is stated to err by `stated_px`
/// (both of the view, the corner and a standard normal number): the mean square of the focal
/// length's error in its own predicted standard deviations, that error's mean square beside the one
/// with equal weights, and the median common error in pixels.
fn over_seeds(noise_px: impl Fn(usize) -> f64, stated_px: impl Fn(usize, f64) -> f64) -> [f64; 3] {
    let camera = SeededCamera { noise_px: 1e-9, ..SeededCamera::ordinary() };
    let normal = Normal::new(0.0, 1.0).unwrap();
    let (mut own, mut ours, mut equals, mut noise_floor_px) = (0.0, 0.0, 0.0, Vec::new());
    for seed in 0..SEEDS {
        let mut rng = SeededCamera::rng(700 + seed);
        let poses = camera.poses(16, &mut rng);
        let mut problem = camera.problem(&poses, &mut rng);
        for (index, view) in problem.views.iter_mut().enumerate() {
            for corner in &mut view.correspondences {
                let [x, y] = [0, 1].map(|_| noise_px(index) * normal.sample(&mut rng));
                corner.pixel = Pixel::new(corner.pixel.x + x, corner.pixel.y + y);
                corner.std_px = stated_px(index, normal.sample(&mut rng));
            }
        }
        let error = |estimate: &CameraEstimate| estimate.lens.matrix.fx - camera.lens.matrix.fx;
        let (estimate, equal) = (solve(&problem), solve(&equally_weighted(&problem)));
        own += (error(&estimate) / estimate.lens_std()[0]).powi(2) / SEEDS as f64;
        ours += error(&estimate).powi(2);
        equals += error(&equal).powi(2);
        noise_floor_px.push(estimate.noise_floor_px);
    }
    noise_floor_px.sort_by(f64::total_cmp);
    [own, ours / equals, noise_floor_px[noise_floor_px.len() / 2]]
}

#[test]
fn deviations_that_no_residual_bears_out_change_little() {
    let [own, beside_equal, noise_floor_px] =
        over_seeds(|_| 0.1, |_, chance| 0.1 * (0.4 * chance).exp());
    println!(
        "stated at random: {own:.2} predicted variances, {beside_equal:.3} of equal weights, common {noise_floor_px:.3} px"
    );
    assert!((0.5..1.6).contains(&own), "{own} predicted variances");
    assert!(
        beside_equal < 1.05 && noise_floor_px > 0.1,
        "{beside_equal} of equal weights, common error {noise_floor_px} px"
    );
}

#[test]
fn deviations_that_residuals_bear_out_are_the_weights() {
    let of_view = |view: usize| if view.is_multiple_of(2) { 0.05 } else { 0.5 };
    let [own, _, noise_floor_px] =
        over_seeds(of_view, |view, chance| of_view(view) * (0.1 * chance).exp());
    println!("stated rightly: {own:.2} predicted variances, common {noise_floor_px:.3} px");
    assert!((0.5..1.6).contains(&own), "{own} predicted variances");
    assert!(
        noise_floor_px < 0.03,
        "a common error of {noise_floor_px} px, where corners of 0.05 px err by that"
    );
}
