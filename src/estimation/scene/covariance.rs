//! How well the images determine the lens: the covariance of the lens from that of everything, and
//! whether observations of one image, or of one region of an image, err together.

use nalgebra::{DMatrix, DVector, Matrix2, Matrix3, SMatrix};

use crate::estimation::scene::bundle::{Bundle, CameraMotion, Row, SceneState};
use crate::geometry::lens::MAX_PARAMETERS;

/// What is known of the lens.
#[derive(Debug, Clone, PartialEq)]
pub struct LensCovariance {
    /// Of the free parameters, in their order, in squared pixels and so on; with everything below.
    pub matrix: DMatrix<f64>,
    /// The factor on the variances because observations of one image err together, 1 or more.
    pub shared_by_image: f64,
    /// The factor because the observations of one scene point err together, 1 or more.
    pub shared_by_point: f64,
}

/// The covariance of the lens at the minimum `state` of `bundle`, whose observations have their true
/// standard deviations; `None` where something is not determined at all.
pub fn lens_covariance(bundle: &Bundle, state: &SceneState) -> Option<LensCovariance> {
    let reduced = bundle.reduced(state, 0.0);
    let kept = kept_parameters(bundle, state);
    let matrix = reduced.matrix.select_rows(&kept).select_columns(&kept);
    let covariance = matrix.cholesky()?.inverse();
    let lens = bundle.free.len();
    let own = covariance.view((0, 0), (lens, lens)).into_owned();
    if own.iter().any(|v| !v.is_finite()) || (0..lens).any(|k| own[(k, k)] <= 0.0) {
        return None;
    }
    let pulls = Pulls {
        covariance: covariance.rows(0, lens).into_owned(),
        own: own.clone().cholesky()?.inverse(),
    };
    let scores = Scores::of(bundle, state, &kept);
    let shared_by_image = pulls.factor(&scores.by_image);
    let shared_by_point = pulls.factor(&scores.by_group);
    let matrix = own * shared_by_image.max(shared_by_point);
    Some(LensCovariance { matrix, shared_by_image, shared_by_point })
}

/// All parameters but one that fixes the scene's scale: the longest coordinate of the translation
/// of the camera farthest from the first.
fn kept_parameters(bundle: &Bundle, state: &SceneState) -> Vec<usize> {
    let size = bundle.size(state.cameras_from_scene.len());
    let first = state.cameras_from_scene[0];
    let distance = |k: &usize| {
        let moved = state.cameras_from_scene[*k] * first.inverse();
        moved.translation().norm()
    };
    let farthest = (1..state.cameras_from_scene.len())
        .max_by(|a, b| distance(a).total_cmp(&distance(b)))
        .filter(|_| bundle.motion == CameraMotion::Moving);
    let fixed = farthest.and_then(|camera| {
        let longest = state.cameras_from_scene[camera].translation().iamax();
        Some(bundle.pose_start(camera)? + 3 + longest)
    });
    (0..size).filter(|k| Some(*k) != fixed).collect()
}

/// The pull of a group of observations on all parameters, points eliminated, and the covariance it
/// has if they err by themselves.
struct Score {
    pull: DVector<f64>,
    information: DMatrix<f64>,
}

struct Scores {
    by_image: Vec<Score>,
    by_group: Vec<Score>,
}

/// Points are dealt into this many groups: few enough that a group's information is worth its
/// memory, many enough to tell what they differ by.
const GROUPS: usize = 24;

impl Scores {
    fn of(bundle: &Bundle, state: &SceneState, kept: &[usize]) -> Self {
        let size = bundle.size(state.cameras_from_scene.len());
        let cameras = state.cameras_from_scene.len();
        let empty = || (DVector::zeros(size), DMatrix::zeros(size, size));
        let mut by_image: Vec<_> = (0..cameras).map(|_| empty()).collect();
        let mut by_group: Vec<_> = (0..GROUPS).map(|_| empty()).collect();
        for point in 0..state.points.len() {
            let rows = bundle.rows(state, point);
            let Some(projected) = Projected::of(bundle, &rows, size) else { continue };
            for (row, (jacobian, leverage)) in rows.iter().zip(&projected.rows) {
                let information = jacobian.tr_mul(&(leverage * jacobian));
                let pull = jacobian.tr_mul(&row.residual);
                let image = &mut by_image[row.camera];
                image.0 += &pull;
                image.1 += &information;
                let group = &mut by_group[point % GROUPS];
                group.0 += pull;
                group.1 += information;
            }
        }
        let score = |(pull, information): (DVector<f64>, DMatrix<f64>)| Score {
            pull: pull.select_rows(kept),
            information: information.select_rows(kept).select_columns(kept),
        };
        Self {
            by_image: by_image.into_iter().map(score).collect(),
            by_group: by_group.into_iter().map(score).collect(),
        }
    }
}

/// The rows of one point with the point eliminated.
struct Projected {
    /// By all parameters, and I − Jp V⁻¹ Jpᵀ: the part of a residual that the point leaves.
    rows: Vec<(DMatrix<f64>, Matrix2<f64>)>,
}

impl Projected {
    fn of(bundle: &Bundle, rows: &[Row], size: usize) -> Option<Self> {
        let mut block = Matrix3::zeros();
        for row in rows {
            block += row.by_point.tr_mul(&row.by_point);
        }
        let inverse = block.try_inverse()?;
        let lens = bundle.free.len();
        let mut by_lens = SMatrix::<f64, 3, MAX_PARAMETERS>::zeros();
        for row in rows {
            by_lens += row.by_point.tr_mul(&row.by_lens);
        }
        let projected = |row: &Row| {
            let mut jacobian = DMatrix::zeros(2, size);
            let own = row.by_lens - row.by_point * inverse * by_lens;
            jacobian.view_mut((0, 0), (2, lens)).copy_from(&own.columns(0, lens));
            for other in rows {
                let Some(start) = bundle.pose_start(other.camera) else { continue };
                let carried = row.by_point * inverse * other.by_point.tr_mul(&other.by_pose);
                let mut view = jacobian.fixed_view_mut::<2, 6>(0, start);
                view -= carried;
                if other.camera == row.camera {
                    view += row.by_pose;
                }
            }
            let taken = row.by_point * inverse * row.by_point.transpose();
            (jacobian, Matrix2::identity() - taken)
        };
        Some(Self { rows: rows.iter().map(projected).collect() })
    }
}

/// What scores do to the lens, in units of its own covariance.
struct Pulls {
    /// The lens's rows of the covariance of everything.
    covariance: DMatrix<f64>,
    /// The inverse of the lens's own covariance.
    own: DMatrix<f64>,
}

impl Pulls {
    /// How much greater the pulls of groups are than if observations erred by themselves, as a
    /// factor on variances, 1 or more: a scalar form of the clustered covariance of K.-Y. Liang and
    /// S. L. Zeger, 1986.
    fn factor(&self, scores: &[Score]) -> f64 {
        let (mut seen, mut expected) = (0.0, 0.0);
        for score in scores {
            let pull = &self.covariance * &score.pull;
            seen += pull.dot(&(&self.own * &pull));
            let carried = &self.covariance * &score.information;
            expected += (&self.own * (&carried * self.covariance.transpose())).trace();
        }
        // Of each parameter the fit itself has taken one sum up: pulls add up to 0.
        let groups = scores.iter().filter(|score| score.information.trace() > 0.0).count() as f64;
        let expected = expected * (1.0 - 1.0 / groups.max(2.0));
        let factor = seen / expected;
        if factor.is_finite() { factor.max(1.0) } else { 1.0 }
    }
}
