use super::*;
use crate::estimation::interrupt::Interrupt;
use crate::estimation::scene::bundle::CameraMotion;
use crate::estimation::scene::lens_prior::LensPrior;
use crate::geometry::lens::LensModel;
use crate::geometry::pixel::ImageSize;
use crate::imaging::gray::GrayImage;

const SIZE: ImageSize = ImageSize::new(320, 240);

/// A smooth texture on a plane, from 20 to 235.
fn light(u: f64, v: f64) -> f64 {
    let waves = [(60.0, 15.0, 0.3), (-30.0, 55.0, 1.1), (45.0, -50.0, 2.3), (80.0, 35.0, 0.7)];
    127.5 + 26.0 * waves.iter().map(|(a, b, c)| (a * u + b * v + c).sin()).sum::<f64>()
}

/// A camera's image of the plane z = 0.
fn image(lens: &Lens, camera_from_scene: &Pose) -> GrayImage {
    let scene_from_camera = camera_from_scene.inverse();
    let center = scene_from_camera.translation();
    let pixels = (0..SIZE.width * SIZE.height).map(|k| {
        let pixel = Pixel::new(f64::from(k % SIZE.width), f64::from(k / SIZE.width));
        let ray = scene_from_camera * lens.bearing_from_pixel(pixel).unwrap().into_inner();
        let at = center - ray * (center.z / ray.z);
        light(at.x, at.y).round() as u8
    });
    GrayImage::from_pixels(SIZE.width as usize, SIZE.height as usize, pixels.collect()).unwrap()
}

/// A reconstruction of points on the plane whose keypoints have errors in all images but the first,
/// with their true positions.
fn off_by(offset: [f64; 2], cameras_from_scene: &[Pose]) -> (Reconstruction, Vec<Vec<Pixel>>) {
    let parameters = [300.0, 300.0, 161.0, 118.0, 0.0, -0.15];
    let lens = Lens::from_parameters(LensModel::Radial, &parameters).unwrap();
    let points: Vec<_> = (0..30)
        .map(|k| {
            nalgebra::Point3::new(f64::from(k % 6) * 0.3 - 0.75, f64::from(k / 6) * 0.25 - 0.5, 0.0)
        })
        .collect();
    let truth: Vec<Vec<Pixel>> = points
        .iter()
        .map(|p| {
            cameras_from_scene.iter().map(|c| lens.pixel_from_point(&(*c * *p)).unwrap()).collect()
        })
        .collect();
    let seen = |(camera, pixel): (usize, &Pixel)| {
        let [x, y] = if camera == 0 { [0.0, 0.0] } else { offset };
        let pixel = Pixel::new(pixel.x + x, pixel.y + y);
        SceneObservation { camera, pixel, scale_px: 2.5, inverse_std: 4.0 }
    };
    let bundle = Bundle {
        observations: truth.iter().map(|p| p.iter().enumerate().map(seen).collect()).collect(),
        free: Vec::new(),
        prior: LensPrior::of_whole(SIZE),
        motion: CameraMotion::Moving,
        robust_limit: f64::INFINITY,
        interrupt: Interrupt::default(),
    };
    let state = SceneState { lens, cameras_from_scene: cameras_from_scene.to_vec(), points };
    (Reconstruction { images: (0..cameras_from_scene.len()).collect(), bundle, state }, truth)
}

/// One camera in front of the plane, the others around it, to the sides of the mean direction.
fn cameras_from_scene() -> Vec<Pose> {
    let rotated = |angle: f64| {
        let rotation = Vector3::new(0.1 * angle, angle, 0.2 * angle);
        Pose::from_axis_angle(rotation, Vector3::new(0.0, 0.0, 2.5))
    };
    [0.0, -0.6, 0.6, -0.3, 0.3].map(rotated).to_vec()
}

fn scene_images(cameras_from_scene: &[Pose], lens: &Lens) -> Vec<SceneImage> {
    let images = cameras_from_scene.iter().map(|camera| image(lens, camera));
    images.map(|image| SceneImage::of(String::new(), image.view())).collect()
}

/// Spots on a slanted surface are localized as accurately as predicted, whatever the errors of
/// their keypoints, and nearly all to a fiftieth of a pixel.
#[test]
fn spots_are_found_at_any_slant() {
    let cameras_from_scene = cameras_from_scene();
    let (mut start, truth) = off_by([0.4, -0.3], &cameras_from_scene);
    let images = scene_images(&cameras_from_scene, &start.state.lens);
    localize(&images, &mut start, 1);
    let (mut moved, mut exact, mut squares, mut count) = (0, 0, 0.0, 0);
    for (seen, truth) in start.bundle.observations.iter().zip(&truth) {
        for (seen, truth) in seen.iter().zip(truth).filter(|(seen, _)| seen.inverse_std != 4.0) {
            let error_px = seen.pixel.distance_px(*truth);
            moved += usize::from(seen.camera != 0);
            squares += (error_px * seen.inverse_std).powi(2);
            count += 2;
            assert!(error_px < 0.02 + 4.0 / seen.inverse_std, "{seen:?} {truth:?}");
            exact += usize::from(error_px < 0.02);
        }
    }
    let rms = (squares / f64::from(count)).sqrt();
    assert!(moved >= 100 && exact > moved && rms < 1.2, "{moved} {exact} {rms}");
}

/// An image that shows something else at the spot moves nothing.
#[test]
fn other_things_are_left_alone() {
    let cameras_from_scene = cameras_from_scene();
    let (mut start, _) = off_by([0.4, -0.3], &cameras_from_scene);
    let mut images = scene_images(&cameras_from_scene, &start.state.lens);
    let mut random = 1_u32;
    let noise = (0..SIZE.width * SIZE.height).map(|_| {
        random = random.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        (random >> 24) as u8
    });
    let noise =
        GrayImage::from_pixels(SIZE.width as usize, SIZE.height as usize, noise.collect()).unwrap();
    images[2] = SceneImage::of(String::new(), noise.view());
    let before = start.clone();
    localize(&images, &mut start, 1);
    for (seen, before) in start.bundle.observations.iter().zip(&before.bundle.observations) {
        assert_eq!(seen[2], before[2]);
    }
    let moved = start.bundle.observations.iter().filter(|seen| seen[1].inverse_std != 4.0).count();
    assert!(moved >= 25, "{moved}");
}
