//! The uncertainty of a lens's projections over the image, as one number to minimize.

use nalgebra::DMatrix;

use crate::estimation::uncertainty::{
    CompensatedSamples, Distance, PixelGrid, ProjectionSamples, UncertaintyMap,
};
use crate::geometry::lens::Lens;
use crate::geometry::median::median;
use crate::geometry::pixel::ImageSize;

/// The figure of the uncertainty over the image that is minimized.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum GoalFigure {
    /// The median over the image: what a session's goal is stated in.
    #[default]
    Median,
    /// The worst anywhere in it.
    Worst,
}

impl GoalFigure {
    /// This figure of uncertainties over an image.
    pub(super) fn of(self, std_px: &[f64]) -> f64 {
        match self {
            Self::Median => median(std_px.to_vec()).unwrap_or(f64::INFINITY),
            Self::Worst => std_px.iter().copied().fold(0.0, f64::max),
        }
    }

    /// The number that views are compared by: the median itself, or instead of the worst a power
    /// mean over the image, which also falls when only one of several nearly worst places improves.
    pub(super) fn criterion(self, std_px: &[f64]) -> f64 {
        match self {
            Self::Median => self.of(std_px),
            Self::Worst => power_mean(std_px),
        }
    }
}

/// The uncertainty of projections of one lens, prepared for many covariances.
#[derive(Debug, Clone)]
pub struct ProjectionGoal {
    samples: ProjectionSamples,
    figure: GoalFigure,
}

/// Columns of the grid that views are compared over: half as fine as the one that results are
/// summed up over, at a quarter of the time.
const COLUMNS: u32 = 7;
/// Exponent of the power mean: 3 and 12 lead to as few views (27 simulated sessions each).
const POWER: i32 = 6;

impl ProjectionGoal {
    /// The `figure` of the uncertainty of projections of `lens` over images of `size`.
    pub fn new(lens: &Lens, size: ImageSize, figure: GoalFigure) -> Self {
        let grid = PixelGrid::over(size, COLUMNS);
        Self { samples: ProjectionSamples::of(lens, grid, Distance::Infinity), figure }
    }

    /// Which figure it is.
    pub fn figure(&self) -> GoalFigure {
        self.figure
    }

    /// The figure for this covariance of the lens's parameters, in pixels; `None` where no pixel of
    /// the image is in the lens's valid region.
    pub fn uncertainty_px(&self, covariance: &DMatrix<f64>) -> Option<f64> {
        self.figure_px(&self.map(covariance)?)
    }

    /// The figure of a map, in pixels.
    pub fn figure_px(&self, map: &UncertaintyMap) -> Option<f64> {
        Some(self.figure.of(&seen_std_px(map)?))
    }

    /// The number that views are compared by, in pixels.
    pub fn criterion_px(&self, map: &UncertaintyMap) -> Option<f64> {
        Some(self.figure.criterion(&seen_std_px(map)?))
    }

    /// The relative drop of [`Self::criterion_px`], 0 to 1.
    pub fn drop(&self, before: &UncertaintyMap, after: &UncertaintyMap) -> f64 {
        match (self.criterion_px(before), self.criterion_px(after)) {
            (Some(before), Some(after)) => 1.0 - after / before.max(f64::MIN_POSITIVE),
            _ => 0.0,
        }
    }

    /// How much the uncertainty falls from `before` to `after`: the mean over the image of the
    /// relative drop of each pixel's standard deviation, 0 to 1. Unlike the figure, it counts an
    /// improvement anywhere.
    pub fn gain(&self, before: &UncertaintyMap, after: &UncertaintyMap) -> f64 {
        let pairs = before.std_px.iter().zip(&after.std_px);
        let drops: Vec<f64> = pairs
            .filter_map(|(before, after)| Some(1.0 - (*after)? / (*before)?.max(f64::MIN_POSITIVE)))
            .collect();
        drops.iter().sum::<f64>() / drops.len().max(1) as f64
    }

    /// The uncertainty at each pixel of the grid.
    pub fn map(&self, covariance: &DMatrix<f64>) -> Option<UncertaintyMap> {
        self.samples.uncertainty(covariance)
    }

    /// Samples for a fast computation of such maps, for many candidates that are compared with
    /// `now`.
    pub fn near(&self, now: &UncertaintyMap) -> Option<CompensatedSamples> {
        self.samples.compensated_as(now)
    }
}

/// The uncertainties inside the lens's valid region; `None` if there are none.
fn seen_std_px(map: &UncertaintyMap) -> Option<Vec<f64>> {
    let seen: Vec<f64> = map.std_px.iter().flatten().copied().collect();
    (!seen.is_empty()).then_some(seen)
}

/// The power mean of uncertainties, which is near the worst of them.
pub(super) fn power_mean(std_px: &[f64]) -> f64 {
    let worst = std_px.iter().copied().fold(0.0, f64::max);
    let sum: f64 = std_px.iter().map(|std| (std / worst).powi(POWER)).sum();
    worst * (sum / std_px.len() as f64).powf(1.0 / f64::from(POWER))
}
