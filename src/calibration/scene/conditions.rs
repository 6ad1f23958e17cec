//! How the images of a reconstruction were taken: motion, parallax, rotation and relief.

use nalgebra::{Matrix3, Point3, Vector3};

use crate::estimation::scene::bundle::{Bundle, CameraMotion, SceneState};
use crate::estimation::two_view::triangulation::parallax;

/// How the camera moved, and what it saw.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SceneConditions {
    /// Whether it moved or only rotated.
    pub motion: CameraMotion,
    /// The median over the points of the widest angle between two of a point's rays, in degrees.
    pub parallax_deg: f64,
    /// The root mean square angle between the optical axis and the directions to the cameras that
    /// see the same points, in degrees: 0 for forward motion, 90 for sideways motion.
    pub sideways_deg: f64,
    /// The widest angle between the optical axes of two cameras, in degrees.
    pub rotated_deg: f64,
    /// The widest rotation about the optical axis between two cameras that share a point, in
    /// degrees.
    pub rolled_deg: f64,
    /// The root mean square distance of the points from their common plane, over their root mean
    /// square distance from the mean along the shorter axis in that plane.
    pub relief: f64,
}

impl SceneConditions {
    /// Of a fit.
    pub fn of(bundle: &Bundle, state: &SceneState) -> Self {
        let mut angles: Vec<f64> = (0..state.points.len())
            .map(|point| widest_parallax(bundle, state, point).to_degrees())
            .collect();
        angles.sort_by(f64::total_cmp);
        let shared = shared_points(bundle, state.cameras_from_scene.len());
        let (rotated, rolled) = widest_rotations(state, &shared);
        Self {
            motion: bundle.motion,
            parallax_deg: angles.get(angles.len() / 2).copied().unwrap_or(0.0),
            sideways_deg: sideways(state, &shared).to_degrees(),
            rotated_deg: rotated.to_degrees(),
            rolled_deg: rolled.to_degrees(),
            relief: relief(&state.points),
        }
    }
}

fn centers(state: &SceneState) -> Vec<Point3<f64>> {
    let center = |pose: &crate::geometry::pose::Pose| Point3::from(pose.inverse().translation());
    state.cameras_from_scene.iter().map(center).collect()
}

fn widest_parallax(bundle: &Bundle, state: &SceneState, point: usize) -> f64 {
    let centers = centers(state);
    let seen = &bundle.observations[point];
    let pairs = seen.iter().enumerate().flat_map(|(k, a)| seen[..k].iter().map(move |b| (a, b)));
    let at = &state.points[point];
    pairs.map(|(a, b)| parallax(&centers[a.camera], &centers[b.camera], at)).fold(0.0, f64::max)
}

/// For each two cameras, the number of points that both see.
fn shared_points(bundle: &Bundle, cameras: usize) -> Vec<Vec<usize>> {
    let mut shared = vec![vec![0; cameras]; cameras];
    for seen in &bundle.observations {
        for a in seen {
            for b in seen.iter().filter(|b| b.camera != a.camera) {
                shared[a.camera][b.camera] += 1;
            }
        }
    }
    shared
}

fn sideways(state: &SceneState, shared: &[Vec<usize>]) -> f64 {
    let centers = centers(state);
    let (mut sum, mut weight) = (0.0, 0.0);
    for (a, camera_from_scene) in state.cameras_from_scene.iter().enumerate() {
        let axis = camera_from_scene.inverse() * Vector3::z();
        for (b, center) in centers.iter().enumerate() {
            let (way, points) = (center - centers[a], shared[a][b] as f64);
            let angle = (axis.cross(&way).norm()).atan2(axis.dot(&way).abs());
            sum += points * angle * angle;
            weight += points;
        }
    }
    (sum / f64::max(weight, f64::MIN_POSITIVE)).sqrt()
}

/// The widest angle between optical axes, and the widest rotation about the axis between cameras
/// that share points.
fn widest_rotations(state: &SceneState, shared: &[Vec<usize>]) -> (f64, f64) {
    let (mut rotated, mut rolled) = (0.0_f64, 0.0_f64);
    for (k, a) in state.cameras_from_scene.iter().enumerate() {
        for (j, b) in state.cameras_from_scene[..k].iter().enumerate() {
            let between = (*a * b.inverse()).rotation_matrix();
            rotated = rotated.max((between * Vector3::z()).angle(&Vector3::z()));
            let about_axis =
                (between[(1, 0)] - between[(0, 1)]).atan2(between[(0, 0)] + between[(1, 1)]).abs();
            if shared[k][j] > 0 {
                rolled = rolled.max(about_axis);
            }
        }
    }
    (rotated, rolled)
}

fn relief(points: &[Point3<f64>]) -> f64 {
    let n = points.len().max(1) as f64;
    let mean = points.iter().map(|p| p.coords).sum::<Vector3<f64>>() / n;
    let mut scatter = Matrix3::zeros();
    for point in points {
        let d = point.coords - mean;
        scatter += d * d.transpose();
    }
    let mut squares: Vec<f64> = scatter.symmetric_eigenvalues().iter().copied().collect();
    squares.sort_by(f64::total_cmp);
    (squares[0].max(0.0) / squares[1].max(f64::MIN_POSITIVE)).sqrt()
}
