//! The covariance of a depth camera's lens and pose estimated from planes.

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

/// Where another form of the correction changes lens or pose by more than this many standard
/// deviations, the change is added to their uncertainty. At exactly this many it counts by half, as
/// the change itself is known to one standard deviation.
const FORM_LIMIT_STDS: f64 = 3.0;

impl Planes<'_> {
    /// The covariance of lens and pose from planes: from the tiles' scatter; from the scatter
    /// between views, which share the error of depth that the model leaves; and from the covariance
    /// of the corners' estimate, which moves all planes of a view together and, through color's
    /// lens, those of all views.
    pub(super) fn covariance(&self, corners: &CornerBlocks, fit: &Fit) -> Option<DMatrix<f64>> {
        let unscaled = fit.equations.global_covariance()?;
        let views: Option<Vec<ReducedView>> =
            self.planes.iter().map(|plane| self.part(fit, plane)).collect();
        let square = fit.together * fit.together;
        let own = FitCovariance::of_views(unscaled.clone(), square, &views?);
        let own = self.with_jackknife(fit, &own);
        let (size, free) = (unscaled.nrows(), self.layout.len);
        let mut by_lens = DMatrix::zeros(size, corners.covariance.nrows());
        // The planes' equations contain the corners' for each pose, and thus the scatter of that
        // pose. What remains is the uncertainty of color's lens, which moves the corners' poses of
        // all views.
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

    /// The covariance of lens and pose by a jackknife over the planes, with the weight of the
    /// scatter between views. The first-order covariance, `own`, keeps the inlier tiles and their
    /// scatter fixed, and limits the steps of views that alone determine a part of the correction.
    fn with_jackknife(&self, fit: &Fit, own: &FitCovariance) -> DMatrix<f64> {
        let free = self.layout.len;
        let [of_both, of_all] = [free, own.unit.nrows()].map(|size| own.block(0..size));
        let to_first_order = of_all.covariance.view((0, 0), (free, free)).into_owned();
        // Views with different errors of depth may agree about lens and pose by chance.
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

    /// The step from the lens and pose of one fit to those of another.
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

    /// The information of one view's plane alone, the board's pose eliminated.
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

    /// The change of lens and pose with another form of the correction, squared to a covariance and
    /// multiplied by the probability that it is beyond chance.
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
        let beyond_chance = normal_probability(in_deviations.fold(0.0, f64::max) - FORM_LIMIT_STDS);
        &step * step.transpose() * beyond_chance
    }
}
