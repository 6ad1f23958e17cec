//! The result of a search that has converged: covariances of lens, poses and shape.

use std::rc::Rc;

use nalgebra::{DMatrix, DVector, Matrix6};

use crate::estimation::clustered_covariance::{Clustered, clustered};
use crate::estimation::effects::effects_fit::EffectsFit;
use crate::estimation::effects::evidence::Posterior;
use crate::estimation::effects::influence::view_jacobians;
use crate::estimation::effects::search::EffectSearch;
use crate::estimation::effects::six_columns::square_of_six;
use crate::estimation::effects::state::Scene;
use crate::estimation::effects::system::System;
use crate::estimation::joint::{BoardObservation, Layout};
use crate::estimation::view_influence::{Influence, LeftOutByChance};
use crate::geometry::lens::Lens;

impl EffectSearch {
    pub(super) fn finished(mut self, scene: Scene<'_>) -> Option<EffectsFit> {
        let basis = Rc::clone(&self.basis);
        let (scene, lens) = (self.restricted(scene, &basis), scene.layout.len);
        let of_motion = self.moves().then(|| self.variances.of_motion(&self.system));
        let posterior = self.last_posterior.take().or_else(|| self.posterior(scene))?;
        let noise_square = posterior.noise_square;
        let all = posterior.covariance();
        let size = basis.len();
        let shape_covariance = all.view((lens, lens), (size, size)) * noise_square;
        // Parameters differ by orders of magnitude, so the lens is handled in units of its standard
        // deviations.
        let scale = all.diagonal().map(|v| v.max(f64::MIN_POSITIVE).sqrt());
        let mut with_lens = all.columns(0, lens).into_owned();
        for (mut column, scale) in with_lens.column_iter_mut().zip(&scale) {
            column /= *scale;
        }
        let unit = DMatrix::from_fn(lens, lens, |i, j| with_lens[(i, j)] / scale[i]);
        let inverse = unit.clone().cholesky()?.inverse();
        let views = view_jacobians(scene, &self.state, of_motion);
        let influences: Vec<Influence> =
            views.iter().map(|view| view.influence(&with_lens, &inverse)).collect();
        let without = || {
            let in_units = |moved: DVector<f64>| DVector::from_fn(lens, |k, _| moved[k] / scale[k]);
            Some(views.iter().map(|view| in_units(view.without(&all))).collect())
        };
        let left_out_by_chance =
            influences.iter().map(|one| LeftOutByChance::of(&inverse, one)).collect::<Option<_>>();
        let Clustered { covariance, factor, weight } =
            clustered(&unit, noise_square, (&influences, scene.good.len()), without);
        Some(EffectsFit {
            noise_square,
            lens_covariance: DMatrix::from_fn(lens, lens, |i, j| {
                covariance[(i, j)] * scale[i] * scale[j]
            }),
            inflation: factor,
            weight_of_views: weight,
            left_out_by_chance: left_out_by_chance.unwrap_or_default(),
            pose_covariances: pose_covariances(&self.system, &posterior, scene.observations.len()),
            shape_covariance: shape_covariance * factor,
            state: self.state.with_rigid_part_in_poses(&basis),
            variances: self.variances,
            shutter_agreement: 1.0,
            basis: (*basis).clone(),
        })
    }
}

fn pose_covariances(
    system: &System,
    posterior: &Posterior,
    observations: usize,
) -> Vec<Option<Matrix6<f64>>> {
    let mut all = vec![None; observations];
    for (k, view) in system.views.iter().enumerate() {
        let Some((mut through, by_motion, alone)) = view.pose_response() else { continue };
        let mut covariance = alone;
        if let Some(up) = posterior.motion_up(k) {
            let through_motion = by_motion * up;
            through -= posterior.halves.columns(6 * k, 6) * through_motion.transpose();
            covariance += through_motion * through_motion.transpose();
        }
        let carried = &posterior.root * through;
        covariance += square_of_six(&carried.columns(0, 6));
        all[view.observation] = Some(covariance * posterior.noise_square);
    }
    all
}

impl EffectsFit {
    pub(super) fn lens(&self) -> &Lens {
        &self.state.fixed.lenses[0]
    }

    /// The observations, with their points displaced by shape and motion.
    pub(crate) fn moved_observations(
        &self,
        layout: &Layout,
        observations: &[BoardObservation],
        rows: f64,
    ) -> Vec<BoardObservation> {
        let scene = Scene {
            layout,
            basis: &self.basis,
            observations,
            good: &[],
            rows,
            by_columns: None,
            moves: true,
        };
        let offsets = self.basis.offsets(&self.state.shape);
        (0..observations.len())
            .map(|index| self.state.moved_observation(scene, &offsets, index))
            .collect()
    }
}
