//! Whether the images, by what they show, are from one camera with one lens setting. Their focal
//! lengths differ if they are from two cameras, if the zoom was moved, or if the autofocus followed
//! the scene; their principal points, if some were rotated by 180 degrees, cropped or stabilized.

use nalgebra::{DMatrix, DMatrixView, DVector, Matrix2, Vector2};

use crate::calibration::scene::fitted_lens::LensFit;
use crate::estimation::scene::bundle::Bundle;
use crate::estimation::scene::lens_by_image::{LensByImage, OwnPart, separate_lenses};
use crate::estimation::scene::reconstruction::Reconstruction;
use crate::geometry::lens::Lens;

/// Images whose lens differs from the others'.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct OtherLenses {
    /// The smaller group of images, as indices of poses, in the order of the images.
    pub poses: Vec<usize>,
    /// How it differs.
    pub difference: OwnLensDifference,
    /// The square of the difference over its critical value.
    significance: f64,
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

/// Images whose focal length or principal point is not that of the others, the more significant
/// difference first. Uses all observations of `start`: those of images with another lens are
/// outliers to the common one, and `fit` may have dropped them.
pub(super) fn other_lenses(start: &Reconstruction, fit: &LensFit) -> Vec<OtherLenses> {
    let both = [OwnPart::Focal, OwnPart::Center];
    let found = both.into_iter().filter_map(|part| others_by(part, start, fit));
    let mut found: Vec<OtherLenses> = found.collect();
    found.sort_by(|a, b| b.significance.total_cmp(&a.significance));
    found
}

fn others_by(part: OwnPart, start: &Reconstruction, fit: &LensFit) -> Option<OtherLenses> {
    let bundle = Bundle { free: fit.fit.bundle.free.clone(), ..start.bundle.clone() };
    let mut state = start.state.clone();
    state.lens = fit.fit.state.lens;
    let (count, width) = (state.cameras_from_scene.len(), part.width());
    if count < 3 {
        return None;
    }
    let found = separate_lenses(&bundle, &state, part)?;
    let best = best_groups(&found, width)?;
    let least = match part {
        OwnPart::Focal => LEAST_FOCAL_DIFFERENCE,
        OwnPart::Center => LEAST_CENTER_DIFFERENCE * f64::from(bundle.prior.image_size.width),
    };
    let significance = best.square / no_chance((count - 1) * width);
    if significance <= 1.0 || best.contrast.norm() < least {
        return None;
    }
    let (mut poses, contrast) = if 2 * best.larger.len() <= count {
        (best.larger, best.contrast)
    } else {
        let smaller = (0..count).filter(|k| !best.larger.contains(k)).collect();
        (smaller, -best.contrast)
    };
    poses.sort_by_key(|pose| start.images[*pose]);
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
    Some(OtherLenses { poses, difference, significance })
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
    let contrasts = Contrasts::of(found, width)?;
    let directions = if width == 1 { 1 } else { 8 };
    let mut best: Option<ImageGroups> = None;
    for direction in 0..directions {
        let (sin, cos) = (f64::from(direction) * std::f64::consts::PI / 8.0).sin_cos();
        let along = |image: usize| match width {
            1 => found.values[image],
            _ => cos * found.values[2 * image] + sin * found.values[2 * image + 1],
        };
        let mut order: Vec<usize> = (0..count).collect();
        order.sort_by(|a, b| along(*b).total_cmp(&along(*a)));
        let mut larger = GroupSums::none(width);
        for split in 1..count {
            larger.add(&contrasts, &order[..split]);
            let Some((contrast, square)) = contrasts.of_group(&larger) else { continue };
            if best.as_ref().is_none_or(|best| square > best.square) {
                best = Some(ImageGroups { larger: order[..split].to_vec(), contrast, square });
            }
        }
    }
    best
}

/// Generalized least squares of the mean of all images and the contrast of a group to the others.
struct Contrasts {
    width: usize,
    /// The inverse of the covariance of all values.
    weight: DMatrix<f64>,
    /// That times the values.
    weighted: DVector<f64>,
    /// Sums of the former over all images.
    all: GroupSums,
}

/// Sums over a group of images.
struct GroupSums {
    /// Weights between two images of the group.
    within: DMatrix<f64>,
    /// Weights between an image of the group and any image.
    to_all: DMatrix<f64>,
    /// Weighted values.
    values: DVector<f64>,
}

impl GroupSums {
    fn none(width: usize) -> Self {
        let zero = DMatrix::zeros(width, width);
        Self { within: zero.clone(), to_all: zero, values: DVector::zeros(width) }
    }

    /// Adds the last image of `group`, whose others are in it.
    fn add(&mut self, of: &Contrasts, group: &[usize]) {
        let Some((image, before)) = group.split_last() else { return };
        for other in before {
            let weight = of.between(*image, *other);
            self.within += weight + weight.transpose();
        }
        self.within += of.between(*image, *image);
        for other in 0..of.weighted.len() / of.width {
            self.to_all += of.between(*image, other);
        }
        self.values += of.weighted.rows(image * of.width, of.width);
    }
}

impl Contrasts {
    fn of(found: &LensByImage, width: usize) -> Option<Self> {
        let weight = found.covariance.clone().cholesky()?.inverse();
        let weighted = &weight * &found.values;
        let mut contrasts = Self { width, weight, weighted, all: GroupSums::none(width) };
        let mut all = GroupSums::none(width);
        let images: Vec<usize> = (0..found.values.len() / width).collect();
        (1..=images.len()).for_each(|count| all.add(&contrasts, &images[..count]));
        contrasts.all = all;
        Some(contrasts)
    }

    fn between(&self, first: usize, second: usize) -> DMatrixView<'_, f64> {
        let width = self.width;
        self.weight.view((first * width, second * width), (width, width))
    }

    /// The values of a group less those of the others, and the square of that in standard
    /// deviations.
    fn of_group(&self, group: &GroupSums) -> Option<(DVector<f64>, f64)> {
        let width = self.width;
        let mut normal = DMatrix::zeros(2 * width, 2 * width);
        normal.view_mut((0, 0), (width, width)).copy_from(&self.all.within);
        normal.view_mut((width, 0), (width, width)).copy_from(&group.to_all);
        normal.view_mut((0, width), (width, width)).copy_from(&group.to_all.transpose());
        normal.view_mut((width, width), (width, width)).copy_from(&group.within);
        let mut right = DVector::zeros(2 * width);
        right.rows_mut(0, width).copy_from(&self.all.values);
        right.rows_mut(width, width).copy_from(&group.values);
        let inverse = normal.try_inverse()?;
        let contrast = (&inverse * right).rows(width, width).into_owned();
        let covariance = inverse.view((width, width), (width, width)).into_owned();
        let square = contrast.dot(&covariance.cholesky()?.solve(&contrast));
        Some((contrast, square))
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
                "images differ in principal point: {names} by ({x:+.1}, {y:+.1}) px from the others: give images of one camera as it made them, none of them rotated by 180 degrees, cropped or stabilized"
            )
        }
    }
}
