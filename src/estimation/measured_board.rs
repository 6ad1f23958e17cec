//! The board's shape and the rolling shutter as a solve measured them, in meters.

use nalgebra::{DMatrix, Point3, Vector3};

use crate::geometry::pose::Pose;

/// A board's shape as a solve measured it, relative to the stated one. It contains no rigid motion,
/// and its mean scale is the stated one.
#[derive(Debug, Clone, PartialEq)]
pub struct MeasuredBoard {
    /// The stated points, in the board frame, in meters.
    pub points: Vec<Point3<f64>>,
    /// The offset of each from its stated position, in meters.
    pub offsets_m: Vec<Vector3<f64>>,
    /// Standard deviation of each offset per axis, in meters.
    pub std_m: Vec<Vector3<f64>>,
    /// Root mean square length of the offsets, in meters.
    pub unevenness_m: f64,
    /// Its standard deviation, in meters.
    pub unevenness_std_m: f64,
    /// The bow of the board along x and y, in meters at its middle: the parabolas that fit its
    /// heights best.
    pub bow_m: [f64; 2],
}

/// Motion during the readout of images, over the views.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct RollingShutter {
    /// Root mean square translation of the board from the first row to the last, in meters.
    pub translation_m: f64,
    /// Root mean square rotation likewise, in radians.
    pub rotation_rad: f64,
    /// 1 where views agree on the motion; otherwise the part of it, 0 to 1, that is beyond chance,
    /// which is its weight.
    pub agreement: f64,
}

/// Standard deviations below this, in meters, are rounding.
const LEAST_STD_M: f64 = 1e-12;

/// A corner closer to a measured one than this part of the board's extent is the same corner.
const SAME_CORNER: f64 = 1e-3;

impl MeasuredBoard {
    /// The mean of one board that several cameras measured: each corner's offset is weighted by 1
    /// over its variance per axis. Measurements with fewer corners than others are left out, as
    /// their shapes are relative to another mean. `None` of none.
    pub fn mean_of(measured: &[Self]) -> Option<Self> {
        let most = measured.iter().map(|board| board.points.len()).max()?;
        let whole: Vec<&Self> =
            measured.iter().filter(|board| board.points.len() == most).collect();
        let (first, others) = whole.split_first()?;
        let points = first.points.clone();
        let (mut offsets_m, mut std_m) = (first.offsets_m.clone(), first.std_m.clone());
        let mut unevenness_weight = first.unevenness_std_m.powi(-2);
        for other in others {
            let nearest: Option<Vec<usize>> =
                points.iter().map(|point| other.nearest(point)).collect();
            let Some(nearest) = nearest else { continue };
            for (k, nearest) in nearest.into_iter().enumerate() {
                for axis in 0..3 {
                    let [own, added] = [std_m[k][axis], other.std_m[nearest][axis]]
                        .map(|std: f64| std.max(LEAST_STD_M).powi(-2));
                    let sum = own * offsets_m[k][axis] + added * other.offsets_m[nearest][axis];
                    offsets_m[k][axis] = sum / (own + added);
                    std_m[k][axis] = (own + added).powf(-0.5);
                }
            }
            unevenness_weight += other.unevenness_std_m.powi(-2);
        }
        let square = offsets_m.iter().map(Vector3::norm_squared).sum::<f64>();
        Some(Self {
            unevenness_m: (square / offsets_m.len().max(1) as f64).sqrt(),
            unevenness_std_m: unevenness_weight.powf(-0.5),
            bow_m: bow_m(&points, &offsets_m),
            points,
            offsets_m,
            std_m,
        })
    }

    /// The same board in frame b.
    #[must_use]
    pub fn transformed(&self, b_from_a: &Pose) -> Self {
        let rotation = b_from_a.rotation_matrix();
        let variance = |std: &Vector3<f64>| {
            let squares = rotation.component_mul(&rotation) * std.component_mul(std);
            squares.map(f64::sqrt)
        };
        let points: Vec<Point3<f64>> = self.points.iter().map(|point| *b_from_a * *point).collect();
        let offsets_m: Vec<Vector3<f64>> = self.offsets_m.iter().map(|o| rotation * o).collect();
        let bow_m = bow_m(&points, &offsets_m);
        let std_m = self.std_m.iter().map(variance).collect();
        Self { points, offsets_m, std_m, bow_m, ..self.clone() }
    }

    /// By how much the board is longer along its x than along its y, relative to its length.
    pub fn aspect(&self) -> f64 {
        let mean = self.points.iter().map(|p| p.coords).sum::<Vector3<f64>>()
            / self.points.len().max(1) as f64;
        let [along_x, along_y] = [0, 1].map(|axis| {
            let (mut product, mut square) = (0.0, 0.0);
            for (point, offset) in self.points.iter().zip(&self.offsets_m) {
                let coordinate = point[axis] - mean[axis];
                product += coordinate * offset[axis];
                square += coordinate * coordinate;
            }
            product / square.max(f64::MIN_POSITIVE)
        });
        along_x - along_y
    }

    /// The measured offset of the corner stated at `point` (in the board frame), in meters; `None`
    /// where none was measured.
    pub fn offset_at(&self, point: &Point3<f64>) -> Option<Vector3<f64>> {
        self.nearest(point).map(|k| self.offsets_m[k])
    }

    /// The index of the measured corner stated at `point`.
    fn nearest(&self, point: &Point3<f64>) -> Option<usize> {
        let distance = |k: &usize| (self.points[*k] - point).norm();
        let first = self.points.first()?;
        let reach = self.points.iter().map(|p| (p - first).norm()).fold(0.0, f64::max);
        let nearest = (0..self.points.len()).min_by(|a, b| distance(a).total_cmp(&distance(b)))?;
        (distance(&nearest) <= SAME_CORNER * reach).then_some(nearest)
    }
}

/// The bow of heights over a board along x and y: the coefficients of the parabolas 1 − (x / half
/// extent)² and 1 − (y / half extent)² about the middle of its `points`, fitted together with a
/// plane.
pub(crate) fn bow_m(points: &[Point3<f64>], offsets_m: &[Vector3<f64>]) -> [f64; 2] {
    let spans = [0, 1].map(|axis| {
        let coordinates = || points.iter().map(|point| point[axis]);
        let (low, high) = coordinates()
            .fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), x| (low.min(x), high.max(x)));
        (0.5 * (low + high), (0.5 * (high - low)).max(f64::MIN_POSITIVE))
    });
    let columns = DMatrix::from_fn(points.len(), 5, |row, k| {
        let [x, y] = [0, 1].map(|axis| (points[row][axis] - spans[axis].0) / spans[axis].1);
        [1.0, x, y, 1.0 - x * x, 1.0 - y * y][k]
    });
    let heights = DMatrix::from_fn(points.len(), 1, |row, _| offsets_m[row].z);
    let normal = columns.transpose() * &columns;
    let solved = normal.cholesky().map(|factor| factor.solve(&(columns.transpose() * heights)));
    solved.map_or([0.0; 2], |solved| [solved[3], solved[4]])
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A board of 4 by 3 corners with these offsets at its first, the others as stated.
    fn board(offset_mm: [f64; 3], std_mm: f64) -> MeasuredBoard {
        let points: Vec<Point3<f64>> = (0..12)
            .map(|k| Point3::new(0.03 * f64::from(k % 4), 0.03 * f64::from(k / 4), 0.0))
            .collect();
        let mut offsets_m = vec![Vector3::zeros(); 12];
        offsets_m[0] = Vector3::from(offset_mm) * 1e-3;
        MeasuredBoard {
            std_m: vec![Vector3::repeat(1e-3 * std_mm); 12],
            unevenness_m: offsets_m[0].norm() / 12.0_f64.sqrt(),
            unevenness_std_m: 1e-3 * std_mm,
            bow_m: bow_m(&points, &offsets_m),
            points,
            offsets_m,
        }
    }

    #[test]
    fn the_surer_of_two_counts_more_and_a_part_of_a_board_does_not() {
        let (sure, unsure) = (board([0.4, 0.0, 0.0], 0.1), board([1.4, 0.0, 0.0], 0.2));
        let mean = MeasuredBoard::mean_of(&[sure.clone(), unsure]).unwrap();
        assert!((mean.offsets_m[0].x - 0.6e-3).abs() < 1e-9, "{}", mean.offsets_m[0]);
        assert!((mean.std_m[0].x - 0.1e-3 / 1.25_f64.sqrt()).abs() < 1e-9);
        let mut part = board([9.0, 0.0, 0.0], 0.01);
        part.points.truncate(11);
        part.offsets_m.truncate(11);
        part.std_m.truncate(11);
        assert_eq!(
            MeasuredBoard::mean_of(&[part, sure.clone()]).unwrap().offsets_m,
            sure.offsets_m
        );
        assert_eq!(MeasuredBoard::mean_of(&[]), None);
    }

    #[test]
    fn a_board_that_is_labeled_from_its_other_end_is_the_same_one() {
        let own = board([0.4, -0.1, 0.2], 0.1);
        let b_from_a = Pose::from_axis_angle(
            Vector3::z() * std::f64::consts::PI,
            Vector3::new(0.09, 0.06, 0.0),
        );
        let other = own.transformed(&b_from_a);
        let offset = other.offset_at(&Point3::new(0.09, 0.06, 0.0)).unwrap();
        assert!((offset - Vector3::new(-0.4e-3, 0.1e-3, 0.2e-3)).norm() < 1e-12, "{offset}");
        assert!((other.bow_m[0] - own.bow_m[0]).abs() < 1e-12);
    }
}
