//! Views that a detector could see: a board anywhere in the image, near and far, tilted and rolled,
//! all of it inside the frame (or, with markers, cut off at its rim), its squares large enough and
//! sharp enough.

use std::f64::consts::{FRAC_PI_2, PI, TAU};

use nalgebra::{Point3, UnitQuaternion, Vector3};

use crate::calibration::information::corner_noise::{CornerNoise, side_px};
use crate::calibration::information::view_information::WeightedCorner;
use crate::estimation::problem::CameraProblem;
use crate::geometry::board::Chessboard;
use crate::geometry::lens::Lens;
use crate::geometry::pixel::{ImageSize, Pixel};
use crate::geometry::pose::Pose;
use crate::geometry::target::Target;

/// The points of a flat board.
#[derive(Debug, Clone, PartialEq)]
pub struct BoardPoints {
    /// In the board frame, in meters.
    pub points: Vec<Point3<f64>>,
    /// The side of a square, or the least distance of two points, in meters.
    pub side_m: f64,
    /// Whether a part of the board shows which part it is, as that of one with markers does.
    pub has_markers: bool,
}

impl BoardPoints {
    /// The inner corners of a chessboard.
    pub fn of_chessboard(board: &Chessboard) -> Self {
        Self { points: board.corners_in_board(), side_m: board.square_m, has_markers: false }
    }

    /// The corners of a target.
    pub fn of_target(target: &Target) -> Self {
        let size = target.lattice();
        let corner = |k: u32| target.corner_at((k % size.cols) as i32, (k / size.cols) as i32);
        Self {
            points: (0..size.cols * size.rows).filter_map(corner).collect(),
            side_m: target.spanned_chessboard().square_m,
            has_markers: !matches!(target, Target::Chessboard(_)),
        }
    }

    /// All points that a problem's views have; `None` if there are fewer than four.
    pub fn of_problem(problem: &CameraProblem) -> Option<Self> {
        let mut points: Vec<Point3<f64>> = Vec::new();
        for correspondence in problem.views.iter().flat_map(|view| &view.correspondences) {
            if !points.contains(&correspondence.point_in_board) {
                points.push(correspondence.point_in_board);
            }
        }
        let first = points.first()?;
        let distances = points.iter().skip(1).map(|point| (point - first).norm());
        let side_m = distances.fold(f64::INFINITY, f64::min);
        let has_markers =
            problem.views.iter().any(|view| view.correspondences.len() < points.len());
        (points.len() >= 4).then_some(Self { points, side_m, has_markers })
    }

    /// The least and the greatest x and y.
    fn extent(&self) -> [[f64; 2]; 2] {
        [0, 1].map(|axis| {
            let along = || self.points.iter().map(|point| point[axis]);
            [along().fold(f64::INFINITY, f64::min), along().fold(f64::NEG_INFINITY, f64::max)]
        })
    }

    /// The middle of its points' extent.
    pub fn middle(&self) -> Point3<f64> {
        let [x, y] = self.extent();
        Point3::new(0.5 * (x[0] + x[1]), 0.5 * (y[0] + y[1]), 0.0)
    }

    /// The corners of its extent, widened by `margin` squares: least x and y first, then along x.
    pub fn outline(&self, margin: f64) -> [Point3<f64>; 4] {
        let [x, y] = self.extent().map(|[least, greatest]| {
            [least - margin * self.side_m, greatest + margin * self.side_m]
        });
        [[0, 0], [1, 0], [1, 1], [0, 1]].map(|[i, j]| Point3::new(x[i], y[j], 0.0))
    }

    /// The geometric mean of its extents, in meters.
    fn mean_extent_m(&self) -> f64 {
        let [x, y] = self.extent();
        ((x[1] - x[0]) * (y[1] - y[0])).max(f64::MIN_POSITIVE).sqrt()
    }
}

/// How a board is held, free of any camera.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Holding {
    /// Where in the room that the image leaves it, across and down, 0 to 1.
    pub at: [f64; 2],
    /// The root of the part of the image that its corners would span facing the camera, 0 to 1.
    pub share: f64,
    /// The angle between its normal and the line of sight, in radians.
    pub tilt: f64,
    /// About which axis it is tilted, in radians from the image's x.
    pub azimuth: f64,
    /// Its roll in the image, in radians.
    pub roll: f64,
}

/// The shares of the image, tilts and rolls that are asked for. Small boards reach far into the
/// corners of a fisheye's image; how small is limited by the squares.
const SHARE: [f64; 2] = [0.12, 0.85];
/// Rendered boards are found up to 50°; beyond, detectors begin to miss them.
const GREATEST_TILT: f64 = 0.85;
const GREATEST_ROLL: f64 = 0.6;
/// A board that is asked for in a corner keeps this part of the room from it.
const IN_CORNER: f64 = 0.06;
/// How far off hands end a movement, relative to the distance: its standard deviation.
const AIM: f64 = 0.03;
/// Squares smaller than this are not asked for: detectors need 6 px.
const LEAST_SIDE_PX: f64 = 8.0;
/// What is seen of a board's card beyond its outer corners: the squares that make them corners.
const MARGIN_SQUARES: f64 = 1.0;
const BORDER_PX: f64 = 2.0;
/// A board with markers may be cut off at the image's rim by this part of its extent.
const OVERHANG: f64 = 0.35;
/// Blur beyond this part of the image's diagonal is refused by admission; half of it is asked for
/// at most.
const BLUR_PART: f64 = 0.00125;
const LEAST_BLUR_LIMIT_PX: f64 = 1.5;
/// Of more corners every n-th stands for the others.
const MOST_CORNERS: usize = 48;

/// The generators of Roberts' R6 sequence: powers of the root of x⁷ = x + 1, inverted.
const GENERATORS: [f64; 6] =
    [0.898_653_9, 0.807_578_8, 0.725_733_8, 0.652_183_5, 0.586_087_2, 0.526_689_6];

impl Holding {
    /// The `index`-th of a sequence that fills all of them evenly.
    pub fn of_sequence(index: usize) -> Self {
        let part = |axis: usize| (0.5 + GENERATORS[axis] * (index as f64 + 1.0)).fract();
        Self {
            // Denser toward the image's edges, where lenses differ most.
            at: [0, 1].map(|axis| 0.5 - 0.5 * (PI * part(axis)).cos()),
            share: SHARE[0] + (SHARE[1] - SHARE[0]) * part(2),
            tilt: GREATEST_TILT * part(3).sqrt(),
            azimuth: TAU * part(4),
            roll: GREATEST_ROLL * (2.0 * part(5) - 1.0),
        }
    }

    /// The `index`-th of those in a corner of the image, one corner after another.
    pub fn in_corner(index: usize) -> Self {
        let beside = |at: f64| IN_CORNER + (1.0 - 2.0 * IN_CORNER) * at;
        let at = [index & 1, index >> 1 & 1].map(|side| beside(side as f64));
        Self { at, ..Self::of_sequence(index) }
    }

    /// One near it: the `index`-th of a sequence within `step` (0 to 1) of the whole range.
    pub fn near(&self, index: usize, step: f64) -> Self {
        let part = |axis: usize| {
            step * (2.0 * (0.5 + GENERATORS[axis] * (index as f64 + 1.0)).fract() - 1.0)
        };
        Self {
            at: [0, 1].map(|axis| (self.at[axis] + part(axis)).clamp(0.0, 1.0)),
            share: (self.share + (SHARE[1] - SHARE[0]) * part(2)).clamp(SHARE[0], SHARE[1]),
            tilt: (self.tilt + GREATEST_TILT * part(3)).clamp(0.0, GREATEST_TILT),
            azimuth: self.azimuth + PI * part(4),
            roll: (self.roll + GREATEST_ROLL * part(5)).clamp(-GREATEST_ROLL, GREATEST_ROLL),
        }
    }
}

/// A view that nobody took yet.
#[derive(Debug, Clone, PartialEq)]
pub struct CandidateView {
    /// How the board would be held.
    pub holding: Holding,
    /// Where it would be.
    pub camera_from_board: Pose,
    /// How likely all of it is seen when hands hold it about there.
    pub likely: f64,
    /// Its corners with the noise that they would have; every n-th of many, with the weight of all.
    pub corners: Vec<WeightedCorner>,
}

/// What can be asked for: a board before a camera.
#[derive(Debug, Clone, Copy)]
pub struct CandidateSpace<'a> {
    /// The lens, as far as it is known.
    pub lens: &'a Lens,
    /// The size of its images.
    pub size: ImageSize,
    /// The board.
    pub board: &'a BoardPoints,
    /// How exact its corners are.
    pub noise: &'a CornerNoise,
    /// How the board is rotated before a camera that it faces, as [`base_rotation`] has it.
    pub base: UnitQuaternion<f64>,
    /// Where it is not asked for.
    pub avoided: &'a [AvoidedPose],
}

/// A pose about which a board would not be kept.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct AvoidedPose {
    /// Where.
    pub camera_from_board: Pose,
    /// Within this effort.
    pub effort: f64,
}

/// How a board is rotated before the camera, tilt and lesser rotations left out: by a multiple of a
/// quarter turn, and about if its z axis points at the camera, as that of Kalibr's grids does.
pub fn base_rotation(camera_from_board: &Pose) -> UnitQuaternion<f64> {
    let row = *camera_from_board * Vector3::x();
    let quarters = (row.y.atan2(row.x) / FRAC_PI_2).round();
    let rolled = UnitQuaternion::from_scaled_axis(Vector3::z() * (quarters * FRAC_PI_2));
    // By the line of sight: at a fisheye's rim the normal of a board that is seen from the front
    // may point away from the image plane.
    let normal = *camera_from_board * Vector3::z();
    let towards_camera = normal.dot(&camera_from_board.translation()) < 0.0;
    if towards_camera {
        rolled * UnitQuaternion::from_scaled_axis(Vector3::x() * PI)
    } else {
        rolled
    }
}

/// A hand carries a board by half its distance, or rotates it by a radian, in the same time.
const EFFORT_PER_DISTANCE: f64 = 2.0;

/// How far it is from one pose to another for a board with this middle, in rotations by a radian.
pub fn effort(here_from_board: &Pose, there_from_board: &Pose, middle: Point3<f64>) -> f64 {
    let poses = [here_from_board, there_from_board];
    let [here, there] = poses.map(|pose| (*pose * middle).coords);
    let translation = (there - here).norm() / here.norm().max(f64::MIN_POSITIVE);
    EFFORT_PER_DISTANCE * translation
        + here_from_board.rotation().angle_to(&there_from_board.rotation())
}

impl CandidateSpace<'_> {
    /// The view of a board held so; `None` where the detector would not see all of it, and in
    /// avoided poses.
    pub fn view(&self, holding: &Holding) -> Option<CandidateView> {
        let camera_from_board = self.camera_from_board(holding)?;
        let is_avoided = |avoided: &AvoidedPose| {
            effort(&avoided.camera_from_board, &camera_from_board, self.board.middle())
                < avoided.effort
        };
        let may_be_asked_for = !self.avoided.iter().any(is_avoided);
        may_be_asked_for.then(|| self.seen(holding, camera_from_board)).flatten()
    }

    /// The view of a board at `camera_from_board`, which another camera sees held as `holding`;
    /// `None` where the detector would not see all of it.
    pub fn view_at(&self, holding: &Holding, camera_from_board: Pose) -> Option<CandidateView> {
        let [low, high] = self.bounding_box(&camera_from_board)?;
        self.is_inside([low, high]).then(|| self.seen(holding, camera_from_board)).flatten()
    }

    fn seen(&self, holding: &Holding, camera_from_board: Pose) -> Option<CandidateView> {
        let step = self.board.points.len().div_ceil(MOST_CORNERS).max(1);
        let each = (self.board.points.iter().step_by(step).count() as f64
            / self.board.points.len() as f64)
            .sqrt();
        let distance_m = (camera_from_board * self.board.middle()).coords.norm();
        let limit_px = (BLUR_PART * self.size.diagonal_px()).max(LEAST_BLUR_LIMIT_PX);
        if self.noise.blur_px(distance_m) > limit_px {
            return None;
        }
        let corner = |point: &Point3<f64>| {
            let side = side_px(self.lens, &camera_from_board, point, self.board.side_m)?;
            let std_px = self.noise.std_px(side, distance_m) * each;
            (side >= LEAST_SIDE_PX).then_some(WeightedCorner { point_in_board: *point, std_px })
        };
        let points = self.board.points.iter().step_by(step);
        let corners: Vec<WeightedCorner> = if self.board.has_markers {
            let inside = |point: &&Point3<f64>| {
                let pixel = self.lens.pixel_from_point(&(camera_from_board * **point));
                pixel.is_some_and(|pixel| self.size.contains(pixel))
            };
            points.clone().filter(inside).filter_map(corner).collect()
        } else {
            points.clone().map(corner).collect::<Option<_>>()?
        };
        if 2 * corners.len() < points.len() {
            return None;
        }
        let likely = self.likely(&camera_from_board)?;
        Some(CandidateView { holding: *holding, camera_from_board, likely, corners })
    }

    /// Where the outer corners of the board are seen, in pixels: the one at its least x and y
    /// first, then along x.
    pub fn outline_px(&self, camera_from_board: &Pose) -> Option<[Pixel; 4]> {
        let [a, b, c, d] = self
            .board
            .outline(0.0)
            .map(|point| self.lens.pixel_from_point(&(*camera_from_board * point)));
        Some([a?, b?, c?, d?])
    }

    /// Puts the card so that its bounding box in the image lies at the part `at` of the room that
    /// is left; farther away where there is none.
    fn camera_from_board(&self, holding: &Holding) -> Option<Pose> {
        let [width, height] = [self.size.width, self.size.height].map(f64::from);
        let focal_px = 0.5 * (self.lens.matrix.fx + self.lens.matrix.fy);
        let mut distance_m =
            self.board.mean_extent_m() * focal_px / (holding.share * (width * height).sqrt());
        let (middle, mut target) = (self.board.middle().coords, self.size.center());
        let mut inside = None;
        for _ in 0..10 {
            let bearing = self.lens.bearing_from_pixel(target)?;
            let facing = UnitQuaternion::rotation_between(&Vector3::z(), &bearing)?;
            let axis = Vector3::new(holding.azimuth.cos(), holding.azimuth.sin(), 0.0);
            let rotation = facing
                * UnitQuaternion::from_scaled_axis(axis * holding.tilt)
                * UnitQuaternion::from_scaled_axis(Vector3::z() * holding.roll)
                * self.base;
            let camera_from_board =
                Pose::new(rotation, bearing.into_inner() * distance_m - rotation * middle);
            let Some([low, high]) = self.bounding_box(&camera_from_board) else {
                distance_m *= 1.2;
                continue;
            };
            let (box_px, over_px) = ([high.x - low.x, high.y - low.y], self.over_px([low, high]));
            let rooms = [width - 1.0 - box_px[0], height - 1.0 - box_px[1]];
            let rooms = [0, 1].map(|axis| rooms[axis] + 2.0 * (over_px[axis] - BORDER_PX));
            if rooms[0] < 0.0 || rooms[1] < 0.0 {
                distance_m *= 1.12;
                continue;
            }
            if self.is_inside([low, high]) {
                inside = Some(camera_from_board);
            }
            let moved = [
                BORDER_PX - over_px[0] + holding.at[0] * rooms[0] - low.x,
                BORDER_PX - over_px[1] + holding.at[1] * rooms[1] - low.y,
            ];
            if moved[0].hypot(moved[1]) < 2.0 && inside.is_some() {
                break;
            }
            target = Pixel::new(target.x + moved[0], target.y + moved[1]);
        }
        inside
    }

    /// By how much a board with this box may be cut off at the image's rim, across and down.
    fn over_px(&self, [low, high]: [Pixel; 2]) -> [f64; 2] {
        [high.x - low.x, high.y - low.y]
            .map(|px| if self.board.has_markers { OVERHANG * px } else { 0.0 })
    }

    fn is_inside(&self, [low, high]: [Pixel; 2]) -> bool {
        let [width, height] = [self.size.width, self.size.height].map(f64::from);
        let over = [-low.x, -low.y, high.x - width + 1.0, high.y - height + 1.0];
        let over_px = self.over_px([low, high]);
        (0..4).all(|side| over[side] <= over_px[side % 2])
    }

    /// How likely a board that is aimed there is seen whole, where it has to be: hands end a
    /// movement beside its aim, normally distributed by each axis.
    fn likely(&self, camera_from_board: &Pose) -> Option<f64> {
        if self.board.has_markers {
            return Some(1.0);
        }
        let [low, high] = self.bounding_box(camera_from_board)?;
        let focal_px = 0.5 * (self.lens.matrix.fx + self.lens.matrix.fy);
        let std_px = AIM * focal_px;
        let [width, height] = [self.size.width, self.size.height].map(f64::from);
        let rooms = [low.x, low.y, width - 1.0 - high.x, height - 1.0 - high.y];
        // The logistic approximation of the normal distribution, right to 0.01.
        let inside = |room: f64| 1.0 / (1.0 + (-1.702 * room / std_px).exp());
        Some(rooms.into_iter().map(inside).product())
    }

    fn bounding_box(&self, camera_from_board: &Pose) -> Option<[Pixel; 2]> {
        let outline = self.board.outline(MARGIN_SQUARES);
        let (mut low, mut high) = ([f64::INFINITY; 2], [f64::NEG_INFINITY; 2]);
        for side in 0..4 {
            let (from, to) = (outline[side], outline[(side + 1) % 4]);
            for part in [0.0, 0.5] {
                let point = from + (to - from) * part;
                let pixel = self.lens.pixel_from_point(&(*camera_from_board * point))?;
                for (axis, value) in [pixel.x, pixel.y].into_iter().enumerate() {
                    low[axis] = low[axis].min(value);
                    high[axis] = high[axis].max(value);
                }
            }
        }
        Some([Pixel::new(low[0], low[1]), Pixel::new(high[0], high[1])])
    }
}
