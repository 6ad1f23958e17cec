//! A textured room with exact truth, rendered: what cameras see that calibrate without a board.

use image::{GrayImage, Luma};
use nalgebra::Vector3;
use plumb::geometry::pose::Pose;
use plumb::simulation::smooth_noise;

/// A camera without distortion.
pub struct RoomCamera {
    /// Width and height, in pixels.
    pub size: [u32; 2],
    /// The focal length.
    pub focal_px: f64,
    /// The principal point.
    pub center_px: [f64; 2],
}

/// Smooth noise of several sizes.
fn texture(u: f64, v: f64, salt: u64) -> f64 {
    [(2.3, 0.35), (5.1, 0.4), (11.7, 0.35), (23.0, 0.3)]
        .iter()
        .enumerate()
        .map(|(k, (frequency, amplitude))| {
            amplitude * smooth_noise(u * frequency, v * frequency, salt + 16 * k as u64)
        })
        .sum::<f64>()
        / 1.4
}

/// The inside of a box from -1.6 to 1.6, -1.2 to 1.2 and -3 to 3, seen from `center` along `ray`.
fn room(center: Vector3<f64>, ray: Vector3<f64>) -> f64 {
    let reach = [1.6, 1.2, 3.0];
    let hit = |k: usize| (reach[k] * ray[k].signum() - center[k]) / ray[k];
    let wall = (0..3).min_by(|a, b| hit(*a).total_cmp(&hit(*b))).unwrap();
    let at = center + ray * hit(wall);
    let [u, v] = [[1, 2], [0, 2], [0, 1]][wall].map(|k| at[k]);
    texture(u, v, wall as u64 * 2 + u64::from(ray[wall] > 0.0))
}

/// What a camera sees of the room.
pub fn rendered(camera_from_room: &Pose, camera: &RoomCamera) -> GrayImage {
    let RoomCamera { size: [width, height], focal_px, center_px } = *camera;
    let room_from_camera = camera_from_room.inverse();
    let center = room_from_camera.translation();
    GrayImage::from_fn(width, height, |column, row| {
        let sample = |k: u32| {
            let [dx, dy] = [f64::from(k % 2) * 0.5 - 0.25, f64::from(k / 2) * 0.5 - 0.25];
            let x = (f64::from(column) + dx - center_px[0]) / focal_px;
            let y = (f64::from(row) + dy - center_px[1]) / focal_px;
            room(center, room_from_camera.rotation() * Vector3::new(x, y, 1.0))
        };
        Luma([(255.0 * (0..4).map(sample).sum::<f64>() / 4.0) as u8])
    })
}

/// A camera at `center` rotated by `angles` (about x and y), then about its own axis by `roll`.
pub fn camera(center: [f64; 3], angles: [f64; 2], roll: f64) -> Pose {
    let pan = Pose::from_axis_angle(Vector3::new(angles[0], angles[1], 0.0), Vector3::zeros());
    let about_axis = Pose::from_axis_angle(Vector3::new(0.0, 0.0, roll), Vector3::zeros());
    let rotation = (about_axis * pan).rotation();
    Pose::new(rotation, -(rotation * Vector3::from(center)))
}
