//! The covariance of parameters when the errors of a view's corners are correlated. The covariance
//! of a least-squares estimate assumes independent errors. Where a model error moves a whole view
//! (a lens that the model does not fit, a board that is not as stated), the scatter between views
//! exceeds that of their corners, and so does the scatter of estimates from other views.
//!
//! Each view (for a rig: all observations of one frame set) contributes a step of the parameters, δ
//! = C s, where s is the view's score with its pose eliminated, and C the covariance for unit
//! noise. With independent corners the covariance of δ is C A C, where A is the view's part of the
//! information. Without the view the estimate would move by (1 − C A)⁻¹ δ. The scatter of these
//! steps over the views is the clustered covariance (K.-Y. Liang, S. L. Zeger, *Longitudinal data
//! analysis using generalized linear models*, 1986, in the form CR3 of R. M. Bell and D. F.
//! McCaffrey, 2002: the jackknife over views, to first order). With few views it is itself
//! uncertain. So its weight grows with the significance of the scatter between views, and is zero
//! where chance would explain it.

use std::ops::Range;

use nalgebra::{DMatrix, DVector};

use crate::estimation::camera_fit::CameraFit;
use crate::estimation::joint::normal::ReducedView;
use crate::estimation::joint::per_observation::assemble;
use crate::estimation::robust_fit::ROUNDING;
use crate::estimation::view_influence::{Excess, Influence};

/// Minimum number of views for an estimate of their scatter. The limits below take into account how
/// much scatter so few views have by chance.
const MIN_VIEWS: usize = 3;

/// The largest factor by which a view's step is corrected for its leverage. With a larger one there
/// would be no estimate without the view.
const LARGEST_CORRECTION: f64 = 5.0;

/// A covariance, and its excess over that with independent corners.
#[derive(Debug, Clone)]
pub(crate) struct Clustered {
    pub(crate) covariance: DMatrix<f64>,
    /// The factor on variances (variance inflation), 1 or more.
    pub(crate) factor: f64,
    /// The part of `covariance` that comes from the scatter between views, from 0 to below 1.
    pub(crate) weight: f64,
}

/// The covariance of all global parameters of a fit, with the influence of each of its views.
#[derive(Debug, Clone)]
pub(crate) struct FitCovariance {
    /// For unit noise.
    pub(crate) unit: DMatrix<f64>,
    /// In units of the parameters' standard deviations, `scale`.
    influences: Vec<Influence>,
    scale: DVector<f64>,
    noise_square: f64,
    frame_sets: usize,
}

impl FitCovariance {
    /// `None` where the views do not determine all parameters.
    pub(crate) fn of(fit: &CameraFit) -> Option<Self> {
        let equations = &fit.robust.minimum.equations;
        let unit = equations.global_covariance()?;
        // Parameters differ by orders of magnitude, hence units of their standard deviations.
        let scale = deviations(&unit);
        // A fit with effects has its own covariance (`effects`).
        let influences = if fit.effects.is_some() || fit.is_exact() || unit.is_empty() {
            Vec::new()
        } else {
            influences(fit, &unit, &scale).unwrap_or_default()
        };
        let (noise_square, frame_sets) = (fit.noise_square(), equations.seen_frame_sets());
        Some(Self { unit, influences, scale, noise_square, frame_sets })
    }

    /// From all views, for parameters whose covariance for unit noise is `unit`.
    pub(crate) fn of_views(unit: DMatrix<f64>, noise_square: f64, views: &[ReducedView]) -> Self {
        let scale = deviations(&unit);
        let influences = of_parts(&unit, &scale, views.iter().cloned()).unwrap_or_default();
        Self { unit, influences, scale, noise_square, frame_sets: views.len() }
    }

    /// The covariance of all parameters.
    pub(crate) fn all(&self) -> DMatrix<f64> {
        self.block(0..self.unit.nrows()).covariance
    }

    /// As [`Self::block`], but never below the observed influence of the views, significant or not.
    /// For independent corners it overestimates variances by √(1 / (π · views · parameters)): half
    /// the mean size of chance influences.
    pub(crate) fn block_as_seen(&self, block: Range<usize>) -> Clustered {
        let known = self.block(block.clone());
        if self.influences.len() < MIN_VIEWS {
            return known;
        }
        let size = block.len();
        let unit = self.unit.view((block.start, block.start), (size, size));
        let scale = self.scale.rows(block.start, size);
        let unit = DMatrix::from_fn(size, size, |i, j| unit[(i, j)] / (scale[i] * scale[j]));
        let of_block: Vec<Influence> =
            self.influences.iter().map(|influence| influence.block(&block)).collect();
        let Some(excess) = Excess::of(&unit, self.noise_square, &of_block) else { return known };
        let widened = (1.0 + excess.part).max(known.factor) / known.factor;
        Clustered { covariance: known.covariance * widened, ..known }
    }

    /// The covariance of the parameters in `block`.
    pub(crate) fn block(&self, block: Range<usize>) -> Clustered {
        let size = block.len();
        let all = in_units(&self.unit, &self.scale);
        let unit = all.view((block.start, block.start), (size, size)).into_owned();
        let of_block: Vec<Influence> =
            self.influences.iter().map(|influence| influence.block(&block)).collect();
        let without = || {
            let inverse = all.clone().cholesky()?.inverse();
            let of = |influence: &Influence| {
                influence.without(&inverse).rows(block.start, size).into_owned()
            };
            Some(self.influences.iter().map(of).collect())
        };
        let views = (of_block.as_slice(), self.frame_sets);
        let Clustered { mut covariance, factor, weight } =
            clustered(&unit, self.noise_square, views, without);
        for (i, j) in (0..size).flat_map(|i| (0..size).map(move |j| (i, j))) {
            covariance[(i, j)] *= self.scale[block.start + i] * self.scale[block.start + j];
        }
        Clustered { covariance, factor, weight }
    }
}

fn in_units(m: &DMatrix<f64>, scale: &DVector<f64>) -> DMatrix<f64> {
    DMatrix::from_fn(m.nrows(), m.ncols(), |i, j| m[(i, j)] / (scale[i] * scale[j]))
}

/// The influence of each view of a fit (or of a sample of many) on all its global parameters, whose
/// covariance for unit noise is `unit`, in units of `scale`.
fn influences(
    fit: &CameraFit,
    unit: &DMatrix<f64>,
    scale: &DVector<f64>,
) -> Option<Vec<Influence>> {
    let local = &fit.robust.minimum.equations.local;
    let of_frame_set = |observations: Vec<usize>| {
        let parts = observations.iter().map(|observation| (*observation, 0));
        let alone = assemble(local, fit.minimum_point(), &fit.observations, parts, 1);
        alone.reduced(0)
    };
    of_parts(unit, scale, fit.some_frame_sets().into_iter().filter_map(of_frame_set))
}

/// The standard deviations of parameters with this covariance.
fn deviations(unit: &DMatrix<f64>) -> DVector<f64> {
    unit.diagonal().map(|v| v.max(f64::MIN_POSITIVE).sqrt())
}

/// The influence of `views` on parameters whose covariance for unit noise is `unit`, in units of
/// `scale`.
fn of_parts(
    unit: &DMatrix<f64>,
    scale: &DVector<f64>,
    views: impl Iterator<Item = ReducedView>,
) -> Option<Vec<Influence>> {
    let size = unit.nrows();
    let scaled = in_units(unit, scale);
    let inverse = scaled.clone().cholesky()?.inverse();
    let of_view = |ReducedView { information, gradient }: ReducedView| {
        let information =
            DMatrix::from_fn(size, size, |i, j| information[(i, j)] * scale[i] * scale[j]);
        let step = -(&scaled * gradient.component_mul(scale));
        Influence::of(step, &scaled * information * &scaled, &inverse)
    };
    Some(views.map(of_view).collect())
}

/// The covariance of parameters whose covariance for unit noise is `unit`, from the influences of a
/// sample of the views, and the number of all views. `without` computes the change of the estimate
/// without each of the sample, and is called only where that is needed. All in units of the
/// parameters' standard deviations.
pub(crate) fn clustered(
    unit: &DMatrix<f64>,
    noise_square: f64,
    (influences, views): (&[Influence], usize),
    without: impl FnOnce() -> Option<Vec<DVector<f64>>>,
) -> Clustered {
    let plain = Clustered { covariance: unit * noise_square, factor: 1.0, weight: 0.0 };
    let exact = noise_square < ROUNDING * ROUNDING;
    if exact || influences.len() < MIN_VIEWS || unit.is_empty() {
        return plain;
    }
    combined(unit, noise_square, influences, views, without).unwrap_or(plain)
}

/// `None` where there is no excess scatter between views, or chance would explain it.
fn combined(
    unit: &DMatrix<f64>,
    noise_square: f64,
    influences: &[Influence],
    views: usize,
    without: impl FnOnce() -> Option<Vec<DVector<f64>>>,
) -> Option<Clustered> {
    let excess = Excess::of(unit, noise_square, influences)?;
    let weight = excess.weight()?;
    let factor = 1.0 + excess.part * weight;
    let by_views = jackknife_covariance(influences, &without()?, views);
    let covariance = unit * ((1.0 - weight) * factor * noise_square) + by_views * weight;
    covariance.iter().all(|v| v.is_finite()).then_some(Clustered { covariance, factor, weight })
}

/// The covariance of the estimate from the steps that leave out one view each.
fn jackknife_covariance(
    influences: &[Influence],
    without: &[DVector<f64>],
    views: usize,
) -> DMatrix<f64> {
    let corrected: Vec<DVector<f64>> = influences
        .iter()
        .zip(without)
        .map(|(influence, without)| {
            let growth = without.norm() / influence.step.norm().max(f64::MIN_POSITIVE);
            without * (LARGEST_CORRECTION / growth).min(1.0)
        })
        .collect();
    let (count, size) = (corrected.len() as f64, corrected[0].len());
    let mean = corrected.iter().sum::<DVector<f64>>() / count;
    let mut scatter = DMatrix::zeros(size, size);
    for step in &corrected {
        let off = step - &mean;
        scatter += &off * off.transpose();
    }
    // All views are assumed to have influences like those of the sample.
    scatter * ((count - 1.0) / count * (views as f64 / count))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The mean of numbers in groups, each group with its own offset.
    fn group_means(offset: f64) -> Vec<Influence> {
        let (groups, each) = (12, 20);
        let unit = 1.0 / f64::from(groups * each);
        let noise = |k: i32| (f64::from(k) * 12.9898).sin() * 43758.5453 % 1.0 * 1.73;
        let raw: Vec<f64> = (0..groups)
            .map(|g| {
                let own = offset * f64::from(g - 6) / 3.5;
                (0..each).map(|k| own + noise(g * each + k)).sum::<f64>()
            })
            .collect();
        let mean = raw.iter().sum::<f64>() * unit;
        let influence = |sum: &f64| {
            Influence::of(
                DVector::from_element(1, (sum - f64::from(each) * mean) * unit),
                DMatrix::from_element(1, 1, f64::from(each) * unit * unit),
                &DMatrix::from_element(1, 1, 1.0 / unit),
            )
        };
        raw.iter().map(influence).collect()
    }

    #[test]
    fn groups_that_differ_widen_the_covariance_and_others_do_not() {
        let unit = DMatrix::from_element(1, 1, 1.0 / 240.0);
        let of = |offset: f64| {
            let influences = group_means(offset);
            let inverse = DMatrix::from_element(1, 1, 240.0);
            let without = || Some(influences.iter().map(|one| one.without(&inverse)).collect());
            clustered(&unit, 1.0, (&influences, 12), without).covariance[(0, 0)]
        };
        assert_eq!(of(0.0) * 240.0, 1.0);
        // Offsets of variance 1 leave a mean over twelve groups uncertain by 1/12.
        let together = of(1.0) * 12.0;
        assert!((0.6..1.6).contains(&together), "{together}");
    }

    #[test]
    fn without_a_view_a_mean_moves_by_its_own_part_of_the_rest() {
        for influence in group_means(1.0) {
            let expected = influence.step[0] / (1.0 - 1.0 / 12.0);
            let without = influence.without(&DMatrix::from_element(1, 1, 240.0));
            assert!((without[0] - expected).abs() < 1e-12);
        }
    }
}
