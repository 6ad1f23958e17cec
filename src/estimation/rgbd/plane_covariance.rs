//! The covariance of a depth camera's lens and pose by planes.

use nalgebra::{DMatrix, Matrix6};

use crate::estimation::clustered_covariance::FitCovariance;
use crate::estimation::joint::Layout;
use crate::estimation::joint::depth_terms::{CorrectionColumns, PlaneObservation, add_planes};
use crate::estimation::joint::linearize::LinearizationPoint;
use crate::estimation::joint::normal::{NormalEquations, ReducedView};
use crate::estimation::normal_probability::normal_probability;
use crate::estimation::rgbd::corners::CornerBlocks;
use crate::estimation::rgbd::planes::{Fit, Planes, scaled};

/// A lens or pose that the form of the correction moves by more than this many standard deviations
/// is known no better than that; at this many it counts by half, as how far it is moved is known to
/// one.
const FORM_LIMIT: f64 = 3.0;

impl Planes<'_> {
    /// The covariance of lens and pose by planes: by the tiles' scatter, by that of the views,
    /// which share what the model leaves of depth's error, and by that of the corners' answer,
    /// which moves all planes of a view together and, through color's lens, those of all views.
    pub(super) fn covariance(&self, corners: &CornerBlocks, fit: &Fit) -> Option<DMatrix<f64>> {
        let unscaled = fit.equations.global_covariance()?;
        let views: Option<Vec<ReducedView>> =
            self.planes.iter().map(|plane| self.part(fit, plane)).collect();
        let square = fit.together * fit.together;
        let own = FitCovariance::of_views(unscaled.clone(), square, &views?).all();
        let size = own.nrows();
        let mut by_lens = DMatrix::zeros(size, corners.covariance.nrows());
        // The planes' equations hold the corners' of each pose, and so its own scatter: what is
        // left is that of color's lens, which moves the corners' poses of all views.
        for (frame_set, block) in fit.equations.frame_sets.iter().enumerate() {
            let Some(factor) = Matrix6::from_fn(|a, b| block.hessian[a][b]).cholesky() else {
                continue;
            };
            let (planes, corners) =
                (fit.equations.coupling_of(frame_set), corners.equations.coupling_of(frame_set));
            let coupled = DMatrix::from_fn(size, 6, |k, a| planes[k][a]);
            let inverse = factor.inverse();
            let inverse = DMatrix::from_fn(6, 6, |a, b| inverse[(a, b)]);
            let through = DMatrix::from_fn(6, by_lens.ncols(), |a, k| corners[k][a]);
            by_lens += &coupled * inverse * through;
        }
        let moved = &unscaled * by_lens;
        Some(own + &moved * &corners.covariance * moved.transpose())
    }

    /// What a view's plane says by itself, the board's pose eliminated.
    fn part(&self, fit: &Fit, plane: &PlaneObservation) -> Option<ReducedView> {
        let at = self.layout.len;
        let layout = Layout { len: at + fit.correction.coefficients.len(), ..self.layout.clone() };
        let frame_set = plane.frame_set;
        let mut alone = NormalEquations::empty(layout.len, fit.state.rig_from_board.len());
        let observations = [scaled(plane, fit.tile_noise)];
        add_planes(
            &mut alone,
            LinearizationPoint { layout: &layout, state: &fit.state },
            CorrectionColumns { correction: &fit.correction, first: at },
            &observations,
            self.anchors.is_some(),
        );
        if let Some(anchor) = self.anchors.as_ref().and_then(|anchors| anchors.get(frame_set)) {
            let pose = &fit.state.rig_from_board[frame_set];
            anchor.hold(pose, &mut alone.cost, &mut alone.frame_sets[frame_set]);
        }
        alone.mirror();
        alone.reduced(frame_set)
    }

    /// What another form of the correction does to lens and pose, as their variances, times how
    /// likely it is that this is beyond chance.
    pub(super) fn by_form(
        &self,
        fit: &Fit,
        other: Option<&Fit>,
        covariance: &DMatrix<f64>,
    ) -> DMatrix<f64> {
        let sensor = &self.layout.sensors[1];
        let mut step = nalgebra::DVector::zeros(covariance.nrows());
        if let Some(other) = other {
            let [before, after] = [fit, other].map(|fit| fit.state.lenses[1].parameters());
            for (k, index) in sensor.lens.free.iter().enumerate() {
                step[sensor.lens_at + k] = after[*index] - before[*index];
            }
            if let Some(at) = sensor.pose_at {
                let [before, after] = [fit, other].map(|fit| fit.state.sensor_from_rig[1]);
                let rotation = (after.rotation() * before.rotation().inverse()).scaled_axis();
                let translation = after.translation() - before.translation();
                (0..3)
                    .for_each(|k| (step[at + k], step[at + 3 + k]) = (rotation[k], translation[k]));
            }
        }
        let in_deviations = (0..step.len())
            .map(|k| step[k].abs() / covariance[(k, k)].max(f64::MIN_POSITIVE).sqrt());
        let beyond_chance = normal_probability(in_deviations.fold(0.0, f64::max) - FORM_LIMIT);
        &step * step.transpose() * beyond_chance
    }
}
