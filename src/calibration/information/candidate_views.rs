//! Views that a detector could find: a board anywhere in the image, near and far, tilted and
//! rolled. All of the board is inside the image (or, if it has markers, cut off at the border), its
//! squares are large enough, and it is sharp enough.

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
    /// Whether a part of the board suffices to identify its corners, as on a board with markers.
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

    /// All points of a problem's views; `None` if there are fewer than four.
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

    /// The corners of its extent, widened by `margin` squares: the one at the least x and y first,
    /// then along x.
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

/// How a board is held in the image, independent of the camera.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PlacementInImage {
    /// Its place in the room that it leaves in the image, across and down, 0 to 1.
    pub at: [f64; 2],
    /// The root of the fraction of the image that its corners would span if it faced the camera, 0
    /// to 1.
    pub share: f64,
    /// The angle between its normal and the line of sight, in radians.
    pub tilt: f64,
    /// The axis that it is tilted about, as an angle in radians from the image's x.
    pub azimuth: f64,
    /// Its roll in the image, in radians.
    pub roll: f64,
}

/// The range of [`PlacementInImage::share`]. Small boards reach far into the corners of a fisheye's
/// image; the size of the squares limits how small.
const SHARE: [f64; 2] = [0.12, 0.85];
/// The greatest tilt and roll. Rendered boards are found up to 50°; beyond, detectors begin to miss
/// them.
const GREATEST_TILT: f64 = 0.85;
const GREATEST_ROLL: f64 = 0.6;
/// A board for a corner of the image keeps this fraction of the room from that corner.
const IN_CORNER: f64 = 0.06;
/// Standard deviation of the position where a movement by hand ends, relative to the distance.
const AIM: f64 = 0.03;
/// The least side of a square: detectors need 6 px.
const LEAST_SIDE_PX: f64 = 8.0;
/// How far the board must be visible beyond its outer corners: the squares that form these corners.
const MARGIN_SQUARES: f64 = 1.0;
const BORDER_PX: f64 = 2.0;
/// A board with markers may extend beyond the image by this fraction of its extent.
const OVERHANG: f64 = 0.35;
/// The greatest blur of a suggested view, as a fraction of the image's diagonal: half of what
/// admission accepts.
const BLUR_PART: f64 = 0.00125;
const LEAST_BLUR_LIMIT_PX: f64 = 1.5;
/// With more corners, every n-th one is used with weight n.
const MOST_CORNERS: usize = 48;

/// The generators of Roberts' R6 sequence: powers of the inverse of the root of x⁷ = x + 1.
const GENERATORS: [f64; 6] =
    [0.898_653_9, 0.807_578_8, 0.725_733_8, 0.652_183_5, 0.586_087_2, 0.526_689_6];

impl PlacementInImage {
    /// The `index`-th of a sequence that covers the whole range evenly.
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

    /// The `index`-th with the board in a corner of the image, one corner after another.
    pub fn in_corner(index: usize) -> Self {
        let beside = |at: f64| IN_CORNER + (1.0 - 2.0 * IN_CORNER) * at;
        let at = [index & 1, index >> 1 & 1].map(|side| beside(side as f64));
        Self { at, ..Self::of_sequence(index) }
    }

    /// The `index`-th of a sequence around it, within `step` (0 to 1) of the whole range.
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

/// A view that could be suggested.
#[derive(Debug, Clone, PartialEq)]
pub struct CandidateView {
    /// How the board would be held.
    pub placement: PlacementInImage,
    /// The board's pose.
    pub camera_from_board: Pose,
    /// The probability that all of the board is visible when it is held by hand near this pose.
    pub visibility: f64,
    /// Its corners with their expected noise; with many, every n-th one has the weight of n.
    pub corners: Vec<WeightedCorner>,
}

/// The space of views to suggest: a board in front of a camera.
#[derive(Debug, Clone, Copy)]
pub struct CandidateSpace<'a> {
    /// The lens, as far as it is known.
    pub lens: &'a Lens,
    /// The size of its images.
    pub size: ImageSize,
    /// The board.
    pub board: &'a BoardPoints,
    /// The expected noise of its corners.
    pub noise: &'a CornerNoise,
    /// The board's rotation when it faces the camera, from [`base_rotation`].
    pub base: UnitQuaternion<f64>,
    /// Poses that are not suggested.
    pub avoided: &'a [AvoidedPose],
}

/// A pose around which a board would not be kept.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct AvoidedPose {
    /// Where.
    pub camera_from_board: Pose,
    /// The radius, as an effort.
    pub effort: f64,
}

/// The board's rotation in the camera without tilt and smaller rotations: a multiple of 90°, and
/// 180° about the board's x axis if its z axis points at the camera, as on Kalibr's grids.
pub fn base_rotation(camera_from_board: &Pose) -> UnitQuaternion<f64> {
    let row = *camera_from_board * Vector3::x();
    let quarters = (row.y.atan2(row.x) / FRAC_PI_2).round();
    let rolled = UnitQuaternion::from_scaled_axis(Vector3::z() * (quarters * FRAC_PI_2));
    // The test uses the line of sight: near the border of a fisheye's image, the normal of a board
    // that is seen from the front may point away from the image plane.
    let normal = *camera_from_board * Vector3::z();
    let towards_camera = normal.dot(&camera_from_board.translation()) < 0.0;
    if towards_camera {
        rolled * UnitQuaternion::from_scaled_axis(Vector3::x() * PI)
    } else {
        rolled
    }
}

/// A hand moves a board by half its distance in the time in which it rotates it by a radian.
const EFFORT_PER_DISTANCE: f64 = 2.0;

/// The effort from one pose to another for a board with this middle, in radians of rotation.
pub fn effort(here_from_board: &Pose, there_from_board: &Pose, middle: Point3<f64>) -> f64 {
    let poses = [here_from_board, there_from_board];
    let [here, there] = poses.map(|pose| (*pose * middle).coords);
    let translation = (there - here).norm() / here.norm().max(f64::MIN_POSITIVE);
    EFFORT_PER_DISTANCE * translation
        + here_from_board.rotation().angle_to(&there_from_board.rotation())
}

impl CandidateSpace<'_> {
    /// The view of a board held like this; `None` in avoided poses, and where the detector would
    /// not find all of it.
    pub fn view(&self, placement: &PlacementInImage) -> Option<CandidateView> {
        let camera_from_board = self.camera_from_board(placement)?;
        let is_avoided = |avoided: &AvoidedPose| {
            effort(&avoided.camera_from_board, &camera_from_board, self.board.middle())
                < avoided.effort
        };
        let may_be_suggested = !self.avoided.iter().any(is_avoided);
        may_be_suggested.then(|| self.seen(placement, camera_from_board)).flatten()
    }

    /// The view of a board at `camera_from_board`, which is held as `placement` before another
    /// camera; `None` where the detector would not find all of it.
    pub fn view_at(
        &self,
        placement: &PlacementInImage,
        camera_from_board: Pose,
    ) -> Option<CandidateView> {
        let [low, high] = self.bounding_box(&camera_from_board)?;
        self.is_inside([low, high]).then(|| self.seen(placement, camera_from_board)).flatten()
    }

    fn seen(&self, placement: &PlacementInImage, camera_from_board: Pose) -> Option<CandidateView> {
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
        let visibility = self.visibility(&camera_from_board)?;
        Some(CandidateView { placement: *placement, camera_from_board, visibility, corners })
    }

    /// The pixels of the board's outer corners: the one at its least x and y first, then along x.
    pub fn outline_px(&self, camera_from_board: &Pose) -> Option<[Pixel; 4]> {
        let [a, b, c, d] = self
            .board
            .outline(0.0)
            .map(|point| self.lens.pixel_from_point(&(*camera_from_board * point)));
        Some([a?, b?, c?, d?])
    }

    /// Places the board so that its bounding box in the image lies at the fraction `at` of the room
    /// that is left, and farther away if there is no room.
    fn camera_from_board(&self, placement: &PlacementInImage) -> Option<Pose> {
        let [width, height] = [self.size.width, self.size.height].map(f64::from);
        let focal_px = 0.5 * (self.lens.matrix.fx + self.lens.matrix.fy);
        let mut distance_m =
            self.board.mean_extent_m() * focal_px / (placement.share * (width * height).sqrt());
        let (middle, mut target) = (self.board.middle().coords, self.size.center());
        let mut inside = None;
        for _ in 0..10 {
            let bearing = self.lens.bearing_from_pixel(target)?;
            let facing = UnitQuaternion::rotation_between(&Vector3::z(), &bearing)?;
            let axis = Vector3::new(placement.azimuth.cos(), placement.azimuth.sin(), 0.0);
            let rotation = facing
                * UnitQuaternion::from_scaled_axis(axis * placement.tilt)
                * UnitQuaternion::from_scaled_axis(Vector3::z() * placement.roll)
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
                BORDER_PX - over_px[0] + placement.at[0] * rooms[0] - low.x,
                BORDER_PX - over_px[1] + placement.at[1] * rooms[1] - low.y,
            ];
            if moved[0].hypot(moved[1]) < 2.0 && inside.is_some() {
                break;
            }
            target = Pixel::new(target.x + moved[0], target.y + moved[1]);
        }
        inside
    }

    /// How far a board with this bounding box may extend beyond the image, across and down.
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

    /// The probability that a board that is aimed there is completely visible, where it has to be:
    /// hands miss the aim, with a normal distribution per axis.
    fn visibility(&self, camera_from_board: &Pose) -> Option<f64> {
        if self.board.has_markers {
            return Some(1.0);
        }
        let [low, high] = self.bounding_box(camera_from_board)?;
        let focal_px = 0.5 * (self.lens.matrix.fx + self.lens.matrix.fy);
        let std_px = AIM * focal_px;
        let [width, height] = [self.size.width, self.size.height].map(f64::from);
        let rooms = [low.x, low.y, width - 1.0 - high.x, height - 1.0 - high.y];
        // The logistic approximation of the normal distribution, accurate to 0.01.
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
