//! The board's print: the light that a small patch of it reflects, as an exact area integral.

use crate::geometry::board::Chessboard;

/// A chessboard on white card.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct BoardPattern {
    /// Its corners and squares.
    pub board: Chessboard,
    /// Width of the white rim around the outer squares, in squares.
    pub rim_squares: f64,
    /// Reflectance of the white, 0 to 1.
    pub white: f64,
    /// Reflectance of the black, 0 to 1.
    pub black: f64,
}

/// The integral over a patch.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Shade {
    /// Light reflected by the part of the patch that lies on the board, per area of the whole
    /// patch.
    pub light: f64,
    /// The part of the patch that lies on the board, 0 to 1.
    pub coverage: f64,
}

/// A convex polygon of at most 8 vertices: a quadrilateral clipped by four lines.
#[derive(Debug, Clone, Copy)]
struct Polygon {
    vertices: [[f64; 2]; 8],
    length: usize,
}

impl BoardPattern {
    /// The pattern of `board` with a rim of 0.7 squares, white 0.8 and black 0.05.
    pub fn new(board: Chessboard) -> Self {
        Self { board, rim_squares: 0.7, white: 0.8, black: 0.05 }
    }

    /// Left, right, top and bottom edge of the card, in squares from the first inner corner.
    pub fn edges_in_squares(&self) -> [f64; 4] {
        let low = -1.0 - self.rim_squares;
        [
            low,
            f64::from(self.board.size.cols) + self.rim_squares,
            low,
            f64::from(self.board.size.rows) + self.rim_squares,
        ]
    }

    /// The light reflected by the convex quadrilateral `patch`, whose vertices are in squares from
    /// the first inner corner, and the part of it that lies on the board: the pattern's integral
    /// over its area, exact to rounding.
    pub fn shade(&self, patch: &[[f64; 2]; 4]) -> Shade {
        let [mut low, mut high] = [patch[0], patch[0]];
        for vertex in &patch[1..] {
            for axis in 0..2 {
                low[axis] = low[axis].min(vertex[axis]);
                high[axis] = high[axis].max(vertex[axis]);
            }
        }
        let [left, right, top, bottom] = self.edges_in_squares();
        // Written so that NaN, a patch whose rays miss the plane, counts as outside.
        if !(high[0] > left && low[0] < right && high[1] > top && low[1] < bottom) {
            return Shade::default();
        }
        let within = low[0] >= left && high[0] <= right && low[1] >= top && high[1] <= bottom;
        let cell = [low[0].floor(), low[1].floor()];
        if within && high[0] <= cell[0] + 1.0 && high[1] <= cell[1] + 1.0 {
            // The rim's outer edge is inside its cell, so a patch within one cell and within the
            // card has only one shade.
            return Shade {
                light: self.reflectance(cell[0] as i64, cell[1] as i64),
                coverage: 1.0,
            };
        }
        let whole = Polygon { vertices: std::array::from_fn(|i| patch[i.min(3)]), length: 4 };
        self.integral(&whole, low, high)
    }

    /// The shade of a patch that has only one, where its sides may be curved by a tenth of its
    /// size; `None` if it may have several.
    pub(super) fn even_shade(&self, patch: &[[f64; 2]; 4]) -> Option<Shade> {
        let [mut low, mut high] = [patch[0], patch[0]];
        for vertex in &patch[1..] {
            for axis in 0..2 {
                low[axis] = low[axis].min(vertex[axis]);
                high[axis] = high[axis].max(vertex[axis]);
            }
        }
        let [left, right, top, bottom] = self.edges_in_squares();
        let margin = [0.1 * (high[0] - low[0]), 0.1 * (high[1] - low[1])];
        let [low, high] =
            [[low[0] - margin[0], low[1] - margin[1]], [high[0] + margin[0], high[1] + margin[1]]];
        if patch.iter().any(|vertex| vertex[0].is_nan()) {
            // Either all of its rays miss the plane, or only some do.
            return patch.iter().all(|vertex| vertex[0].is_nan()).then(Shade::default);
        }
        if high[0] < left || low[0] > right || high[1] < top || low[1] > bottom {
            return Some(Shade::default());
        }
        let within = low[0] >= left && high[0] <= right && low[1] >= top && high[1] <= bottom;
        let cell = [low[0].floor(), low[1].floor()];
        let alone = within && high[0] <= cell[0] + 1.0 && high[1] <= cell[1] + 1.0;
        alone.then(|| Shade {
            light: self.reflectance(cell[0] as i64, cell[1] as i64),
            coverage: 1.0,
        })
    }

    fn integral(&self, whole: &Polygon, low: [f64; 2], high: [f64; 2]) -> Shade {
        let area = whole.area();
        if !(area > 0.0) {
            return Shade::default();
        }
        let [left, right, top, bottom] = self.edges_in_squares();
        let mut shade = Shade::default();
        for col in low[0].max(left).floor() as i64..high[0].min(right).ceil() as i64 {
            let strip = whole.clipped(0, (col as f64).max(left), (col as f64 + 1.0).min(right));
            for row in low[1].max(top).floor() as i64..high[1].min(bottom).ceil() as i64 {
                let part =
                    strip.clipped(1, (row as f64).max(top), (row as f64 + 1.0).min(bottom)).area()
                        / area;
                shade.coverage += part;
                shade.light += part * self.reflectance(col, row);
            }
        }
        shade
    }

    /// The reflectance of the cell whose first corner is (`col`, `row`): the square outside the
    /// first inner corner, (−1, −1), is dark.
    fn reflectance(&self, col: i64, row: i64) -> f64 {
        let size = self.board.size;
        let square =
            (-1..i64::from(size.cols)).contains(&col) && (-1..i64::from(size.rows)).contains(&row);
        if square && (col + row).rem_euclid(2) == 0 { self.black } else { self.white }
    }
}

impl Polygon {
    fn area(&self) -> f64 {
        let mut twice = 0.0;
        for i in 0..self.length {
            let [a, b] = [self.vertices[i], self.vertices[(i + 1) % self.length]];
            twice += a[0] * b[1] - a[1] * b[0];
        }
        0.5 * twice.abs()
    }

    /// The part where `low` ≤ coordinate `axis` ≤ `high` (Sutherland and Hodgman, CACM 1974).
    fn clipped(&self, axis: usize, low: f64, high: f64) -> Self {
        self.clipped_once(axis, low, 1.0).clipped_once(axis, high, -1.0)
    }

    /// The part where sign · (coordinate − at) ≥ 0.
    fn clipped_once(&self, axis: usize, at: f64, sign: f64) -> Self {
        let mut clipped = Self { vertices: [[0.0; 2]; 8], length: 0 };
        for i in 0..self.length {
            let [a, b] = [self.vertices[i], self.vertices[(i + 1) % self.length]];
            let [da, db] = [sign * (a[axis] - at), sign * (b[axis] - at)];
            if da >= 0.0 {
                clipped.push(a);
            }
            if (da > 0.0 && db < 0.0) || (da < 0.0 && db > 0.0) {
                let t = da / (da - db);
                clipped.push([a[0] + t * (b[0] - a[0]), a[1] + t * (b[1] - a[1])]);
            }
        }
        clipped
    }

    /// Rounding can give a clipped polygon a ninth vertex that repeats the eighth: it adds no area.
    fn push(&mut self, vertex: [f64; 2]) {
        if let Some(slot) = self.vertices.get_mut(self.length) {
            *slot = vertex;
            self.length += 1;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::board::BoardSize;

    fn pattern() -> BoardPattern {
        let board = Chessboard::new(BoardSize::new(9, 6).unwrap(), 0.025).unwrap();
        BoardPattern { white: 1.0, black: 0.0, ..BoardPattern::new(board) }
    }

    fn rotated_square(center: [f64; 2], side: f64, angle: f64) -> [[f64; 2]; 4] {
        let (s, c) = angle.sin_cos();
        let h = 0.5 * side;
        [[-h, -h], [h, -h], [h, h], [-h, h]]
            .map(|[x, y]| [center[0] + c * x - s * y, center[1] + s * x + c * y])
    }

    #[test]
    fn the_square_outside_the_first_corner_is_dark() {
        let shade = |x: f64, y: f64| pattern().shade(&rotated_square([x, y], 0.1, 0.3)).light;
        assert_eq!([shade(-0.5, -0.5), shade(0.5, -0.5), shade(0.5, 0.5)], [0.0, 1.0, 0.0]);
        assert_eq!([shade(-1.3, -0.5), shade(-1.5, 2.5)], [1.0, 1.0]);
    }

    #[test]
    fn integrals_agree_with_dense_sums() {
        let pattern = pattern();
        let n = 400;
        for (center, side, angle) in [
            ([0.1, 0.05], 0.7, 0.4),
            ([3.02, 2.97], 0.2, 1.1),
            ([-1.6, 0.4], 1.3, 0.2),
            ([8.9, 5.8], 2.9, 0.75),
            ([4.0, -1.72], 0.11, 2.0),
        ] {
            let patch = rotated_square(center, side, angle);
            let mut sum = Shade::default();
            for i in 0..n * n {
                let s = ((i % n) as f64 + 0.5) / n as f64 - 0.5;
                let t = ((i / n) as f64 + 0.5) / n as f64 - 0.5;
                let (sin, cos) = angle.sin_cos();
                let [x, y] = [
                    center[0] + side * (cos * s - sin * t),
                    center[1] + side * (sin * s + cos * t),
                ];
                let point = pattern.shade(&rotated_square([x, y], 1e-9, 0.0));
                sum.light += point.light / (n * n) as f64;
                sum.coverage += point.coverage / (n * n) as f64;
            }
            let shade = pattern.shade(&patch);
            assert!((shade.light - sum.light).abs() < 2e-3, "{shade:?} {sum:?} at {center:?}");
            assert!(
                (shade.coverage - sum.coverage).abs() < 2e-3,
                "{shade:?} {sum:?} at {center:?}"
            );
        }
    }

    #[test]
    fn an_edge_through_a_patch_is_exact() {
        let shade = pattern().shade(&[[-0.3, 0.2], [0.7, 0.2], [0.7, 0.8], [-0.3, 0.8]]);
        assert!(
            (shade.light - 0.3).abs() < 1e-12 && (shade.coverage - 1.0).abs() < 1e-12,
            "{shade:?}"
        );
    }

    #[test]
    fn a_patch_that_sees_no_plane_is_empty() {
        assert_eq!(pattern().shade(&[[f64::NAN; 2]; 4]), Shade::default());
        assert_eq!(pattern().shade(&[[0.5; 2]; 4]).coverage, 1.0);
        assert_eq!(
            pattern().shade(&[[0.0, 0.5], [1.5, 0.5], [1.5, 0.5], [0.0, 0.5]]),
            Shade::default()
        );
    }
}
