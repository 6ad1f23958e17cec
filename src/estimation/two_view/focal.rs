//! The focal length from the epipolar geometry of image pairs alone.

use nalgebra::Matrix3;

use crate::estimation::two_view::essential::{essential_from_fundamental, singular_gap};
use crate::geometry::camera_matrix::CameraMatrix;
use crate::geometry::pixel::ImageSize;

/// Focal lengths tried, over the longer side of the image: 120 to 7 degrees of view. Chosen, not
/// swept.
const SHORTEST_FOCAL: f64 = 0.3;
const LONGEST_FOCAL: f64 = 8.0;
const FOCAL_SAMPLES: usize = 80;

/// The gap between singular values at which a pair has half its largest cost: about the gap that
/// noise and distortion leave at the true focal length.
const LARGE_GAP: f64 = 0.02;

/// A focal length, and how much pairs contradict it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct FocalVote {
    /// In pixels.
    pub focal_px: f64,
    /// The weighted mean over the pairs: 0 where all are consistent with it, 1 where all contradict
    /// it.
    pub cost: f64,
}

/// Focal lengths in pixels to try for images of `size`: `count` of them, two at least, ascending,
/// in equal ratios.
pub(in crate::estimation) fn focals_to_try(
    size: ImageSize,
    count: usize,
) -> impl Iterator<Item = f64> {
    let longer = f64::from(size.width.max(size.height));
    (0..count).map(move |k| {
        let part = k as f64 / (count - 1) as f64;
        longer * SHORTEST_FOCAL * (LONGEST_FOCAL / SHORTEST_FOCAL).powf(part)
    })
}

/// Every tried focal length, ascending, with its cost. The cost of each pair (F, weight) is a
/// robust function of how far KᵀFK is from an essential matrix, which is Kruppa's equations in the
/// form of singular values (HZ section 19.5.1; P. Mendonça and R. Cipolla, *A simple technique for
/// self-calibration*, 1999). Assumes square pixels and a principal point in the image's center.
pub fn focal_votes(pairs: &[(Matrix3<f64>, f64)], size: ImageSize) -> Vec<FocalVote> {
    let center = size.center();
    let weight: f64 = pairs.iter().map(|(_, weight)| weight).sum();
    let vote = |focal_px: f64| {
        let matrix =
            CameraMatrix { fx: focal_px, fy: focal_px, cx: center.x, cy: center.y, skew: 0.0 };
        let against = |(f, weight): &(Matrix3<f64>, f64)| {
            let gap = singular_gap(&essential_from_fundamental(f, matrix, matrix)) / LARGE_GAP;
            weight * gap * gap / (1.0 + gap * gap)
        };
        let cost = pairs.iter().map(against).sum::<f64>() / weight.max(f64::MIN_POSITIVE);
        FocalVote { focal_px, cost }
    };
    focals_to_try(size, FOCAL_SAMPLES).map(vote).collect()
}

/// The local minima of `votes`, best first.
pub fn likely_focals(votes: &[FocalVote]) -> Vec<FocalVote> {
    let mut minima: Vec<FocalVote> = votes
        .windows(3)
        .filter(|v| v[1].cost <= v[0].cost && v[1].cost < v[2].cost)
        .map(|v| v[1])
        .collect();
    minima.sort_by(|a, b| a.cost.total_cmp(&b.cost));
    minima
}

/// f² of both images, (first, second) in px², from F by Bougnoux's formula (S. Bougnoux, *From
/// projective to Euclidean space under any practical situation*, 1998), for square pixels and
/// principal points in the images' centers. It is exact without noise, meaningless where the
/// optical axes meet (then it is 0 / 0), and negative where F is poor.
pub fn bougnoux_square_focals(f: &Matrix3<f64>, size: ImageSize) -> [f64; 2] {
    let center = size.center();
    let p = nalgebra::Vector3::new(center.x, center.y, 1.0);
    let flat = Matrix3::from_diagonal(&nalgebra::Vector3::new(1.0, 1.0, 0.0));
    let square = |f: &Matrix3<f64>| {
        // The epipole of the second image.
        let svd = f.svd(true, false);
        let epipole = svd.u.map_or_else(nalgebra::Vector3::zeros, |u| u.column(2).into_owned());
        let cross = epipole.cross_matrix();
        let above = p.dot(&(cross * flat * f * p)) * p.dot(&f.tr_mul(&p));
        let below = p.dot(&(cross * flat * f * flat * f.tr_mul(&p)));
        -above / below
    };
    [square(&f.transpose()), square(f)]
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::estimation::two_view::essential::essential_from_pose;
    use nalgebra::{Rotation3, Vector3};

    fn fundamental(focal_px: f64, size: ImageSize) -> Matrix3<f64> {
        let c = size.center();
        let k = CameraMatrix { fx: focal_px, fy: focal_px, cx: c.x, cy: c.y, skew: 0.0 };
        let rotation = Rotation3::from_scaled_axis(Vector3::new(0.12, -0.35, 0.08)).into_inner();
        let e = essential_from_pose(&rotation, &Vector3::new(0.8, 0.25, -0.3));
        let k_inverse = k.to_matrix().try_inverse().unwrap();
        k_inverse.transpose() * e * k_inverse
    }

    #[test]
    fn exact_pairs_vote_for_their_focal_length() {
        let size = ImageSize::new(1280, 960);
        let f = fundamental(1400.0, size);
        for square in bougnoux_square_focals(&f, size) {
            assert!((square.sqrt() - 1400.0).abs() < 1e-6, "{square}");
        }
        let best = likely_focals(&focal_votes(&[(f / f.norm(), 1.0)], size))[0];
        assert!((best.focal_px / 1400.0).ln().abs() < 0.05, "{best:?}");
    }
}
