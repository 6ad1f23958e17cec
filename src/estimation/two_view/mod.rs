//! The geometry of two images of one scene: the inlier matches, the relative pose of the cameras,
//! and the points.
//!
//! ```text
//! pairs of pixels --ransac--> F, E or H with inliers and their scale --degeneracy--> what it shows
//! pairs, K --ransac--> E of known cameras with inliers
//! E --pose--> of four poses the one with points in front --triangulation--> points
//! F of many pairs --focal--> focal length
//! ```
//!
//! All pairs hold x₂ᵀ F x₁ = 0: F maps a point of the first image to its line in the second.
//! Source: R. Hartley and A. Zisserman, *Multiple view geometry in computer vision*, 2004 (HZ).

pub mod calibrated;
pub mod degeneracy;
pub mod essential;
mod five_point;
pub mod focal;
pub mod fundamental;
mod null_space;
pub mod ransac;
pub mod refinement;
pub mod relative_pose;
mod roots;

pub mod triangulation;
#[cfg(test)]
mod two_view_tests;

use nalgebra::{Point2, Vector3};

pub(crate) use roots::real_roots;

/// One scene point in two images: pixels, or normalized coordinates where a function says so.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PointPair {
    /// In the first image.
    pub first: Point2<f64>,
    /// In the second image.
    pub second: Point2<f64>,
}

impl PointPair {
    /// Both as homogeneous vectors with last coordinate 1.
    pub fn homogeneous(&self) -> [Vector3<f64>; 2] {
        [self.first, self.second].map(|p| Vector3::new(p.x, p.y, 1.0))
    }
}
