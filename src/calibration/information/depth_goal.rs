//! How uncertain it is where color sees what depth measures: the pixels of the depth image at the
//! distances that boards were seen at, in the color image. Both lenses, the relative pose and the
//! error of depth have their part in it, with their correlations. The noise of a single reading has
//! none: it is the device's, and no view lowers it.

use nalgebra::DMatrix;

use crate::calibration::information::depth_information::DepthInformation;
use crate::calibration::information::projection_goal::{GoalFigure, power_mean};
use crate::estimation::rgbd::plane_information::PlacedDepth;
use crate::estimation::uncertainty::{PixelGrid, greatest_variance};
use crate::geometry::lens::Lens;
use crate::geometry::pixel::ImageSize;

/// The derivatives of transferred pixels.
#[derive(Debug, Clone)]
pub struct DepthGoal {
    /// Two columns a pixel, a row for each parameter of the depth camera …
    by_depth: DMatrix<f64>,
    /// … and for each open one of color's lens.
    by_color: DMatrix<f64>,
    /// How many pixels there are at each distance.
    counts: Vec<usize>,
    figure: GoalFigure,
}

/// Columns of the grid over the depth image.
const COLUMNS: u32 = 5;
/// Of those that color sees at least so many at a distance, or all that its lens has a pixel for
/// are taken.
const LEAST_SEEN: usize = 4;

/// A depth camera beside a color camera.
#[derive(Debug, Clone, Copy)]
pub struct DepthBesideColor<'a> {
    /// Depth, where color has it.
    pub depth: &'a PlacedDepth,
    /// The size of its images.
    pub depth_size: ImageSize,
    /// Color's lens.
    pub color: &'a Lens,
    /// Which of its parameters are estimated.
    pub free: &'a [usize],
    /// The size of its images.
    pub color_size: ImageSize,
}

impl DepthGoal {
    /// The `figure` of depth's pixels in color at each of `distances_m`. `None` where color sees
    /// none of them.
    pub fn new(
        sensors: DepthBesideColor<'_>,
        distances_m: &[f64],
        figure: GoalFigure,
    ) -> Option<Self> {
        let DepthBesideColor { depth, depth_size, color, free, color_size } = sensors;
        let grid = PixelGrid::over(depth_size, COLUMNS);
        let (mut by_depth, mut by_color, mut counts) = (Vec::new(), Vec::new(), Vec::new());
        for z_m in distances_m {
            let transferred: Vec<_> = (grid.pixels())
                .filter_map(|pixel| {
                    let (point, by_depth) = depth.point_in_color(pixel, *z_m)?;
                    let seen = color.project(&point)?;
                    let by_point = DMatrix::from_fn(2, 3, |i, k| seen.by_point[(i, k)]);
                    Some((seen.pixel, by_point * by_depth, seen.by_parameters))
                })
                .collect();
            let is_seen = transferred.iter().filter(|it| color_size.contains(it.0)).count();
            let taken =
                transferred.iter().filter(|it| is_seen < LEAST_SEEN || color_size.contains(it.0));
            let before = by_depth.len();
            for (_, of_depth, of_color) in taken {
                for axis in 0..2 {
                    by_depth.push(of_depth.row(axis).transpose());
                    let row = free.iter().map(|index| of_color[(axis, *index)]);
                    by_color.push(nalgebra::DVector::from_iterator(free.len(), row));
                }
            }
            counts.push((by_depth.len() - before) / 2);
        }
        counts.retain(|count| *count > 0);
        (!counts.is_empty()).then(|| Self {
            by_depth: DMatrix::from_columns(&by_depth),
            by_color: DMatrix::from_columns(&by_color),
            counts,
            figure,
        })
    }

    /// The 1-σ uncertainty of each transferred pixel in its worst direction, in pixels of color,
    /// distance after distance. `None` where the information leaves something open.
    pub fn std_px(&self, known: &DepthInformation) -> Option<Vec<f64>> {
        let parts = known.deviations(&self.by_depth, &self.by_color)?;
        let std = |at: usize| {
            let (mut own, mut other, mut shared) = (0.0, 0.0, 0.0);
            for part in &parts {
                let (u, v) = (part.column(2 * at), part.column(2 * at + 1));
                (own, other) = (own + u.norm_squared(), other + v.norm_squared());
                shared += u.dot(&v);
            }
            greatest_variance([own, other], shared).sqrt()
        };
        let stds: Vec<f64> = (0..self.by_depth.ncols() / 2).map(std).collect();
        stds.iter().all(|std| std.is_finite()).then_some(stds)
    }

    /// The figure of uncertainties at the distance where it is greatest, in pixels of color.
    pub fn figure_px(&self, std_px: &[f64]) -> f64 {
        self.figures_px(std_px).into_iter().fold(0.0, f64::max)
    }

    /// What views are compared by, in pixels: a power mean over the distances, or over all pixels
    /// where the worst of them is to fall.
    pub fn criterion_px(&self, std_px: &[f64]) -> f64 {
        match self.figure {
            GoalFigure::Median => power_mean(&self.figures_px(std_px)),
            GoalFigure::Worst => power_mean(std_px),
        }
    }

    /// The figure at each distance.
    pub fn figures_px(&self, std_px: &[f64]) -> Vec<f64> {
        let mut at = 0;
        let figure = |count: &usize| {
            let part = &std_px[at..at + count];
            at += count;
            self.figure.of(part)
        };
        self.counts.iter().map(figure).collect()
    }
}
