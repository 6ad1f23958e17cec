//! The same lens at another resolution or crop of its images.

use crate::geometry::camera_matrix::CameraMatrix;
use crate::geometry::lens::Lens;
use crate::geometry::pixel::ImageSize;

/// A part of an image, in its pixels.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct ImageRegion {
    /// The first column.
    pub left: u32,
    /// The first row.
    pub top: u32,
    /// Its size.
    pub size: ImageSize,
}

/// Text that is no region.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("`{0}` is not a region: write LEFT,TOP,WIDTH,HEIGHT in pixels, as in 160,120,320,240")]
pub struct RegionTextError(String);

impl std::str::FromStr for ImageRegion {
    type Err = RegionTextError;

    /// From `left,top,width,height`.
    fn from_str(text: &str) -> Result<Self, RegionTextError> {
        let numbers: Result<Vec<u32>, _> =
            text.split(',').map(|number| number.trim().parse()).collect();
        match numbers.as_deref() {
            Ok([left, top, width, height]) => {
                Ok(Self { left: *left, top: *top, size: ImageSize::new(*width, *height) })
            }
            _ => Err(RegionTextError(text.to_owned())),
        }
    }
}

/// A region or size for which a lens cannot be computed.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
pub enum RegionError {
    /// No pixels.
    #[error("an image of {0} has no pixels: give a width and a height of at least 1")]
    Empty(ImageSize),
    /// Not all of the region is inside the image.
    #[error("the region {region} at ({left}, {top}) is not inside the image of {image}")]
    Outside {
        /// The region's size.
        region: ImageSize,
        /// Its first column.
        left: u32,
        /// Its first row.
        top: u32,
        /// The image's size.
        image: ImageSize,
    },
    /// Width and height are scaled differently, which requires a crop or a stretch.
    #[error(
        "{from} scaled to {to} would stretch the image: give the region of {from} that it shows, or a size of the same aspect ratio"
    )]
    Stretched {
        /// The size of the calibrated images.
        from: ImageSize,
        /// The requested size.
        to: ImageSize,
    },
}

/// The lens of images of `to` pixels that show `region` of the images of `from`, for which `lens`
/// is valid. A pixel's *area* is scaled, so centers map as x' = (x + ½ − left) · scale − ½;
/// distortion is in normalized coordinates and does not change.
///
/// # Errors
/// An empty size, a region outside the image, or a change of shape by more than one pixel.
pub fn lens_in_region(
    lens: &Lens,
    from: ImageSize,
    region: ImageRegion,
    to: ImageSize,
) -> Result<Lens, RegionError> {
    for size in [from, region.size, to] {
        if size.width == 0 || size.height == 0 {
            return Err(RegionError::Empty(size));
        }
    }
    let ImageRegion { left, top, size } = region;
    let end = |first: u32, length: u32| u64::from(first) + u64::from(length);
    if end(left, size.width) > u64::from(from.width)
        || end(top, size.height) > u64::from(from.height)
    {
        return Err(RegionError::Outside { region: size, left, top, image: from });
    }
    let (across, down) = (
        f64::from(to.width) / f64::from(size.width),
        f64::from(to.height) / f64::from(size.height),
    );
    let expected_height = across * f64::from(size.height);
    if (expected_height - f64::from(to.height)).abs() > 1.0 {
        return Err(RegionError::Stretched { from: size, to });
    }
    let CameraMatrix { fx, fy, cx, cy, skew } = lens.matrix;
    let matrix = CameraMatrix {
        fx: fx * across,
        fy: fy * down,
        cx: (cx + 0.5 - f64::from(left)) * across - 0.5,
        cy: (cy + 0.5 - f64::from(top)) * down - 0.5,
        skew: skew * across,
    };
    Ok(Lens { matrix, ..*lens })
}

/// The lens of whole images scaled from `from` to `to`.
///
/// # Errors
/// As [`lens_in_region`].
pub fn lens_at_size(lens: &Lens, from: ImageSize, to: ImageSize) -> Result<Lens, RegionError> {
    lens_in_region(lens, from, ImageRegion { left: 0, top: 0, size: from }, to)
}

#[cfg(test)]
mod tests {
    use nalgebra::Point3;

    use super::*;
    use crate::geometry::lens::LensModel;

    #[test]
    fn pixels_of_the_region_see_what_they_saw() {
        let parameters = [560.0, 555.0, 328.0, 235.0, 1.5, -0.2, 0.1, 0.001, -0.002, 0.0];
        let lens = Lens::from_parameters(LensModel::Brown, &parameters).unwrap();
        let from = ImageSize::new(640, 480);
        let region = ImageRegion { left: 80, top: 60, size: ImageSize::new(480, 360) };
        let cropped = lens_in_region(&lens, from, region, ImageSize::new(240, 180)).unwrap();
        let point = Point3::new(0.1, -0.2, 1.0);
        let (whole, part) =
            (lens.pixel_from_point(&point).unwrap(), cropped.pixel_from_point(&point).unwrap());
        assert!((part.x - ((whole.x + 0.5 - 80.0) / 2.0 - 0.5)).abs() < 1e-12);
        assert!((part.y - ((whole.y + 0.5 - 60.0) / 2.0 - 0.5)).abs() < 1e-12);
        let doubled = lens_at_size(&lens, from, ImageSize::new(1280, 960)).unwrap();
        assert!((doubled.matrix.cx - 656.5).abs() < 1e-12);
    }

    #[test]
    fn what_no_crop_or_scale_explains_is_refused() {
        let lens =
            Lens::pinhole(CameraMatrix { fx: 500.0, fy: 500.0, cx: 320.0, cy: 240.0, skew: 0.0 });
        let from = ImageSize::new(640, 480);
        let at = |left, width, to| {
            let region = ImageRegion { left, top: 0, size: ImageSize::new(width, 480) };
            lens_in_region(&lens, from, region, to).unwrap_err()
        };
        assert!(matches!(at(1, 640, from), RegionError::Outside { .. }));
        assert!(matches!(at(0, 640, ImageSize::new(1280, 720)), RegionError::Stretched { .. }));
        assert!(matches!(at(0, 640, ImageSize::new(0, 720)), RegionError::Empty(_)));
    }
}
