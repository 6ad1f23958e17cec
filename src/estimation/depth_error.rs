//! The choice of a correction for a depth camera: polynomials over grids from none to fine,
//! compared by cross-validation.
//!
//! With the board's planes given, the corrected quantity is linear in the coefficients. So one set
//! of normal equations per fold suffices to fit any four of five folds.

use nalgebra::{DMatrix, DVector};

use crate::estimation::interrupt::Interrupt;
use crate::estimation::joint::depth_terms::correction_columns;
use crate::estimation::row_products::SparseRowProducts;
use crate::geometry::depth_camera::DepthTile;
use crate::geometry::depth_correction::{CorrectedQuantity, DepthCorrection, SplineGrid};
use crate::geometry::pixel::ImageSize;

/// A tile, the 1/z of the board's plane there, and the expected scatter between the two.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ComparedTile {
    /// The measurement.
    pub tile: DepthTile,
    /// The plane's 1/z, in 1/m.
    pub plane: f64,
    /// 1 over the standard deviation of the tile's 1/z, in m.
    pub inverse_std: f64,
}

/// The prior that couples coefficients where tiles carry little information.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Smoothness {
    /// One standard deviation of a term's effect on 1/z at the middle of the depths seen, as a part
    /// of 1/z.
    pub amplitude: f64,
    /// The same for the deviation of a node from the straight line through its neighbors.
    pub curvature: f64,
}

/// A correction that was tried.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct TriedCorrection {
    /// The corrected quantity.
    pub quantity: CorrectedQuantity,
    /// Number of powers; 0 for no correction.
    pub terms: usize,
    /// Cells along x and y; 0 for a constant.
    pub cells: [u32; 2],
    /// The smoothness prior.
    pub smoothness: Smoothness,
    /// Root mean square on held-out views of (corrected − plane) / standard deviation.
    pub held_out: f64,
}

/// The result of comparing corrections.
#[derive(Debug, Clone, PartialEq)]
pub struct CorrectionChoice {
    /// The form with the least error on held-out views, not fitted; `None` where none is better
    /// than no correction.
    pub form: Option<DepthCorrection>,
    /// Its smoothness prior.
    pub smoothness: Smoothness,
    /// All corrections that were tried.
    pub tried: Vec<TriedCorrection>,
}

/// The weak prior of a correction, as a part of the normal equations.
pub(crate) struct Prior {
    pub(crate) hessian: DMatrix<f64>,
}

impl Prior {
    /// Of a correction whose terms are scaled to the middle of the depths seen.
    pub(crate) fn of(correction: &DepthCorrection, smoothness: Smoothness) -> Self {
        let count = correction.grid.node_count();
        let mut hessian = DMatrix::zeros(correction.terms * count, correction.terms * count);
        let [across, down] = correction.grid.nodes();
        let middle = (correction.seen_m[0] * correction.seen_m[1]).sqrt();
        for term in 0..correction.terms {
            let unit = match correction.quantity {
                CorrectedQuantity::InverseDepth => middle.powi(term as i32 - 1),
                CorrectedQuantity::Depth => middle.powi(1 - term as i32),
            };
            let ridge = (smoothness.amplitude * unit).powi(-2) / count as f64;
            for node in 0..count {
                hessian[(term * count + node, term * count + node)] += ridge;
            }
            if correction.quantity == CorrectedQuantity::InverseDepth && term >= LINEAR_TERMS {
                let mean = (MEAN_CURVATURE_STD * unit * count as f64).powi(-2);
                for a in 0..count {
                    for b in 0..count {
                        hessian[(term * count + a, term * count + b)] += mean;
                    }
                }
            }
            let curvature = (smoothness.curvature * unit).powi(-2);
            let mut second = |nodes: [usize; 3]| {
                for (a, wa) in nodes.iter().zip([1.0, -2.0, 1.0]) {
                    for (b, wb) in nodes.iter().zip([1.0, -2.0, 1.0]) {
                        hessian[(term * count + a, term * count + b)] += curvature * wa * wb;
                    }
                }
            };
            for j in 0..down {
                for i in 1..across.saturating_sub(1) {
                    second([j * across + i - 1, j * across + i, j * across + i + 1]);
                }
            }
            for i in 0..across {
                for j in 1..down.saturating_sub(1) {
                    second([(j - 1) * across + i, j * across + i, (j + 1) * across + i]);
                }
            }
        }
        Self { hessian }
    }
}

/// Terms from this power on are curvatures. A triangulating sensor measures 1/z up to a scale and
/// an offset, and a curvature common to the whole image acts like a translation of the sensor along
/// its axis (1/(z + t) = 1/z − t/z² …). So the mean curvature has this prior standard deviation, as
/// a part of 1/z at the middle of the depths seen; its variation over the image is free.
const LINEAR_TERMS: usize = 2;
const MEAN_CURVATURE_STD: f64 = 0.002;

/// The number of folds: every fifth view is held out together.
const FOLDS: usize = 5;

/// The least relative improvement by which a correction is preferred to a simpler one.
const LEAST_IMPROVEMENT: f64 = 0.01;

/// Compares corrections on `views` (the tiles of each). `quantities` are those that make sense for
/// the device. Once `interrupt` was requested no more are tried.
pub fn choose_correction(
    views: &[Vec<ComparedTile>],
    size: ImageSize,
    quantities: &[CorrectedQuantity],
    interrupt: &Interrupt,
) -> CorrectionChoice {
    let seen_m = seen(views);
    let mut tried = Vec::new();
    let Some(first) = quantities.first() else {
        return CorrectionChoice { form: None, smoothness: SMOOTH[0], tried };
    };
    let none = TriedCorrection {
        quantity: *first,
        terms: 0,
        cells: [0, 0],
        smoothness: SMOOTH[0],
        held_out: uncorrected(views),
    };
    tried.push(none);
    let mut best = none;
    // The normal equations of a form are the same for every smoothness.
    let attempt =
        |quantity, terms, cells: [u32; 2], smooth: &[Smoothness]| -> Vec<TriedCorrection> {
            if interrupt.is_requested() {
                return Vec::new();
            }
            let grid = SplineGrid { size, cols: cells[0], rows: cells[1] };
            let form = DepthCorrection::none(quantity, terms, grid, seen_m);
            let folds = folds(views, &form);
            let tried = |smoothness: &Smoothness| {
                let held_out = held_out(views, &folds, &form, *smoothness);
                TriedCorrection { quantity, terms, cells, smoothness: *smoothness, held_out }
            };
            smooth.iter().map(tried).collect()
        };
    let mut consider = |candidate: TriedCorrection, best: &mut TriedCorrection| {
        tried.push(candidate);
        if candidate.held_out < best.held_out * (1.0 - LEAST_IMPROVEMENT) {
            *best = candidate;
        }
    };
    for quantity in quantities {
        for terms in 1..=3 {
            for cells in [[0, 0], COARSE] {
                attempt(*quantity, terms, cells, &SMOOTH[..1])
                    .into_iter()
                    .for_each(|one| consider(one, &mut best));
            }
        }
    }
    if best.terms > 0 {
        for cells in FINER {
            attempt(best.quantity, best.terms, cells, &SMOOTH)
                .into_iter()
                .for_each(|one| consider(one, &mut best));
        }
    }
    let grid = SplineGrid { size, cols: best.cells[0], rows: best.cells[1] };
    let chosen = DepthCorrection::none(best.quantity, best.terms, grid, seen_m);
    CorrectionChoice {
        form: (best.terms > 0).then_some(chosen),
        smoothness: best.smoothness,
        tried,
    }
}

const COARSE: [u32; 2] = [4, 3];
const FINER: [[u32; 2]; 3] = [[2, 2], [4, 3], [8, 6]];
const SMOOTH: [Smoothness; 3] = [
    Smoothness { amplitude: 0.2, curvature: 0.01 },
    Smoothness { amplitude: 0.2, curvature: 0.003 },
    Smoothness { amplitude: 0.2, curvature: 0.03 },
];

/// The nearest and the farthest depth of the tiles.
fn seen(views: &[Vec<ComparedTile>]) -> [f64; 2] {
    let depths = || views.iter().flatten().map(|compared| 1.0 / compared.tile.inverse_depth);
    [depths().fold(f64::INFINITY, f64::min), depths().fold(0.0, f64::max)]
}

fn uncorrected(views: &[Vec<ComparedTile>]) -> f64 {
    let squares = |compared: &ComparedTile| {
        ((compared.tile.inverse_depth - compared.plane) * compared.inverse_std).powi(2)
    };
    let count = views.iter().map(Vec::len).sum::<usize>().max(1);
    (views.iter().flatten().map(squares).sum::<f64>() / count as f64).sqrt()
}

/// The normal equations of one group of views.
struct Fold {
    hessian: DMatrix<f64>,
    right: DVector<f64>,
}

/// A tile's residual without correction, and its derivatives by the coefficients: of the corrected
/// quantity, in standard deviations, with the sign of 1/z.
fn rows(
    correction: &DepthCorrection,
    compared: &ComparedTile,
    columns: &mut Vec<(usize, f64)>,
) -> f64 {
    columns.clear();
    correction_columns(correction, &compared.tile, |index, value| {
        columns.push((index, value * compared.inverse_std));
    });
    let measured = compared.tile.inverse_depth;
    let off = match correction.quantity {
        CorrectedQuantity::InverseDepth => measured - compared.plane,
        CorrectedQuantity::Depth => measured * measured * (1.0 / compared.plane - 1.0 / measured),
    };
    off * compared.inverse_std
}

/// Corrected 1/z minus the plane's, in 1/m, where the error of the corrected quantity is `off`
/// standard deviations ([`rows`]).
fn off_plane(quantity: CorrectedQuantity, compared: &ComparedTile, off: f64) -> f64 {
    let off = off / compared.inverse_std;
    match quantity {
        CorrectedQuantity::InverseDepth => off,
        CorrectedQuantity::Depth => {
            let corrected_m = 1.0 / compared.plane - off / compared.tile.inverse_depth.powi(2);
            1.0 / corrected_m - compared.plane
        }
    }
}

fn held_out(
    views: &[Vec<ComparedTile>],
    folds: &[Fold],
    form: &DepthCorrection,
    smoothness: Smoothness,
) -> f64 {
    let Some(residuals) = residuals_of(views, folds, form, smoothness) else {
        return f64::INFINITY;
    };
    let count = residuals.iter().map(Vec::len).sum::<usize>().max(1);
    let of_tile =
        |(compared, residual): (&ComparedTile, &f64)| (compared.inverse_std * residual).powi(2);
    let squares =
        views.iter().zip(&residuals).flat_map(|(view, residuals)| view.iter().zip(residuals));
    (squares.map(of_tile).sum::<f64>() / count as f64).sqrt()
}

/// Corrected 1/z minus the plane's, in 1/m, of every tile, by a correction of this form fitted to
/// other views. `None` where it cannot be fitted.
pub fn held_out_residuals(
    views: &[Vec<ComparedTile>],
    correction: &DepthCorrection,
    smoothness: Smoothness,
) -> Option<Vec<Vec<f64>>> {
    let form = DepthCorrection {
        coefficients: vec![0.0; correction.coefficients.len()],
        ..correction.clone()
    };
    residuals_of(views, &folds(views, &form), &form, smoothness)
}

/// The normal equations of each group of views for an unfitted correction of this form.
fn folds(views: &[Vec<ComparedTile>], form: &DepthCorrection) -> Vec<Fold> {
    let size = form.coefficients.len();
    let mut folds: Vec<Fold> = (0..FOLDS)
        .map(|_| Fold { hessian: DMatrix::zeros(size, size), right: DVector::zeros(size) })
        .collect();
    let mut columns = Vec::new();
    for (view, fold) in views.iter().zip(fold_of_each(views)) {
        let fold = &mut folds[fold];
        let mut products = SparseRowProducts::default();
        for compared in view {
            let residual = rows(form, compared, &mut columns);
            products.push(&columns, &mut fold.hessian);
            columns.iter().for_each(|(column, value)| fold.right[*column] -= value * residual);
        }
        products.add_all(&mut fold.hessian);
    }
    folds.iter_mut().for_each(|fold| fold.hessian.fill_lower_triangle_with_upper_triangle());
    folds
}

/// The fold of each view. Those with depth are assigned in rotation; a view without depth is in the
/// first fold, where it has no effect.
fn fold_of_each(views: &[Vec<ComparedTile>]) -> impl Iterator<Item = usize> + '_ {
    let mut with_depth = 0;
    views.iter().map(move |view| {
        let fold = if view.is_empty() { 0 } else { with_depth % FOLDS };
        with_depth += usize::from(!view.is_empty());
        fold
    })
}

/// The residuals of each view under the fit to the other folds.
fn residuals_of(
    views: &[Vec<ComparedTile>],
    folds: &[Fold],
    form: &DepthCorrection,
    smoothness: Smoothness,
) -> Option<Vec<Vec<f64>>> {
    let (size, mut columns) = (form.coefficients.len(), Vec::new());
    let prior = Prior::of(form, smoothness).hessian;
    let all = folds.iter().fold(prior, |sum, fold| sum + &fold.hessian);
    let all_right =
        folds.iter().fold(DVector::zeros(size), |sum: DVector<f64>, fold| sum + &fold.right);
    let fits: Option<Vec<DVector<f64>>> = folds
        .iter()
        .map(|fold| Some((&all - &fold.hessian).cholesky()?.solve(&(&all_right - &fold.right))))
        .collect();
    let fits = fits?;
    let each = views.iter().zip(fold_of_each(views)).map(|(view, fold)| {
        let coefficients = &fits[fold];
        let residual = |compared: &ComparedTile| {
            let before = rows(form, compared, &mut columns);
            let off = before + columns.iter().map(|(i, d)| d * coefficients[*i]).sum::<f64>();
            off_plane(form.quantity, compared, off)
        };
        view.iter().map(residual).collect()
    });
    Some(each.collect())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::pixel::Pixel;

    /// Ten views of planes from 0.4 to 3 m, all measured 5 cm too far.
    fn too_far() -> Vec<Vec<ComparedTile>> {
        let tile = |view: u32, k: u32| {
            let z = 0.4 + 0.26 * f64::from(view) + 0.01 * f64::from(k);
            let pixel = Pixel::new(f64::from(20 * k), 100.0);
            ComparedTile {
                tile: DepthTile {
                    pixel,
                    inverse_depth: 1.0 / (z + 0.05),
                    reading_std: 0.001,
                    count: 100,
                },
                plane: 1.0 / z,
                inverse_std: z * z / 0.001,
            }
        };
        (0..10).map(|view| (0..20).map(|k| tile(view, k)).collect()).collect()
    }

    #[test]
    fn an_offset_of_depth_is_corrected_whole() {
        let grid = SplineGrid { size: ImageSize::new(640, 480), cols: 0, rows: 0 };
        let views = too_far();
        let form = DepthCorrection::none(CorrectedQuantity::Depth, 1, grid, seen(&views));
        let left = held_out_residuals(&views, &form, SMOOTH[0]).unwrap();
        let left_m =
            |(compared, residual): (&ComparedTile, &f64)| residual / compared.plane.powi(2);
        let worst_m = views
            .iter()
            .flatten()
            .zip(left.iter().flatten())
            .map(left_m)
            .fold(0.0, |worst: f64, m| worst.max(m.abs()));
        assert!(left.iter().map(Vec::len).sum::<usize>() == 200 && worst_m < 1e-5, "{worst_m}");
    }
}
