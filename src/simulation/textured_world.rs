//! A textured world without a board, and a camera that moves through it: the input for calibration
//! without a target. Everything follows from the seed, and the ground truth is exact.

use nalgebra::{Point3, Rotation3, UnitQuaternion, Vector3};
use rand::{Rng, RngExt};

use crate::geometry::pixel::Pixel;
use crate::geometry::pose::Pose;
use crate::imaging::gray::GrayImage;
use crate::simulation::image_sensor::ImageSensor;
use crate::simulation::noise::{Purpose, stream};
use crate::simulation::textured_solids::{TexturedBox, nearest_face};

/// The scene.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Scenery {
    /// A room with furniture.
    Room,
    /// A house front with sills and balconies, seen from the street.
    Facade,
    /// One flat wall.
    Plane,
    /// A long narrow room.
    Corridor,
    /// Objects on the ground in front of a far background.
    Garden,
}

/// The camera's motion.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum CameraPath {
    /// Around the middle of the scene; every third image is rotated by 90 degrees about the optical
    /// axis.
    Orbit,
    /// Sideways, without rotation about the optical axis.
    Sideways,
    /// Along its optical axis.
    Forward,
    /// Pure rotation; every third image by 90 degrees about the optical axis.
    Rotation,
}

impl Scenery {
    /// All of them.
    pub const ALL: [Self; 5] =
        [Self::Room, Self::Facade, Self::Plane, Self::Corridor, Self::Garden];

    /// The scenery with this name.
    pub fn from_name(name: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|scenery| format!("{scenery:?}").eq_ignore_ascii_case(name))
    }
}

impl CameraPath {
    /// All of them.
    pub const ALL: [Self; 4] = [Self::Orbit, Self::Sideways, Self::Forward, Self::Rotation];

    /// The path with this name.
    pub fn from_name(name: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|path| format!("{path:?}").eq_ignore_ascii_case(name))
    }
}

/// What is simulated.
#[derive(Debug, Clone, PartialEq)]
pub struct TexturedWorldOptions {
    /// The seed of everything random.
    pub seed: u64,
    /// The scene.
    pub scenery: Scenery,
    /// The camera's motion.
    pub path: CameraPath,
    /// Images along the path.
    pub images: usize,
    /// The camera.
    pub sensor: ImageSensor,
    /// Whether a box moves in the scene: it is at another place in each image.
    pub has_mover: bool,
}

/// A world that a camera moves through: every image of its path is computed from its number alone.
#[derive(Debug, Clone)]
pub struct TexturedWorld {
    options: TexturedWorldOptions,
    solids: Vec<TexturedBox>,
    cameras_from_world: Vec<Pose>,
    /// The rays through the corners of all pixels, row by row; the third coordinate is 1.
    rays: Vec<Vector3<f64>>,
}

/// The light of rays that meet no solid: a uniform sky.
const SKY_LIGHT: f64 = 0.85;

impl TexturedWorld {
    /// The world that `options` describe.
    pub fn new(options: TexturedWorldOptions) -> Self {
        let mut rng = stream(options.seed, Purpose::Background, options.scenery as u64);
        let solids = solids(options.scenery, &mut rng);
        let mut rng = stream(options.seed, Purpose::Waypoint, options.path as u64);
        let place = Standpoint::of(options.scenery);
        let cameras_from_world =
            (0..options.images).map(|k| place.camera(options.path, k, options.images, &mut rng));
        let cameras_from_world = cameras_from_world.collect();
        let (size, lens) = (options.sensor.size, &options.sensor.lens);
        let corners = (0..=size.height).flat_map(|row| (0..=size.width).map(move |at| (at, row)));
        let ray = |(column, row): (u32, u32)| {
            let pixel = Pixel::new(f64::from(column) - 0.5, f64::from(row) - 0.5);
            let bearing = lens.bearing_from_pixel(pixel).map(nalgebra::Unit::into_inner);
            bearing.map_or(Vector3::repeat(f64::NAN), |bearing| bearing / bearing.z)
        };
        let rays = corners.map(ray).collect();
        Self { solids, cameras_from_world, rays, options }
    }

    /// The true pose of the camera in the `index`-th image.
    pub fn camera_from_world(&self, index: usize) -> Pose {
        self.cameras_from_world[index]
    }

    /// The `index`-th image.
    pub fn image(&self, index: usize) -> GrayImage {
        let sensor = &self.options.sensor;
        let (width, height) = (sensor.size.width as usize, sensor.size.height as usize);
        let world_from_camera = self.cameras_from_world[index].inverse();
        let origin = Point3::from(world_from_camera.translation());
        let rotation = world_from_camera.rotation_matrix();
        let solids = self.solids(index);
        let mut light = vec![0.0_f32; width * height];
        for (k, light) in light.iter_mut().enumerate() {
            let corner = (k / width) * (width + 1) + k % width;
            let [upper, lower] = [&self.rays[corner..], &self.rays[corner + width + 1..]];
            let footprint = 0.5 * ((upper[1] - upper[0]).norm() + (lower[0] - upper[0]).norm());
            let mut sum = 0.0;
            for [s, t] in [[0.25, 0.25], [0.75, 0.75]] {
                let ray = upper[0].lerp(&upper[1], s).lerp(&lower[0].lerp(&lower[1], s), t);
                let face = nearest_face(&solids, &origin, &(rotation * ray));
                sum += face.map_or(SKY_LIGHT, |face| face.light(footprint * face.along));
            }
            *light = (0.5 * sum) as f32;
        }
        let light = blurred(&light, width, sensor.blur_px);
        sensor.develop(&light, self.options.seed, index as u64)
    }

    /// The seed of everything random.
    pub(super) fn seed(&self) -> u64 {
        self.options.seed
    }

    /// All solids in the `index`-th image.
    pub(super) fn solids(&self, index: usize) -> Vec<TexturedBox> {
        self.solids.iter().copied().chain(self.mover(index)).collect()
    }

    /// The moving box, at its place in the `index`-th image.
    fn mover(&self, index: usize) -> Option<TexturedBox> {
        let mut rng = stream(self.options.seed, Purpose::Mover, index as u64);
        let distance = Standpoint::of(self.options.scenery).distance;
        let mut at = |low: f64, high: f64| rng.random_range(low..high) * distance;
        let center = Point3::new(at(-0.3, 0.3), at(-0.1, 0.2), at(-0.4, -0.2));
        let half = Vector3::repeat(0.06 * distance);
        self.options.has_mover.then_some(TexturedBox { center, half, salt: 999, is_room: false })
    }
}

/// A Gaussian of σ `blur_px` over the image, edges repeated.
fn blurred(light: &[f32], width: usize, blur_px: f64) -> Vec<f32> {
    let reach = (3.0 * blur_px).ceil() as isize;
    let weight = |k: isize| (-0.5 * (k as f64 / blur_px.max(1e-3)).powi(2)).exp() as f32;
    let weights: Vec<f32> = (-reach..=reach).map(weight).collect();
    let total: f32 = weights.iter().sum();
    let height = light.len() / width;
    let along = |light: &[f32], [dx, dy]: [isize; 2]| -> Vec<f32> {
        let at = |x: isize, y: isize| {
            light[y.clamp(0, height as isize - 1) as usize * width
                + x.clamp(0, width as isize - 1) as usize]
        };
        let value = |k: usize| {
            let (x, y) = ((k % width) as isize, (k / width) as isize);
            let taps = (-reach..=reach).zip(&weights);
            taps.map(|(tap, weight)| weight * at(x + dx * tap, y + dy * tap)).sum::<f32>() / total
        };
        (0..light.len()).map(value).collect()
    };
    along(&along(light, [1, 0]), [0, 1])
}

/// Where the camera stands in front of the origin of the world, along z; y points down. Meters.
struct Standpoint {
    /// Distance from the origin.
    distance: f64,
    /// How far it may move to each side.
    reach: f64,
}

impl Standpoint {
    fn of(scenery: Scenery) -> Self {
        let (distance, reach) = match scenery {
            Scenery::Room => (3.2, 1.5),
            Scenery::Facade => (8.0, 3.5),
            Scenery::Plane => (3.0, 1.3),
            Scenery::Corridor => (4.0, 0.8),
            Scenery::Garden => (5.0, 2.2),
        };
        Self { distance, reach }
    }

    /// The pose of the camera in the `number`-th of `count` images.
    fn camera(&self, path: CameraPath, number: usize, count: usize, rng: &mut impl Rng) -> Pose {
        let part = 2.0 * number as f64 / (count.max(2) - 1) as f64 - 1.0;
        let mut jitter = |reach: f64| rng.random_range(-reach..reach);
        let Self { distance, reach } = *self;
        let quarter = if number % 3 == 1 { std::f64::consts::FRAC_PI_2 } else { 0.0 };
        let (center, [pan, tilt, roll]) = match path {
            CameraPath::Orbit => {
                let angle = (reach / distance).asin() * part;
                let y = jitter(0.15 * reach) + 0.25 * reach * f64::from((number % 2) as u8);
                let center = [distance * angle.sin(), y, -distance * angle.cos()];
                (center, [-angle + jitter(0.04), jitter(0.04), quarter + jitter(0.1)])
            }
            CameraPath::Sideways => {
                let center = [reach * part, jitter(0.15 * reach), -distance + jitter(0.02 * reach)];
                (center, [jitter(0.05), jitter(0.05), jitter(0.03)])
            }
            CameraPath::Forward => {
                let z = -distance * (1.1 - 0.2 * (part + 1.0));
                let aside = 0.01 * distance;
                ([jitter(aside), jitter(aside), z], [jitter(0.02), jitter(0.02), jitter(0.02)])
            }
            CameraPath::Rotation => {
                let angle = 0.9 * number as f64;
                let pan_tilt =
                    [0.24 * angle.cos() + jitter(0.03), 0.16 * angle.sin() + jitter(0.03)];
                ([0.0, 0.0, -distance], [pan_tilt[0], pan_tilt[1], quarter + jitter(0.05)])
            }
        };
        camera_at([center[0], center[1], center[2]], [pan, tilt, roll])
    }
}

/// A camera at `center` whose axis is z, rotated about y, then x, then its own axis.
fn camera_at(center: [f64; 3], [pan, tilt, roll]: [f64; 3]) -> Pose {
    let [x, y, z] = [Vector3::x_axis(), Vector3::y_axis(), Vector3::z_axis()];
    let world_from_camera = Rotation3::from_axis_angle(&y, pan)
        * Rotation3::from_axis_angle(&x, tilt)
        * Rotation3::from_axis_angle(&z, roll);
    let rotation = UnitQuaternion::from_rotation_matrix(&world_from_camera.inverse());
    Pose::new(rotation, -(rotation * Vector3::from(center)))
}

fn solids(scenery: Scenery, rng: &mut impl Rng) -> Vec<TexturedBox> {
    let first_salt = rng.random_range(0..1 << 40);
    let mut solids = Vec::new();
    let mut add = |center: [f64; 3], half: [f64; 3], is_room: bool| {
        let salt = first_salt + solids.len() as u64;
        solids.push(TexturedBox { center: center.into(), half: half.into(), salt, is_room });
    };
    let mut between = |low: f64, high: f64| rng.random_range(low..high);
    match scenery {
        Scenery::Room => {
            add([0.0, 0.0, -1.0], [2.4, 1.4, 3.2], true);
            for _ in 0..7 {
                let half = [between(0.15, 0.5), between(0.2, 0.7), between(0.15, 0.4)];
                add([between(-1.8, 1.8), 1.4 - half[1], between(-0.6, 1.7)], half, false);
            }
        }
        Scenery::Facade => {
            add([0.0, 0.0, 1.0], [14.0, 9.0, 1.0], false);
            add([0.0, 3.0, -10.0], [20.0, 0.01, 12.0], false);
            for k in 0..14 {
                let center = [1.7 * f64::from(k % 5) - 3.4, 1.9 * f64::from(k / 5) - 2.6, 0.0];
                let half = [between(0.3, 0.6), between(0.08, 0.5), between(0.1, 0.7)];
                add([center[0] + between(-0.3, 0.3), center[1], -half[2]], half, false);
            }
        }
        Scenery::Plane => add([0.0, 0.0, 0.5], [9.0, 9.0, 0.5], false),
        Scenery::Corridor => {
            add([0.0, 0.0, 2.0], [1.2, 1.25, 8.0], true);
            for k in 0..5 {
                let half = [between(0.1, 0.25), between(0.3, 0.9), between(0.1, 0.3)];
                let side = if k % 2 == 0 { 1.2 - half[0] } else { half[0] - 1.2 };
                add([side, 1.25 - half[1], between(-1.0, 5.0)], half, false);
            }
        }
        Scenery::Garden => {
            add([0.0, 0.0, 9.0], [20.0, 12.0, 0.5], false);
            add([0.0, 1.6, 0.0], [20.0, 0.01, 20.0], false);
            for _ in 0..16 {
                let half = [between(0.1, 0.45), between(0.1, 0.7), between(0.1, 0.45)];
                add([between(-2.6, 2.6), 1.6 - half[1], between(-1.6, 3.0)], half, false);
            }
        }
    }
    solids
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::lens::{Lens, LensModel};
    use crate::geometry::pixel::ImageSize;

    fn world(path: CameraPath) -> TexturedWorld {
        let parameters = [150.0, 150.0, 81.0, 59.0, 0.0, -0.1];
        let lens = Lens::from_parameters(LensModel::Radial, &parameters).unwrap();
        let mut sensor = ImageSensor::new(ImageSize::new(160, 120), lens);
        (sensor.blur_px, sensor.full_well_e, sensor.read_noise_e) = (0.5, 1e9, 0.0);
        let (scenery, images) = (Scenery::Plane, 4);
        let options =
            TexturedWorldOptions { seed: 5, scenery, path, images, sensor, has_mover: false };
        TexturedWorld::new(options)
    }

    /// Points of the wall, projected into two images, have the same light there.
    #[test]
    fn images_agree_with_the_poses_and_the_lens() {
        let world = world(CameraPath::Orbit);
        let sensor = &world.options.sensor;
        let images = [0, 3].map(|index| world.image(index));
        let value = |image: &GrayImage, pixel: Pixel| {
            let (x, y) = (pixel.x.floor(), pixel.y.floor());
            let at = |dx: usize, dy: usize| {
                f64::from(image.view().row(y as usize + dy)[x as usize + dx])
            };
            let (s, t) = (pixel.x - x, pixel.y - y);
            (at(0, 0) * (1.0 - s) + at(1, 0) * s) * (1.0 - t)
                + (at(0, 1) * (1.0 - s) + at(1, 1) * s) * t
        };
        let mut values: Vec<[f64; 2]> = Vec::new();
        for k in 0..2500 {
            let at =
                Point3::new(f64::from(k % 50) * 0.04 - 1.0, f64::from(k / 50) * 0.04 - 1.0, 0.0);
            let pixels = [0, 3].map(|index| {
                let pixel = sensor.lens.pixel_from_point(&(world.camera_from_world(index) * at))?;
                let inner = (1.0..158.0).contains(&pixel.x) && (1.0..118.0).contains(&pixel.y);
                inner.then_some(pixel)
            });
            if let [Some(first), Some(second)] = pixels {
                values.push([value(&images[0], first), value(&images[1], second)]);
            }
        }
        assert!(values.len() > 500, "{}", values.len());
        let n = values.len() as f64;
        let mean = [0, 1].map(|i| values.iter().map(|v| v[i]).sum::<f64>() / n);
        let covariance = |i: usize, j: usize| {
            values.iter().map(|v| (v[i] - mean[i]) * (v[j] - mean[j])).sum::<f64>() / n
        };
        let correlation = covariance(0, 1) / (covariance(0, 0) * covariance(1, 1)).sqrt();
        assert!(correlation > 0.9, "{correlation}");
    }

    #[test]
    fn a_camera_that_only_rotates_stays_where_it_is() {
        let world = world(CameraPath::Rotation);
        let center = |index: usize| world.camera_from_world(index).inverse().translation();
        for index in 1..4 {
            assert!((center(index) - center(0)).norm() < 1e-12);
        }
    }
}
