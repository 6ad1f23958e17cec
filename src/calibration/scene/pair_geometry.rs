//! The geometry of two images of a scene, without what is fixed to the camera: its own robot in
//! view, a time stamp, dirt on the lens.

use nalgebra::Point2;

use crate::estimation::two_view::PointPair;
use crate::estimation::two_view::degeneracy::{
    LEAST_INLIERS, STILL_PX, TwoViewGeometry, TwoViewKind, two_view_geometry,
};
use crate::estimation::two_view::fundamental::sampson_distance_px;
use crate::geometry::pixel::ImageSize;

/// Two images between which nothing moved are of one view if at least this fraction of the features
/// of the image with fewer features stayed. With less, only what is written into the images stayed.
const SAME_VIEW_FRACTION: f64 = 0.2;

/// A match with a smaller displacement stayed, in pixels.
const STAYED_PX: f64 = 4.0 * STILL_PX;

/// What moved, moved as one if it shows depth, or if at least this part of it agrees. Of 18 sets of
/// photographs with a robot in view, 0.3 to 0.7 answer the same 17.
const AGREED_PART: f64 = 0.5;

/// What stayed is fixed to the camera if at least this part of it contradicts the motion of the
/// rest. Points at infinity stay too where a camera translates, and contradict nothing. With 0.3 to
/// 0.7 the same 17 of those sets are answered.
const CONTRADICTING_PART: f64 = 0.5;

/// What moved is the scene if at least this part of the image is nearer to it than to what stayed.
/// Otherwise it is a thing that moves before a camera at rest. 17 of those sets are answered with
/// 0.4 and 0.5, 18 with 0.3, and 15 with 0.6: a frame around the whole image then counts for more.
const SCENE_PART: f64 = 0.5;

/// The image is divided into so many columns and rows for that. Not swept.
const CELLS: [u32; 2] = [16, 12];

/// The geometry of two images of a scene.
#[derive(Debug, Clone)]
pub(super) struct SceneGeometry {
    /// That of the matches that are not fixed to the camera.
    pub geometry: TwoViewGeometry,
    /// Matches that are fixed to the camera, since they contradict that geometry.
    pub fixed: Vec<usize>,
}

/// The geometry of two images by their matches. `features` is the feature count of the image that
/// has fewer.
pub(super) fn scene_geometry(
    pairs: &[PointPair],
    features: usize,
    size: ImageSize,
) -> Option<SceneGeometry> {
    if let Some(of_rest) = beside_fixed(pairs, size) {
        return Some(of_rest);
    }
    let of_all = |geometry| SceneGeometry { geometry, fixed: Vec::new() };
    let geometry = two_view_geometry(pairs, size)?;
    if geometry.kind != TwoViewKind::Still || is_one_view(&geometry, features) {
        return Some(of_all(geometry));
    }
    let is_left = |k: &usize| geometry.inliers.binary_search(k).is_err();
    let moved: Vec<usize> = (0..pairs.len()).filter(is_left).collect();
    Some(of_all(geometry_of(pairs, &moved, size).unwrap_or(geometry)))
}

/// Whether a match stayed at its place in the image.
pub(super) fn stayed(pair: &PointPair) -> bool {
    (pair.second - pair.first).norm() < STAYED_PX
}

/// The geometry of what moved, where that is the scene: it moved as one, fills most of the image,
/// and most of what stayed contradicts it.
fn beside_fixed(pairs: &[PointPair], size: ImageSize) -> Option<SceneGeometry> {
    let (stayed, moved): (Vec<usize>, Vec<usize>) =
        (0..pairs.len()).partition(|k| stayed(&pairs[*k]));
    if stayed.len().min(moved.len()) < LEAST_INLIERS {
        return None;
    }
    let geometry = geometry_of(pairs, &moved, size)?;
    let agreed = geometry.inliers.len() as f64 / moved.len() as f64;
    if geometry.kind != TwoViewKind::General && agreed < AGREED_PART {
        return None;
    }
    let at = |k: &usize| pairs[*k].first;
    let part = nearer_part(geometry.inliers.iter().map(at), stayed.iter().map(at), size);
    let fixed: Vec<usize> =
        stayed.iter().copied().filter(|k| contradicts(&geometry, &pairs[*k])).collect();
    if part < SCENE_PART || (fixed.len() as f64) < CONTRADICTING_PART * stayed.len() as f64 {
        return None;
    }
    if geometry.kind != TwoViewKind::General {
        // A plane before a background at infinity: only together they show the motion.
        let of_all = two_view_geometry(pairs, size);
        let is_inlier = |of: &TwoViewGeometry| {
            stayed.iter().filter(|k| of.inliers.binary_search(k).is_ok()).count()
        };
        let holds = |of: &TwoViewGeometry| {
            of.kind == TwoViewKind::General && 2 * is_inlier(of) > stayed.len()
        };
        if of_all.as_ref().is_some_and(holds) {
            return None;
        }
    }
    Some(SceneGeometry { geometry, fixed })
}

/// The part of the image that is nearer to one of `some` than to any of `others`.
fn nearer_part(
    some: impl Iterator<Item = Point2<f64>>,
    others: impl Iterator<Item = Point2<f64>>,
    size: ImageSize,
) -> f64 {
    let [columns, rows] = CELLS;
    let (width, height) = (f64::from(size.width), f64::from(size.height));
    let center = |cell: u32| {
        let (column, row) = (f64::from(cell % columns), f64::from(cell / columns));
        let x = (column + 0.5) * width / f64::from(columns);
        Point2::new(x, (row + 0.5) * height / f64::from(rows))
    };
    let cells: Vec<Point2<f64>> = (0..columns * rows).map(center).collect();
    let nearest = |points: &mut dyn Iterator<Item = Point2<f64>>| {
        let mut nearest = vec![f64::INFINITY; cells.len()];
        for point in points {
            for (least, cell) in nearest.iter_mut().zip(&cells) {
                *least = least.min((point - cell).norm_squared());
            }
        }
        nearest
    };
    let (mut some, mut others) = (some, others);
    let (some, others) = (nearest(&mut some), nearest(&mut others));
    let nearer = some.iter().zip(&others).filter(|(some, others)| some < others).count();
    nearer as f64 / cells.len() as f64
}

/// Whether a match that stayed does not fit the motion.
fn contradicts(geometry: &TwoViewGeometry, pair: &PointPair) -> bool {
    let distance_px = match (geometry.kind, &geometry.homography) {
        (TwoViewKind::Homography, Some(homography)) => homography
            .apply(pair.first)
            .map_or(f64::INFINITY, |second: Point2<f64>| (second - pair.second).norm()),
        _ => sampson_distance_px(&geometry.fundamental, pair).abs(),
    };
    distance_px > STAYED_PX
}

/// The geometry of some of `pairs`; its inliers are indices of all.
pub(super) fn geometry_of(
    pairs: &[PointPair],
    some: &[usize],
    size: ImageSize,
) -> Option<TwoViewGeometry> {
    let rest: Vec<PointPair> = some.iter().map(|k| pairs[*k]).collect();
    let mut geometry = two_view_geometry(&rest, size)?;
    geometry.inliers.iter_mut().for_each(|k| *k = some[*k]);
    Some(geometry)
}

/// Whether `geometry` is that of two images of one view: nothing moved. `features` is the feature
/// count of the image that has fewer.
pub(super) fn is_one_view(geometry: &TwoViewGeometry, features: usize) -> bool {
    let stayed = geometry.inliers.len() as f64;
    geometry.kind == TwoViewKind::Still && stayed >= SAME_VIEW_FRACTION * features as f64
}

#[cfg(test)]
mod tests {
    use nalgebra::{Point3, Vector2, Vector3};
    use rand::{RngExt, SeedableRng};
    use rand_chacha::ChaCha8Rng;

    use super::*;
    use crate::geometry::pose::Pose;

    const SIZE: ImageSize = ImageSize::new(640, 480);

    /// Matches of points from near to far, seen before and after a motion.
    fn seen(
        count: usize,
        depth: [f64; 2],
        second_from_first: &Pose,
        random: &mut ChaCha8Rng,
    ) -> Vec<PointPair> {
        let pixel = |point: Point3<f64>, random: &mut ChaCha8Rng| {
            let mut noise = || random.random_range(-0.3..0.3);
            let (x, y) = (point.x / point.z, point.y / point.z);
            Point2::new(320.0 + 500.0 * x + noise(), 240.0 + 500.0 * y + noise())
        };
        (0..count)
            .map(|_| {
                let z = random.random_range(depth[0]..depth[1]);
                let (x, y) = (random.random_range(-0.5..0.5), random.random_range(-0.4..0.4));
                let point = Point3::new(x * z, y * z, z);
                PointPair {
                    first: pixel(point, random),
                    second: pixel(*second_from_first * point, random),
                }
            })
            .collect()
    }

    /// Matches of what is fixed to the camera, in the lowest fifth of the image.
    fn fixed(count: usize, random: &mut ChaCha8Rng) -> Vec<PointPair> {
        let at = |random: &mut ChaCha8Rng| {
            Point2::new(random.random_range(0.0..640.0), random.random_range(384.0..480.0))
        };
        (0..count).map(|_| at(random)).map(|at| PointPair { first: at, second: at }).collect()
    }

    #[test]
    fn a_robot_in_view_is_no_part_of_the_scene() {
        let mut random = ChaCha8Rng::seed_from_u64(3);
        let moved =
            Pose::from_axis_angle(Vector3::new(0.02, -0.1, 0.3), Vector3::new(0.5, 0.1, 0.05));
        let rotated = Pose::from_axis_angle(Vector3::new(0.05, -0.15, 0.4), Vector3::zeros());
        // With more, fewer and as many matches on the robot as on the scene.
        for on_robot in [60, 200, 900] {
            for second_from_first in [moved, rotated] {
                let mut pairs = seen(200, [3.0, 9.0], &second_from_first, &mut random);
                pairs.extend(fixed(on_robot, &mut random));
                let found = scene_geometry(&pairs, 1000, SIZE).unwrap().geometry;
                assert_ne!(found.kind, TwoViewKind::Still, "{on_robot}");
                let of_scene = found.inliers.iter().filter(|k| **k < 200).count();
                let of_robot = found.inliers.len() - of_scene;
                assert!(of_scene > 180 && of_robot == 0, "{on_robot}: {of_scene} {of_robot}");
            }
        }
    }

    #[test]
    fn what_is_far_away_is_part_of_the_scene() {
        let mut random = ChaCha8Rng::seed_from_u64(4);
        let second_from_first =
            Pose::from_axis_angle(Vector3::zeros(), Vector3::new(0.1, 0.0, 0.0));
        let mut pairs = seen(100, [3.0, 9.0], &second_from_first, &mut random);
        pairs.extend(seen(100, [300.0, 900.0], &second_from_first, &mut random));
        let found = scene_geometry(&pairs, 300, SIZE).unwrap().geometry;
        let far = found.inliers.iter().filter(|k| **k >= 100).count();
        assert!(far > 90, "{far}");
    }

    #[test]
    fn a_plane_before_a_far_background_shows_the_motion_with_it() {
        let mut random = ChaCha8Rng::seed_from_u64(6);
        let second_from_first =
            Pose::from_axis_angle(Vector3::zeros(), Vector3::new(0.3, 0.05, 0.0));
        let mut pairs = seen(150, [4.0, 4.001], &second_from_first, &mut random);
        pairs.extend(seen(60, [3e3, 9e3], &second_from_first, &mut random));
        let found = scene_geometry(&pairs, 300, SIZE).unwrap();
        let far = found.geometry.inliers.iter().filter(|k| **k >= 150).count();
        assert!(found.fixed.is_empty() && far > 50, "{far}");
        assert_eq!(found.geometry.kind, TwoViewKind::General);
    }

    #[test]
    fn what_moves_before_a_camera_at_rest_is_not_the_scene() {
        let mut random = ChaCha8Rng::seed_from_u64(7);
        let mut pairs = seen(300, [3.0, 9.0], &Pose::identity(), &mut random);
        let motion = Vector2::new(-40.0, 6.0);
        for _ in 0..80 {
            let first =
                Point2::new(random.random_range(200.0..330.0), random.random_range(100.0..300.0));
            pairs.push(PointPair { first, second: first + motion });
        }
        let found = scene_geometry(&pairs, 400, SIZE).unwrap();
        assert!(is_one_view(&found.geometry, 400) && found.fixed.is_empty());
    }

    #[test]
    fn a_camera_that_stood_still_did_not_move_with_wrong_matches() {
        let mut random = ChaCha8Rng::seed_from_u64(5);
        let mut pairs = seen(300, [3.0, 9.0], &Pose::identity(), &mut random);
        for _ in 0..100 {
            let mut at =
                || Point2::new(random.random_range(0.0..640.0), random.random_range(0.0..480.0));
            pairs.push(PointPair { first: at(), second: at() });
        }
        let found = scene_geometry(&pairs, 400, SIZE).unwrap().geometry;
        assert!(is_one_view(&found, 400), "{found:?}");
    }
}
