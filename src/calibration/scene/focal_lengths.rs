//! Whether images are by one focal length, by what they show: two cameras, a zoom that was moved,
//! or a focus that follows what is near.

use nalgebra::{DVector, RowDVector};

use crate::calibration::scene::fitted_lens::LensFit;
use crate::estimation::scene::bundle::Bundle;
use crate::estimation::scene::focal_by_image::{FocalByImage, separate_focals};
use crate::estimation::scene::reconstruction::Reconstruction;
use crate::geometry::lens::Lens;

/// Images that have another focal length than the others.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct OtherFocals {
    /// The fewer ones, by pose.
    pub poses: Vec<usize>,
    /// Their focal length over that of the others.
    pub ratio: f64,
    /// The standard deviation of the focal lengths of all images, as a part of them.
    pub relative_std: f64,
}

/// Less of a difference, as a part of the focal length, is nothing to act on: the image of a lens
/// changes as much with where it is focused.
const LEAST_DIFFERENCE: f64 = 0.005;

/// The two groups of images that differ most, where that is no chance. All observations of `start`
/// are asked: those of images by another focal length are wrong beside the others', and `fit` may
/// have dropped them.
pub(super) fn other_focals(start: &Reconstruction, fit: &LensFit) -> Option<OtherFocals> {
    let bundle = Bundle { free: fit.fit.bundle.free.clone(), ..start.bundle.clone() };
    let mut state = start.state.clone();
    state.lens = fit.fit.state.lens;
    let found = separate_focals(&bundle, &state)?;
    let count = found.log_ratios.len();
    if count < 3 {
        return None;
    }
    let mut order: Vec<usize> = (0..count).collect();
    order.sort_by(|a, b| found.log_ratios[*a].total_cmp(&found.log_ratios[*b]));
    let splits = (1..count).filter_map(|split| Contrast::of(&found, &order[split..]));
    let best = splits.max_by(|a, b| a.square().total_cmp(&b.square()))?;
    if best.square() <= no_chance(count - 1) || best.log_ratio.abs() < LEAST_DIFFERENCE {
        return None;
    }
    let mean = found.log_ratios.mean();
    let relative_std = found.log_ratios.map(|v| (v - mean).powi(2)).mean().sqrt();
    let (poses, log_ratio) = if 2 * best.larger.len() <= count {
        (best.larger, best.log_ratio)
    } else {
        let smaller = order.into_iter().filter(|k| !best.larger.contains(k)).collect();
        (smaller, -best.log_ratio)
    };
    Some(OtherFocals { poses, ratio: log_ratio.exp(), relative_std })
}

/// A square of a difference, in standard deviations, that is no chance where the best of all splits
/// of images with `freedom` differences was taken: it is at most the sum of the squares of as many
/// normal deviates, which exceeds its mean by four standard deviations and ten less than once in
/// ten thousand.
fn no_chance(freedom: usize) -> f64 {
    let freedom = freedom as f64;
    freedom + 4.0 * (2.0 * freedom).sqrt() + 10.0
}

/// Two groups of images.
struct Contrast {
    larger: Vec<usize>,
    log_ratio: f64,
    variance: f64,
}

impl Contrast {
    /// Of the images in `larger` to all others, by generalized least squares.
    fn of(found: &FocalByImage, larger: &[usize]) -> Option<Self> {
        let count = found.log_ratios.len();
        let weights = found.covariance.clone().cholesky()?;
        let is_in = DVector::from_fn(count, |k, _| if larger.contains(&k) { 1.0 } else { 0.0 });
        let terms = nalgebra::DMatrix::from_columns(&[DVector::from_element(count, 1.0), is_in]);
        let weighted = weights.solve(&terms);
        let inverse = (terms.transpose() * &weighted).try_inverse()?;
        let right: RowDVector<f64> = found.log_ratios.transpose() * &weighted;
        let solution = &inverse * right.transpose();
        Some(Self { larger: larger.to_vec(), log_ratio: solution[1], variance: inverse[(1, 1)] })
    }

    fn square(&self) -> f64 {
        self.log_ratio * self.log_ratio / self.variance
    }
}

/// Adds to the covariance of `fit` that its focal length is one of several.
pub(super) fn widen(fit: &mut LensFit, others: &OtherFocals) {
    let matrix = fit.fit.state.lens.matrix;
    let focal = |parameter: usize| match parameter {
        Lens::FX => matrix.fx,
        Lens::FY => matrix.fy,
        _ => 0.0,
    };
    let free = &fit.fit.bundle.free;
    let off =
        DVector::from_iterator(free.len(), free.iter().map(|k| focal(*k) * others.relative_std));
    fit.covariance.matrix += &off * off.transpose();
}

/// What to say of it; `name` names the image of a pose.
pub(super) fn reason(others: &OtherFocals, name: impl Fn(usize) -> String) -> String {
    const NAMED: usize = 4;
    let mut poses = others.poses.clone();
    poses.sort_unstable();
    let mut names: Vec<String> =
        poses.iter().take(NAMED).map(|pose| format!("`{}`", name(*pose))).collect();
    if poses.len() > NAMED {
        names.push(format!("{} more", poses.len() - NAMED));
    }
    let percent = 100.0 * (others.ratio - 1.0);
    format!(
        "images differ in focal length: {} by {percent:+.1} % from the others: give images of one camera with one setting of zoom and focus",
        names.join(", ")
    )
}
