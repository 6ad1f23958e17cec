//! A depth camera beside the camera that moves through a textured world.

use nalgebra::Point3;

use crate::geometry::pose::Pose;
use crate::imaging::depth_image::DepthImage;
use crate::simulation::depth_sensor::{DepthRenderer, SimulatedDepthSensor, TrueDepth};
use crate::simulation::textured_solids::nearest_face;
use crate::simulation::textured_world::TexturedWorld;

/// A depth camera that is fixed to the color camera.
#[derive(Debug, Clone)]
pub struct TexturedDepth {
    renderer: DepthRenderer,
    color_from_depth: Pose,
}

impl TexturedDepth {
    /// A depth camera at `color_from_depth`.
    pub fn new(sensor: SimulatedDepthSensor, color_from_depth: Pose) -> Self {
        Self { renderer: DepthRenderer::new(sensor), color_from_depth }
    }

    /// The depth image of `world` at the time of the `index`-th image.
    pub fn image(&self, world: &TexturedWorld, index: usize) -> DepthImage {
        let world_from_depth = world.camera_from_world(index).inverse() * self.color_from_depth;
        let origin = Point3::from(world_from_depth.translation());
        let rotation = world_from_depth.rotation_matrix();
        let solids = world.solids(index);
        let seen = self.renderer.rays().map(|ray| {
            // The ray has z = 1, so the factor at which it reaches the face is the depth.
            let face = ray.and_then(|ray| nearest_face(&solids, &origin, &(rotation * ray)));
            face.map_or((0.0, 0), |face| (1.0 / face.along, face.solid()))
        });
        let (inverse, thing) = seen.unzip();
        self.renderer.measured(&TrueDepth { inverse, thing }, world.seed(), index as u64)
    }
}

#[cfg(test)]
mod tests {
    use nalgebra::{UnitQuaternion, Vector3};

    use super::*;
    use crate::geometry::camera_matrix::CameraMatrix;
    use crate::geometry::lens::Lens;
    use crate::geometry::pixel::{ImageSize, Pixel};
    use crate::simulation::depth_sensor::DepthError;
    use crate::simulation::image_sensor::ImageSensor;
    use crate::simulation::textured_world::{CameraPath, Scenery, TexturedWorldOptions};

    /// Readings of the one flat wall, at z = 0, are where the poses have it.
    #[test]
    fn depth_agrees_with_the_poses() {
        let size = ImageSize::new(160, 120);
        let matrix = CameraMatrix { fx: 150.0, fy: 150.0, cx: 80.0, cy: 60.0, skew: 0.0 };
        let lens = Lens::pinhole(matrix);
        let options = TexturedWorldOptions {
            seed: 5,
            scenery: Scenery::Plane,
            path: CameraPath::Orbit,
            images: 4,
            sensor: ImageSensor::new(size, lens),
            has_mover: false,
        };
        let world = TexturedWorld::new(options);
        let sensor = SimulatedDepthSensor {
            size,
            lens,
            unit_m: 0.0001,
            error: DepthError::default(),
            noise_per_m: 0.0,
            step_per_m: 0.0,
            disparity_px_m: 7.0,
            holes: 0,
            dropout: 0.0,
        };
        let rotation = UnitQuaternion::from_euler_angles(0.01, -0.02, 0.03);
        let color_from_depth = Pose::new(rotation, Vector3::new(0.1, 0.0, 0.02));
        let depth = TexturedDepth::new(sensor, color_from_depth);
        for index in 0..4 {
            let image = depth.image(&world, index);
            let world_from_depth = world.camera_from_world(index).inverse() * color_from_depth;
            for pixel in [Pixel::new(80.0, 60.0), Pixel::new(120.0, 20.0), Pixel::new(40.0, 90.0)] {
                let reading = f64::from(image.row(pixel.y as usize)[pixel.x as usize]) * 0.0001;
                let ray = matrix.normalized_from_pixel(pixel);
                let at = world_from_depth * (Point3::new(ray.x, ray.y, 1.0) * reading);
                assert!(reading > 1.0 && at.z.abs() < 2e-4, "{index}: {reading} {at}");
            }
        }
    }
}
