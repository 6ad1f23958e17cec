//! How well the images determine the lens: the covariance of the lens from that of everything, and
//! whether observations of one image, of one part of the scene, or of one region of all images, err
//! together.

use nalgebra::{DMatrix, DVector, Matrix2, Matrix2xX, Matrix3, Matrix3xX, Point3, SymmetricEigen};

use crate::estimation::scene::bundle::{Bundle, CameraMotion, PixelRow, SceneState};
use crate::geometry::pixel::{ImageSize, Pixel};

/// What is known of the lens.
#[derive(Debug, Clone, PartialEq)]
pub struct LensCovariance {
    /// Of the free parameters, in their order, in squared pixels and so on; with everything below.
    pub matrix: DMatrix<f64>,
    /// What it is if each observation errs by itself.
    pub independent: DMatrix<f64>,
    /// The factor on the variances because observations err together, the mean over all directions,
    /// 1 or more.
    pub shared: f64,
}

/// The covariance of the lens at the minimum `state` of `bundle`, whose observations have their
/// true standard deviations; `None` where something is not determined at all.
///
/// Observations err together by image (motion blur, rolling shutter), by part of the scene (what
/// moves, surfaces seen at a slant, edges before a background, wrong matches) and by region of the
/// image (what the lens model does not follow): the clustered
/// covariance of K.-Y. Liang and S. L. Zeger, 1986, each way, the excesses added (A. C. Cameron, J.
/// Gelbach and D. Miller, *Robust inference with multiway clustering*, 2011).
pub fn lens_covariance(bundle: &Bundle, state: &SceneState) -> Option<LensCovariance> {
    let reduced = bundle.reduced(state, 0.0);
    let kept = kept_parameters(bundle, state);
    let matrix = reduced.matrix.select_rows(&kept).select_columns(&kept);
    let covariance = matrix.cholesky()?.inverse();
    let lens = bundle.free.len();
    let independent = covariance.view((0, 0), (lens, lens)).into_owned();
    let positive = (0..lens).all(|k| independent[(k, k)] > 0.0);
    if !positive || independent.iter().any(|v| !v.is_finite()) {
        return None;
    }
    if lens == 0 {
        return Some(LensCovariance { matrix: independent.clone(), independent, shared: 1.0 });
    }
    let root = independent.clone().cholesky()?.l();
    let whitening = root.clone().try_inverse()?;
    let mut steps = DMatrix::zeros(bundle.size(state.cameras_from_scene.len()), lens);
    let whitened = covariance.columns(0, lens) * whitening.transpose();
    for (row, place) in kept.iter().enumerate() {
        steps.row_mut(*place).copy_from(&whitened.row(row));
    }
    let inflation = Clusters::of(bundle, state, &steps).inflation();
    let shared = inflation.trace() / lens as f64;
    let matrix = &root * inflation * root.transpose();
    Some(LensCovariance { matrix, independent, shared })
}

/// All parameters but the one that fixes the scene's scale.
fn kept_parameters(bundle: &Bundle, state: &SceneState) -> Vec<usize> {
    let fixed = scale_parameter(bundle, state);
    let size = bundle.size(state.cameras_from_scene.len());
    (0..size).filter(|k| Some(*k) != fixed).collect()
}

/// The parameter that fixes the scene's scale: the longest coordinate of the translation of the
/// camera farthest from the first. `None` where there is no scale.
pub(super) fn scale_parameter(bundle: &Bundle, state: &SceneState) -> Option<usize> {
    let first = state.cameras_from_scene[0];
    let distance = |k: &usize| {
        let moved = state.cameras_from_scene[*k] * first.inverse();
        moved.translation().norm()
    };
    let farthest = (1..state.cameras_from_scene.len())
        .max_by(|a, b| distance(a).total_cmp(&distance(b)))
        .filter(|_| bundle.motion == CameraMotion::Moving);
    let camera = farthest?;
    let longest = state.cameras_from_scene[camera].translation().iamax();
    Some(bundle.pose_start(camera)? + 3 + longest)
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

/// How often the scene is halved into parts whose points are one cluster each: 32 parts are many
/// enough to estimate what they differ by, and large enough to hold a thing or a surface.
const HALVINGS: u32 = 5;

/// The part of the scene that each point lies in: the scene is halved at the median of its longest
/// extent, the halves likewise, and so on.
pub(super) fn scene_parts(points: &[Point3<f64>]) -> Vec<usize> {
    let mut parts = vec![0; points.len()];
    let mut split: Vec<Vec<usize>> = vec![(0..points.len()).collect()];
    for _ in 0..HALVINGS {
        split = split.into_iter().flat_map(|part| halved(points, part)).collect();
    }
    for (number, part) in split.iter().enumerate() {
        part.iter().for_each(|point| parts[*point] = number);
    }
    parts
}

/// Both halves of a part of the scene.
fn halved(points: &[Point3<f64>], mut part: Vec<usize>) -> [Vec<usize>; 2] {
    let extent = |axis: &usize| {
        let (low, high) = part
            .iter()
            .map(|k| points[*k][*axis])
            .fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), at| {
                (low.min(at), high.max(at))
            });
        high - low
    };
    let longest = (0..3).max_by(|a, b| extent(a).total_cmp(&extent(b))).unwrap_or(0);
    part.sort_by(|a, b| points[*a][longest].total_cmp(&points[*b][longest]).then(a.cmp(b)));
    let upper = part.split_off(part.len() / 2);
    [part, upper]
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
            by_part: vec![empty.clone(); 1 << HALVINGS],
            by_region: vec![empty; REGIONS * REGIONS],
        };
        let parts = scene_parts(&state.points);
        for (point, part) in parts.into_iter().enumerate() {
            let rows = bundle.rows(state, point);
            let Some(influences) = influences(bundle, state, (point, &rows), steps) else {
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

    /// The covariance of the whitened lens parameters: the identity where all observations err by
    /// themselves.
    fn inflation(&self) -> DMatrix<f64> {
        let lens = self.by_part[0].pull.len();
        let identity = DMatrix::<f64>::identity(lens, lens);
        let mut total = identity.clone();
        for clusters in [&self.by_image, &self.by_part, &self.by_region] {
            total += clustered(clusters) - &identity;
        }
        let mut eigen = SymmetricEigen::new(total);
        eigen.eigenvalues.iter_mut().for_each(|value| *value = value.max(1.0));
        eigen.recompose()
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

/// The clustered covariance over the expected one, in the frame of whitened parameters. Few
/// clusters say little of single directions: the matrix is drawn towards its mean by the part that
/// the number of parameters has of parameters and clusters.
fn clustered(clusters: &[Cluster]) -> DMatrix<f64> {
    let lens = clusters[0].pull.len();
    let used = clusters.iter().filter(|cluster| cluster.expected.trace() > 0.0).count() as f64;
    let identity = DMatrix::<f64>::identity(lens, lens);
    if used < 2.0 {
        return identity;
    }
    let (mut seen, mut expected) = (DMatrix::<f64>::zeros(lens, lens), 0.0);
    for cluster in clusters {
        let pull = cluster.left_out();
        seen += &pull * pull.transpose();
        expected += cluster.expected.trace();
    }
    let seen = seen * (1.0 - 1.0 / used);
    let ratio = seen * (lens as f64 / expected.max(f64::MIN_POSITIVE));
    let mean = (ratio.trace() / lens as f64).max(1.0);
    let own = (used - 1.0) / (used - 1.0 + lens as f64);
    let drawn = ratio * own + &identity * (mean * (1.0 - own));
    // One estimated from few clusters varies: the variance of Student's t for as many.
    let freedom = (used - 1.0) * lens as f64;
    let wider = freedom / (freedom - 2.0).max(1.0);
    let finite = drawn.iter().all(|value| value.is_finite());
    if finite { drawn * wider } else { identity }
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
    (point, rows): (usize, &[PixelRow]),
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
