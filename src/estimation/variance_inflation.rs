//! Whether the corners of a view err together. The covariance of a least-squares estimate takes
//! every corner's error for its own; where something moves a whole view's corners (a moving board
//! under a rolling shutter, a picture of a bent board, a lens that the model cannot follow), views
//! differ by more than their corners' scatter explains, and so do estimates from other views.
//!
//! Each view (of a rig: what all sensors saw at one frame set) pulls the parameters by its score s =
//! g − C H⁻¹ h (its pose eliminated), whose covariance is A, its part of the information, if
//! corners err by themselves. How much greater the scores are is the factor on the covariance: a
//! scalar form of the clustered covariance of K.-Y. Liang and S. L. Zeger, *Longitudinal data
//! analysis using generalized linear models*, 1986, which with few views would itself be too
//! uncertain.

use std::ops::Range;

use nalgebra::{DMatrix, DVector};

use crate::estimation::camera_fit::CameraFit;
use crate::estimation::joint::apart::together;
use crate::estimation::joint::minimize::Minimum;

/// Fewer frame sets tell nothing of how they differ.
const MIN_FRAME_SETS: usize = 5;

/// A factor within this many standard deviations of 1 is chance.
const CHANCE: f64 = 4.0;

/// The factor on the variance of the parameters in `block`, 1 or more; `unit` is the covariance of
/// all parameters for residuals of unit variance.
pub(crate) fn variance_inflation(fit: &CameraFit, unit: &DMatrix<f64>, block: Range<usize>) -> f64 {
    factor(fit, unit, block).filter(|factor| factor.is_finite()).unwrap_or(1.0)
}

/// `None` where nothing tells of it, or chance would explain it.
fn factor(fit: &CameraFit, unit: &DMatrix<f64>, block: Range<usize>) -> Option<f64> {
    let frame_sets = fit.some_frame_sets();
    if frame_sets.len() < MIN_FRAME_SETS || block.is_empty() {
        return None;
    }
    let Minimum { state, equations, .. } = &fit.robust.minimum;
    let pulls = Pulls::on(block, unit)?;
    let (mut seen, mut expected, mut variance) = (0.0, 0.0, 0.0);
    for observations in frame_sets {
        let parts = observations.iter().map(|observation| (*observation, 0));
        let alone = together(&equations.apart, (&fit.layout, state), &fit.observations, (parts, 1));
        let (information, score) = alone.reduced(0)?;
        let (part, taken_up) = pulls.expected(&information);
        seen += pulls.seen(&score);
        expected += part.trace() - taken_up;
        variance += 2.0 * part.dot(&part.transpose());
    }
    let factor = seen / (fit.noise_square() * expected);
    (factor > 1.0 + CHANCE * variance.sqrt() / expected).then_some(factor)
}

/// What the scores of frame sets do to the parameters of a block, in units of the block's own
/// covariance.
struct Pulls<'a> {
    unit: &'a DMatrix<f64>,
    /// The block's rows of `unit` and the inverse of its own part; `None` where the block is all of
    /// it.
    block: Option<(DMatrix<f64>, DMatrix<f64>)>,
}

impl<'a> Pulls<'a> {
    fn on(block: Range<usize>, unit: &'a DMatrix<f64>) -> Option<Self> {
        if block.len() == unit.nrows() {
            return Some(Self { unit, block: None });
        }
        let own = unit.view((block.start, block.start), (block.len(), block.len())).into_owned();
        Some(Self {
            unit,
            block: Some((
                unit.rows(block.start, block.len()).into_owned(),
                own.cholesky()?.inverse(),
            )),
        })
    }

    /// The square of the pull of one score.
    fn seen(&self, score: &DVector<f64>) -> f64 {
        match &self.block {
            None => score.dot(&(self.unit * score)),
            Some((rows, own)) => {
                let pull = rows * score;
                pull.dot(&(own * &pull))
            }
        }
    }

    /// The covariance of the pull that a frame set with this information has if corners err by
    /// themselves, and how much of that the estimate took up, which is gone.
    fn expected(&self, information: &DMatrix<f64>) -> (DMatrix<f64>, f64) {
        match &self.block {
            None => {
                let part = information * self.unit;
                let taken_up = part.dot(&part.transpose());
                (part, taken_up)
            }
            Some((rows, own)) => {
                let carried = rows * information;
                let part = own * (&carried * rows.transpose());
                (part, (own * (&carried * self.unit * carried.transpose())).trace())
            }
        }
    }
}
