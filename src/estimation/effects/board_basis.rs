//! The shapes a board can have, as functions on its points: polynomials of degree 2 and more out of
//! the plane, an aspect and a shear in the plane, and an offset of each single point. Each function
//! is scaled to a root mean square of 1 over the points, so that every coefficient is in meters.
//!
//! The first two kinds exclude rigid motion and a common scale: the mean scale of the board is the
//! stated one.

use nalgebra::Point3;

use crate::estimation::joint::BoardObservation;

/// The highest degree of the polynomials out of the plane. Of a surface that is smooth over a third
/// of the board, they leave less than a hundredth unexplained.
pub(super) const MAX_DEGREE: usize = 9;

/// The highest degree in a test of whether the board has a shape at all, and in the first steps of
/// a search for it.
const ROUGH_DEGREE: usize = 5;

/// With up to this many points, each has its own offset. Two unknowns per point make the equations
/// dense, and the time grows with the cube: at 15 views 140 points double the time of the solve,
/// 300 take six times as long. With more points only the smooth shape is estimated.
const MAX_OWN: usize = 150;

/// A polynomial is dropped where less than this part of its square remains after projection onto
/// those before it: the points do not determine it.
const LEAST_REST_PART: f64 = 1e-4;

/// The largest number of distinct points times views. Beyond it, the points cannot be those of one
/// board, and memory would not suffice: products of the shape with each view's pose and motion take
/// 288 bytes each. 100 by 100 corners in 100 views, or 54 in 18,000, reach it.
const MOST_PRODUCTS: usize = 1_000_000;

/// Points closer than this part of the board's extent are the same point.
const SAME_POINT: f64 = 1e-5;

/// Points further from their plane than this part of the board's extent are not those of a flat
/// board.
const LARGEST_HEIGHT: f64 = 0.05;

/// The distinct points of a flat board, and the functions on them.
#[derive(Debug, Clone)]
pub(crate) struct BoardBasis {
    /// Relative to the problem's center, in meters.
    pub(crate) points: Vec<Point3<f64>>,
    /// For each observation, the index of each corner's point.
    pub(crate) point_of: Vec<Vec<usize>>,
    /// Half the extent along x and y, in meters.
    pub(crate) half_extent: [f64; 2],
    /// Out of the plane: group, and the value at each point. The three polynomials of degree 2
    /// (curvature along x, twist, curvature along y) are a group each; above that, all of one
    /// degree are a group.
    pub(super) heights: Vec<(usize, Vec<f64>)>,
    /// In the plane: aspect and shear, as (x, y) at each point.
    pub(super) stretches: Vec<Vec<[f64; 2]>>,
    /// Whether each point has an offset of its own.
    pub(super) has_point_offsets: bool,
}

impl BoardBasis {
    /// Half the board's diagonal, in meters: the lever arm that converts a rotation to meters.
    pub(super) fn lever(&self) -> f64 {
        self.half_extent[0].hypot(self.half_extent[1])
    }

    /// With all degrees if `in_detail`, and offsets of single points unless there are many;
    /// otherwise with the few functions that suffice to test whether there is a shape at all, or to
    /// start a search for it. `None` where the points do not lie near one plane z = const, are too
    /// few, or are more than the views of one board can have.
    pub(crate) fn of(observations: &[BoardObservation], in_detail: bool) -> Option<Self> {
        let all = || observations.iter().flat_map(|observation| &observation.points);
        let half_extent =
            [0, 1].map(|axis| all().map(|p| p[axis].abs()).fold(f64::MIN_POSITIVE, f64::max));
        let cell = SAME_POINT * half_extent[0].max(half_extent[1]);
        let extent = half_extent[0].max(half_extent[1]);
        if all().any(|p| p.z.abs() > LARGEST_HEIGHT * extent) {
            return None;
        }
        let key = |p: &Point3<f64>| [p.x, p.y].map(|v| (v / cell).round() as i64);
        let mut keys: Vec<([i64; 2], Point3<f64>)> = all().map(|p| (key(p), *p)).collect();
        keys.sort_by_key(|(key, _)| *key);
        keys.dedup_by_key(|(key, _)| *key);
        if keys.len().saturating_mul(observations.len()) > MOST_PRODUCTS {
            return None;
        }
        let index = |p: &Point3<f64>| keys.binary_search_by_key(&key(p), |(key, _)| *key).ok();
        let point_of = observations
            .iter()
            .map(|observation| observation.points.iter().map(index).collect::<Option<Vec<_>>>())
            .collect::<Option<Vec<_>>>()?;
        let points: Vec<Point3<f64>> = keys.iter().map(|(_, point)| *point).collect();
        let normalized: Vec<[f64; 2]> =
            points.iter().map(|p| [p.x / half_extent[0], p.y / half_extent[1]]).collect();
        let heights = heights(&normalized, if in_detail { MAX_DEGREE } else { ROUGH_DEGREE });
        let has_point_offsets = in_detail && points.len() <= MAX_OWN;
        let mean_square = |of: &dyn Fn(&Point3<f64>) -> f64| {
            (points.iter().map(|p| of(p).powi(2)).sum::<f64>() / points.len() as f64).sqrt()
        };
        let radius = mean_square(&|p| p.x.hypot(p.y));
        let stretches = vec![
            points.iter().map(|p| [p.x / radius, -p.y / radius]).collect(),
            points.iter().map(|p| [p.y / radius, p.x / radius]).collect(),
        ];
        (!heights.is_empty()).then_some(Self {
            points,
            point_of,
            half_extent,
            heights,
            stretches,
            has_point_offsets,
        })
    }

    /// The groups of heights that the basis contains.
    pub(super) fn height_groups(&self) -> Vec<usize> {
        let mut groups: Vec<usize> = self.heights.iter().map(|(group, _)| *group).collect();
        groups.dedup();
        groups
    }

    /// Number of a shape's coefficients: heights, stretches, then x and y of each point's own
    /// offset.
    pub(crate) fn len(&self) -> usize {
        self.smooth_len() + if self.has_point_offsets { 2 * self.points.len() } else { 0 }
    }

    /// Number of coefficients of the functions that extend over all points.
    pub(super) fn smooth_len(&self) -> usize {
        self.heights.len() + self.stretches.len()
    }

    /// The offset of each point, in meters, for these coefficients of a shape.
    pub(crate) fn offsets(&self, coefficients: &[f64]) -> Vec<nalgebra::Vector3<f64>> {
        let mut offsets = vec![nalgebra::Vector3::zeros(); self.points.len()];
        let (smooth, own) = coefficients.split_at(self.smooth_len());
        let (heights, stretches) = smooth.split_at(self.heights.len());
        for ((_, height), coefficient) in self.heights.iter().zip(heights) {
            offsets.iter_mut().zip(height).for_each(|(o, h)| o.z += coefficient * h);
        }
        for (stretch, coefficient) in self.stretches.iter().zip(stretches) {
            for (offset, [x, y]) in offsets.iter_mut().zip(stretch) {
                offset.x += coefficient * x;
                offset.y += coefficient * y;
            }
        }
        for (offset, own) in offsets.iter_mut().zip(own.chunks_exact(2)) {
            offset.x += own[0];
            offset.y += own[1];
        }
        offsets
    }

    /// Bᵀ o: the inner product of `offsets` with each coefficient's function.
    pub(super) fn projections(&self, offsets: &[nalgebra::Vector3<f64>]) -> Vec<f64> {
        let heights = self
            .heights
            .iter()
            .map(|(_, height)| height.iter().zip(offsets).map(|(h, o)| h * o.z).sum());
        let stretches = self.stretches.iter().map(|stretch| {
            stretch.iter().zip(offsets).map(|([x, y], o)| x * o.x + y * o.y).sum::<f64>()
        });
        let own = offsets.iter().filter(|_| self.has_point_offsets).flat_map(|o| [o.x, o.y]);
        heights.chain(stretches).chain(own).collect()
    }
}

/// Products of Legendre polynomials ordered by total degree, made orthonormal over the points to
/// each other and to constant and linear functions.
fn heights(points: &[[f64; 2]], max_degree: usize) -> Vec<(usize, Vec<f64>)> {
    let mut kept: Vec<(usize, Vec<f64>)> = Vec::new();
    for degree in 0..=max_degree {
        for along_y in 0..=degree {
            let of = |[x, y]: &[f64; 2]| legendre(degree - along_y, *x) * legendre(along_y, *y);
            let mut values: Vec<f64> = points.iter().map(of).collect();
            let before = mean_product(&values, &values);
            for _ in 0..2 {
                for (_, other) in &kept {
                    let part = mean_product(&values, other);
                    values.iter_mut().zip(other).for_each(|(v, o)| *v -= part * o);
                }
            }
            let rest = mean_product(&values, &values);
            if rest > LEAST_REST_PART * before {
                values.iter_mut().for_each(|v| *v /= rest.sqrt());
                kept.push((degree, values));
            }
        }
    }
    kept.retain(|(degree, _)| *degree >= 2);
    for (index, (group, _)) in kept.iter_mut().enumerate() {
        *group = if *group == 2 { index.min(2) } else { *group };
    }
    kept
}

fn mean_product(a: &[f64], b: &[f64]) -> f64 {
    a.iter().zip(b).map(|(a, b)| a * b).sum::<f64>() / a.len().max(1) as f64
}

fn legendre(degree: usize, x: f64) -> f64 {
    let (mut last, mut this) = (0.0, 1.0);
    for k in 0..degree {
        let k = k as f64;
        (last, this) = (this, ((2.0 * k + 1.0) * x * this - k * last) / (k + 1.0));
    }
    this
}
