//! The covariance of a lens when the corners of a view err together. The covariance of a
//! least-squares estimate takes every corner's error for its own; where something that is not in the
//! model moves a whole view, estimates from other views differ by more.
//!
//! Each view has an influence on the estimate, δ = C s (its score s, with the covariance C for unit
//! noise); C A C is the covariance that this has if corners err by themselves, A being the view's
//! information. The sum of δ δᵀ, each corrected for its leverage, is the clustered covariance (K.-Y.
//! Liang, S. L. Zeger, *Longitudinal data analysis using generalized linear models*, 1986, in the
//! form CR3 of R. M. Bell and D. F. McCaffrey, 2002: the jackknife over views, to first order). With
//! few views it is itself uncertain, so it counts the more the better the influences show that
//! views differ at all.

use nalgebra::{DMatrix, DVector};

/// Fewer views tell nothing of how they differ.
const MIN_VIEWS: usize = 5;

/// Where influences exceed what corners by themselves explain by this many standard deviations, the
/// clustered covariance and the model's count the same.
const EVEN_ODDS: f64 = 2.0;

/// A view's influence is corrected for its leverage by this factor at most: beyond, without the view
/// there would be no estimate.
const LARGEST_CORRECTION: f64 = 5.0;

/// What one view does to the lens.
#[derive(Debug, Clone)]
pub(crate) struct Influence {
    /// The step of the parameters that the view asks for.
    pub(crate) step: DVector<f64>,
    /// The covariance of that step for unit noise, if corners err by themselves.
    pub(crate) expected: DMatrix<f64>,
}

/// A covariance, and how much larger its influences are than those of corners by themselves.
#[derive(Debug, Clone)]
pub(crate) struct Clustered {
    pub(crate) covariance: DMatrix<f64>,
    /// The factor on variances, 1 or more.
    pub(crate) factor: f64,
}

/// The covariance of parameters whose covariance for unit noise is `unit`; `views` is the number of
/// views, of which `influences` may be a part.
pub(crate) fn clustered(
    unit: &DMatrix<f64>,
    noise_square: f64,
    influences: &[Influence],
    views: usize,
) -> Clustered {
    let plain = Clustered { covariance: unit * noise_square, factor: 1.0 };
    if influences.len() < MIN_VIEWS || unit.is_empty() {
        return plain;
    }
    combined(unit, noise_square, influences, views).unwrap_or(plain)
}

fn combined(
    unit: &DMatrix<f64>,
    noise_square: f64,
    influences: &[Influence],
    views: usize,
) -> Option<Clustered> {
    let size = unit.nrows();
    // Parameters differ by orders of magnitude: in units of their own deviations.
    let scale = unit.diagonal().map(|v| 1.0 / v.max(f64::MIN_POSITIVE).sqrt());
    let scaled =
        |m: &DMatrix<f64>| DMatrix::from_fn(size, size, |i, j| m[(i, j)] * scale[i] * scale[j]);
    let inverse = scaled(unit).cholesky()?.inverse();
    let identity = DMatrix::<f64>::identity(size, size);
    let (mut seen, mut expected, mut variance) = (0.0, 0.0, 0.0);
    let mut corrected: Vec<DVector<f64>> = Vec::with_capacity(influences.len());
    for influence in influences {
        let step = influence.step.component_mul(&scale);
        let leverage = scaled(&influence.expected) * &inverse;
        let square = leverage.dot(&leverage.transpose());
        seen += step.dot(&(&inverse * &step));
        expected += leverage.trace() - square;
        variance += 2.0 * square;
        let alone = (&identity - &leverage).lu().solve(&step).unwrap_or_else(|| step.clone());
        let growth = alone.norm() / step.norm().max(f64::MIN_POSITIVE);
        corrected.push(alone * (LARGEST_CORRECTION / growth).min(1.0));
    }
    let factor = seen / (noise_square * expected);
    if !(factor > 1.0) {
        return None;
    }
    let excess = factor - 1.0;
    let weight = excess / (excess + EVEN_ODDS * variance.sqrt() / expected);
    let count = corrected.len() as f64;
    let mean = corrected.iter().sum::<DVector<f64>>() / count;
    let mut spread = DMatrix::zeros(size, size);
    for step in &corrected {
        let off = step - &mean;
        spread += &off * off.transpose();
    }
    // Each of all the views moves the estimate as those that were looked at do.
    spread *= (count - 1.0) / count * (views as f64 / count);
    let inflation = 1.0 + (factor - 1.0) * weight;
    let covariance = DMatrix::from_fn(size, size, |i, j| {
        let by_views = spread[(i, j)] / (scale[i] * scale[j]);
        (1.0 - weight) * inflation * noise_square * unit[(i, j)] + weight * by_views
    });
    covariance.iter().all(|v| v.is_finite()).then_some(Clustered { covariance, factor: inflation })
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A mean of numbers that come in groups, each group with an offset of its own.
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
        let influence = |sum: &f64| Influence {
            step: DVector::from_element(1, (sum - f64::from(each) * mean) * unit),
            expected: DMatrix::from_element(1, 1, f64::from(each) * unit * unit),
        };
        raw.iter().map(influence).collect()
    }

    #[test]
    fn groups_that_differ_widen_the_covariance_and_others_do_not() {
        let unit = DMatrix::from_element(1, 1, 1.0 / 240.0);
        let of = |offset: f64| clustered(&unit, 1.0, &group_means(offset), 12).covariance[(0, 0)];
        let alone = of(0.0) * 240.0;
        assert!((0.6..1.6).contains(&alone), "{alone}");
        // Offsets of variance 1 leave a mean over twelve groups uncertain by 1/12.
        let together = of(1.0) * 12.0;
        assert!((0.6..1.6).contains(&together), "{together}");
    }
}
