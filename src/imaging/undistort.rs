//! Images as a lens without distortion would have taken them.

use nalgebra::Vector2;

use crate::geometry::camera_matrix::CameraMatrix;
use crate::geometry::flat_image::{WIDEST, flat_from_ray};
use crate::geometry::lens::Lens;
use crate::geometry::pixel::{ImageSize, Pixel};
use crate::imaging::remap::PixelMap;

/// What of the image to keep.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct UndistortOptions {
    /// 0, the default: the result has only valid pixels. 1: all source pixels are in it. As
    /// OpenCV's `alpha` of `getOptimalNewCameraMatrix`, but for the focal lengths, whose ratio
    /// stays.
    pub balance: f64,
    /// The size of the result; that of the image unless said.
    pub size: Option<ImageSize>,
}

/// How to undistort the images of one lens.
#[derive(Debug, Clone)]
pub struct Undistortion {
    /// The pinhole lens of the results.
    pub lens: Lens,
    /// Where each pixel of the result is in the image.
    pub map: PixelMap,
}

impl Undistortion {
    /// For images of `size` taken with `lens`. Takes about 30 ns a pixel, once; each image is
    /// then one pass of [`PixelMap::gray`] or [`PixelMap::rgb`].
    pub fn new(lens: &Lens, size: ImageSize, options: &UndistortOptions) -> Self {
        let target = options.size.unwrap_or(size);
        let matrix = flat_matrix(lens, size, target, options.balance.clamp(0.0, 1.0));
        let flat = Lens::pinhole(matrix);
        let map = PixelMap::new(size, target, |pixel| {
            let at = matrix.normalized_from_pixel(pixel);
            lens.pixel_from_point(&nalgebra::Point3::new(at.x, at.y, 1.0))
        });
        Self { lens: flat, map }
    }

    /// Where `pixel` of the image is in the result; `None` for what a flat image cannot show.
    pub fn flat_from_pixel(&self, lens: &Lens, pixel: Pixel) -> Option<Pixel> {
        let bearing = lens.bearing_from_pixel(pixel)?;
        (bearing.z > 0.0).then(|| self.lens.pixel_from_point(&bearing.into_inner().into()))?
    }
}

/// A rectangle of normalized coordinates.
#[derive(Debug, Clone, Copy)]
struct FieldOfView {
    low: Vector2<f64>,
    high: Vector2<f64>,
}

/// The camera matrix that shows what `balance` asks for.
fn flat_matrix(lens: &Lens, size: ImageSize, target: ImageSize, balance: f64) -> CameraMatrix {
    let CameraMatrix { fx, fy, .. } = lens.matrix;
    let (inner, outer) = fields(lens, size);
    let span = Vector2::new(f64::from(target.width) - 1.0, f64::from(target.height) - 1.0)
        .map(|s| s.max(1.0));
    // Focal lengths, in units of fx, that fill the result with a field along x and along y.
    let scales = |field: FieldOfView| {
        let extent = (field.high - field.low).map(|extent| extent.max(1e-9));
        [span.x / (fx * extent.x), span.y / (fy * extent.y)]
    };
    let ([a, b], [c, d]) = (scales(inner), scales(outer));
    let scale = a.max(b) * (1.0 - balance) + c.min(d) * balance;
    let middle = |field: FieldOfView| 0.5 * (field.low + field.high);
    let center = middle(inner).lerp(&middle(outer), balance);
    CameraMatrix {
        fx: scale * fx,
        fy: scale * fy,
        cx: 0.5 * span.x - scale * fx * center.x,
        cy: 0.5 * span.y - scale * fy * center.y,
        skew: 0.0,
    }
}

/// The largest field that is seen everywhere (by the image's sides), and the smallest that holds
/// all that is seen.
fn fields(lens: &Lens, size: ImageSize) -> (FieldOfView, FieldOfView) {
    // Samples of each of the image's sides. Chosen.
    const STEPS: u32 = 32;
    let [right, bottom] = [f64::from(size.width) - 1.0, f64::from(size.height) - 1.0];
    let seen =
        |x: f64, y: f64| lens.bearing_from_pixel(Pixel::new(x, y)).map(|ray| flat_from_ray(&ray));
    let mut inner = FieldOfView { low: Vector2::repeat(-WIDEST), high: Vector2::repeat(WIDEST) };
    let mut outer = FieldOfView {
        low: Vector2::repeat(f64::INFINITY),
        high: Vector2::repeat(f64::NEG_INFINITY),
    };
    let mut any = false;
    for step in 0..=STEPS {
        let part = f64::from(step) / f64::from(STEPS);
        let (x, y) = (part * right, part * bottom);
        for (side, at) in
            [seen(0.0, y), seen(right, y), seen(x, 0.0), seen(x, bottom)].into_iter().enumerate()
        {
            let Some(at) = at else { continue };
            any = true;
            match side {
                0 => inner.low.x = inner.low.x.max(at.x),
                1 => inner.high.x = inner.high.x.min(at.x),
                2 => inner.low.y = inner.low.y.max(at.y),
                _ => inner.high.y = inner.high.y.min(at.y),
            }
            outer.low = outer.low.inf(&at);
            outer.high = outer.high.sup(&at);
        }
    }
    if !any {
        // The model ends inside the image: all of its valid region is to be shown.
        outer = inner;
    }
    (inner, outer)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::lens::LensModel;
    use crate::imaging::gray::GrayImage;
    use crate::imaging::remap::Interpolation;

    fn lens(model: LensModel, coefficients: &[f64]) -> Lens {
        let parameters: Vec<f64> =
            [95.0, 96.0, 82.0, 57.0, 0.0].iter().chain(coefficients).copied().collect();
        Lens::from_parameters(model, &parameters).unwrap()
    }

    fn lenses() -> [Lens; 4] {
        [
            lens(LensModel::Pinhole, &[]),
            lens(LensModel::Brown, &[-0.2, 0.05, 1e-3, -1e-3, 0.0]),
            lens(LensModel::Radial, &[0.1]),
            lens(LensModel::KannalaBrandt, &[0.05, -0.01, 0.0, 0.0]),
        ]
    }

    #[test]
    fn without_balance_every_pixel_is_seen_and_with_it_everything_seen_is_there() {
        let size = ImageSize::new(160, 120);
        for lens in lenses() {
            let tight = Undistortion::new(&lens, size, &UndistortOptions::default());
            assert!(
                tight.map.seen_fraction() > 0.999,
                "{} of {}",
                tight.map.seen_fraction(),
                lens.model()
            );
            let wide =
                Undistortion::new(&lens, size, &UndistortOptions { balance: 1.0, size: None });
            for (x, y) in [(0.0, 0.0), (159.0, 0.0), (80.0, 119.0), (0.0, 60.0), (159.0, 119.0)] {
                let at = wide.flat_from_pixel(&lens, Pixel::new(x, y)).unwrap();
                let inside = at.x > -0.6 && at.y > -0.6 && at.x < 159.6 && at.y < 119.6;
                assert!(inside, "{at:?} of {}", lens.model());
            }
        }
    }

    #[test]
    fn the_image_of_a_line_becomes_straight() {
        let size = ImageSize::new(160, 120);
        for lens in lenses() {
            // A dark line in space, as the lens draws it.
            let (a, b, c) = (0.3, 1.0, 0.12);
            let distance = |at: Vector2<f64>| (a * at.x + b * at.y - c) / f64::hypot(a, b);
            let pixels = (0..160 * 120).map(|k| {
                let ray = lens
                    .bearing_from_pixel(Pixel::new(f64::from(k % 160), f64::from(k / 160)))
                    .unwrap();
                let off = distance(Vector2::new(ray.x / ray.z, ray.y / ray.z)) * 95.0;
                (255.0 * (1.0 - (-0.5 * (off / 1.5).powi(2)).exp())) as u8
            });
            let image = GrayImage::from_pixels(160, 120, pixels.collect()).unwrap();
            let undistortion = Undistortion::new(&lens, size, &UndistortOptions::default());
            let flat = undistortion.map.gray(image.view(), Interpolation::Bicubic).unwrap();
            let matrix = undistortion.lens.matrix;
            for x in (10..150).step_by(10) {
                let column = (0..120).map(|y| (y as f64, 255.0 - f64::from(flat.row(y)[x])));
                let (moment, mass) =
                    column.fold((0.0, 0.0), |(m, w), (y, dark)| (m + y * dark, w + dark));
                if mass < 300.0 {
                    continue;
                }
                let expected =
                    (c - a * (x as f64 - matrix.cx) / matrix.fx) / b * matrix.fy + matrix.cy;
                let near_edge = !(8.0..112.0).contains(&expected);
                assert!(
                    near_edge || (moment / mass - expected).abs() < 0.05,
                    "at {x}: {} {expected}",
                    moment / mass
                );
            }
        }
    }
}
