//! Depth corrected, and depth and color brought into each other's images.

mod color_view;
mod depth_conversion;
mod distortion_lookup;
mod nearest_canvas;

use std::marker::PhantomData;

use image::{Rgb, RgbImage};
use nalgebra::Vector3;

use crate::geometry::depth_camera::DepthCamera;
use crate::geometry::lens::Lens;
use crate::geometry::pixel::{ImageSize, Pixel};
use crate::geometry::pose::Pose;
use crate::imaging::depth_image::DepthImage;
use crate::imaging::point_cloud::CloudPoint;
use crate::imaging::registration::color_view::ColorView;
use crate::imaging::registration::depth_conversion::{ConversionRow, DepthConversion};
use crate::imaging::registration::nearest_canvas::{HeldDepth, NearestCanvas, SquareRow};

/// Metric depth as 16-bit readings.
#[derive(Debug, Clone, PartialEq)]
pub struct CorrectedDepth {
    /// Readings; 0 = none.
    pub image: DepthImage,
    /// Readings whose distance lies outside those that the correction was fitted over: corrected as
    /// at the nearest one.
    pub beyond: usize,
    /// Readings that do not fit 16 bits in the unit asked for; they are 0.
    pub overflowed: usize,
}

/// What each pixel of a depth camera's images stands for, computed once.
#[derive(Debug, Clone)]
pub struct DepthRegistration {
    camera: DepthCamera,
    /// The ray (x, y, 1) of each pixel, rotated to the color camera's axes; NaN where the lens sees
    /// nothing.
    rays_in_color: [Vec<f32>; 3],
    conversion: DepthConversion,
    color: ColorView,
    /// How many of color's pixels a reading covers to each side, at the same distance from both.
    half: f32,
}

/// A reading covers this much of its pixel: a little more than all, so that noise in its neighbors
/// leaves no cracks between. Chosen, not swept.
const FOOTPRINT_PX: f64 = 1.25;
/// A point is hidden from the color camera if its depth is more than this many times the nearest
/// one at its pixel. Chosen, not swept.
const HIDDEN_DISTANCE_RATIO: f32 = 1.03;

impl DepthRegistration {
    /// For the images of `camera`, seen from a color camera with `color` and images of
    /// `color_size`.
    pub fn new(
        camera: &DepthCamera,
        color: &Lens,
        color_size: ImageSize,
        color_from_depth: &Pose,
    ) -> Self {
        let size = camera.image_size;
        let pixels = || {
            (0..size.height).flat_map(move |y| {
                (0..size.width).map(move |x| Pixel::new(f64::from(x), f64::from(y)))
            })
        };
        let rotation = color_from_depth.rotation_matrix();
        let ray = |pixel: Pixel| match camera
            .lens
            .bearing_from_pixel(pixel)
            .filter(|bearing| bearing.z > 0.0)
        {
            Some(bearing) => (rotation * (bearing.into_inner() / bearing.z)).cast().into(),
            None => [f32::NAN; 3],
        };
        let rays: Vec<[f32; 3]> = pixels().map(ray).collect();
        Self {
            rays_in_color: [0, 1, 2].map(|axis| rays.iter().map(|ray| ray[axis]).collect()),
            conversion: DepthConversion::new(camera),
            half: (0.5 * FOOTPRINT_PX * color.matrix.fx / camera.lens.matrix.fx) as f32,
            camera: camera.clone(),
            color: ColorView::new(color, color_size, color_from_depth),
        }
    }

    /// The corrected depth of each pixel in meters; 0 where there is none.
    pub fn depths_m(&self, image: &DepthImage, invalid: Option<u16>) -> Vec<f32> {
        self.conversion.depths_m(image.readings(), invalid)
    }

    /// Corrected depth in `unit_m`, in the depth camera's own image.
    pub fn correct(&self, image: &DepthImage, invalid: Option<u16>, unit_m: f64) -> CorrectedDepth {
        let depths = self.depths_m(image, invalid);
        let seen_m = self
            .camera
            .correction
            .as_ref()
            .map_or([0.0, f32::INFINITY], |c| c.seen_m.map(|m| m as f32));
        let beyond =
            |depth: &&f32| **depth > 0.0 && !(**depth >= seen_m[0] && **depth <= seen_m[1]);
        let beyond = depths.iter().filter(beyond).count();
        let (image, overflowed) = to_readings(&depths, image.size(), unit_m);
        CorrectedDepth { image, beyond, overflowed }
    }

    /// Corrected depth in `unit_m`, as the color camera would see it: what is behind something
    /// nearer is hidden, and what the depth camera did not see is 0. Each reading covers what its
    /// pixel covers of the color image.
    pub fn register(
        &self,
        image: &DepthImage,
        invalid: Option<u16>,
        unit_m: f64,
    ) -> CorrectedDepth {
        let depths = Depths::Read { readings: image.readings(), invalid };
        let work = Registering {
            registration: self,
            depths,
            per_unit: (1.0 / unit_m) as f32,
            held: PhantomData,
        };
        let (readings, overflowed) = pulp::Arch::new().dispatch(work);
        CorrectedDepth {
            image: DepthImage::new(self.color.size, readings).unwrap_or_default(),
            beyond: 0,
            overflowed,
        }
    }

    /// The measured points in the color camera's frame, row by row of the depth image; each has
    /// the color that `color` shows there, black where the color camera does not see it (outside
    /// its image, or behind something nearer). `depths` are those of [`Self::depths_m`].
    pub fn points(&self, depths: &[f32], color: Option<&RgbImage>) -> Vec<CloudPoint> {
        let nearest = self.nearest_in_color(depths);
        let point = |(pixel, depth): (usize, &f32)| {
            let point = self.point_in_color(pixel, *depth)?;
            let color = color.and_then(|image| self.color_of(&point, &nearest, image));
            Some(CloudPoint { point_m: point.into(), color: color.unwrap_or_default() })
        };
        depths.iter().enumerate().filter_map(point).collect()
    }

    /// The color image as the depth camera would see it, as far as depth was measured; black
    /// elsewhere, and where something nearer hides a point from the color camera. `depths` are
    /// those of [`Self::depths_m`].
    pub fn color_in_depth(&self, depths: &[f32], color: &RgbImage) -> RgbImage {
        let nearest = self.nearest_in_color(depths);
        let width = self.camera.image_size.width;
        RgbImage::from_fn(width, self.camera.image_size.height, |x, y| {
            let pixel = (y * width + x) as usize;
            let point = depths.get(pixel).and_then(|depth| self.point_in_color(pixel, *depth));
            Rgb(point.and_then(|point| self.color_of(&point, &nearest, color)).unwrap_or_default())
        })
    }

    /// What the color image shows of a point, unless something nearer hides it.
    fn color_of(&self, point: &Vector3<f32>, nearest: &[f32], color: &RgbImage) -> Option<[u8; 3]> {
        let [x, y] = self.color.pixel(point.x / point.z, point.y / point.z);
        let ColorView { size, .. } = self.color;
        if color.dimensions() != (size.width, size.height) || !(x > -0.5 && y > -0.5) {
            return None;
        }
        let (x, y) = (x.round().max(0.0) as u32, y.round().max(0.0) as u32);
        let seen = nearest
            .get((y * size.width + x) as usize)
            .filter(|_| x < size.width && y < size.height)?;
        (point.z <= *seen * HIDDEN_DISTANCE_RATIO).then(|| color.get_pixel(x, y).0)
    }

    /// The nearest depth in the color camera's frame, pixel by pixel of its image, in meters; 0
    /// for none. `depths` are those of [`Self::depths_m`].
    pub fn nearest_in_color(&self, depths: &[f32]) -> Vec<f32> {
        let depths = Depths::Meters(depths);
        pulp::Arch::new()
            .dispatch(Registering { registration: self, depths, per_unit: 1.0, held: PhantomData })
            .0
    }

    /// The point that a depth at the `pixel`-th of the image stands for, in the color camera's
    /// frame; `None` for no reading, and behind the camera.
    fn point_in_color(&self, pixel: usize, depth: f32) -> Option<Vector3<f32>> {
        let [x, y, z] = &self.rays_in_color;
        let ray = Vector3::new(*x.get(pixel)?, *y.get(pixel)?, *z.get(pixel)?);
        let point = ray * depth + self.color.translation;
        (depth > 0.0 && point.z > 0.0).then_some(point)
    }
}

/// What is registered.
enum Depths<'a> {
    Read { readings: &'a [u16], invalid: Option<u16> },
    Meters(&'a [f32]),
}

/// Registering a whole image, as one depth of each pixel of color, and how many depths do not
/// fit. A struct, not a closure: all of it must be inlined to be compiled for the processor.
struct Registering<'a, T> {
    registration: &'a DepthRegistration,
    depths: Depths<'a>,
    per_unit: f32,
    held: PhantomData<T>,
}

impl<T: HeldDepth> pulp::NullaryFnOnce for Registering<'_, T> {
    type Output = (Vec<T>, usize);

    #[inline(always)]
    fn call(self) -> Self::Output {
        let DepthRegistration { camera, rays_in_color, conversion, color, half } =
            self.registration;
        let width = camera.image_size.width.max(1) as usize;
        let mut canvas = NearestCanvas::<T>::new(color.size, *half);
        let (mut squares, mut working) = (SquareRow::new(width), ConversionRow::default());
        let (mut depths, mut overflowed) = (vec![0.0; width], 0);
        let [x, y, z] = rays_in_color.each_ref().map(|axis| axis.chunks_exact(width));
        for (row, ((x, y), z)) in x.zip(y).zip(z).enumerate() {
            let here = row * width..(row + 1) * width;
            match self.depths {
                Depths::Read { readings, invalid } => {
                    let Some(readings) = readings.get(here) else { break };
                    conversion.convert_row(row, readings, invalid, &mut working, &mut depths);
                }
                Depths::Meters(meters) => {
                    let Some(meters) = meters.get(here) else { break };
                    depths.copy_from_slice(meters);
                }
            }
            color.project([x, y, z], &depths, *half, &mut squares);
            canvas.cover(&mut squares, self.per_unit);
            overflowed +=
                squares.depth.iter().filter(|depth| !T::fits(**depth, self.per_unit)).count();
        }
        (canvas.into_depths(), overflowed)
    }
}

/// Meters to readings; what does not fit is 0 and counted.
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
        Lens::from_parameters(
            LensModel::Brown,
            &[110.0, 110.0, 63.0, 47.0, 0.0, -0.05, 0.01, 0.0, 0.0, 0.0],
        )
        .unwrap()
    }

    fn registration(correction: Option<DepthCorrection>) -> DepthRegistration {
        DepthRegistration::new(&camera(correction), &color_lens(), COLOR_SIZE, &color_from_depth())
    }

    fn color_from_depth() -> Pose {
        Pose::from_axis_angle(Vector3::new(0.0, 0.01, 0.0), Vector3::new(0.025, 0.0, 0.0))
    }

    #[test]
    fn a_box_before_a_wall_hides_it_and_leaves_a_hole_beside_it() {
        let near = |x: usize, y: usize| (20..40).contains(&x) && (15..35).contains(&y);
        let raw = |k: usize| if near(k % 64, k / 64) { 500 } else { 2000 };
        let image = DepthImage::new(DEPTH_SIZE, (0..64 * 48).map(raw).collect()).unwrap();
        let registered = registration(None).register(&image, None, 0.001).image;
        let middle = registered.row(47);
        let counts =
            |low: u16, high: u16| middle.iter().filter(|d| (low..high).contains(d)).count();
        // 20 pixels at 0.5 m are 38 of color's; the box moved by 5.5 px against 1.4 px of the
        // wall.
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
        let image = DepthImage::new(DEPTH_SIZE, (0..64 * 48).map(raw).collect()).unwrap();
        let registration = registration(None);
        let depths = registration.depths_m(&image, None);
        // Red where the color camera sees the box, blue where it sees the wall.
        let nearest = registration.nearest_in_color(&depths);
        let color = RgbImage::from_fn(128, 96, |x, y| {
            let seen = nearest[(y * 128 + x) as usize];
            if seen > 0.0 && seen < 1.0 { Rgb([255, 0, 0]) } else { Rgb([0, 0, 255]) }
        });
        let in_depth = registration.color_in_depth(&depths, &color);
        assert_eq!(in_depth.dimensions(), (64, 48));
        let row: Vec<[u8; 3]> = (0..64).map(|x| in_depth.get_pixel(x, 24).0).collect();
        let count = |wanted: [u8; 3], from: usize, to: usize| {
            row[from..to].iter().filter(|c| **c == wanted).count()
        };
        assert!(count([255, 0, 0], 20, 40) >= 19, "{row:?}");
        assert_eq!(
            count([255, 0, 0], 0, 20) + count([255, 0, 0], 40, 64),
            0,
            "no red beside the box: {row:?}"
        );
        assert_eq!(row[3], [0; 3], "a hole stays one");
        // The color camera stands 25 mm to the left, so the box hides a strip of the wall at its
        // right: (25 mm / 0.5 m - 25 mm / 2 m) * 58 px = 2.2 px, and a reading covers a little
        // more.
        assert!((2..=4).contains(&count([0; 3], 40, 64)), "{row:?}");
        assert_eq!(count([0; 3], 10, 20), 0, "{row:?}");

        let points = registration.points(&depths, Some(&color));
        assert_eq!(points.len(), 63 * 48);
        assert!(points.iter().all(|point| point.color != [255, 0, 0] || point.point_m[2] < 0.6));
    }

    #[test]
    fn a_corrected_image_says_what_it_could_not_know() {
        let grid = SplineGrid::constant(DEPTH_SIZE);
        let mut correction = DepthCorrection::none(CorrectedQuantity::Depth, 1, grid, [0.4, 1.5]);
        correction.coefficients = vec![-0.01];
        let image = DepthImage::new(
            DEPTH_SIZE,
            (0..64 * 48)
                .map(|k| if k < 64 { 0 } else { 1000 + (k / 1024) as u16 * 1000 })
                .collect(),
        );
        let corrected = registration(Some(correction)).correct(&image.unwrap(), None, 0.0001);
        assert_eq!(corrected.image.row(0), [0; 64]);
        assert_eq!(corrected.image.row(2)[5], 9900);
        assert_eq!((corrected.beyond, corrected.overflowed), (2048, 0));
    }

    /// Depth in color by its definition, in double precision, with squares that reach `more`
    /// pixels farther to each side.
    fn by_definition(
        camera: &DepthCamera,
        color: &Lens,
        image: &DepthImage,
        more: f64,
    ) -> Vec<f64> {
        let color_from_depth = color_from_depth();
        let mut nearest = vec![f64::INFINITY; (COLOR_SIZE.width * COLOR_SIZE.height) as usize];
        for (k, reading) in image.readings().iter().enumerate().filter(|(_, reading)| **reading > 0)
        {
            let pixel = Pixel::new((k % 64) as f64, (k / 64) as f64);
            let Some(point) = camera.point_from_reading(pixel, f64::from(*reading)) else {
                continue;
            };
            let in_color = color_from_depth * point;
            let Some(at) = color.pixel_from_point(&in_color) else { continue };
            let half = 0.5 * FOOTPRINT_PX * color.matrix.fx / camera.lens.matrix.fx * point.z
                / in_color.z
                + more;
            for (y, row) in nearest.chunks_exact_mut(COLOR_SIZE.width as usize).enumerate() {
                for (x, nearest) in row.iter_mut().enumerate() {
                    let covers = |at: f64, pixel: usize| {
                        pixel as f64 >= at - half && (pixel as f64) < at + half
                    };
                    if covers(at.x, x) && covers(at.y, y) {
                        *nearest = nearest.min(in_color.z);
                    }
                }
            }
        }
        nearest
    }

    #[test]
    fn every_pixel_is_as_in_double_precision() {
        let grid = SplineGrid { size: DEPTH_SIZE, cols: 3, rows: 2 };
        let mut correction =
            DepthCorrection::none(CorrectedQuantity::InverseDepth, 2, grid, [0.5, 2.5]);
        correction
            .coefficients
            .iter_mut()
            .enumerate()
            .for_each(|(k, c)| *c = 0.02 * (k as f64).sin());
        let noise = |k: usize| (k * 7919 % 61) as u16;
        let raw = |k: usize| match (k % 64, k / 64) {
            (20..40, 15..35) => 700 + noise(k),
            (x, y) if (x + 3 * y) % 29 == 0 => 0,
            (x, y) => 1500 + 10 * (x + y) as u16 + noise(k),
        };
        let image = DepthImage::new(DEPTH_SIZE, (0..64 * 48).map(raw).collect()).unwrap();
        let camera = camera(Some(correction));
        let fisheye = Lens::from_parameters(
            LensModel::KannalaBrandt,
            &[110.0, 110.0, 63.0, 47.0, 0.0, -0.02, 0.003, 0.0, 0.0],
        );
        let rational =
            [110.0, 109.0, 63.0, 47.0, 0.1, 0.3, -0.1, 0.001, -0.002, 0.01, 0.35, -0.05, 0.01];
        let rational = Lens::from_parameters(LensModel::Rational, &rational);
        // In pixels: what the formulas and the table of the lens lose in single precision.
        for (color, tolerance_px) in
            [(color_lens(), 1e-3), (rational.unwrap(), 1e-3), (fisheye.unwrap(), 1e-2)]
        {
            let registration =
                DepthRegistration::new(&camera, &color, COLOR_SIZE, &color_from_depth());
            let registered = registration.register(&image, None, 0.0001).image;
            let most = by_definition(&camera, &color, &image, tolerance_px);
            let least = by_definition(&camera, &color, &image, -tolerance_px);
            let mut alike = 0;
            for (k, reading) in registered.readings().iter().enumerate() {
                let depth = if *reading > 0 { f64::from(*reading) } else { f64::INFINITY };
                let (low, high) = (most[k] * 1e4 - 0.51, least[k] * 1e4 + 0.51);
                assert!(
                    depth >= low && depth <= high,
                    "{color:?} at {k}: {depth}, not within {low} to {high}"
                );
                alike += usize::from(low + 1.1 > high || high.is_infinite() && low.is_infinite());
            }
            assert!(
                alike > registered.readings().len() * 95 / 100,
                "{alike} pixels are decided exactly"
            );
        }
    }
}
