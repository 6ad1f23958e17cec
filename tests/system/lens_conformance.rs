//! What every lens model must do, checked over the whole image: a new model is one line at the end
//! of this file.

use nalgebra::{Matrix2x3, Matrix3, Point3, SMatrix, Vector2, Vector3};
use plumb::document::lens::LensDocument;
use plumb::geometry::lens::{Lens, LensModel, MAX_PARAMETERS};
use plumb::geometry::pixel::{ImageSize, Pixel};
use plumb::geometry::pose::Pose;

const SIZE: ImageSize = ImageSize::new(640, 480);
/// Round trips are exact to this, everywhere the model sees.
const ROUND_TRIP_PX: f64 = 1e-9;

fn lens(model: LensModel, parameters: &[f64]) -> Lens {
    Lens::from_parameters(model, parameters).unwrap()
}

/// The image's pixels on a grid, its borders and corners among them.
fn pixels_of_the_image() -> impl Iterator<Item = Pixel> {
    let steps = |length: u32| (0..=40).map(move |k| -0.5 + f64::from(k) / 40.0 * f64::from(length));
    steps(SIZE.height).flat_map(move |y| steps(SIZE.width).map(move |x| Pixel::new(x, y)))
}

/// Directions all around, denser than any lens needs: every 2° off the axis, every 15° around it.
fn directions() -> impl Iterator<Item = (f64, Vec<Vector3<f64>>)> {
    (0..24).map(|rotation| {
        let around = f64::from(rotation) * 15f64.to_radians() + 0.1;
        let along = (0..90)
            .map(|k| f64::from(k) * 2f64.to_radians())
            .map(|off| Vector3::new(off.sin() * around.cos(), off.sin() * around.sin(), off.cos()))
            .collect();
        (around, along)
    })
}

/// Pixel → direction → pixel returns within [`ROUND_TRIP_PX`] wherever the lens sees; `sees_all`:
/// that is the whole image.
fn round_trips(lens: &Lens, sees_all: bool) {
    let mut seen = 0;
    let mut blind = 0;
    for pixel in pixels_of_the_image() {
        let Some(bearing) = lens.bearing_from_pixel(pixel) else {
            blind += 1;
            continue;
        };
        seen += 1;
        for distance_m in [0.3, 7.0] {
            let point = Point3::from(bearing.into_inner() * distance_m);
            let back = lens
                .pixel_from_point(&point)
                .unwrap_or_else(|| panic!("{pixel:?} is seen one way only"));
            let miss = back.distance_px(pixel);
            assert!(miss < ROUND_TRIP_PX, "{pixel:?} returns to {back:?}, {miss:e} px off");
        }
    }
    assert!(seen > 400, "only {seen} pixels are seen");
    assert_eq!(blind == 0, sees_all, "{blind} pixels of the image see nothing");
}

/// Direction → pixel → direction: inside the valid region the model is one-to-one, and that region
/// is in one piece around the axis.
fn is_one_to_one_where_valid(lens: &Lens) {
    for (around, along) in directions() {
        let mut ended = None;
        for direction in along {
            let Some(pixel) = lens.pixel_from_point(&Point3::from(direction * 2.0)) else {
                ended.get_or_insert(direction);
                continue;
            };
            assert!(
                ended.is_none(),
                "at {around} rad around, {direction:?} is seen again beyond {ended:?}"
            );
            let back = lens
                .bearing_from_pixel(pixel)
                .unwrap_or_else(|| panic!("{direction:?} is seen one way only"));
            let again = lens.pixel_from_point(&Point3::from(back.into_inner())).unwrap();
            // In pixels up to the image's own size: far outside it a pixel has fewer digits.
            let scale = 1.0 + (pixel.to_vector().norm() / SIZE.diagonal_px()).powi(2);
            assert!(
                again.distance_px(pixel) < ROUND_TRIP_PX * scale,
                "{direction:?}: {pixel:?} or {again:?}"
            );
        }
    }
}

/// What the lens cannot see is `None`, never a number.
fn refuses_what_it_cannot_see(lens: &Lens) {
    let nan = f64::NAN;
    for point in [
        [0.0, 0.0, 0.0],
        [nan, 0.0, 1.0],
        [0.0, nan, 1.0],
        [0.0, 0.0, nan],
        [f64::INFINITY, 0.0, 1.0],
    ] {
        let point = Point3::from(point);
        assert!(lens.pixel_from_point(&point).is_none(), "{point} gives a pixel");
        assert!(lens.project(&point).is_none(), "{point} gives a projection");
    }
    for pixel in [Pixel::new(nan, 0.0), Pixel::new(0.0, nan), Pixel::new(f64::INFINITY, 0.0)] {
        assert!(lens.bearing_from_pixel(pixel).is_none(), "{pixel:?} gives a direction");
    }
    let fisheyes = [LensModel::KannalaBrandt, LensModel::Eucm, LensModel::DoubleSphere];
    if !fisheyes.contains(&lens.model()) {
        for point in [[0.1, 0.1, -1.0], [0.1, 0.0, 0.0], [0.0, 0.0, -2.0]] {
            assert!(
                lens.pixel_from_point(&Point3::from(point)).is_none(),
                "{point:?} is not in front"
            );
        }
    }
}

/// Fourth-order central difference of `f` at 0 with step `h`; `None` where `f` ends.
fn slope(h: f64, f: impl Fn(f64) -> Option<Pixel>) -> Option<Vector2<f64>> {
    let at = |k: f64| Some(f(k * h)?.to_vector());
    Some(((at(1.0)? - at(-1.0)?) * 8.0 - (at(2.0)? - at(-2.0)?)) / (12.0 * h))
}

fn numeric<const N: usize>(
    steps: [f64; N],
    f: impl Fn(usize, f64) -> Option<Pixel>,
) -> Option<SMatrix<f64, 2, N>> {
    let mut matrix = SMatrix::<f64, 2, N>::zeros();
    for (k, step) in steps.into_iter().enumerate() {
        matrix.set_column(k, &slope(step, |t| f(k, t))?);
    }
    Some(matrix)
}

fn assert_close<const N: usize>(
    what: &str,
    at: Pixel,
    analytic: &SMatrix<f64, 2, N>,
    numeric: &SMatrix<f64, 2, N>,
) {
    for column in 0..N {
        let (a, n) = (analytic.column(column), numeric.column(column));
        let scale = 1.0 + a.norm();
        assert!(
            (a - n).norm() < 2e-6 * scale,
            "{what}, column {column} at {at:?}: {a} by formula, {n} by differences"
        );
    }
}

/// The derivatives by point, pose and every parameter, against differences, over the whole image.
fn derivatives_are_true(lens: &Lens) {
    let camera_from_board =
        Pose::from_axis_angle(Vector3::new(0.4, -0.3, 0.9), Vector3::new(0.1, -0.2, 0.8));
    let parameters = lens.parameters();
    let mut checked = 0;
    for pixel in pixels_of_the_image() {
        let Some(bearing) = lens.bearing_from_pixel(pixel) else { continue };
        let point = Point3::from(bearing.into_inner() * 1.3);
        let Some(projection) = lens.project(&point) else { panic!("{pixel:?} has no derivative") };
        assert!(projection.pixel.distance_px(pixel) < ROUND_TRIP_PX);

        let by_point = numeric([1e-4; 3], |axis, t| {
            let mut moved = point;
            moved[axis] += t;
            lens.pixel_from_point(&moved)
        });
        // A small rotation and translation of the camera frame after the pose: δ ·
        // camera_from_board.
        let point_in_board = camera_from_board.inverse() * point;
        let by_pose = numeric([1e-4; 6], |axis, t| {
            let mut change = [0.0; 6];
            change[axis] = t;
            let rotation = Vector3::new(change[0], change[1], change[2]);
            let moved_from_camera =
                Pose::from_axis_angle(rotation, Vector3::new(change[3], change[4], change[5]));
            lens.pixel_from_point(&((moved_from_camera * camera_from_board) * point_in_board))
        });
        let steps: [f64; MAX_PARAMETERS] = std::array::from_fn(|k| if k < 5 { 1e-2 } else { 1e-5 });
        let by_parameters = numeric(steps, |k, t| {
            let mut changed = parameters.clone();
            if let Some(value) = changed.get_mut(k) {
                *value += t;
            }
            Lens::from_parameters(lens.model(), &changed)?.pixel_from_point(&point)
        });
        let (Some(by_point), Some(by_pose), Some(by_parameters)) =
            (by_point, by_pose, by_parameters)
        else {
            continue;
        };
        // Beside the fold the third derivative has no bound, and differences say nothing.
        if near_the_fold(&projection.by_point) {
            continue;
        }
        assert_close("by point", pixel, &projection.by_point, &by_point);
        assert_close("by pose", pixel, &pose_derivative(&projection.by_point, &point), &by_pose);
        assert_close("by parameters", pixel, &projection.by_parameters, &by_parameters);
        checked += 1;
    }
    assert!(checked > 400, "only {checked} pixels could be checked");
}

/// d(pixel)/d(rotation, translation) for a rotation and translation applied after the pose: the
/// point moves by rotation × point + translation.
fn pose_derivative(by_point: &Matrix2x3<f64>, point: &Point3<f64>) -> SMatrix<f64, 2, 6> {
    let cross =
        Matrix3::new(0.0, point.z, -point.y, -point.z, 0.0, point.x, point.y, -point.x, 0.0);
    let mut by_pose = SMatrix::<f64, 2, 6>::zeros();
    by_pose.fixed_columns_mut::<3>(0).copy_from(&(by_point * cross));
    by_pose.fixed_columns_mut::<3>(3).copy_from(by_point);
    by_pose
}

/// Where the image hardly moves in one direction: its smaller singular value is below 5 % of the
/// larger.
fn near_the_fold(by_point: &Matrix2x3<f64>) -> bool {
    let values = by_point.svd(false, false).singular_values;
    values.min() < 0.05 * values.max()
}

/// Agrees with `cv::projectPoints` and `cv::fisheye::projectPoints`: the file holds OpenCV's own
/// numbers, which `tests/python/test_opencv.py` computes again.
#[test]
fn agrees_with_opencv() {
    #[derive(serde::Deserialize)]
    struct Reference {
        lenses: Vec<ReferenceLens>,
    }
    #[derive(serde::Deserialize)]
    struct ReferenceLens {
        lens: LensDocument,
        points_m: Vec<[f64; 3]>,
        pixels: Vec<[f64; 2]>,
    }
    let reference: Reference =
        serde_json::from_str(include_str!("../golden/opencv_projections.json")).unwrap();
    let models: Vec<LensModel> = reference
        .lenses
        .iter()
        .map(|ReferenceLens { lens, points_m, pixels }| {
            let lens = Lens::try_from(lens).unwrap();
            assert_eq!((points_m.len(), pixels.len()), (169, 169));
            for (point, [x, y]) in points_m.iter().zip(pixels) {
                let pixel = lens.pixel_from_point(&Point3::from(*point)).unwrap();
                let distance_px = pixel.distance_px(Pixel::new(*x, *y));
                assert!(
                    distance_px < 1e-9,
                    "{} at {point:?}: {pixel:?}, OpenCV ({x}, {y})",
                    lens.model()
                );
            }
            lens.model()
        })
        .collect();
    let in_opencv = |model: &LensModel| model.facts().opencv.is_some();
    assert!(
        LensModel::ALL.iter().filter(|model| in_opencv(model)).all(|model| models.contains(model)),
        "a model is not compared: {models:?}"
    );
}

/// One line a lens: name, model, parameters (fx, fy, cx, cy, skew, coefficients), and whether it
/// sees the whole image.
macro_rules! conforms {
    ($($name:ident: $model:ident $parameters:expr, sees_all = $sees_all:expr;)*) => {$(
        mod $name {
            use super::*;

            #[test]
            fn round_trips() {
                super::round_trips(&lens(LensModel::$model, &$parameters), $sees_all);
            }

            #[test]
            fn one_to_one() {
                is_one_to_one_where_valid(&lens(LensModel::$model, &$parameters));
            }

            #[test]
            fn refusals() {
                refuses_what_it_cannot_see(&lens(LensModel::$model, &$parameters));
            }

            #[test]
            fn derivatives() {
                derivatives_are_true(&lens(LensModel::$model, &$parameters));
            }
        }
    )*};
}

conforms! {
    pinhole: Pinhole [530.0, 535.0, 318.0, 242.0, 0.0], sees_all = true;
    pinhole_with_skew: Pinhole [471.9, 435.6, 289.2, 219.3, 8.08], sees_all = true;
    radial_barrel: Radial [530.0, 535.0, 318.0, 242.0, 0.0, -0.25], sees_all = true;
    radial_pincushion: Radial [530.0, 535.0, 318.0, 242.0, 2.0, 0.4], sees_all = true;
    radial_that_folds: Radial [400.0, 400.0, 320.0, 240.0, 0.0, -0.55], sees_all = false;
    brown: Brown [532.8, 532.9, 342.5, 233.9, 0.0, -0.281, 0.025, 0.0012, -0.00014, 0.163], sees_all = true;
    brown_with_skew: Brown [532.8, 532.9, 342.5, 233.9, 3.0, -0.281, 0.08, 0.002, -0.003, -0.01], sees_all = true;
    brown_that_folds: Brown [380.0, 382.0, 320.0, 240.0, 0.0, -0.45, 0.05, 0.001, 0.001, -0.02], sees_all = false;
    rational: Rational [520.0, 522.0, 321.0, 238.0, 0.0, 8.1, 4.3, 0.0003, -0.0002, 0.2, 8.4, 6.9, 1.1], sees_all = true;
    rational_with_a_pole: Rational [400.0, 400.0, 320.0, 240.0, 0.0, -0.6, 0.1, 0.001, 0.0, 0.0, -0.3, 0.0, 0.0], sees_all = false;
    fisheye: KannalaBrandt [205.0, 206.0, 319.0, 241.0, 0.0, -0.012, 0.004, -0.002, 0.0003], sees_all = true;
    eucm: Eucm [250.0, 251.0, 319.0, 241.0, 0.0, 0.6, 1.1], sees_all = true;
    eucm_nearly_straight: Eucm [530.0, 535.0, 318.0, 242.0, 0.0, 0.2, 0.9], sees_all = true;
    eucm_that_ends: Eucm [120.0, 121.0, 320.0, 240.0, 0.0, 0.7, 1.2], sees_all = false;
    double_sphere: DoubleSphere [200.0, 201.0, 319.0, 241.0, 0.0, -0.1, 0.55], sees_all = true;
    double_sphere_ahead: DoubleSphere [330.0, 331.0, 319.0, 241.0, 0.0, 0.3, 0.4], sees_all = true;
    double_sphere_that_ends: DoubleSphere [157.0, 157.0, 320.0, 240.0, 0.0, -0.18, 0.59], sees_all = false;
    fisheye_that_folds: KannalaBrandt [160.0, 160.0, 320.0, 240.0, 0.0, -0.09, -0.01, 0.0, 0.0], sees_all = false;
}
