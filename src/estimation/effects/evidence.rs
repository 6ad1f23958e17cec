//! The posterior of lens, shape and motion for given variances, and the variances themselves by
//! maximum evidence: restricted maximum likelihood, by D. MacKay's updates (*Bayesian
//! interpolation*, 1992, equations 4.9 and 4.10: a variance is the sum of the squares of its
//! coefficients over the number of them that the data determine).
//!
//! Variances are stored as ratios λ = noise variance / variance of the effect, so that the variance
//! of the noise follows in closed form.

use nalgebra::{DMatrix, DVector, Matrix6, Vector6};

use crate::estimation::effects::board_basis::BoardBasis;
use crate::estimation::effects::dense::{
    Factor, lower_times, square_of_lower, take_square_from_lower,
};
use crate::estimation::effects::effect::Effect;
use crate::estimation::effects::six_columns::{by_inverse_transpose, square_of_six};
use crate::estimation::effects::state::EffectsState;
use crate::estimation::effects::system::{System, ViewPart};

/// An effect that is in the model.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct EffectVariance {
    pub(crate) effect: Effect,
    /// λ: the noise's variance over the effect's.
    pub(crate) lambda: f64,
}

/// The effects that are in the model.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Variances(pub(crate) Vec<EffectVariance>);

/// Factor on λ of an effect that is held at zero: its standard deviation becomes a ten-thousandth
/// of what it was. Not swept.
const HELD_LAMBDA_FACTOR: f64 = 1e8;

/// λ over the largest information of any view's motion, for a motion that is not in the model: the
/// prior then holds it at zero.
const ABSENT_MOTION_LAMBDA: f64 = 1e9;

impl Variances {
    /// Initial variances: each effect alone could double the residuals.
    pub(super) fn start(
        effects: &[Effect],
        system: &System,
        lens: usize,
        basis: &BoardBasis,
    ) -> Self {
        let count = system.residual_count as f64;
        let information = |effect: &Effect| -> f64 {
            let range = effect.range(basis);
            if effect.is_motion() {
                let of_view = |m: &Matrix6<f64>| range.clone().map(|k| m[(k, k)]).sum::<f64>();
                system.views.iter().map(|view| of_view(&view.motion)).sum()
            } else {
                range.map(|k| system.global[(lens + k, lens + k)]).sum()
            }
        };
        let start = |effect: &Effect| EffectVariance {
            effect: *effect,
            lambda: (information(effect) / (4.0 * count)).max(f64::MIN_POSITIVE),
        };
        Self(effects.iter().map(start).collect())
    }

    pub(super) fn effects(&self) -> Vec<Effect> {
        self.0.iter().map(|one| one.effect).collect()
    }

    /// Whether motion is in the model.
    pub(super) fn moves(&self) -> bool {
        self.0.iter().any(|one| one.effect.is_motion())
    }

    /// Whether the board's shape is in the model.
    pub(super) fn shapes(&self) -> bool {
        self.0.iter().any(|one| !one.effect.is_motion())
    }

    /// λ of each of the six numbers of a motion.
    pub(super) fn of_motion(&self, system: &System) -> Vector6<f64> {
        let largest = system.views.iter().map(|v| v.motion.diagonal().max()).fold(1e-300, f64::max);
        let of = |effect: Effect| self.of(effect).unwrap_or(ABSENT_MOTION_LAMBDA * largest);
        let (rotation, translation) = (of(Effect::Rotation), of(Effect::Translation));
        Vector6::new(rotation, rotation, rotation, translation, translation, translation)
    }

    pub(super) fn of(&self, effect: Effect) -> Option<f64> {
        self.0.iter().find(|one| one.effect == effect).map(|one| one.lambda)
    }

    /// The same with some effects held at zero.
    pub(super) fn held(&self, effects: &[Effect]) -> Self {
        let held = |one: &EffectVariance| match effects.contains(&one.effect) {
            true => EffectVariance { lambda: one.lambda * HELD_LAMBDA_FACTOR, ..*one },
            false => *one,
        };
        Self(self.0.iter().map(held).collect())
    }

    pub(super) fn without(&self, effect: Effect) -> Self {
        Self(self.0.iter().filter(|one| one.effect != effect).copied().collect())
    }

    /// The same with a variance of the stretch no smaller than that of the rest of the unevenness.
    /// Where the views do not determine the stretch, its estimate is near zero; without this bound
    /// the update would shrink its variance until the stretch counted as known to be zero.
    pub(super) fn with_stretch_as_others(mut self, basis: &BoardBasis) -> Self {
        // Mean squares over the points, in units of the noise: functions over all points have a
        // mean square of 1, and a point's own offset is of one point.
        let mean_square = |EffectVariance { effect, lambda }: &EffectVariance| match effect {
            Effect::Height(_) => effect.range(basis).len() as f64 / lambda,
            Effect::PointOffset => 2.0 / lambda,
            Effect::Stretch | Effect::Rotation | Effect::Translation => 0.0,
        };
        let others: f64 = self.0.iter().map(mean_square).sum();
        if others > 0.0 {
            let most = Effect::Stretch.range(basis).len() as f64 / others;
            for one in self.0.iter_mut().filter(|one| one.effect == Effect::Stretch) {
                one.lambda = one.lambda.min(most);
            }
        }
        self
    }

    /// The penalty of a state: the sum of squares that the prior adds to the cost.
    pub(super) fn penalty(&self, state: &EffectsState, basis: &BoardBasis, good: &[usize]) -> f64 {
        let squares = |EffectVariance { effect, lambda }: &EffectVariance| {
            let range = effect.range(basis);
            let sum: f64 = if effect.is_motion() {
                let of_view = |view: &usize| -> f64 {
                    range.clone().map(|k| state.motions[*view][k].powi(2)).sum()
                };
                good.iter().map(of_view).sum()
            } else {
                state.shape[range].iter().map(|u| u * u).sum()
            };
            lambda * sum
        };
        self.0.iter().map(squares).sum()
    }
}

/// What the prior adds to the information of each global parameter. Effects refer to `basis`.
fn prior_information(variances: &Variances, lens: usize, basis: &BoardBasis) -> Vec<f64> {
    let mut of = vec![0.0; lens + basis.len()];
    for EffectVariance { effect, lambda } in &variances.0 {
        if !effect.is_motion() {
            effect.range(basis).for_each(|k| of[lens + k] = *lambda);
        }
    }
    of
}

/// The eliminated motion of one view: Cholesky factor L of its block, and L⁻¹ times its gradient.
struct Eliminated {
    factor: Matrix6<f64>,
    half_gradient: Vector6<f64>,
}

/// The equations of the global parameters for one choice of variances, poses and motions
/// eliminated.
pub(super) struct ReducedSystem<'a> {
    system: &'a System,
    basis: &'a BoardBasis,
    variances: &'a Variances,
    lens: usize,
    /// For each global parameter, what its prior adds to its information.
    lambda: Vec<f64>,
    scale: DVector<f64>,
    factor: Factor,
    gradient: DVector<f64>,
    /// Six columns per view: the coupling of the globals with the view's motion, times L⁻ᵀ.
    halves: DMatrix<f64>,
    eliminated: Vec<Eliminated>,
    /// Sum over the views of ln |motion's block + Λ| − ln |Λ|.
    motion_determinants: f64,
}

/// The noise of the residuals.
struct ResidualNoise {
    /// Its variance, as a factor on the corners' own variances.
    square: f64,
    /// Its degrees of freedom.
    freedom: f64,
}

impl<'a> ReducedSystem<'a> {
    pub(super) fn of(
        system: &'a System,
        state: &EffectsState,
        basis: &'a BoardBasis,
        lens: usize,
        variances: &'a Variances,
    ) -> Option<Self> {
        Self::damped(system, state, (basis, lens), variances, 0.0)
    }

    /// As [`Self::of`], with the diagonal of the information multiplied by 1 + `damping` (K.
    /// Levenberg, 1944; D. Marquardt, 1963).
    pub(super) fn damped(
        system: &'a System,
        state: &EffectsState,
        (basis, lens): (&'a BoardBasis, usize),
        variances: &'a Variances,
        damping: f64,
    ) -> Option<Self> {
        let lambda = prior_information(variances, lens, basis);
        let (size, mut schur) = (lambda.len(), system.global.clone());
        let mut gradient = system.gradient.clone();
        for (k, lambda) in lambda.iter().enumerate() {
            let value = if k < lens { 0.0 } else { state.shape[k - lens] };
            gradient[k] += lambda * value;
            schur[(k, k)] += lambda;
        }
        let of_motion = variances.of_motion(system);
        let views = if variances.moves() { system.views.len() } else { 0 };
        let mut halves = DMatrix::zeros(size, 6 * views);
        let mut eliminated = Vec::with_capacity(views);
        let mut motion_determinants = 0.0;
        for (k, view) in system.views.iter().take(views).enumerate() {
            let mut block = view.motion + Matrix6::from_diagonal(&of_motion);
            (0..6).for_each(|k| block[(k, k)] *= 1.0 + damping);
            let factor = block.cholesky()?.unpack();
            motion_determinants +=
                (0..6).map(|k| 2.0 * factor[(k, k)].ln() - of_motion[k].ln()).sum::<f64>();
            let now = state.motions[view.observation].component_mul(&of_motion);
            let half_gradient = factor.solve_lower_triangular(&(view.motion_gradient + now))?;
            let mut half = view.motion_coupling.clone();
            by_inverse_transpose(&mut half, &factor);
            gradient.gemv(-1.0, &half, &half_gradient, 1.0);
            halves.columns_mut(6 * k, 6).copy_from(&half);
            eliminated.push(Eliminated { factor, half_gradient });
        }
        if views > 0 {
            take_square_from_lower(&mut schur, &halves);
        }
        (0..size).for_each(|k| schur[(k, k)] *= 1.0 + damping);
        let scale = schur.diagonal().map(|d| 1.0 / d.max(f64::MIN_POSITIVE).sqrt());
        for j in 0..size {
            for i in j..size {
                schur[(i, j)] *= scale[i] * scale[j];
            }
        }
        Some(Self {
            system,
            basis,
            variances,
            lens,
            lambda,
            scale,
            factor: Factor::of(schur)?,
            gradient,
            halves,
            eliminated,
            motion_determinants,
        })
    }

    /// The posterior with its covariance.
    pub(super) fn posterior(self, state: &EffectsState) -> Posterior {
        let noise_square = self.noise_square(state);
        let mut root = self.factor.root_of_inverse();
        for (mut column, scale) in root.column_iter_mut().zip(&self.scale) {
            column *= *scale;
        }
        let step = -root.tr_mul(&(&root * &self.gradient));
        let carried = lower_times(&root, &self.halves);
        let (mut motions, mut motion_covariances, mut ups) = (Vec::new(), Vec::new(), Vec::new());
        for (k, view) in self.eliminated.iter().enumerate() {
            let right = view.half_gradient + self.halves.columns(6 * k, 6).tr_mul(&step);
            let up = view.factor.try_inverse().unwrap_or_default().transpose();
            motions.push(-(up * right));
            ups.push(up);
            let carried = carried.columns(6 * k, 6);
            let inner = square_of_six(&carried);
            motion_covariances.push(up * (inner + Matrix6::identity()) * up.transpose());
        }
        Posterior {
            root,
            global: step,
            motions,
            motion_covariances,
            halves: self.halves,
            ups,
            noise_square,
        }
    }

    /// The noise at the mode, without computing the posterior.
    fn noise(&self, state: &EffectsState) -> ResidualNoise {
        // The decrease of a full step needs the factor only: gᵀ S⁻¹ g = |L⁻¹ g|².
        let scaled = self.gradient.component_mul(&self.scale);
        let decrease = self.factor.half_square(&scaled);
        let cost = self.system.cost
            + self.variances.penalty(state, self.basis, &self.observations())
            - self.system.views.iter().map(ViewPart::pose_decrease).sum::<f64>()
            - self.eliminated.iter().map(|view| view.half_gradient.norm_squared()).sum::<f64>()
            - decrease;
        let views = self.system.views.len();
        let freedom = (self.system.residual_count as f64 - (self.lens + 6 * views) as f64).max(1.0);
        ResidualNoise { square: (cost / freedom).max(f64::MIN_POSITIVE), freedom }
    }

    /// The variance of the noise at the mode.
    pub(super) fn noise_square(&self, state: &EffectsState) -> f64 {
        self.noise(state).square
    }

    /// The logarithm of the evidence, without computing the posterior.
    pub(super) fn log_evidence(&self, state: &EffectsState) -> f64 {
        let ResidualNoise { square, freedom } = self.noise(state);
        let log_determinants = self.factor.log_determinant()
            - 2.0 * self.scale.iter().map(|s| s.ln()).sum::<f64>()
            - self.lambda[self.lens..].iter().map(|l| l.ln()).sum::<f64>()
            + self.motion_determinants;
        -0.5 * (freedom * (square.ln() + 1.0) + log_determinants)
    }

    /// By how much a full step would lower the cost, in units of twice the noise's variance: as much
    /// is missing from the logarithm of the likelihood at this state.
    pub(super) fn log_likelihood_gain(&self, state: &EffectsState) -> f64 {
        let ResidualNoise { square, freedom } = self.noise(state);
        let penalty = self.variances.penalty(state, self.basis, &self.observations());
        0.5 * ((self.system.cost + penalty) / square - freedom)
    }

    fn observations(&self) -> Vec<usize> {
        self.system.views.iter().map(|view| view.observation).collect()
    }
}

/// The posterior, as steps from the present state and their covariances.
pub(super) struct Posterior {
    /// A lower-triangular R with Rᵀ R = covariance of the globals, for noise of unit variance.
    pub(super) root: DMatrix<f64>,
    /// The step of all global parameters.
    pub(super) global: DVector<f64>,
    /// Per view, in the system's order: the step of its motion, and its covariance for noise of
    /// unit variance; empty without motion.
    pub(super) motions: Vec<Vector6<f64>>,
    pub(super) motion_covariances: Vec<Matrix6<f64>>,
    pub(super) halves: DMatrix<f64>,
    ups: Vec<Matrix6<f64>>,
    pub(super) noise_square: f64,
}

/// Variances after an update.
pub(super) struct UpdatedVariances {
    pub(super) variances: Variances,
    /// How many coefficients of each effect the data determine.
    pub(super) determined: Vec<f64>,
}

/// A lower bound on λ as a part of an effect's mean information. Even with noiseless corners, the
/// prior must determine what no corner determines, such as a motion of the whole board.
const LEAST_LAMBDA: f64 = 1e-10;

/// An upper bound on the standard deviation of a motion, as a part of half the board's diagonal: of
/// a board that fills half of an image of 640 columns, corners then move by 20 px while it is read,
/// and blur. Without a bound, the motion explains other model errors too: of 30 photographs of a
/// board of 0.7 m, motions of 120 mm, where motion capture shows 1 mm. Chosen for blur; on these
/// photographs 0.03, 0.06 and 0.1 give the same lens, and larger bounds were not tried.
const MOST_MOTION: f64 = 0.1;

/// The largest factor by which one update changes λ.
const LARGEST_CHANGE: f64 = 1e4;

impl Posterior {
    /// The covariance of all globals, for noise of unit variance.
    pub(super) fn covariance(&self) -> DMatrix<f64> {
        square_of_lower(&self.root)
    }

    /// L⁻ᵀ of the `k`-th view's motion; `None` without motion.
    pub(super) fn motion_up(&self, k: usize) -> Option<Matrix6<f64>> {
        self.ups.get(k).copied()
    }

    /// MacKay's update of each variance.
    pub(super) fn updated(
        &self,
        system: &System,
        state: &EffectsState,
        (basis, lens): (&BoardBasis, usize),
        variances: &Variances,
    ) -> UpdatedVariances {
        let mut determined = Vec::new();
        let update = |EffectVariance { effect, lambda }: &EffectVariance| {
            let range = effect.range(basis);
            let (mut trace, mut squares, mut count) = (0.0, 0.0, 0.0);
            let mut information = 0.0;
            if effect.is_motion() {
                for ((view, step), covariance) in
                    system.views.iter().zip(&self.motions).zip(&self.motion_covariances)
                {
                    let motion = state.motions[view.observation] + step;
                    trace += range.clone().map(|k| covariance[(k, k)]).sum::<f64>();
                    information += range.clone().map(|k| view.motion[(k, k)]).sum::<f64>();
                    squares += range.clone().map(|k| motion[k] * motion[k]).sum::<f64>();
                    count += range.len() as f64;
                }
            } else {
                for k in range {
                    let column = self.root.column(lens + k);
                    trace += column.rows_range(lens + k..).norm_squared();
                    information += system.global[(lens + k, lens + k)];
                    squares += (state.shape[k] + self.global[lens + k]).powi(2);
                    count += 1.0;
                }
            }
            let known = (count - lambda * trace).max(1e-6 * count);
            determined.push(known);
            let next = self.noise_square * known / squares.max(f64::MIN_POSITIVE);
            let next = next.clamp(lambda / LARGEST_CHANGE, lambda * LARGEST_CHANGE);
            let mut lambda = next.max(LEAST_LAMBDA * information / count);
            if effect.is_motion() {
                lambda = lambda.max(self.noise_square / (MOST_MOTION * basis.lever()).powi(2));
            }
            EffectVariance { effect: *effect, lambda }
        };
        let variances = Variances(variances.0.iter().map(update).collect());
        UpdatedVariances { variances, determined }
    }

    /// By how much each effect raises the logarithm of the evidence, the other variances being
    /// fixed: the Savage–Dickey ratio, prior over posterior density at zero effect (J. Dickey,
    /// 1971). The motions of different views are treated as independent.
    pub(super) fn gains(
        &self,
        system: &System,
        state: &EffectsState,
        (basis, lens): (&BoardBasis, usize),
        variances: &Variances,
    ) -> Vec<f64> {
        let gain = |EffectVariance { effect, lambda }: &EffectVariance| {
            let range = effect.range(basis);
            if !effect.is_motion() {
                let (first, size) = (lens + range.start, range.len());
                let rows = self.root.nrows() - first;
                let columns = self.root.view((first, first), (rows, size));
                let value =
                    DVector::from_column_slice(&state.shape[range]) + self.global.rows(first, size);
                return self.gain(columns.transpose() * columns * *lambda, &value, *lambda);
            }
            let of_view =
                |((view, step), covariance): ((&ViewPart, &Vector6<f64>), &Matrix6<f64>)| {
                    let motion = state.motions[view.observation] + step;
                    let block = covariance.view((range.start, range.start), (3, 3)) * *lambda;
                    self.gain(block, &motion.rows(range.start, 3).into_owned(), *lambda)
                };
            system.views.iter().zip(&self.motions).zip(&self.motion_covariances).map(of_view).sum()
        };
        variances.0.iter().map(gain).collect()
    }

    /// ½ (uᵀ C⁻¹ u / noise² + ln |λ C|), `block` being λ C.
    fn gain(&self, block: DMatrix<f64>, value: &DVector<f64>, lambda: f64) -> f64 {
        let Some(factor) = Factor::of(block) else { return 0.0 };
        let square = factor.half_square(value) * lambda / self.noise_square;
        0.5 * (square + factor.log_determinant())
    }
}
