//! The search for the posterior's mode, with variances updated on the way.

use std::rc::Rc;

use nalgebra::Vector6;

use crate::estimation::effects::board_basis::BoardBasis;
use crate::estimation::effects::effect::{CandidateEffects, Effect};
use crate::estimation::effects::effects_fit::EffectsFit;
use crate::estimation::effects::evidence::{Posterior, ReducedSystem, UpdatedVariances, Variances};
use crate::estimation::effects::score_tests;
use crate::estimation::effects::state::{EffectsState, Scene, ViewStep};
use crate::estimation::effects::system::System;
use crate::estimation::joint::State;
use crate::geometry::lens::Lens;

/// The board's shape, or its motion, must raise the logarithm of the evidence by this to be in the
/// model. Chance alone does so once in a hundred times (χ² of the few variances that each has).
pub(super) const LEAST_GROUP_GAIN: f64 = 4.0;

/// Likewise for one kind of shape or motion, given that others of its group are in the model.
const LEAST_GAIN: f64 = 1.5;

/// Steps before insignificant effects are dropped: the remaining steps are faster without them.
const FIRST_STEPS: usize = 3;

/// Steps after effects were dropped or corners selected again: the minimum is then close.
pub(super) const MAX_STEPS: usize = 5;

/// State and variances have converged where no ln λ changes by more than this, among effects of
/// which the data determine one coefficient or more, …
const CONVERGED_LOG_LAMBDA: f64 = 0.1;
/// … and a step lowers the sum of squares by less than this, in units of the noise's variance: the
/// mode is then 0.17 standard deviations away. Neither was swept.
const CONVERGED_COST: f64 = 0.03;

/// Steps at fixed variances after a view is added. Not swept.
const MAX_JOINING_STEPS: usize = 8;

/// The damping of a first step after a full one that raises the cost, relative to the information;
/// by which factor it is raised from try to try, and lowered from step to step; and from where on
/// the state is left as it is. Chosen, not swept.
const FIRST_DAMPING: f64 = 1e-6;
const DAMPING_FACTOR: f64 = 10.0;
const MOST_DAMPING: f64 = 10.0;

/// Damped steps, which do not count as steps. Not swept.
const MAX_DAMPED_STEPS: usize = 24;

/// Steps with smooth shapes alone.
const ROUGH_STEPS: usize = 8;

/// A step that was made.
struct StepTaken {
    /// By how much it lowered the penalized cost.
    decrease: f64,
    /// Whether it was not damped.
    is_full: bool,
}

/// The search. An effect that is not in the model has no unknowns.
pub(super) struct EffectSearch {
    pub(super) state: EffectsState,
    pub(super) system: System,
    pub(super) variances: Variances,
    /// The functions on the board that are in the model.
    pub(super) basis: Rc<BoardBasis>,
    /// The posterior at this state and these variances, where it was computed last.
    pub(super) last_posterior: Option<Posterior>,
}

impl EffectSearch {
    /// Starts with a few smooth shapes alone: they take a tenth of the time and lead close to the
    /// mode.
    pub(super) fn start(
        scene: Scene<'_>,
        plain: State,
        candidates: CandidateEffects,
    ) -> Option<Self> {
        let rough = BoardBasis::of(scene.observations, false)?;
        let flat = EffectsState::without_effects(plain, &rough, scene.observations.len());
        let rough_scene = Scene { basis: &rough, moves: true, ..scene };
        if !candidates.shape {
            return Self::from_state(rough_scene, flat, candidates, false);
        }
        let mut near = Self::from_state(rough_scene, flat.clone(), candidates, false)?;
        let is_linear = near.converge(rough_scene, ROUGH_STEPS)?;
        if candidates.motion && !is_linear {
            // With six unknowns per view, motion also explained what the smooth shapes do not, and
            // became far too large. So it is added after the rest of the shape.
            let shape_only = CandidateEffects { motion: false, ..candidates };
            near = Self::from_state(rough_scene, flat, shape_only, false)?;
            near.converge(rough_scene, ROUGH_STEPS)?;
            if !near.misses_point_offsets(rough_scene)? {
                near = Self::from_state(rough_scene, near.state, candidates, false)?;
                near.converge(rough_scene, ROUGH_STEPS)?;
            }
        }
        // Offsets of single points make the equations large. They are left out where smooth shapes
        // and motion leave no residuals that they would explain.
        let own = candidates.is_shape_required || near.misses_point_offsets(rough_scene)?;
        let heights = rough.heights.len();
        let mut shape = vec![0.0; scene.basis.len()];
        shape[..heights].copy_from_slice(&near.state.shape[..heights]);
        let stretches = Effect::Stretch.range(scene.basis);
        shape[stretches].copy_from_slice(&near.state.shape[heights..]);
        let state = EffectsState { shape, ..near.state };
        let mut next = Self::from_state(scene, state, candidates, own)?;
        for one in &mut next.variances.0 {
            // Too wide a variance lets effects that the rough shapes hid appear in fewer steps.
            let found = near.variances.of(one.effect);
            one.lambda = found.map_or(one.lambda, |found| found.min(one.lambda));
        }
        Some(next)
    }

    /// Whether offsets of single points would explain more of the residuals than expected by chance.
    fn misses_point_offsets(&self, scene: Scene<'_>) -> Option<bool> {
        let noise_square = self.noise_square(scene)?;
        Some(score_tests::may_have_point_offsets(&self.system, noise_square))
    }

    /// Starts from effects that were found before in the same views.
    pub(super) fn from_found(
        scene: Scene<'_>,
        fixed: State,
        found: &EffectsFit,
        candidates: CandidateEffects,
    ) -> Option<Self> {
        let state = found.state_in(scene, fixed, candidates.motion);
        let own = found.variances.of(Effect::PointOffset).is_some() || candidates.is_shape_required;
        Some(Self::from_state(scene, state, candidates, own)?.with_variances_of(found))
    }

    /// The minimum with the same effects that were found before in the same views, with or without
    /// the motion among them.
    pub(super) fn same_as(
        scene: Scene<'_>,
        (fixed, found): (State, &EffectsFit),
        moves: bool,
    ) -> Option<Self> {
        let mut effects = found.variances.effects();
        effects.retain(|effect| moves || !effect.is_motion());
        let state = found.state_in(scene, fixed, moves);
        let mut search = Self::of_effects(scene, state, &effects)?.with_variances_of(found);
        search.converge(scene, ROUGH_STEPS)?;
        Some(search)
    }

    fn with_variances_of(mut self, found: &EffectsFit) -> Self {
        for one in &mut self.variances.0 {
            one.lambda = found.variances.of(one.effect).unwrap_or(one.lambda);
        }
        self
    }

    /// Starts with all wanted effects, in a scene whose basis has all of them; with offsets of
    /// single points too if `own`.
    fn from_state(
        scene: Scene<'_>,
        state: EffectsState,
        candidates: CandidateEffects,
        own: bool,
    ) -> Option<Self> {
        let mut effects: Vec<Effect> = Vec::new();
        if candidates.shape {
            effects.extend(scene.basis.height_groups().into_iter().map(Effect::Height));
            effects.push(Effect::Stretch);
            effects.extend((scene.basis.has_point_offsets && own).then_some(Effect::PointOffset));
        }
        if candidates.motion {
            effects.extend([Effect::Rotation, Effect::Translation]);
        }
        Self::of_effects(scene, state, &effects)
    }

    /// With these effects.
    fn of_effects(scene: Scene<'_>, mut state: EffectsState, effects: &[Effect]) -> Option<Self> {
        let (basis, kept) = scene.basis.only(effects);
        state.shape = kept.iter().map(|k| state.shape[*k]).collect();
        let moves = effects.iter().any(|effect| effect.is_motion());
        let scene = Scene { basis: &basis, moves, ..scene };
        let system = System::at(scene, &state)?;
        let variances = Variances::start(effects, &system, scene.layout.len, &basis);
        Some(Self { state, system, variances, basis: Rc::new(basis), last_posterior: None })
    }

    /// The scene restricted to what is in the model; `basis` is this search's own.
    pub(super) fn restricted<'a>(&self, scene: Scene<'a>, basis: &'a BoardBasis) -> Scene<'a> {
        Scene { basis, moves: self.moves(), ..scene }
    }

    /// With no effects.
    pub(super) fn without_effects(scene: Scene<'_>, plain: State) -> Option<Self> {
        let flat = EffectsState::without_effects(plain, scene.basis, scene.observations.len());
        let none = CandidateEffects {
            shape: false,
            motion: false,
            is_shape_required: false,
            is_motion_required: false,
        };
        Self::from_state(scene, flat, none, false)
    }

    /// The minimum with the same effects, after corners were selected again.
    pub(super) fn reconverged(self, scene: Scene<'_>) -> Option<Self> {
        let mut next = self.relinearized(scene)?;
        next.converge(scene, MAX_STEPS)?;
        Some(next)
    }

    /// The minimum with only the significant effects; `None` where there are none.
    pub(super) fn converged(
        mut self,
        scene: Scene<'_>,
        candidates: CandidateEffects,
    ) -> Option<Self> {
        let mut steps = FIRST_STEPS;
        loop {
            if self.variances.0.is_empty() {
                return None;
            }
            self.converge(scene, steps)?;
            if !self.drop_insignificant(scene, candidates)? {
                return Some(self);
            }
            steps = MAX_STEPS;
        }
    }

    pub(super) fn lens(&self) -> &Lens {
        &self.state.fixed.lenses[0]
    }

    /// The same state and variances, with the equations of the corners as selected now.
    pub(super) fn relinearized(self, scene: Scene<'_>) -> Option<Self> {
        let system = System::at(self.restricted(scene, &self.basis), &self.state)?;
        Some(Self { system, last_posterior: None, ..self })
    }

    pub(super) fn moves(&self) -> bool {
        self.variances.moves()
    }

    /// A search that starts from this state with all motions set to zero, in another scene. Motion
    /// stays in the model.
    pub(super) fn without_motion(&self, scene: Scene<'_>) -> Option<Self> {
        let mut state = self.state.clone();
        for effect in self.variances.effects().into_iter().filter(|effect| effect.is_motion()) {
            state.clear(effect, &self.basis);
        }
        let system = System::at(self.restricted(scene, &self.basis), &state)?;
        let (variances, basis) = (self.variances.clone(), self.basis.clone());
        Some(Self { state, system, variances, basis, last_posterior: None })
    }

    fn reduced<'a>(
        &'a self,
        scene: Scene<'a>,
        variances: &'a Variances,
    ) -> Option<ReducedSystem<'a>> {
        ReducedSystem::of(&self.system, &self.state, scene.basis, scene.layout.len, variances)
    }

    /// The variance of the noise at this state, as a factor on the corners' own variances.
    pub(super) fn noise_square(&self, scene: Scene<'_>) -> Option<f64> {
        let basis = Rc::clone(&self.basis);
        let reduced = self.reduced(self.restricted(scene, &basis), &self.variances)?;
        Some(reduced.noise_square(&self.state))
    }

    pub(super) fn posterior(&self, scene: Scene<'_>) -> Option<Posterior> {
        Some(self.reduced(scene, &self.variances)?.posterior(&self.state))
    }

    /// Steps until state and variances have converged. Returns whether all of them were full ones.
    /// Variances are updated only after full steps: the motions and the noise that they follow from
    /// are those at the end of such a step, and where it cannot be made, the linearized equations
    /// do not hold there.
    pub(super) fn converge(&mut self, scene: Scene<'_>, max_steps: usize) -> Option<bool> {
        self.last_posterior = None;
        let basis = Rc::clone(&self.basis);
        let scene = self.restricted(scene, &basis);
        let (mut damping, mut steps, mut are_full) = (0.0, 0, true);
        for _ in 0..max_steps + MAX_DAMPED_STEPS {
            let posterior = self.posterior(scene)?;
            let of = (scene.basis, scene.layout.len);
            let UpdatedVariances { variances: next, determined } =
                posterior.updated(&self.system, &self.state, of, &self.variances);
            let StepTaken { decrease, is_full } = self.step(scene, &posterior, &mut damping)?;
            let is_at_mode = decrease < CONVERGED_COST * posterior.noise_square;
            are_full &= is_full;
            if !is_full {
                if is_at_mode {
                    break;
                }
                continue;
            }
            let changes = next.0.iter().zip(&self.variances.0).zip(&determined);
            let changed = changes
                .map(|((next, now), known)| {
                    (next.lambda / now.lambda).ln().abs() * known.sqrt().min(1.0)
                })
                .fold(0.0, f64::max);
            self.variances = next.with_stretch_as_others(scene.basis);
            steps += 1;
            if steps == max_steps || is_at_mode && changed < CONVERGED_LOG_LAMBDA {
                break;
            }
        }
        Some(are_full)
    }

    /// Steps until the state has converged, at fixed variances.
    pub(super) fn converge_state(&mut self, scene: Scene<'_>, noise_square: f64) -> Option<()> {
        self.last_posterior = None;
        let basis = Rc::clone(&self.basis);
        let scene = self.restricted(scene, &basis);
        let mut damping = 0.0;
        for _ in 0..MAX_JOINING_STEPS {
            let posterior = self.posterior(scene)?;
            let StepTaken { decrease, .. } = self.step(scene, &posterior, &mut damping)?;
            if decrease < CONVERGED_COST * noise_square {
                break;
            }
        }
        Some(())
    }

    /// Makes a step that lowers the penalized cost, if there is one: the full one where `damping`
    /// is 0, to the mode that `posterior` has.
    fn step(
        &mut self,
        scene: Scene<'_>,
        posterior: &Posterior,
        damping: &mut f64,
    ) -> Option<StepTaken> {
        let cost = self.penalized_cost(scene, &self.state, &self.system);
        while *damping <= MOST_DAMPING {
            let is_full = *damping == 0.0;
            let next = if is_full {
                self.stepped(scene, posterior)
            } else {
                let of = (scene.basis, scene.layout.len);
                let (system, variances) = (&self.system, &self.variances);
                ReducedSystem::damped(system, &self.state, of, variances, *damping)
                    .and_then(|reduced| self.stepped(scene, &reduced.posterior(&self.state)))
            };
            let system = next.as_ref().and_then(|next| System::at(scene, next));
            if let (Some(next), Some(system)) = (next, system) {
                let at_next = self.penalized_cost(scene, &next, &system);
                if at_next <= cost * (1.0 + 1e-9) {
                    (self.state, self.system) = (next, system);
                    *damping /= DAMPING_FACTOR;
                    if *damping < FIRST_DAMPING {
                        *damping = 0.0;
                    }
                    return Some(StepTaken { decrease: cost - at_next, is_full });
                }
            }
            *damping = FIRST_DAMPING.max(*damping * DAMPING_FACTOR);
        }
        Some(StepTaken { decrease: 0.0, is_full: false })
    }

    /// The sum of squares at a state, with what the priors add.
    fn penalized_cost(&self, scene: Scene<'_>, state: &EffectsState, system: &System) -> f64 {
        system.cost + self.variances.penalty(state, scene.basis, scene.good)
    }

    fn stepped(&self, scene: Scene<'_>, posterior: &Posterior) -> Option<EffectsState> {
        let view_steps: Vec<ViewStep> = self
            .system
            .views
            .iter()
            .enumerate()
            .map(|(k, view)| {
                let motion = posterior.motions.get(k).copied().unwrap_or_else(Vector6::zeros);
                let pose = view.pose_step(&posterior.global, &motion);
                ViewStep { observation: view.observation, pose, motion }
            })
            .collect();
        self.state.stepped(scene, &posterior.global, &view_steps)
    }

    /// Drops the effects that are not significant, and returns whether there were any.
    fn drop_insignificant(
        &mut self,
        scene: Scene<'_>,
        candidates: CandidateEffects,
    ) -> Option<bool> {
        let basis = Rc::clone(&self.basis);
        let scene = self.restricted(scene, &basis);
        let (insignificant, posterior) = self.insignificant(scene, candidates)?;
        if insignificant.is_empty() {
            self.last_posterior = Some(posterior);
            return Some(false);
        }
        for effect in &insignificant {
            self.variances = self.variances.without(*effect);
            self.state.clear(*effect, &basis);
        }
        let (narrow, kept) = basis.only(&self.variances.effects());
        self.state.shape = kept.iter().map(|k| self.state.shape[*k]).collect();
        self.basis = Rc::new(narrow);
        let basis = Rc::clone(&self.basis);
        self.system = System::at(self.restricted(scene, &basis), &self.state)?;
        Some(true)
    }

    /// The effects that are not significant, with the posterior from which this follows.
    fn insignificant(
        &self,
        scene: Scene<'_>,
        candidates: CandidateEffects,
    ) -> Option<(Vec<Effect>, Posterior)> {
        let reduced = self.reduced(scene, &self.variances)?;
        let with = reduced.log_evidence(&self.state);
        let of = (scene.basis, scene.layout.len);
        let posterior = reduced.posterior(&self.state);
        let gains = posterior.gains(&self.system, &self.state, of, &self.variances);
        let mut groups: Vec<GroupGain> = Vec::new();
        for motion in [true, false] {
            let group: Vec<(Effect, f64)> = self
                .variances
                .0
                .iter()
                .zip(&gains)
                .map(|(one, gain)| (one.effect, *gain))
                .filter(|(effect, _)| effect.is_motion() == motion)
                .collect();
            let certain =
                if motion { candidates.is_motion_required } else { candidates.is_shape_required };
            if group.is_empty() || certain {
                continue;
            }
            let effects: Vec<Effect> = group.iter().map(|(effect, _)| *effect).collect();
            let whole = with - self.log_evidence(scene, &self.variances.held(&effects))?;
            groups.push(GroupGain::of(whole, &group));
        }
        // While the variances of one group are still far too wide, the other is not significant
        // either. So it is tested again without that group. Otherwise, of 25 photographs, 16 sets of
        // 24 had a flat board, and the others an uneven one.
        if groups.iter().map(|group| group.insignificant.len()).sum::<usize>() == gains.len() {
            groups.sort_by(|a, b| a.whole.total_cmp(&b.whole));
            groups.truncate(1);
        }
        Some((groups.into_iter().flat_map(|group| group.insignificant).collect(), posterior))
    }

    pub(super) fn log_evidence(&self, scene: Scene<'_>, variances: &Variances) -> Option<f64> {
        Some(self.reduced(scene, variances)?.log_evidence(&self.state))
    }
}

/// How much the board's shape, or the motion, raises the logarithm of the evidence.
struct GroupGain {
    whole: f64,
    insignificant: Vec<Effect>,
}

impl GroupGain {
    /// Of a group that raises it by `whole`, and each of its effects by the number beside it.
    fn of(whole: f64, effects: &[(Effect, f64)]) -> Self {
        let is_shown = |gain: f64| whole >= LEAST_GROUP_GAIN && gain >= LEAST_GAIN;
        let has_shape =
            effects.iter().any(|(effect, gain)| *effect != Effect::Stretch && is_shown(*gain));
        // A stretch that the views do not show may still exist: in upright views the board's aspect
        // cannot be separated from that of the pixels.
        let is_kept = |(effect, gain): &(Effect, f64)| match effect {
            Effect::Stretch => has_shape || is_shown(*gain),
            _ => is_shown(*gain),
        };
        let dropped = effects.iter().filter(|one| !is_kept(one));
        Self { whole, insignificant: dropped.map(|(effect, _)| *effect).collect() }
    }
}
