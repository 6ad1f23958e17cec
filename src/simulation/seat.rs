//! The pose of a camera in a simulated rig.

use nalgebra::Vector3;
use rand::RngExt;

use crate::geometry::lens::Lens;
use crate::geometry::pose::Pose;
use crate::simulation::noise::{Purpose, stream};

/// A camera of a simulated rig beside the first one, in front of which the board is moved.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Seat {
    /// The camera's number in the rig; the first is 0. Each has noise of its own.
    pub number: u32,
    /// Its pose.
    pub camera_from_first: Pose,
    /// The first camera's lens, for which the board's walk is planned.
    pub first_lens: Lens,
}

/// The distance from one camera to the next, in meters, and how much further each is rotated
/// inward, in radians.
const STEP_M: f64 = 0.12;
const TOE_IN: f64 = 0.1;

impl Seat {
    /// The `number`-th camera of the rig of `seed`: 12 cm to the right of the one before and
    /// rotated inward by 6°, both approximately.
    pub fn on_rig(seed: u64, number: u32, first_lens: Lens) -> Self {
        let mut rng = stream(seed, Purpose::Seat, u64::from(number));
        let mut about = |spread: f64| Vector3::from_fn(|_, _| rng.random_range(-spread..spread));
        let across = f64::from(number);
        let rotation = Vector3::new(0.0, -TOE_IN * across, 0.0) + about(0.03);
        let place = Vector3::new(STEP_M * across, 0.0, 0.0) + about(0.01);
        Self {
            number,
            camera_from_first: Pose::from_axis_angle(rotation, place).inverse(),
            first_lens,
        }
    }
}
