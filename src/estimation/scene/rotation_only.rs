//! The lens of a camera that only rotated, from homographies between its images (R. Hartley,
//! *Self-calibration from multiple views with a rotating camera*, 1994; HZ section 19.6). Depth is
//! not observable, but the angles between directions are the same in all images.

use nalgebra::{Matrix3, Point3};

use crate::estimation::scene::bundle::{
    Bundle, BundleStop, CameraMotion, SceneObservation, SceneState,
};
use crate::estimation::scene::lens_prior::LensPrior;
use crate::estimation::scene::problem::SceneProblem;
use crate::estimation::scene::reconstruction::Reconstruction;
use crate::estimation::two_view::focal::focals_to_try;
use crate::geometry::camera_matrix::CameraMatrix;
use crate::geometry::homography::Homography;
use crate::geometry::lens::{Lens, LensModel};
use crate::geometry::pose::Pose;

/// Two images and the homography between them.
#[derive(Debug, Clone, PartialEq)]
pub struct RotatedPair {
    /// The first image.
    pub first: usize,
    /// The second image.
    pub second: usize,
    /// Pixels of the second image from pixels of the first.
    pub homography: Homography,
    /// Number of inlier matches.
    pub matches: usize,
}

/// Number of focal lengths tried. Chosen, not swept.
const FOCAL_SAMPLES: usize = 120;

/// The deviation from orthonormality that K⁻¹ H K of a rotation may have, as [`deviation`] measures
/// it. From five times this on, as the mean over all pairs, the camera did not only rotate.
const MOST_DEVIATION: f64 = 0.02;

/// The scale of Cauchy's loss, in standard deviations (95 % efficient without outliers).
const CAUCHY_STDS: f64 = 2.4;

const DESCENT_STOP: BundleStop = BundleStop { max_steps: 20, least_decrease: 1e-5 };

/// The largest number of fits, each with the loss's scale from the noise of the one before.
const MOST_FITS: usize = 10;

/// The fits end where the noise remains above this part of that of the fit before.
const SETTLED_NOISE_PART: f64 = 0.98;

/// The deviation of M = K⁻¹ H K, scaled to determinant 1, from orthonormality: the Frobenius norm
/// of MᵀM − I. Returned with M.
fn deviation(homography: &Homography, matrix: CameraMatrix) -> (f64, Matrix3<f64>) {
    let k = matrix.to_matrix();
    let Some(inverse) = k.try_inverse() else { return (f64::INFINITY, Matrix3::identity()) };
    let m = inverse * homography.matrix() * k;
    let m = m / m.determinant().abs().cbrt().max(1e-12) * m.determinant().signum();
    ((m.transpose() * m - Matrix3::identity()).norm(), m)
}

/// The focal length for which the homographies are closest to rotations, and their mean deviation.
/// `None` where it is too large for rotations.
pub fn focal_of_rotations(pairs: &[RotatedPair], problem: &SceneProblem) -> Option<(f64, f64)> {
    let size = problem.image_size;
    let center = size.center();
    let weight: usize = pairs.iter().map(|pair| pair.matches).sum();
    let cost = |focal: f64| {
        let matrix = CameraMatrix { fx: focal, fy: focal, cx: center.x, cy: center.y, skew: 0.0 };
        let sum: f64 = pairs
            .iter()
            .map(|pair| pair.matches as f64 * deviation(&pair.homography, matrix).0.min(1.0))
            .sum();
        sum / weight.max(1) as f64
    };
    let best = focals_to_try(size, FOCAL_SAMPLES)
        .map(|focal| (focal, cost(focal)))
        .min_by(|a, b| a.1.total_cmp(&b.1))?;
    (best.1 < 5.0 * MOST_DEVIATION).then_some(best)
}

/// Rotations and directions from `pairs`, chained from the image with the most matches; `None`
/// where the homographies are not those of a rotating camera.
pub fn reconstruct_rotations(
    problem: &SceneProblem,
    pairs: &[RotatedPair],
) -> Option<Reconstruction> {
    let (focal, _) = focal_of_rotations(pairs, problem)?;
    let center = problem.image_size.center();
    let matrix = CameraMatrix { fx: focal, fy: focal, cx: center.x, cy: center.y, skew: 0.0 };
    let lens = Lens::from_parameters(
        LensModel::Radial,
        &[matrix.fx, matrix.fy, matrix.cx, matrix.cy, 0.0, 0.0],
    )?;
    let (images, cameras_from_scene) = chained(problem.images, pairs, matrix);
    let camera_of = |image: usize| images.iter().position(|k| *k == image);
    let (mut observations, mut points) = (Vec::new(), Vec::new());
    for track in &problem.tracks {
        let seen = SceneObservation::of_track(track, camera_of);
        let Some(first) = seen.first().filter(|_| seen.len() >= 2) else { continue };
        let Some(bearing) = lens.bearing_from_pixel(first.pixel) else { continue };
        let direction = cameras_from_scene[first.camera].inverse() * bearing.into_inner();
        points.push(Point3::from(direction));
        observations.push(seen);
    }
    let prior = LensPrior::of_whole(problem.image_size);
    let mut bundle = Bundle {
        observations,
        free: vec![Lens::FX, Lens::FY],
        prior,
        motion: CameraMotion::RotationOnly,
        robust_limit: f64::INFINITY,
        interrupt: problem.interrupt.clone(),
    };
    let state = SceneState { lens, cameras_from_scene, points };
    bundle.robust_limit = CAUCHY_STDS * bundle.median_noise(&state);
    let mut state = bundle.minimize(state, DESCENT_STOP);
    // The homographies assumed a lens without distortion, with its principal point in the center.
    bundle.free = vec![Lens::FX, Lens::FY, Lens::CX, Lens::CY, Lens::FIRST_COEFFICIENT];
    let mut noise = bundle.median_noise(&state);
    for _ in 0..MOST_FITS {
        bundle.robust_limit = CAUCHY_STDS * noise;
        state = bundle.minimize(state, DESCENT_STOP);
        let last = std::mem::replace(&mut noise, bundle.median_noise(&state));
        if noise > SETTLED_NOISE_PART * last {
            break;
        }
    }
    (images.len() >= 2).then_some(Reconstruction { images, bundle, state })
}

/// Rotations from the image with the most matches outward, each along the pair with the most.
fn chained(images: usize, pairs: &[RotatedPair], matrix: CameraMatrix) -> (Vec<usize>, Vec<Pose>) {
    let matches_of = |image: usize| -> usize {
        let own = pairs.iter().filter(|pair| pair.first == image || pair.second == image);
        own.map(|pair| pair.matches).sum()
    };
    let first = (0..images).max_by_key(|image| (matches_of(*image), images - image)).unwrap_or(0);
    let (mut order, mut poses) = (vec![first], vec![Pose::identity()]);
    loop {
        let open =
            |pair: &&RotatedPair| order.contains(&pair.first) != order.contains(&pair.second);
        let Some(pair) = pairs.iter().filter(open).max_by_key(|pair| pair.matches) else { break };
        let (_, rotation) = deviation(&pair.homography, matrix);
        let nearest = rotation.svd(true, true);
        let rotation = match (nearest.u, nearest.v_t) {
            (Some(u), Some(v_t)) => u * v_t,
            _ => Matrix3::identity(),
        };
        let second_from_first = Pose::from_matrix(&rotation, nalgebra::Vector3::zeros());
        let known = |image: usize| order.iter().position(|k| *k == image).map(|k| poses[k]);
        let (image, camera_from_scene) = match (known(pair.first), known(pair.second)) {
            (Some(first_from_scene), _) => (pair.second, second_from_first * first_from_scene),
            (_, Some(second_from_scene)) => {
                (pair.first, second_from_first.inverse() * second_from_scene)
            }
            _ => break,
        };
        order.push(image);
        poses.push(camera_from_scene);
    }
    (order, poses)
}
