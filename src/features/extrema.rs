//! Extrema of the difference of Gaussians, to a fraction of a pixel (Lowe 2004, sections 3 and 4).

use nalgebra::{Matrix3, Vector3};

use crate::features::plane::Plane;
use crate::features::scale_space::{Octave, SCALES, sigma};

/// The least absolute difference of Gaussians at an extremum, for luma from 0 to 1 and
/// [`SCALES`] scales an octave: half of Lowe's 0.04 / SCALES, as VLFeat and COLMAP take it.
const LEAST_CONTRAST: f32 = 0.02 / SCALES as f32;

/// The greatest ratio of principal curvatures; more is an edge (Lowe 2004, section 4.1).
const EDGE_RATIO: f64 = 10.0;

/// Steps of the quadratic fit before an extremum counts as unstable.
const MAX_STEPS: usize = 5;

/// Extrema this near to the border have no neighborhood.
const BORDER: usize = 5;

/// An extremum in an octave's own pixels.
#[derive(Debug, Clone, Copy)]
pub(super) struct Extremum {
    pub x: f64,
    pub y: f64,
    /// The plane at whose blur it lies, with a fraction.
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
    let mut found = Vec::new();
    let planes = &octave.differences;
    let (width, height) = (planes[0].width, planes[0].height);
    for level in 1..=SCALES {
        for y in BORDER..height.saturating_sub(BORDER) {
            let row = planes[level].row(y);
            let inner = row.iter().enumerate().take(width.saturating_sub(BORDER)).skip(BORDER);
            for (x, value) in inner {
                if value.abs() < 0.8 * LEAST_CONTRAST || !is_extremum(planes, [x, y, level]) {
                    continue;
                }
                found.extend(refined(planes, [x, y, level]));
            }
        }
    }
    found
}

fn is_extremum(planes: &[Plane], [x, y, level]: [usize; 3]) -> bool {
    let value = planes[level].at(x, y);
    // A bright and a dark extremum alike: compare with the sign taken off.
    let sign = value.signum();
    let value = value * sign;
    [level, level - 1, level + 1].into_iter().all(|plane| {
        (y - 1..=y + 1).all(|row| {
            let around = &planes[plane].row(row)[x - 1..=x + 1];
            around.iter().all(|other| other * sign <= value)
        })
    })
}

/// Lowe 2004, equations 2 and 3: the extremum of the quadratic through the neighbors; `None`
/// where it wanders off, has little contrast, or is an edge.
fn refined(planes: &[Plane], at: [usize; 3]) -> Option<Extremum> {
    let [mut x, mut y, mut level] = at;
    for _ in 0..MAX_STEPS {
        let d = |dx: i64, dy: i64, dl: i64| {
            let at = |a: usize, b: i64| (a as i64 + b) as usize;
            f64::from(planes[at(level, dl)].at(at(x, dx), at(y, dy)))
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
        x = moved(x, step.x, BORDER, planes[0].width - 1 - BORDER)?;
        y = moved(y, step.y, BORDER, planes[0].height - 1 - BORDER)?;
        level = moved(level, step.z, 1, SCALES)?;
    }
    None
}
