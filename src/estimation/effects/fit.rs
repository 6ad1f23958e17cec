//! Which effects the views of one camera show. Corners and views are selected again under the model
//! with effects.

use nalgebra::DVector;

use crate::estimation::camera_fit::CameraFit;
use crate::estimation::effects::board_basis::BoardBasis;
use crate::estimation::effects::effect::Wanted;
use crate::estimation::effects::effects_fit::EffectsFit;
use crate::estimation::effects::hints::plausible;
use crate::estimation::effects::read_by_rows::ReadByRows;
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
    /// As [`CameraFit::shutter_doubt`].
    pub(crate) shutter_doubt: Option<DVector<f64>>,
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
    wanted: Wanted,
) -> Option<Effects> {
    let [width, rows] = size;
    let wanted = plausible(plain, size, wanted)?;
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
    let start = WalkStart { state: &plain.robust.minimum.state, found };
    let weighed = start.weighed(Scene { good: &good, ..whole }, wanted, width)?;
    let mut chosen = Corners {
        observations: plain.observations.clone(),
        faults: plain.faults.clone(),
        limit: plain.robust.limit,
    };
    let scene = Scene { good: &good, ..whole };
    let Weighed { walk, without, shutter_doubt } =
        start.without_exceptions(weighed, &mut chosen, (scene, wanted, width))?;
    if walk.variances.0.is_empty() {
        return Some(Effects { found: None, shutter_doubt });
    }
    // Where the shutter has only a part of the weight, readmitted views that motion explains would
    // be outliers of the model without it.
    let CornersChosen { walk, corners, good } =
        CornersChosen::beside(walk, chosen, whole, wanted, without.is_none())?;
    let scene = Scene { observations: &corners.observations, good: &good, ..whole };
    let found = walk.finished(scene)?;
    let Some(WithoutMotion { still, by_rows }) = without else {
        return Some(Effects { found: Some((found, corners)), shutter_doubt });
    };
    let still = still.settled_again(scene)?.finished(scene)?;
    let difference = lens_difference(found.lens(), still.lens());
    let shutter_doubt = Some(difference * by_rows.error());
    let found = found.averaged_with(&still, &basis, by_rows.agreement)?;
    Some(Effects { found: Some((found, corners)), shutter_doubt })
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
    let still = EffectSearch::same_as(scene, from(), false)?.finished(scene)?;
    with.averaged_with(&still, &basis, found.shutter_agreement)
}

/// The difference between the parameters of two lenses, `lens` minus `other`.
fn lens_difference(lens: &Lens, other: &Lens) -> DVector<f64> {
    let [lens, other] = [lens, other].map(Lens::parameters);
    DVector::from_vec(lens) - DVector::from_vec(other)
}

/// Where a search begins.
#[derive(Clone, Copy)]
struct WalkStart<'a> {
    /// The plain fit's.
    state: &'a State,
    /// Effects that were found with another lens or other poses.
    found: Option<&'a EffectsFit>,
}

impl WalkStart<'_> {
    fn settled(&self, scene: Scene<'_>, wanted: Wanted) -> Option<EffectSearch> {
        let state = self.state.clone();
        let walk = match self.found {
            Some(found) => EffectSearch::from_found(scene, state, found, wanted),
            None => EffectSearch::start(scene, state, wanted),
        };
        walk?.settled(scene, wanted)
    }

    /// A converged search; one without effects where none is significant.
    fn settled_or_bare(&self, scene: Scene<'_>, wanted: Wanted) -> Option<EffectSearch> {
        let bare = || EffectSearch::bare(scene, self.state.clone());
        self.settled(scene, wanted).or_else(bare)
    }

    /// A converged search. Its motion is compared with none, unless motion is in the model for
    /// certain.
    fn weighed(&self, scene: Scene<'_>, wanted: Wanted, width: f64) -> Option<Weighed> {
        let walk = self.settled(scene, wanted)?;
        if !walk.moves() || wanted.motion_for_certain {
            return Some(Weighed { walk, without: None, shutter_doubt: None });
        }
        let still = || self.settled_or_bare(scene, Wanted { motion: false, ..wanted });
        Weighed::of(walk, still, scene, width)
    }

    /// `weighed`, without views that are exceptions: motion also explains part of the residuals of
    /// another board or camera. Their faults are recorded in `chosen`.
    fn without_exceptions(
        &self,
        weighed: Weighed,
        chosen: &mut Corners,
        (scene, wanted, width): (Scene<'_>, Wanted, f64),
    ) -> Option<Weighed> {
        if !weighed.walk.moves() || wanted.motion_for_certain {
            return Some(weighed);
        }
        let Some(residuals) = self.still_residuals(&weighed, (scene, wanted)) else {
            return Some(weighed);
        };
        match self.without_few(&residuals, chosen, (scene, wanted, width)) {
            Some(rest) => Some(rest),
            None => self.without_odd(weighed, residuals, chosen, (scene, wanted, width)),
        }
    }

    /// Every corner's residuals in a fit without motion.
    fn still_residuals(
        &self,
        weighed: &Weighed,
        (scene, wanted): (Scene<'_>, Wanted),
    ) -> Option<Vec<Vec<[f64; 2]>>> {
        if let Some(without) = &weighed.without {
            return Some(without.still.system.residuals.clone());
        }
        let still = self.settled_or_bare(scene, Wanted { motion: false, ..wanted })?;
        Some(still.system.residuals)
    }

    /// A search without the views that are outliers of the fit without motion, whose `residuals`
    /// are given. `None` unless there are some but few of these, and the other views show effects
    /// but no motion.
    fn without_few(
        &self,
        residuals: &[Vec<[f64; 2]>],
        chosen: &mut Corners,
        (scene, wanted, width): (Scene<'_>, Wanted, f64),
    ) -> Option<Weighed> {
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
        let rest = self.weighed(Scene { good: &good, ..scene }, wanted, width)?;
        if rest.walk.moves() || rest.walk.variances.0.is_empty() {
            return None;
        }
        for view in scene.good.iter().filter(|view| faults[**view].is_some()) {
            chosen.observations[*view].used.fill(false);
        }
        chosen.faults = faults;
        Some(rest)
    }

    /// `weighed`, without views whose motion is incompatible with that of the others. They are
    /// tested one at a time: each time the one with the largest `residuals` in the fit without
    /// motion.
    fn without_odd(
        &self,
        mut weighed: Weighed,
        mut residuals: Vec<Vec<[f64; 2]>>,
        chosen: &mut Corners,
        (scene, wanted, width): (Scene<'_>, Wanted, f64),
    ) -> Option<Weighed> {
        let mut good = scene.good.to_vec();
        // Effects that were found with a view of odd motion are biased by it, so each search starts
        // from scratch.
        let fresh = WalkStart { found: None, ..*self };
        for _ in 0..scene.good.len() / FEW_PART {
            let scene = Scene { good: &good, ..scene };
            let mean_square = |view: usize| {
                let used = residuals[view].iter().zip(&chosen.observations[view].used);
                let squares = used.filter(|(_, used)| **used).map(|([x, y], _)| x * x + y * y);
                let (sum, count) =
                    squares.fold((0.0, 0.0), |(sum, n), square| (sum + square, n + 1.0));
                sum / f64::max(count, 1.0)
            };
            let worst = |a: &usize, b: &usize| mean_square(*a).total_cmp(&mean_square(*b));
            let Some(view) = good.iter().copied().max_by(worst) else { break };
            let others: Vec<usize> = good.iter().copied().filter(|other| *other != view).collect();
            let without = Scene { good: &others, ..scene };
            let rest = fresh.settled_or_bare(without, wanted);
            let odd = rest.and_then(|rest| rest.odd_motion(scene, view));
            let Some(times) = odd else { break };
            // Where the other views show no effect at all, there is no fit with effects to continue
            // from.
            let Some(next) = fresh.weighed(without, wanted, width) else { break };
            let at_rest = fresh.still_residuals(&next, (without, wanted));
            if next.walk.variances.0.is_empty() {
                break;
            }
            weighed = next;
            chosen.observations[view].used.fill(false);
            chosen.faults[view] = Some(ViewFault::OddMotion { times });
            let Some(at_rest) = at_rest.filter(|_| weighed.walk.moves()) else { break };
            residuals = at_rest;
            good = others;
        }
        Some(weighed)
    }
}

/// A search, and the inlier corners and views under its effects.
struct CornersChosen {
    walk: EffectSearch,
    corners: Corners,
    good: Vec<usize>,
}

impl CornersChosen {
    /// Alternates between selecting corners by the residuals of `walk` and continuing the search,
    /// until the selection no longer changes. `None` where too few views are good. With `readmits`,
    /// views that had been rejected before return in the first round if the effects explain them.
    /// `whole` is the scene of the plain fit, without views.
    fn beside(
        mut walk: EffectSearch,
        mut corners: Corners,
        whole: Scene<'_>,
        wanted: Wanted,
        readmits: bool,
    ) -> Option<Self> {
        let mut good = corners.good_views();
        for round in 0..MAX_ROUNDS {
            if round > 0 {
                let scene = Scene { observations: &corners.observations, good: &good, ..whole };
                walk = walk.again(scene)?.settled(scene, wanted)?;
            }
            let residuals = std::mem::take(&mut walk.system.residuals);
            corners.limit = LIMIT * scale_of(&corners.observations, &residuals).max(ROUNDING);
            let readmitted = round == 0 && readmits && walk.readmit(whole, &mut corners);
            let Corners { observations, faults, limit } = &mut corners;
            if !select(observations, &residuals, *limit, faults) && !readmitted {
                break;
            }
            good = corners.good_views();
            if good.len() < MIN_VIEWS {
                return None;
            }
        }
        Some(Self { walk, corners, good })
    }
}

/// The result without a rolling shutter, for views that do not agree on one.
struct WithoutMotion {
    still: EffectSearch,
    by_rows: ReadByRows,
}

/// A search whose motion was compared with none.
struct Weighed {
    walk: EffectSearch,
    /// The result to average it with.
    without: Option<WithoutMotion>,
    shutter_doubt: Option<DVector<f64>>,
}

impl Weighed {
    /// `walk`, or the `still` one where none of its motion is beyond chance.
    fn of(
        walk: EffectSearch,
        still: impl FnOnce() -> Option<EffectSearch>,
        scene: Scene<'_>,
        width: f64,
    ) -> Option<Self> {
        let by_rows = walk.read_by_rows(scene, width)?;
        if by_rows.is_shown {
            return Some(Self { walk, without: None, shutter_doubt: None });
        }
        let still = still()?;
        if by_rows.agreement > 0.0 {
            let without = Some(WithoutMotion { still, by_rows });
            return Some(Self { walk, without, shutter_doubt: None });
        }
        let shutter_doubt = Some(lens_difference(walk.lens(), still.lens()) * by_rows.error());
        Some(Self { walk: still, without: None, shutter_doubt })
    }
}
