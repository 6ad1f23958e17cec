//! The covariance of the lens where observations have errors in common: those of one image, of one
//! part of the scene, or of one region of all images. It is the clustered covariance of K.-Y. Liang
//! and S. L. Zeger, 1986, in each of these ways, with the excesses added (A. C. Cameron, J. Gelbach
//! and D. Miller, *Robust inference with multiway clustering*, 2011). Errors that observations
//! share in two ways at once are counted twice, because in photographs errors reach further than
//! any cluster.

use nalgebra::{DMatrix, DVector, Matrix2, Matrix2xX, Matrix3, Matrix3xX, SymmetricEigen};

use crate::estimation::scene::bundle::{Bundle, PixelRow, SceneState};
use crate::estimation::scene::parts::{PARTS, scene_parts};
use crate::geometry::pixel::{ImageSize, Pixel};

/// The effect of common errors on the lens, in whitened parameters of the lens, whose covariance is
/// the identity.
pub(super) struct SharedErrors {
    /// The part of that covariance that comes from observations with independent errors of their
    /// stated standard deviations. The rest comes from priors.
    pub(super) observed: DMatrix<f64>,
    /// The covariance from common errors, beyond that from independent ones.
    pub(super) excess: DMatrix<f64>,
}

impl SharedErrors {
    /// At the minimum `state` of `bundle`, whose observations have standard deviations √`widened`
    /// times their true ones. `steps` maps the gradient of all parameters to whitened lens
    /// parameters.
    pub(super) fn of(
        bundle: &Bundle,
        state: &SceneState,
        steps: &DMatrix<f64>,
        widened: f64,
    ) -> Self {
        let clusters = Clusters::of(bundle, state, steps);
        let observed: DMatrix<f64> = clusters.by_part.iter().map(|cluster| &cluster.expected).sum();
        // Points and poses absorb a part of the errors that the images of a point share; a residual
        // retains `free_part` of them, on average. So the variance of clusters of residuals beyond
        // chance is that of the errors times the square of this part.
        let kept = bundle.free_part(state.cameras_from_scene.len()).powi(2);
        let by_themselves = &observed / widened;
        let mut excess = DMatrix::zeros(observed.nrows(), observed.ncols());
        for way in [&clusters.by_image, &clusters.by_part, &clusters.by_region] {
            if let Some(ClusterSpread { covariance, wider }) = clustered(way, &observed) {
                excess += (covariance - &by_themselves) * (wider / kept);
            }
        }
        Self { observed, excess }
    }

    /// The mean of the excess over all directions, relative to `observed`.
    pub(super) fn mean(&self) -> f64 {
        self.excess.trace() / self.observed.trace().max(f64::MIN_POSITIVE)
    }
}

/// The effect of a cluster of observations on the lens, in standard deviations of the lens: its
/// step (the pull), and the covariance that the pull has with independent errors.
#[derive(Clone)]
struct Cluster {
    pull: DVector<f64>,
    expected: DMatrix<f64>,
}

/// Three ways to cluster the same observations.
struct Clusters {
    by_image: Vec<Cluster>,
    by_part: Vec<Cluster>,
    by_region: Vec<Cluster>,
}

/// Regions along each side of the image: the misfit of a lens model changes over such lengths.
const REGIONS: usize = 4;

impl Clusters {
    /// `steps` maps the gradient of all parameters to whitened lens parameters.
    fn of(bundle: &Bundle, state: &SceneState, steps: &DMatrix<f64>) -> Self {
        let lens = steps.ncols();
        let empty = Cluster { pull: DVector::zeros(lens), expected: DMatrix::zeros(lens, lens) };
        let mut clusters = Self {
            by_image: vec![empty.clone(); state.cameras_from_scene.len()],
            by_part: vec![empty.clone(); PARTS],
            by_region: vec![empty; REGIONS * REGIONS],
        };
        let parts = scene_parts(&state.points);
        for (point, part) in parts.into_iter().enumerate() {
            let rows = bundle.rows(state, point);
            let Some(influences) = influences(bundle, state, point, &rows, steps) else {
                continue;
            };
            for (row, ImageInfluence { by_residual, kept }) in rows.iter().zip(&influences) {
                let pull = by_residual.tr_mul(&row.residual);
                let expected = by_residual.tr_mul(&(kept * by_residual));
                clusters.by_image[row.camera].add(&pull, &expected);
                let region = region(row.pixel, bundle.prior.image_size);
                clusters.by_region[region].add(&pull, &expected);
                // All rows of a point together: the covariance of their residuals is a projection.
                let whole = by_residual.tr_mul(by_residual);
                clusters.by_part[part].add(&pull, &whole);
            }
        }
        clusters
    }
}

impl Cluster {
    fn add(&mut self, pull: &DVector<f64>, expected: &DMatrix<f64>) {
        self.pull += pull;
        self.expected += expected;
    }

    /// The step of the lens, in standard deviations, if this cluster is left out: its pull,
    /// corrected for how far the fit has already followed the cluster (M. McCaffrey and R. Bell,
    /// *Bias reduction in standard errors for linear regression with multi-stage samples*, 2002:
    /// the jackknife).
    fn left_out(&self) -> DVector<f64> {
        let mut eigen = SymmetricEigen::new(self.expected.clone());
        eigen.eigenvalues.iter_mut().for_each(|own| *own = 1.0 / (1.0 - *own).max(LEAST_OTHERS));
        eigen.recompose() * &self.pull
    }
}

/// A lower limit on the part of the information that comes from the other clusters. Below it,
/// leaving a cluster out shows nothing.
const LEAST_OTHERS: f64 = 0.1;

/// The least degrees of freedom that are assumed for few clusters: with fewer, Student's t has no
/// variance.
const LEAST_FREEDOM: f64 = 3.0;

/// The scatter of clusters.
struct ClusterSpread {
    covariance: DMatrix<f64>,
    /// The factor on variances for their estimation from few clusters: the variance of Student's t
    /// with as many degrees of freedom.
    wider: f64,
}

/// The clustered covariance, in whitened parameters; `observed` is the covariance with independent
/// errors. Few clusters determine single directions poorly, so the matrix is shrunk towards a
/// multiple of `observed`. The weight of the latter is the number of parameters over that of
/// parameters and degrees of freedom. `None` of fewer than two clusters.
fn clustered(clusters: &[Cluster], observed: &DMatrix<f64>) -> Option<ClusterSpread> {
    let lens = clusters[0].pull.len();
    let used = clusters.iter().filter(|cluster| cluster.expected.trace() > 0.0).count() as f64;
    if used < 2.0 {
        return None;
    }
    let (mut seen, mut expected) = (DMatrix::<f64>::zeros(lens, lens), 0.0);
    for cluster in clusters {
        let pull = cluster.left_out();
        seen += &pull * pull.transpose();
        expected += cluster.expected.trace();
    }
    let over_expected = (1.0 - 1.0 / used) / expected.max(f64::MIN_POSITIVE);
    let mean = seen.trace() * over_expected;
    let freedom = used - 1.0;
    let own = freedom / (freedom + lens as f64);
    let covariance =
        seen * (own * over_expected * observed.trace()) + observed * (mean * (1.0 - own));
    let of_t = |freedom: f64| freedom.max(LEAST_FREEDOM) / (freedom.max(LEAST_FREEDOM) - 2.0);
    let wider = own * of_t(freedom) + (1.0 - own) * of_t(freedom * lens as f64);
    let is_finite = covariance.iter().all(|value| value.is_finite());
    is_finite.then_some(ClusterSpread { covariance, wider })
}

/// The region of the image that contains `pixel`.
fn region(pixel: Pixel, size: ImageSize) -> usize {
    let cell = |at: f64, length: u32| {
        let part = at / f64::from(length.max(1));
        ((part * REGIONS as f64).max(0.0) as usize).min(REGIONS - 1)
    };
    cell(pixel.y, size.height) * REGIONS + cell(pixel.x, size.width)
}

/// The effect of one observation on the lens, its point eliminated.
struct ImageInfluence {
    /// Whitened lens parameters per residual.
    by_residual: Matrix2xX<f64>,
    /// I − Jp V⁻¹ Jpᵀ: the part of a residual that remains after the point is fitted.
    kept: Matrix2<f64>,
}

/// The influence of each of the rows of a point.
fn influences(
    bundle: &Bundle,
    state: &SceneState,
    point: usize,
    rows: &[PixelRow],
    steps: &DMatrix<f64>,
) -> Option<Vec<ImageInfluence>> {
    let mut block = Matrix3::zeros();
    for row in rows {
        block += row.by_point.tr_mul(&row.by_point);
    }
    let held = bundle.held_length(&block, &state.points[point]);
    let inverse = (block + held).try_inverse()?;
    let lens = bundle.free.len();
    let carried = |row: &PixelRow| {
        let mut all: Matrix2xX<f64> = row.by_lens.columns(0, lens) * steps.rows(0, lens);
        if let Some(start) = bundle.pose_start(row.camera) {
            all += row.by_pose * steps.fixed_rows::<6>(start);
        }
        all
    };
    let carried: Vec<Matrix2xX<f64>> = rows.iter().map(carried).collect();
    let mut by_point = Matrix3xX::zeros(steps.ncols());
    for (row, carried) in rows.iter().zip(&carried) {
        by_point += row.by_point.tr_mul(carried);
    }
    let by_point = inverse * by_point;
    let influence = |(row, carried): (&PixelRow, Matrix2xX<f64>)| ImageInfluence {
        by_residual: carried - row.by_point * &by_point,
        kept: Matrix2::identity() - row.by_point * inverse * row.by_point.transpose(),
    };
    Some(rows.iter().zip(carried).map(influence).collect())
}
