//! Colour and depth together: the predicted uncertainty is the scatter that is observed, and depth's error goes away.

use nalgebra::Vector6;
use plumb::calibration::solve_rgbd::{SolvedRgbd, solve_rgbd};
use plumb::geometry::pixel::Pixel;

use crate::seeded_camera::SeededCamera;
use crate::seeded_rgbd::SeededRgbd;

const RUNS: u64 = 100;

/// Of each run with the same poses and other noise, where depth is found to be off, in predicted standard deviations.
fn scatter(rig: &SeededRgbd, views: usize) -> Vec<Vector6<f64>> {
    let poses = rig.poses(views, &mut SeededCamera::rng(31));
    let truth = rig.depth_from_color.inverse();
    let run = |run: u64| {
        let input = rig.input(&poses, &mut SeededCamera::rng(500 + run));
        let joint = solve_rgbd(&input, &SeededRgbd::options()).unwrap().joint;
        let turn = (joint.color_from_depth.rotation() * truth.rotation().inverse()).scaled_axis();
        let shift = joint.color_from_depth.translation() - truth.translation();
        let std = |k: usize| joint.color_from_depth_covariance[(k, k)].sqrt();
        Vector6::from_fn(|k, _| if k < 3 { turn[k] } else { shift[k - 3] } / std(k))
    };
    (0..RUNS).map(run).collect()
}

/// All six numbers together within a fifth of what is predicted, and no run further off than chance.
fn expect_predicted(name: &str, runs: &[Vector6<f64>]) {
    let rms = |k: usize| (runs.iter().map(|run| run[k] * run[k]).sum::<f64>() / runs.len() as f64).sqrt();
    let each: Vec<f64> = (0..6).map(rms).collect();
    let all = (each.iter().map(|rms| rms * rms).sum::<f64>() / 6.0).sqrt();
    let worst = runs.iter().map(|run| run.amax()).fold(0.0, f64::max);
    println!("{name}: observed over predicted {all:.3}, each {each:.2?}, worst {worst:.2} sigma");
    assert!((0.8..1.2).contains(&all) && worst < 4.5, "{name}: {all}, each {each:.2?}, worst {worst}");
}

#[test]
fn predicted_and_observed_scatter_agree_with_infrared() {
    expect_predicted("with infrared", &scatter(&SeededRgbd::new(), 9));
}

#[test]
fn predicted_and_observed_scatter_agree_by_planes_alone() {
    let rig = SeededRgbd { with_infrared: false, ..SeededRgbd::new() };
    expect_predicted("by planes alone", &scatter(&rig, 12));
}

/// Mean over the picture of |bias| before and after correction and of a reading's σ at 1/z, in metres: exact, without noise.
fn left_at(rig: &SeededRgbd, solved: &SolvedRgbd, z_m: f64) -> [f64; 3] {
    let (size, mut sums, mut count) = (rig.depth.size, [0.0; 3], 0.0);
    for (x, y) in (3..30).flat_map(|x| (3..22).map(move |y| (10 * x, 10 * y))) {
        let pixel = Pixel::new(f64::from(x), f64::from(y));
        let measured = rig.error.measured(1.0 / z_m, pixel, size);
        let correction = solved.joint.depth.correction.as_ref().unwrap();
        let corrected = correction.correct(pixel, measured).unwrap();
        sums[0] += (1.0 / measured - z_m).abs();
        sums[1] += (1.0 / corrected - z_m).abs();
        sums[2] += rig.noise_per_m * z_m * z_m;
        count += 1.0;
    }
    sums.map(|sum| sum / count)
}

#[test]
fn the_error_of_depth_goes_away_at_every_distance_seen() {
    let rig = SeededRgbd::new();
    let mut rng = SeededCamera::rng(77);
    let poses = rig.poses(40, &mut rng);
    let solved = solve_rgbd(&rig.input(&poses, &mut rng), &SeededRgbd::options()).unwrap();
    let [near, far] = solved.joint.depth.correction.as_ref().unwrap().seen_m;
    for part in [0.1, 0.3, 0.5, 0.7, 0.9] {
        let z_m = near + part * (far - near);
        let [before, after, noise] = left_at(&rig, &solved, z_m);
        println!("{z_m:.2} m: {:.2} mm before, {:.3} mm after, noise {:.2} mm", 1e3 * before, 1e3 * after, 1e3 * noise);
        assert!(after <= 0.1 * before && after <= 0.3 * noise, "{z_m} m: {before} to {after}, noise {noise}");
    }
}
