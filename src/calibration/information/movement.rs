//! How to move the board from its pose to another one, in words: one movement at a time, the
//! greatest first. Left, right, up, down and rotations are as seen in the image.

use nalgebra::{UnitQuaternion, Vector2, Vector3};

use crate::calibration::information::candidate_views::CandidateSpace;
use crate::geometry::pixel::Pixel;
use crate::geometry::pose::Pose;

/// How a board is held in front of a camera.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PlacementInCamera {
    /// The pixel of its middle.
    pub middle: Pixel,
    /// The distance of its middle, in meters.
    pub distance_m: f64,
    /// The angles of its normal to the line of sight, in radians: x > 0 when its right side is
    /// nearer, y > 0 when its lower side is.
    pub tilt: Vector2<f64>,
    /// The direction of its rows in the image, in radians from the image's x.
    pub roll: f64,
}

/// Differences that count as one step each: a fraction of the image's diagonal, the logarithm of a
/// distance, angles in radians. A view one step off adds nearly as much information as the
/// suggested one.
const MIDDLE_STEP: f64 = 0.10;
const DISTANCE_STEP: f64 = 0.20;
const TILT_STEP: f64 = 0.20;
const ROLL_STEP: f64 = 0.35;
/// The board is in place when it is within this many steps in each respect.
const ARRIVED: f64 = 1.0;

impl PlacementInCamera {
    /// How a board at `camera_from_board` is held; `None` where its middle is not visible.
    pub fn of(space: &CandidateSpace<'_>, camera_from_board: &Pose) -> Option<Self> {
        let middle_in_camera = *camera_from_board * space.board.middle();
        let line_of_sight = middle_in_camera.coords.try_normalize(1e-12)?;
        let camera_from_facing = UnitQuaternion::rotation_between(&Vector3::z(), &line_of_sight)?;
        let facing_from_board = camera_from_facing.inverse() * camera_from_board.rotation();
        let (row, normal) = (facing_from_board * Vector3::x(), facing_from_board * Vector3::z());
        // If z points at the camera, as in Kalibr's frames, the normal is reversed.
        let away = normal * normal.z.signum();
        Some(Self {
            middle: space.lens.pixel_from_point(&middle_in_camera)?,
            distance_m: middle_in_camera.coords.norm(),
            tilt: Vector2::new((away.x / away.z).atan(), (away.y / away.z).atan()),
            roll: row.y.atan2(row.x),
        })
    }
}

/// The next movement from one pose to another, as a sentence without its end; `None` if the board
/// is nearly there.
pub fn next_movement(
    space: &CandidateSpace<'_>,
    here_from_board: &Pose,
    there_from_board: &Pose,
) -> Option<String> {
    let (here, there) = (
        PlacementInCamera::of(space, here_from_board)?,
        PlacementInCamera::of(space, there_from_board)?,
    );
    let displacement =
        (there.middle.to_vector() - here.middle.to_vector()) / space.size.diagonal_px();
    let nearer = (here.distance_m / there.distance_m).ln();
    let tilt = there.tilt - here.tilt;
    let roll = wrapped(there.roll - here.roll);
    let movements = [
        (displacement.norm() / MIDDLE_STEP, format!("move it {}", direction(displacement))),
        (
            nearer.abs() / DISTANCE_STEP,
            if nearer > 0.0 { "bring it nearer to the camera" } else { "move it farther away" }
                .to_owned(),
        ),
        (tilt.norm() / TILT_STEP, format!("tilt its {} towards the camera", side(tilt))),
        (
            roll.abs() / ROLL_STEP,
            if roll > 0.0 { "turn it clockwise" } else { "turn it counterclockwise" }.to_owned(),
        ),
    ];
    let greatest = movements.into_iter().max_by(|a, b| a.0.total_cmp(&b.0))?;
    (greatest.0 > ARRIVED).then_some(greatest.1)
}

/// Where a board should be held, as a sentence without its end, for an operator whose board is not
/// in view.
pub fn description(space: &CandidateSpace<'_>, there_from_board: &Pose) -> Option<String> {
    let there = PlacementInCamera::of(space, there_from_board)?;
    let part = [
        there.middle.x / f64::from(space.size.width),
        there.middle.y / f64::from(space.size.height),
    ];
    let third = |part: f64| usize::from(part > 0.4) + usize::from(part > 0.6);
    let place =
        match (["upper", "", "lower"][third(part[1])], ["left", "", "right"][third(part[0])]) {
            ("", "") => "in the middle of the image".to_owned(),
            ("", edge) | (edge, "") => format!("in the {edge} part of the image"),
            (vertical, horizontal) => format!("in the {vertical} {horizontal} of the image"),
        };
    let tilt = if there.tilt.norm() > TILT_STEP {
        format!("its {} towards the camera", side(there.tilt))
    } else {
        "facing the camera".to_owned()
    };
    Some(format!("hold the board {place}, {tilt}"))
}

/// The side of the board that this tilt brings nearer.
pub fn side(tilt: Vector2<f64>) -> &'static str {
    match (tilt.x.abs() > tilt.y.abs(), tilt.x > 0.0, tilt.y > 0.0) {
        (true, true, _) => "right side",
        (true, false, _) => "left side",
        (false, _, true) => "bottom",
        (false, _, false) => "top",
    }
}

fn direction(displacement: Vector2<f64>) -> String {
    // Eight directions: the smaller component is named if it exceeds tan 22.5° times the larger.
    const LESSER: f64 = 0.414;
    let across = if displacement.x > 0.0 { "to the right" } else { "to the left" };
    let down = if displacement.y > 0.0 { "down" } else { "up" };
    match (
        displacement.x.abs() > LESSER * displacement.y.abs(),
        displacement.y.abs() > LESSER * displacement.x.abs(),
    ) {
        (true, true) => format!("{down} and {across}"),
        (true, false) => across.to_owned(),
        _ => down.to_owned(),
    }
}

fn wrapped(angle: f64) -> f64 {
    let positive = angle.rem_euclid(std::f64::consts::TAU);
    if positive > std::f64::consts::PI { positive - std::f64::consts::TAU } else { positive }
}
