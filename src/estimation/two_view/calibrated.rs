//! The relative pose of two images with known lenses, from matches with outliers: the five-point
//! algorithm in RANSAC, then the maximum-likelihood pose of the inliers.

use nalgebra::{Matrix3, Point2};

use crate::estimation::two_view::PointPair;
use crate::estimation::two_view::essential::{essential_from_five, essential_from_pose};
use crate::estimation::two_view::fundamental::sampson_distance_px;
use crate::estimation::two_view::ransac::{
    Consensus, RansacOptions, SampledModel, chance_beside_line, ransac,
};
use crate::estimation::two_view::refinement::{
    ResidualMixture, refine_pose, refine_pose_among_wrong,
};
use crate::estimation::two_view::relative_pose::{RelativePose, pose_from_essential};
use crate::geometry::camera_matrix::CameraMatrix;
use crate::geometry::pixel::ImageSize;

/// Two images of cameras without distortion, and matches between them.
#[derive(Debug, Clone, Copy)]
pub struct CalibratedPair<'a> {
    /// In pixels.
    pub pairs: &'a [PointPair],
    /// Of the first and of the second camera.
    pub cameras: [CameraMatrix; 2],
    /// The size of the second image, from which follows the probability that a wrong match fits by
    /// chance.
    pub size: ImageSize,
}

/// The relative pose whose inliers are the least likely to arise by chance; its translation has
/// unit length. `None` where chance explains them, or none is in front of both cameras.
///
/// ```
/// use nalgebra::{Point2, Vector3};
/// use plumb::estimation::two_view::PointPair;
/// use plumb::estimation::two_view::calibrated::{CalibratedPair, relative_pose};
/// use plumb::geometry::camera_matrix::CameraMatrix;
/// use plumb::geometry::pixel::ImageSize;
/// use plumb::geometry::pose::Pose;
///
/// let camera = CameraMatrix { fx: 500.0, fy: 500.0, cx: 320.0, cy: 240.0, skew: 0.0 };
/// let truth = Pose::from_axis_angle(Vector3::new(0.0, 0.1, 0.0), Vector3::new(-1.0, 0.0, 0.0));
/// let pairs: Vec<PointPair> = (0..40)
///     .map(|k| {
///         let k = f64::from(k);
///         let point = nalgebra::Point3::new((1.7 * k).sin(), k.cos(), 5.0 + (2.3 * k).sin());
///         let pixel = |at: nalgebra::Point3<f64>| {
///             let pixel = camera.pixel_from_normalized(at.xy().coords / at.z);
///             Point2::new(pixel.x, pixel.y)
///         };
///         PointPair { first: pixel(point), second: pixel(truth * point) }
///     })
///     .collect();
/// let size = ImageSize::new(640, 480);
/// let found = relative_pose(CalibratedPair { pairs: &pairs, cameras: [camera; 2], size }).unwrap();
/// assert!(found.model.second_from_first.angle_to(&truth) < 1e-6);
/// assert_eq!(found.inliers.len(), 40);
/// ```
pub fn relative_pose(matches: CalibratedPair<'_>) -> Option<Consensus<RelativePose>> {
    let [first, second] = matches.cameras;
    let normalized = |camera: CameraMatrix, at: Point2<f64>| {
        Point2::from(camera.normalized_from_pixel(at.into()))
    };
    let normalized: Vec<PointPair> = matches
        .pairs
        .iter()
        .map(|pair| PointPair {
            first: normalized(first, pair.first),
            second: normalized(second, pair.second),
        })
        .collect();
    let inverses = [first.to_matrix().try_inverse()?, second.to_matrix().try_inverse()?];
    let problem = Calibrated { matches, normalized, inverses };
    let options = RansacOptions { max_limit_px: 4.0, ..RansacOptions::default() };
    let Consensus { model, inliers, limit_px, log_false_alarms } = ransac(&problem, &options)?;
    let mut model = problem.pose(&model.essential, &inliers)?;
    // Residuals of normalized coordinates are those in pixels over the focal length.
    let focal_px = (first.fx * first.fy * second.fx * second.fy).sqrt().sqrt();
    let mixture = ResidualMixture {
        std: 0.5 * limit_px / focal_px,
        wrong_within_unit: problem.chance(1.0) * focal_px,
    };
    model.second_from_first =
        refine_pose_among_wrong(&model.second_from_first, &problem.normalized, mixture);
    Some(Consensus { model, inliers, limit_px, log_false_alarms })
}

/// E, with F for pixels, in which residuals are measured.
#[derive(Clone)]
struct Essential {
    essential: Matrix3<f64>,
    fundamental: Matrix3<f64>,
}

struct Calibrated<'a> {
    matches: CalibratedPair<'a>,
    normalized: Vec<PointPair>,
    /// K⁻¹ of each camera.
    inverses: [Matrix3<f64>; 2],
}

impl Calibrated<'_> {
    fn model(&self, essential: Matrix3<f64>) -> Essential {
        let [first, second] = &self.inverses;
        Essential { essential, fundamental: second.tr_mul(&essential) * first }
    }

    fn pose(&self, essential: &Matrix3<f64>, inliers: &[usize]) -> Option<RelativePose> {
        let pairs: Vec<PointPair> = inliers.iter().map(|k| self.normalized[*k]).collect();
        let mut pose = pose_from_essential(essential, &pairs)?;
        pose.second_from_first = refine_pose(&pose.second_from_first, &pairs);
        Some(pose)
    }
}

impl SampledModel for Calibrated<'_> {
    type Model = Essential;
    const SAMPLE: usize = 5;

    fn count(&self) -> usize {
        self.normalized.len()
    }

    fn fit_sample(&self, sample: &[usize]) -> Vec<Essential> {
        let Ok(sample) = <&[usize; 5]>::try_from(sample) else { return Vec::new() };
        let found = essential_from_five(&sample.map(|k| self.normalized[k]));
        found.into_iter().map(|essential| self.model(essential)).collect()
    }

    fn fit_inliers(&self, model: &Essential, inliers: &[usize]) -> Option<Essential> {
        let pose = self.pose(&model.essential, inliers)?.second_from_first;
        Some(self.model(essential_from_pose(&pose.rotation_matrix(), &pose.translation())))
    }

    fn squared_residual_px2(&self, model: &Essential, index: usize) -> f64 {
        sampson_distance_px(&model.fundamental, &self.matches.pairs[index]).powi(2)
    }

    fn chance(&self, limit_px: f64) -> f64 {
        chance_beside_line(self.matches.size, limit_px)
    }

    fn max_solutions(&self) -> f64 {
        10.0
    }
}
