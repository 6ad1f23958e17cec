//! Two disjoint halves of the views of color and depth, each calibrated by itself: by how much
//! lenses and poses differ in units of what the halves predict.

use nalgebra::DMatrix;

use crate::estimation::rgbd::calibrate_rgbd;
use crate::estimation::rgbd::problem::{DepthLens, RgbdEstimate, RgbdProblem};
use crate::estimation::split_halves::{LensDifference, MIN_FRAME_SETS, PoseBetweenHalves};
use crate::geometry::pixel::ImageSize;

/// Two halves of the views, and the estimate from each.
#[derive(Debug, Clone, PartialEq)]
pub struct RgbdHalves {
    /// The views of each, by index in the problem: only views whose color and depth were taken
    /// together.
    pub views: [Vec<usize>; 2],
    /// The estimate from each; `None` where its views are too few.
    pub estimates: [Option<RgbdEstimate>; 2],
}

/// How far the two halves differ.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct RgbdDifference {
    /// In color's lens.
    pub color: LensDifference,
    /// In the lens of infrared and depth, where it is estimated.
    pub depth: Option<LensDifference>,
    /// In depth's pose.
    pub color_from_depth: Option<PoseBetweenHalves>,
}

impl RgbdHalves {
    /// From the views of `problem` whose images were taken together, according to `estimate`.
    pub fn of(problem: &RgbdProblem, estimate: &RgbdEstimate) -> Self {
        let usable = |index: &usize| {
            let view = &problem.views[*index];
            let together = !estimate.not_together.contains(index);
            together && !view.color.is_empty() && !view.tiles.is_empty()
        };
        let mut all: Vec<usize> = (0..problem.views.len()).filter(usable).collect();
        // Views with infrared come first, so that they alternate between the halves too.
        all.sort_by_key(|index| problem.views[*index].infrared.is_empty());
        let views = [0, 1].map(|half| all.iter().copied().skip(half).step_by(2).collect());
        let estimates = [0, 1].map(|half: usize| {
            let of_half: &Vec<usize> = &views[half];
            let views = of_half.iter().map(|index| problem.views[*index].clone()).collect();
            // The covariance by color alone is that of all views, so it does not hold for a half.
            let half = RgbdProblem { views, color_covariance: None, ..problem.clone() };
            calibrate_rgbd(&half).ok()
        });
        Self { views, estimates }
    }

    /// The difference. `None` with fewer than six views, or where a half has no estimate.
    pub fn difference(
        &self,
        problem: &RgbdProblem,
        whole: &RgbdEstimate,
        color_size: ImageSize,
    ) -> Option<RgbdDifference> {
        let [Some(a), Some(b)] = &self.estimates else { return None };
        if self.views.iter().map(Vec::len).sum::<usize>() < MIN_FRAME_SETS {
            return None;
        }
        let color_covariance = &a.color_covariance + &b.color_covariance;
        let color = LensDifference::between(
            [&a.color, &b.color],
            &whole.color,
            Some(&color_covariance),
            color_size,
        );
        let depth_covariance = &a.depth_covariance + &b.depth_covariance;
        let estimated = problem.depth_lens != DepthLens::Known;
        let depth = estimated.then(|| {
            LensDifference::between(
                [&a.depth.lens, &b.depth.lens],
                &whole.depth.lens,
                Some(&depth_covariance),
                whole.depth.image_size,
            )
        });
        let covariance = a.color_from_depth_covariance + b.color_from_depth_covariance;
        let covariance = DMatrix::from_column_slice(6, 6, covariance.as_slice());
        let color_from_depth =
            PoseBetweenHalves::between([&a.color_from_depth, &b.color_from_depth], &covariance);
        Some(RgbdDifference { color, depth, color_from_depth })
    }
}

impl RgbdDifference {
    /// The same without depth's lens and pose.
    pub fn of_color_alone(self) -> Self {
        Self { depth: None, color_from_depth: None, ..self }
    }

    /// The largest ratio.
    pub fn ratio(&self) -> Option<f64> {
        let depth = self.depth.and_then(|depth| depth.ratio);
        let pose = self.color_from_depth.map(|pose| pose.ratio);
        [self.color.ratio, depth, pose].into_iter().flatten().reduce(f64::max)
    }
}
