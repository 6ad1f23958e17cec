//! The unit of a scene's lengths from depth images that were taken together with its images.
//!
//! A scene point has a depth in the depth camera, up to the scale of all lengths; the depth image
//! has a reading there, in meters. Only surfaces count: a plane is fitted to the readings around
//! the place, and where it does not fit, near the edge of something, the place says nothing. Where
//! a point lies in the depth image depends a little on the scale (the sensors are some centimeters
//! from each other), so that both are found alternately.
//!
//! What depth and color cannot show is a factor on all depth: the stated unit is taken as it is,
//! and the depth camera's own scale as depth cameras have it.

use std::sync::Arc;

use nalgebra::{Matrix3, Point3, Vector3};

use crate::calibration::result::SceneScale;
use crate::calibration::rgbd_input::DepthSensor;
use crate::calibration::scene::result::{SceneCalibration, ScenePoint};
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
    /// What is known of the depth camera.
    pub sensor: DepthSensor,
    /// By image, in the order of the images; `None` for one without depth.
    pub images: Vec<Option<Arc<DepthImage>>>,
}

/// Why lengths stay without a unit.
#[derive(Debug, Clone, Copy, PartialEq, thiserror::Error)]
pub enum NoScale {
    /// A rotation has no lengths.
    #[error("the camera only rotated, which has no lengths; move it too")]
    OnlyRotated,
    /// Disparity of unknown meaning.
    #[error("what depth's numbers mean is not stated: state it, or calibrate depth with a board")]
    NoReading,
    /// Where a point lies in the depth image is not known.
    #[error(
        "depth's lens and where it is from color are not stated: a folder's sensors.toml has depth.lens and color_from_depth, a recording the camera_info and tf_static of both"
    )]
    NoLens,
    /// Depth images of several sizes have no common lens.
    #[error("depth images are {first} and {other}: a lens is of one size")]
    DifferentSizes {
        /// The first.
        first: ImageSize,
        /// Another.
        other: ImageSize,
    },
    /// Next to nothing was measured where points are.
    #[error(
        "depth measured {readings} surfaces with scene points in {views} images, which is too few: show surfaces within depth's reach"
    )]
    TooFew {
        /// Readings.
        readings: usize,
        /// Images with any.
        views: usize,
    },
    /// Scene and depth are of different things.
    #[error(
        "depth does not fit the scene (ratios scatter by {percent:.0} %): check that depth is of the same moments, and its lens and pose"
    )]
    Disagrees {
        /// The standard deviation of ratios.
        percent: f64,
    },
    /// No depth camera measures that.
    #[error(
        "depth says that things are {distance_m} m away, which no depth camera measures: check its unit"
    )]
    Implausible {
        /// The median depth.
        distance_m: f64,
    },
}

/// Readings on each side of a place that its plane is fitted to, in pixels: five by five are enough
/// to show an edge and to average noise, and few enough to be one surface.
const AROUND: usize = 2;
/// Readings that a plane is fitted to at least, of the 25.
const LEAST_AROUND: usize = 17;
/// Readings that are off their plane by more than this part of the depth (root mean square) are not
/// of one surface: a step of a tenth leaves a fortieth.
const OFF_PLANE: f64 = 0.025;
/// Points whose own depth is less certain than this part of itself do not count: rays that are
/// nearly parallel meet anywhere.
const LARGEST_POINT_STD: f64 = 0.1;
/// No comparison is taken to be more certain than this part of the depth: depth cameras have
/// errors of that size that change over the image.
const LEAST_STD: f64 = 0.005;
/// Observations are not taken to be more certain than this, in pixels.
const LEAST_NOISE_PX: f64 = 0.2;
/// Fewer readings, or of fewer images, do not show how they differ.
const LEAST_READINGS: usize = 30;
const LEAST_VIEWS: usize = 3;
/// Ratios with a greater standard deviation, as a part of themselves, are not of one scene: depth
/// cameras measure to some per cent.
const LARGEST_STD: f64 = 0.1;
/// What depth cameras measure, in meters, with room to both sides.
const PLAUSIBLE_M: [f64; 2] = [0.03, 100.0];
/// How often scale and places are found alternately: sensors are a hundredth of the depth from each
/// other, so that each round is a hundred times nearer.
const MOST_ROUNDS: usize = 8;
/// Scales that differ by less are the same.
const SAME: f64 = 1e-6;
/// The standard deviation of a depth camera's own scale, as a part of it: cameras are sold as
/// within 2 %, which are two of these.
const OWN_SCALE_STD: f64 = 0.01;
/// Regions along each side of the depth image, in which its error is much the same.
const REGIONS: usize = 4;

impl SceneCalibration {
    /// The same with lengths in meters where `depth` gives them; where not, with the reason among
    /// those of the verdict.
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

/// How many meters a unit of the scene is, and how well that is known.
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
        if step.abs() < SAME {
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
    // Depth is along the axis. Across it lengths are as wrong as the focal length.
    let focal_std = scene.sensor.lens_std[0] / scene.sensor.lens.matrix.fx;
    let relative_std = relative_std.hypot(focal_std).hypot(OWN_SCALE_STD);
    Ok((unit_m, SceneScale { relative_std, readings: used, views }))
}

/// What is known of the depth camera, where that is enough.
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

    /// The surface at `pixel`; `None` where no one surface was measured.
    fn surface(&self, image: &DepthImage, pixel: Pixel) -> Option<Surface> {
        let ImageSize { width, height } = self.camera.image_size;
        let margin = AROUND as f64;
        let inside = |at: f64, length: u32| at >= margin && at < f64::from(length) - 1.0 - margin;
        if !inside(pixel.x, width) || !inside(pixel.y, height) {
            return None;
        }
        let (column, row) = (pixel.x.round() as usize, pixel.y.round() as usize);
        let mut samples: Vec<(Vector3<f64>, f64)> = Vec::new();
        for y in row - AROUND..=row + AROUND {
            for (x, reading) in
                image.row(y).iter().enumerate().take(column + AROUND + 1).skip(column - AROUND)
            {
                let at = Pixel::new(x as f64, y as f64);
                if let Some(inverse) = self.reading(at, *reading) {
                    samples.push((Vector3::new(1.0, at.x - pixel.x, at.y - pixel.y), inverse));
                }
            }
        }
        (samples.len() >= LEAST_AROUND).then(|| on_plane(&samples)).flatten()
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
    /// The standard deviation of that, as a part of it.
    relative_std: f64,
}

/// The value at the origin of the plane through `samples` (1, x, y → 1/z, in which a plane is
/// linear); `None` where they are not of one plane.
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
    (inverse_depth > 0.0 && rms <= OFF_PLANE * inverse_depth)
        .then_some(Surface { inverse_depth, relative_std })
}

/// A measured depth beside a point's.
struct Compared {
    /// The logarithm of the measured over the point's.
    log_ratio: f64,
    /// The standard deviation of the measured, as a part of it.
    relative_std: f64,
    /// The measured.
    depth_m: f64,
    /// The region of the depth image.
    region: usize,
}

/// Scene and depth, to compare.
struct DepthComparison<'a> {
    scene: &'a SceneCalibration,
    depth: &'a SceneDepth,
    camera: SceneDepthCamera,
    /// The points whose own depth is known, by their place in the list, each with the standard
    /// deviation of its depth as a part of it.
    certain: Vec<(usize, f64)>,
}

impl DepthComparison<'_> {
    /// All comparisons where a unit of the scene is `unit_m` meters; without it, as if the depth
    /// camera were where color is, against units of the scene.
    fn readings(&self, unit_m: Option<f64>) -> Vec<ScaleReading> {
        let mut readings = Vec::new();
        for (point, point_std) in &self.certain {
            let ScenePoint { point: in_scene, seen, .. } = &self.scene.points[*point];
            for (view, _) in seen {
                let found = self.compared(*view, in_scene, unit_m);
                readings.extend(found.map(
                    |Compared { log_ratio, relative_std, depth_m, region }| {
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
    ) -> Option<Compared> {
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
        let part = |at: f64, length: u32| (at / f64::from(length) * REGIONS as f64) as usize;
        let region = part(pixel.y, height) * REGIONS + part(pixel.x, width);
        let log_ratio = -(inverse_depth * in_depth.z).ln();
        let depth_m = 1.0 / inverse_depth;
        (in_depth.z > 0.0).then_some(Compared { log_ratio, relative_std, depth_m, region })
    }

    /// The median depth of points in color, in units of the scene.
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

/// The points whose depth is certain, each with its standard deviation as a part of it: the noise
/// of their pixels over the focal length and the widest angle between their rays.
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
