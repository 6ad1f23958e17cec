//! `auto` finds the model that made the pictures, and none with more parameters than they show.

use plumb::estimation::camera::{CameraOptions, calibrate_camera};
use plumb::geometry::lens::LensModel;
use plumb::geometry::pixel::ImageSize;

use crate::seeded_camera::SeededCamera;

#[test]
fn auto_finds_the_true_model() {
    let size = ImageSize::new(640, 480);
    let cameras = [
        SeededCamera::new(LensModel::Pinhole, size, &[560.0, 555.0, 328.0, 235.0, 0.0]),
        SeededCamera::new(LensModel::Radial, size, &[560.0, 555.0, 328.0, 235.0, 0.0, -0.2]),
        SeededCamera::ordinary(),
        SeededCamera::fisheye(),
    ];
    for camera in cameras {
        let mut rng = SeededCamera::rng(31);
        let poses = camera.poses(30, &mut rng);
        let estimate = calibrate_camera(&camera.problem(&poses, &mut rng), &CameraOptions::default()).unwrap();
        assert_eq!(estimate.lens.model(), camera.lens.model(), "{:?}", estimate.compared);
        assert!(estimate.compared.len() >= 3, "{:?}", estimate.compared);
    }
}

#[test]
fn given_parameters_stay_and_square_pixels_are_square() {
    let camera = SeededCamera::ordinary();
    let mut rng = SeededCamera::rng(32);
    let poses = camera.poses(12, &mut rng);
    let problem = camera.problem(&poses, &mut rng);
    let lens = plumb::estimation::problem::LensChoice::Model(LensModel::Brown);
    let given = vec![("cx".to_owned(), 320.0), ("k3".to_owned(), 0.0)];
    let options = CameraOptions { lens, given, square_pixels: true, ..CameraOptions::default() };
    let estimate = calibrate_camera(&problem, &options).unwrap();
    let (parameters, std) = (estimate.lens.parameters(), estimate.lens_std());
    assert_eq!((parameters[2], parameters[9], std[2], std[9]), (320.0, 0.0, 0.0, 0.0));
    assert_eq!((parameters[0], std[0]), (parameters[1], std[1]));
    let unknown = CameraOptions { given: vec![("k7".to_owned(), 0.0)], ..options };
    let error = calibrate_camera(&problem, &unknown).unwrap_err();
    assert!(error.to_string().contains("no parameter `k7`"), "{error}");
}
