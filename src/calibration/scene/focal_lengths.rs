//! Whether the images, by what they show, have one focal length. They do not if they are from two
//! cameras, if the zoom was moved, or if the autofocus followed the scene.

use nalgebra::{DVector, RowDVector};

use crate::calibration::scene::fitted_lens::LensFit;
use crate::estimation::scene::bundle::Bundle;
use crate::estimation::scene::focal_by_image::{FocalByImage, separate_focals};
use crate::estimation::scene::reconstruction::Reconstruction;
use crate::geometry::lens::Lens;

/// Images whose focal length differs from the others'.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct OtherFocals {
    /// The smaller group of images, as indices of poses.
    pub poses: Vec<usize>,
    /// Their focal length over that of the other group.
    pub ratio: f64,
    /// The relative standard deviation of the focal lengths of all images.
    pub relative_std: f64,
}

/// The least relative difference of focal lengths that counts: focusing alone changes that of a
/// lens by as much.
const LEAST_DIFFERENCE: f64 = 0.005;

/// The two groups of images whose focal lengths differ most, if the difference is significant. Uses
/// all observations of `start`: those of images with another focal length are outliers to the
/// common lens, and `fit` may have dropped them.
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
    let splits = (1..count).filter_map(|split| ImageGroups::of(&found, &order[split..]));
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

/// The critical value for the square of a difference in standard deviations, given that the best
/// split of the images, with `freedom` degrees of freedom, was taken. That square is at most a
/// chi-square variable, which exceeds its mean by four standard deviations and ten less than once
/// in ten thousand.
fn no_chance(freedom: usize) -> f64 {
    let freedom = freedom as f64;
    freedom + 4.0 * (2.0 * freedom).sqrt() + 10.0
}

/// Two groups of images.
struct ImageGroups {
    larger: Vec<usize>,
    log_ratio: f64,
    variance: f64,
}

impl ImageGroups {
    /// The contrast of the images in `larger` to all others, by generalized least squares.
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

/// Adds to the covariance of `fit` the scatter of the images' focal lengths.
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

/// The reason for the verdict; `name` names the image of a pose.
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
