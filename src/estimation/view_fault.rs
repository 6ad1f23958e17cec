//! Why a view is not used in an estimate, and which labels would fit its corners instead.

use nalgebra::{Point2, Point3};

use crate::geometry::homography::Homography;
use crate::geometry::pixel::Pixel;

/// Why a view is not used in an estimate.
#[derive(Debug, Clone, Copy, PartialEq, thiserror::Error)]
pub enum ViewFault {
    /// Too few points: a pose has six unknowns, and a check needs more.
    #[error("only {points} points; at least {needed} are needed")]
    TooFewPoints {
        /// Number of points.
        points: usize,
        /// Number of points needed.
        needed: usize,
    },
    /// A duplicate: it carries no new information, and counting it would understate every
    /// uncertainty.
    #[error("a duplicate of view {number}: it counts once")]
    Copied {
        /// The number of the original view, from 1.
        number: usize,
    },
    /// The board's points are on one line or in one place.
    #[error("its board points lie on one line or in one place")]
    PointsOnLine,
    /// The pixels are on one line or in one place.
    #[error("its corners were all seen on one line or in one place")]
    PixelsOnLine,
    /// Seen from behind, which a printed board cannot be.
    #[error("mirrored: it fits only as the board's back side")]
    Mirrored,
    /// Labeled one place off; the labels wrap around at the board's edge.
    #[error("its labels are shifted by one {0}")]
    Shifted(GridLine),
    /// Rotated by half a turn relative to the rig's other sensors.
    #[error(
        "its labels are rotated by 180 degrees: its first corner is not the first corner of the other sensors"
    )]
    HalfTurn,
    /// Labeled along the columns.
    #[error("its labels are transposed: the corners were listed along the columns")]
    Transposed,
    /// No pose fits it.
    #[error(
        "no board pose fits its corners (rms {rms_px:.1} px): they are mislabeled, or from another board"
    )]
    NoPose {
        /// Rms of its residuals at the best pose.
        rms_px: f64,
    },
    /// Too many corners are outliers.
    #[error("{outliers} of its {points} corners have residuals above {limit_px:.2} px")]
    Outliers {
        /// Number of outliers.
        outliers: usize,
        /// Number of corners.
        points: usize,
        /// The largest residual of an inlier.
        limit_px: f64,
    },
    /// Its corners do not fit the lens and the board that the other views show.
    #[error(
        "its corners are {rms_px:.2} px off by the lens and the board that the other {others} views show ({expected_px:.2} px expected): the image is mirrored or from another camera, or the board was bent or moved"
    )]
    LeftOutMisfit {
        /// Root mean square of its residuals, in pixels.
        rms_px: f64,
        /// The same as expected from the noise and from the uncertainty of lens and board.
        expected_px: f64,
        /// Number of the other views.
        others: usize,
    },
    /// It fits best with a motion that is incompatible with the other views.
    #[error(
        "its corners imply {times:.1} times the board motion during readout that the other views predict, and do not fit even with that motion: the board was bent in this view, or the image is mirrored or from another camera"
    )]
    OddMotion {
        /// Relative to the root mean square that the other views show.
        times: f64,
    },
}

/// A line of a chessboard's corners.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum GridLine {
    /// Along y.
    Column,
    /// Along x.
    Row,
}

impl std::fmt::Display for GridLine {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(match self {
            Self::Column => "column",
            Self::Row => "row",
        })
    }
}

/// The grid formed by the corners of a complete view.
struct LabelGrid {
    cols: usize,
    rows: usize,
    /// The column and row of each point.
    cells: Vec<(usize, usize)>,
    /// The point in each cell, row by row.
    point_at: Vec<usize>,
}

impl LabelGrid {
    /// `None` unless the points are all the cells of a grid along x and y, each once.
    fn of(points: &[Point3<f64>]) -> Option<Self> {
        let (xs, ys) = (lines(points.iter().map(|p| p.x)), lines(points.iter().map(|p| p.y)));
        let (cols, rows) = (xs.len(), ys.len());
        if cols * rows != points.len() || cols < 3 || rows < 3 {
            return None;
        }
        let nearest = |values: &[f64], v: f64| {
            values.partition_point(|x| *x < v - 0.5 * (values[1] - values[0]))
        };
        let cells: Vec<_> = points.iter().map(|p| (nearest(&xs, p.x), nearest(&ys, p.y))).collect();
        let mut point_at = vec![usize::MAX; points.len()];
        for (index, (col, row)) in cells.iter().enumerate() {
            *point_at.get_mut(row * cols + col)? = index;
        }
        point_at.iter().all(|index| *index != usize::MAX).then_some(Self {
            cols,
            rows,
            cells,
            point_at,
        })
    }

    /// For each point, the index of the point at the grid position to which `moved` maps it.
    fn permuted(&self, moved: impl Fn(usize, usize) -> (usize, usize)) -> Vec<usize> {
        let at = |&(col, row): &(usize, usize)| {
            let (col, row) = moved(col, row);
            self.point_at[row * self.cols + col]
        };
        self.cells.iter().map(at).collect()
    }
}

/// The distinct values, ascending.
fn lines(values: impl Iterator<Item = f64>) -> Vec<f64> {
    let mut sorted: Vec<f64> = values.collect();
    sorted.sort_by(f64::total_cmp);
    let width = sorted.last().unwrap_or(&0.0) - sorted.first().unwrap_or(&0.0);
    sorted.dedup_by(|a, b| (*a - *b).abs() <= 1e-6 * width);
    sorted
}

/// The fault in the labels of a flat view that no pose fits: the relabeling under which a
/// homography fits to within `limit_px`, if there is one.
pub(crate) fn mislabeling(
    points_on_plane: &[Point3<f64>],
    pixels: &[Pixel],
    limit_px: f64,
) -> Option<ViewFault> {
    let grid = LabelGrid::of(points_on_plane)?;
    let (cols, rows) = (grid.cols, grid.rows);
    let shifted = |by_col: usize, by_row: usize| {
        grid.permuted(|c, r| ((c + by_col) % cols, (r + by_row) % rows))
    };
    let listed_along_columns = |k: usize| (k / rows, k % rows);
    let listed_along_rows = |k: usize| (k % cols, k / cols);
    let along_columns = grid.permuted(|c, r| listed_along_columns(r * cols + c));
    let along_rows = grid.permuted(|c, r| listed_along_rows(c * rows + r));
    let relabelings = [
        (ViewFault::Shifted(GridLine::Column), shifted(1, 0)),
        (ViewFault::Shifted(GridLine::Column), shifted(cols - 1, 0)),
        (ViewFault::Shifted(GridLine::Row), shifted(0, 1)),
        (ViewFault::Shifted(GridLine::Row), shifted(0, rows - 1)),
        (ViewFault::Transposed, along_columns),
        (ViewFault::Transposed, along_rows),
    ];
    relabelings.into_iter().find_map(|(fault, relabeled)| {
        let pair = |(label, pixel): (&usize, &Pixel)| {
            (points_on_plane[*label].xy(), Point2::new(pixel.x, pixel.y))
        };
        let pairs: Vec<_> = relabeled.iter().zip(pixels).map(pair).collect();
        let homography = Homography::fit(&pairs).ok()?;
        (homography.rms(&pairs) <= limit_px).then_some(fault)
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_mislabeling_is_named() {
        let (cols, rows) = (7, 5);
        let points: Vec<_> = (0..35)
            .map(|k| Point3::new(f64::from(k % cols) * 0.03, f64::from(k / cols) * 0.03, 0.0))
            .collect();
        let pixels: Vec<_> = points
            .iter()
            .map(|p| {
                Pixel::new(
                    100.0 + 900.0 * p.x / (1.0 + p.y),
                    80.0 + 800.0 * (p.y + 0.1 * p.x) / (1.0 + p.y),
                )
            })
            .collect();
        let named = |order: &dyn Fn(i32) -> i32| {
            let seen: Vec<_> = (0..35).map(|k| pixels[order(k) as usize]).collect();
            mislabeling(&points, &seen, 1.0)
        };
        let shift = |k: i32| k / cols * cols + (k % cols + 1) % cols;
        assert_eq!(named(&shift), Some(ViewFault::Shifted(GridLine::Column)));
        assert_eq!(named(&|k| (k + cols) % 35), Some(ViewFault::Shifted(GridLine::Row)));
        assert_eq!(named(&|k| k % rows * cols + k / rows), Some(ViewFault::Transposed));
        assert_eq!(named(&|k| k % cols * rows + k / cols), Some(ViewFault::Transposed));
        assert_eq!(named(&|k| (k * 11) % 35), None);
    }
}
