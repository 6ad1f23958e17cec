//! Predicts a crossing from the nearest known ones by a local homography from the lattice to the
//! image. As it is fitted to these alone, it follows the lens's distortion.

use nalgebra::Matrix3;

use crate::detection::coded::homography_equations::HomographyEquations;
use crate::detection::coded::sheet::Sheets;
use crate::detection::grid::Grid;
use crate::detection::grid::perspective::LEAST_W;
use crate::detection::vec2::Vec2;

/// Radii around a place within which crossings are gathered for a local homography, in grid lines,
/// tried in this order. Chosen, not swept.
const REACHES: [i32; 3] = [2, 4, FARTHEST];
/// The largest of them: crossings farther away do not affect a chart.
pub(super) const FARTHEST: i32 = 9;
/// Crossings at which gathering stops: twice the four that determine a homography.
const ENOUGH_CROSSINGS: usize = 8;
/// Weight of the prior that there is no perspective, relative to one crossing: a few crossings with
/// a noise of 2 % of their spread weigh less.
const FLATNESS: f64 = 0.004;

/// A homography from lattice to image, near one place.
#[derive(Debug, Clone, Copy)]
pub(super) struct Chart {
    h: [f64; 8],
    middle: [f64; 2],
    spread: f64,
    mean: [f64; 2],
    scale: f64,
    /// The number of lines within which crossings were gathered for it.
    pub reach: i32,
}

/// The contribution of a column or a row to the three homogeneous coordinates.
#[derive(Debug, Clone, Copy)]
pub(super) struct ChartLine([f64; 3]);

/// A crossing: its place in the lattice, its pixel, and its weight.
#[derive(Debug, Clone, Copy)]
pub(super) struct ChartPair {
    pub place: [f64; 2],
    pub pixel: [f64; 2],
    pub weight: f64,
}

/// A struct, not a closure: all of it must be inlined to be compiled for the processor.
struct ChartFit<'a> {
    pairs: &'a [ChartPair],
}

impl pulp::NullaryFnOnce for ChartFit<'_> {
    type Output = Option<Chart>;

    #[inline(always)]
    fn call(self) -> Option<Chart> {
        let Self { pairs } = self;
        let (mut total, mut middle, mut mean) = (0.0, [0.0; 2], [0.0; 2]);
        for pair in pairs {
            total += pair.weight;
            for k in 0..2 {
                middle[k] += pair.weight * pair.place[k];
                mean[k] += pair.weight * pair.pixel[k];
            }
        }
        let (middle, mean) = (middle.map(|v| v / total), mean.map(|v| v / total));
        let (mut spread, mut scale) = (0.0, 0.0);
        for pair in pairs {
            spread += pair.weight * squared_distance(pair.place, middle);
            scale += pair.weight * squared_distance(pair.pixel, mean);
        }
        let [spread, scale] = [spread, scale].map(|sum: f64| (sum / total).sqrt().max(1e-6));
        let mut equations = HomographyEquations::flat(FLATNESS * total);
        for pair in pairs {
            let place = [0, 1].map(|k| (pair.place[k] - middle[k]) / spread);
            let pixel = [0, 1].map(|k| (pair.pixel[k] - mean[k]) / scale);
            equations.take(place, pixel, pair.weight);
        }
        let h = equations.solve()?;
        Some(Chart { h, middle, spread, mean, scale, reach: 0 })
    }
}

#[inline(always)]
fn squared_distance([x, y]: [f64; 2], [to_x, to_y]: [f64; 2]) -> f64 {
    (x - to_x).powi(2) + (y - to_y).powi(2)
}

impl Chart {
    /// Fits a homography to `pairs`; `None` for fewer than three, or where they do not span a
    /// plane.
    pub(super) fn fit(pairs: &[ChartPair]) -> Option<Self> {
        if pairs.len() < 3 { None } else { pulp::Arch::new().dispatch(ChartFit { pairs }) }
    }

    /// Fits a homography to the crossings of `grid` nearest to the crossing (i, j), except for the
    /// crossing `without`.
    pub(super) fn near(
        grid: &Grid,
        sheets: &Sheets,
        (i, j): (i32, i32),
        without: Option<(i32, i32)>,
        pairs: &mut Vec<ChartPair>,
    ) -> Option<Self> {
        let at = [sheets.line(i), sheets.line(j)];
        let mut lines = [[0.0; 2 * FARTHEST as usize + 1]; 2];
        let mut inner = -1;
        pairs.clear();
        for reach in REACHES {
            for off in (-reach..=reach).filter(|off| off.abs() > inner) {
                let slot = (FARTHEST + off) as usize;
                (lines[0][slot], lines[1][slot]) = (sheets.line(i + off), sheets.line(j + off));
            }
            for dj in -reach..=reach {
                let dy = lines[1][(FARTHEST + dj) as usize] - at[1];
                for (k, pixel) in grid.pixels_on_line(j + dj, (i - reach, i + reach)) {
                    let di = k - i;
                    let is_new = di.abs() > inner || dj.abs() > inner;
                    if !is_new || Some((k, j + dj)) == without {
                        continue;
                    }
                    let place =
                        [lines[0][(FARTHEST + di) as usize], lines[1][(FARTHEST + dj) as usize]];
                    let away = (place[0] - at[0]).powi(2) + dy.powi(2);
                    pairs.push(ChartPair {
                        place: place.map(f64::from),
                        pixel: [f64::from(pixel.x), f64::from(pixel.y)],
                        weight: 1.0 / (0.5 + f64::from(away)),
                    });
                }
            }
            inner = reach;
            if pairs.len() >= ENOUGH_CROSSINGS {
                break;
            }
        }
        Some(Self { reach: inner, ..Self::fit(pairs)? })
    }

    /// The pixel of the place (x, y); `None` behind the camera.
    pub(super) fn at(&self, x: f32, y: f32) -> Option<Vec2> {
        self.at_crossing(self.column(x), self.row(y))
    }

    /// The part of the projection that all places with this x share.
    #[inline(always)]
    pub(super) fn column(&self, x: f32) -> ChartLine {
        let i = (f64::from(x) - self.middle[0]) / self.spread;
        let h = &self.h;
        ChartLine([h[0] * i, h[3] * i, 1.0 + h[6] * i])
    }

    /// The part of the projection that all places with this y share.
    #[inline(always)]
    pub(super) fn row(&self, y: f32) -> ChartLine {
        let j = (f64::from(y) - self.middle[1]) / self.spread;
        let h = &self.h;
        ChartLine([h[1] * j, h[4] * j, h[7] * j])
    }

    /// The pixel of the place where a column and a row cross; `None` behind the camera.
    #[inline(always)]
    pub(super) fn at_crossing(&self, column: ChartLine, row: ChartLine) -> Option<Vec2> {
        let (ChartLine([u, v, w]), ChartLine([du, dv, dw])) = (column, row);
        let (h, w) = (&self.h, w + dw);
        (w > LEAST_W).then(|| {
            let u = (u + du + h[2]) / w * self.scale + self.mean[0];
            let v = (v + dv + h[5]) / w * self.scale + self.mean[1];
            Vec2::new(u as f32, v as f32)
        })
    }

    /// The same as a matrix, from the lattice to the image.
    pub(super) fn matrix(&self) -> Matrix3<f64> {
        let h = &self.h;
        let (k, [mi, mj]) = (1.0 / self.spread, self.middle);
        let centered = Matrix3::new(k, 0.0, -k * mi, 0.0, k, -k * mj, 0.0, 0.0, 1.0);
        let (s, [x, y]) = (self.scale, self.mean);
        let placed = Matrix3::new(s, 0.0, x, 0.0, s, y, 0.0, 0.0, 1.0);
        placed * Matrix3::new(h[0], h[1], h[2], h[3], h[4], h[5], h[6], h[7], 1.0) * centered
    }

    /// One unit of the lattice along each axis, at the place (x, y), in pixels.
    pub(super) fn steps(&self, x: f32, y: f32) -> Option<[Vec2; 2]> {
        // Half the interval over which the slope is taken, in units of the lattice.
        const HALF: f32 = 0.1;
        let step = |dx: f32, dy: f32| {
            Some((self.at(x + dx, y + dy)? - self.at(x - dx, y - dy)?) / (2.0 * HALF))
        };
        Some([step(HALF, 0.0)?, step(0.0, HALF)?])
    }
}
