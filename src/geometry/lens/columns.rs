//! The distortion of many points at once, in columns of numbers, so that the loop over points is
//! vectorized.

use nalgebra::Point3;

use crate::geometry::lens::model::DistortionModel;

/// Distorted normalized coordinates of many points, with their derivatives: each quantity is one
/// column over the points.
#[derive(Debug, Clone, Default)]
pub struct DistortedColumns {
    len: usize,
    values: Vec<f64>,
}

/// Column numbers: x_d, y_d; the six derivatives of (x_d, y_d) by the point, row by row; one that
/// is 1 inside the valid region and 0 outside; then for each coefficient the derivatives of x_d and
/// y_d.
const BY_POINT: usize = 2;
const INSIDE: usize = 8;
const BY_COEFFICIENT: usize = 9;

/// Number of points that are processed together.
const BLOCK: usize = 8;

/// Copies a block, or the remaining part of one.
#[inline(always)]
fn copy(from: &[f64], to: &mut [f64]) {
    match (from.first_chunk::<BLOCK>(), to.first_chunk_mut::<BLOCK>()) {
        (Some(from), Some(to)) => *to = *from,
        _ => to.iter_mut().zip(from).for_each(|(to, from)| *to = *from),
    }
}

impl DistortedColumns {
    #[inline(always)]
    pub(super) fn fill<const N: usize>(
        &mut self,
        model: &impl DistortionModel<N>,
        points: [&[f64]; 3],
    ) {
        self.len = points.iter().map(|column| column.len()).min().unwrap_or(0);
        self.values.resize((BY_COEFFICIENT + 2 * N) * self.len, 0.0);
        // Arrays of known size, so that the loop needs no bounds checks.
        let mut block = [[1.0; BLOCK]; 3];
        let (mut fixed, mut by_coefficients) =
            ([[0.0; BLOCK]; BY_COEFFICIENT], [[[0.0; BLOCK]; 2]; N]);
        for from in (0..self.len).step_by(BLOCK) {
            for (block, column) in block.iter_mut().zip(points) {
                copy(&column[from..], block);
            }
            for k in 0..BLOCK {
                let (distorted, inside) =
                    model.distort_or_axis(&Point3::new(block[0][k], block[1][k], block[2][k]));
                fixed[0][k] = distorted.normalized.x;
                fixed[1][k] = distorted.normalized.y;
                for c in 0..3 {
                    fixed[BY_POINT + c][k] = distorted.by_point[(0, c)];
                    fixed[BY_POINT + 3 + c][k] = distorted.by_point[(1, c)];
                }
                fixed[INSIDE][k] = if inside { 1.0 } else { 0.0 };
                for (c, [by_x, by_y]) in by_coefficients.iter_mut().enumerate() {
                    by_x[k] = distorted.by_coefficients[(0, c)];
                    by_y[k] = distorted.by_coefficients[(1, c)];
                }
            }
            let blocks = fixed.iter().chain(by_coefficients.as_flattened());
            for (column, block) in self.values.chunks_exact_mut(self.len).zip(blocks) {
                copy(block, &mut column[from..]);
            }
        }
    }

    fn column(&self, column: usize) -> &[f64] {
        &self.values[column * self.len..(column + 1) * self.len]
    }

    /// x_d and y_d.
    pub fn normalized(&self) -> [&[f64]; 2] {
        [self.column(0), self.column(1)]
    }

    /// The derivatives of x_d and y_d by coordinate `axis` of the point in the camera frame.
    pub fn by_point(&self, axis: usize) -> [&[f64]; 2] {
        [self.column(BY_POINT + axis), self.column(BY_POINT + 3 + axis)]
    }

    /// The derivatives of x_d and y_d by the model's coefficient `index`.
    pub fn by_coefficient(&self, index: usize) -> [&[f64]; 2] {
        let first = BY_COEFFICIENT + 2 * index;
        [self.column(first), self.column(first + 1)]
    }

    /// 1 for a point inside the lens's valid region, 0 for one outside, whose other columns have no
    /// meaning.
    pub fn inside(&self) -> &[f64] {
        self.column(INSIDE)
    }
}
