//! Whether the images, by what they show, are from one camera with one lens setting. Their focal
//! lengths differ if they are from two cameras, if the zoom was moved, or if the autofocus followed
//! the scene; their principal points, if some were rotated by 180 degrees, cropped or stabilized.

use nalgebra::{DMatrix, DVector, Matrix2, Vector2};

use crate::calibration::scene::fitted_lens::LensFit;
use crate::estimation::scene::bundle::Bundle;
use crate::estimation::scene::lens_by_image::{LensByImage, OwnPart, separate_lenses};
use crate::estimation::scene::reconstruction::Reconstruction;
use crate::geometry::lens::Lens;

/// Images whose lens differs from the others'.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct OtherLenses {
    /// The smaller group of images, as indices of poses.
    pub poses: Vec<usize>,
    /// How it differs.
    pub difference: OwnLensDifference,
    /// The square of the difference in standard deviations.
    square: f64,
}

/// How a group of images differs from the others.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum OwnLensDifference {
    /// By its focal length.
    Focal {
        /// The focal length over that of the others.
        ratio: f64,
        /// The relative standard deviation of the focal lengths of all images.
        relative_std: f64,
    },
    /// By its principal point.
    Center {
        /// The principal point less that of the others.
        offset_px: Vector2<f64>,
        /// The covariance of the principal points of all images.
        covariance: Matrix2<f64>,
    },
}

/// The least relative difference of focal lengths that counts: focusing alone changes that of a
/// lens by as much.
const LEAST_FOCAL_DIFFERENCE: f64 = 0.005;

/// The least difference of principal points that counts, over the image's width: that of focal
/// lengths moves the left and right edges by as much.
const LEAST_CENTER_DIFFERENCE: f64 = 0.5 * LEAST_FOCAL_DIFFERENCE;

/// Images whose focal length or principal point, whichever differs more significantly, is not that
/// of the others. Uses all observations of `start`: those of images with another lens are outliers
/// to the common one, and `fit` may have dropped them.
pub(super) fn other_lenses(start: &Reconstruction, fit: &LensFit) -> Option<OtherLenses> {
    let both = [OwnPart::Focal, OwnPart::Center];
    let found = both.into_iter().filter_map(|part| others_by(part, start, fit));
    found.max_by(|a, b| a.square.total_cmp(&b.square))
}

fn others_by(part: OwnPart, start: &Reconstruction, fit: &LensFit) -> Option<OtherLenses> {
    let bundle = Bundle { free: fit.fit.bundle.free.clone(), ..start.bundle.clone() };
    let mut state = start.state.clone();
    state.lens = fit.fit.state.lens;
    let found = separate_lenses(&bundle, &state, part)?;
    let (count, width) = (state.cameras_from_scene.len(), part.width());
    if count < 3 {
        return None;
    }
    let best = best_groups(&found, width)?;
    let least = match part {
        OwnPart::Focal => LEAST_FOCAL_DIFFERENCE,
        OwnPart::Center => LEAST_CENTER_DIFFERENCE * f64::from(bundle.prior.image_size.width),
    };
    if best.square <= no_chance((count - 1) * width) || best.contrast.norm() < least {
        return None;
    }
    let (poses, contrast) = if 2 * best.larger.len() <= count {
        (best.larger, best.contrast)
    } else {
        let smaller = (0..count).filter(|k| !best.larger.contains(k)).collect();
        (smaller, -best.contrast)
    };
    let scatter = scatter(&found.values, width);
    let difference = match part {
        OwnPart::Focal => OwnLensDifference::Focal {
            ratio: contrast[0].exp(),
            relative_std: scatter[(0, 0)].sqrt(),
        },
        OwnPart::Center => OwnLensDifference::Center {
            offset_px: Vector2::new(contrast[0], contrast[1]),
            covariance: scatter.fixed_view::<2, 2>(0, 0).into_owned(),
        },
    };
    Some(OtherLenses { poses, difference, square: best.square })
}

/// The covariance, between images, of their `width` values.
fn scatter(values: &DVector<f64>, width: usize) -> DMatrix<f64> {
    let of_images = DMatrix::from_column_slice(width, values.len() / width, values.as_slice());
    let mean = of_images.column_mean();
    let off =
        DMatrix::from_fn(width, of_images.ncols(), |k, image| of_images[(k, image)] - mean[k]);
    &off * off.transpose() / of_images.ncols() as f64
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
    /// The values of the images in `larger` less those of the others.
    contrast: DVector<f64>,
    /// Its square in standard deviations.
    square: f64,
}

/// The two groups of images that differ most significantly, of those that a line separates: with
/// two values, in one of eight directions.
fn best_groups(found: &LensByImage, width: usize) -> Option<ImageGroups> {
    let count = found.values.len() / width;
    let weights = found.covariance.clone().cholesky()?;
    let directions = if width == 1 { 1 } else { 8 };
    let mut best: Option<ImageGroups> = None;
    for direction in 0..directions {
        let (sin, cos) = (f64::from(direction) * std::f64::consts::PI / 8.0).sin_cos();
        let along = |image: usize| match width {
            1 => found.values[image],
            _ => cos * found.values[2 * image] + sin * found.values[2 * image + 1],
        };
        let mut order: Vec<usize> = (0..count).collect();
        order.sort_by(|a, b| along(*a).total_cmp(&along(*b)));
        for split in 1..count {
            let groups = ImageGroups::of(found, &weights, width, &order[split..]);
            let is_better = |than: &ImageGroups| {
                groups.as_ref().is_some_and(|groups| groups.square > than.square)
            };
            if best.as_ref().is_none_or(is_better) {
                best = groups.or(best);
            }
        }
    }
    best
}

impl ImageGroups {
    /// The contrast of the images in `larger` to all others, by generalized least squares.
    fn of(
        found: &LensByImage,
        weights: &nalgebra::Cholesky<f64, nalgebra::Dyn>,
        width: usize,
        larger: &[usize],
    ) -> Option<Self> {
        let terms = DMatrix::from_fn(found.values.len(), 2 * width, |row, term| {
            let (image, k) = (row / width, row % width);
            let is_of_group = term < width || larger.contains(&image);
            if term % width == k && is_of_group { 1.0 } else { 0.0 }
        });
        let weighted = weights.solve(&terms);
        let inverse = (terms.transpose() * &weighted).try_inverse()?;
        let solution = &inverse * (weighted.transpose() * &found.values);
        let contrast = solution.rows(width, width).into_owned();
        let covariance = inverse.view((width, width), (width, width)).into_owned();
        let square = contrast.dot(&covariance.cholesky()?.solve(&contrast));
        Some(Self { larger: larger.to_vec(), contrast, square })
    }
}

/// Adds to the covariance of `fit` the scatter of the images' lenses.
pub(super) fn widen(fit: &mut LensFit, others: &OtherLenses) {
    let matrix = fit.fit.state.lens.matrix;
    let free = &fit.fit.bundle.free;
    let between = |a: usize, b: usize| match (others.difference, a, b) {
        (OwnLensDifference::Focal { relative_std, .. }, a, b) => {
            let focal = |parameter: usize| match parameter {
                Lens::FX => matrix.fx,
                Lens::FY => matrix.fy,
                _ => 0.0,
            };
            focal(a) * focal(b) * relative_std.powi(2)
        }
        (OwnLensDifference::Center { covariance, .. }, a, b) => {
            let axis = |parameter: usize| [Lens::CX, Lens::CY].iter().position(|k| *k == parameter);
            axis(a).zip(axis(b)).map_or(0.0, |(a, b)| covariance[(a, b)])
        }
    };
    let added = DMatrix::from_fn(free.len(), free.len(), |a, b| between(free[a], free[b]));
    fit.covariance.matrix += added;
}

/// The reason for the verdict; `name` names the image of a pose.
pub(super) fn reason(others: &OtherLenses, name: impl Fn(usize) -> String) -> String {
    const NAMED: usize = 4;
    let mut names: Vec<String> =
        others.poses.iter().map(|pose| format!("`{}`", name(*pose))).collect();
    names.sort();
    if names.len() > NAMED {
        let more = format!("{} more", names.len() - NAMED);
        names.truncate(NAMED);
        names.push(more);
    }
    let names = names.join(", ");
    match others.difference {
        OwnLensDifference::Focal { ratio, .. } => {
            let percent = 100.0 * (ratio - 1.0);
            format!(
                "images differ in focal length: {names} by {percent:+.1} % from the others: give images of one camera with one setting of zoom and focus"
            )
        }
        OwnLensDifference::Center { offset_px, .. } => {
            let [x, y] = [offset_px.x, offset_px.y];
            format!(
                "images differ in principal point: {names} by ({x:+.1}, {y:+.1}) px from the others: give images of one camera as it made them, none of them rotated by 180 degrees, mirrored, cropped or stabilized"
            )
        }
    }
}
