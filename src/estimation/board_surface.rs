//! A board's surface between and beyond its measured corners.
//!
//! The surface is the one through the measured heights whose curvature changes least: the
//! polyharmonic spline of third derivatives (J. Duchon, *Splines minimizing rotation-invariant
//! semi-norms in Sobolev spaces*, 1977)
//!
//! ```text
//! h(p) = q(p) + Σₖ wₖ U(|p − pₖ|),   U(r) = r⁴ ln r,   Σₖ wₖ q'(pₖ) = 0 for each quadratic q'
//! ```
//!
//! with a quadratic q, so that a bow and a twist are exact and continue unchanged beyond the
//! corners. A thin-plate spline (of second derivatives) continues straight, and loses a fifth of a
//! bow and a third of a twist at the edge of a board of 9 by 6. The polynomials by which the shape
//! was estimated have too high a degree to extrapolate beyond the corners.

use nalgebra::{DMatrix, DVector, Point3, Vector3};

use crate::estimation::measured_board::MeasuredBoard;
use crate::geometry::depth_camera::DepthTile;
use crate::geometry::lens::Lens;
use crate::geometry::pose::Pose;

/// The heights of a board as a function of position.
#[derive(Debug, Clone, PartialEq)]
pub struct BoardSurface {
    /// The middle of the corners and half their extents, in meters. The spline is solved in these
    /// units, so that its equations do not depend on the unit of length.
    middle: [f64; 2],
    half_extent: [f64; 2],
    corners: Vec<[f64; 2]>,
    /// One per corner, then those of the quadratics, in meters.
    weights: DVector<f64>,
}

/// 1, x, y, x², xy, y².
const QUADRATICS: usize = 6;

/// The largest number of corners in use, evenly spread over the board: the heights are polynomials
/// of 55 coefficients, and the time grows with the cube.
const MOST_CORNERS: usize = 200;

/// The least ratio of the smallest to the largest eigenvalue of the quadratics' products at the
/// corners. Below it, corners lie on a line, in two rows, or on a circle. For a grid it is 0.02.
const LEAST_PART: f64 = 1e-4;

/// The position of a tile depends on the height there. The second round is exact to a thousandth of
/// the height, for a surface that rises by a thirtieth and rays of 45 degrees.
const PLACE_ROUNDS: usize = 2;

impl BoardSurface {
    /// `None` for corners that do not determine a quadratic, such as those on a line.
    pub fn of(board: &MeasuredBoard) -> Option<Self> {
        let spans = [0, 1].map(|axis| {
            let places = board.points.iter().map(|point| point[axis]);
            places.fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), x| {
                (low.min(x), high.max(x))
            })
        });
        let middle = spans.map(|(low, high)| 0.5 * (low + high));
        let half_extent = spans.map(|(low, high)| 0.5 * (high - low));
        let chosen = evenly(&board.points);
        let count = chosen.len();
        let surface = Self { middle, half_extent, corners: Vec::new(), weights: DVector::zeros(0) };
        let corners: Vec<[f64; 2]> =
            chosen.iter().map(|k| surface.placed(board.points[*k].x, board.points[*k].y)).collect();
        let polynomials =
            DMatrix::from_fn(count, QUADRATICS, |row, k| surface.quadratics(&corners[row])[k]);
        let parts = (polynomials.transpose() * &polynomials).symmetric_eigenvalues();
        if !(parts.min() > LEAST_PART * parts.max()) {
            return None;
        }
        let size = count + QUADRATICS;
        let equations = DMatrix::from_fn(size, size, |row, column| {
            match (row.checked_sub(count), column.checked_sub(count)) {
                (None, None) => spline(&corners[row], &corners[column]),
                (None, Some(k)) => polynomials[(row, k)],
                (Some(k), None) => polynomials[(column, k)],
                (Some(_), Some(_)) => 0.0,
            }
        });
        let heights =
            DVector::from_fn(size, |row, _| chosen.get(row).map_or(0.0, |k| board.offsets_m[*k].z));
        let weights = equations.lu().solve(&heights)?;
        let is_finite = weights.iter().all(|weight| weight.is_finite());
        is_finite.then_some(Self { corners, weights, ..surface })
    }

    /// A position relative to the middle, in units of half the greater extent.
    fn placed(&self, x: f64, y: f64) -> [f64; 2] {
        let unit = self.half_extent[0].max(self.half_extent[1]);
        [(x - self.middle[0]) / unit, (y - self.middle[1]) / unit]
    }

    /// The quadratics at a position, in units of half the extent along each axis.
    fn quadratics(&self, at: &[f64; 2]) -> [f64; QUADRATICS] {
        let unit = self.half_extent[0].max(self.half_extent[1]);
        let [x, y] = [0, 1].map(|k| at[k] * unit / self.half_extent[k]);
        [1.0, x, y, x * x, x * y, y * y]
    }

    /// The height of the surface above the board's plane at (x, y) in the board frame, in meters,
    /// along the board's z.
    pub fn height_m(&self, x: f64, y: f64) -> f64 {
        let at = self.placed(x, y);
        let splines = self.corners.iter().map(|corner| spline(&at, corner));
        let values = splines.chain(self.quadratics(&at));
        values.zip(self.weights.iter()).map(|(value, weight)| value * weight).sum()
    }

    /// What a depth camera with `lens` would have measured if the board were its plane. Along a
    /// ray, 1/z is inverse to the plane's distance d from the camera, and the surface at height h
    /// lies on the plane at d + h. `None` where the lens has no ray for the pixel.
    pub fn on_plane(
        &self,
        lens: &Lens,
        depth_from_board: &Pose,
        tile: &DepthTile,
    ) -> Option<DepthTile> {
        let bearing = lens.bearing_from_pixel(tile.pixel).filter(|bearing| bearing.z > 1e-3)?;
        let ray = bearing.into_inner();
        let normal = *depth_from_board * Vector3::z();
        let distance_m = normal.dot(&depth_from_board.translation());
        let board_from_depth = depth_from_board.inverse();
        let height_m = (0..PLACE_ROUNDS).fold(0.0, |height_m, _| {
            let along = (distance_m + height_m) / normal.dot(&ray);
            let place = board_from_depth * Point3::from(ray * along);
            self.height_m(place.x, place.y)
        });
        let inverse_depth = tile.inverse_depth * (1.0 + height_m / distance_m);
        inverse_depth.is_finite().then_some(DepthTile { inverse_depth, ..*tile })
    }
}

/// U of the distance between two positions.
fn spline(a: &[f64; 2], b: &[f64; 2]) -> f64 {
    let square = (a[0] - b[0]).powi(2) + (a[1] - b[1]).powi(2);
    if square > 0.0 { 0.5 * square * square * square.ln() } else { 0.0 }
}

/// All points; or of many, a sample in which each is the farthest from those before it.
fn evenly(points: &[Point3<f64>]) -> Vec<usize> {
    if points.len() <= MOST_CORNERS {
        return (0..points.len()).collect();
    }
    let mut chosen = vec![0];
    let mut nearest = vec![f64::INFINITY; points.len()];
    while chosen.len() < MOST_CORNERS {
        let last = &points[chosen[chosen.len() - 1]];
        for (distance, point) in nearest.iter_mut().zip(points) {
            *distance = distance.min((point - last).norm_squared());
        }
        let farthest = (0..points.len()).max_by(|a, b| nearest[*a].total_cmp(&nearest[*b]));
        chosen.extend(farthest);
    }
    chosen
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::camera_matrix::CameraMatrix;
    use crate::geometry::pixel::Pixel;

    const SQUARE_M: f64 = 0.03;

    /// A board of this many corners with these heights over (x, y), which are ±1 at its outer
    /// corners.
    fn board([cols, rows]: [u32; 2], height_m: impl Fn(f64, f64) -> f64) -> MeasuredBoard {
        let points: Vec<Point3<f64>> = (0..cols * rows)
            .map(|k| Point3::new(f64::from(k % cols), f64::from(k / cols), 0.0) * SQUARE_M)
            .collect();
        let half = [cols, rows].map(|count| 0.5 * f64::from(count - 1) * SQUARE_M);
        let offset = |p: &Point3<f64>| {
            Vector3::new(1e-4, -1e-4, height_m(p.x / half[0] - 1.0, p.y / half[1] - 1.0))
        };
        MeasuredBoard {
            offsets_m: points.iter().map(offset).collect(),
            std_m: vec![Vector3::zeros(); points.len()],
            unevenness_m: 0.0,
            unevenness_std_m: 0.0,
            bow_m: [0.0; 2],
            points,
        }
    }

    /// Bowed by 2 mm along x, twisted by 2 mm, and wavy by 1 mm.
    fn uneven(x: f64, y: f64) -> f64 {
        0.002 * (1.0 - x * x) + 0.002 * x * y + 0.001 * (2.0 * x + y).sin()
    }

    /// The largest errors between corners, and up to 0.8 squares beyond them, in meters.
    fn largest_errors(size: [u32; 2]) -> [f64; 2] {
        let surface = BoardSurface::of(&board(size, uneven)).unwrap();
        let half = size.map(|count| 0.5 * f64::from(count - 1));
        let mut errors = [0.0_f64; 2];
        for k in 0..41 * 41 {
            let [x, y] = [0, 1].map(|axis| {
                let part = f64::from([k % 41, k / 41][axis]) / 20.0 - 1.0;
                part * (half[axis] + 0.8)
            });
            let found = surface.height_m((half[0] + x) * SQUARE_M, (half[1] + y) * SQUARE_M);
            let is_beside = x.abs() > half[0] || y.abs() > half[1];
            let error = &mut errors[usize::from(is_beside)];
            *error = error.max((found - uneven(x / half[0], y / half[1])).abs());
        }
        errors
    }

    #[test]
    fn between_corners_and_to_the_board_s_edge_the_surface_is_the_true_one() {
        let [inside, beside] = largest_errors([9, 6]);
        assert!(inside < 0.01e-3 && beside < 0.15e-3, "{inside} and {beside} m");
        // Of 1600 corners 200 are used.
        let [inside, beside] = largest_errors([40, 40]);
        assert!(inside < 0.01e-3 && beside < 0.01e-3, "{inside} and {beside} m");
    }

    #[test]
    fn a_flat_board_is_flat_and_two_rows_are_no_surface() {
        let flat = BoardSurface::of(&board([9, 6], |_, _| 0.0)).unwrap();
        assert_eq!(flat.height_m(0.1, -0.02), 0.0);
        assert!(BoardSurface::of(&board([3, 3], uneven)).is_some());
        assert!(BoardSurface::of(&board([30, 3], uneven)).is_some());
        assert_eq!(BoardSurface::of(&board([9, 2], uneven)), None);
        assert_eq!(BoardSurface::of(&board([9, 2], |_, _| 0.0)), None);
    }

    /// The ray is followed to the surface by bisection, and to the plane.
    #[test]
    fn a_tile_of_the_surface_becomes_one_of_the_plane() {
        let found = BoardSurface::of(&board([9, 6], uneven)).unwrap();
        let lens =
            Lens::pinhole(CameraMatrix { fx: 290.0, fy: 291.0, cx: 158.0, cy: 121.0, skew: 0.0 });
        let depth_from_board =
            Pose::from_axis_angle(Vector3::new(0.3, -0.5, 0.2), Vector3::new(-0.05, -0.1, 0.7));
        let board_from_depth = depth_from_board.inverse();
        for k in 0..48 {
            let (x, y) = (f64::from(k % 8) + 0.4, f64::from(k / 8) * 0.8 + 0.3);
            let point = depth_from_board * Point3::new(x * SQUARE_M, y * SQUARE_M, 0.0);
            let pixel: Pixel = lens.pixel_from_point(&point).unwrap();
            let above = |z: f64| {
                let at = board_from_depth * Point3::from(point.coords * (z / point.z));
                at.z - found.height_m(at.x, at.y)
            };
            let (mut near, mut far) = (point.z - 0.02, point.z + 0.02);
            for _ in 0..60 {
                let middle = 0.5 * (near + far);
                *(if above(middle) < 0.0 { &mut near } else { &mut far }) = middle;
            }
            let tile =
                DepthTile { pixel, inverse_depth: 1.0 / near, reading_std: 0.003, count: 100 };
            let on_plane = found.on_plane(&lens, &depth_from_board, &tile).unwrap();
            let (before, after) =
                (1.0 / tile.inverse_depth - point.z, 1.0 / on_plane.inverse_depth - point.z);
            assert!(after.abs() < 5e-6 + 0.01 * before.abs(), "{before} to {after} m");
        }
    }
}
