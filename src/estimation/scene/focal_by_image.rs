//! The focal length of each image by itself: a problem in which each image has its own factor on
//! the focal length. For one camera with one lens setting all factors are 1, except for their
//! noise.

use nalgebra::{DMatrix, DVector, Matrix3, SMatrix, Vector2, Vector3};

use crate::estimation::scene::bundle::{
    Bundle, BundleStop, CameraMotion, PixelRow, SceneObservation, SceneState,
};
use crate::estimation::scene::covariance::{lens_covariance, scale_parameter};
use crate::estimation::scene::robust_bundle::{CAUCHY, fit_robustly};
use crate::geometry::lens::{Lens, MAX_PARAMETERS};
use crate::geometry::pixel::Pixel;

/// The focal length that each image shows.
#[derive(Debug, Clone, PartialEq)]
pub struct FocalByImage {
    /// Per pose, the logarithm of the image's focal length over the common one.
    pub log_ratios: DVector<f64>,
    /// Their covariance. A common change of all is not determined.
    pub covariance: DMatrix<f64>,
}

/// The prior standard deviation of each logarithm: a factor of e, which is hardly a constraint. It
/// keeps the problem solvable where the common focal length is estimated too.
const LOG_FOCAL_STD: f64 = 1.0;

/// A limit for safety: fits end earlier, where a step is below [`SETTLED_STEP`]. Images enlarged by
/// up to 1.3 reach the focal length that they show within as many fits.
const MOST_FITS: usize = 4;

/// The fits end where a step of all logarithms is below this: a fifth of the least difference that
/// is reported.
const SETTLED_STEP: f64 = 1e-3;

const FIT_STOP: BundleStop = BundleStop { max_steps: 30, least_decrease: 1e-3 };

/// The focal lengths that the images show where they may differ by much, starting from `state`.
/// `bundle` has all observations, including those that are outliers for a common focal length. Each
/// image is scaled about the principal point to the mean focal length, until nothing changes.
pub fn separate_focals(bundle: &Bundle, state: &SceneState) -> Option<FocalByImage> {
    let mut scaled = bundle.clone();
    let mut state = state.clone();
    let mut log_ratios = DVector::zeros(state.cameras_from_scene.len());
    for _ in 0..MOST_FITS {
        scaled.rescaled(scaled.median_noise(&state));
        scaled.robust_limit = CAUCHY;
        state = scaled.minimize(state, FIT_STOP);
        // Observations may fit better now: outliers have little weight only relative to the true
        // noise.
        scaled.rescaled(scaled.median_noise(&state));
        let step = focal_by_image(&scaled, &state)?.log_ratios;
        let step = step.add_scalar(-step.mean());
        log_ratios += &step;
        scale_images(&mut scaled, bundle, &state, &log_ratios);
        if step.amax() < SETTLED_STEP {
            break;
        }
    }
    let mut last = fit_robustly(scaled, state, FIT_STOP);
    let shared = lens_covariance(&last.bundle, &last.state, 1.0)?.shared;
    last.bundle.rescaled(shared.sqrt());
    let found = focal_by_image(&last.bundle, &last.state)?;
    Some(FocalByImage { log_ratios: log_ratios + found.log_ratios, ..found })
}

/// Sets the observations to those of `bundle` as they would be if all images had one focal length.
fn scale_images(
    scaled: &mut Bundle,
    bundle: &Bundle,
    state: &SceneState,
    log_ratios: &DVector<f64>,
) {
    let center = state.lens.matrix;
    let scaled_one = |seen: &SceneObservation| {
        let scale = (-log_ratios[seen.camera]).exp();
        Pixel::new(
            center.cx + scale * (seen.pixel.x - center.cx),
            center.cy + scale * (seen.pixel.y - center.cy),
        )
    };
    let seen = bundle.observations.iter().flatten();
    let scaled = scaled.observations.iter_mut().flatten();
    scaled.zip(seen).for_each(|(scaled, seen)| scaled.pixel = scaled_one(seen));
}

/// The focal lengths by one step from the minimum `state` of `bundle`, whose observations have
/// their true standard deviations; `None` where they are not determined.
pub fn focal_by_image(bundle: &Bundle, state: &SceneState) -> Option<FocalByImage> {
    let mut free = bundle.free.clone();
    free.extend([Lens::FX, Lens::FY].into_iter().filter(|k| !bundle.free.contains(k)));
    let both = [Lens::FX, Lens::FY].map(|k| free.iter().position(|own| *own == k).unwrap_or(0));
    let with_focal = Bundle { free, ..bundle.clone() };
    let cameras = state.cameras_from_scene.len();
    let own = bundle.size(cameras);
    let (mut matrix, mut gradient) =
        (DMatrix::zeros(own + cameras, own + cameras), DVector::zeros(own + cameras));
    let focal = state.lens.matrix;
    for point in 0..state.points.len() {
        let rows = with_focal.rows(state, point);
        let columns: Vec<RowColumns> = rows
            .iter()
            .map(|row| {
                let by_focal =
                    row.by_lens.column(both[0]) * focal.fx + row.by_lens.column(both[1]) * focal.fy;
                RowColumns::of(bundle, row, by_focal, own + row.camera)
            })
            .collect();
        let of_point = PointRows { point, rows: &rows, columns: &columns };
        of_point.add_to(bundle, state, &mut matrix, &mut gradient);
    }
    bundle.add_prior(&state.lens, &mut matrix, &mut gradient);
    (own..own + cameras).for_each(|k| matrix[(k, k)] += LOG_FOCAL_STD.powi(-2));
    matrix.fill_upper_triangle_with_lower_triangle();
    let scale = scale_parameter(bundle, state);
    let lens = bundle.free.len();
    let is_translation = |k: usize| (lens..own).contains(&k) && (k - lens) % 6 >= 3;
    let rotates = bundle.motion == CameraMotion::RotationOnly;
    let is_kept = |k: &usize| Some(*k) != scale && !(rotates && is_translation(*k));
    let kept: Vec<usize> = (0..own + cameras).filter(is_kept).collect();
    let inverse = matrix.select_rows(&kept).select_columns(&kept).cholesky()?.inverse();
    let step = -(&inverse * gradient.select_rows(&kept));
    let first = kept.len() - cameras;
    let covariance = inverse.view((first, first), (cameras, cameras)).into_owned();
    let log_ratios = step.rows(first, cameras).into_owned();
    log_ratios.iter().all(|v| v.is_finite()).then_some(FocalByImage { log_ratios, covariance })
}

/// The columns of one observation, each with its index among all parameters: lens, pose, the
/// image's own focal length.
struct RowColumns(Vec<(usize, Vector2<f64>)>);

impl RowColumns {
    fn of(bundle: &Bundle, row: &PixelRow, by_focal: Vector2<f64>, index: usize) -> Self {
        let lens = bundle.free.len();
        let mut columns: Vec<(usize, Vector2<f64>)> = (0..lens.min(MAX_PARAMETERS))
            .map(|k| (k, row.by_lens.column(k).into_owned()))
            .collect();
        if let Some(start) = bundle.pose_start(row.camera) {
            columns.extend((0..6).map(|k| (start + k, row.by_pose.column(k).into_owned())));
        }
        columns.push((index, by_focal));
        Self(columns)
    }
}

/// The observations of a point, each with its columns.
struct PointRows<'a> {
    point: usize,
    rows: &'a [PixelRow],
    columns: &'a [RowColumns],
}

impl PointRows<'_> {
    /// Adds the rows to the lower triangle of `matrix`, and eliminates the point.
    fn add_to(
        &self,
        bundle: &Bundle,
        state: &SceneState,
        matrix: &mut DMatrix<f64>,
        gradient: &mut DVector<f64>,
    ) {
        let Self { point, rows, columns } = *self;
        let mut block = Matrix3::zeros();
        let mut point_gradient = Vector3::zeros();
        for row in rows {
            block += row.by_point.tr_mul(&row.by_point);
            point_gradient += row.by_point.tr_mul(&row.residual);
        }
        block += bundle.held_length(&block, &state.points[point]);
        let Some(inverse) = block.try_inverse() else { return };
        let mut mixed: Vec<(usize, Vector3<f64>)> = Vec::new();
        for (row, RowColumns(columns)) in rows.iter().zip(columns) {
            for (i, a) in columns {
                gradient[*i] += a.dot(&row.residual);
                let by_point: Vector3<f64> = row.by_point.tr_mul(a);
                match mixed.iter_mut().find(|(k, _)| k == i) {
                    Some((_, sum)) => *sum += by_point,
                    None => mixed.push((*i, by_point)),
                }
                for (j, b) in columns.iter().filter(|(j, _)| j <= i) {
                    matrix[(*i, *j)] += a.dot(b);
                }
            }
        }
        for (i, a) in &mixed {
            let carried: SMatrix<f64, 3, 1> = inverse * a;
            gradient[*i] -= carried.dot(&point_gradient);
            for (j, b) in mixed.iter().filter(|(j, _)| j <= i) {
                matrix[(*i, *j)] -= carried.dot(b);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::estimation::scene::bundle_tests::exact;

    fn enlarged(bundle: &mut Bundle, truth: &SceneState, camera: usize, by: f64) {
        let center = truth.lens.matrix;
        let all = bundle.observations.iter_mut().flatten();
        for seen in all.filter(|seen| seen.camera == camera) {
            let Pixel { x, y } = seen.pixel;
            seen.pixel =
                Pixel::new(center.cx + by * (x - center.cx), center.cy + by * (y - center.cy));
        }
    }

    #[test]
    fn images_of_quite_other_focal_lengths_are_found() {
        let (mut bundle, truth) = exact();
        bundle.free = vec![Lens::FX, Lens::FY];
        bundle.observations.iter_mut().flatten().for_each(|seen| seen.inverse_std *= 1e3);
        enlarged(&mut bundle, &truth, 1, 1.3);
        enlarged(&mut bundle, &truth, 2, 1.3);
        let found = separate_focals(&bundle, &truth).unwrap();
        let ratio = |k: usize| (found.log_ratios[k] - found.log_ratios[0]).exp();
        for (k, expected) in [(1, 1.3), (2, 1.3), (3, 1.0)] {
            assert!((ratio(k) / expected - 1.0).abs() < 1e-3, "image {k}: {}", ratio(k));
        }
    }

    #[test]
    fn an_image_of_another_focal_length_is_found() {
        let (mut bundle, truth) = exact();
        bundle.free = vec![Lens::FX, Lens::FY];
        // So precise that priors do not matter: they know fx / fy to 0.2 %.
        bundle.observations.iter_mut().flatten().for_each(|seen| seen.inverse_std *= 1e3);
        enlarged(&mut bundle, &truth, 2, 1.0002);
        let stop = BundleStop { max_steps: 60, least_decrease: 1e-12 };
        let state = bundle.minimize(truth, stop);
        let found = focal_by_image(&bundle, &state).unwrap();
        let others = [0, 1, 3].map(|k| found.log_ratios[k]);
        let mean = others.iter().sum::<f64>() / 3.0;
        let larger = found.log_ratios[2] - mean;
        // One step is exact to second order in the error, which weak geometry amplifies.
        assert!((larger - 2e-4).abs() < 1e-5, "{found:?}");
        assert!(others.iter().all(|other| (other - mean).abs() < 1e-5), "{found:?}");
    }
}
