//! Colour and depth together: depth's error goes away.

use plumb::calibration::solve_rgbd::{SolvedRgbd, solve_rgbd};
use plumb::geometry::pixel::Pixel;

use crate::seeded_camera::SeededCamera;
use crate::seeded_rgbd::SeededRgbd;

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
