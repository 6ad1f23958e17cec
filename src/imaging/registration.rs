//! Depth corrected, and depth and colour brought into each other's pictures.

use image::{Rgb, RgbImage};
use nalgebra::Vector3;

use crate::geometry::depth_camera::DepthCamera;
use crate::geometry::lens::Lens;
use crate::geometry::pixel::{ImageSize, Pixel};
use crate::geometry::pose::Pose;
use crate::imaging::depth_conversion::DepthConversion;
use crate::imaging::depth_image::DepthImage;
use crate::imaging::distortion_lookup::DistortionLookup;
use crate::imaging::nearest_canvas::NearestCanvas;
use crate::imaging::point_cloud::CloudPoint;

/// Metric depth as 16-bit readings.
#[derive(Debug, Clone, PartialEq)]
pub struct CorrectedDepth {
    /// Readings; 0 = none.
    pub picture: DepthImage,
    /// Readings whose distance lies outside those that the correction was fitted over: corrected as at the nearest one.
    pub beyond: usize,
    /// Readings that do not fit 16 bits in the unit asked for; they are 0.
    pub overflowed: usize,
}

/// What each pixel of a depth camera's pictures stands for, computed once.
#[derive(Debug, Clone)]
pub struct DepthRegistration {
    camera: DepthCamera,
    /// The ray (x, y, 1) of each pixel, turned to the colour camera's axes; NaN where the lens sees nothing.
    rays_in_color: [Vec<f32>; 3],
    conversion: DepthConversion,
    color: ColorView,
}

/// Where a point of the depth camera's frame is in the colour picture.
#[derive(Debug, Clone)]
struct ColorView {
    size: ImageSize,
    /// Of `color_from_depth`.
    translation: Vector3<f32>,
    lens: Lens,
    lookup: DistortionLookup,
}

/// A reading covers this much of its pixel: a little more than all, so that noise in its neighbours leaves no cracks between.
const FOOTPRINT: f32 = 1.25;
/// A point is hidden from the colour camera by what is nearer than this part of its distance.
const HIDDEN: f32 = 1.03;

impl DepthRegistration {
    /// For the pictures of `camera`, seen from a colour camera with `color` and pictures of `color_size`.
    pub fn new(camera: &DepthCamera, color: &Lens, color_size: ImageSize, color_from_depth: &Pose) -> Self {
        let size = camera.image_size;
        let pixels =
            || (0..size.height).flat_map(move |y| (0..size.width).map(move |x| Pixel::new(f64::from(x), f64::from(y))));
        let rotation = color_from_depth.rotation_matrix();
        let ray = |pixel: Pixel| match camera.lens.bearing_from_pixel(pixel).filter(|bearing| bearing.z > 0.0) {
            Some(bearing) => (rotation * (bearing.into_inner() / bearing.z)).cast().into(),
            None => [f32::NAN; 3],
        };
        let rays: Vec<[f32; 3]> = pixels().map(ray).collect();
        let color = ColorView {
            size: color_size,
            translation: color_from_depth.translation().cast(),
            lens: *color,
            lookup: DistortionLookup::new(color, color_size),
        };
        Self {
            rays_in_color: [0, 1, 2].map(|axis| rays.iter().map(|ray| ray[axis]).collect()),
            conversion: DepthConversion::new(camera),
            camera: camera.clone(),
            color,
        }
    }

    /// The corrected depth of each pixel in metres; 0 where there is none.
    pub fn depths_m(&self, picture: &DepthImage, invalid: Option<u16>) -> Vec<f32> {
        self.conversion.depths_m(picture.readings(), invalid)
    }

    /// Corrected depth in `unit_m`, in the depth camera's own picture.
    pub fn correct(&self, picture: &DepthImage, invalid: Option<u16>, unit_m: f64) -> CorrectedDepth {
        let depths = self.depths_m(picture, invalid);
        let correction = self.camera.correction.as_ref();
        let beyond = |depth: &&f32| **depth > 0.0 && correction.is_some_and(|c| !c.has_seen(1.0 / f64::from(**depth)));
        let beyond = depths.iter().filter(beyond).count();
        let (picture, overflowed) = to_readings(&depths, picture.size(), unit_m);
        CorrectedDepth { picture, beyond, overflowed }
    }

    /// Corrected depth in `unit_m`, as the colour camera would see it: what is behind something nearer is hidden, and what
    /// the depth camera did not see is 0. Each reading covers what its pixel covers of the colour picture.
    pub fn register(&self, picture: &DepthImage, invalid: Option<u16>, unit_m: f64) -> CorrectedDepth {
        let depths = self.depths_m(picture, invalid);
        let nearest = self.nearest_in_color(&depths);
        let (picture, overflowed) = to_readings(&nearest, self.color.size, unit_m);
        CorrectedDepth { picture, beyond: 0, overflowed }
    }

    /// The measured points in the colour camera's frame, row by row of the depth picture; each has the colour that `color`
    /// shows there, black where the colour camera does not see it (outside its picture, or behind something nearer).
    /// `depths` are those of [`Self::depths_m`].
    pub fn points(&self, depths: &[f32], color: Option<&RgbImage>) -> Vec<CloudPoint> {
        let nearest = self.nearest_in_color(depths);
        let point = |(pixel, depth): (usize, &f32)| {
            let point = self.point_in_color(pixel, *depth)?;
            let color = color.and_then(|picture| self.color_of(&point, &nearest, picture));
            Some(CloudPoint { point_m: point.into(), color: color.unwrap_or_default() })
        };
        depths.iter().enumerate().filter_map(point).collect()
    }

    /// The colour picture as the depth camera would see it, as far as depth was measured; black elsewhere, and where
    /// something nearer hides a point from the colour camera. `depths` are those of [`Self::depths_m`].
    pub fn color_in_depth(&self, depths: &[f32], color: &RgbImage) -> RgbImage {
        let nearest = self.nearest_in_color(depths);
        let width = self.camera.image_size.width;
        RgbImage::from_fn(width, self.camera.image_size.height, |x, y| {
            let pixel = (y * width + x) as usize;
            let point = depths.get(pixel).and_then(|depth| self.point_in_color(pixel, *depth));
            Rgb(point.and_then(|point| self.color_of(&point, &nearest, color)).unwrap_or_default())
        })
    }

    /// What the colour picture shows of a point, unless something nearer hides it.
    fn color_of(&self, point: &Vector3<f32>, nearest: &[f32], color: &RgbImage) -> Option<[u8; 3]> {
        let [x, y] = self.color.lookup.pixel(point.x / point.z, point.y / point.z);
        let ColorView { size, .. } = self.color;
        if color.dimensions() != (size.width, size.height) || !(x > -0.5 && y > -0.5) {
            return None;
        }
        let (x, y) = (x.round().max(0.0) as u32, y.round().max(0.0) as u32);
        let seen = nearest.get((y * size.width + x) as usize).filter(|_| x < size.width && y < size.height)?;
        (point.z <= *seen * HIDDEN).then(|| color.get_pixel(x, y).0)
    }

    /// The nearest depth in the colour camera's frame, pixel by pixel of its picture, in metres; 0 for none.
    pub fn nearest_in_color(&self, depths: &[f32]) -> Vec<f32> {
        let half = 0.5 * FOOTPRINT * (self.color.lens.matrix.fx / self.camera.lens.matrix.fx) as f32;
        let width = self.camera.image_size.width.max(1) as usize;
        let mut canvas = NearestCanvas::new(self.color.size, half);
        let mut row = Row { x: vec![0.0; width], y: vec![0.0; width], z: vec![0.0; width] };
        let [x, y, z] = self.rays_in_color.each_ref().map(|axis| axis.chunks_exact(width));
        for (((x, y), z), depths) in x.zip(y).zip(z).zip(depths.chunks_exact(width)) {
            self.color.project([x, y, z], depths, &mut row);
            for (((x, y), z), depth) in row.x.iter().zip(&row.y).zip(&row.z).zip(depths) {
                if *z > 0.0 {
                    canvas.cover(self.color.lookup.pixel(*x, *y), half * depth / z, *z);
                }
            }
        }
        canvas.into_depths()
    }

    /// The point that a depth at the `pixel`-th of the picture stands for, in the colour camera's frame; `None` for no reading,
    /// and behind the camera.
    fn point_in_color(&self, pixel: usize, depth: f32) -> Option<Vector3<f32>> {
        let [x, y, z] = &self.rays_in_color;
        let ray = Vector3::new(*x.get(pixel)?, *y.get(pixel)?, *z.get(pixel)?);
        let point = ray * depth + self.color.translation;
        (depth > 0.0 && point.z > 0.0).then_some(point)
    }
}

impl ColorView {
    /// Where the points that a row of depths stands for are.
    fn project(&self, rays_in_color: [&[f32]; 3], depths: &[f32], row: &mut Row) {
        let ([right, down, ahead], [tx, ty, tz]) = (rays_in_color, self.translation.into());
        let rays = right.iter().zip(down).zip(ahead).zip(depths);
        let points = row.x.iter_mut().zip(&mut row.y).zip(&mut row.z);
        for (((x, y), z), (((right, down), ahead), depth)) in points.zip(rays) {
            let distance = depth * ahead + tz;
            let per_z = 1.0 / distance;
            (*x, *y) = ((depth * right + tx) * per_z, (depth * down + ty) * per_z);
            *z = if *depth > 0.0 && distance > 0.0 { distance } else { 0.0 };
        }
    }
}

/// Points of a row in a camera's frame: x/z, y/z and z in metres; z = 0 for none.
struct Row {
    x: Vec<f32>,
    y: Vec<f32>,
    z: Vec<f32>,
}

/// Metres to readings; what does not fit is 0 and counted.
fn to_readings(depths: &[f32], size: ImageSize, unit_m: f64) -> (DepthImage, usize) {
    let per_unit = (1.0 / unit_m) as f32;
    let mut overflowed = 0;
    let reading = |depth: &f32| {
        // To the nearest, of what is not negative.
        let units = depth * per_unit + 0.5;
        if units >= f32::from(u16::MAX) + 1.0 {
            overflowed += 1;
            return 0;
        }
        units as u16
    };
    let readings = depths.iter().map(reading).collect();
    (DepthImage::new(size, readings).unwrap_or_default(), overflowed)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::camera_matrix::CameraMatrix;
    use crate::geometry::depth_camera::DepthReading;
    use crate::geometry::depth_correction::{CorrectedQuantity, DepthCorrection, SplineGrid};
    use crate::geometry::lens::LensModel;

    const DEPTH_SIZE: ImageSize = ImageSize::new(64, 48);
    const COLOR_SIZE: ImageSize = ImageSize::new(128, 96);

    fn camera(correction: Option<DepthCorrection>) -> DepthCamera {
        DepthCamera {
            image_size: DEPTH_SIZE,
            lens: Lens::pinhole(CameraMatrix { fx: 58.0, fy: 58.0, cx: 31.5, cy: 23.5, skew: 0.0 }),
            reading: DepthReading::Metric { unit_m: 0.001 },
            correction,
        }
    }

    fn color_lens() -> Lens {
        Lens::from_parameters(LensModel::Brown, &[110.0, 110.0, 63.0, 47.0, 0.0, -0.05, 0.01, 0.0, 0.0, 0.0]).unwrap()
    }

    fn registration(correction: Option<DepthCorrection>) -> DepthRegistration {
        let color_from_depth = Pose::from_axis_angle(Vector3::new(0.0, 0.01, 0.0), Vector3::new(0.025, 0.0, 0.0));
        DepthRegistration::new(&camera(correction), &color_lens(), COLOR_SIZE, &color_from_depth)
    }

    #[test]
    fn a_box_before_a_wall_hides_it_and_leaves_a_hole_beside_it() {
        let near = |x: usize, y: usize| (20..40).contains(&x) && (15..35).contains(&y);
        let raw = |k: usize| if near(k % 64, k / 64) { 500 } else { 2000 };
        let picture = DepthImage::new(DEPTH_SIZE, (0..64 * 48).map(raw).collect()).unwrap();
        let registered = registration(None).register(&picture, None, 0.001).picture;
        let middle = registered.row(47);
        let counts = |low: u16, high: u16| middle.iter().filter(|d| (low..high).contains(d)).count();
        // 20 pixels at 0.5 m are 38 of colour's; the box moved by 5.5 px against 1.4 px of the wall.
        assert!((36..=40).contains(&counts(480, 520)), "{middle:?}");
        assert!((5..=12).contains(&counts(0, 1)), "{middle:?}");
        assert_eq!(counts(0, 1) + counts(480, 520) + counts(1950, 2050), 128, "{middle:?}");
    }

    #[test]
    fn color_behind_a_box_is_hidden_from_depth() {
        let near = |x: usize, y: usize| (20..40).contains(&x) && (15..35).contains(&y);
        let raw = |k: usize| {
            if near(k % 64, k / 64) {
                500
            } else if k % 64 == 3 {
                0
            } else {
                2000
            }
        };
        let picture = DepthImage::new(DEPTH_SIZE, (0..64 * 48).map(raw).collect()).unwrap();
        let registration = registration(None);
        let depths = registration.depths_m(&picture, None);
        // Red where the colour camera sees the box, blue where it sees the wall.
        let nearest = registration.nearest_in_color(&depths);
        let color = RgbImage::from_fn(128, 96, |x, y| {
            let seen = nearest[(y * 128 + x) as usize];
            if seen > 0.0 && seen < 1.0 { Rgb([255, 0, 0]) } else { Rgb([0, 0, 255]) }
        });
        let in_depth = registration.color_in_depth(&depths, &color);
        assert_eq!(in_depth.dimensions(), (64, 48));
        let row: Vec<[u8; 3]> = (0..64).map(|x| in_depth.get_pixel(x, 24).0).collect();
        let count = |wanted: [u8; 3], from: usize, to: usize| row[from..to].iter().filter(|c| **c == wanted).count();
        assert!(count([255, 0, 0], 20, 40) >= 19, "{row:?}");
        assert_eq!(count([255, 0, 0], 0, 20) + count([255, 0, 0], 40, 64), 0, "no red beside the box: {row:?}");
        assert_eq!(row[3], [0; 3], "a hole stays one");
        // The box hides a strip of the wall: (25 mm / 0.5 m - 25 mm / 2 m) * 58 px.
        assert!((2..=4).contains(&count([0; 3], 40, 64)) || (2..=4).contains(&count([0; 3], 10, 20)), "{row:?}");

        let points = registration.points(&depths, Some(&color));
        assert_eq!(points.len(), 63 * 48);
        assert!(points.iter().all(|point| point.color != [255, 0, 0] || point.point_m[2] < 0.6));
    }

    #[test]
    fn a_corrected_picture_says_what_it_could_not_know() {
        let grid = SplineGrid::constant(DEPTH_SIZE);
        let mut correction = DepthCorrection::none(CorrectedQuantity::Depth, 1, grid, [0.4, 1.5]);
        correction.coefficients = vec![-0.01];
        let picture = DepthImage::new(
            DEPTH_SIZE,
            (0..64 * 48).map(|k| if k < 64 { 0 } else { 1000 + (k / 1024) as u16 * 1000 }).collect(),
        );
        let corrected = registration(Some(correction)).correct(&picture.unwrap(), None, 0.0001);
        assert_eq!(corrected.picture.row(0), [0; 64]);
        assert_eq!(corrected.picture.row(2)[5], 9900);
        assert_eq!((corrected.beyond, corrected.overflowed), (2048, 0));
    }
}
