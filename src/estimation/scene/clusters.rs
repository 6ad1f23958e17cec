//! Whether observations of one image, of one part of the scene, or of one region of all images, err
//! together: the clustered covariance of K.-Y. Liang and S. L. Zeger, 1986, each way, the excesses
//! added (A. C. Cameron, J. Gelbach and D. Miller, *Robust inference with multiway clustering*,
//! 2011). What observations share in two ways at once is counted twice: on photographs errors reach
//! farther than any cluster.

use nalgebra::{DMatrix, DVector, Matrix2, Matrix2xX, Matrix3, Matrix3xX, SymmetricEigen};

use crate::estimation::scene::bundle::{Bundle, PixelRow, SceneState};
use crate::estimation::scene::parts::{PARTS, scene_parts};
use crate::geometry::pixel::{ImageSize, Pixel};

/// What observations that err together do to the lens, in whitened parameters of the lens: the
/// identity is their covariance.
pub(super) struct SharedErrors {
    /// What observations say of it, by themselves and with the standard deviations that they have;
    /// priors say the rest.
    pub(super) observed: DMatrix<f64>,
    /// The covariance because they err together, beyond what they do by themselves.
    pub(super) excess: DMatrix<f64>,
}

impl SharedErrors {
    /// At the minimum `state` of `bundle`, whose observations have standard deviations √`widened`
    /// times their true ones. `steps`: whitened lens parameters by pull on all parameters.
    pub(super) fn of(
        bundle: &Bundle,
        state: &SceneState,
        steps: &DMatrix<f64>,
        widened: f64,
    ) -> Self {
        let clusters = Clusters::of(bundle, state, steps);
        let observed: DMatrix<f64> = clusters.by_part.iter().map(|cluster| &cluster.expected).sum();
        // Points and poses take up what the images of a point share, and a residual keeps this
        // part of it, on average. What clusters of residuals vary by beyond chance is the square of
        // that part of what there is.
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

    /// The mean of the excess over all directions, as a part of what is observed.
    pub(super) fn mean(&self) -> f64 {
        self.excess.trace() / self.observed.trace().max(f64::MIN_POSITIVE)
    }
}

/// What a cluster of observations does to the lens, in standard deviations of the lens: its pull,
/// and the covariance that the pull has if observations err by themselves.
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

/// Regions along each side of the image: a lens model's misfit changes over lengths like these.
const REGIONS: usize = 4;

impl Clusters {
    /// `steps`: whitened lens parameters by pull on all parameters.
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
                // All rows of a point together: their residuals' covariance is a projection.
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

    /// How far the lens moves, in standard deviations, if this cluster is left out: its pull, but
    /// for what the fit has already given way to it (M. McCaffrey and R. Bell, *Bias reduction in
    /// standard errors for linear regression with multi-stage samples*, 2002: the jackknife).
    fn left_out(&self) -> DVector<f64> {
        let mut eigen = SymmetricEigen::new(self.expected.clone());
        eigen.eigenvalues.iter_mut().for_each(|own| *own = 1.0 / (1.0 - *own).max(LEAST_OTHERS));
        eigen.recompose() * &self.pull
    }
}

/// Where the other clusters say less than this part of what all say, nothing can be learned from
/// leaving one out.
const LEAST_OTHERS: f64 = 0.1;

/// Degrees of freedom that few clusters are taken for at least: with fewer, Student's t has no
/// variance.
const LEAST_FREEDOM: f64 = 3.0;

/// What clusters show.
struct ClusterSpread {
    covariance: DMatrix<f64>,
    /// The factor on variances because it is estimated from few clusters: the variance of Student's
    /// t for as many.
    wider: f64,
}

/// The clustered covariance, in the frame of whitened parameters, where observations say
/// `observed`. Few clusters say little of single directions: the matrix is drawn towards its mean
/// by the part that the number of parameters has of parameters and clusters. `None` of fewer than
/// two clusters.
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

/// The region of the image that `pixel` lies in.
fn region(pixel: Pixel, size: ImageSize) -> usize {
    let cell = |at: f64, length: u32| {
        let part = at / f64::from(length.max(1));
        ((part * REGIONS as f64).max(0.0) as usize).min(REGIONS - 1)
    };
    cell(pixel.y, size.height) * REGIONS + cell(pixel.x, size.width)
}

/// What one observation does to the lens, its point eliminated.
struct ImageInfluence {
    /// Whitened lens parameters by the residual.
    by_residual: Matrix2xX<f64>,
    /// I − Jp V⁻¹ Jpᵀ: the part of a residual that the point leaves.
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
