//! The uncertainty of where color sees what depth measures: pixels of the depth image, at the
//! distances of the boards seen, are projected into the color image. Both lenses, the relative pose
//! and the depth error contribute, with their correlations. The noise of a single reading does not:
//! it belongs to the device, and no view lowers it.

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
    /// Two columns per pixel, a row for each parameter of the depth camera …
    by_depth: DMatrix<f64>,
    /// … and for each free parameter of color's lens.
    by_color: DMatrix<f64>,
    /// The number of pixels at each distance.
    counts: Vec<usize>,
    figure: GoalFigure,
}

/// Columns of the grid over the depth image.
const COLUMNS: u32 = 5;
/// If fewer of them than this project into the color image at a distance, those outside it count
/// too.
const LEAST_SEEN: usize = 4;

/// A depth camera beside a color camera.
#[derive(Debug, Clone, Copy)]
pub struct DepthColorPair<'a> {
    /// The depth camera with its pose relative to color.
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
    /// The uncertainty of depth's pixels in color at each of `distances_m`, reduced to `figure`.
    /// `None` where no pixel is in the valid regions of both lenses.
    pub fn new(
        sensors: DepthColorPair<'_>,
        distances_m: &[f64],
        figure: GoalFigure,
    ) -> Option<Self> {
        let DepthColorPair { depth, depth_size, color, free, color_size } = sensors;
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

    /// The 1-σ uncertainty of each projected pixel in its worst direction, in pixels of color,
    /// distance after distance. `None` where the information matrix leaves something undetermined.
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

    /// The greatest over the distances of the figure of `std_px`, in pixels of color.
    pub fn figure_px(&self, std_px: &[f64]) -> f64 {
        self.figures_px(std_px).into_iter().fold(0.0, f64::max)
    }

    /// The number that views are compared by, in pixels: a power mean of the figures at the
    /// distances, or of all pixels if the goal is the worst one.
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
