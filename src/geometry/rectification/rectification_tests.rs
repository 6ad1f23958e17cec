//! Rectification against plain geometry: points in space, projected to both cameras.

use nalgebra::{Point3, Vector3, Vector4};

use super::*;
use crate::geometry::flat_image::WIDEST;

/// Pseudorandom numbers between −1 and 1 (the upper bits of a linear congruential generator).
struct Draws(u64);

impl Draws {
    fn next(&mut self) -> f64 {
        self.0 =
            self.0.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (self.0 >> 11) as f64 / (1u64 << 52) as f64 - 1.0
    }

    fn vector(&mut self, size: f64) -> Vector3<f64> {
        Vector3::from_fn(|_, _| size * self.next())
    }
}

const SIZE: ImageSize = ImageSize::new(640, 480);

fn lens(model: LensModel, draws: &mut Draws) -> Lens {
    let coefficients: &[f64] = match model {
        LensModel::Brown => &[-0.28, 0.08, 0.0012, -0.0014, -0.013],
        LensModel::Rational => &[8.1, 4.3, 0.0003, -0.0002, 0.2, 8.4, 6.9, 1.1],
        LensModel::KannalaBrandt => &[-0.012, 0.004, -0.002, 0.0003],
        LensModel::DoubleSphere => &[-0.2, 0.55],
        _ => &[],
    };
    let focal_px = if model == LensModel::KannalaBrandt { 300.0 } else { 500.0 };
    let mut near = |value: f64, off: f64| value + off * draws.next();
    let k = [near(focal_px, 20.0), near(focal_px, 20.0), near(320.0, 15.0), near(240.0, 15.0), 0.0];
    Lens::from_parameters(model, &[&k, coefficients].concat()).unwrap()
}

const MODELS: [LensModel; 5] = [
    LensModel::Pinhole,
    LensModel::Brown,
    LensModel::Rational,
    LensModel::KannalaBrandt,
    LensModel::DoubleSphere,
];

/// A rig whose second camera is right of the first, or below it.
fn rig(models: [LensModel; 2], axis: StereoAxis, draws: &mut Draws) -> ([StereoCamera; 2], Pose) {
    let cameras = models.map(|model| StereoCamera { lens: lens(model, draws), image_size: SIZE });
    let mut translation = draws.vector(0.02);
    translation[axis.coordinate()] = -0.12;
    (cameras, Pose::from_axis_angle(draws.vector(0.08), translation))
}

#[test]
fn what_both_see_is_in_one_line_and_disparity_is_depth() {
    for seed in 0..60 {
        let mut draws = Draws(seed);
        let models = [MODELS[seed as usize % 5], MODELS[seed as usize / 5 % 5]];
        let axis = if seed % 3 == 2 { StereoAxis::Vertical } else { StereoAxis::Horizontal };
        let (cameras, second_from_first) = rig(models, axis, &mut draws);
        let alpha = f64::from(seed as u32 % 4) / 3.0;
        let stereo = StereoRectification::new(&cameras, &second_from_first, alpha).unwrap();
        assert_eq!((stereo.axis, stereo.image_size), (axis, SIZE));
        let baseline_m = second_from_first.translation().norm();
        assert!((stereo.second_from_first_m + baseline_m).abs() < 1e-12);
        let [first, second] = stereo.cameras;
        let focal_px = first.matrix().fx;
        let last = second.projection[(axis.coordinate(), 3)];
        assert!((last + focal_px * baseline_m).abs() < 1e-9 * focal_px);
        let mut seen = 0;
        for _ in 0..200 {
            let point = Point3::from(Vector3::new(0.0, 0.0, 1.4) + draws.vector(0.6));
            let pixels = cameras[0]
                .lens
                .pixel_from_point(&point)
                .zip(cameras[1].lens.pixel_from_point(&(second_from_first * point)));
            let Some((a, b)) = pixels else { continue };
            seen += 1;
            let rectified_a = first.rectified_from_pixel(&cameras[0].lens, a).unwrap();
            let rectified_b = second.rectified_from_pixel(&cameras[1].lens, b).unwrap();
            assert!((axis.shared(rectified_a) - axis.shared(rectified_b)).abs() < 1e-7);
            let back = first.pixel_from_rectified(&cameras[0].lens, rectified_a).unwrap();
            assert!(back.distance_px(a) < 1e-7);

            let along = axis.coordinate();
            let disparity = rectified_a.to_vector()[along] - rectified_b.to_vector()[along];
            let placed = stereo.point_from_disparity()
                * Vector4::new(rectified_a.x, rectified_a.y, disparity, 1.0);
            let expected = first.rectified_from_camera * point.coords;
            assert!((placed.xyz() / placed.w - expected).norm() < 1e-8 * expected.norm() / 0.05);
            let projected = second.projection * expected.push(1.0);
            let projected = Pixel::from((projected.xy() / projected.z).into_owned());
            assert!(projected.distance_px(rectified_b) < 1e-7);
        }
        assert!(seen > 100, "seed {seed}: {seen} points");
    }
}

/// The pixels at the border of an image.
fn edge() -> impl Iterator<Item = Pixel> {
    let across = (0..640).flat_map(|x| [(x, 0), (x, 479)]);
    let down = (0..480).flat_map(|y| [(0, y), (639, y)]);
    across.chain(down).map(|(x, y)| Pixel::new(f64::from(x), f64::from(y)))
}

/// Inside the image, up to the curvature of a side between two of the nine sampled points.
fn is_inside(at: Pixel) -> bool {
    (-1.0..640.0).contains(&at.x) && (-1.0..480.0).contains(&at.y)
}

#[test]
fn alpha_0_shows_nothing_unseen_and_alpha_1_leaves_nothing_out() {
    for seed in 0..20 {
        let mut draws = Draws(seed + 1000);
        let model = MODELS[seed as usize % 3];
        let (cameras, second_from_first) = rig([model; 2], StereoAxis::Horizontal, &mut draws);
        let [tight, wide] = [0.0, 1.0]
            .map(|alpha| StereoRectification::new(&cameras, &second_from_first, alpha).unwrap());
        for (k, camera) in cameras.iter().enumerate() {
            let lens = &camera.lens;
            let [tight, wide] = [&tight, &wide].map(|stereo| &stereo.cameras[k]);
            assert_frames(lens, tight, wide);
        }
        assert!(tight.cameras[0].matrix().fx > wide.cameras[0].matrix().fx);
    }
}

/// Checks that the `tight` image shows only what the camera sees, and that the `wide` one shows all
/// of it.
fn assert_frames(lens: &Lens, tight: &RectifiedCamera, wide: &RectifiedCamera) {
    for pixel in edge() {
        let seen = tight.pixel_from_rectified(lens, pixel);
        assert!(seen.is_some_and(is_inside), "{lens:?}: {pixel:?} shows {seen:?}");
        let shown = wide.rectified_from_pixel(lens, pixel);
        assert!(shown.is_some_and(is_inside), "{lens:?}: {pixel:?} is at {shown:?}");
    }
}

#[test]
fn a_camera_by_itself_is_framed_as_a_pair_is() {
    for seed in 0..20 {
        let mut draws = Draws(seed + 2000);
        let lens = lens(MODELS[seed as usize % 3], &mut draws);
        let [tight, wide] = [0.0, 1.0].map(|alpha| RectifiedCamera::framed(&lens, SIZE, alpha));
        assert_frames(&lens, &tight, &wide);
        let unchanged = tight == RectifiedCamera::alone(&lens.matrix);
        assert_eq!(unchanged, lens.model() == LensModel::Pinhole);
        let between = RectifiedCamera::framed(&lens, SIZE, 0.25);
        let mean = tight.projection * 0.75 + wide.projection * 0.25;
        assert!((between.projection - mean).amax() < 1e-9);
    }
}

#[test]
fn a_fisheye_is_framed_by_its_sides_and_no_wider_than_a_flat_image_is() {
    // From 50 to more than 90 degrees off the axis at the left and right sides.
    for focal_px in [380.0, 300.0, 240.0, 205.0, 160.0] {
        let parameters =
            [focal_px, 1.01 * focal_px, 319.0, 241.0, 0.0, -0.012, 0.004, -0.002, 3e-4];
        let lens = Lens::from_parameters(LensModel::KannalaBrandt, &parameters).unwrap();
        for alpha in [0.0, 0.5, 1.0] {
            let matrix = RectifiedCamera::framed(&lens, SIZE, alpha).matrix();
            assert!((matrix.fy / matrix.fx - 1.01).abs() < 1e-12);
            let shown = [(0.0, 240.0), (639.0, 240.0), (320.0, 0.0), (320.0, 479.0)]
                .map(|(x, y)| matrix.normalized_from_pixel(Pixel::new(x, y)).norm());
            // What is as far as that in one direction may leave the other one's sides empty.
            let nearest = shown.into_iter().fold(f64::INFINITY, f64::min);
            assert!(nearest < 1.05 * WIDEST, "{focal_px}: {shown:?}");
            let off = f64::hypot(matrix.cx - 319.5, matrix.cy - 239.5);
            assert!(off < 10.0, "{focal_px}: {off} px off the middle");
        }
    }
}

#[test]
fn a_lens_model_that_ends_inside_the_image_is_framed_by_what_it_reaches() {
    // One-to-one up to 163 and 230 pixels from the middle.
    for (model, coefficients) in
        [(LensModel::Radial, &[-0.5][..]), (LensModel::KannalaBrandt, &[-0.2, 0.0, 0.0, 0.0])]
    {
        let parameters = [&[300.0, 300.0, 320.0, 240.0, 0.0], coefficients].concat();
        let lens = Lens::from_parameters(model, &parameters).unwrap();
        assert!(lens.bearing_from_pixel(Pixel::new(0.0, 240.0)).is_none());
        for alpha in [0.0, 0.5, 1.0] {
            let framed = RectifiedCamera::framed(&lens, SIZE, alpha);
            for (x, y) in [(60.0, 240.0), (580.0, 240.0), (320.0, 40.0), (320.0, 440.0)] {
                let seen = framed.pixel_from_rectified(&lens, Pixel::new(x, y));
                assert!(seen.is_some(), "{model:?}, {alpha}: nothing is seen at {x}, {y}");
            }
            let matrix = framed.matrix();
            assert!((matrix.cx - 320.0).abs() < 5.0 && (matrix.cy - 240.0).abs() < 5.0);
        }
    }
}

#[test]
fn cameras_that_are_no_stereo_pair_are_refused() {
    let mut draws = Draws(3);
    let (cameras, _) = rig([LensModel::Brown; 2], StereoAxis::Horizontal, &mut draws);
    let refused = |translation: Vector3<f64>| {
        let pose = Pose::from_axis_angle(Vector3::zeros(), translation);
        StereoRectification::new(&cameras, &pose, 0.0).unwrap_err()
    };
    assert_eq!(refused(Vector3::zeros()), RectificationError::NoBaseline);
    assert_eq!(refused(Vector3::new(f64::NAN, 0.0, 0.0)), RectificationError::NoBaseline);
    let forward = refused(Vector3::new(0.01, 0.0, -0.2));
    assert!(matches!(forward, RectificationError::Forward { degrees } if degrees > 80.0));
}
