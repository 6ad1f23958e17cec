//! Checks the stated spacing of a tag grid against its measured corners. A wrong spacing resembles
//! a board whose columns are displaced in pairs: it is measured well as an uneven board, but all
//! distances have the relative error of a tag's pitch.

use nalgebra::{Matrix4, Vector4};

use crate::estimation::measured_board::MeasuredBoard;

/// A gap as a fraction of a tag's side, stated and measured.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct TagSpacing {
    pub(super) stated: f64,
    pub(super) measured: f64,
    /// The standard deviation of `measured`.
    pub(super) std: f64,
}

/// Corners within this fraction of the grid's extent are on one line.
const LINE_TOLERANCE: f64 = 1e-6;

/// Smaller differences are within the accuracy of a ruler: half a millimeter on tags of 10 cm.
/// Chosen, not swept.
const LEAST_DIFFERENCE: f64 = 0.005;

/// Differences within this many standard deviations are chance.
const CHANCE_SIGMAS: f64 = 4.0;

impl TagSpacing {
    /// For a board whose stated corners form a grid of tags; `None` for others, and if the spacing
    /// is as stated.
    pub(super) fn off_stated(shape: &MeasuredBoard) -> Option<Self> {
        let along = [0, 1].map(|axis| spacing_along(shape, axis));
        let [x, y] = [along[0]?, along[1]?];
        let weights = [x, y].map(|one| one.std.powi(-2));
        let sum = weights[0] + weights[1];
        let measured = (x.measured * weights[0] + y.measured * weights[1]) / sum;
        let (stated, std) = (x.stated, sum.sqrt().recip());
        let off = (measured - stated).abs();
        (off > LEAST_DIFFERENCE.max(CHANCE_SIGMAS * std)).then_some(Self { stated, measured, std })
    }
}

/// The spacing along an axis of the board, by least squares of each corner's position against its
/// tag's number, the side of the tag, and its position along the other axis.
fn spacing_along(shape: &MeasuredBoard, axis: usize) -> Option<TagSpacing> {
    let places: Vec<f64> = shape.points.iter().map(|point| point[axis]).collect();
    let mut lines = places.clone();
    lines.sort_by(f64::total_cmp);
    let extent = lines.last()? - lines.first()?;
    lines.dedup_by(|a, b| (*a - *b).abs() < LINE_TOLERANCE * extent);
    let steps: Vec<f64> = lines.windows(2).map(|pair| pair[1] - pair[0]).collect();
    let (tag, gap) = (*steps.first()?, *steps.get(1)?);
    let alternates = steps.iter().enumerate().all(|(k, step)| {
        let expected = if k % 2 == 0 { tag } else { gap };
        (step - expected).abs() < LINE_TOLERANCE * extent
    });
    if !alternates || lines.len() % 2 == 1 || (tag - gap).abs() < LINE_TOLERANCE * extent {
        return None;
    }
    let (mut square, mut right) = (Matrix4::zeros(), Vector4::zeros());
    let row = |k: usize| -> Option<(Vector4<f64>, f64)> {
        let line = lines.iter().position(|at| (at - places[k]).abs() < LINE_TOLERANCE * extent)?;
        let [number, side] = [line / 2, line % 2].map(|count| count as f64);
        let across = shape.points[k][1 - axis] / extent;
        Some((Vector4::new(1.0, number, side, across), places[k] + shape.offsets_m[k][axis]))
    };
    let rows: Vec<(Vector4<f64>, f64)> = (0..places.len()).map(row).collect::<Option<_>>()?;
    for (by, place) in &rows {
        square += by * by.transpose();
        right += by * *place;
    }
    let inverse = square.cholesky()?.inverse();
    let fitted = inverse * right;
    let freedom = rows.len().checked_sub(4).filter(|freedom| *freedom > 0)? as f64;
    let left: f64 = rows.iter().map(|(by, place)| (place - by.dot(&fitted)).powi(2)).sum();
    let (pitch, side) = (fitted[1], fitted[2]);
    let by_fitted = Vector4::new(0.0, 1.0 / side, -pitch / (side * side), 0.0);
    let std = (by_fitted.dot(&(inverse * by_fitted)) * left / freedom).sqrt();
    Some(TagSpacing { stated: gap / tag, measured: pitch / side - 1.0, std })
}

#[cfg(test)]
mod tests {
    use nalgebra::{Point3, Vector3};

    use super::*;

    /// Six by five tags of 5 cm whose gaps are stated as `stated` parts of a tag and are `real`, on
    /// a print that is 0.2 % larger along x, with offsets of 20 µm of every corner's own.
    fn measured(stated: f64, real: f64) -> MeasuredBoard {
        let place = |spacing: f64, line: u32| {
            0.05 * (f64::from(line / 2) * (1.0 + spacing) + f64::from(line % 2))
        };
        let lines = || (0..10).flat_map(|row| (0..12).map(move |col| (col, row)));
        let at = |spacing: f64| {
            lines()
                .map(move |(col, row)| Point3::new(place(spacing, col), place(spacing, row), 0.0))
        };
        let own = |k: usize| 2e-5 * (k as f64 * 1.7).sin();
        let points: Vec<Point3<f64>> = at(stated).collect();
        let offset = |(k, (stated, real)): (usize, (&Point3<f64>, Point3<f64>))| {
            Vector3::new(1.002 * real.x - stated.x + own(k), real.y - stated.y + own(k + 50), 0.0)
        };
        let offsets_m = points.iter().zip(at(real)).enumerate().map(offset).collect();
        MeasuredBoard {
            std_m: vec![Vector3::repeat(1e-6); points.len()],
            points,
            offsets_m,
            unevenness_m: 1e-4,
            unevenness_std_m: 1e-6,
            bow_m: [0.0; 2],
        }
    }

    #[test]
    fn a_wrong_spacing_is_reported_and_a_right_one_is_not() {
        for (stated, real) in [(0.33, 0.3), (0.28, 0.3), (0.2, 0.25)] {
            let found = TagSpacing::off_stated(&measured(stated, real)).unwrap();
            assert!((found.stated - stated).abs() < 1e-9 && found.std < 2e-4, "{found:?}");
            assert!((found.measured - real).abs() < 4.0 * found.std, "{found:?}");
        }
        assert_eq!(TagSpacing::off_stated(&measured(0.3, 0.302)), None);
    }

    #[test]
    fn boards_without_gaps_have_no_spacing() {
        let mut chessboard = measured(0.3, 0.35);
        for (k, point) in chessboard.points.iter_mut().enumerate() {
            *point = Point3::new(0.03 * (k % 12) as f64, 0.03 * (k / 12) as f64, 0.0);
        }
        assert_eq!(TagSpacing::off_stated(&chessboard), None);
    }
}
