//! Incremental reconstruction of poses and points: from two images first, then by adding the image
//! that observes most of the points known so far (HZ section 18.6; J. Schönberger and J.-M. Frahm,
//! *Structure-from-motion revisited*, 2016).

use nalgebra::{Matrix3, Point2, Point3};

use crate::estimation::scene::bundle::{
    Bundle, BundleStop, CameraMotion, SceneObservation, SceneState,
};
use crate::estimation::scene::lens_prior::LensPrior;
use crate::estimation::scene::problem::{SceneProblem, TrackPoint};
use crate::estimation::scene::resection::{PointInImage, resect};
use crate::estimation::two_view::PointPair;
use crate::estimation::two_view::essential::{essential_from_fundamental, nearest_essential};
use crate::estimation::two_view::refinement::refine_pose;
use crate::estimation::two_view::relative_pose::pose_from_essential;
use crate::estimation::two_view::triangulation::{parallax, triangulate_linear, triangulate_rays};
use crate::geometry::lens::Lens;
use crate::geometry::pose::Pose;

/// Two images with an epipolar geometry.
#[derive(Debug, Clone, PartialEq)]
pub struct ImagePair {
    /// The first image.
    pub first: usize,
    /// The second image.
    pub second: usize,
    /// x₂ᵀ F x₁ = 0.
    pub fundamental: Matrix3<f64>,
    /// The inlier matches.
    pub matches: Vec<PointPair>,
}

/// Cameras and points, with the observations that determine them.
#[derive(Debug, Clone)]
pub struct Reconstruction {
    /// The image of each pose of the state.
    pub images: Vec<usize>,
    /// The bundle, its observations with their expected standard deviations.
    pub bundle: Bundle,
    /// Lens, poses, points.
    pub state: SceneState,
}

/// The least angle between two rays to a new point, in radians: 1.5 degrees (COLMAP's).
const LEAST_PARALLAX: f64 = 1.5 * std::f64::consts::PI / 180.0;

/// The median angle that a first pair should have. A larger angle is no advantage.
const GOOD_PARALLAX: f64 = 8.0 * std::f64::consts::PI / 180.0;

/// Below this median angle, in radians, a first pair does not determine depth.
const NO_PARALLAX: f64 = 0.7 * std::f64::consts::PI / 180.0;

/// The largest reprojection error, in pixels, of a point that is kept while poses are rough.
const ROUGH_PX: f64 = 6.0;

/// The least number of inliers, among known points, for the pose of an image.
const LEAST_RESECTED: usize = 15;

/// How many pairs are tried as the first.
const FIRST_PAIRS: usize = 6;

const GROWTH_STOP: BundleStop = BundleStop { max_steps: 8, least_decrease: 1e-3 };

/// The reconstruction from the best first pair of images; `None` where no pair determines depth.
pub fn reconstruct(
    problem: &SceneProblem,
    pairs: &[ImagePair],
    lens: Lens,
) -> Option<Reconstruction> {
    let mut incremental = IncrementalReconstruction::start(problem, pairs, lens)?;
    incremental.grow();
    incremental.finish()
}

struct IncrementalReconstruction<'a> {
    problem: &'a SceneProblem,
    lens: Lens,
    order: Vec<usize>,
    camera_from_scene: Vec<Option<Pose>>,
    points: Vec<Option<Point3<f64>>>,
    /// The tracks of each image.
    tracks_of: Vec<Vec<(usize, TrackPoint)>>,
}

impl<'a> IncrementalReconstruction<'a> {
    fn start(problem: &'a SceneProblem, pairs: &[ImagePair], lens: Lens) -> Option<Self> {
        let mut by_size: Vec<&ImagePair> = pairs.iter().collect();
        by_size.sort_by_key(|pair| std::cmp::Reverse(pair.matches.len()));
        let mut candidates: Vec<(f64, &ImagePair, Pose)> = Vec::new();
        // Wide pairs have fewer matches than narrow ones, so more pairs are considered than are
        // tried.
        for pair in by_size.iter().take(4 * FIRST_PAIRS) {
            let Some((second_from_first, angle)) = relative_pose(pair, &lens) else { continue };
            if angle > NO_PARALLAX {
                let worth = (angle / GOOD_PARALLAX).min(1.0) * pair.matches.len() as f64;
                candidates.push((worth, pair, second_from_first));
            }
        }
        candidates.sort_by(|a, b| b.0.total_cmp(&a.0));
        let mut tracks_of = vec![Vec::new(); problem.images];
        for (k, track) in problem.tracks.iter().enumerate() {
            for seen in track {
                tracks_of[seen.image].push((k, *seen));
            }
        }
        for (_, pair, second_from_first) in candidates.into_iter().take(FIRST_PAIRS) {
            let mut incremental = IncrementalReconstruction {
                problem,
                lens,
                order: vec![pair.first, pair.second],
                camera_from_scene: vec![None; problem.images],
                points: vec![None; problem.tracks.len()],
                tracks_of: tracks_of.clone(),
            };
            incremental.camera_from_scene[pair.first] = Some(Pose::identity());
            incremental.camera_from_scene[pair.second] = Some(second_from_first);
            incremental.triangulate();
            if incremental.points.iter().flatten().count() >= 2 * LEAST_RESECTED {
                incremental.adjust(&[]);
                return Some(incremental);
            }
        }
        None
    }

    fn grow(&mut self) {
        let mut refused: Vec<usize> = Vec::new();
        while let Some(image) = self.next_image(&refused) {
            if self.problem.interrupt.is_requested() {
                break;
            }
            let seen: Vec<PointInImage> = self.tracks_of[image]
                .iter()
                .filter_map(|(track, at)| {
                    Some(PointInImage { point: self.points[*track]?, pixel: at.pixel })
                })
                .collect();
            let found = resect(&seen, &self.lens, self.problem.image_size);
            let Some(found) = found.filter(|found| found.inliers.len() >= LEAST_RESECTED) else {
                refused.push(image);
                continue;
            };
            self.camera_from_scene[image] = Some(found.model);
            self.order.push(image);
            self.triangulate();
            self.adjust(&[Lens::FX, Lens::FY]);
            self.triangulate();
            refused.clear();
        }
    }

    /// The image that observes most of the known points.
    fn next_image(&self, refused: &[usize]) -> Option<usize> {
        let count = |image: usize| {
            self.tracks_of[image].iter().filter(|(track, _)| self.points[*track].is_some()).count()
        };
        let open =
            |image: &usize| self.camera_from_scene[*image].is_none() && !refused.contains(image);
        let candidates = (0..self.problem.images).filter(open).map(|image| (count(image), image));
        let best = candidates.max_by_key(|(count, image)| (*count, std::cmp::Reverse(*image)))?;
        (best.0 >= LEAST_RESECTED).then_some(best.1)
    }

    /// Triangulates every track again from all its images that have poses.
    fn triangulate(&mut self) {
        for (k, track) in self.problem.tracks.iter().enumerate() {
            let seen: Vec<(Pose, Point2<f64>, TrackPoint)> = track
                .iter()
                .filter_map(|at| {
                    let camera_from_scene = self.camera_from_scene[at.image]?;
                    let bearing = self.lens.bearing_from_pixel(at.pixel)?;
                    let normalized = Point2::new(bearing.x / bearing.z, bearing.y / bearing.z);
                    Some((camera_from_scene, normalized, *at))
                })
                .collect();
            self.points[k] = self.triangulated(&seen);
        }
    }

    fn triangulated(&self, seen: &[(Pose, Point2<f64>, TrackPoint)]) -> Option<Point3<f64>> {
        let rays: Vec<_> = seen.iter().map(|(pose, at, _)| (*pose, *at)).collect();
        let point = triangulate_linear(&rays)?;
        let is_near = |(camera_from_scene, _, at): &(Pose, Point2<f64>, TrackPoint)| {
            let pixel = self.lens.pixel_from_point(&(*camera_from_scene * point));
            pixel.is_some_and(|pixel| pixel.distance_px(at.pixel) < ROUGH_PX)
        };
        let centers: Vec<Point3<f64>> = seen
            .iter()
            .map(|(camera_from_scene, ..)| Point3::from(camera_from_scene.inverse().translation()))
            .collect();
        let widest = centers
            .iter()
            .flat_map(|a| centers.iter().map(|b| parallax(a, b, &point)))
            .fold(0.0, f64::max);
        (widest >= LEAST_PARALLAX && seen.iter().all(is_near)).then_some(point)
    }

    fn bundle(&self, free: &[usize]) -> (Bundle, SceneState, Vec<usize>) {
        let camera_of = |image: usize| self.order.iter().position(|k| *k == image);
        let (mut observations, mut points, mut tracks) = (Vec::new(), Vec::new(), Vec::new());
        for (k, track) in self.problem.tracks.iter().enumerate() {
            let Some(point) = self.points[k] else { continue };
            observations.push(SceneObservation::of_track(track, camera_of));
            points.push(point);
            tracks.push(k);
        }
        let prior = LensPrior::of_whole(self.problem.image_size);
        let bundle = Bundle {
            observations,
            free: free.to_vec(),
            prior,
            motion: CameraMotion::Moving,
            robust_limit: f64::INFINITY,
            interrupt: self.problem.interrupt.clone(),
        };
        let cameras_from_scene =
            self.order.iter().filter_map(|image| self.camera_from_scene[*image]).collect();
        (bundle, SceneState { lens: self.lens, cameras_from_scene, points }, tracks)
    }

    fn adjust(&mut self, free: &[usize]) {
        let (mut bundle, state, tracks) = self.bundle(free);
        let noise = bundle.median_noise(&state);
        bundle.robust_limit = 2.4 * noise;
        let state = bundle.minimize(state, GROWTH_STOP);
        self.lens = state.lens;
        for (image, pose) in self.order.iter().zip(&state.cameras_from_scene) {
            self.camera_from_scene[*image] = Some(*pose);
        }
        for (track, point) in tracks.iter().zip(&state.points) {
            self.points[*track] = Some(*point);
        }
    }

    fn finish(mut self) -> Option<Reconstruction> {
        self.triangulate();
        let (bundle, state, _) = self.bundle(&[Lens::FX, Lens::FY]);
        (!state.points.is_empty()).then_some(Reconstruction { images: self.order, bundle, state })
    }
}

/// The relative pose of a pair, and the median angle between the rays to its points.
fn relative_pose(pair: &ImagePair, lens: &Lens) -> Option<(Pose, f64)> {
    let e = essential_from_fundamental(&pair.fundamental, lens.matrix, lens.matrix);
    let normalized = |pixel: Point2<f64>| {
        let bearing = lens.bearing_from_pixel(pixel.into())?;
        Some(Point2::new(bearing.x / bearing.z, bearing.y / bearing.z))
    };
    let pairs: Vec<PointPair> = pair
        .matches
        .iter()
        .filter_map(|pair| {
            Some(PointPair { first: normalized(pair.first)?, second: normalized(pair.second)? })
        })
        .collect();
    let found = pose_from_essential(&nearest_essential(&e), &pairs)?;
    let second_from_first = refine_pose(&found.second_from_first, &pairs);
    let center = Point3::from(second_from_first.inverse().translation());
    let mut angles: Vec<f64> = pairs
        .iter()
        .filter_map(|pair| {
            let [first, second] = pair.homogeneous();
            let point = triangulate_rays(&second_from_first, first, second)?;
            (point.z > 0.0).then(|| parallax(&Point3::origin(), &center, &point))
        })
        .collect();
    angles.sort_by(f64::total_cmp);
    let enough = 2 * angles.len() > pairs.len();
    let angle = angles.get(angles.len() / 2).copied().filter(|_| enough)?;
    Some((second_from_first, angle))
}
