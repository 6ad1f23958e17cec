//! Maps pixels to places of the lattice, near one crossing: by the homography of the crossings
//! around it, plus a quadratic form for the lens's distortion.
//!
//! A homography alone is off by 0.1 px and more at the lines next to a crossing if a lens distorts
//! by a few percent: too much where blur makes each line affect the position of the next.

use std::collections::HashSet;

use nalgebra::{Matrix2, Matrix3, SMatrix, SVector, Vector2, Vector3};

use crate::detection::coded::chart::{Chart, ChartPair};
use crate::detection::coded::sheet::Sheets;
use crate::detection::grid::Grid;
use crate::detection::vec2::Vec2;

/// The number of lines within which crossings are gathered: four standard deviations of their
/// weight if lines are equally spaced.
const REACH: i32 = 4;
/// Terms of a quadratic form of two coordinates.
const TERMS: usize = 6;
/// The least number of crossings for a quadratic form: twice its terms.
const ENOUGH_PAIRS: usize = 2 * TERMS;

/// The number of Newton steps: each leaves the square of the previous error. And the pixels over
/// which the chart's slope is taken: the chart is linear over half a pixel.
const STEPS: usize = 3;
const HALF_PX: f64 = 0.5;

/// The map from the image to the lattice, near one crossing.
#[derive(Debug, Clone)]
pub(super) struct CurvedChart {
    lattice_from_image: Matrix3<f64>,
    origin: [f64; 2],
    scale: f64,
    /// The factors of the quadratic form that is added to the homography's place.
    added: SMatrix<f64, TERMS, 2>,
}

impl CurvedChart {
    /// Fits a chart to the crossings of `grid` around the one at (i, j) that are `known`, or to all
    /// if those are too few. The weights fall as a Gaussian with the distance.
    pub(super) fn near(
        grid: &Grid,
        sheets: &Sheets,
        (i, j): (i32, i32),
        known: &HashSet<(i32, i32)>,
        pairs: &mut Vec<ChartPair>,
    ) -> Option<Self> {
        let at = |p: Vec2| [f64::from(p.x), f64::from(p.y)];
        let origin = grid.pixel(i, j).map(at)?;
        gather(grid, sheets, (i, j), pairs, |at| known.contains(&at));
        if pairs.len() < ENOUGH_PAIRS {
            gather(grid, sheets, (i, j), pairs, |_| true);
        }
        let lattice_from_image = Chart::fit(pairs)?.matrix().try_inverse()?;
        let away = pairs.iter().map(|pair| {
            pair.weight
                * ((pair.pixel[0] - origin[0]).powi(2) + (pair.pixel[1] - origin[1]).powi(2))
        });
        let total: f64 = pairs.iter().map(|pair| pair.weight).sum();
        let scale = (away.sum::<f64>() / total).sqrt().max(1.0);
        let mut chart =
            Self { lattice_from_image, origin, scale, added: SMatrix::<f64, TERMS, 2>::zeros() };
        if pairs.len() >= ENOUGH_PAIRS {
            chart.added = chart.fitted_to(pairs).unwrap_or_default();
        }
        Some(chart)
    }

    /// The place of a pixel in the lattice.
    pub(super) fn place(&self, pixel: [f64; 2]) -> [f64; 2] {
        let flat = self.flat(pixel);
        let added = self.added.tr_mul(&self.terms(pixel));
        [flat[0] + added[0], flat[1] + added[1]]
    }

    /// The pixel of a place near the crossing, by Newton's method; `None` where it ends far from
    /// the crossing.
    pub(super) fn pixel(&self, place: [f64; 2]) -> Option<[f64; 2]> {
        let mut pixel = self.origin;
        for _ in 0..STEPS {
            let [x, y] = self.place(pixel);
            let step = |k: usize| {
                let mut beside = pixel;
                beside[k] += HALF_PX;
                let [right, below] = self.place(beside);
                [(right - x) / HALF_PX, (below - y) / HALF_PX]
            };
            let ([a, c], [b, d]) = (step(0), step(1));
            let off = Vector2::new(place[0] - x, place[1] - y);
            let moved = Matrix2::new(a, b, c, d).try_inverse()? * off;
            pixel = [pixel[0] + moved.x, pixel[1] + moved.y];
        }
        let away = (pixel[0] - self.origin[0]).hypot(pixel[1] - self.origin[1]);
        (away < self.scale).then_some(pixel)
    }

    fn flat(&self, [x, y]: [f64; 2]) -> [f64; 2] {
        let place = self.lattice_from_image * Vector3::new(x, y, 1.0);
        [place.x / place.z, place.y / place.z]
    }

    fn terms(&self, pixel: [f64; 2]) -> SVector<f64, TERMS> {
        let [x, y] = [0, 1].map(|k| (pixel[k] - self.origin[k]) / self.scale);
        SVector::from([1.0, x, y, x * x, x * y, y * y])
    }

    /// The factors of the terms, by least squares from the homography's residuals at `pairs`.
    fn fitted_to(&self, pairs: &[ChartPair]) -> Option<SMatrix<f64, TERMS, 2>> {
        let mut normal = SMatrix::<f64, TERMS, TERMS>::zeros();
        let mut right = SMatrix::<f64, TERMS, 2>::zeros();
        for pair in pairs {
            let terms = self.terms(pair.pixel);
            let flat = self.flat(pair.pixel);
            let left = SVector::<f64, 2>::new(pair.place[0] - flat[0], pair.place[1] - flat[1]);
            normal += pair.weight * terms * terms.transpose();
            right += pair.weight * terms * left.transpose();
        }
        Some(normal.cholesky()?.solve(&right))
    }
}
/// Gathers the crossings of `grid` around the one at (i, j) that are `wanted`.
fn gather(
    grid: &Grid,
    sheets: &Sheets,
    (i, j): (i32, i32),
    pairs: &mut Vec<ChartPair>,
    wanted: impl Fn((i32, i32)) -> bool,
) {
    let at = |p: Vec2| [f64::from(p.x), f64::from(p.y)];
    let [x, y] = [sheets.line(i), sheets.line(j)];
    // The mean interval between lines.
    let spread = (sheets.widths[0] + sheets.widths[1]) / 2.0;
    pairs.clear();
    for dj in -REACH..=REACH {
        for di in -REACH..=REACH {
            let here = (i + di, j + dj);
            let Some(pixel) = grid.pixel(here.0, here.1).filter(|_| wanted(here)) else {
                continue;
            };
            let place = [sheets.line(i + di), sheets.line(j + dj)];
            let away = [place[0] - x, place[1] - y].map(|v| f64::from(v / spread));
            let weight = (-0.5 * (away[0] * away[0] + away[1] * away[1])).exp();
            pairs.push(ChartPair { place: place.map(f64::from), pixel: at(pixel), weight });
        }
    }
}
