//! A simulated person with a board in front of a camera: one who follows requests, one who waves
//! the board about, one who fills the bars of ROS's calibrator. Reactions take time, hands have a
//! limited speed and tremble, and one request in ten is misunderstood.

use std::f64::consts::TAU;

use nalgebra::{Point3, UnitQuaternion, Vector3};
use rand::RngExt;
use rand_chacha::ChaCha8Rng;
use rand_distr::StandardNormal;

use crate::geometry::board::Chessboard;
use crate::geometry::lens::Lens;
use crate::geometry::pixel::{ImageSize, Pixel};
use crate::geometry::pose::Pose;
use crate::simulation::noise::{Purpose, stream};
use crate::simulation::tremor::tremor;

/// What the person does.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum OperatorKind {
    /// Holds the board where it is requested.
    Follows,
    /// Moves it at random.
    Wanders,
    /// Fills the bars of ROS's `cameracalibrator`: from side to side, up and down, near and far,
    /// then tilted; and again.
    Bars,
}

impl OperatorKind {
    /// Every kind.
    pub const ALL: [Self; 3] = [Self::Follows, Self::Wanders, Self::Bars];

    /// Its name in configurations and on the command line.
    pub fn name(self) -> &'static str {
        match self {
            Self::Follows => "follows",
            Self::Wanders => "wanders",
            Self::Bars => "bars",
        }
    }

    /// The kind with this name.
    pub fn from_name(name: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|kind| kind.name() == name)
    }
}

/// A person's abilities. The figures are those of unhurried adults: choice reactions take 0.5 to 1
/// s when an image has to be understood first, and hands at rest drift by a few tenths of a
/// millimeter, here at 1.1 to 2.9 Hz. Tremor proper, at 8 to 12 Hz, is not simulated.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Skill {
    /// Time from a request to the beginning of the movement, in seconds; and its standard
    /// deviation.
    pub reaction_s: [f64; 2],
    /// The speed of the board, in its own distances per second.
    pub speed_per_s: f64,
    /// The angular speed of the board, in radians per second.
    pub rotation_rad_per_s: f64,
    /// The error of a movement's end: relative to the distance, and in radians.
    pub aim: [f64; 2],
    /// The amplitude of the hands' drift, in meters and in radians.
    pub tremor: [f64; 2],
    /// The part of the requests that are misunderstood.
    pub misunderstood: f64,
    /// How long the board is held at a place before the person tries something else, in seconds.
    pub patience_s: f64,
}

impl Default for Skill {
    fn default() -> Self {
        Self {
            reaction_s: [0.7, 0.2],
            speed_per_s: 0.5,
            rotation_rad_per_s: 1.0,
            aim: [0.03, 0.06],
            tremor: [2e-4, 0.03_f64.to_radians()],
            misunderstood: 0.1,
            patience_s: 1.5,
        }
    }
}

/// A person with a board, in the camera's frame.
#[derive(Debug, Clone)]
pub struct Operator {
    kind: OperatorKind,
    skill: Skill,
    rng: ChaCha8Rng,
    /// The board's middle in its own frame.
    middle: Vector3<f64>,
    /// The distance at which the board fills about half of the image, in meters; and the tangents
    /// of half the field of view.
    distance_m: f64,
    half_view: [f64; 2],
    time_s: f64,
    at: Middle,
    aim: Middle,
    /// When the present aim was reached.
    arrived_s: Option<f64>,
    /// The next aim, and when the movement to it begins.
    next: Option<(f64, Middle)>,
    asked_from_board: Option<Pose>,
    places: u32,
}

/// Where the middle of the board is, and how it is rotated.
#[derive(Debug, Clone, Copy)]
struct Middle {
    rotation: UnitQuaternion<f64>,
    place: Vector3<f64>,
}

/// The largest tilt at which the person holds a board without a request, in radians. Chosen, not
/// swept.
const OWN_TILT_RAD: f64 = 0.6;

impl Operator {
    /// The person of `seed` with `board`, in front of a camera whose image spans `half_view` (the
    /// tangents of its half angles, horizontal and vertical; at most 1.2).
    pub fn new(seed: u64, kind: OperatorKind, board: &Chessboard, half_view: [f64; 2]) -> Self {
        let extent = [board.size.cols, board.size.rows]
            .map(|count| (f64::from(count) - 1.0) * board.square_m);
        let half_view = half_view.map(|tangent| tangent.clamp(0.05, 1.2));
        let distance_m = (0..2).map(|k| extent[k] / half_view[k]).fold(0.0, f64::max);
        let here = Middle {
            rotation: UnitQuaternion::identity(),
            place: Vector3::new(0.0, 0.0, distance_m),
        };
        Self {
            kind,
            skill: Skill::default(),
            rng: stream(seed, Purpose::Operator, kind as u64),
            middle: Vector3::new(extent[0], extent[1], 0.0) / 2.0,
            distance_m,
            half_view,
            time_s: 0.0,
            at: here,
            aim: here,
            arrived_s: Some(0.0),
            next: None,
            asked_from_board: None,
            places: 0,
        }
    }

    /// Like [`Self::new`], in front of a camera with this lens and images of `size`.
    pub fn before(
        seed: u64,
        kind: OperatorKind,
        board: &Chessboard,
        lens: &Lens,
        size: ImageSize,
    ) -> Self {
        let center = size.center();
        let tangent = |x: f64, y: f64, axis: usize| {
            let bearing = lens.bearing_from_pixel(Pixel::new(x, y)).filter(|b| b.z > 0.1);
            bearing.map_or(f64::INFINITY, |b| b[axis].abs() / b.z)
        };
        let half_view = [tangent(0.0, center.y, 0), tangent(center.x, 0.0, 1)];
        Self::new(seed, kind, board, half_view)
    }

    /// Shows the person the requested pose of the board.
    pub fn ask(&mut self, camera_from_board: Option<&Pose>) {
        if self.kind != OperatorKind::Follows || camera_from_board.copied() == self.asked_from_board
        {
            return;
        }
        self.asked_from_board = camera_from_board.copied();
        let misunderstood = self.rng.random_bool(self.skill.misunderstood);
        self.plan(misunderstood);
    }

    /// Advances by `seconds`. Returns the pose of the board then.
    pub fn step(&mut self, seconds: f64) -> Pose {
        self.time_s += seconds;
        match self.next {
            Some((begins_s, aim)) if self.time_s >= begins_s => {
                (self.aim, self.arrived_s, self.next) = (aim, None, None);
            }
            _ => {}
        }
        self.carry(seconds);
        if let Some(arrived_s) = self.arrived_s
            && self.next.is_none()
            && self.time_s - arrived_s > self.held_s()
        {
            self.plan(false);
        }
        self.trembling()
    }

    fn held_s(&self) -> f64 {
        match self.kind {
            OperatorKind::Follows => self.skill.patience_s,
            OperatorKind::Wanders => 0.2,
            OperatorKind::Bars => 0.5,
        }
    }

    /// Decides where to go next.
    fn plan(&mut self, misunderstood: bool) {
        let aim = match self.kind {
            OperatorKind::Follows => match self.asked_from_board {
                Some(asked) => self.understood(&asked, misunderstood),
                None => self.anywhere(),
            },
            OperatorKind::Wanders => self.anywhere(),
            OperatorKind::Bars => self.next_bar(),
        };
        let [mean_s, std_s] = self.skill.reaction_s;
        let reaction_s = match self.kind {
            OperatorKind::Follows => (mean_s + std_s * self.normal()).max(0.2),
            _ => 0.0,
        };
        self.places += 1;
        self.next = Some((self.time_s + reaction_s, self.aimed(aim)));
    }

    /// How a request is understood: correctly, or with the tilt or the place mirrored.
    fn understood(&mut self, asked_from_board: &Pose, misunderstood: bool) -> Middle {
        let place = (*asked_from_board * Point3::from(self.middle)).coords;
        let rotation = asked_from_board.rotation();
        if !misunderstood {
            return Middle { rotation, place };
        }
        if self.rng.random_bool(0.5) {
            return Middle { rotation, place: Vector3::new(-place.x, place.y, place.z) };
        }
        // The opposite tilt, with the same rotation in the image.
        let normal = rotation * Vector3::z();
        let upright = UnitQuaternion::rotation_between(&normal, &Vector3::z())
            .unwrap_or_else(UnitQuaternion::identity);
        Middle { rotation: upright * upright * rotation, place }
    }

    fn anywhere(&mut self) -> Middle {
        let mut uniform = |low: f64, high: f64| self.rng.random_range(low..high);
        let distance = self.distance_m * uniform(0.9, 2.2);
        let (across, down) = (uniform(-0.8, 0.8), uniform(-0.8, 0.8));
        let (tilt, azimuth, roll) =
            (uniform(0.0, OWN_TILT_RAD), uniform(0.0, TAU), uniform(-0.35, 0.35));
        self.middle_at([across, down], distance, [tilt * azimuth.cos(), tilt * azimuth.sin(), roll])
    }

    /// The bars X, Y, size and skew in sequence, each from end to end.
    fn next_bar(&mut self) -> Middle {
        let step = self.places % 16;
        let end = [-0.75, -0.25, 0.25, 0.75][(step % 4) as usize];
        let (at, distance, rotation) = match step / 4 {
            0 => ([end, 0.0], 1.5, [0.0; 3]),
            1 => ([0.0, end], 1.5, [0.0; 3]),
            2 => ([0.0, 0.0], 1.6 + 0.8 * end, [0.0; 3]),
            _ => {
                let tilts = [[0.55, 0.0], [-0.55, 0.0], [0.0, 0.55], [0.0, -0.55]];
                let [x, y] = tilts[(step % 4) as usize];
                ([0.0, 0.0], 1.3, [x, y, 0.0])
            }
        };
        self.middle_at(at, self.distance_m * distance, rotation)
    }

    /// `at` is the position of the board's middle, relative to the farthest position from the
    /// middle of the image at which the board does not leave it.
    fn middle_at(&self, at: [f64; 2], distance: f64, rotation: [f64; 3]) -> Middle {
        let room = [0, 1].map(|k| {
            let half_board = self.middle[k] / distance;
            (self.half_view[k] - half_board).max(0.0) * at[k]
        });
        let place = Vector3::new(room[0], room[1], 1.0) * distance;
        let facing = UnitQuaternion::rotation_between(&Vector3::z(), &place)
            .unwrap_or_else(UnitQuaternion::identity);
        let rotation = facing
            * UnitQuaternion::from_scaled_axis(Vector3::new(rotation[0], rotation[1], 0.0))
            * UnitQuaternion::from_scaled_axis(Vector3::z() * rotation[2]);
        Middle { rotation, place }
    }

    /// A movement ends near its aim.
    fn aimed(&mut self, aim: Middle) -> Middle {
        let [place, rotation] = self.skill.aim;
        let off = Vector3::from_fn(|_, _| self.normal()) * (place * aim.place.norm());
        let rotated = Vector3::from_fn(|_, _| self.normal()) * rotation;
        Middle {
            rotation: UnitQuaternion::from_scaled_axis(rotated) * aim.rotation,
            place: aim.place + off,
        }
    }

    fn carry(&mut self, seconds: f64) {
        let (rest, angle) =
            (self.aim.place - self.at.place, self.at.rotation.angle_to(&self.aim.rotation));
        let needed_s = (rest.norm() / (self.skill.speed_per_s * self.at.place.norm()))
            .max(angle / self.skill.rotation_rad_per_s);
        if needed_s <= seconds {
            self.at = self.aim;
            self.arrived_s.get_or_insert(self.time_s);
            return;
        }
        let part = seconds / needed_s;
        self.at.place += rest * part;
        self.at.rotation =
            self.at.rotation.try_slerp(&self.aim.rotation, part, 1e-9).unwrap_or(self.aim.rotation);
    }

    fn trembling(&self) -> Pose {
        let (shake, wobble) = tremor(self.time_s, self.skill.tremor);
        let rotation = wobble * self.at.rotation;
        Pose::new(rotation, self.at.place + shake - rotation * self.middle)
    }

    fn normal(&mut self) -> f64 {
        self.rng.sample(StandardNormal)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::board::BoardSize;

    fn operator(seed: u64, kind: OperatorKind) -> Operator {
        let board = Chessboard::new(BoardSize::new(9, 6).unwrap(), 0.025).unwrap();
        Operator::new(seed, kind, &board, [0.57, 0.43])
    }

    fn middle(operator: &Operator, camera_from_board: &Pose) -> Vector3<f64> {
        (*camera_from_board * Point3::from(operator.middle)).coords
    }

    #[test]
    fn who_follows_arrives_after_a_reaction_and_at_a_limited_speed() {
        let mut arrived = 0;
        for seed in 0..40 {
            let mut operator = operator(seed, OperatorKind::Follows);
            let start = operator.step(0.1);
            let rotation = UnitQuaternion::from_scaled_axis(Vector3::new(0.3, -0.4, 0.1));
            let place = Vector3::new(0.1, -0.05, 0.5);
            let asked = Pose::new(rotation, place - rotation * operator.middle);
            operator.ask(Some(&asked));
            let soon = operator.step(0.1);
            assert!((middle(&operator, &soon) - middle(&operator, &start)).norm() < 2e-3);
            let mut before = middle(&operator, &soon);
            let mut now = soon;
            for _ in 0..30 {
                now = operator.step(0.1);
                let here = middle(&operator, &now);
                assert!((here - before).norm() <= 0.1 * 0.5 * before.norm() * 1.02 + 2e-3);
                before = here;
            }
            let close = (before - place).norm() < 0.1 && now.rotation().angle_to(&rotation) < 0.35;
            arrived += u32::from(close);
        }
        // One in ten misunderstands.
        assert!((30..40).contains(&arrived), "{arrived} of 40");
    }

    #[test]
    fn the_same_seed_moves_the_same_and_another_one_does_not() {
        for kind in OperatorKind::ALL {
            let walk = |seed: u64| {
                let mut operator = operator(seed, kind);
                (0..200).map(|_| operator.step(0.1)).collect::<Vec<_>>()
            };
            assert_eq!(walk(3), walk(3));
            assert_ne!(walk(3), walk(4));
        }
    }

    #[test]
    fn bars_reach_every_side_and_tilt() {
        let mut operator = operator(1, OperatorKind::Bars);
        let camera_from_board: Vec<Pose> = (0..900).map(|_| operator.step(0.1)).collect();
        let slope = |axis: usize| {
            let along = camera_from_board.iter().map(|pose| {
                let place = middle(&operator, pose);
                place[axis] / place.z
            });
            along.fold([f64::MAX, f64::MIN], |[least, most], v| [least.min(v), most.max(v)])
        };
        for [least, most] in [slope(0), slope(1)] {
            assert!(least < -0.05 && most > 0.05, "{least} {most}");
        }
        let tilted = camera_from_board.iter().filter(|pose| (**pose * Vector3::z()).z < 0.92);
        assert!(tilted.count() > 10);
    }
}
