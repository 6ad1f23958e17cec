//! The estimated effects beyond lens and poses.

use nalgebra::{DMatrix, Matrix6};

use crate::estimation::effects::board_basis::BoardBasis;
use crate::estimation::effects::evidence::Variances;
use crate::estimation::effects::state::EffectsState;
use crate::estimation::view_influence::LeftOutByChance;

/// The estimated effects beyond lens and poses, with their covariances.
#[derive(Debug, Clone)]
pub(crate) struct EffectsFit {
    pub(crate) basis: BoardBasis,
    pub(crate) state: EffectsState,
    /// The effects in the model, each with λ = noise variance / its variance.
    pub(crate) variances: Variances,
    /// The variance of the noise, as a factor on the corners' own variances.
    pub(crate) noise_square: f64,
    /// Covariance of the lens's free parameters, everything else marginalized.
    pub(crate) lens_covariance: DMatrix<f64>,
    /// Variance inflation: how many times larger variances are than with independent corner errors.
    pub(crate) inflation: f64,
    /// The part of `lens_covariance` that comes from the scatter between views, from 0 to below 1.
    pub(crate) weight_of_views: f64,
    /// For each view in use, or a sample of many: the change of the lens without it, if corners were
    /// independent. Empty where a view alone determines some parameter.
    pub(crate) left_out_by_chance: Vec<LeftOutByChance>,
    /// Per observation: covariance of its pose step (rotation, translation).
    pub(crate) pose_covariances: Vec<Option<Matrix6<f64>>>,
    /// Covariance of the shape's coefficients (zero for those not in the model).
    pub(crate) shape_covariance: DMatrix<f64>,
    /// 1 where the views agree that the motion in the model is a rolling shutter's. Otherwise the
    /// part of the motion that is beyond chance, which is its weight in the average.
    pub(crate) shutter_agreement: f64,
}

impl EffectsFit {
    /// The same fit, restricted to some of its views.
    pub(crate) fn of_views(&self, views: &[usize]) -> Self {
        let motions = views.iter().map(|view| self.state.motions[*view]).collect();
        Self { state: EffectsState { motions, ..self.state.clone() }, ..self.clone() }
    }
}
