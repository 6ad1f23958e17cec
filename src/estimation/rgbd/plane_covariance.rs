//! The covariance of a depth camera's lens and pose by planes.

use nalgebra::{DMatrix, DVector, Matrix6};

use crate::estimation::clustered_covariance::FitCovariance;
use crate::estimation::jackknife::scatter_without_views;
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
        let own = FitCovariance::of_views(unscaled.clone(), square, &views?);
        let own = self.with_jackknife(fit, &own);
        let (size, free) = (unscaled.nrows(), self.layout.len);
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
        let moved = unscaled.rows(0, free) * by_lens;
        Some(own + &moved * &corners.covariance * moved.transpose())
    }

    /// The covariance of lens and pose as fits without some of the planes show it, as far as views
    /// differ. To first order (`own`) the tiles that are believed and their scatter are held, and
    /// the steps of views that alone determine a part of the correction are cut short.
    fn with_jackknife(&self, fit: &Fit, own: &FitCovariance) -> DMatrix<f64> {
        let free = self.layout.len;
        let [of_both, of_all] = [free, own.unit.nrows()].map(|size| own.block(0..size));
        let to_first_order = of_all.covariance.view((0, 0), (free, free)).into_owned();
        // Views that differ in what they say of depth's error may agree about lens and pose by
        // chance.
        let weight = of_both.weight.max(of_all.weight);
        if !(weight > 0.0) {
            return to_first_order;
        }
        let by_fits = scatter_without_views(self.planes.len(), |is_kept| {
            let fit_of_kept = self.of_views(is_kept).fit_again(fit)?;
            Some(self.step(fit, &fit_of_kept))
        });
        match by_fits {
            Some(by_fits) => to_first_order * (1.0 - weight) + by_fits * weight,
            None => to_first_order,
        }
    }

    /// From the lens and pose of one fit to those of another.
    fn step(&self, fit: &Fit, other: &Fit) -> DVector<f64> {
        let sensor = &self.layout.sensors[1];
        let mut step = DVector::zeros(self.layout.len);
        let [before, after] = [fit, other].map(|fit| fit.state.lenses[1].parameters());
        for (k, index) in sensor.lens.free.iter().enumerate() {
            step[sensor.lens_at + k] = after[*index] - before[*index];
        }
        if let Some(at) = sensor.pose_at {
            let [before, after] = [fit, other].map(|fit| fit.state.sensor_from_rig[1]);
            let rotation = (after.rotation() * before.rotation().inverse()).scaled_axis();
            let translation = after.translation() - before.translation();
            (0..3).for_each(|k| (step[at + k], step[at + 3 + k]) = (rotation[k], translation[k]));
        }
        step
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
        let step =
            other.map_or_else(|| DVector::zeros(covariance.nrows()), |other| self.step(fit, other));
        let in_deviations = (0..step.len())
            .map(|k| step[k].abs() / covariance[(k, k)].max(f64::MIN_POSITIVE).sqrt());
        let beyond_chance = normal_probability(in_deviations.fold(0.0, f64::max) - FORM_LIMIT);
        &step * step.transpose() * beyond_chance
    }
}
