//! What each image by itself shows of the lens: a problem in which each image has its own factor on
//! the focal length, or its own principal point. For one camera with one lens setting they are the
//! same in all images, except for their noise.

use nalgebra::{DMatrix, DVector, Matrix3, SMatrix, Vector2, Vector3};

use crate::estimation::scene::bundle::{
    Bundle, BundleStop, CameraMotion, PixelRow, SceneObservation, SceneState,
};
use crate::estimation::scene::covariance::{lens_covariance, scale_parameter};
use crate::estimation::scene::robust_bundle::{CAUCHY, fit_robustly};
use crate::geometry::lens::{Lens, MAX_PARAMETERS};
use crate::geometry::pixel::{ImageSize, Pixel};

/// What may differ between images.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum OwnPart {
    /// The focal length: zoom or focus was changed, or the images are from two cameras.
    Focal,
    /// The principal point: images were rotated by 180 degrees, cropped or stabilized.
    Center,
}

impl OwnPart {
    /// Values per image.
    pub const fn width(self) -> usize {
        match self {
            Self::Focal => 1,
            Self::Center => 2,
        }
    }

    const fn parameters(self) -> [usize; 2] {
        match self {
            Self::Focal => [Lens::FX, Lens::FY],
            Self::Center => [Lens::CX, Lens::CY],
        }
    }

    /// The prior standard deviation of each value: hardly a constraint. It keeps the problem
    /// solvable where the common value is estimated too.
    fn prior_std(self, size: ImageSize) -> f64 {
        match self {
            Self::Focal => LOG_FOCAL_STD,
            Self::Center => CENTER_STD * f64::from(size.width),
        }
    }

    /// Fits end where a step of all values is below this: a fifth of the least difference of focal
    /// lengths that is reported, and two fifths of that of principal points.
    fn settled_step(self, size: ImageSize) -> f64 {
        match self {
            Self::Focal => SETTLED_STEP,
            Self::Center => SETTLED_STEP * f64::from(size.width),
        }
    }
}

/// What each image shows of the focal length or the principal point.
#[derive(Debug, Clone, PartialEq)]
pub struct LensByImage {
    /// Per pose: the logarithm of the image's focal length over the common one, or the image's
    /// principal point less the common one, (x, y), in pixels.
    pub values: DVector<f64>,
    /// Their covariance. A common change of all is not determined.
    pub covariance: DMatrix<f64>,
}

/// A factor of e.
const LOG_FOCAL_STD: f64 = 1.0;

/// Over the image's width: the principal point may be anywhere in the image. Not swept.
const CENTER_STD: f64 = 0.5;

/// A limit for safety: fits end earlier, where a step is below [`SETTLED_STEP`]. Images enlarged by
/// up to 1.3 reach the focal length that they show within as many fits.
const MOST_FITS: usize = 4;

/// For logarithms of focal lengths, and for principal points over the image's width.
const SETTLED_STEP: f64 = 1e-3;

const FIT_STOP: BundleStop = BundleStop { max_steps: 30, least_decrease: 1e-3 };

/// What the images show where they may differ by much, starting from `state`. `bundle` has all
/// observations, including those that are outliers for a common lens. Each image is scaled about
/// the principal point, or moved, to the mean of all, until nothing changes.
pub fn separate_lenses(bundle: &Bundle, state: &SceneState, part: OwnPart) -> Option<LensByImage> {
    let size = bundle.prior.image_size;
    let mut alike = bundle.clone();
    let mut state = state.clone();
    let mut values = DVector::zeros(state.cameras_from_scene.len() * part.width());
    for _ in 0..MOST_FITS {
        alike.rescaled(alike.median_noise(&state));
        alike.robust_limit = CAUCHY;
        state = alike.minimize(state, FIT_STOP);
        // Observations may fit better now: outliers have little weight only relative to the true
        // noise.
        alike.rescaled(alike.median_noise(&state));
        let mut step = lens_by_image(&alike, &state, part)?.values;
        remove_mean(&mut step, part.width());
        values += &step;
        make_alike(&mut alike, bundle, &state, part, &values);
        if step.amax() < part.settled_step(size) {
            break;
        }
    }
    let mut last = fit_robustly(alike, state, FIT_STOP);
    let shared = lens_covariance(&last.bundle, &last.state, 1.0)?.shared;
    last.bundle.rescaled(shared.sqrt());
    let found = lens_by_image(&last.bundle, &last.state, part)?;
    Some(LensByImage { values: values + found.values, ..found })
}

/// Subtracts the mean over images from each of their `width` values.
fn remove_mean(values: &mut DVector<f64>, width: usize) {
    for k in 0..width {
        let of_images: Vec<f64> = values.iter().skip(k).step_by(width).copied().collect();
        let mean = of_images.iter().sum::<f64>() / of_images.len() as f64;
        values.iter_mut().skip(k).step_by(width).for_each(|value| *value -= mean);
    }
}

/// Sets the observations to those of `bundle` as they would be if all images had one lens.
fn make_alike(
    alike: &mut Bundle,
    bundle: &Bundle,
    state: &SceneState,
    part: OwnPart,
    values: &DVector<f64>,
) {
    let center = state.lens.matrix;
    let alike_one = |seen: &SceneObservation| {
        let Pixel { x, y } = seen.pixel;
        let first = seen.camera * part.width();
        match part {
            OwnPart::Focal => {
                let scale = (-values[first]).exp();
                Pixel::new(center.cx + scale * (x - center.cx), center.cy + scale * (y - center.cy))
            }
            OwnPart::Center => Pixel::new(x - values[first], y - values[first + 1]),
        }
    };
    let seen = bundle.observations.iter().flatten();
    let alike = alike.observations.iter_mut().flatten();
    alike.zip(seen).for_each(|(alike, seen)| alike.pixel = alike_one(seen));
}

/// The values by one step from the minimum `state` of `bundle`, whose observations have their true
/// standard deviations; `None` where they are not determined.
pub fn lens_by_image(bundle: &Bundle, state: &SceneState, part: OwnPart) -> Option<LensByImage> {
    let mut free = bundle.free.clone();
    free.extend(part.parameters().into_iter().filter(|k| !bundle.free.contains(k)));
    let both = part.parameters().map(|k| free.iter().position(|own| *own == k).unwrap_or(0));
    let with_part = Bundle { free, ..bundle.clone() };
    let cameras = state.cameras_from_scene.len();
    let (common, width) = (bundle.size(cameras), part.width());
    let size = common + cameras * width;
    let (mut matrix, mut gradient) = (DMatrix::zeros(size, size), DVector::zeros(size));
    let focal = state.lens.matrix;
    for point in 0..state.points.len() {
        let rows = with_part.rows(state, point);
        let columns: Vec<RowColumns> = rows
            .iter()
            .map(|row| {
                let [x, y] = both.map(|k| row.by_lens.column(k).into_owned());
                let first = common + row.camera * width;
                match part {
                    OwnPart::Focal => {
                        RowColumns::of(bundle, row, [(first, x * focal.fx + y * focal.fy)])
                    }
                    OwnPart::Center => RowColumns::of(bundle, row, [(first, x), (first + 1, y)]),
                }
            })
            .collect();
        let of_point = PointRows { point, rows: &rows, columns: &columns };
        of_point.add_to(bundle, state, &mut matrix, &mut gradient);
    }
    bundle.add_prior(&state.lens, &mut matrix, &mut gradient);
    let prior = part.prior_std(bundle.prior.image_size).powi(-2);
    (common..size).for_each(|k| matrix[(k, k)] += prior);
    matrix.fill_upper_triangle_with_lower_triangle();
    let scale = scale_parameter(bundle, state);
    let lens = bundle.free.len();
    let is_translation = |k: usize| (lens..common).contains(&k) && (k - lens) % 6 >= 3;
    let rotates = bundle.motion == CameraMotion::RotationOnly;
    let is_kept = |k: &usize| Some(*k) != scale && !(rotates && is_translation(*k));
    let kept: Vec<usize> = (0..size).filter(is_kept).collect();
    let inverse = matrix.select_rows(&kept).select_columns(&kept).cholesky()?.inverse();
    let step = -(&inverse * gradient.select_rows(&kept));
    let (first, count) = (kept.len() - cameras * width, cameras * width);
    let covariance = inverse.view((first, first), (count, count)).into_owned();
    let values = step.rows(first, count).into_owned();
    values.iter().all(|v| v.is_finite()).then_some(LensByImage { values, covariance })
}

/// The columns of one observation, each with its index among all parameters: lens, pose, the
/// image's own focal length or principal point.
struct RowColumns(Vec<(usize, Vector2<f64>)>);

impl RowColumns {
    fn of<const WIDTH: usize>(
        bundle: &Bundle,
        row: &PixelRow,
        own: [(usize, Vector2<f64>); WIDTH],
    ) -> Self {
        let lens = bundle.free.len();
        let mut columns: Vec<(usize, Vector2<f64>)> = (0..lens.min(MAX_PARAMETERS))
            .map(|k| (k, row.by_lens.column(k).into_owned()))
            .collect();
        if let Some(start) = bundle.pose_start(row.camera) {
            columns.extend((0..6).map(|k| (start + k, row.by_pose.column(k).into_owned())));
        }
        columns.extend(own);
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
    use crate::geometry::lens::LensModel;
    use crate::geometry::pose::Pose;

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
        let found = separate_lenses(&bundle, &truth, OwnPart::Focal).unwrap();
        let ratio = |k: usize| (found.values[k] - found.values[0]).exp();
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
        let found = lens_by_image(&bundle, &state, OwnPart::Focal).unwrap();
        let others = [0, 1, 3].map(|k| found.values[k]);
        let mean = others.iter().sum::<f64>() / 3.0;
        let larger = found.values[2] - mean;
        // One step is exact to second order in the error, which weak geometry amplifies.
        assert!((larger - 2e-4).abs() < 1e-5, "{found:?}");
        assert!(others.iter().all(|other| (other - mean).abs() < 1e-5), "{found:?}");
    }

    #[test]
    fn images_rotated_by_half_a_circle_are_found() {
        let (mut bundle, mut truth) = exact();
        let size = bundle.prior.image_size;
        bundle.free = vec![Lens::FX, Lens::FY, Lens::CX, Lens::CY];
        bundle.observations.iter_mut().flatten().for_each(|seen| seen.inverse_std *= 1e3);
        let (middle, center) = (size.center(), truth.lens.matrix);
        // Without tangential distortion, which a rotated image has with the other sign.
        let parameters = [center.fx, center.fy, center.cx, center.cy, 0.0, -0.1];
        truth.lens = Lens::from_parameters(LensModel::Radial, &parameters).unwrap();
        for (point, seen) in truth.points.iter().zip(&mut bundle.observations) {
            for seen in seen {
                let in_camera = truth.cameras_from_scene[seen.camera] * *point;
                seen.pixel = truth.lens.pixel_from_point(&in_camera).unwrap();
                let Pixel { x, y } = seen.pixel;
                if seen.camera % 2 == 1 {
                    seen.pixel = Pixel::new(2.0 * middle.x - x, 2.0 * middle.y - y);
                }
            }
        }
        let half = Pose::from_axis_angle(Vector3::z() * std::f64::consts::PI, Vector3::zeros());
        for pose in truth.cameras_from_scene.iter_mut().skip(1).step_by(2) {
            *pose = half * *pose;
        }
        let found = separate_lenses(&bundle, &truth, OwnPart::Center).unwrap();
        let expected = [2.0 * (middle.x - center.cx), 2.0 * (middle.y - center.cy)];
        for (image, is_rotated) in [(1, true), (2, false), (3, true)] {
            for (k, expected) in expected.iter().enumerate() {
                let difference = found.values[2 * image + k] - found.values[k];
                let expected = if is_rotated { *expected } else { 0.0 };
                // The fits end at steps below 0.64 px.
                assert!((difference - expected).abs() < 0.1, "image {image}: {difference}");
            }
        }
    }
}
