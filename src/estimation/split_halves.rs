//! Two disjoint halves of the frame sets, fitted separately: by how much lenses and poses differ in
//! units of their predicted uncertainties, and how well each half predicts the other. A single
//! camera is a rig of one sensor, whose frame sets are its views.

use std::ops::Range;

use nalgebra::{DMatrix, DVector};

use crate::estimation::camera_fit::CameraFit;
use crate::estimation::joint::minimize::Minimum;
use crate::estimation::joint::normal::ReducedView;
use crate::estimation::joint::per_observation::assemble;
use crate::estimation::joint::{BoardObservation, State};
use crate::estimation::refit::{refit, squares_under};
use crate::estimation::uncertainty::{
    Distance, PixelGrid, projection_difference, projection_uncertainty,
};
use crate::geometry::lens::Lens;
use crate::geometry::pixel::ImageSize;
use crate::geometry::pose::{Pose, pose_step};

/// The least number of frame sets: with fewer, the halves do not determine a lens each.
pub(crate) const MIN_FRAME_SETS: usize = 6;

/// Columns of the grid on which projections are compared.
const COLUMNS: u32 = 10;

/// A second-order prediction is used where another lens raises the squares of a view by less than
/// this part: the higher-order terms are then far smaller.
const MOST_COST_RISE: f64 = 0.2;

/// The estimated lens, with the covariance of all its parameters.
#[derive(Debug, Clone, Copy)]
pub(crate) struct LensWithCovariance<'a> {
    pub(crate) lens: &'a Lens,
    pub(crate) covariance: &'a DMatrix<f64>,
}

/// The difference between two halves in a lens.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct LensDifference {
    /// As [`crate::estimation::model_check::ModelCheck::split_half_ratio`]; `None` where no
    /// difference is predicted, as for a lens that is not estimated.
    pub ratio: Option<f64>,
    /// The difference of the focal lengths, relative to the focal length.
    pub focal_change: f64,
}

impl LensDifference {
    /// Between the lenses of the halves. `stated` is the lens of the whole; `covariance` is that of
    /// the difference, `None` where it is not determined.
    pub(crate) fn between(
        lenses: [&Lens; 2],
        stated: &Lens,
        covariance: Option<&DMatrix<f64>>,
        image_size: ImageSize,
    ) -> Self {
        let [a, b] = lenses.map(|lens| lens.matrix.fx);
        let ratio = covariance.and_then(|covariance| {
            projection_ratio(lenses, LensWithCovariance { lens: stated, covariance }, image_size)
        });
        let focal_change = (a - b).abs() / stated.matrix.fx;
        Self { ratio: ratio.filter(|ratio| ratio.is_finite()), focal_change }
    }
}

/// The difference between two halves in the pose of a sensor.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PoseBetweenHalves {
    /// The root mean square of its six components in units of their predicted standard deviations,
    /// about 1 when the model is right.
    pub ratio: f64,
    /// The angle between both, in radians.
    pub rotation_rad: f64,
    /// The distance between both, in meters.
    pub translation_m: f64,
}

impl PoseBetweenHalves {
    /// Between the poses of the halves, whose difference has this `covariance` (rotation in radians
    /// about the target's axes, then translation in meters). `None` where that is singular.
    pub fn between(a_from_b: [&Pose; 2], covariance: &DMatrix<f64>) -> Option<Self> {
        let [first, second] = a_from_b;
        let rotation = (second.rotation() * first.rotation().inverse()).scaled_axis();
        let translation = second.translation() - first.translation();
        let step = pose_step(&rotation, &translation);
        let step = DVector::from_column_slice(step.as_slice());
        // Radians and meters differ by orders of magnitude, hence units of their standard
        // deviations.
        let std = covariance.diagonal().map(f64::sqrt);
        let scaled = DMatrix::from_fn(6, 6, |i, j| covariance[(i, j)] / (std[i] * std[j]));
        let in_stds = step.component_div(&std);
        let square = in_stds.dot(&scaled.cholesky()?.solve(&in_stds));
        let ratio = (square / 6.0).sqrt();
        let (rotation_rad, translation_m) = (rotation.norm(), translation.norm());
        ratio.is_finite().then_some(Self { ratio, rotation_rad, translation_m })
    }
}

/// The difference of the projections of two lenses, after the best compensating rotation, over its
/// predicted standard deviation at that pixel: the root mean square over the image. `predicted` is
/// a lens close to both, with the covariance of their difference. `None` where the lens sees
/// nothing of the image.
fn projection_ratio(
    [first, second]: [&Lens; 2],
    predicted: LensWithCovariance<'_>,
    image_size: ImageSize,
) -> Option<f64> {
    let grid = PixelGrid::over(image_size, COLUMNS);
    let LensWithCovariance { lens, covariance } = predicted;
    let predicted = projection_uncertainty(lens, covariance, grid, Distance::Infinity)?;
    let seen = projection_difference(first, second, grid, &predicted.weights);
    // Each pixel relative to its own prediction, so that an image corner that no view reached does
    // not dominate.
    let ratios = seen.iter().zip(&predicted.square_px2).filter_map(|(seen, predicted)| {
        let [x, y] = (*seen)?;
        Some((x * x + y * y) / (*predicted)?)
    });
    let (count, sum) = ratios.fold((0.0, 0.0), |(count, sum), ratio| (count + 1.0, sum + ratio));
    Some(f64::sqrt(sum / count))
}

/// The fits of both halves of a fit's frame sets.
pub(crate) struct SplitHalves<'a> {
    fit: &'a CameraFit,
    /// The frame sets of each half, as their observations' indices.
    frame_sets: [Vec<Vec<usize>>; 2],
    halves: [Minimum; 2],
}

impl<'a> SplitHalves<'a> {
    /// `None` with fewer than [`MIN_FRAME_SETS`].
    pub(crate) fn of(fit: &'a CameraFit) -> Option<Self> {
        let mut all = fit.some_frame_sets();
        if all.len() < MIN_FRAME_SETS {
            return None;
        }
        // Frame sets with the same sensors follow each other, and alternate between the halves.
        let sensors = |frame_set: &Vec<usize>| -> Vec<usize> {
            frame_set.iter().map(|index| fit.observations[*index].sensor).collect()
        };
        all.sort_by_key(sensors);
        let half = |parity: usize| -> Vec<Vec<usize>> {
            all.iter().skip(parity).step_by(2).cloned().collect()
        };
        let frame_sets = [half(0), half(1)];
        let local = &fit.robust.minimum.equations.local;
        let halves = [0, 1].map(|half| refit(fit, &fit.observations, local, &frame_sets[half]));
        Some(Self { fit, frame_sets, halves })
    }

    /// The difference between the halves in the lens of `sensor`; `stated` is that of the whole.
    pub(crate) fn lens_difference(
        &self,
        sensor: usize,
        stated: LensWithCovariance<'_>,
        image_size: ImageSize,
    ) -> LensDifference {
        let of_half = |half: usize| self.lens_covariance(half, sensor, stated);
        let covariance = of_half(0).zip(of_half(1)).map(|(a, b)| a + b);
        let lenses = [0, 1].map(|half| &self.halves[half].state.lenses[sensor]);
        LensDifference::between(lenses, stated.lens, covariance.as_ref(), image_size)
    }

    /// The difference between the halves in the pose of `sensor`, which has the covariance `stated`
    /// in the whole. `None` for the first sensor, which is the rig's own frame.
    pub(crate) fn pose_difference(
        &self,
        sensor: usize,
        stated: &DMatrix<f64>,
    ) -> Option<PoseBetweenHalves> {
        let at = self.fit.layout.sensors[sensor].pose_at?;
        let covariance = self.half_covariance(0, at..at + 6, stated)?
            + self.half_covariance(1, at..at + 6, stated)?;
        let sensor_from_rig = [0, 1].map(|half| &self.halves[half].state.sensor_from_rig[sensor]);
        PoseBetweenHalves::between(sensor_from_rig, &covariance)
    }

    /// Root mean square error of the views of `sensor`, in pixels, each under the lenses and sensor
    /// poses of the other half.
    pub(crate) fn held_out_rms_px(&self, sensor: usize) -> Option<f64> {
        let (mut sum, mut corners) = (0.0, 0);
        for (half, frame_sets) in self.frame_sets.iter().enumerate() {
            let other = &self.halves[1 - half].state;
            for frame_set in frame_sets {
                let observations = frame_set.iter().map(|index| &self.fit.observations[*index]);
                let own = |observation: &&BoardObservation| observation.sensor == sensor;
                let Some(observation) = observations.clone().find(own) else { continue };
                sum += squares_nearby(other, self.fit, frame_set)
                    .or_else(|| squares_under(other, self.fit, observations, sensor))?;
                corners += observation.used.iter().filter(|used| **used).count();
            }
        }
        (corners > 0).then(|| (sum / corners as f64).sqrt())
    }

    /// The covariance of all parameters of the lens of `sensor` in one half.
    fn lens_covariance(
        &self,
        half: usize,
        sensor: usize,
        stated: LensWithCovariance<'_>,
    ) -> Option<DMatrix<f64>> {
        let layout = &self.fit.layout.sensors[sensor];
        let (free, at) = (&layout.lens.free, layout.lens_at);
        let of_free =
            DMatrix::from_fn(free.len(), free.len(), |i, j| stated.covariance[(free[i], free[j])]);
        let covariance = self.half_covariance(half, at..at + free.len(), &of_free)?;
        let by_free = layout.lens.all_by_free(stated.lens);
        Some(&by_free * covariance * by_free.transpose())
    }

    /// The covariance of the global parameters `block` in one half: that with independent corners,
    /// widened as the covariance of the whole, `stated`, is relative to its own with independent
    /// corners.
    fn half_covariance(
        &self,
        half: usize,
        block: Range<usize>,
        stated: &DMatrix<f64>,
    ) -> Option<DMatrix<f64>> {
        let (at, size) = (block.start, block.len());
        if size == 0 {
            return None;
        }
        let of = |minimum: &Minimum| -> Option<DMatrix<f64>> {
            Some(minimum.equations.global_covariance()?.view((at, at), (size, size)).into_owned())
        };
        let unit = of(&self.fit.robust.minimum)?;
        // Parameters differ by orders of magnitude: in units of their own deviations.
        let scale: Vec<f64> = unit.diagonal().iter().map(|v| v.sqrt()).collect();
        let scaled = |m: &DMatrix<f64>| {
            DMatrix::from_fn(size, size, |i, j| m[(i, j)] / (scale[i] * scale[j]))
        };
        let from = scaled(&unit).cholesky()?.unpack();
        let widened = scaled(stated).cholesky()?.unpack() * from.try_inverse()?;
        let half = &widened * scaled(&of(&self.halves[half])?) * widened.transpose();
        Some(DMatrix::from_fn(size, size, |i, j| half[(i, j)] * scale[i] * scale[j]))
    }
}

/// The sum of squared pixel errors of a frame set of one sensor, at the best pose of the board,
/// under a lens close to that of the fit: to second order, from the view's equations at the fit.
/// `None` where the lens is not close enough, the corners have different weights, or the rig has
/// other sensors.
fn squares_nearby(under: &State, fit: &CameraFit, frame_set: &[usize]) -> Option<f64> {
    let [view] = *frame_set else { return None };
    let (minimum, observation) = (&fit.robust.minimum, &fit.observations[view]);
    let free = &fit.layout.sensors[0].lens.free;
    let inverse_std = *observation.inverse_std.first()?;
    if fit.layout.len > free.len()
        || observation.inverse_std.iter().any(|other| *other != inverse_std)
    {
        return None;
    }
    let part = std::iter::once((view, 0));
    let alone = assemble(&minimum.equations.local, fit.minimum_point(), &fit.observations, part, 1);
    let ReducedView { information, gradient } = alone.reduced(0)?;
    let (there, here) = (under.lenses[0].parameters(), fit.lens().parameters());
    let moved =
        DVector::from_iterator(free.len(), free.iter().map(|index| there[*index] - here[*index]));
    let raised = 2.0 * gradient.dot(&moved) + moved.dot(&(&information * &moved));
    (raised.abs() < MOST_COST_RISE * alone.cost)
        .then_some((alone.cost + raised) / (inverse_std * inverse_std))
}

#[cfg(test)]
mod tests {
    use nalgebra::Vector3;

    use super::*;

    #[test]
    fn a_difference_of_one_deviation_on_each_axis_has_ratio_one() {
        let first =
            Pose::from_axis_angle(Vector3::new(0.3, -0.2, 0.1), Vector3::new(0.1, 0.0, 2.0));
        let (rotation, translation) =
            (Vector3::new(2e-4, -1e-4, 2e-4), Vector3::new(0.3, 0.0, 0.4));
        let second = Pose::new(
            Pose::from_axis_angle(rotation, Vector3::zeros()).rotation() * first.rotation(),
            first.translation() + translation,
        );
        let std = [2e-4, 1e-4, 2e-4, 0.3, 1.0, 0.4];
        let covariance = DMatrix::from_fn(6, 6, |i, j| if i == j { std[i] * std[i] } else { 0.0 });
        let difference = PoseBetweenHalves::between([&first, &second], &covariance).unwrap();
        // Five of the six components differ by one standard deviation.
        assert!((difference.ratio - (5.0_f64 / 6.0).sqrt()).abs() < 1e-9, "{difference:?}");
        assert!((difference.rotation_rad - 3e-4).abs() < 1e-12, "{difference:?}");
        assert!((difference.translation_m - 0.5).abs() < 1e-12, "{difference:?}");
        assert_eq!(PoseBetweenHalves::between([&first, &second], &DMatrix::zeros(6, 6)), None);
    }
}
