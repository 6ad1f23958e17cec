//! The weighted mean of two models, with a rolling shutter and without, where the views do not
//! decide between them (J. A. Hoeting, D. Madigan, A. E. Raftery, C. T. Volinsky, *Bayesian model
//! averaging: a tutorial*, 1999, equations 1 to 3). Choosing one of the two would make the result
//! jump when a single view is added or removed.

use nalgebra::{DMatrix, DVector, Matrix6};

use crate::estimation::effects::board_basis::BoardBasis;
use crate::estimation::effects::effect::Effect;
use crate::estimation::effects::effects_fit::EffectsFit;
use crate::estimation::effects::evidence::{EffectVariance, Variances};
use crate::estimation::effects::state::{EffectsState, Scene};
use crate::estimation::joint::State;
use crate::geometry::lens::Lens;
use crate::geometry::pose::{Pose, pose_step};

impl EffectsFit {
    /// The mean of this fit, which has a rolling shutter and the weight `agreement`, and of
    /// `global_shutter`, which has none. `full` is the basis that contains both. The covariance of
    /// the lens does not include the difference between the two lenses.
    ///
    /// `None` where the mean parameters are not those of a valid lens.
    pub(super) fn averaged_with(
        &self,
        global_shutter: &Self,
        full: &BoardBasis,
        agreement: f64,
    ) -> Option<Self> {
        let (p, q) = (agreement, 1.0 - agreement);
        let variances = union(full, &self.variances, &global_shutter.variances);
        let (basis, _) = full.only(&variances.effects());
        let [own, other] = [self, global_shutter].map(|fit| fit.indices_in(&basis));
        let [own_shape, other_shape] = [(self, &own), (global_shutter, &other)]
            .map(|(fit, indices)| widened(&fit.state.shape, indices, basis.len()));
        let difference = &own_shape - &other_shape;
        let [own_covariance, other_covariance] = [(self, &own), (global_shutter, &other)]
            .map(|(fit, indices)| widened_square(&fit.shape_covariance, indices, basis.len()));
        let inflation = p * self.inflation + q * global_shutter.inflation;
        let mut fixed = if p > q { &self.state.fixed } else { &global_shutter.state.fixed }.clone();
        fixed.lenses[0] =
            mean_lens([&self.state, &global_shutter.state].map(|s| &s.fixed.lenses[0]), p)?;
        let pose_covariances = (0..self.pose_covariances.len())
            .map(|index| {
                let [own, other] = [self, global_shutter].map(|fit| fit.pose_covariances[index]);
                // With one camera, an observation's index is that of its frame set.
                let [a, b] =
                    [self, global_shutter].map(|fit| &fit.state.fixed.rig_from_board[index]);
                let within = own? * (p * self.inflation) + other? * (q * global_shutter.inflation);
                let difference = step_between(a, b);
                Some((within + difference * (p * q)) / inflation)
            })
            .collect();
        Some(Self {
            state: EffectsState {
                fixed,
                shape: (&own_shape * p + &other_shape * q).as_slice().to_vec(),
                motions: self.state.motions.iter().map(|motion| motion * p).collect(),
            },
            variances,
            noise_square: p * self.noise_square + q * global_shutter.noise_square,
            lens_covariance: &self.lens_covariance * p + &global_shutter.lens_covariance * q,
            inflation,
            weight_of_views: p * self.weight_of_views + q * global_shutter.weight_of_views,
            left_out_by_chance: self.left_out_by_chance.clone(),
            pose_covariances,
            shape_covariance: own_covariance * p
                + other_covariance * q
                + &difference * difference.transpose() * (p * q),
            shutter_agreement: agreement,
            basis,
        })
    }

    /// The effects that were found, with the given lens and poses, in a scene of the same views.
    pub(super) fn state_in(&self, scene: Scene<'_>, fixed: State, moves: bool) -> EffectsState {
        let global_shutter =
            EffectsState::without_effects(fixed, scene.basis, scene.observations.len());
        let shape = widened(&self.state.shape, &self.indices_in(scene.basis), scene.basis.len());
        EffectsState {
            shape: shape.as_slice().to_vec(),
            motions: if moves { self.state.motions.clone() } else { global_shutter.motions },
            ..global_shutter
        }
    }

    /// The indices of this fit's coefficients among those of a wider basis.
    fn indices_in(&self, wider: &BoardBasis) -> Vec<usize> {
        wider.only(&self.variances.effects()).1
    }
}

/// The effects that are in either model, in the order of `full`.
fn union(full: &BoardBasis, a: &Variances, b: &Variances) -> Variances {
    let heights = full.height_groups().into_iter().map(Effect::Height);
    let others = [Effect::Stretch, Effect::PointOffset, Effect::Rotation, Effect::Translation];
    let known = |effect: Effect| {
        let lambda = a.of(effect).or_else(|| b.of(effect))?;
        Some(EffectVariance { effect, lambda })
    };
    Variances(heights.chain(others).filter_map(known).collect())
}

/// A vector of length `len` with `values` at `indices` and 0 elsewhere.
fn widened(values: &[f64], indices: &[usize], len: usize) -> DVector<f64> {
    let mut of = DVector::zeros(len);
    indices.iter().zip(values).for_each(|(index, value)| of[*index] = *value);
    of
}

/// The same for the rows and columns of a square matrix.
fn widened_square(values: &DMatrix<f64>, indices: &[usize], len: usize) -> DMatrix<f64> {
    let mut of = DMatrix::zeros(len, len);
    for (k, row) in indices.iter().enumerate() {
        for (l, column) in indices.iter().enumerate() {
            of[(*row, *column)] = values[(k, l)];
        }
    }
    of
}

/// The lens with parameters `part` · a + (1 − `part`) · b.
fn mean_lens([a, b]: [&Lens; 2], part: f64) -> Option<Lens> {
    let parameters: Vec<f64> = a
        .parameters()
        .iter()
        .zip(b.parameters())
        .map(|(a, b)| part * a + (1.0 - part) * b)
        .collect();
    Lens::from_parameters(a.model(), &parameters)
}

/// d dᵀ, where d is the step from one pose of a board to another.
fn step_between(a_from_board: &Pose, b_from_board: &Pose) -> Matrix6<f64> {
    let rotation = (a_from_board.rotation() * b_from_board.rotation().inverse()).scaled_axis();
    let translation = a_from_board.translation() - b_from_board.translation();
    let step = pose_step(&rotation, &translation);
    step * step.transpose()
}
