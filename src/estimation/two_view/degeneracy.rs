//! What the matches of two images determine: a full epipolar geometry, or only a homography.

use nalgebra::{Matrix3, Point2};

use crate::estimation::two_view::PointPair;
use crate::estimation::two_view::fundamental::{
    fundamental_from_many, fundamental_from_seven, sampson_distance_px,
};
use crate::estimation::two_view::ransac::{
    Consensus, RansacOptions, SampledModel, chance_beside_line, chance_in_disk, ransac,
};
use crate::estimation::two_view::refinement::{
    ResidualMixture, refine_fundamental, refine_fundamental_among_wrong,
};
use crate::geometry::homography::Homography;
use crate::geometry::median::median;
use crate::geometry::pixel::ImageSize;

/// What the matches of two images determine.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum TwoViewKind {
    /// Points at different depths and a moved camera: F is determined.
    General,
    /// A homography explains the matches: one plane, or a camera that only rotated (or hardly
    /// moved). F is not determined.
    Homography,
    /// Matches did not move: the camera stood still, or it is the same image.
    Still,
}

/// The geometry of two images, with its inliers.
#[derive(Debug, Clone)]
pub struct TwoViewGeometry {
    /// What the matches determine.
    pub kind: TwoViewKind,
    /// F, as well as the matches determine it; 0 for a still camera.
    pub fundamental: Matrix3<f64>,
    /// The homography with the most inliers among them.
    pub homography: Option<Homography>,
    /// The inliers of F, ascending.
    pub inliers: Vec<usize>,
    /// How many of those are also inliers of the homography.
    pub on_homography: usize,
    /// Whether a homography explains nearly all of the inliers.
    pub is_nearly_planar: bool,
    /// The median displacement of the matches between the images, in pixels.
    pub displacement_px: f64,
}

/// Where a homography explains more than this part of F's inliers, the scene is nearly one plane,
/// or the camera only rotated (COLMAP's).
const HOMOGRAPHY_PART: f64 = 0.8;

/// The natural logarithm of the rate at which matches off the homography may fit F by chance: once
/// in a million pairs of images. Given a homography, F has two more degrees of freedom, the epipole
/// (HZ result 13.6: plane and parallax). So the matches off the homography decide whether there is
/// depth, however large the plane is.
const LOG_NO_CHANCE: f64 = -13.8;

/// The least number of inliers: fewer fit by chance too easily.
pub(crate) const LEAST_INLIERS: usize = 16;

/// A displacement below this is no motion, in pixels.
pub(crate) const STILL_PX: f64 = 0.5;

/// The geometry whose inliers are the least likely to arise by chance; `None` where chance explains
/// them, or where there are too few.
pub fn two_view_geometry(pairs: &[PointPair], size: ImageSize) -> Option<TwoViewGeometry> {
    if let Some(still) = still(pairs) {
        return Some(still);
    }
    if pairs.len() < LEAST_INLIERS {
        return None;
    }
    let epipolar = Epipolar { pairs, size };
    let Consensus { model, inliers, limit_px, .. } =
        ransac(&epipolar, &RansacOptions { max_limit_px: 4.0, ..RansacOptions::default() })?;
    if inliers.len() < LEAST_INLIERS {
        return None;
    }
    let inlier_pairs: Vec<PointPair> = inliers.iter().map(|k| pairs[*k]).collect();
    let mixture = ResidualMixture { std: 0.5 * limit_px, wrong_within_unit: epipolar.chance(1.0) };
    let fundamental = refine_fundamental_among_wrong(&model, pairs, mixture).unwrap_or(model);
    let planar = Planar { pairs: &inlier_pairs, size };
    // The test for a plane uses a limit from F's own precision.
    let limit_px = limit_px.max(1.0) * 1.5;
    let options = RansacOptions { max_limit_px: 8.0, ..RansacOptions::default() };
    let homography = ransac(&planar, &options).map(|consensus| consensus.model);
    let on_homography = homography.as_ref().map_or(0, |homography| {
        let explained =
            |k: &usize| planar.squared_residual_px2(homography, *k) <= limit_px * limit_px;
        (0..inlier_pairs.len()).filter(explained).count()
    });
    let displacement_px = median_displacement_px(&inlier_pairs);
    let beside = homography.as_ref().map_or(pairs.len(), |homography| {
        let all = Planar { pairs, size };
        let is_beside = |k: &usize| all.squared_residual_px2(homography, *k) > limit_px * limit_px;
        (0..pairs.len()).filter(is_beside).count()
    });
    let on_epipolar_lines = inliers.len() - on_homography;
    let shows_depth = on_epipolar_lines >= LEAST_INLIERS
        && log_false_alarms(on_epipolar_lines, beside, epipolar.chance(limit_px)) < LOG_NO_CHANCE;
    let kind = if shows_depth { TwoViewKind::General } else { TwoViewKind::Homography };
    let is_nearly_planar = on_homography as f64 > HOMOGRAPHY_PART * inliers.len() as f64;
    Some(TwoViewGeometry {
        kind,
        fundamental,
        homography,
        inliers,
        on_homography,
        is_nearly_planar,
        displacement_px,
    })
}

/// The natural logarithm of how often `on_epipolar_lines` of `beside` matches, each with
/// probability `chance`, lie on the epipolar lines of an epipole that two of them determine.
fn log_false_alarms(on_epipolar_lines: usize, beside: usize, chance: f64) -> f64 {
    let log_factorial = |n: usize| (1..=n).map(|k| (k as f64).ln()).sum::<f64>();
    let log_choose = |n: usize, k: usize| {
        log_factorial(n) - log_factorial(k) - log_factorial(n.saturating_sub(k))
    };
    let tests = (beside.max(1) as f64).ln();
    let free = on_epipolar_lines.saturating_sub(2) as f64;
    tests
        + log_choose(beside, on_epipolar_lines)
        + log_choose(on_epipolar_lines, 2)
        + free * chance.ln()
}

fn median_displacement_px(pairs: &[PointPair]) -> f64 {
    median(pairs.iter().map(|p| (p.second - p.first).norm()).collect()).unwrap_or(0.0)
}

/// The geometry of images without motion between them. Any skew-symmetric matrix is a valid F.
fn still(pairs: &[PointPair]) -> Option<TwoViewGeometry> {
    let displacement_px = median_displacement_px(pairs);
    if pairs.len() < LEAST_INLIERS || displacement_px >= STILL_PX {
        return None;
    }
    let stays = |k: &usize| (pairs[*k].second - pairs[*k].first).norm() < 4.0 * STILL_PX;
    let inliers: Vec<usize> = (0..pairs.len()).filter(stays).collect();
    Some(TwoViewGeometry {
        kind: TwoViewKind::Still,
        fundamental: Matrix3::zeros(),
        homography: Homography::from_matrix(&Matrix3::identity()),
        on_homography: inliers.len(),
        is_nearly_planar: true,
        inliers,
        displacement_px,
    })
}

/// The RANSAC problem of F.
pub struct Epipolar<'a> {
    /// The matches.
    pub pairs: &'a [PointPair],
    /// The size of the images.
    pub size: ImageSize,
}

impl SampledModel for Epipolar<'_> {
    type Model = Matrix3<f64>;
    const SAMPLE: usize = 7;

    fn count(&self) -> usize {
        self.pairs.len()
    }

    fn fit_sample(&self, sample: &[usize]) -> Vec<Matrix3<f64>> {
        let Ok(sample) = <&[usize; 7]>::try_from(sample) else { return Vec::new() };
        fundamental_from_seven(&sample.map(|k| self.pairs[k]))
    }

    fn fit_inliers(&self, _: &Matrix3<f64>, inliers: &[usize]) -> Option<Matrix3<f64>> {
        let pairs: Vec<PointPair> = inliers.iter().map(|k| self.pairs[*k]).collect();
        refine_fundamental(&fundamental_from_many(&pairs)?, &pairs)
    }

    fn squared_residual_px2(&self, f: &Matrix3<f64>, index: usize) -> f64 {
        sampson_distance_px(f, &self.pairs[index]).powi(2)
    }

    fn chance(&self, limit_px: f64) -> f64 {
        chance_beside_line(self.size, limit_px)
    }

    fn max_solutions(&self) -> f64 {
        3.0
    }
}

/// The RANSAC problem of a homography.
pub struct Planar<'a> {
    /// The matches.
    pub pairs: &'a [PointPair],
    /// The size of the images.
    pub size: ImageSize,
}

impl Planar<'_> {
    fn fit(&self, indices: &[usize], refine: bool) -> Option<Homography> {
        let pairs: Vec<(Point2<f64>, Point2<f64>)> =
            indices.iter().map(|k| (self.pairs[*k].first, self.pairs[*k].second)).collect();
        if refine { Homography::fit_refined(&pairs) } else { Homography::fit(&pairs) }.ok()
    }
}

impl SampledModel for Planar<'_> {
    type Model = Homography;
    const SAMPLE: usize = 4;

    fn count(&self) -> usize {
        self.pairs.len()
    }

    fn fit_sample(&self, sample: &[usize]) -> Vec<Homography> {
        self.fit(sample, false).into_iter().collect()
    }

    fn fit_inliers(&self, _: &Homography, inliers: &[usize]) -> Option<Homography> {
        self.fit(inliers, true)
    }

    fn squared_residual_px2(&self, homography: &Homography, index: usize) -> f64 {
        let pair = &self.pairs[index];
        let mapped = homography.apply(pair.first);
        mapped.map_or(f64::INFINITY, |mapped| (mapped - pair.second).norm_squared())
    }

    fn chance(&self, limit_px: f64) -> f64 {
        chance_in_disk(self.size, limit_px)
    }

    fn max_solutions(&self) -> f64 {
        1.0
    }
}
