//! Integrals of a print over rectangles, by a summed-area table (F. C. Crow: Summed-area tables for
//! texture mapping, 1984).
//!
//! The table's nodes are on the print's own edges. Between them the print is constant, so
//! interpolation in the table is exact.

/// Buckets per node, by which the node before a position is found.
const BUCKETS: usize = 2;

/// A print of brightness −1 and 1.
#[derive(Debug)]
pub(super) struct PrintIntegral {
    across: EdgeLines,
    down: EdgeLines,
    /// The integral from the first node on both axes to each node, row by row.
    sums: Vec<f64>,
    /// The brightness beyond the outermost nodes.
    paper: f64,
}

/// The positions of edges along one axis.
#[derive(Debug)]
struct EdgeLines {
    /// In increasing order.
    nodes: Vec<f64>,
    /// For equal parts of the range between the outermost nodes: the last node before each.
    buckets: Vec<u32>,
    buckets_a_unit: f64,
}

impl PrintIntegral {
    /// The integral of a print with edges on the lines `across` and `down` (two or more each, in
    /// increasing order) that is bright where `is_bright` is true; beyond the outermost lines its
    /// brightness is `paper`.
    pub(super) fn new(
        [across, down]: [Vec<f64>; 2],
        paper: f64,
        is_bright: impl Fn(f64, f64) -> bool,
    ) -> Self {
        let wide = across.len();
        let mut sums = vec![0.0; wide * down.len()];
        for (row, ends) in down.windows(2).enumerate() {
            let mut along = 0.0;
            for (col, sides) in across.windows(2).enumerate() {
                let area = (sides[1] - sides[0]) * (ends[1] - ends[0]);
                let bright = is_bright((sides[0] + sides[1]) / 2.0, (ends[0] + ends[1]) / 2.0);
                along += if bright { area } else { -area };
                sums[(row + 1) * wide + col + 1] = sums[row * wide + col + 1] + along;
            }
        }
        Self { across: EdgeLines::new(across), down: EdgeLines::new(down), sums, paper }
    }

    /// The mean over the rectangle that extends `half` to each side of `at`.
    pub(super) fn mean(&self, at: [f64; 2], half: [f64; 2]) -> f64 {
        let (left, right) = (self.across.find(at[0] - half[0]), self.across.find(at[0] + half[0]));
        let (above, below) = (self.down.find(at[1] - half[1]), self.down.find(at[1] + half[1]));
        let inside =
            self.integral(right, below) - self.integral(left, below) - self.integral(right, above)
                + self.integral(left, above);
        let area_inside = (right.at - left.at) * (below.at - above.at);
        let area = 4.0 * half[0] * half[1];
        (inside + self.paper * (area - area_inside)) / area
    }

    fn integral(&self, x: Between, y: Between) -> f64 {
        let wide = self.across.nodes.len();
        let first = &self.sums[y.node * wide + x.node..];
        let second = &self.sums[(y.node + 1) * wide + x.node..];
        let along = |row: &[f64]| row[0] + x.part * (row[1] - row[0]);
        let [upper, lower] = [along(first), along(second)];
        upper + y.part * (lower - upper)
    }
}

/// A position between a node and the next one.
#[derive(Debug, Clone, Copy)]
struct Between {
    node: usize,
    part: f64,
    at: f64,
}

impl EdgeLines {
    fn new(nodes: Vec<f64>) -> Self {
        let parts = BUCKETS * nodes.len();
        let (first, last) = (nodes[0], nodes[nodes.len() - 1]);
        let buckets_a_unit = parts as f64 / (last - first);
        let mut node = 0;
        let buckets = (0..=parts)
            .map(|bucket| {
                let start = first + bucket as f64 / buckets_a_unit;
                while node + 2 < nodes.len() && nodes[node + 1] <= start {
                    node += 1;
                }
                node as u32
            })
            .collect();
        Self { nodes, buckets, buckets_a_unit }
    }

    /// The interval that contains `place`; outside, the nearest end.
    fn find(&self, place: f64) -> Between {
        let nodes = &self.nodes;
        let at = place.clamp(nodes[0], nodes[nodes.len() - 1]);
        let bucket = ((at - nodes[0]) * self.buckets_a_unit) as usize;
        let mut node = self.buckets[bucket.min(self.buckets.len() - 1)] as usize;
        while node > 0 && nodes[node] > at {
            node -= 1;
        }
        while node + 2 < nodes.len() && nodes[node + 1] <= at {
            node += 1;
        }
        let part = (at - nodes[node]) / (nodes[node + 1] - nodes[node]);
        Between { node, part, at }
    }
}

#[cfg(test)]
mod tests {
    use super::PrintIntegral;

    /// Columns of different widths, of which every other one is bright, and one dark row.
    fn print() -> PrintIntegral {
        let across = vec![-1.0, -0.7, 0.1, 0.2, 2.0];
        let down = vec![0.0, 0.5, 1.5];
        PrintIntegral::new([across, down], 1.0, |x, y| {
            y > 0.5 && ((-0.7..0.1).contains(&x) || x > 0.2)
        })
    }

    /// A million points in the rectangle, by the print's own definition.
    fn mean_of_points([x, y]: [f64; 2], [half_x, half_y]: [f64; 2]) -> f64 {
        let side = 1000;
        let part = |k: usize| (2 * k + 1) as f64 / side as f64 - 1.0;
        let bright = |px: f64, py: f64| {
            let paper = !(-1.0..2.0).contains(&px) || !(0.0..1.5).contains(&py);
            paper || (py > 0.5 && ((-0.7..0.1).contains(&px) || px > 0.2))
        };
        let points = (0..side).flat_map(|i| (0..side).map(move |j| (i, j)));
        let sum: f64 = points
            .map(
                |(i, j)| {
                    if bright(x + half_x * part(i), y + half_y * part(j)) { 1.0 } else { -1.0 }
                },
            )
            .sum();
        sum / (side * side) as f64
    }

    #[test]
    fn means_are_those_of_the_print_wherever_the_rectangle_lies() {
        let print = print();
        for at in [[0.15, 0.5], [-0.9, 0.1], [1.9, 1.4], [0.3, 0.7], [-1.4, -0.4], [5.0, 5.0]] {
            for half in [[0.013, 0.021], [0.4, 0.3], [2.5, 1.7]] {
                let expected = mean_of_points(at, half);
                let found = print.mean(at, half);
                assert!((found - expected).abs() < 5e-3, "{at:?} {half:?}: {found} {expected}");
            }
        }
    }

    #[test]
    fn a_rectangle_within_one_part_of_the_print_has_its_brightness() {
        let print = print();
        assert!((print.mean([-0.3, 1.0], [0.01, 0.01]) - 1.0).abs() < 1e-9);
        assert!((print.mean([0.15, 1.0], [0.01, 0.01]) + 1.0).abs() < 1e-9);
        assert!((print.mean([9.0, 0.2], [0.01, 0.01]) - 1.0).abs() < 1e-9);
    }
}
