//! Products of the board's shape with all other parameters, computed by way of its points. A
//! function on the board only moves points, so its products follow from those of each point's
//! displacement along the board's axes, which are summed over the views first. One column for each
//! of 52 polynomials in each view would take 1.6 times as long.

use nalgebra::{DMatrix, DVector, Matrix3};
use pulp::{Arch, Simd, WithSimd};

use crate::estimation::effects::board_basis::BoardBasis;

/// Pairs of axes, in the order of [`PointProducts::squares`].
const PAIRS: [(usize, usize); 6] = [(0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2)];

/// The index in [`PAIRS`] of two axes.
const PAIR_OF: [[usize; 3]; 3] = [[0, 1, 2], [1, 3, 4], [2, 4, 5]];

/// The weighted derivatives by a displacement of each corner along the board's x, y and z, from the
/// six columns of the pose. Each holds all corners' x, then all corners' y.
pub(super) fn by_board_axes(camera_from_board: &Matrix3<f64>, pose: &[f64]) -> [Vec<f64>; 3] {
    let rows = pose.len() / 7;
    let along = |k: usize| &pose[(3 + k) * rows..][..rows];
    let (by_x, by_y, by_z) = (along(0), along(1), along(2));
    [0, 1, 2].map(|axis| {
        let [x, y, z] = [0, 1, 2].map(|k| camera_from_board[(k, axis)]);
        let columns = by_x.iter().zip(by_y).zip(by_z);
        columns.map(|((by_x, by_y), by_z)| x * by_x + y * by_y + z * by_z).collect()
    })
}

/// Products of the derivatives by the displacement of each point along the board's axes.
pub(super) struct PointProducts {
    /// Of two axes, summed over the views: one value per point.
    squares: [Vec<f64>; 6],
    /// Of each axis with the lens's parameters and the residual, summed over the views: points ×
    /// columns.
    global: [DMatrix<f64>; 3],
    /// Of each axis with the pose and the motion of each view, view after view.
    local: [DMatrix<f64>; 3],
    /// Columns per view: six of the pose, or twelve with the motion.
    of_view: usize,
    room: Vec<f64>,
}

/// One view, linearized.
pub(super) struct SeenPoints<'a> {
    /// As [`by_board_axes`] returns them.
    pub(super) by: [Vec<f64>; 3],
    /// The columns of the lens, of the pose, and the residual.
    pub(super) plain: &'a [f64],
    /// The index of each corner's point.
    pub(super) point_of: &'a [usize],
    /// For rotation and translation: the time at which each corner is read, in the unit of that
    /// motion.
    pub(super) times: [&'a [f64]; 2],
}

impl PointProducts {
    pub(super) fn none(points: usize, lens: usize, (views, moves): (usize, bool)) -> Self {
        let of_view = if moves { 12 } else { 6 };
        let zeros = |columns: usize| [(); 3].map(|()| DMatrix::zeros(points, columns));
        Self {
            squares: [(); 6].map(|()| vec![0.0; points]),
            global: zeros(lens + 1),
            local: zeros(of_view * views),
            of_view,
            room: Vec::new(),
        }
    }

    /// Adds the view with this `number` in the order of the views.
    pub(super) fn add(&mut self, number: usize, seen: &SeenPoints<'_>) {
        Arch::new().dispatch(Addition { products: self, number, seen });
    }

    /// Per point: the gradient by its own x and y, and the diagonal of their information.
    pub(super) fn point_offset_scores(&self) -> Vec<[f64; 4]> {
        let residual = self.global[0].ncols() - 1;
        let [x, y] = [0, 1].map(|axis| self.global[axis].column(residual));
        (0..x.len()).map(|p| [x[p], y[p], self.squares[0][p], self.squares[3][p]]).collect()
    }

    /// Adds the shape's part to the lower triangle of the global equations, and to their gradient.
    pub(super) fn add_to(
        &self,
        basis: &BoardBasis,
        global: &mut DMatrix<f64>,
        gradient: &mut DVector<f64>,
    ) {
        let by_shape = by_shape(basis, &self.global);
        let (lens, shape) = (by_shape.ncols() - 1, by_shape.nrows());
        global.view_mut((lens, 0), (shape, lens)).copy_from(&by_shape.columns(0, lens));
        gradient.rows_mut(lens, shape).copy_from(&by_shape.column(lens));
        self.add_squares(basis, lens, global);
    }

    /// The coupling of the shape with pose and motion of each view, view after view: shape ×
    /// columns.
    pub(super) fn coupling(&self, basis: &BoardBasis) -> DMatrix<f64> {
        by_shape(basis, &self.local)
    }

    fn square(&self, a: usize, b: usize) -> &[f64] {
        &self.squares[PAIR_OF[a][b]]
    }

    fn add_squares(&self, basis: &BoardBasis, first: usize, global: &mut DMatrix<f64>) {
        // Products of a displacement of each point along each axis with every function that extends
        // over all points.
        let (heights, smooth) = (basis.heights.len(), basis.smooth_len());
        let mut moved = [(); 3].map(|()| DMatrix::zeros(basis.points.len(), smooth));
        for (axis, moved) in moved.iter_mut().enumerate() {
            for (mut column, (_, height)) in moved.column_iter_mut().zip(&basis.heights) {
                let with_z = height.iter().zip(self.square(axis, 2));
                column.iter_mut().zip(with_z).for_each(|(to, (h, square))| *to = h * square);
            }
            let stretches = moved.columns_mut(heights, smooth - heights);
            for (mut column, stretch) in { stretches }.column_iter_mut().zip(&basis.stretches) {
                let squares = self.square(axis, 0).iter().zip(self.square(axis, 1));
                for (to, ([x, y], (with_x, with_y))) in
                    column.iter_mut().zip(stretch.iter().zip(squares))
                {
                    *to = x * with_x + y * with_y;
                }
            }
        }
        let of_smooth = by_shape(basis, &moved);
        let rows = basis.len();
        global.view_mut((first, first), (rows, smooth)).copy_from(&of_smooth);
        let own = first + smooth;
        for point in 0..if basis.has_point_offsets { basis.points.len() } else { 0 } {
            let at = own + 2 * point;
            global[(at, at)] = self.squares[0][point];
            global[(at + 1, at)] = self.squares[1][point];
            global[(at + 1, at + 1)] = self.squares[3][point];
        }
    }
}

/// Sums over the points, weighted by each function of the shape: (points × columns) per axis
/// becomes shape × columns.
fn by_shape(basis: &BoardBasis, of: &[DMatrix<f64>; 3]) -> DMatrix<f64> {
    let (heights, smooth, count) = (basis.heights.len(), basis.smooth_len(), of[0].ncols());
    let points = basis.points.len();
    let mut sums = DMatrix::zeros(basis.len(), count);
    if heights > 0 {
        let values = DMatrix::from_fn(heights, points, |k, p| basis.heights[k].1[p]);
        sums.rows_mut(0, heights).gemm(1.0, &values, &of[2], 0.0);
    }
    for column in 0..count {
        let [x, y] = [0, 1].map(|axis| &of[axis].as_slice()[column * points..][..points]);
        let sums = &mut sums.as_mut_slice()[column * basis.len()..][..basis.len()];
        for (sum, stretch) in sums[heights..smooth].iter_mut().zip(&basis.stretches) {
            *sum = stretch.iter().zip(x.iter().zip(y)).map(|([a, b], (x, y))| a * x + b * y).sum();
        }
        for (own, (x, y)) in sums[smooth..].chunks_exact_mut(2).zip(x.iter().zip(y)) {
            (own[0], own[1]) = (*x, *y);
        }
    }
    sums
}

struct Addition<'a, 'b> {
    products: &'a mut PointProducts,
    number: usize,
    seen: &'a SeenPoints<'b>,
}

impl WithSimd for Addition<'_, '_> {
    type Output = ();

    /// The loops are plain: compiled in here, they use the machine's widest vectors.
    #[inline(always)]
    fn with_simd<S: Simd>(self, _: S) {
        let Self { products, number, seen } = self;
        let PointProducts { squares, global, local, of_view, room } = products;
        let (rows, lens) = (seen.by[0].len(), global[0].ncols() - 1);
        let first = number * *of_view;
        room.resize(rows / 2, 0.0);
        for (square, (a, b)) in squares.iter_mut().zip(PAIRS) {
            multiply(&seen.by[a], &seen.by[b], room);
            add(square, room, seen.point_of);
        }
        for ((by, global), local) in seen.by.iter().zip(global).zip(local) {
            let points = global.nrows();
            let (global, local) = (global.as_mut_slice(), local.as_mut_slice());
            let add_to = |to: &mut [f64], column: usize, room: &[f64]| {
                add(&mut to[column * points..][..points], room, seen.point_of);
            };
            for (k, column) in seen.plain.chunks_exact(rows).enumerate() {
                multiply(by, column, room);
                if k < lens {
                    add_to(global, k, room);
                } else if k == lens + 6 {
                    add_to(global, lens, room);
                } else {
                    add_to(local, first + k - lens, room);
                    if *of_view > 6 {
                        let times = seen.times[(k - lens) / 3];
                        room.iter_mut().zip(times).for_each(|(value, time)| *value *= time);
                        add_to(local, first + 6 + k - lens, room);
                    }
                }
            }
        }
    }
}

/// For each corner, the product of two columns.
#[inline(always)]
fn multiply(a: &[f64], b: &[f64], products: &mut [f64]) {
    let half = products.len();
    let ((a, a_y), (b, b_y)) = (a.split_at(half), b.split_at(half));
    for (k, product) in products.iter_mut().enumerate() {
        *product = a[k] * b[k] + a_y[k] * b_y[k];
    }
}

/// Adds each corner's value to that of its point.
#[inline(always)]
fn add(to: &mut [f64], of_corners: &[f64], point_of: &[usize]) {
    for (point, value) in point_of.iter().zip(of_corners) {
        to[*point] += value;
    }
}
