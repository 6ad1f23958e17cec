//! The poses and points of a scene in the coordinate frame of results.

use nalgebra::Point3;

use crate::calibration::scene::correspondence::SceneImage;
use crate::calibration::scene::fitted_lens::LensFit;
use crate::calibration::scene::result::{ScenePoint, SceneView};
use crate::estimation::scene::reconstruction::Reconstruction;
use crate::geometry::lens::Lens;
use crate::geometry::pixel::ImageSize;
use crate::geometry::pose::Pose;

/// The coordinate frame of results: that of the first used image, scaled so that the greatest
/// distance between two cameras is 1.
pub(super) struct SceneFrame {
    /// By image.
    camera_from_scene: Vec<Option<Pose>>,
    scene_from_state: Pose,
    scale: f64,
}

impl SceneFrame {
    pub(super) fn of(start: &Reconstruction, cameras_from_state: &[Pose]) -> Self {
        let centers: Vec<_> =
            cameras_from_state.iter().map(|pose| pose.inverse().translation()).collect();
        let distances = centers.iter().flat_map(|a| centers.iter().map(move |b| (a - b).norm()));
        let widest = distances.fold(0.0, f64::max);
        let scale = if widest > 0.0 { 1.0 / widest } else { 1.0 };
        let first = (0..start.images.len()).min_by_key(|k| start.images[*k]).unwrap_or(0);
        let scene_from_state = cameras_from_state[first];
        let count = start.images.iter().max().map_or(0, |last| last + 1);
        let mut camera_from_scene = vec![None; count];
        for (image, camera_from_state) in start.images.iter().zip(cameras_from_state) {
            let pose = *camera_from_state * scene_from_state.inverse();
            camera_from_scene[*image] =
                Some(Pose::new(pose.rotation(), pose.translation() * scale));
        }
        Self { camera_from_scene, scene_from_state, scale }
    }

    /// A point of the fit in that frame.
    fn point(&self, in_state: &Point3<f64>) -> Point3<f64> {
        (self.scene_from_state * *in_state) * self.scale
    }
}

/// The points of the fit in the frame of results, each with the images that see it.
pub(super) fn scene_points(
    start: &Reconstruction,
    fit: &LensFit,
    frame: &SceneFrame,
) -> Vec<ScenePoint> {
    let (bundle, state) = (&fit.fit.bundle, &fit.fit.state);
    let squares = bundle.squares(state);
    let all = state.points.iter().zip(&bundle.observations).zip(&squares);
    all.map(|((point, seen), squares)| {
        // Points outside the lens's valid region have no residual.
        let px2: Vec<f64> = seen
            .iter()
            .zip(squares)
            .filter(|(_, square)| square.is_finite())
            .map(|(seen, square)| square / seen.inverse_std.powi(2))
            .collect();
        ScenePoint {
            point: frame.point(point),
            rms_px: (px2.iter().sum::<f64>() / px2.len().max(1) as f64).sqrt(),
            seen: seen.iter().map(|seen| (start.images[seen.camera], seen.pixel)).collect(),
        }
    })
    .collect()
}

/// One image's part of the result.
pub(super) fn view(
    of: &SceneImage,
    same_as: Option<&str>,
    image: usize,
    frame: &SceneFrame,
    points: &[ScenePoint],
    lens: &Lens,
) -> SceneView {
    let name = of.name.clone();
    let sees = |point: &ScenePoint| point.seen.iter().any(|(seen_in, _)| *seen_in == image);
    let pose = frame.camera_from_scene.get(image).copied().flatten();
    let Some(camera_from_scene) = pose.filter(|_| points.iter().any(sees)) else {
        let reason = same_as.map_or_else(
            || "too few of its features agree with the other images".to_owned(),
            |other| format!("it shows the same as `{other}`, from the same place"),
        );
        return SceneView { name, reason: Some(reason), rms_px: None, camera_from_scene: None };
    };
    let (mut sum, mut count) = (0.0, 0);
    for point in points {
        for (_, pixel) in point.seen.iter().filter(|(seen_in, _)| *seen_in == image) {
            let projected = lens.pixel_from_point(&(camera_from_scene * point.point));
            let Some(projected) = projected else { continue };
            sum += projected.distance_px(*pixel).powi(2);
            count += 1;
        }
    }
    let rms_px = (count > 0).then(|| (sum / f64::from(count)).sqrt());
    SceneView { name, reason: None, rms_px, camera_from_scene: Some(camera_from_scene) }
}

/// The fraction of the image's cells (12 along the longer side) that contain points.
pub(super) fn coverage(points: &[ScenePoint], size: ImageSize) -> f64 {
    let side = f64::from(size.width.max(size.height)) / 12.0;
    let cells = |length: u32| (f64::from(length) / side).ceil().max(1.0);
    let seen: std::collections::BTreeSet<(i64, i64)> = points
        .iter()
        .flat_map(|point| &point.seen)
        .map(|(_, pixel)| ((pixel.x / side) as i64, (pixel.y / side) as i64))
        .collect();
    (seen.len() as f64 / (cells(size.width) * cells(size.height))).min(1.0)
}
