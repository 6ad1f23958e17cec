//! Views whose motion during the readout is incompatible with that of the others. Such a view must
//! be tested for, because the motion that the model allows also explains a part of the residuals of
//! a mirrored image, or of another camera's.

use std::rc::Rc;

use nalgebra::{DMatrix, DVector};

use crate::estimation::effects::capped_squares::CappedSquares;
use crate::estimation::effects::search::EffectSearch;
use crate::estimation::effects::state::Scene;
use crate::estimation::student::normal_deviations_of_ratio;
use crate::estimation::view_fault::ViewFault;

/// Added to P − V, as a part of P. For a component that the data do not determine P and V are
/// equal, and their difference is rounding. Not swept.
const ROUNDING_PART: f64 = 1e-6;

/// A motion is odd, and residuals are larger than noise, from this many standard deviations on. If
/// all boards move alike, one view in four thousand exceeds it by chance. Chosen, not swept.
const ODD_STDS: f64 = 3.5;

/// Below this many standard deviations, at the minimum of all views, a view fits as the others do.
/// One view in forty of those that do exceeds it by chance. Chosen, not swept.
const FITTING_STDS: f64 = 2.0;

/// Parameters that are fitted to one view: six of its pose, six of its motion.
const VIEW_PARAMETERS: f64 = 12.0;

/// The motion of a view, compared with that of the other views.
pub(super) struct ComparedMotion {
    /// Its size, relative to that of the other views.
    pub(super) times: f64,
    /// Whether it is significantly larger than theirs.
    pub(super) is_odd: bool,
    /// Whether the corners of the view fit with it: those of a board that merely moved fast do.
    pub(super) fits: bool,
}

impl ComparedMotion {
    /// The fault of the view: a motion that is odd, with which its corners do not fit either.
    /// `fits_in_all`: they fit in the fit of all views ([`EffectSearch::fits_as_others`]).
    pub(super) fn fault(&self, fits_in_all: bool) -> Option<ViewFault> {
        let incompatible = self.is_odd && !self.fits && !fits_in_all;
        incompatible.then_some(ViewFault::OddMotion { times: self.times })
    }
}

impl EffectSearch {
    /// Whether the corners of `view` fit as those of the other views do, at this minimum of all of
    /// them. With the variance that the others alone have, as in [`Self::compared_motion`], its
    /// motion would be held closer to theirs, and explain less of its residuals.
    pub(super) fn fits_as_others(&self, good: &[usize], view: usize, noise_square: f64) -> bool {
        let residuals = |view: usize| self.system.residuals[view].as_slice();
        let others = good.iter().filter(|other| **other != view).map(|other| residuals(*other));
        let of_others = CappedSquares::of(others, noise_square);
        let misfit = CappedSquares::of([residuals(view)], noise_square);
        misfit.excess_over(&of_others, VIEW_PARAMETERS) < FITTING_STDS
    }

    /// The motion of `view` in `scene`. `None` where the other views do not move.
    /// `self` is the converged search of all other views; with the view among them, its motion
    /// would raise the variance that it is tested against.
    ///
    /// Under a prior of variance P, the posterior mean m of a motion has variance P − V, where V is
    /// the posterior variance. So mᵀ (P − V)⁻¹ m is χ² with as many degrees of freedom as the
    /// motion has components, and Fisher's F where P itself is estimated.
    pub(super) fn compared_motion(self, scene: Scene<'_>, view: usize) -> Option<ComparedMotion> {
        if !self.moves() {
            return None;
        }
        let mut search = self;
        let others: Vec<usize> =
            scene.good.iter().copied().filter(|other| *other != view).collect();
        let others = Scene { good: &others, ..scene };
        let basis = Rc::clone(&search.basis);
        let narrow = search.restricted(others, &basis);
        let posterior = search.posterior(narrow)?;
        let noise_square = posterior.noise_square;
        let of = (narrow.basis, narrow.layout.len);
        let updated = posterior.updated(&search.system, &search.state, of, &search.variances);
        let effects = search.variances.effects();
        let motions = effects.iter().filter(|effect| effect.is_motion());
        let determined: f64 = search
            .variances
            .0
            .iter()
            .zip(&updated.determined)
            .filter(|(one, _)| one.effect.is_motion())
            .map(|(_, determined)| determined)
            .sum();
        let rows: Vec<usize> = motions.flat_map(|effect| effect.range(&basis)).collect();
        search = search.relinearized(scene)?;
        search.converge_state(scene, noise_square)?;
        let posterior = search.posterior(search.restricted(scene, &basis))?;
        let place = search.system.views.iter().position(|part| part.observation == view)?;
        let covariance = posterior.motion_covariances.get(place)?;
        let lambda = search.variances.of_motion(&search.system);
        // In units of the prior's standard deviations.
        let scale = DVector::from_iterator(rows.len(), rows.iter().map(|k| lambda[*k].sqrt()));
        let motion = DVector::from_iterator(
            rows.len(),
            rows.iter().map(|k| search.state.motions[view][*k] + posterior.motions[place][*k]),
        )
        .component_mul(&scale);
        let spread = DMatrix::from_fn(rows.len(), rows.len(), |i, j| {
            let kept = covariance[(rows[i], rows[j])] * scale[i] * scale[j];
            if i == j { 1.0 + ROUNDING_PART - kept } else { -kept }
        });
        let square = motion.dot(&spread.cholesky()?.solve(&motion)) / noise_square;
        let ratio = square / rows.len() as f64;
        let deviations = normal_deviations_of_ratio(ratio, [rows.len() as f64, determined]);
        let residuals = |view: usize| search.system.residuals[view].as_slice();
        let of_others = others.good.iter().map(|other| residuals(*other));
        let of_others = CappedSquares::of(of_others, noise_square);
        let misfit = CappedSquares::of([residuals(view)], noise_square);
        let misfit = misfit.excess_over(&of_others, VIEW_PARAMETERS);
        Some(ComparedMotion {
            times: ratio.sqrt(),
            is_odd: deviations >= ODD_STDS,
            fits: misfit < ODD_STDS,
        })
    }
}
