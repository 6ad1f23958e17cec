//! Consistent labels of a symmetric board over the views of one camera. No image determines which
//! end of such a board comes first, so a view in which the board was rotated may count its corners
//! from another end. For a board exactly as stated this makes no difference. A real board is
//! uneven: its shape, as the other views show it, predicts the residuals of a view under one
//! labeling better than under the others.
//!
//! Residuals are linear in the offsets of the board's corners. What a pose and a motion during the
//! readout explain is projected out of each view, since the residuals of a rolling shutter rotate
//! with the image, not with the board. The shape is the posterior mean of independent Gaussian
//! offsets, with the lens as the views show it under their labels: both are found by alternating
//! between them (block coordinate descent).

mod lattice;
mod lens_equations;
mod residual_field;
mod shape;

use nalgebra::{Matrix3, Vector3};

use crate::estimation::camera_estimate::{CameraEstimate, ViewEstimate};
use crate::estimation::labels_by_shape::lattice::{BoardLattice, least};
use crate::estimation::labels_by_shape::lens_equations::LensEquations;
use crate::estimation::labels_by_shape::residual_field::{CornerField, ResidualField};
use crate::estimation::labels_by_shape::shape::{CornerOffsets, LensVector};
use crate::estimation::measured_board::MeasuredBoard;
use crate::estimation::problem::{BoardView, CameraProblem};
use crate::geometry::pose::Pose;

/// Alternations between the offsets, the poses and the lens. Chosen, not swept.
const ALTERNATIONS: usize = 6;

/// Offsets out of the board's plane may be this many times as large as those in the plane: a board
/// is less flat than its print is exact. Chosen, not swept.
const OUT_OF_PLANE: f64 = 3.0;

/// The largest number of views, evenly spaced, that determine the shape. The labels of the others
/// follow from it.
const MAX_VIEWS: usize = 40;

/// The largest number of views from which the search starts.
const MAX_STARTS: usize = 10;

/// The largest number of passes over the views. Chosen, not swept.
const MAX_PASSES: usize = 8;

/// The largest part of the residuals' squares that a shape may leave in views that it is not fitted
/// to, unless it was measured before. Where other errors are as large as the shape, they decide
/// about labels. Chosen on photographs: pora, whose labels differ, leaves 0.16 to 0.17;
/// photon-lifecam, whose labels do not differ but would be changed, 0.65 and more. Every value
/// between gives the same labels.
const MOST_LEFT: f64 = 0.5;

/// The least logarithm of the likelihood ratio between two labels of a view: four standard
/// deviations, where the errors of four neighboring corners count as one. Of photographs, a sheet
/// of paper that was not rotated (boofcv-sony-chess) reaches 18, rotated boards (pora) 45 and more:
/// every value between gives the same labels.
const LEAST_EVIDENCE: f64 = 4.0 * 0.5 * 4.0 * 4.0;

/// For each view of `problem`, the index into `board_from_labels` of the symmetry to apply: its
/// corners are at `board_from_labels⁻¹ · point_in_board`, as in
/// [`crate::estimation::consistent_labels`]. `board_from_labels` are the rotations that map the
/// board's corners to themselves, the identity first. `estimate` has the lens and the poses about
/// which residuals are linear. With `measured`, labels become those of that board; without, most
/// views keep theirs.
///
/// A view keeps its labels unless the shape predicts it far better under others, and a shape that
/// is estimated from these views is the largest of all errors.
pub fn labels_by_shape(
    problem: &CameraProblem,
    estimate: &CameraEstimate,
    board_from_labels: &[Pose],
    measured: Option<&MeasuredBoard>,
) -> Vec<usize> {
    let as_they_are = vec![0; problem.views.len()];
    let lattice = BoardLattice::of(problem, board_from_labels);
    let field = |(index, (view, posed)): (usize, (&BoardView, &ViewEstimate))| {
        ResidualField::of(index, view, posed, estimate, &lattice)
    };
    let views = problem.views.iter().zip(&estimate.views).enumerate();
    let fields: Vec<ResidualField> = views.filter_map(field).collect();
    let good: Vec<&ResidualField> =
        fields.iter().filter(|field| estimate.views[field.view].fault.is_none()).collect();
    let step = good.len().div_ceil(MAX_VIEWS).max(1);
    let search = LabelSearch::new(&lattice, good.into_iter().step_by(step).collect());
    let shape = match measured {
        Some(board) => Some(CornerOffsets::of(lattice.offsets_of(board))),
        None => search.shape(),
    };
    let Some(shape) = shape else { return as_they_are };
    let misfits: Vec<Vec<f64>> =
        fields.iter().map(|field| field.misfits(&lattice, &shape)).collect();
    let kept = match measured {
        Some(_) => 0,
        None => lattice.most_frequent(misfits.iter().map(|misfits| least(misfits))),
    };
    let mut labels = as_they_are;
    for (field, misfits) in fields.iter().zip(misfits) {
        let best = least(&misfits);
        let evidence = 0.5 * field.freedom() * (misfits[kept] / misfits[best]).ln();
        if evidence > LEAST_EVIDENCE {
            labels[field.view] = lattice.relative(best, kept);
        }
    }
    labels
}

/// The search for labels under which the views agree on a shape.
struct LabelSearch<'a> {
    lattice: &'a BoardLattice,
    fields: Vec<&'a ResidualField>,
    /// 1 over the variances of an offset, in units of the residuals' variance.
    prior: Matrix3<f64>,
    /// Of the lens, from all views; `None` where they do not determine its parameters.
    lens: Option<LensEquations>,
}

impl<'a> LabelSearch<'a> {
    /// The prior takes all residuals as offsets in the board's plane.
    fn new(lattice: &'a BoardLattice, fields: Vec<&'a ResidualField>) -> Self {
        let corners = || fields.iter().flat_map(|field| &field.corners);
        let in_plane = |corner: &CornerField| corner.by_offset.fixed_columns::<2>(0).norm_squared();
        let inverse = corners().map(in_plane).sum::<f64>() / (2 * corners().count().max(1)) as f64;
        let out_of_plane = inverse / (OUT_OF_PLANE * OUT_OF_PLANE);
        let prior = Matrix3::from_diagonal(&Vector3::new(inverse, inverse, out_of_plane));
        let lens = LensEquations::of(&fields);
        Self { lattice, fields, prior, lens }
    }

    /// The shape under the labels that agree on it best; `None` where it leaves too much.
    fn shape(&self) -> Option<CornerOffsets> {
        let flat: f64 = self.fields.iter().map(|field| field.square()).sum();
        let step = self.fields.len().div_ceil(MAX_STARTS).max(1);
        let starts = (0..self.fields.len()).step_by(step).map(|first| self.started_from(first));
        let as_they_are = std::iter::once(vec![0; self.fields.len()]);
        let found = as_they_are.chain(starts).map(|labels| self.improved(labels));
        let (predicted, labels) = found.min_by(|a, b| a.0.total_cmp(&b.0))?;
        (predicted < MOST_LEFT * flat).then(|| self.fit(&self.all(&labels)))
    }

    /// The labels under which the shape that one view shows explains each of the others best.
    fn started_from(&self, first: usize) -> Vec<usize> {
        let own = self.fit(&[(self.fields[first], 0)]);
        let label = |field: &&ResidualField| least(&field.misfits(self.lattice, &own));
        let mut labels: Vec<usize> = self.fields.iter().map(label).collect();
        labels[first] = 0;
        labels
    }

    /// Gives each view the label under which the others predict it best, until no label changes.
    /// Returns the least sum of squares that was predicted, with its labels.
    fn improved(&self, start: Vec<usize>) -> (f64, Vec<usize>) {
        let mut labels = start;
        let mut best = (f64::INFINITY, labels.clone());
        for _ in 0..MAX_PASSES {
            let predicted = self.predict(&labels);
            let misfit = predicted.misfit(&labels);
            if misfit < best.0 {
                best = (misfit, labels.clone());
            }
            let next: Vec<usize> = predicted.misfits.iter().map(|of| least(of)).collect();
            if next == labels {
                break;
            }
            labels = next;
        }
        best
    }

    /// Predicts each view by the shape that the others show under `labels`.
    fn predict(&self, labels: &[usize]) -> ViewPrediction {
        let views = self.all(labels);
        let shape = self.fit(&views);
        let gradient = self.gradient(&views, &shape);
        let of_view = |(field, label): &(&ResidualField, usize)| {
            let symmetry = &self.lattice.symmetries[*label];
            let mut of_others = shape.clone();
            let left = field.left(symmetry, &shape);
            for (seen, left) in field.corners.iter().zip(left) {
                let corner = symmetry.corner[seen.corner];
                let by_offset = seen.by_offset * symmetry.rotation;
                let weight = shape.weights[corner] - by_offset.tr_mul(&by_offset);
                let gradient = gradient[corner] - by_offset.tr_mul(&left);
                of_others.offsets[corner] += weight.try_inverse().unwrap_or_default() * gradient;
            }
            field.misfits(self.lattice, &of_others)
        };
        ViewPrediction { misfits: views.iter().map(of_view).collect() }
    }

    /// The posterior mean of the offsets from `views` with their labels.
    fn fit(&self, views: &[(&ResidualField, usize)]) -> CornerOffsets {
        let corners = self.lattice.points.len();
        let mut weights = vec![self.prior; corners];
        for (field, label) in views {
            let symmetry = &self.lattice.symmetries[*label];
            for seen in &field.corners {
                let by_offset = seen.by_offset * symmetry.rotation;
                weights[symmetry.corner[seen.corner]] += by_offset.tr_mul(&by_offset);
            }
        }
        let inverses: Vec<Matrix3<f64>> =
            weights.iter().map(|weight| weight.try_inverse().unwrap_or_default()).collect();
        let mut shape =
            CornerOffsets { weights, ..CornerOffsets::of(vec![Vector3::zeros(); corners]) };
        for _ in 0..ALTERNATIONS {
            let gradient = self.gradient(views, &shape);
            for ((offset, inverse), gradient) in
                shape.offsets.iter_mut().zip(&inverses).zip(gradient)
            {
                *offset += inverse * gradient;
            }
            // A single view determines no lens.
            if let Some(lens) = self.lens.as_ref().filter(|_| views.len() == self.fields.len()) {
                shape.lens += lens.step(&self.lens_gradient(views, &shape));
            }
        }
        shape
    }

    /// The gradient of the logarithm of the posterior by the offsets, with the poses and motions of
    /// `views` at their best.
    fn gradient(
        &self,
        views: &[(&ResidualField, usize)],
        shape: &CornerOffsets,
    ) -> Vec<Vector3<f64>> {
        let mut gradient: Vec<Vector3<f64>> =
            shape.offsets.iter().map(|offset| -self.prior * offset).collect();
        for (field, label) in views {
            let symmetry = &self.lattice.symmetries[*label];
            for (seen, left) in field.corners.iter().zip(field.left(symmetry, shape)) {
                let by_offset = seen.by_offset * symmetry.rotation;
                gradient[symmetry.corner[seen.corner]] += by_offset.tr_mul(&left);
            }
        }
        gradient
    }

    /// The same by the parameters of the lens.
    fn lens_gradient(
        &self,
        views: &[(&ResidualField, usize)],
        shape: &CornerOffsets,
    ) -> LensVector {
        let of_view = |(field, label): &(&ResidualField, usize)| {
            let left = field.left(&self.lattice.symmetries[*label], shape);
            let corners = field.corners.iter().zip(left);
            corners.map(|(seen, left)| seen.by_lens.tr_mul(&left)).sum::<LensVector>()
        };
        views.iter().map(of_view).sum()
    }

    fn all(&self, labels: &[usize]) -> Vec<(&'a ResidualField, usize)> {
        self.fields.iter().copied().zip(labels.iter().copied()).collect()
    }
}

/// What remains of each view under the shape that the others show, by label.
struct ViewPrediction {
    misfits: Vec<Vec<f64>>,
}

impl ViewPrediction {
    fn misfit(&self, labels: &[usize]) -> f64 {
        self.misfits.iter().zip(labels).map(|(misfits, label)| misfits[*label]).sum()
    }
}

#[cfg(test)]
mod tests;
