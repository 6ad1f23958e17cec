//! One view's Jacobian as dense columns.

use crate::estimation::effects::shape_products::by_board_axes;
use crate::estimation::effects::state::{Scene, read_out_times};
use crate::estimation::joint::BoardObservation;

/// The layout of one view's Jacobian: lens, smooth shapes, motion, pose, residual. Each column
/// holds all corners' x, then all corners' y.
pub(super) struct ViewColumns<'a> {
    scene: Scene<'a>,
    lens: usize,
    smooth: usize,
    pub(super) rows: usize,
    point_of: &'a [usize],
}

impl<'a> ViewColumns<'a> {
    pub(super) fn of(scene: Scene<'a>, seen: &BoardObservation, index: usize) -> Self {
        Self {
            scene,
            lens: scene.layout.len,
            smooth: scene.basis.smooth_len(),
            rows: 2 * seen.points.len().max(1).next_multiple_of(8),
            point_of: &scene.basis.point_of[index],
        }
    }

    pub(super) fn motion(&self) -> usize {
        self.lens + self.smooth
    }

    pub(super) fn pose(&self) -> usize {
        self.motion() + if self.scene.moves { 6 } else { 0 }
    }

    pub(super) fn residual(&self) -> usize {
        self.pose() + 6
    }

    pub(super) fn count(&self) -> usize {
        self.residual() + 1
    }

    /// Number of global parameters.
    pub(super) fn globals(&self) -> usize {
        self.scene.global_len()
    }

    /// The index of each corner's point, where points have offsets of their own; otherwise empty.
    pub(super) fn own(&self) -> &'a [usize] {
        if self.scene.basis.has_point_offsets { self.point_of } else { &[] }
    }

    /// Fills `values` from the columns (lens, pose, residual) of the plain problem. Returns the
    /// derivatives by a displacement along the board's x and y.
    pub(super) fn fill(
        &self,
        camera_from_board: &nalgebra::Matrix3<f64>,
        seen: &BoardObservation,
        plain: &[f64],
        values: &mut Vec<f64>,
    ) -> [Vec<f64>; 2] {
        let (rows, half) = (self.rows, self.rows / 2);
        let basis = self.scene.basis;
        values.clear();
        values.resize(self.count() * rows, 0.0);
        values[..self.lens * rows].copy_from_slice(&plain[..self.lens * rows]);
        values[self.pose() * rows..].copy_from_slice(&plain[self.lens * rows..]);
        let pose = &plain[self.lens * rows..];
        let [by_x, by_y, by_z] = by_board_axes(camera_from_board, pose);
        let (heights, stretches) = values[self.lens * rows..][..self.smooth * rows]
            .split_at_mut(basis.heights.len() * rows);
        for (column, (_, height)) in heights.chunks_exact_mut(rows).zip(&basis.heights) {
            for (corner, point) in self.point_of.iter().enumerate() {
                for row in [corner, corner + half] {
                    column[row] = by_z[row] * height[*point];
                }
            }
        }
        for (column, stretch) in stretches.chunks_exact_mut(rows).zip(&basis.stretches) {
            for (corner, point) in self.point_of.iter().enumerate() {
                let [x, y] = stretch[*point];
                for row in [corner, corner + half] {
                    column[row] = by_x[row] * x + by_y[row] * y;
                }
            }
        }
        let times = read_out_times(seen, self.scene);
        let lever = 1.0 / basis.lever();
        for column in 0..self.pose() - self.motion() {
            let unit = if column < 3 { lever } else { 1.0 };
            for (corner, time) in times.iter().enumerate() {
                for row in [corner, corner + half] {
                    values[(self.motion() + column) * rows + row] =
                        pose[column * rows + row] * time * unit;
                }
            }
        }
        [by_x, by_y]
    }
}
