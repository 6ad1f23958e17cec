//! The uncertainty of projections over the image, after the camera motion that compensates best: a
//! difference that a rotation of the camera explains is no error of its lens (mrcal's projection
//! uncertainty and difference). Pixels that are known far worse than most, as in an image corner
//! that no view reached, get little weight in that motion. Otherwise their uncertainty would spread
//! over the whole image.

use nalgebra::{DMatrix, Matrix2, Matrix2x6, Matrix6, Point3, SMatrix, Vector6};

use crate::geometry::lens::{Lens, MAX_PARAMETERS, Projection};
use crate::geometry::median::median_of;
use crate::geometry::pixel::{Bearing, ImageSize, Pixel};

/// The distance of the observed scene.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Distance {
    /// So far that only a rotation of the camera compensates.
    Infinity,
    /// At this many meters: a rotation and a translation compensate.
    Meters(f64),
}

/// A grid of pixels over an image, corner to corner.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct PixelGrid {
    /// The image.
    pub size: ImageSize,
    /// Columns, at least 2.
    pub cols: u32,
    /// Rows, at least 2.
    pub rows: u32,
}

impl PixelGrid {
    /// About `count` columns along the longer side, and the same spacing along the other.
    pub fn over(size: ImageSize, count: u32) -> Self {
        let longer = f64::from(size.width.max(size.height));
        let along =
            |length: u32| ((f64::from(count) * f64::from(length) / longer).round() as u32).max(2);
        Self { size, cols: along(size.width), rows: along(size.height) }
    }

    /// The pixels, row by row.
    pub fn pixels(self) -> impl Iterator<Item = Pixel> {
        let at = |k: u32, count: u32, length: u32| {
            f64::from(k) / f64::from(count.max(2) - 1) * (f64::from(length) - 1.0)
        };
        let Self { size, cols, rows } = self;
        (0..rows).flat_map(move |r| {
            (0..cols).map(move |c| Pixel::new(at(c, cols, size.width), at(r, rows, size.height)))
        })
    }
}

/// The predicted 1-σ uncertainty of projections over an image, in pixels.
#[derive(Debug, Clone, PartialEq)]
pub struct UncertaintyMap {
    /// The pixels.
    pub grid: PixelGrid,
    /// Standard deviation in the worst direction at each pixel of the grid, row by row; `None`
    /// where the lens sees nothing.
    pub std_px: Vec<Option<f64>>,
    /// Mean squared length of the error (both axes) at each pixel of the grid, in px²: the
    /// expectation for a squared difference.
    pub square_px2: Vec<Option<f64>>,
    /// The covariance of the error at each pixel of the grid, in px².
    pub covariance_px2: Vec<Option<Matrix2<f64>>>,
    /// The weight of each pixel of the grid in the fit of the compensating motion: 1, less where
    /// the standard deviation is far above the median, 0 where nothing is projected.
    pub weights: Vec<f64>,
}

impl UncertaintyMap {
    /// The uncertainty at the image's center (at the nearest pixel of the grid that the lens sees).
    pub fn center(&self) -> Option<f64> {
        let middle = self.grid.size.center();
        let seen =
            self.grid.pixels().zip(&self.std_px).filter_map(|(pixel, std)| Some((pixel, (*std)?)));
        let nearest =
            seen.min_by(|a, b| a.0.distance_px(middle).total_cmp(&b.0.distance_px(middle)));
        Some(nearest?.1)
    }

    /// The mean of [`Self::square_px2`] over the image.
    pub fn mean_square_px2(&self) -> f64 {
        let seen = || self.square_px2.iter().flatten();
        seen().sum::<f64>() / seen().count().max(1) as f64
    }

    /// Median and maximum over the image; `None` where the lens sees nothing of it.
    pub fn median_and_worst(&self) -> Option<MedianAndWorst> {
        let mut seen: Vec<f64> = self.std_px.iter().flatten().copied().collect();
        seen.sort_by(f64::total_cmp);
        Some(MedianAndWorst { median_px: *seen.get(seen.len() / 2)?, worst_px: *seen.last()? })
    }
}

/// The 1-σ uncertainty of projections over an image.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct MedianAndWorst {
    /// Its upper median, in pixels.
    pub median_px: f64,
    /// Its maximum, in pixels.
    pub worst_px: f64,
}

impl MedianAndWorst {
    /// For an unknown lens.
    pub const UNKNOWN: Self = Self { median_px: f64::INFINITY, worst_px: f64::INFINITY };
}

/// Pixels whose standard deviation exceeds the image's median by this factor get less weight.
const FAR_WORSE_RATIO: f64 = 4.0;

/// The largest number of rounds. The weights converge in a few; most images need none.
const MAX_ROUNDS: usize = 8;

/// The derivative of one projection by the lens's parameters and by the compensating motion.
#[derive(Debug, Clone)]
struct Sample {
    by_parameters: SMatrix<f64, 2, MAX_PARAMETERS>,
    by_motion: Matrix2x6<f64>,
}

impl Sample {
    fn of(lens: &Lens, bearing: Bearing, distance: Distance) -> Option<Self> {
        let (length, translates) = match distance {
            Distance::Infinity => (1.0, 0.0),
            Distance::Meters(meters) => (meters, 1.0),
        };
        let point = Point3::from(bearing.into_inner() * length);
        let Projection { by_point, by_parameters, .. } = lens.project(&point)?;
        let mut by_motion = Matrix2x6::zeros();
        for axis in 0..2 {
            let row = by_point.row(axis).transpose();
            let by_rotation = point.coords.cross(&row);
            for k in 0..3 {
                by_motion[(axis, k)] = by_rotation[k];
                by_motion[(axis, 3 + k)] = translates * row[k];
            }
        }
        Some(Self { by_parameters, by_motion })
    }
}

/// Inverts the normal matrix of a motion, of which only the rotation may be determined.
fn invert_motion(normal: &Matrix6<f64>, distance: Distance) -> Option<Matrix6<f64>> {
    match distance {
        Distance::Meters(_) => normal.cholesky().map(|c| c.inverse()),
        Distance::Infinity => {
            let rotation = normal.fixed_view::<3, 3>(0, 0).into_owned().cholesky()?.inverse();
            let mut inverse = Matrix6::zeros();
            inverse.fixed_view_mut::<3, 3>(0, 0).copy_from(&rotation);
            Some(inverse)
        }
    }
}

/// The derivatives of projections over a grid of pixels, from which the uncertainty of a lens
/// follows for any covariance of its parameters.
#[derive(Debug, Clone)]
pub struct ProjectionSamples {
    grid: PixelGrid,
    distance: Distance,
    samples: Vec<Option<Sample>>,
}

impl ProjectionSamples {
    /// For `lens` at the pixels of `grid`, and a scene at `distance`.
    pub fn of(lens: &Lens, grid: PixelGrid, distance: Distance) -> Self {
        let sample = |pixel| Sample::of(lens, lens.bearing_from_pixel(pixel)?, distance);
        Self { grid, distance, samples: grid.pixels().map(sample).collect() }
    }

    /// The 1-σ uncertainty of the projections for this covariance of the lens's parameters (in the
    /// order of [`Lens::parameter_names`]), after the best compensating motion. `None` where the
    /// lens sees nothing of the image.
    pub fn uncertainty(&self, covariance: &DMatrix<f64>) -> Option<UncertaintyMap> {
        let Self { grid, distance, samples } = self;
        let padded = padded(covariance);
        let mut weights: Vec<f64> =
            samples.iter().map(|sample| f64::from(u8::from(sample.is_some()))).collect();
        let mut covariances = projection_covariances(samples, &weights, &padded, *distance)?;
        for _ in 0..MAX_ROUNDS {
            let next = weights_of(&covariances);
            let settled = next
                .iter()
                .zip(&weights)
                .all(|(next, weight)| (next - weight).abs() < 0.1 * weight + 1e-3);
            if settled {
                break;
            }
            weights = next;
            covariances = projection_covariances(samples, &weights, &padded, *distance)?;
        }
        Some(map_of(*grid, covariances, weights))
    }

    /// The same samples with the compensating motion fixed to the weights of `map`, to compare many
    /// covariances that differ little from that of the map. `None` where the motion is not
    /// determined.
    pub fn compensated_as(&self, map: &UncertaintyMap) -> Option<CompensatedSamples> {
        let compensation = compensation(&self.samples, &map.weights, self.distance)?;
        let rest = |sample: &Sample| sample.by_parameters - sample.by_motion * compensation;
        Some(CompensatedSamples {
            grid: self.grid,
            weights: map.weights.clone(),
            rests: self.samples.iter().map(|sample| sample.as_ref().map(rest)).collect(),
        })
    }
}

/// [`ProjectionSamples`] with a fixed compensating motion: an uncertainty takes a tenth of the
/// time.
#[derive(Debug, Clone)]
pub struct CompensatedSamples {
    grid: PixelGrid,
    weights: Vec<f64>,
    /// The derivative of each projection by the parameters, including the compensating motion.
    rests: Vec<Option<SMatrix<f64, 2, MAX_PARAMETERS>>>,
}

impl CompensatedSamples {
    /// The 1-σ uncertainty of the projections for this covariance of the lens's parameters. It
    /// equals that of [`ProjectionSamples::uncertainty`] for the covariance for which the motion
    /// was chosen and its multiples, and is close to it for others.
    pub fn uncertainty(&self, covariance: &DMatrix<f64>) -> UncertaintyMap {
        let covariance = padded(covariance);
        let of_pixel =
            |rest: &SMatrix<f64, 2, MAX_PARAMETERS>| rest * covariance * rest.transpose();
        let covariances = self.rests.iter().map(|rest| rest.as_ref().map(of_pixel)).collect();
        map_of(self.grid, covariances, self.weights.clone())
    }
}

/// A covariance padded with zeros to the largest number of parameters of a lens.
fn padded(covariance: &DMatrix<f64>) -> SMatrix<f64, MAX_PARAMETERS, MAX_PARAMETERS> {
    let mut padded = SMatrix::<f64, MAX_PARAMETERS, MAX_PARAMETERS>::zeros();
    let count = covariance.nrows().min(MAX_PARAMETERS);
    padded.view_mut((0, 0), (count, count)).copy_from(&covariance.view((0, 0), (count, count)));
    padded
}

/// The largest variance in any direction of the plane, from the variances along its axes and their
/// covariance: the larger eigenvalue.
pub(crate) fn greatest_variance([x, y]: [f64; 2], covariance: f64) -> f64 {
    0.5 * (x + y) + (0.5 * (x - y)).hypot(covariance)
}

fn map_of(
    grid: PixelGrid,
    covariances: Vec<Option<Matrix2<f64>>>,
    weights: Vec<f64>,
) -> UncertaintyMap {
    let worst_direction = |covariance: &Matrix2<f64>| {
        let variances = [covariance[(0, 0)], covariance[(1, 1)]];
        greatest_variance(variances, covariance[(0, 1)]).clamp(0.0, f64::INFINITY).sqrt()
    };
    UncertaintyMap {
        grid,
        std_px: covariances.iter().map(|pixel| pixel.as_ref().map(worst_direction)).collect(),
        square_px2: covariances.iter().map(|pixel| pixel.as_ref().map(Matrix2::trace)).collect(),
        covariance_px2: covariances,
        weights,
    }
}

/// The 1-σ uncertainty of projections over a grid of pixels, from the covariance of the lens's
/// parameters (in the order of [`Lens::parameter_names`]), after the best compensating motion.
/// `None` where the lens sees nothing of the image.
pub fn projection_uncertainty(
    lens: &Lens,
    covariance: &DMatrix<f64>,
    grid: PixelGrid,
    distance: Distance,
) -> Option<UncertaintyMap> {
    ProjectionSamples::of(lens, grid, distance).uncertainty(covariance)
}

/// The covariance of each sample's projection after the compensating motion for `weights`.
fn projection_covariances(
    samples: &[Option<Sample>],
    weights: &[f64],
    covariance: &SMatrix<f64, MAX_PARAMETERS, MAX_PARAMETERS>,
    distance: Distance,
) -> Option<Vec<Option<Matrix2<f64>>>> {
    let compensation = compensation(samples, weights, distance)?;
    let of_sample = |sample: &Sample| {
        let rest = sample.by_parameters - sample.by_motion * compensation;
        rest * covariance * rest.transpose()
    };
    Some(samples.iter().map(|sample| sample.as_ref().map(of_sample)).collect())
}

/// The derivative of the compensating motion for `weights` by the lens's parameters.
fn compensation(
    samples: &[Option<Sample>],
    weights: &[f64],
    distance: Distance,
) -> Option<SMatrix<f64, 6, MAX_PARAMETERS>> {
    let mut normal = Matrix6::zeros();
    let mut coupling = SMatrix::<f64, 6, MAX_PARAMETERS>::zeros();
    for (sample, weight) in samples.iter().zip(weights) {
        let Some(sample) = sample else { continue };
        let by_motion = sample.by_motion.transpose() * *weight;
        normal += by_motion * sample.by_motion;
        coupling += by_motion * sample.by_parameters;
    }
    Some(invert_motion(&normal, distance)? * coupling)
}

/// 1 for pixels whose standard deviation is at most [`FAR_WORSE_RATIO`] times the median; above
/// that, inverse to the variance.
fn weights_of(covariances: &[Option<Matrix2<f64>>]) -> Vec<f64> {
    let mut variances: Vec<f64> = covariances.iter().flatten().map(Matrix2::trace).collect();
    let Some(median) = median_of(&mut variances) else { return vec![0.0; covariances.len()] };
    let limit = median * FAR_WORSE_RATIO * FAR_WORSE_RATIO;
    let weight =
        |pixel: &Matrix2<f64>| if pixel.trace() > limit { limit / pixel.trace() } else { 1.0 };
    covariances.iter().map(|pixel| pixel.as_ref().map_or(0.0, weight)).collect()
}

/// The projection by `second` of each grid pixel's ray under `first`, minus that pixel, after the
/// best compensating rotation, in pixels; `None` where either lens sees nothing. For a comparison
/// with a prediction, pass the `weights` of that prediction ([`UncertaintyMap::weights`]); with an
/// empty slice all pixels have equal weight in the rotation.
pub fn projection_difference(
    first: &Lens,
    second: &Lens,
    grid: PixelGrid,
    weights: &[f64],
) -> Vec<Option<[f64; 2]>> {
    let seen: Vec<_> =
        grid.pixels().map(|pixel| (pixel, first.bearing_from_pixel(pixel))).collect();
    let mut rotation = nalgebra::UnitQuaternion::identity();
    let difference = |pixel: Pixel, bearing: Bearing, rotation: &nalgebra::UnitQuaternion<f64>| {
        let projection = second.project(&Point3::from(rotation * bearing.into_inner()))?;
        Some((projection, [projection.pixel.x - pixel.x, projection.pixel.y - pixel.y]))
    };
    for _ in 0..4 {
        let (mut normal, mut gradient) = (Matrix6::zeros(), Vector6::zeros());
        for (index, (pixel, bearing)) in seen.iter().enumerate() {
            let (pixel, Some(bearing)) = (*pixel, *bearing) else { continue };
            let weight = weights.get(index).copied().unwrap_or(1.0);
            let Some((projection, rest)) = difference(pixel, bearing, &rotation) else { continue };
            let rotated = rotation * bearing.into_inner();
            let mut by_motion = Matrix2x6::zeros();
            for axis in 0..2 {
                let by_rotation = rotated.cross(&projection.by_point.row(axis).transpose());
                by_motion.fixed_view_mut::<1, 3>(axis, 0).copy_from(&by_rotation.transpose());
            }
            normal += by_motion.transpose() * by_motion * weight;
            gradient += by_motion.transpose() * nalgebra::Vector2::from(rest) * weight;
        }
        let Some(inverse) = invert_motion(&normal, Distance::Infinity) else { break };
        let step = -(inverse * gradient);
        rotation = nalgebra::UnitQuaternion::from_scaled_axis(step.fixed_rows::<3>(0).into_owned())
            * rotation;
        if step.norm() < 1e-8 {
            break;
        }
    }
    seen.iter()
        .map(|(pixel, bearing)| Some(difference(*pixel, (*bearing)?, &rotation)?.1))
        .collect()
}
