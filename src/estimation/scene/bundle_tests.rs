//! Bundle adjustment on exact observations: its derivatives and its gradient.

use nalgebra::{DVector, Point3, Vector3};

use crate::estimation::interrupt::Interrupt;
use crate::estimation::scene::bundle::{
    Bundle, BundleStop, CameraMotion, SceneObservation, SceneState,
};
use crate::estimation::scene::lens_prior::LensPrior;
use crate::geometry::lens::{Lens, LensModel};
use crate::geometry::pixel::ImageSize;
use crate::geometry::pose::Pose;

const PARAMETERS: [f64; 10] = [700.0, 702.0, 322.0, 236.0, 0.0, -0.1, 0.05, 0.0004, -0.0003, 0.0];

pub(super) fn exact() -> (Bundle, SceneState) {
    let lens = Lens::from_parameters(LensModel::Brown, &PARAMETERS).unwrap();
    let pose = |k: i32| {
        let part = f64::from(k) - 1.5;
        let angles = Vector3::new(0.05 * part, -0.12 * part, 0.4 * part * part);
        Pose::from_axis_angle(angles, Vector3::new(0.7 * part, 0.2 * part * part, 5.0))
    };
    let cameras_from_scene: Vec<Pose> = (0..4).map(pose).collect();
    let point = |k: i32| {
        let [x, y, z] = [7, 11, 13].map(|prime| f64::from(k * prime % 17) / 8.5 - 1.0);
        Point3::new(x, y, z)
    };
    let points: Vec<Point3<f64>> = (0..30).map(point).collect();
    let seen = |point: &Point3<f64>| -> Vec<SceneObservation> {
        let at = |(camera, pose): (usize, &Pose)| {
            let pixel = lens.pixel_from_point(&(*pose * *point))?;
            Some(SceneObservation {
                camera,
                pixel,
                scale_px: 2.0,
                inverse_std: 2.0 + camera as f64,
            })
        };
        cameras_from_scene.iter().enumerate().filter_map(at).collect()
    };
    let bundle = Bundle {
        observations: points.iter().map(seen).collect(),
        free: vec![0, 1, 2, 3, 5, 6, 7, 8],
        prior: LensPrior::of_whole(ImageSize::new(640, 480)),
        motion: CameraMotion::Moving,
        robust_limit: f64::INFINITY,
        interrupt: Interrupt::default(),
    };
    (bundle, SceneState { lens, cameras_from_scene, points })
}

/// `state` with lens parameter `k`, or coordinate `k` of a pose or of a point, larger by `by`.
enum Changed {
    Lens(usize),
    Pose(usize, usize),
    Point(usize, usize),
}

fn changed(state: &SceneState, what: &Changed, by: f64) -> SceneState {
    let mut state = state.clone();
    match what {
        Changed::Lens(parameter) => {
            let mut parameters = state.lens.parameters();
            parameters[*parameter] += by;
            state.lens = Lens::from_parameters(state.lens.model(), &parameters).unwrap();
        }
        Changed::Pose(camera, k) => {
            let step = Vector3::ith(k % 3, by);
            let pose = &mut state.cameras_from_scene[*camera];
            let (rotation, translation) = (pose.rotation(), pose.translation());
            *pose = if *k < 3 {
                Pose::new(nalgebra::UnitQuaternion::from_scaled_axis(step) * rotation, translation)
            } else {
                Pose::new(rotation, translation + step)
            };
        }
        Changed::Point(point, k) => state.points[*point][*k] += by,
    }
    state
}

#[test]
fn derivatives_agree_with_numeric_differences() {
    let (bundle, state) = exact();
    for point in [0, 7, 19] {
        let residuals = |state: &SceneState| -> Vec<_> {
            bundle.rows(state, point).iter().map(|row| row.residual).collect()
        };
        let assert_is = |what: Changed, step: f64, analytic: &dyn Fn(usize) -> [f64; 2]| {
            let (above, below) = (
                residuals(&changed(&state, &what, step)),
                residuals(&changed(&state, &what, -step)),
            );
            for (k, (above, below)) in above.iter().zip(&below).enumerate() {
                let numeric = (above - below) / (2.0 * step);
                for (expected, numeric) in analytic(k).into_iter().zip(numeric.iter()) {
                    let error = (expected - numeric).abs() / numeric.abs().max(1.0);
                    assert!(error < 1e-5, "point {point}, row {k}: {expected}, not {numeric}");
                }
            }
        };
        let rows = bundle.rows(&state, point);
        for (column, parameter) in bundle.free.iter().enumerate() {
            let by_lens = |k: usize| [0, 1].map(|i| rows[k].by_lens[(i, column)]);
            assert_is(Changed::Lens(*parameter), 1e-5, &by_lens);
        }
        for (camera, coordinate) in (1..4).flat_map(|camera| (0..6).map(move |k| (camera, k))) {
            let by_pose = |k: usize| {
                let own = rows[k].camera == camera;
                [0, 1].map(|i| if own { rows[k].by_pose[(i, coordinate)] } else { 0.0 })
            };
            assert_is(Changed::Pose(camera, coordinate), 1e-6, &by_pose);
        }
        for coordinate in 0..3 {
            let by_point = |k: usize| [0, 1].map(|i| rows[k].by_point[(i, coordinate)]);
            assert_is(Changed::Point(point, coordinate), 1e-6, &by_point);
        }
    }
}

#[test]
fn the_reduced_gradient_is_that_of_the_cost_at_the_best_points() {
    let (mut bundle, truth) = exact();
    bundle.free = vec![0, 1];
    let start = changed(&truth, &Changed::Lens(0), 3.0);
    // At the best points their own gradients are 0, and eliminating them changes no gradient.
    let held = Bundle { free: Vec::new(), ..bundle.clone() };
    let start = held.minimize(start, BundleStop { max_steps: 60, least_decrease: 1e-14 });
    let gradient: DVector<f64> = bundle.reduced(&start, 0.0).gradient;
    let cost = |by: f64| bundle.cost(&changed(&start, &Changed::Lens(0), by));
    let numeric = (cost(1e-4) - cost(-1e-4)) / 2e-4;
    // The cost is the sum of squares: its gradient is twice the normal equations' right side.
    let expected = 2.0 * gradient[0];
    assert!((expected - numeric).abs() < 1e-4 * numeric.abs().max(1.0), "{expected}, {numeric}");
}

#[test]
fn a_focal_length_that_starts_far_off_is_found_within_sixty_steps() {
    let (mut bundle, truth) = exact();
    bundle.robust_limit = 2.4;
    let minimum = |start: SceneState| {
        bundle.minimize(start, BundleStop { max_steps: 60, least_decrease: 1e-12 }).lens.matrix.fx
    };
    let fx = minimum(truth.clone());
    for factor in [0.7, 1.4, 1.8] {
        let by = (factor - 1.0) * truth.lens.matrix.fx;
        let start = changed(&truth, &Changed::Lens(0), by);
        let start = changed(&start, &Changed::Lens(1), by);
        let found = minimum(start);
        assert!((found - fx).abs() < 0.01, "{factor} times: {found}, not {fx}");
    }
}

#[test]
fn a_descent_that_nobody_waits_for_ends_where_it_is() {
    let (mut bundle, truth) = exact();
    bundle.free = vec![0, 1];
    let start = changed(&truth, &Changed::Lens(0), 3.0);
    let stop = BundleStop { max_steps: 20, least_decrease: 1e-9 };
    bundle.interrupt = Interrupt::new();
    assert_ne!(bundle.minimize(start.clone(), stop), start);
    bundle.interrupt.request();
    assert_eq!(bundle.minimize(start.clone(), stop), start);
}
