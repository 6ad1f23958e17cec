//! Which effects the views of one camera show. Corners and views are selected again under the model
//! with effects.

use nalgebra::DVector;

use crate::estimation::camera_fit::CameraFit;
use crate::estimation::effects::board_basis::BoardBasis;
use crate::estimation::effects::capped_squares::CappedSquares;
use crate::estimation::effects::effect::CandidateEffects;
use crate::estimation::effects::effects_fit::EffectsFit;
use crate::estimation::effects::rolling_shutter_test::RollingShutterTest;
use crate::estimation::effects::score_tests::plausible;
use crate::estimation::effects::search::EffectSearch;
use crate::estimation::effects::state::Scene;
use crate::estimation::joint::{BoardObservation, State};
use crate::estimation::robust_fit::{LIMIT, ROUNDING, scale_of, select};
use crate::estimation::view_fault::ViewFault;
use crate::geometry::lens::Lens;

/// The corners after the last selection.
pub(crate) struct Corners {
    pub(crate) observations: Vec<BoardObservation>,
    pub(crate) faults: Vec<Option<ViewFault>>,
    /// The largest residual of an inlier, in units of each corner's own standard deviation.
    pub(crate) limit: f64,
}

impl Corners {
    /// The views without a fault.
    fn good_views(&self) -> Vec<usize> {
        (0..self.faults.len()).filter(|view| self.faults[*view].is_none()).collect()
    }
}

/// What the views determine beyond lens and poses.
pub(crate) struct Effects {
    /// `None` where they show no effect.
    pub(crate) found: Option<(EffectsFit, Corners)>,
    /// As [`CameraFit::shutter_step`].
    pub(crate) shutter_step: Option<DVector<f64>>,
}

/// Fewer views than this determine nothing beyond lens and poses.
const MIN_VIEWS: usize = 3;

/// At most one view in this many may be rejected as an exception. Chosen, not swept.
const FEW_PART: usize = 4;

/// Rounds of selecting corners.
const MAX_ROUNDS: usize = 4;

/// Estimates effects, starting from a plain fit of one camera, or from the effects that were
/// `found` with another lens or other poses. `None` where the residuals hint at none, or the views
/// do not determine them.
pub(crate) fn fit_effects(
    plain: &CameraFit,
    found: Option<&EffectsFit>,
    size: [f64; 2],
    candidates: CandidateEffects,
) -> Option<Effects> {
    let [width, rows] = size;
    let candidates = plausible(plain, size, candidates)?;
    let basis = BoardBasis::of(&plain.observations, true)?;
    let good = plain.good_views();
    if good.len() < MIN_VIEWS {
        return None;
    }
    let whole = Scene {
        layout: &plain.layout,
        basis: &basis,
        observations: &plain.observations,
        good: &[],
        rows,
        by_columns: None,
        moves: true,
    };
    // Views that alone saw a part of the board may be absent here: the bases then differ.
    let found = found.filter(|found| found.basis.points == basis.points);
    let start = SearchStart { state: &plain.robust.minimum.state, found };
    let comparison = start.shutter_comparison(Scene { good: &good, ..whole }, candidates, width)?;
    let mut chosen = Corners {
        observations: plain.observations.clone(),
        faults: plain.faults.clone(),
        limit: plain.robust.limit,
    };
    let scene = Scene { good: &good, ..whole };
    let ShutterComparison { search, without, shutter_step } =
        start.without_outlier_views(comparison, &mut chosen, (scene, candidates, width))?;
    if search.variances.0.is_empty() {
        return Some(Effects { found: None, shutter_step });
    }
    // Where the shutter has only a part of the weight, readmitted views that motion explains would
    // be outliers of the model without it.
    let CornerSelection { search, corners, good } =
        CornerSelection::alternate(search, chosen, whole, candidates, without.is_none())?;
    let scene = Scene { observations: &corners.observations, good: &good, ..whole };
    let found = search.finished(scene)?;
    let Some(GlobalShutterFit { global_shutter, shutter_test }) = without else {
        return Some(Effects { found: Some((found, corners)), shutter_step });
    };
    let global_shutter = global_shutter.reconverged(scene)?.finished(scene)?;
    let difference = lens_difference(found.lens(), global_shutter.lens());
    let shutter_step = Some(difference * shutter_test.error());
    let found = found.averaged_with(&global_shutter, &basis, shutter_test.agreement)?;
    Some(Effects { found: Some((found, corners)), shutter_step })
}

/// The same effects that were `found` with another lens, estimated with the lens of a plain fit to
/// the same corners. No effect is added or dropped, and a rolling shutter keeps its weight.
pub(crate) fn fit_same_effects(
    plain: &CameraFit,
    found: &EffectsFit,
    rows: f64,
) -> Option<EffectsFit> {
    let basis = BoardBasis::of(&plain.observations, true)?;
    let good = plain.good_views();
    let scene = Scene {
        layout: &plain.layout,
        basis: &basis,
        observations: &plain.observations,
        good: &good,
        rows,
        by_columns: None,
        moves: true,
    };
    let from = || (plain.robust.minimum.state.clone(), found);
    let with = EffectSearch::same_as(scene, from(), true)?.finished(scene)?;
    if found.shutter_agreement >= 1.0 {
        return Some(with);
    }
    let global_shutter = EffectSearch::same_as(scene, from(), false)?.finished(scene)?;
    with.averaged_with(&global_shutter, &basis, found.shutter_agreement)
}

/// The difference between the parameters of two lenses, `lens` minus `other`.
fn lens_difference(lens: &Lens, other: &Lens) -> DVector<f64> {
    let [lens, other] = [lens, other].map(Lens::parameters);
    DVector::from_vec(lens) - DVector::from_vec(other)
}

/// Where a search begins.
#[derive(Clone, Copy)]
struct SearchStart<'a> {
    /// The plain fit's.
    state: &'a State,
    /// Effects that were found with another lens or other poses.
    found: Option<&'a EffectsFit>,
}

impl SearchStart<'_> {
    fn converged(&self, scene: Scene<'_>, candidates: CandidateEffects) -> Option<EffectSearch> {
        let state = self.state.clone();
        let search = match self.found {
            Some(found) => EffectSearch::from_found(scene, state, found, candidates),
            None => EffectSearch::start(scene, state, candidates),
        };
        search?.converged(scene, candidates)
    }

    /// A converged search; one without effects where none is significant.
    fn converged_or_without_effects(
        &self,
        scene: Scene<'_>,
        candidates: CandidateEffects,
    ) -> Option<EffectSearch> {
        let without_effects = || EffectSearch::without_effects(scene, self.state.clone());
        self.converged(scene, candidates).or_else(without_effects)
    }

    /// A converged search. Its motion is compared with none, unless motion is in the model for
    /// certain.
    fn shutter_comparison(
        &self,
        scene: Scene<'_>,
        candidates: CandidateEffects,
        width: f64,
    ) -> Option<ShutterComparison> {
        let search = self.converged(scene, candidates)?;
        if !search.moves() || candidates.is_motion_required {
            return Some(ShutterComparison { search, without: None, shutter_step: None });
        }
        let global_shutter = || {
            self.converged_or_without_effects(
                scene,
                CandidateEffects { motion: false, ..candidates },
            )
        };
        ShutterComparison::of(search, global_shutter, scene, width)
    }

    /// `comparison`, without views that are exceptions: motion also explains part of the residuals
    /// of another board or camera. Their faults are recorded in `chosen`.
    fn without_outlier_views(
        &self,
        comparison: ShutterComparison,
        chosen: &mut Corners,
        (scene, candidates, width): (Scene<'_>, CandidateEffects, f64),
    ) -> Option<ShutterComparison> {
        if !comparison.search.moves() || candidates.is_motion_required {
            return Some(comparison);
        }
        let Some(residuals) = self.global_shutter_residuals(&comparison, (scene, candidates))
        else {
            return Some(comparison);
        };
        match self.without_outliers(&residuals, chosen, (scene, candidates, width)) {
            Some(rest) => Some(rest),
            None => {
                self.without_incompatible(comparison, residuals, chosen, (scene, candidates, width))
            }
        }
    }

    /// Every corner's residuals in a fit without motion.
    fn global_shutter_residuals(
        &self,
        comparison: &ShutterComparison,
        (scene, candidates): (Scene<'_>, CandidateEffects),
    ) -> Option<Vec<Vec<[f64; 2]>>> {
        if let Some(without) = &comparison.without {
            return Some(without.global_shutter.system.residuals.clone());
        }
        let global_shutter = self.converged_or_without_effects(
            scene,
            CandidateEffects { motion: false, ..candidates },
        )?;
        Some(global_shutter.system.residuals)
    }

    /// A search without the views that are outliers of the fit without motion, whose `residuals`
    /// are given. `None` unless there are some but few of these, and the other views show effects
    /// but no motion.
    fn without_outliers(
        &self,
        residuals: &[Vec<[f64; 2]>],
        chosen: &mut Corners,
        (scene, candidates, width): (Scene<'_>, CandidateEffects, f64),
    ) -> Option<ShutterComparison> {
        let (mut observations, mut faults) = (chosen.observations.clone(), chosen.faults.clone());
        let limit = LIMIT * scale_of(&observations, residuals).max(ROUNDING);
        select(&mut observations, residuals, limit, &mut faults);
        let good: Vec<usize> =
            scene.good.iter().copied().filter(|view| faults[*view].is_none()).collect();
        let few = scene.good.len() - good.len();
        if few == 0 || few > scene.good.len() / FEW_PART || good.len() < MIN_VIEWS {
            return None;
        }
        // Where the other views show no effect at all, there is no fit with effects to continue
        // from.
        let rest = self.shutter_comparison(Scene { good: &good, ..scene }, candidates, width)?;
        if rest.search.moves() || rest.search.variances.0.is_empty() {
            return None;
        }
        for view in scene.good.iter().filter(|view| faults[**view].is_some()) {
            chosen.observations[*view].used.fill(false);
        }
        chosen.faults = faults;
        Some(rest)
    }

    /// `comparison`, without views that are incompatible with what the others show. They are tested
    /// one at a time: each time the one with the largest `residuals` in the fit without motion.
    fn without_incompatible(
        &self,
        mut comparison: ShutterComparison,
        mut residuals: Vec<Vec<[f64; 2]>>,
        chosen: &mut Corners,
        (scene, candidates, width): (Scene<'_>, CandidateEffects, f64),
    ) -> Option<ShutterComparison> {
        let mut good = scene.good.to_vec();
        // Effects that were found with an incompatible view are biased by it, so each search starts
        // from scratch.
        let fresh = SearchStart { found: None, ..*self };
        for _ in 0..scene.good.len() / FEW_PART {
            let scene = Scene { good: &good, ..scene };
            let scale = scale_of(&chosen.observations, &residuals).max(ROUNDING);
            let squares =
                |view: &usize| CappedSquares::of([residuals[*view].as_slice()], scale * scale);
            let worst = |a: &usize, b: &usize| squares(a).mean().total_cmp(&squares(b).mean());
            let Some(view) = good.iter().copied().max_by(worst) else { break };
            let others: Vec<usize> = good.iter().copied().filter(|other| *other != view).collect();
            let noise_square = comparison.search.noise_square(scene)?;
            let fits = comparison.search.fits_as_others(&good, view, noise_square);
            if fits && !squares(&view).exceed_each(others.iter().map(squares)) {
                break;
            }
            let without = Scene { good: &others, ..scene };
            let rest = fresh.converged_or_without_effects(without, candidates);
            let Some(motion) = rest.and_then(|rest| rest.compared_motion(scene, view)) else {
                break;
            };
            if !motion.is_odd && motion.fits {
                break;
            }
            // Where the other views show no effect at all, there is no fit with effects to continue
            // from.
            let Some(next) = fresh.shutter_comparison(without, candidates, width) else { break };
            let Some(fault) = next.left_out_fault(scene, view).or_else(|| motion.fault(fits))
            else {
                break;
            };
            let at_rest = fresh.global_shutter_residuals(&next, (without, candidates));
            if next.search.variances.0.is_empty() {
                break;
            }
            comparison = next;
            chosen.observations[view].used.fill(false);
            chosen.faults[view] = Some(fault);
            let Some(at_rest) = at_rest.filter(|_| comparison.search.moves()) else { break };
            residuals = at_rest;
            good = others;
        }
        Some(comparison)
    }
}

/// A search, and the inlier corners and views under its effects.
struct CornerSelection {
    search: EffectSearch,
    corners: Corners,
    good: Vec<usize>,
}

impl CornerSelection {
    /// Alternates between selecting corners by the residuals of `search` and continuing the search,
    /// until the selection no longer changes. `None` where too few views are good. With `readmits`,
    /// views that had been rejected before return in the first round if the effects explain them.
    /// `whole` is the scene of the plain fit, without views.
    fn alternate(
        mut search: EffectSearch,
        mut corners: Corners,
        whole: Scene<'_>,
        candidates: CandidateEffects,
        readmits: bool,
    ) -> Option<Self> {
        let mut good = corners.good_views();
        for round in 0..MAX_ROUNDS {
            if round > 0 {
                let scene = Scene { observations: &corners.observations, good: &good, ..whole };
                search = search.relinearized(scene)?.converged(scene, candidates)?;
            }
            let residuals = std::mem::take(&mut search.system.residuals);
            corners.limit = LIMIT * scale_of(&corners.observations, &residuals).max(ROUNDING);
            let readmitted = round == 0 && readmits && search.readmit(whole, &mut corners);
            let Corners { observations, faults, limit } = &mut corners;
            if !select(observations, &residuals, *limit, faults) && !readmitted {
                break;
            }
            good = corners.good_views();
            if good.len() < MIN_VIEWS {
                return None;
            }
        }
        Some(Self { search, corners, good })
    }
}

/// The result without a rolling shutter, for views that do not agree on one.
struct GlobalShutterFit {
    global_shutter: EffectSearch,
    shutter_test: RollingShutterTest,
}

/// A search whose motion was compared with none.
struct ShutterComparison {
    search: EffectSearch,
    /// The result to average it with.
    without: Option<GlobalShutterFit>,
    shutter_step: Option<DVector<f64>>,
}

impl ShutterComparison {
    /// The fault of `view`, which is not among those of this comparison. `None` unless these leave
    /// a global shutter possible, and the view does not fit with one.
    fn left_out_fault(&self, scene: Scene<'_>, view: usize) -> Option<ViewFault> {
        let global_shutter = &self.without.as_ref()?.global_shutter;
        if !global_shutter.variances.0.is_empty() {
            return global_shutter.left_out_fault(scene, view);
        }
        // Without effects, the search is still at the minimum of all views.
        let others: Vec<usize> =
            scene.good.iter().copied().filter(|other| *other != view).collect();
        let without = Scene { good: &others, ..scene };
        EffectSearch::without_effects(without, global_shutter.state.fixed.clone())?
            .reconverged(without)?
            .left_out_fault(scene, view)
    }

    /// `search`, or the `global_shutter` one where none of its motion is beyond chance.
    fn of(
        search: EffectSearch,
        global_shutter: impl FnOnce() -> Option<EffectSearch>,
        scene: Scene<'_>,
        width: f64,
    ) -> Option<Self> {
        let shutter_test = search.test_rolling_shutter(scene, width)?;
        if shutter_test.is_shown {
            return Some(Self { search, without: None, shutter_step: None });
        }
        let global_shutter = global_shutter()?;
        if shutter_test.agreement > 0.0 {
            let without = Some(GlobalShutterFit { global_shutter, shutter_test });
            return Some(Self { search, without, shutter_step: None });
        }
        let shutter_step =
            Some(lens_difference(search.lens(), global_shutter.lens()) * shutter_test.error());
        Some(Self { search: global_shutter, without: None, shutter_step })
    }
}
