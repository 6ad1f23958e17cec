//! The scale of a reconstruction from measured depth: how many meters a unit of the scene is.
//!
//! Each reading compares a measured depth z with that of a scene point. The error of a depth camera
//! is mainly an offset b of 1/z, so the logarithm of the ratio is s − b z: the part that grows with
//! z is the camera's error, and the rest is the scale. Readings of one image share the error of its
//! pose, those of one part of the scene the errors of its points, those of one region of the depth
//! image the depth camera's error. So the standard deviation follows from the differences between
//! these, not from the number of readings.

use std::collections::BTreeMap;

use nalgebra::{Matrix2, Point3, Vector2};

use crate::estimation::scene::parts::scene_parts;
use crate::geometry::median::{STD_PER_MAD, median};

/// One comparison of a measured depth with a reconstructed one.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ScaleReading {
    /// The logarithm of the measured depth, in meters, over the depth of the point.
    pub log_ratio: f64,
    /// Its standard deviation, as far as it is known: the weight of the reading.
    pub std: f64,
    /// The measured depth.
    pub depth_m: f64,
    /// The image.
    pub view: usize,
    /// The scene point, as its index among the points.
    pub point: usize,
    /// The region of the depth image.
    pub region: usize,
}

/// The scale from all readings.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ScaleEstimate {
    /// The logarithm of the ratio, without the part that grows with depth.
    pub log_ratio: f64,
    /// Its standard deviation, which is the relative standard deviation of the scale.
    pub relative_std: f64,
    /// The offset of the depth camera's 1/z, in 1/m.
    pub offset_per_m: f64,
    /// The standard deviation of one reading's ratio, from their median absolute deviation.
    pub robust_std: f64,
    /// Number of inlier readings.
    pub readings: usize,
    /// Number of images with inlier readings.
    pub views: usize,
}

/// Readings with a larger residual, in standard deviations, are outliers: of normal ones, one in
/// 370.
const OUTLIER_STDS: f64 = 3.0;
/// How often the line is fitted to its inliers.
const MOST_FITS: usize = 5;
/// The prior standard deviation of a depth camera's offset, in 1/m: stereo cameras are sold as
/// within 2 % at 2 m, which are two of these.
const OFFSET_STD_PER_M: f64 = 0.005;

/// The scale by `readings` of these `points`; `None` of fewer than two images.
///
/// The covariance is the clustered one (K.-Y. Liang and S. L. Zeger, 1986) by image, by part of the
/// scene and by region of the depth image, each way's excess added (A. C. Cameron, J. Gelbach and
/// D. Miller, 2011).
pub fn metric_scale(readings: &[ScaleReading], points: &[Point3<f64>]) -> Option<ScaleEstimate> {
    let middle = median(readings.iter().map(|reading| reading.log_ratio).collect())?;
    let off = |reading: &ScaleReading| (reading.log_ratio - middle).abs();
    let robust_std = STD_PER_MAD * median(readings.iter().map(off).collect())?;
    let mut line = Line { scale: middle, offset: 0.0 };
    let mut kept: Vec<&ScaleReading> = Vec::new();
    let mut inverse = Matrix2::zeros();
    for _ in 0..MOST_FITS {
        let in_std = |reading: &ScaleReading| line.left(reading).abs() / reading.std;
        let limit = OUTLIER_STDS * STD_PER_MAD * median(readings.iter().map(in_std).collect())?;
        kept = readings.iter().filter(|reading| in_std(reading) <= limit).collect();
        (line, inverse) = Line::through(&kept)?;
    }
    let covariance = clustered_covariance(&kept, &line, &inverse, points)?;
    // The prior of the offset, as a measurement of 0.
    let gain = covariance.column(1) / (covariance[(1, 1)] + OFFSET_STD_PER_M.powi(2));
    let updated = Vector2::new(line.scale, line.offset) - gain * line.offset;
    let variance = covariance[(0, 0)] - gain[0] * covariance[(0, 1)];
    let mut views: Vec<usize> = kept.iter().map(|reading| reading.view).collect();
    views.sort_unstable();
    views.dedup();
    Some(ScaleEstimate {
        log_ratio: updated[0],
        relative_std: variance.max(0.0).sqrt(),
        offset_per_m: updated[1],
        robust_std,
        readings: kept.len(),
        views: views.len(),
    })
}

/// The logarithm of the ratio as a function of depth.
#[derive(Debug, Clone, Copy)]
struct Line {
    scale: f64,
    /// In 1/m.
    offset: f64,
}

/// A weak prior on the offset (information in m²: a standard deviation of 1/m) that keeps readings
/// at a single depth solvable.
const LEAST_INFORMATION: f64 = 1.0;

impl Line {
    /// The residual of a reading.
    fn left(&self, reading: &ScaleReading) -> f64 {
        reading.log_ratio - self.scale + self.offset * reading.depth_m
    }

    /// The line of least squares, with the inverse of its information.
    fn through(readings: &[&ScaleReading]) -> Option<(Self, Matrix2<f64>)> {
        let mut information = Matrix2::new(0.0, 0.0, 0.0, LEAST_INFORMATION);
        let mut right = Vector2::zeros();
        for reading in readings {
            let (terms, weight) = (terms(reading), reading.std.powi(-2));
            information += terms * terms.transpose() * weight;
            right += terms * (weight * reading.log_ratio);
        }
        let inverse = information.try_inverse()?;
        let solution = inverse * right;
        Some((Self { scale: solution[0], offset: solution[1] }, inverse))
    }
}

/// The derivatives of a reading by scale and offset.
fn terms(reading: &ScaleReading) -> Vector2<f64> {
    Vector2::new(1.0, -reading.depth_m)
}

/// The covariance of scale and offset; `None` of fewer than two images.
fn clustered_covariance(
    readings: &[&ScaleReading],
    line: &Line,
    inverse: &Matrix2<f64>,
    points: &[Point3<f64>],
) -> Option<Matrix2<f64>> {
    let parts = scene_parts(points);
    let pull = |r: &ScaleReading| inverse * terms(r) * (line.left(r) / r.std.powi(2));
    let pulls: Vec<(Vector2<f64>, &ScaleReading)> =
        readings.iter().map(|reading| (pull(reading), *reading)).collect();
    let by = |cluster: &dyn Fn(&ScaleReading) -> usize| {
        clustered(pulls.iter().map(|(pull, reading)| (cluster(reading), *pull)))
    };
    let independent: Matrix2<f64> = pulls.iter().map(|(pull, _)| pull * pull.transpose()).sum();
    let ways = [
        Some(by(&|reading| reading.view)?),
        by(&|reading| parts[reading.point]),
        by(&|reading| reading.region),
    ];
    // Where readings do not determine the offset, its variance is that of the weak prior.
    let open = inverse.column(1);
    let mut total = independent + open * open.transpose() * LEAST_INFORMATION;
    for way in ways.into_iter().flatten() {
        // An excess below 0 is chance.
        let mut excess = (way - independent).symmetric_eigen();
        excess.eigenvalues.iter_mut().for_each(|value| *value = value.max(0.0));
        total += excess.recompose();
    }
    Some(total)
}

/// The covariance of the sum of pulls, with errors common to each cluster; `None` of one cluster.
fn clustered(pulls: impl Iterator<Item = (usize, Vector2<f64>)>) -> Option<Matrix2<f64>> {
    let mut sums = BTreeMap::<usize, Vector2<f64>>::new();
    for (cluster, pull) in pulls {
        *sums.entry(cluster).or_insert_with(Vector2::zeros) += pull;
    }
    let clusters = sums.len() as f64;
    // The fit has used one degree of freedom of the clusters.
    let small = clusters / (clusters - 1.0);
    let squares: Matrix2<f64> = sums.values().map(|sum| sum * sum.transpose()).sum();
    (clusters > 1.0).then(|| squares * small)
}

#[cfg(test)]
mod tests {
    use rand::{RngExt, SeedableRng};
    use rand_chacha::ChaCha8Rng;
    use rand_distr::StandardNormal;

    use super::*;

    const VIEWS: usize = 12;

    /// Readings by a depth camera with an offset, with independent noise and noise of their view
    /// and of their region; every seventh is an outlier.
    fn readings(seed: u64, [own, of_view, of_region]: [f64; 3]) -> Vec<ScaleReading> {
        let mut random = ChaCha8Rng::seed_from_u64(seed);
        let mut normal = || -> f64 { random.sample(StandardNormal) };
        let views: Vec<f64> = (0..VIEWS).map(|_| of_view * normal()).collect();
        let regions: Vec<f64> = (0..16).map(|_| of_region * normal()).collect();
        let offset = OFFSET_STD_PER_M * normal();
        let reading = |k: usize| {
            let (view, region) = (k % VIEWS, (k / VIEWS) % 16);
            let wrong = if k.is_multiple_of(7) { 0.4 } else { 0.0 };
            let depth_m = 1.0 + 3.0 * (k % 97) as f64 / 97.0;
            let shared = views[view] + regions[region] - offset * depth_m;
            let log_ratio = 0.7 + own * normal() + shared + wrong;
            ScaleReading { log_ratio, std: own, depth_m, view, point: k % 100, region }
        };
        (0..1920).map(reading).collect()
    }

    fn points() -> Vec<Point3<f64>> {
        (0..100).map(|k| Point3::new(f64::from(k % 10), f64::from(k / 10), 1.0)).collect()
    }

    #[test]
    fn errors_are_as_large_as_stated_whatever_is_shared() {
        for noise in [[0.01, 0.0, 0.0], [0.01, 0.01, 0.0], [0.01, 0.005, 0.01]] {
            let ratios: Vec<f64> = (0..60)
                .map(|seed| {
                    let found = metric_scale(&readings(seed, noise), &points()).unwrap();
                    assert!(found.views == VIEWS && found.readings > 1500, "{found:?}");
                    (found.log_ratio - 0.7) / found.relative_std
                })
                .collect();
            let rms = (ratios.iter().map(|z| z * z).sum::<f64>() / 60.0).sqrt();
            assert!((0.6..1.5).contains(&rms), "{rms} for {noise:?}");
        }
    }

    #[test]
    fn readings_of_one_depth_leave_the_offset_to_what_is_known_beforehand() {
        let mut flat = readings(1, [0.01, 0.0, 0.0]);
        flat.iter_mut().for_each(|reading| reading.depth_m = 2.0);
        let found = metric_scale(&flat, &points()).unwrap();
        let expected = 2.0 * OFFSET_STD_PER_M;
        assert!((found.relative_std / expected - 1.0).abs() < 0.1, "{found:?}");
    }

    #[test]
    fn one_image_says_nothing_of_how_images_differ() {
        let mut one = readings(1, [0.01, 0.0, 0.0]);
        one.retain(|reading| reading.view == 3);
        assert_eq!(metric_scale(&one, &points()), None);
        assert_eq!(metric_scale(&[], &[]), None);
    }
}
