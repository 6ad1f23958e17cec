//! Extrema of the difference of Gaussians, to a fraction of a pixel (Lowe 2004, sections 3 and 4).

use nalgebra::{Matrix3, Vector3};

use crate::features::plane::Plane;
use crate::features::scale_space::{Octave, SCALES, sigma};

/// The least absolute difference of Gaussians at an extremum, for luma from 0 to 1 and [`SCALES`]
/// scales per octave: half of OpenCV's 0.04 / SCALES, as in VLFeat and COLMAP.
const LEAST_CONTRAST: f32 = 0.02 / SCALES as f32;

/// The largest ratio of principal curvatures; a larger one is an edge (Lowe 2004, section 4.1).
const EDGE_RATIO: f64 = 10.0;

/// Steps of the quadratic fit after which an extremum counts as unstable.
const MAX_STEPS: usize = 5;

/// Extrema this close to the border lack a neighborhood.
const BORDER_PX: usize = 5;

/// An extremum in an octave's own pixels.
#[derive(Debug, Clone, Copy)]
pub(super) struct Extremum {
    pub x: f64,
    pub y: f64,
    /// The index of the plane with its blur, fractional.
    pub level: f64,
    pub contrast: f64,
}

impl Extremum {
    /// Its blur in the octave's pixels.
    pub fn sigma(&self) -> f64 {
        sigma(self.level)
    }
}

/// The extrema of one octave, by scale and then row by row.
pub(super) fn extrema(octave: &Octave) -> Vec<Extremum> {
    let candidates = pulp::Arch::new().dispatch(Scan { planes: &octave.gaussians });
    let candidates = candidates.iter().flatten();
    candidates.filter_map(|at| refined(&octave.gaussians, *at)).collect()
}

/// Number of pixels that are tested together.
const LANES: usize = 16;

/// The differences of neighboring planes in three rows: that of `planes[level]` in row `y` is
/// `[level][y % 3]`, with [`LANES`] additional values at the end.
type DifferenceRows = Vec<[Vec<f32>; 3]>;

struct Scan<'a> {
    planes: &'a [Plane],
}

impl pulp::NullaryFnOnce for Scan<'_> {
    /// By level: x, y, level of the pixels that are above or below all their neighbors.
    type Output = [Vec<[usize; 3]>; SCALES];

    #[inline(always)]
    fn call(self) -> Self::Output {
        let (width, height) = (self.planes[0].width, self.planes[0].height);
        let mut found: Self::Output = Default::default();
        let mut rows: DifferenceRows =
            vec![std::array::from_fn(|_| vec![0.0; width + LANES]); self.planes.len() - 1];
        for below in (BORDER_PX - 1)..(height + 1).saturating_sub(BORDER_PX) {
            for (planes, rows) in self.planes.windows(2).zip(&mut rows) {
                let pairs = planes[1].row(below).iter().zip(planes[0].row(below));
                for (value, (wide, narrow)) in rows[below % 3].iter_mut().zip(pairs) {
                    *value = wide - narrow;
                }
            }
            let y = below - 1;
            if y < BORDER_PX {
                continue;
            }
            for (level, found) in (1..).zip(&mut found) {
                scan_row(&rows, [y, level], width.saturating_sub(BORDER_PX), found);
            }
        }
        found
    }
}

#[inline(always)]
fn scan_row(
    rows: &DifferenceRows,
    [y, level]: [usize; 2],
    end: usize,
    found: &mut Vec<[usize; 3]>,
) {
    let of = |level: usize, y: usize, x: usize| -> &[f32; LANES] {
        rows[level][y % 3][x..].first_chunk().unwrap_or(&[0.0; LANES])
    };
    for start in (BORDER_PX..end).step_by(LANES) {
        // Most pixels are neither above nor below their nearest neighbors.
        let values = of(level, y, start);
        let nearest = [
            of(level, y, start - 1),
            of(level, y, start + 1),
            of(level, y - 1, start),
            of(level, y + 1, start),
            of(level - 1, y, start),
            of(level + 1, y, start),
        ];
        let mut any = [false; LANES];
        for k in 0..LANES {
            let (mut high, mut low) = (nearest[0][k], nearest[0][k]);
            for other in &nearest[1..] {
                high = if other[k] > high { other[k] } else { high };
                low = if other[k] < low { other[k] } else { low };
            }
            any[k] = (values[k] >= high) | (values[k] <= low);
        }
        for (x, any) in (start..end).zip(any) {
            if any && is_extremum(rows, [x, y, level]) {
                found.push([x, y, level]);
            }
        }
    }
}

#[inline(always)]
fn is_extremum(rows: &DifferenceRows, [x, y, level]: [usize; 3]) -> bool {
    let value = rows[level][y % 3][x];
    if value.abs() < 0.8 * LEAST_CONTRAST {
        return false;
    }
    // Bright and dark extrema are treated alike: the sign is removed before comparing.
    let sign = value.signum();
    let value = value * sign;
    rows[level - 1..=level + 1].iter().all(|rows| {
        // All three rows, in whichever order they are.
        rows.iter().all(|row| row[x - 1..=x + 1].iter().all(|other| other * sign <= value))
    })
}

/// Lowe 2004, equations 2 and 3: the extremum of the quadratic through the neighbors; `None` where
/// it does not converge, has little contrast, or is an edge.
fn refined(planes: &[Plane], at: [usize; 3]) -> Option<Extremum> {
    let [mut x, mut y, mut level] = at;
    for _ in 0..MAX_STEPS {
        let d = |dx: i64, dy: i64, dl: i64| {
            let at = |a: usize, b: i64| (a as i64 + b) as usize;
            let (x, y, level) = (at(x, dx), at(y, dy), at(level, dl));
            f64::from(planes[level + 1].at(x, y) - planes[level].at(x, y))
        };
        let center = d(0, 0, 0);
        let gradient = 0.5
            * Vector3::new(
                d(1, 0, 0) - d(-1, 0, 0),
                d(0, 1, 0) - d(0, -1, 0),
                d(0, 0, 1) - d(0, 0, -1),
            );
        let xx = d(1, 0, 0) + d(-1, 0, 0) - 2.0 * center;
        let yy = d(0, 1, 0) + d(0, -1, 0) - 2.0 * center;
        let ll = d(0, 0, 1) + d(0, 0, -1) - 2.0 * center;
        let xy = 0.25 * (d(1, 1, 0) + d(-1, -1, 0) - d(-1, 1, 0) - d(1, -1, 0));
        let xl = 0.25 * (d(1, 0, 1) + d(-1, 0, -1) - d(-1, 0, 1) - d(1, 0, -1));
        let yl = 0.25 * (d(0, 1, 1) + d(0, -1, -1) - d(0, -1, 1) - d(0, 1, -1));
        let hessian = Matrix3::new(xx, xy, xl, xy, yy, yl, xl, yl, ll);
        let offset = -(hessian.try_inverse()? * gradient);
        if offset.amax() <= 0.6 {
            let contrast = (center + 0.5 * gradient.dot(&offset)).abs();
            let (trace, determinant) = (xx + yy, xx * yy - xy * xy);
            let is_edge = trace * trace * EDGE_RATIO >= (EDGE_RATIO + 1.0).powi(2) * determinant;
            let kept = contrast >= f64::from(LEAST_CONTRAST) && determinant > 0.0 && !is_edge;
            return kept.then(|| Extremum {
                x: x as f64 + offset.x,
                y: y as f64 + offset.y,
                level: level as f64 + offset.z,
                contrast,
            });
        }
        let step = offset.map(|o| {
            if o > 0.6 {
                1
            } else if o < -0.6 {
                -1
            } else {
                0_i64
            }
        });
        let moved = |at: usize, by: i64, low: usize, high: usize| {
            let to = at as i64 + by;
            (to >= low as i64 && to <= high as i64).then_some(to as usize)
        };
        x = moved(x, step.x, BORDER_PX, planes[0].width - 1 - BORDER_PX)?;
        y = moved(y, step.y, BORDER_PX, planes[0].height - 1 - BORDER_PX)?;
        level = moved(level, step.z, 1, SCALES)?;
    }
    None
}
