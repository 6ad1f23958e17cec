//! Rejected views tested again under the model with effects. Before the board's shape and motion
//! are known, the residuals of a view with a fast-moving board are as large as those of a
//! mislabeled one.

use std::rc::Rc;

use nalgebra::{DVector, Matrix6, Vector6};

use crate::estimation::effects::fit::Corners;
use crate::estimation::effects::search::EffectSearch;
use crate::estimation::effects::state::{EffectsState, Scene, ViewStep};
use crate::estimation::effects::system::System;
use crate::estimation::robust_fit::is_explained;
use crate::estimation::view_fault::ViewFault;

/// Gauss-Newton steps of one view's pose and motion, from the pose that fits best without motion.
/// Not swept.
const STEPS: usize = 8;

impl EffectSearch {
    /// Readmits the views that the effects explain, with lens and shape fixed. Returns whether
    /// there are any. Outliers among their corners are still to be rejected.
    pub(super) fn readmit(&mut self, scene: Scene<'_>, corners: &mut Corners) -> bool {
        let basis = Rc::clone(&self.basis);
        let mut readmitted = Vec::new();
        for (view, fault) in corners.faults.iter().enumerate() {
            let Some(ViewFault::Outliers { .. } | ViewFault::NoPose { .. }) = fault else {
                continue;
            };
            let mut observations = corners.observations.clone();
            observations[view].used.fill(true);
            let good = [view];
            let scene = Scene { observations: &observations, good: &good, ..scene };
            if let Some(state) = self.explained(self.restricted(scene, &basis), corners.limit) {
                self.state = state;
                readmitted.push(view);
            }
        }
        for view in &readmitted {
            corners.faults[*view] = None;
            corners.observations[*view].used.fill(true);
        }
        !readmitted.is_empty()
    }

    /// The state with the pose and the motion that fit the one view of `scene` best. `None` where
    /// more than a tenth of its corners exceed the limit there. How large the motion is has no part
    /// in this decision, since the other views' variance is that of slower motions; the variance
    /// only regularizes the fit.
    fn explained(&self, scene: Scene<'_>, limit: f64) -> Option<EffectsState> {
        let (state, system) = self.placed(scene)?;
        is_explained(&system.residuals[scene.good[0]], limit).then_some(state)
    }

    /// The state with the pose and the motion that fit the one view of `scene` best, with lens and
    /// shape fixed, and the equations there.
    pub(super) fn placed(&self, scene: Scene<'_>) -> Option<(EffectsState, System)> {
        let globals = DVector::zeros(scene.global_len());
        let mut state = self.state.clone();
        let mut system = System::at(scene, &state)?;
        let lambda = self.variances.of_motion(&self.system);
        for _ in 0..STEPS {
            let view = system.views.first()?;
            let motion = if scene.moves {
                let gradient =
                    view.motion_gradient + state.motions[view.observation].component_mul(&lambda);
                -(view.motion + Matrix6::from_diagonal(&lambda)).cholesky()?.solve(&gradient)
            } else {
                Vector6::zeros()
            };
            let pose = view.pose_step(&globals, &motion);
            state = state.stepped(
                scene,
                &globals,
                &[ViewStep { observation: view.observation, pose, motion }],
            )?;
            system = System::at(scene, &state)?;
        }
        Some((state, system))
    }
}
