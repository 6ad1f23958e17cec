//! Properties over random inputs: poses compose and invert, lenses return where they came from,
//! homographies invert, and documents lose nothing.

use nalgebra::{Matrix3, Point2, Point3, Vector3};
use plumb::document::lens::LensDocument;
use plumb::document::pose::PoseDocument;
use plumb::document::reading::{from_json, to_json};
use plumb::geometry::homography::Homography;
use plumb::geometry::lens::{Lens, LensModel};
use plumb::geometry::pixel::Pixel;
use plumb::geometry::pose::Pose;
use proptest::prelude::*;

fn vector(range: f64) -> impl Strategy<Value = Vector3<f64>> {
    [-range..range, -range..range, -range..range].prop_map(Vector3::from)
}

/// Rotations of up to half a turn about any axis, translations of up to 5 m along each.
fn pose() -> impl Strategy<Value = Pose> {
    (vector(1.8), vector(5.0)).prop_map(|(axis, t)| Pose::from_axis_angle(axis, t))
}

/// Lenses of every model, with coefficients as real cameras have them.
fn lens() -> impl Strategy<Value = Lens> {
    let matrix = [300.0..900.0, 0.98..1.02, 300.0..340.0, 220.0..260.0, -0.5..0.5];
    let coefficients = proptest::array::uniform8(-1.0..1.0_f64);
    (0..LensModel::ALL.len(), matrix, coefficients).prop_map(|(model, matrix, coefficients)| {
        let model = LensModel::ALL[model];
        let [fx, aspect, cx, cy, skew] = matrix;
        let scales: &[f64] = match model {
            LensModel::DoubleSphere => &[0.4, 0.4],
            LensModel::Eucm => &[0.4, 0.3],
            LensModel::KannalaBrandt => &[0.02, 0.01, 0.004, 0.001],
            LensModel::Pinhole => &[],
            LensModel::Radial => &[0.3],
            LensModel::Brown => &[0.3, 0.1, 0.002, 0.002, 0.02],
            LensModel::Rational => &[0.3, 0.1, 0.002, 0.002, 0.02, 0.1, 0.05, 0.01],
        };
        let mut parameters = vec![fx, fx * aspect, cx, cy, skew];
        let middles: &[f64] = match model {
            LensModel::DoubleSphere => &[0.0, 0.5],
            LensModel::Eucm => &[0.5, 1.0],
            _ => &[0.0; 8],
        };
        let around = coefficients.iter().zip(scales).zip(middles);
        parameters.extend(around.map(|((value, scale), middle)| middle + value * scale));
        Lens::from_parameters(model, &parameters).unwrap()
    })
}

proptest! {
    #![proptest_config(ProptestConfig { failure_persistence: None, ..ProptestConfig::with_cases(256) })]

    #[test]
    fn a_pose_and_its_inverse_cancel(a_from_b in pose(), p in vector(10.0)) {
        let there_and_back = a_from_b.inverse() * (a_from_b * Point3::from(p));
        prop_assert!((there_and_back.coords - p).norm() < 1e-12 * 50.0);
        prop_assert!((a_from_b * a_from_b.inverse()).translation().norm() < 1e-12 * 50.0);
    }

    #[test]
    fn poses_compose_as_their_maps_do(a_from_b in pose(), b_from_c in pose(), p in vector(10.0)) {
        let point_in_c = Point3::from(p);
        let one_by_one = a_from_b * (b_from_c * point_in_c);
        let at_once = (a_from_b * b_from_c) * point_in_c;
        prop_assert!((one_by_one - at_once).norm() < 1e-12 * 50.0);
    }

    #[test]
    fn a_pixel_that_a_lens_sees_returns(
        lens in lens(), x in -0.5..639.5, y in -0.5..479.5, distance_m in 0.1..20.0,
    ) {
        let pixel = Pixel::new(x, y);
        if let Some(bearing) = lens.bearing_from_pixel(pixel) {
            let point_in_camera = Point3::from(bearing.into_inner() * distance_m);
            let back = lens.pixel_from_point(&point_in_camera);
            prop_assert!(back.is_some_and(|back| back.distance_px(pixel) < 1e-6), "{back:?}");
        }
    }

    #[test]
    fn a_homography_and_its_inverse_cancel(
        entries in proptest::array::uniform8(-0.3..0.3_f64), x in -1.0..1.0, y in -1.0..1.0,
    ) {
        let [a, b, c, d, e, f, g, h] = entries;
        let matrix = Matrix3::new(1.0 + a, b, c, d, 1.0 + e, f, g, h, 1.0);
        if let Some(target_from_source) = Homography::from_matrix(&matrix)
            && let Some(source_from_target) = target_from_source.inverse()
            && let Some(target) = target_from_source.apply(Point2::new(x, y))
        {
            let back = source_from_target.apply(target);
            let scale = 1.0 + matrix.try_inverse().map_or(f64::INFINITY, |inverse| inverse.norm());
            let close = |back: Point2<f64>| (back - Point2::new(x, y)).norm() < 1e-9 * scale.powi(3);
            prop_assert!(back.is_some_and(close), "{back:?}");
        }
    }

    #[test]
    fn a_pose_survives_its_document_to_the_bit(a_from_b in pose()) {
        let json = to_json(&PoseDocument::from(&a_from_b)).unwrap();
        let document: PoseDocument = from_json(json.as_bytes()).unwrap();
        prop_assert_eq!(Pose::try_from(&document).unwrap(), a_from_b);
    }

    #[test]
    fn a_lens_survives_its_document_to_the_bit(lens in lens()) {
        let json = to_json(&LensDocument::from(&lens)).unwrap();
        let document: LensDocument = from_json(json.as_bytes()).unwrap();
        prop_assert_eq!(Lens::try_from(&document).unwrap(), lens);
    }
}
