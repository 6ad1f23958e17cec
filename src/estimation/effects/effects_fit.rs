//! What was found beyond lens and poses.

use nalgebra::{DMatrix, Matrix6};

use crate::estimation::effects::board_basis::BoardBasis;
use crate::estimation::effects::evidence::Variances;
use crate::estimation::effects::state::EffectsState;

/// What was found beyond lens and poses.
#[derive(Debug, Clone)]
pub(crate) struct EffectsFit {
    pub(crate) basis: BoardBasis,
    pub(crate) state: EffectsState,
    /// What is in the model, with noise variance / its variance.
    pub(crate) variances: Variances,
    /// The noise's variance in units of the corners' own.
    pub(crate) noise_square: f64,
    /// Covariance of the lens's free parameters, everything else marginalized.
    pub(crate) lens_covariance: DMatrix<f64>,
    /// How many times larger variances are than if each corner erred by itself.
    pub(crate) inflation: f64,
    /// What part of `lens_covariance` is how views differ, from 0 to below 1.
    pub(crate) weight_of_views: f64,
    /// Per observation: covariance of its pose step (rotation, translation).
    pub(crate) pose_covariances: Vec<Option<Matrix6<f64>>>,
    /// Covariance of the shape's coefficients (zero for those not in the model).
    pub(crate) shape_covariance: DMatrix<f64>,
    /// 1 where views agree that the motion in the model is a rolling shutter's; else the part of it
    /// that is beyond chance, as which it counts.
    pub(crate) shutter_agreement: f64,
}

impl EffectsFit {
    /// The same for some of its views.
    pub(crate) fn of_views(&self, views: &[usize]) -> Self {
        let motions = views.iter().map(|view| self.state.motions[*view]).collect();
        Self { state: EffectsState { motions, ..self.state.clone() }, ..self.clone() }
    }
}
