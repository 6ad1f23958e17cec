//! Whether all images are from one camera with one lens setting, by what their files state.

use crate::calibration::scene::correspondence::SceneImage;
use crate::calibration::scene::refusal::SceneRefusal;
use crate::geometry::pixel::ImageSize;
use crate::imaging::stated_camera::StatedCamera;

/// A greater relative difference of focal lengths means that the zoom was moved: files state them
/// to a hundredth of a millimeter to a whole one.
const FOCAL_TOLERANCE: f64 = 0.01;
/// A greater relative difference of aspect ratios means that an image was cropped: rounding changes
/// that of an image of 200 pixels by less.
const ASPECT_TOLERANCE: f64 = 0.01;

/// Refuses images whose files state different cameras or focal lengths.
pub(super) fn check_one_camera(images: &[SceneImage]) -> Result<(), SceneRefusal> {
    let cameras = stated(images, |stated| stated.camera.as_deref());
    if let Some([(image, camera), (other, expected)]) = odd_one(&cameras, |a, b| a == b) {
        return Err(SceneRefusal::DifferentCameras {
            name: image.name.clone(),
            camera: (*camera).to_owned(),
            other: other.name.clone(),
            expected: (*expected).to_owned(),
        });
    }
    let focals = stated(images, |stated| stated.focal_mm);
    let is_same = |a: &f64, b: &f64| (a / b - 1.0).abs() <= FOCAL_TOLERANCE;
    if let Some([(image, focal_mm), (other, expected_mm)]) = odd_one(&focals, is_same) {
        return Err(SceneRefusal::DifferentZoom {
            name: image.name.clone(),
            focal_mm: *focal_mm,
            other: other.name.clone(),
            expected_mm: *expected_mm,
        });
    }
    Ok(())
}

/// Whether an image has another aspect ratio than the camera wrote, by what its file states.
pub(super) fn states_cropping(images: &[SceneImage]) -> bool {
    let shape = |size: ImageSize| {
        let (width, height) = (f64::from(size.width), f64::from(size.height));
        width.max(height) / width.min(height).max(1.0)
    };
    let is_other = |(image, written): &(&SceneImage, ImageSize)| {
        (shape(image.size) / shape(*written) - 1.0).abs() > ASPECT_TOLERANCE
    };
    stated(images, |stated| stated.image_size).iter().any(is_other)
}

/// The images whose files state something, with what.
fn stated<'a, T>(
    images: &'a [SceneImage],
    of: impl Fn(&'a StatedCamera) -> Option<T>,
) -> Vec<(&'a SceneImage, T)> {
    let of_image = |image: &'a SceneImage| Some((image, of(image.stated.as_ref()?)?));
    images.iter().filter_map(of_image).collect()
}

/// The first one that differs from the majority, and the first of the majority.
fn odd_one<I, T>(stated: &[(I, T)], is_same: impl Fn(&T, &T) -> bool) -> Option<[&(I, T); 2]> {
    let count = |of: &T| stated.iter().filter(|(_, other)| is_same(of, other)).count();
    let most = stated.iter().map(|(_, of)| count(of)).max()?;
    let expected = stated.iter().find(|(_, of)| count(of) == most)?;
    let odd = stated.iter().find(|(_, of)| !is_same(of, &expected.1))?;
    Some([odd, expected])
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::features::detector::Features;

    fn image(name: &str, stated: Option<StatedCamera>) -> SceneImage {
        let features = Features { keypoints: Vec::new(), descriptors: Vec::new() };
        let mut image = SceneImage::of_features(name, ImageSize::new(300, 200), features);
        image.stated = stated;
        image
    }

    fn by(camera: &str, focal_mm: f64, size: [u32; 2]) -> Option<StatedCamera> {
        let image_size = Some(ImageSize::new(size[0], size[1]));
        Some(StatedCamera { camera: Some(camera.to_owned()), focal_mm: Some(focal_mm), image_size })
    }

    #[test]
    fn the_odd_camera_and_the_odd_focal_length_are_named() {
        let one = || image("a", by("A 1", 18.0, [3000, 2000]));
        assert_eq!(check_one_camera(&[one(), image("b", None), one()]), Ok(()));
        let mixed = [image("b", by("B 2", 18.0, [3000, 2000])), one(), one()];
        let said = check_one_camera(&mixed).unwrap_err().to_string();
        assert!(said.starts_with("`b` was taken with B 2, `a` with A 1"), "{said}");
        let zoomed = [one(), one(), image("c", by("A 1", 35.0, [3000, 2000]))];
        let said = check_one_camera(&zoomed).unwrap_err().to_string();
        assert!(said.starts_with("`c` was taken at 35 mm, `a` at 18 mm"), "{said}");
    }

    #[test]
    fn another_shape_than_the_camera_wrote_is_a_crop() {
        assert!(!states_cropping(&[image("a", None), image("b", by("A", 1.0, [3000, 2000]))]));
        assert!(!states_cropping(&[image("a", by("A", 1.0, [2000, 3000]))]));
        assert!(states_cropping(&[image("a", by("A", 1.0, [4000, 2000]))]));
    }
}
