//! Two-view geometry on simulated cameras: the relations of HZ part II, one by one.

use nalgebra::{Matrix3, Point2, Point3, Rotation3, Vector3};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

use super::PointPair;
use super::degeneracy::{TwoViewKind, two_view_geometry};
use super::essential::{
    essential_from_five, essential_from_fundamental, essential_from_many, essential_from_pose,
    nearest_essential, singular_gap,
};
use super::fundamental::{
    epipole_in_first, fundamental_from_many, fundamental_from_seven, sampson_distance_px,
};
use super::refinement::{refine_fundamental, refine_pose};
use super::relative_pose::{pose_from_essential, poses_from_essential};
use super::triangulation::{nearest_epipolar_pair, triangulate_linear, triangulate_rays};
use crate::geometry::camera_matrix::CameraMatrix;
use crate::geometry::pixel::ImageSize;
use crate::geometry::pose::Pose;

const SIZE: ImageSize = ImageSize::new(1280, 960);
const MATRIX: CameraMatrix =
    CameraMatrix { fx: 1100.0, fy: 1100.0, cx: 640.0, cy: 480.0, skew: 0.0 };

struct World {
    second_from_first: Pose,
    points: Vec<Point3<f64>>,
}

impl World {
    fn new(seed: u64, count: usize) -> Self {
        let mut random = ChaCha8Rng::seed_from_u64(seed);
        let mut uniform = |reach: f64| random.random_range(-reach..reach);
        let rotation = Vector3::new(uniform(0.1), uniform(0.2), uniform(0.3));
        let translation = Vector3::new(1.0, uniform(0.3), uniform(0.3));
        let points = (0..count)
            .map(|_| Point3::new(uniform(2.0), uniform(1.5), 7.0 + uniform(2.0)))
            .collect();
        Self { second_from_first: Pose::from_axis_angle(rotation, -translation), points }
    }

    fn normalized(&self) -> Vec<PointPair> {
        let flat = |p: Point3<f64>| Point2::new(p.x / p.z, p.y / p.z);
        let pair = |p: &Point3<f64>| PointPair {
            first: flat(*p),
            second: flat(self.second_from_first * *p),
        };
        self.points.iter().map(pair).collect()
    }

    fn pixels(&self, noise_px: f64, seed: u64) -> Vec<PointPair> {
        let mut random = ChaCha8Rng::seed_from_u64(seed ^ 0xf00d);
        let mut noisy = |p: Point2<f64>| {
            let pixel = MATRIX.pixel_from_normalized(p.coords);
            // A sum of uniform numbers is nearly Gaussian.
            let mut gauss = || (0..12).map(|_| random.random_range(-0.5..0.5)).sum::<f64>();
            Point2::new(pixel.x + noise_px * gauss(), pixel.y + noise_px * gauss())
        };
        let pairs = self.normalized();
        pairs.iter().map(|p| PointPair { first: noisy(p.first), second: noisy(p.second) }).collect()
    }

    fn essential(&self) -> Matrix3<f64> {
        let pose = &self.second_from_first;
        let e = essential_from_pose(&pose.rotation_matrix(), &pose.translation());
        e / e.norm()
    }

    fn fundamental(&self) -> Matrix3<f64> {
        let inverse = MATRIX.to_matrix().try_inverse().unwrap();
        let f = inverse.transpose() * self.essential() * inverse;
        f / f.norm()
    }

    fn errors_deg(&self, second_from_first: &Pose) -> [f64; 2] {
        let truth = &self.second_from_first;
        let direction = second_from_first.translation().angle(&truth.translation());
        [second_from_first.angle_to(truth).to_degrees(), direction.to_degrees()]
    }
}

/// The distance of two matrices that are defined up to scale and sign.
fn difference(a: &Matrix3<f64>, b: &Matrix3<f64>) -> f64 {
    let (a, b) = (a / a.norm(), b / b.norm());
    (a - b).norm().min((a + b).norm())
}

#[test]
fn exact_pixels_satisfy_the_epipolar_constraint_and_give_f_back() {
    for seed in 0..20 {
        let world = World::new(seed, 30);
        let (truth, pairs) = (world.fundamental(), world.pixels(0.0, seed));
        assert!(pairs.iter().all(|pair| sampson_distance_px(&truth, pair).abs() < 1e-9));
        let many = fundamental_from_many(&pairs).unwrap();
        assert!(difference(&many, &truth) < 1e-7, "{}", difference(&many, &truth));
        assert!(many.determinant().abs() < 1e-15);
        let sample: &[PointPair; 7] = pairs[..7].try_into().unwrap();
        let seven = fundamental_from_seven(sample);
        let nearest = seven.iter().map(|f| difference(f, &truth)).fold(1.0, f64::min);
        assert!(nearest < 1e-6, "{nearest}");
        // The epipole is the image of the second camera's center.
        let center = MATRIX.to_matrix() * world.second_from_first.inverse().translation();
        assert!(epipole_in_first(&truth).cross(&center.normalize()).norm() < 1e-6);
    }
}

#[test]
fn essential_matrices_have_two_equal_singular_values_and_four_poses() {
    for seed in 0..20 {
        let world = World::new(seed, 40);
        let (truth, pairs) = (world.essential(), world.normalized());
        let from_f = essential_from_fundamental(&world.fundamental(), MATRIX, MATRIX);
        assert!(difference(&from_f, &truth) < 1e-12 && singular_gap(&from_f) < 1e-12);
        assert!(difference(&essential_from_many(&pairs).unwrap(), &truth) < 1e-8);
        let sample: &[PointPair; 5] = pairs[..5].try_into().unwrap();
        let five = essential_from_five(sample);
        let nearest = five.iter().map(|e| difference(e, &truth)).fold(1.0, f64::min);
        assert!(nearest < 1e-6, "seed {seed}: {nearest} of {}", five.len());
        for pose in poses_from_essential(&truth).unwrap() {
            let again = essential_from_pose(&pose.rotation_matrix(), &pose.translation());
            assert!(difference(&again, &truth) < 1e-12);
        }
        let found = pose_from_essential(&truth, &pairs).unwrap();
        assert_eq!(found.in_front, pairs.len());
        assert!(world.errors_deg(&found.second_from_first).iter().all(|deg| *deg < 1e-5));
    }
}

#[test]
fn triangulation_gives_exact_points_back_and_the_nearest_pair_otherwise() {
    let world = World::new(3, 40);
    let pose = world.second_from_first;
    for (pair, point) in world.normalized().iter().zip(&world.points) {
        let [first, second] = pair.homogeneous();
        assert!((triangulate_rays(&pose, first, second).unwrap() - point).norm() < 1e-9);
        let seen = [(Pose::identity(), pair.first), (pose, pair.second)];
        assert!((triangulate_linear(&seen).unwrap() - point).norm() < 1e-9);
    }
    let f = world.fundamental();
    for pair in world.pixels(1.0, 3) {
        let near = nearest_epipolar_pair(&f, &pair);
        assert!(sampson_distance_px(&f, &near).abs() < 1e-4);
        let moved = (near.first - pair.first).norm().hypot((near.second - pair.second).norm());
        // To first order the displacement is Sampson's distance, and no pair on the lines can be
        // closer.
        assert!((moved - sampson_distance_px(&f, &pair).abs()).abs() < 0.01);
    }
}

#[test]
fn refinement_lowers_the_errors_of_f_and_pose() {
    let (mut before, mut after, mut linear, mut refined) = (0.0, 0.0, 0.0, 0.0);
    for seed in 0..30 {
        let world = World::new(seed, 60);
        let pairs = world.pixels(0.5, seed);
        let many = fundamental_from_many(&pairs).unwrap();
        before += difference(&many, &world.fundamental());
        after += difference(&refine_fundamental(&many, &pairs).unwrap(), &world.fundamental());
        let normalized = |p: Point2<f64>| MATRIX.normalized_from_pixel(p.into()).into();
        let pairs: Vec<PointPair> = pairs
            .iter()
            .map(|p| PointPair { first: normalized(p.first), second: normalized(p.second) })
            .collect();
        let e = nearest_essential(&essential_from_fundamental(&many, MATRIX, MATRIX));
        let start = pose_from_essential(&e, &pairs).unwrap().second_from_first;
        linear += world.errors_deg(&start).iter().sum::<f64>();
        refined += world.errors_deg(&refine_pose(&start, &pairs)).iter().sum::<f64>();
    }
    assert!(after < before, "{after} {before}");
    assert!(refined < 0.7 * linear, "{refined} {linear}");
}

#[test]
fn wrong_matches_are_left_out_and_degeneracies_named() {
    let mut random = ChaCha8Rng::seed_from_u64(5);
    let world = World::new(5, 200);
    let mut pairs = world.pixels(0.3, 5);
    for pair in &mut pairs[120..] {
        pair.second =
            Point2::new(random.random_range(0.0..1280.0), random.random_range(0.0..960.0));
    }
    let found = two_view_geometry(&pairs, SIZE).unwrap();
    assert_eq!(found.kind, TwoViewKind::General);
    let right = found.inliers.iter().filter(|k| **k < 120).count();
    assert!(right >= 114 && found.inliers.len() - right <= 4, "{right} {}", found.inliers.len());
    let mut plane = World::new(6, 150);
    plane.points.iter_mut().for_each(|p| p.z = 7.0 + 0.3 * p.x - 0.2 * p.y);
    let found = two_view_geometry(&plane.pixels(0.3, 6), SIZE).unwrap();
    assert_eq!(found.kind, TwoViewKind::Homography);
    let mut rotated = World::new(7, 150);
    let rotation = Rotation3::from_scaled_axis(Vector3::new(0.05, 0.2, 0.1));
    rotated.second_from_first = Pose::from_matrix(&rotation.into_inner(), Vector3::zeros());
    let found = two_view_geometry(&rotated.pixels(0.3, 7), SIZE).unwrap();
    assert_eq!(found.kind, TwoViewKind::Homography);
    rotated.second_from_first = Pose::identity();
    let found = two_view_geometry(&rotated.pixels(0.1, 8), SIZE).unwrap();
    assert_eq!(found.kind, TwoViewKind::Still);
    for pair in &mut pairs {
        pair.second =
            Point2::new(random.random_range(0.0..1280.0), random.random_range(0.0..960.0));
    }
    assert!(two_view_geometry(&pairs, SIZE).is_none());
    assert!(two_view_geometry(&[], SIZE).is_none());
}
