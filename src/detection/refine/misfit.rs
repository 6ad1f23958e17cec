//! Corners at which the model fits worse than at the board's others: beside an occluder, or in its
//! shadow.
//!
//! Noise is common to the board: if a corner's residuals are a little above or below the others',
//! that is chance, or the shape of the blur, which does not bias a corner. An occluder's residuals
//! are one-sided and bias the corner: the error grows with the excess.

use crate::geometry::median::median_of;

/// Minimum corners for a robust reference. Chosen, not swept.
const FEWEST_CORNERS: usize = 8;
/// By chance, mean squares exceed the median by up to this many of their standard deviations,
/// √(2/samples): three of a normal distribution, one in 740.
const CHANCE_STDS: f64 = 3.0;
/// Lower bound of a corner's mean square, in medians: a corner may have no noise at all. Chosen,
/// not swept.
const LEAST_MEDIANS: f64 = 0.1;
/// Coefficients of the excess and of its square, in medians, in the factor on the standard
/// deviation. Chosen so that corners beside occluders have the errors that are stated, not swept.
const EXCESS_COEFFICIENTS: [f64; 2] = [1.2, 0.7];
/// A corner with this many times the median mean square is excluded from the board's fields.
/// Chosen, not swept.
const EXCLUDED_MEDIANS: f64 = 2.5;
/// Rejected: more than this many times the median mean square, and an inlier ratio below this part
/// of the median. Chosen, not swept.
const REJECTED_MEDIANS: f64 = 3.0;
const REJECTED_INLIER_PART: f64 = 0.66;

/// How well a corner's model fits its samples.
#[derive(Debug, Clone, Copy)]
pub(super) struct Quality {
    /// Mean square of the residuals in units of the noise.
    pub mean_square: f64,
    /// Inlier ratio: the share of samples that agree with the model.
    pub inlier_ratio: f64,
    /// Their number.
    pub samples: f64,
    /// Whether it was fitted with light of its own: then it is no reference for the others.
    pub local_light: bool,
}

/// The medians over a board.
#[derive(Clone, Copy)]
struct BoardMedians {
    mean_square: f64,
    inlier_ratio: f64,
}

/// The qualities of a board's corners.
#[derive(Debug, Default)]
pub(super) struct CornerMisfit {
    of_corners: Vec<Option<Quality>>,
    sorted: Vec<f64>,
}

impl CornerMisfit {
    /// Forgets all corners.
    pub fn clear(&mut self) {
        self.of_corners.clear();
    }

    /// Whether the corner of this number was fitted with light of its own.
    pub fn has_own_light(&self, corner: usize) -> bool {
        self.of_corners.get(corner).copied().flatten().is_some_and(|quality| quality.local_light)
    }

    /// Takes the next corner's quality.
    pub fn take(&mut self, quality: Option<Quality>) {
        self.of_corners.push(quality);
    }

    /// For each corner whether it fits well enough to contribute to the board's fields.
    pub fn fits(&mut self) -> impl Iterator<Item = bool> + '_ {
        let most =
            self.medians().map_or(f64::INFINITY, |medians| EXCLUDED_MEDIANS * medians.mean_square);
        self.of_corners
            .iter()
            .map(move |quality| quality.is_some_and(|quality| quality.mean_square < most))
    }

    /// For each corner whether it leaves more than this many times the median mean square.
    pub fn worse_than(&mut self, times: f64) -> impl Iterator<Item = bool> + '_ {
        let most = self.medians().map_or(f64::INFINITY, |medians| times * medians.mean_square);
        self.of_corners
            .iter()
            .map(move |quality| quality.is_some_and(|quality| quality.mean_square > most))
    }

    /// For each corner whether its mean square is more than this many times the first quartile: a
    /// highlight may cover half of a board.
    pub fn worse_than_closest(&mut self, times: f64) -> impl Iterator<Item = bool> + '_ {
        let Self { of_corners, sorted } = self;
        sorted.clear();
        sorted.extend(of_corners.iter().flatten().map(|quality| quality.mean_square));
        sorted.sort_unstable_by(f64::total_cmp);
        let enough = sorted.len() >= FEWEST_CORNERS;
        let most = if enough { times * sorted[sorted.len() / 4] } else { f64::INFINITY };
        of_corners
            .iter()
            .map(move |quality| quality.is_some_and(|quality| quality.mean_square > most))
    }

    /// For each corner the factor on the standard deviation predicted by its own residuals; `None`
    /// if it is rejected as an outlier.
    pub fn std_factors(&mut self) -> impl Iterator<Item = Option<f64>> + '_ {
        let medians = self.medians();
        self.of_corners.iter().map(move |quality| {
            let (quality, Some(medians)) = ((*quality)?, medians) else { return Some(1.0) };
            let times = (quality.mean_square / medians.mean_square).max(LEAST_MEDIANS);
            let excess = (times - 1.0 - CHANCE_STDS * (2.0 / quality.samples).sqrt()).max(0.0);
            // With light of its own a corner may well fit better than the others.
            if quality.local_light && excess == 0.0 {
                return Some(1.0);
            }
            let no_corner = times > REJECTED_MEDIANS
                && quality.inlier_ratio < REJECTED_INLIER_PART * medians.inlier_ratio;
            let [linear, square] = EXCESS_COEFFICIENTS;
            (!no_corner).then_some((1.0 + excess * (linear + square * excess)) / times.sqrt())
        })
    }

    /// The medians.
    fn medians(&mut self) -> Option<BoardMedians> {
        let Self { of_corners, sorted } = self;
        let mut median = |of: fn(&Quality) -> f64| {
            sorted.clear();
            sorted.extend(of_corners.iter().flatten().filter(|it| !it.local_light).map(of));
            median_of(sorted).filter(|_| sorted.len() >= FEWEST_CORNERS)
        };
        let (mean_square, inlier_ratio) = (median(|q| q.mean_square)?, median(|q| q.inlier_ratio)?);
        (mean_square > 0.0).then_some(BoardMedians { mean_square, inlier_ratio })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn factors(qualities: &[Option<(f64, f64)>]) -> Vec<Option<f64>> {
        let mut misfit = CornerMisfit::default();
        for quality in qualities {
            misfit.take(quality.map(|(mean_square, inlier_ratio)| Quality {
                mean_square,
                inlier_ratio,
                samples: 450.0,
                local_light: false,
            }));
        }
        misfit.std_factors().collect()
    }

    #[test]
    fn what_fits_worse_than_the_others_is_less_certain_and_at_last_no_corner() {
        let mut seen = vec![Some((1.1, 0.97)); 12];
        seen.extend([Some((3.3, 0.8)), None, Some((9.0, 0.5)), Some((9.0, 0.8))]);
        let factors = factors(&seen);
        assert!(
            factors[..12]
                .iter()
                .all(|factor| factor.is_some_and(|factor| (factor - 1.0).abs() < 1e-12))
        );
        // Three times the mean square predicts √3 times the deviation by itself.
        assert!(factors[12].is_some_and(|factor| (5.0..6.0).contains(&(factor * 3_f64.sqrt()))));
        assert_eq!((factors[13], factors[14]), (None, None));
        assert!(factors[15].is_some_and(|factor| factor > 4.0));
    }

    #[test]
    fn a_little_more_or_less_than_the_others_changes_nothing() {
        let mut seen = vec![Some((1.0, 0.97)); 11];
        seen.extend([Some((0.81, 0.97)), Some((1.18, 0.97))]);
        let factors = factors(&seen);
        for (factor, (mean_square, _)) in factors.iter().flatten().zip(seen.iter().flatten()) {
            assert!((factor * f64::sqrt(*mean_square) - 1.0).abs() < 1e-12);
        }
    }

    #[test]
    fn what_fits_much_worse_contributes_nothing() {
        let mut misfit = CornerMisfit::default();
        for mean_square in [1.0, 1.1, 0.9, 1.0, 1.2, 1.0, 2.0, 1.0, 5.0] {
            misfit.take(Some(Quality {
                mean_square,
                inlier_ratio: 0.9,
                samples: 100.0,
                local_light: false,
            }));
        }
        misfit.take(None);
        let fits: Vec<bool> = misfit.fits().collect();
        assert_eq!(fits, [true, true, true, true, true, true, true, true, false, false]);
    }

    #[test]
    fn half_a_board_may_fit_worse_than_the_closest_quarter() {
        let mut misfit = CornerMisfit::default();
        for mean_square in [1.0, 1.1, 0.9, 1.0, 3.0, 3.1, 2.9, 5.0] {
            misfit.take(Some(Quality {
                mean_square,
                inlier_ratio: 0.9,
                samples: 100.0,
                local_light: false,
            }));
        }
        misfit.take(None);
        let worse: Vec<bool> = misfit.worse_than_closest(1.6).collect();
        assert_eq!(worse, [false, false, false, false, true, true, true, true, false]);
        assert!(misfit.worse_than(1.6).filter(|worse| *worse).count() < 4);
    }

    #[test]
    fn few_corners_have_nothing_to_compare_with() {
        assert_eq!(factors(&[Some((1.0, 0.9)), Some((50.0, 0.1))]), [Some(1.0), Some(1.0)]);
    }
}
