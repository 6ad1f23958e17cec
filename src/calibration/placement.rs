//! The placement of a board in front of the camera, from one detection only: position and size in
//! the image, tilt and roll. Admission and guidance compare placements: a view is new if its
//! placement differs from those of all accepted views.
//!
//! Tilts need a focal length before one is estimated, so a nominal one is used. They are
//! approximate, but the same for the same image, so which views are accepted does not depend on how
//! fast a solve was.

use nalgebra::{Point2, Vector2, Vector3};

use crate::detection::board_detection::{DetectedCorner, Detection};
use crate::geometry::board::BoardSize;
use crate::geometry::homography::Homography;
use crate::geometry::pixel::{ImageSize, Pixel};

/// Nominal focal length over the image's longer side: a horizontal field of view of 58°, between
/// those of phones and webcams.
pub(crate) const NOMINAL_FOCAL: f64 = 0.9;

/// How a board is held in front of the camera.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Placement {
    /// Its middle, as fractions of the image's width and height, 0 to 1.
    pub center: Vector2<f64>,
    /// Square root of the fraction of the image's area that its inner corners span, 0 to 1.
    pub size: f64,
    /// The angles of its normal to the line of sight, in radians: x > 0 when its right side is
    /// nearer, y > 0 when its lower side is nearer.
    pub tilt: Vector2<f64>,
    /// The direction of its rows in the image, in radians from the image's x axis, −π to π.
    pub roll: f64,
    /// Whether a half turn cannot be distinguished.
    pub half_turn_alike: bool,
}

// The difference of two placements in one respect that counts as one step: the unit of the limits
// of admission and guidance.
/// Of the center, as a part of the image's width and height: 90 px at 640x480 along x.
const CENTER_STEP: f64 = 0.14;
/// Of the size, as a natural logarithm: 1.28 times as large.
const SIZE_STEP_LOG: f64 = 0.25;
/// Of the tilt, in radians: 11.5 degrees.
const TILT_STEP_RAD: f64 = 0.20;
/// Of the roll, in radians: 29 degrees.
const ROLL_STEP_RAD: f64 = 0.50;

impl Placement {
    /// The placement of a detected board in an image of `size`; `None` if its outer corners are
    /// neither seen nor predicted by the others, or they span no area.
    pub fn of(detection: &Detection, size: ImageSize) -> Option<Self> {
        let placement = Self::of_outline(outer_corners(detection)?, detection.board, size)?;
        Some(Self { half_turn_alike: detection.orientation_ambiguous, ..placement })
    }

    /// The placement of a board whose outermost inner corners are seen at `outline`: first, end of
    /// the first row, last, start of the last row.
    pub fn of_outline(outline: [Pixel; 4], board: BoardSize, size: ImageSize) -> Option<Self> {
        let (width, height) = (f64::from(size.width), f64::from(size.height));
        let focal_px = NOMINAL_FOCAL * width.max(height);
        let image_center = size.center().to_vector();
        let square_to_image =
            Homography::of_unit_square(outline.map(|p| (p.to_vector() - image_center) / focal_px))?;
        let along_row = square_to_image.column(0) / (f64::from(board.cols) - 1.0);
        let along_column = square_to_image.column(1) / (f64::from(board.rows) - 1.0);
        let normal = along_row.cross(&along_column).try_normalize(1e-12)?;
        let middle = square_to_image * Vector3::new(0.5, 0.5, 1.0);
        let center = middle.xy() / middle.z * focal_px + image_center + Vector2::new(0.5, 0.5);
        let row = outline[1].to_vector() - outline[0].to_vector() + outline[2].to_vector()
            - outline[3].to_vector();
        let placement = Self {
            center: center.component_div(&Vector2::new(width, height)),
            size: (polygon_area(&outline) / (width * height)).sqrt(),
            tilt: Vector2::new((normal.x / normal.z).atan(), (normal.y / normal.z).atan()),
            roll: row.y.atan2(row.x),
            half_turn_alike: board.orientation_ambiguous(),
        };
        let finite = placement.center.iter().chain(placement.tilt.iter()).all(|v| v.is_finite());
        (finite && placement.size > 0.0).then_some(placement)
    }

    /// The distance of two placements in steps; views of placements closer than 1 add nearly the
    /// same information.
    pub fn steps_to(&self, other: &Self) -> f64 {
        let center = (self.center - other.center).norm() / CENTER_STEP;
        let size = (self.size / other.size).ln() / SIZE_STEP_LOG;
        let tilt = (self.tilt - other.tilt).norm() / TILT_STEP_RAD;
        let roll = self.roll_to(other) / ROLL_STEP_RAD;
        (center * center + size * size + tilt * tilt + roll * roll).sqrt()
    }

    fn roll_to(&self, other: &Self) -> f64 {
        let period =
            if self.half_turn_alike { std::f64::consts::PI } else { std::f64::consts::TAU };
        let rotated = (self.roll - other.roll).rem_euclid(period);
        rotated.min(period - rotated)
    }
}

/// The board's outermost inner corners, in the order first, end of first row, last, start of last
/// row.
pub(crate) fn outer_corners(detection: &Detection) -> Option<[Pixel; 4]> {
    let (last_col, last_row) = (detection.board.cols as i32 - 1, detection.board.rows as i32 - 1);
    let at = |col: i32, row: i32| {
        let corner = detection
            .corners
            .iter()
            .find(|corner| corner.index.col == col && corner.index.row == row)?;
        Some(corner.pixel)
    };
    let known = detection.position_known || !detection.partial;
    known.then_some(())?;
    let ends = [(0, 0), (last_col, 0), (last_col, last_row), (0, last_row)];
    if let [Some(a), Some(b), Some(c), Some(d)] = ends.map(|(col, row)| at(col, row)) {
        return Some([a, b, c, d]);
    }
    // Only markers prove where on the board a part of it lies.
    detection.markers?;
    let pairs: Vec<(Point2<f64>, Point2<f64>)> = (detection.corners.iter())
        .map(|DetectedCorner { index, pixel, .. }| {
            let in_squares = Point2::new(f64::from(index.col), f64::from(index.row));
            (in_squares, Point2::from(pixel.to_vector()))
        })
        .collect();
    let image_from_board = Homography::fit(&pairs).ok()?;
    let [a, b, c, d] = ends.map(|(col, row)| {
        let pixel = image_from_board.apply(Point2::new(f64::from(col), f64::from(row)))?;
        Some(Pixel::new(pixel.x, pixel.y))
    });
    Some([a?, b?, c?, d?])
}

fn polygon_area(points: &[Pixel]) -> f64 {
    let next = points.iter().cycle().skip(1);
    let doubled: f64 =
        points.iter().zip(next).map(|(p, q)| p.to_vector().perp(&q.to_vector())).sum();
    doubled.abs() / 2.0
}

#[cfg(test)]
pub(crate) mod tests {
    use nalgebra::Point3;

    use super::*;
    use crate::detection::board_detection::{BoardMarkers, DetectedCorner, GridIndex};
    use crate::geometry::board::Chessboard;
    use crate::geometry::camera_matrix::CameraMatrix;
    use crate::geometry::lens::Lens;
    use crate::geometry::pose::Pose;

    pub(crate) const SIZE: ImageSize = ImageSize::new(640, 480);

    /// What a perfect detector sees of a 9×6 board of 25 mm squares, its middle at `position`
    /// (meters in the camera frame), rotated by `axis_angle` about its middle.
    pub(crate) fn detection_at(position: Vector3<f64>, axis_angle: Vector3<f64>) -> Detection {
        let board = Chessboard::new(BoardSize::new(9, 6).unwrap(), 0.025).unwrap();
        let matrix = CameraMatrix { fx: 576.0, fy: 576.0, cx: 319.5, cy: 239.5, skew: 0.0 };
        let lens = Lens::pinhole(matrix);
        let camera_from_middle = Pose::from_axis_angle(axis_angle, position);
        let pixel = |col: i32, row: i32| {
            let middle = Vector3::new(0.1, 0.0625, 0.0);
            lens.pixel_from_point(
                &(camera_from_middle * Point3::from(board.corner_in_board(col, row) - middle)),
            )
        };
        let corners = (0..6).flat_map(|row| (0..9).map(move |col| (col, row))).map(|(col, row)| {
            DetectedCorner {
                index: GridIndex { col, row },
                pixel: pixel(col, row).unwrap(),
                std_px: 0.05,
            }
        });
        Detection {
            board: board.size,
            corners: corners.collect(),
            partial: false,
            position_known: true,
            markers: None,
            orientation_ambiguous: false,
            blur_px: 0.7,
        }
    }

    #[test]
    fn markers_place_a_board_of_which_a_part_is_seen() {
        let whole = detection_at(Vector3::new(0.05, 0.02, 0.6), Vector3::new(0.3, -0.2, 0.4));
        let placement = Placement::of(&whole, SIZE).unwrap();
        let seen = whole.corners.iter().filter(|corner| corner.index.col > 2).copied();
        let part = Detection { corners: seen.collect(), partial: true, ..whole };
        assert_eq!(Placement::of(&part, SIZE), None);
        let markers = BoardMarkers { read: 9, legacy: None, border_bits: None, inverted: false };
        let coded = Detection { markers: Some(markers), ..part };
        let by_part = Placement::of(&coded, SIZE).unwrap();
        assert!(placement.steps_to(&by_part) < 1e-6, "{placement:?}, {by_part:?}");
    }

    #[test]
    fn a_frontal_board_has_no_tilt_and_lies_where_it_is() {
        let placement =
            Placement::of(&detection_at(Vector3::new(0.0, 0.0, 0.5), Vector3::zeros()), SIZE)
                .unwrap();
        assert!((placement.center - Vector2::new(0.5, 0.5)).norm() < 1e-9, "{placement:?}");
        assert!(placement.tilt.norm() < 1e-9 && placement.roll.abs() < 1e-9, "{placement:?}");
        let span: f64 = (0.2 * 576.0 / 0.5) * (0.125 * 576.0 / 0.5);
        assert!((placement.size - (span / (640.0 * 480.0)).sqrt()).abs() < 1e-9);
    }

    #[test]
    fn tilts_differ_by_direction() {
        let tilt = |axis_angle| {
            Placement::of(&detection_at(Vector3::new(0.0, 0.0, 0.5), axis_angle), SIZE)
                .unwrap()
                .tilt
        };
        let right_side_nearer = tilt(Vector3::new(0.0, 0.5, 0.0));
        let lower_side_nearer = tilt(Vector3::new(-0.5, 0.0, 0.0));
        assert!((right_side_nearer - Vector2::new(0.5, 0.0)).norm() < 1e-6, "{right_side_nearer}");
        assert!((lower_side_nearer - Vector2::new(0.0, 0.5)).norm() < 1e-6, "{lower_side_nearer}");
    }

    #[test]
    fn one_step_in_any_respect_is_new() {
        let at = |position, axis_angle| {
            Placement::of(&detection_at(position, axis_angle), SIZE).unwrap()
        };
        let here = at(Vector3::new(0.0, 0.0, 0.5), Vector3::zeros());
        let moved = at(Vector3::new(0.1, 0.0, 0.5), Vector3::zeros());
        let nearer = at(Vector3::new(0.0, 0.0, 0.38), Vector3::zeros());
        let tilted = at(Vector3::new(0.0, 0.0, 0.5), Vector3::new(0.25, 0.0, 0.0));
        let rotated = at(Vector3::new(0.0, 0.0, 0.5), Vector3::new(0.0, 0.0, 0.6));
        for other in [moved, nearer, tilted, rotated] {
            assert!(here.steps_to(&other) > 1.0 && other.steps_to(&here) > 1.0, "{other:?}");
        }
        let nearly = at(Vector3::new(0.01, 0.0, 0.51), Vector3::new(0.03, 0.0, 0.05));
        assert!(here.steps_to(&nearly) < 1.0, "{nearly:?}");
    }

    #[test]
    fn a_half_turn_counts_only_where_it_can_be_seen() {
        let upright =
            Placement::of(&detection_at(Vector3::new(0.0, 0.0, 0.5), Vector3::zeros()), SIZE)
                .unwrap();
        let rotated = Placement { roll: std::f64::consts::PI, ..upright };
        assert!(upright.steps_to(&rotated) > 1.0);
        let alike = Placement { half_turn_alike: true, ..upright };
        assert!(alike.steps_to(&Placement { half_turn_alike: true, ..rotated }) < 1e-9);
    }

    #[test]
    fn points_on_a_line_are_no_placement() {
        let mut flat = detection_at(Vector3::new(0.0, 0.0, 0.5), Vector3::zeros());
        flat.corners.iter_mut().for_each(|corner| corner.pixel.y = 100.0);
        assert_eq!(Placement::of(&flat, SIZE), None);
    }
}
