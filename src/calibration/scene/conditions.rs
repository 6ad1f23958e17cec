//! What a reconstruction shows of how the images were taken.

use nalgebra::{Matrix3, Point3, Vector3};

use crate::estimation::scene::bundle::{CameraMotion, SceneState};
use crate::estimation::scene::robust_bundle::RobustBundle;
use crate::estimation::two_view::triangulation::parallax;

/// How the camera stood and moved.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SceneConditions {
    /// What it did.
    pub motion: CameraMotion,
    /// The median over the points of the widest angle between two rays, in degrees.
    pub parallax_deg: f64,
    /// The root mean square angle between the ways from camera to camera and the optical axis,
    /// weighted by length, in degrees: 0 for forward, 90 for sideways.
    pub sideways_deg: f64,
    /// The widest angle between two cameras' axes, in degrees.
    pub turned_deg: f64,
    /// The widest rotation about the optical axis between two cameras, in degrees.
    pub rolled_deg: f64,
    /// The distance of points from their common plane (root mean square), over their spread in it.
    pub relief: f64,
}

impl SceneConditions {
    /// Of a fit.
    pub fn of(fit: &RobustBundle) -> Self {
        let state = &fit.state;
        let mut angles: Vec<f64> =
            (0..state.points.len()).map(|point| widest_parallax(fit, point).to_degrees()).collect();
        angles.sort_by(f64::total_cmp);
        let (turned, rolled) = widest_turns(state);
        Self {
            motion: fit.bundle.motion,
            parallax_deg: angles.get(angles.len() / 2).copied().unwrap_or(0.0),
            sideways_deg: sideways(state).to_degrees(),
            turned_deg: turned.to_degrees(),
            rolled_deg: rolled.to_degrees(),
            relief: relief(&state.points),
        }
    }
}

fn centers(state: &SceneState) -> Vec<Point3<f64>> {
    let center = |pose: &crate::geometry::pose::Pose| Point3::from(pose.inverse().translation());
    state.cameras_from_scene.iter().map(center).collect()
}

fn widest_parallax(fit: &RobustBundle, point: usize) -> f64 {
    let centers = centers(&fit.state);
    let seen = &fit.bundle.observations[point];
    let pairs = seen.iter().enumerate().flat_map(|(k, a)| seen[..k].iter().map(move |b| (a, b)));
    let at = &fit.state.points[point];
    pairs.map(|(a, b)| parallax(&centers[a.camera], &centers[b.camera], at)).fold(0.0, f64::max)
}

fn sideways(state: &SceneState) -> f64 {
    let centers = centers(state);
    let (mut sum, mut weight) = (0.0, 0.0);
    for (a, camera_from_scene) in state.cameras_from_scene.iter().enumerate() {
        let axis = camera_from_scene.inverse() * Vector3::z();
        for b in (0..centers.len()).filter(|b| *b != a) {
            let way = centers[b] - centers[a];
            let length = way.norm();
            let angle = (axis.cross(&way).norm()).atan2(axis.dot(&way).abs());
            sum += length * angle * angle;
            weight += length;
        }
    }
    (sum / f64::max(weight, f64::MIN_POSITIVE)).sqrt()
}

/// The widest angle between axes, and the widest rotation about the axis.
fn widest_turns(state: &SceneState) -> (f64, f64) {
    let (mut turned, mut rolled) = (0.0_f64, 0.0_f64);
    for (k, a) in state.cameras_from_scene.iter().enumerate() {
        for b in &state.cameras_from_scene[..k] {
            let between = (*a * b.inverse()).rotation_matrix();
            turned = turned.max((between * Vector3::z()).angle(&Vector3::z()));
            rolled = rolled.max(
                (between[(1, 0)] - between[(0, 1)]).atan2(between[(0, 0)] + between[(1, 1)]).abs(),
            );
        }
    }
    (turned, rolled)
}

fn relief(points: &[Point3<f64>]) -> f64 {
    let n = points.len().max(1) as f64;
    let mean = points.iter().map(|p| p.coords).sum::<Vector3<f64>>() / n;
    let mut scatter = Matrix3::zeros();
    for point in points {
        let d = point.coords - mean;
        scatter += d * d.transpose();
    }
    let mut spreads: Vec<f64> = scatter.symmetric_eigenvalues().iter().copied().collect();
    spreads.sort_by(f64::total_cmp);
    (spreads[0].max(0.0) / spreads[1].max(f64::MIN_POSITIVE)).sqrt()
}
