//! The stated covariance of a lens against the scatter of its errors, over seeded scenes.

use nalgebra::{Point3, Vector3};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rand_distr::StandardNormal;

use crate::estimation::interrupt::Interrupt;
use crate::estimation::scene::bundle::{
    Bundle, BundleStop, CameraMotion, SceneObservation, SceneState,
};
use crate::estimation::scene::covariance::lens_covariance;
use crate::estimation::scene::lens_prior::LensPrior;
use crate::estimation::scene::parts::{PARTS, scene_parts};
use crate::geometry::lens::{Lens, LensModel};
use crate::geometry::pixel::{ImageSize, Pixel};
use crate::geometry::pose::Pose;

const SIZE: ImageSize = ImageSize::new(640, 480);
const CAMERAS: usize = 8;
const POINTS: usize = 320;
const SCENES: u64 = 60;
/// Of each coordinate, in pixels.
const NOISE_PX: f64 = 0.1;
/// Of the cameras from the scene's middle.
const DISTANCE: f64 = 5.0;
/// fx, fy, cx, cy, k1.
const FREE: [usize; 5] = [0, 1, 2, 3, 5];

fn normal(random: &mut ChaCha8Rng) -> f64 {
    random.sample(StandardNormal)
}

/// Cameras around a scene, without errors.
fn scene(random: &mut ChaCha8Rng) -> SceneState {
    let parameters = [600.0, 600.0, 322.0, 236.0, 0.0, -0.1];
    let lens = Lens::from_parameters(LensModel::Radial, &parameters).unwrap();
    let pose = |k: usize| {
        let along = k as f64 / (CAMERAS - 1) as f64 - 0.5;
        let angles = Vector3::new(0.1 * along, -0.8 * along, if k % 2 == 1 { 1.57 } else { 0.0 });
        Pose::from_axis_angle(angles, Vector3::new(0.2 * along, 0.3 * along, DISTANCE))
    };
    let mut point = |_| {
        let mut between = || random.random_range(-1.4..1.4);
        Point3::new(between(), between(), between())
    };
    SceneState {
        lens,
        cameras_from_scene: (0..CAMERAS).map(pose).collect(),
        points: (0..POINTS).map(&mut point).collect(),
    }
}

/// Observations of one scene with independent errors and, times `shared`, an error of the focal
/// length for each part of the scene, which acts by its depth in each camera.
fn observed(truth: &SceneState, shared: f64, random: &mut ChaCha8Rng) -> Bundle {
    let of_part: Vec<f64> = (0..PARTS).map(|_| shared * normal(random)).collect();
    let parts = scene_parts(&truth.points);
    let center = truth.lens.matrix;
    let mut seen = |(point, part): (&Point3<f64>, usize)| -> Vec<SceneObservation> {
        let mut all = Vec::new();
        for (camera, pose) in truth.cameras_from_scene.iter().enumerate() {
            let in_camera = *pose * *point;
            let exact = truth.lens.pixel_from_point(&in_camera).unwrap();
            // Perspective that grows with depth: the part appears to be seen with another focal
            // length.
            let by = of_part[part] * (in_camera.z / DISTANCE - 1.0);
            let pixel = Pixel::new(
                exact.x + by * (exact.x - center.cx) + NOISE_PX * normal(random),
                exact.y + by * (exact.y - center.cy) + NOISE_PX * normal(random),
            );
            let inverse_std = 1.0 / NOISE_PX;
            all.push(SceneObservation { camera, pixel, scale_px: 2.0, inverse_std });
        }
        all
    };
    Bundle {
        observations: truth.points.iter().zip(parts).map(&mut seen).collect(),
        free: FREE.to_vec(),
        prior: LensPrior::of_whole(SIZE),
        motion: CameraMotion::Moving,
        robust_limit: f64::INFINITY,
        interrupt: Interrupt::default(),
    }
}

/// The root mean square over all scenes of each free parameter's error, in units of its stated
/// standard deviation, and of that for independent errors.
fn errors_in_std(shared: f64) -> [[f64; FREE.len()]; 2] {
    let mut squares = [[0.0; FREE.len()]; 2];
    for seed in 0..SCENES {
        let mut random = ChaCha8Rng::seed_from_u64(seed);
        let truth = scene(&mut random);
        let mut bundle = observed(&truth, shared, &mut random);
        let stop = BundleStop { max_steps: 30, least_decrease: 1e-9 };
        let state = bundle.minimize(truth.clone(), stop);
        bundle.rescaled(bundle.median_noise(&state));
        let covariance = lens_covariance(&bundle, &state, 1.0).unwrap();
        let [estimate, truth] = [&state, &truth].map(|state| state.lens.parameters());
        for (k, parameter) in FREE.into_iter().enumerate() {
            let error = estimate[parameter] - truth[parameter];
            squares[0][k] += error * error / covariance.matrix[(k, k)];
            squares[1][k] += error * error / covariance.independent[(k, k)];
        }
    }
    squares.map(|of| of.map(|square| (square / SCENES as f64).sqrt()))
}

#[test]
fn observations_that_err_by_themselves_have_the_stated_scatter() {
    let [stated, independent] = errors_in_std(0.0);
    // The root mean square of 60 is known to 9 %.
    assert!(independent.iter().all(|z| (0.8..1.2).contains(z)), "{independent:.2?}");
    // Chance differences between few clusters can only widen it.
    assert!(stated.iter().all(|z| (0.65..1.2).contains(z)), "{stated:.2?}");
}

#[test]
fn what_parts_of_a_scene_do_to_the_focal_length_widens_that() {
    let [stated, independent] = errors_in_std(8e-3);
    assert!(independent[..2].iter().all(|z| *z > 2.5), "{independent:.2?}");
    assert!(stated[..2].iter().all(|z| (0.8..1.2).contains(z)), "{stated:.2?}");
    assert!(stated.iter().all(|z| (0.65..1.2).contains(z)), "{stated:.2?}");
}
