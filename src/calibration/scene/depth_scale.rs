//! The unit of a scene's lengths from depth images that were taken together with its images.
//!
//! A scene point has a depth in the depth camera, up to the common scale of all lengths; the depth
//! image has a reading there, in meters. Only readings on surfaces count: a plane is fitted to the
//! readings around the pixel, and where it does not fit, at a depth edge, the pixel is skipped.
//! Where a point projects into the depth image depends a little on the scale (the sensors are some
//! centimeters from each other), so that scale and projections are found alternately.
//!
//! A common factor on all depth cannot be observed: the stated unit is taken as it is, and the
//! depth camera's own scale error is taken from what such cameras have.

use std::sync::Arc;

use nalgebra::{Matrix3, Point3, Vector3};

use crate::calibration::result::SceneScale;
use crate::calibration::scene::result::{SceneCalibration, ScenePoint};
use crate::calibration::solve::rgbd_input::DepthSensor;
use crate::estimation::scene::bundle::CameraMotion;
use crate::estimation::scene::metric_scale::{ScaleEstimate, ScaleReading, metric_scale};
use crate::estimation::two_view::triangulation::parallax;
use crate::geometry::depth_camera::{DepthCamera, DepthReading, PosedDepthLens};
use crate::geometry::median::median;
use crate::geometry::pixel::{ImageSize, Pixel};
use crate::geometry::pose::Pose;
use crate::imaging::depth_image::DepthImage;

/// Depth that was taken together with the images of a scene.
#[derive(Debug, Clone, PartialEq)]
pub struct SceneDepth {
    /// The depth camera, as far as it is known.
    pub sensor: DepthSensor,
    /// By image, in the order of the images; `None` for one without depth.
    pub images: Vec<Option<Arc<DepthImage>>>,
}

/// Why lengths have no unit.
#[derive(Debug, Clone, Copy, PartialEq, thiserror::Error)]
pub enum NoScale {
    /// A rotation has no lengths.
    #[error("the camera only rotated, so the scale cannot be determined; also move it sideways")]
    OnlyRotated,
    /// The meaning of the disparity is unknown.
    #[error(
        "the meaning of the depth readings is unknown: state it (in a folder's sensors.toml), or calibrate depth with a board"
    )]
    NoReading,
    /// The depth camera's lens or pose is unknown, so a point's pixel in the depth image is too.
    #[error(
        "the depth camera's lens and its pose relative to color are unknown: give depth.lens and color_from_depth in the folder's sensors.toml; a recording needs camera_info and tf_static of both sensors"
    )]
    NoLens,
    /// Depth images of several sizes have no common lens.
    #[error("depth images have different sizes ({first} and {other}): use images of one size")]
    DifferentSizes {
        /// The first.
        first: ImageSize,
        /// Another.
        other: ImageSize,
    },
    /// Too few scene points have a reading.
    #[error(
        "only {readings} scene points in {views} images have a depth reading, which is too few: show surfaces within the depth camera's range"
    )]
    TooFew {
        /// Readings.
        readings: usize,
        /// Images with any.
        views: usize,
    },
    /// The depth images do not show the scene.
    #[error(
        "depth does not fit the scene (the scale ratios scatter by {percent:.0} %): check that depth and color were taken at the same time, and the depth camera's lens and pose"
    )]
    Disagrees {
        /// The standard deviation of ratios.
        percent: f64,
    },
    /// No depth camera measures that.
    #[error(
        "the depth readings ({distance_m} m) are outside any depth camera's range: check their unit"
    )]
    Implausible {
        /// The median depth.
        distance_m: f64,
    },
}

/// Readings on each side of a pixel that its plane is fitted to, in pixels: five by five are enough
/// to show a depth edge and to average noise, and few enough to lie on one surface.
const MARGIN_PX: usize = 2;
/// The least number of valid readings that a plane is fitted to, of the 25.
const LEAST_PLANE_READINGS: usize = 17;
/// Readings whose root mean square distance from their plane exceeds this fraction of the depth are
/// not on one surface: a step of a tenth leaves a fortieth.
const LARGEST_PLANE_RMS: f64 = 0.025;
/// Points whose relative standard deviation of depth is greater than this are skipped: nearly
/// parallel rays hardly determine where they meet.
const LARGEST_POINT_STD: f64 = 0.1;
/// The least relative standard deviation of one comparison: depth cameras have errors of that size
/// that vary over the image.
const LEAST_STD: f64 = 0.005;
/// The least standard deviation of an observation, in pixels.
const LEAST_NOISE_PX: f64 = 0.2;
/// Fewer readings, or readings from fewer images, do not show how much they scatter.
const LEAST_READINGS: usize = 30;
const LEAST_VIEWS: usize = 3;
/// If the ratios' relative standard deviation is greater, depth and scene do not match: depth
/// cameras are accurate to a few percent.
const LARGEST_STD: f64 = 0.1;
/// The range that depth cameras measure, in meters, with some margin on both sides.
const PLAUSIBLE_M: [f64; 2] = [0.03, 100.0];
/// The greatest number of alternations of scale and projections: the sensors' distance is about a
/// hundredth of the depth, so each round divides the error by about a hundred.
const MOST_ROUNDS: usize = 8;
/// The alternation ends once the logarithm of the scale changes by less.
const SETTLED_LOG_SCALE: f64 = 1e-6;
/// The relative standard deviation of a depth camera's own scale: cameras are sold as within 2 %,
/// which is two of these.
const OWN_SCALE_STD: f64 = 0.01;
/// Regions along each side of the depth image; the depth error is about constant within one.
const REGIONS_PER_SIDE: usize = 4;

impl SceneCalibration {
    /// The calibration with lengths in meters, if `depth` gives the scale; if not, the verdict gets
    /// the reason.
    #[must_use]
    pub fn in_meters(mut self, depth: &SceneDepth) -> Self {
        match scale_of(&self, depth) {
            Ok((unit_m, scale)) => self.rescale(unit_m, scale),
            Err(reason) => {
                self.verdict.reasons.push(format!("lengths have no unit: {reason}"));
            }
        }
        self
    }

    fn rescale(&mut self, unit_m: f64, scale: SceneScale) {
        for camera_from_scene in self.views.iter_mut().filter_map(|v| v.camera_from_scene.as_mut())
        {
            let translation = camera_from_scene.translation() * unit_m;
            *camera_from_scene = Pose::new(camera_from_scene.rotation(), translation);
        }
        self.points.iter_mut().for_each(|point| point.point *= unit_m);
        self.scale = Some(scale);
    }
}

/// How many meters a unit of the scene is, with its uncertainty.
fn scale_of(scene: &SceneCalibration, depth: &SceneDepth) -> Result<(f64, SceneScale), NoScale> {
    if scene.conditions.motion == CameraMotion::RotationOnly {
        return Err(NoScale::OnlyRotated);
    }
    let Some(camera) = SceneDepthCamera::of(depth)? else {
        return Err(NoScale::TooFew { readings: 0, views: 0 });
    };
    let found = DepthComparison { scene, depth, camera, certain: certain_points(scene) };
    let mut unit_m = None;
    let mut readings = Vec::new();
    for _ in 0..MOST_ROUNDS {
        readings = found.readings(unit_m);
        let Some(step) = median(readings.iter().map(|reading| reading.log_ratio).collect()) else {
            break;
        };
        unit_m = Some(unit_m.unwrap_or(1.0) * f64::exp(step));
        if step.abs() < SETTLED_LOG_SCALE {
            break;
        }
    }
    let estimate = metric_scale(&readings, &scene_points(scene));
    let too_few = NoScale::TooFew {
        readings: estimate.map_or(readings.len(), |estimate| estimate.readings),
        views: estimate.map_or(usize::from(!readings.is_empty()), |estimate| estimate.views),
    };
    let (unit_m, estimate) = unit_m.zip(estimate).ok_or(too_few)?;
    let ScaleEstimate { log_ratio, relative_std, robust_std, readings: used, views, .. } = estimate;
    if used < LEAST_READINGS || views < LEAST_VIEWS {
        return Err(too_few);
    }
    if !(robust_std < LARGEST_STD) {
        return Err(NoScale::Disagrees { percent: 100.0 * robust_std });
    }
    let unit_m = unit_m * log_ratio.exp();
    let distance_m = unit_m * found.median_depth();
    if !(PLAUSIBLE_M[0]..PLAUSIBLE_M[1]).contains(&distance_m) {
        return Err(NoScale::Implausible { distance_m });
    }
    // Depth is measured along the optical axis; lengths across it inherit the focal length's
    // relative error.
    let focal_std = scene.sensor.lens_std[0] / scene.sensor.lens.matrix.fx;
    let relative_std = relative_std.hypot(focal_std).hypot(OWN_SCALE_STD);
    Ok((unit_m, SceneScale { relative_std, readings: used, views }))
}

/// The depth camera, where enough of it is known.
struct SceneDepthCamera {
    camera: DepthCamera,
    invalid: Option<u16>,
    depth_from_color: Pose,
}

impl SceneDepthCamera {
    /// `None` where there is no depth image.
    fn of(depth: &SceneDepth) -> Result<Option<Self>, NoScale> {
        let mut sizes = depth.images.iter().flatten().map(|image| image.size());
        let Some(image_size) = sizes.next() else { return Ok(None) };
        if let Some(other) = sizes.find(|size| *size != image_size) {
            return Err(NoScale::DifferentSizes { first: image_size, other });
        }
        let DepthSensor { reading, invalid, factory, .. } = depth.sensor;
        let reading = reading.ok_or(NoScale::NoReading)?;
        let PosedDepthLens { lens, depth_from_color } = factory.ok_or(NoScale::NoLens)?;
        let camera = DepthCamera { image_size, lens, reading, correction: None };
        Ok(Some(Self { camera, invalid, depth_from_color }))
    }

    /// The surface at `pixel`; `None` where the readings do not lie on one surface.
    fn surface(&self, image: &DepthImage, pixel: Pixel) -> Option<Surface> {
        let ImageSize { width, height } = self.camera.image_size;
        let margin = MARGIN_PX as f64;
        let inside = |at: f64, length: u32| at >= margin && at < f64::from(length) - 1.0 - margin;
        if !inside(pixel.x, width) || !inside(pixel.y, height) {
            return None;
        }
        let (column, row) = (pixel.x.round() as usize, pixel.y.round() as usize);
        let mut samples: Vec<(Vector3<f64>, f64)> = Vec::new();
        for y in row - MARGIN_PX..=row + MARGIN_PX {
            for (x, reading) in image
                .row(y)
                .iter()
                .enumerate()
                .take(column + MARGIN_PX + 1)
                .skip(column - MARGIN_PX)
            {
                let at = Pixel::new(x as f64, y as f64);
                if let Some(inverse) = self.reading(at, *reading) {
                    samples.push((Vector3::new(1.0, at.x - pixel.x, at.y - pixel.y), inverse));
                }
            }
        }
        (samples.len() >= LEAST_PLANE_READINGS).then(|| on_plane(&samples)).flatten()
    }

    fn reading(&self, pixel: Pixel, reading: u16) -> Option<f64> {
        let is_none = Some(reading) == self.invalid
            || (reading == 0 && matches!(self.camera.reading, DepthReading::Metric { .. }));
        (!is_none).then(|| self.camera.inverse_depth(pixel, f64::from(reading))).flatten()
    }
}

/// A measured surface at one place.
struct Surface {
    /// 1/z, in 1/m.
    inverse_depth: f64,
    /// Its relative standard deviation.
    relative_std: f64,
}

/// The plane through `samples` (1, x, y → 1/z, in which a plane is linear), evaluated at the
/// origin; `None` where they do not lie on one plane.
fn on_plane(samples: &[(Vector3<f64>, f64)]) -> Option<Surface> {
    let (mut normal, mut right) = (Matrix3::zeros(), Vector3::zeros());
    for (terms, inverse) in samples {
        normal += terms * terms.transpose();
        right += terms * *inverse;
    }
    let plane = normal.cholesky()?.solve(&right);
    let square = |(terms, inverse): &(Vector3<f64>, f64)| (terms.dot(&plane) - inverse).powi(2);
    let count = samples.len() as f64;
    let rms = (samples.iter().map(square).sum::<f64>() / count).sqrt();
    let inverse_depth = plane[0];
    let relative_std = rms / (count.sqrt() * inverse_depth);
    (inverse_depth > 0.0 && rms <= LARGEST_PLANE_RMS * inverse_depth)
        .then_some(Surface { inverse_depth, relative_std })
}

/// A measured depth, compared with that of the scene point.
struct ComparedDepth {
    /// The logarithm of the measured depth over the point's depth.
    log_ratio: f64,
    /// The relative standard deviation of the measured depth.
    relative_std: f64,
    /// The measured depth.
    depth_m: f64,
    /// The region of the depth image.
    region: usize,
}

/// Scene and depth, to compare.
struct DepthComparison<'a> {
    scene: &'a SceneCalibration,
    depth: &'a SceneDepth,
    camera: SceneDepthCamera,
    /// The points whose depth is determined well enough, as indices, each with its relative
    /// standard deviation of depth.
    certain: Vec<(usize, f64)>,
}

impl DepthComparison<'_> {
    /// All comparisons, if a unit of the scene is `unit_m` meters. Without `unit_m`, the distance
    /// between the sensors is neglected, and ratios are against units of the scene.
    fn readings(&self, unit_m: Option<f64>) -> Vec<ScaleReading> {
        let mut readings = Vec::new();
        for (point, point_std) in &self.certain {
            let ScenePoint { point: in_scene, seen, .. } = &self.scene.points[*point];
            for (view, _) in seen {
                let found = self.compared(*view, in_scene, unit_m);
                readings.extend(found.map(
                    |ComparedDepth { log_ratio, relative_std, depth_m, region }| {
                        let std = point_std.hypot(relative_std).max(LEAST_STD);
                        ScaleReading { log_ratio, std, depth_m, view: *view, point: *point, region }
                    },
                ));
            }
        }
        readings
    }

    fn compared(
        &self,
        view: usize,
        in_scene: &Point3<f64>,
        unit_m: Option<f64>,
    ) -> Option<ComparedDepth> {
        let image = self.depth.images.get(view)?.as_ref()?;
        let in_color = self.scene.views[view].camera_from_scene? * *in_scene;
        let depth_from_color = &self.camera.depth_from_color;
        let in_depth = match unit_m {
            Some(unit_m) => *depth_from_color * Point3::from(in_color.coords * unit_m),
            None => Point3::from(*depth_from_color * in_color.coords),
        };
        let pixel = self.camera.camera.lens.pixel_from_point(&in_depth)?;
        let Surface { inverse_depth, relative_std } = self.camera.surface(image, pixel)?;
        let ImageSize { width, height } = self.camera.camera.image_size;
        let part =
            |at: f64, length: u32| (at / f64::from(length) * REGIONS_PER_SIDE as f64) as usize;
        let region = part(pixel.y, height) * REGIONS_PER_SIDE + part(pixel.x, width);
        let log_ratio = -(inverse_depth * in_depth.z).ln();
        let depth_m = 1.0 / inverse_depth;
        (in_depth.z > 0.0).then_some(ComparedDepth { log_ratio, relative_std, depth_m, region })
    }

    /// The median depth of the points in the color cameras, in units of the scene.
    fn median_depth(&self) -> f64 {
        let depths = self.certain.iter().flat_map(|(point, _)| {
            let ScenePoint { point, seen, .. } = &self.scene.points[*point];
            seen.iter().filter_map(move |(view, _)| {
                Some((self.scene.views[*view].camera_from_scene? * *point).z)
            })
        });
        median(depths.collect()).unwrap_or(0.0)
    }
}

fn scene_points(scene: &SceneCalibration) -> Vec<Point3<f64>> {
    scene.points.iter().map(|point| point.point).collect()
}

/// The points whose depth is determined well enough, each with its relative standard deviation: the
/// pixel noise over the focal length and the widest angle between its rays.
fn certain_points(scene: &SceneCalibration) -> Vec<(usize, f64)> {
    let centers: Vec<Option<Point3<f64>>> = scene
        .views
        .iter()
        .map(|view| Some(Point3::from(view.camera_from_scene?.inverse().translation())))
        .collect();
    let noise = scene.sensor.rms_px.max(LEAST_NOISE_PX) / scene.sensor.lens.matrix.fx;
    let relative_std = |point: &ScenePoint| {
        let seen: Vec<&Point3<f64>> =
            point.seen.iter().filter_map(|(view, _)| centers[*view].as_ref()).collect();
        let pairs =
            seen.iter().enumerate().flat_map(|(k, a)| seen[..k].iter().map(move |b| (a, b)));
        noise / pairs.map(|(a, b)| parallax(a, b, &point.point)).fold(0.0, f64::max)
    };
    let stds = scene.points.iter().map(relative_std).enumerate();
    stds.filter(|(_, std)| *std < LARGEST_POINT_STD).collect()
}
