//! The prior of a lens before any image. It constrains parameters that the images hardly determine,
//! and is too weak to change those that they do.

use crate::geometry::lens::{Lens, LensModel};
use crate::geometry::pixel::ImageSize;

/// The standard deviation of the principal point about the image's center, over the image's width:
/// the tolerance in mounting sensors and lenses.
const MOUNTED_STD: f64 = 0.02;

/// The same where images may be cropped, or rectified with those of another camera. A crop of a
/// half to all of an image, from anywhere in it, has its center within 0.5 of its width from that
/// of the whole, and within 0.2 in the root mean square.
const CROPPED_STD: f64 = 0.2;

/// The standard deviation of fy / fx about 1: pixels are square, except for sizes that were rounded
/// when images were scaled (0.1 % at 500 rows). Not swept.
const SQUARE_STD: f64 = 0.002;

/// The same where images were stretched: in common video standards and camera modes fy / fx is 0.91
/// to 1.09.
const STRETCHED_STD: f64 = 0.1;

/// Independent Gaussian priors on a lens's parameters.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct LensPrior {
    /// The size of the image.
    pub image_size: ImageSize,
    /// Whether the image may be a crop of the camera's.
    pub cropped: bool,
    /// Whether width and height may be scaled by different factors.
    pub stretched: bool,
}

/// One term of a prior: a residual in standard deviations, and its derivatives by parameters (in
/// the order of [`Lens::parameters`]).
#[derive(Debug, Clone, PartialEq)]
pub struct PriorTerm {
    /// In standard deviations.
    pub residual: f64,
    /// (parameter, derivative).
    pub by_parameters: Vec<(usize, f64)>,
}

impl LensPrior {
    /// For images that are neither cropped nor stretched.
    pub const fn of_whole(image_size: ImageSize) -> Self {
        Self { image_size, cropped: false, stretched: false }
    }

    /// The standard deviation of the principal point, in pixels.
    pub fn center_std_px(&self) -> f64 {
        f64::from(self.image_size.width) * if self.cropped { CROPPED_STD } else { MOUNTED_STD }
    }

    /// The standard deviation of fy / fx.
    pub const fn aspect_std(&self) -> f64 {
        if self.stretched { STRETCHED_STD } else { SQUARE_STD }
    }

    /// The prior standard deviation of each parameter, in the order of [`Lens::parameters`];
    /// infinite for the focal lengths.
    pub fn std(&self, model: LensModel) -> Vec<f64> {
        let center = self.center_std_px();
        let mut std = vec![f64::INFINITY, f64::INFINITY, center, center, 0.0];
        std.extend(model.priors().iter().map(|prior| prior.std));
        std
    }

    /// The prior mean of each parameter; 0 for the focal lengths, which have none.
    pub fn mean(&self, model: LensModel) -> Vec<f64> {
        let middle = self.image_size.center();
        let mut mean = vec![0.0, 0.0, middle.x, middle.y, 0.0];
        mean.extend(model.priors().iter().map(|prior| prior.mean));
        mean
    }

    /// The prior's terms at `lens`.
    pub fn terms(&self, lens: &Lens) -> Vec<PriorTerm> {
        let (parameters, std) = (lens.parameters(), self.std(lens.model()));
        let mean = self.mean(lens.model());
        let ratio = parameters[Lens::FY] / parameters[Lens::FX];
        let aspect_std = self.aspect_std();
        let mut terms = vec![PriorTerm {
            residual: (ratio - 1.0) / aspect_std,
            by_parameters: vec![
                (Lens::FX, -ratio / parameters[Lens::FX] / aspect_std),
                (Lens::FY, 1.0 / parameters[Lens::FX] / aspect_std),
            ],
        }];
        for (k, value) in parameters
            .iter()
            .enumerate()
            .filter(|(k, _)| ![Lens::FX, Lens::FY, Lens::SKEW].contains(k))
        {
            terms.push(PriorTerm {
                residual: (value - mean[k]) / std[k],
                by_parameters: vec![(k, 1.0 / std[k])],
            });
        }
        terms
    }
}
