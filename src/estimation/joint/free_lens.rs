//! Which parameters of a lens are estimated, and which are given.

use nalgebra::DMatrix;

use crate::estimation::error::EstimationError;
use crate::estimation::given_range::check_given_value;
use crate::estimation::problem::{CameraOptions, GivenParameter};
use crate::geometry::lens::{Lens, LensModel};

/// Which parameters of a lens are estimated.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct FreeLens {
    pub(crate) model: LensModel,
    /// Indices into [`Lens::parameters`]; with `square_pixels`, fx stands for fx and fy.
    pub(crate) free: Vec<usize>,
    /// fx and fy are one parameter.
    pub(crate) square_pixels: bool,
}

/// Parameters with known values, by their index.
pub(crate) struct Given(Vec<(usize, f64)>);

impl Given {
    /// The parameters of `lens` that `free` does not estimate.
    pub(crate) fn held(free: &FreeLens, lens: &Lens) -> Self {
        let parameters = lens.parameters().into_iter().enumerate();
        Self(parameters.filter(|(index, _)| !free.moves(*index)).collect())
    }

    /// Sets them in a lens.
    pub(crate) fn apply(&self, lens: &mut Lens) -> Option<()> {
        let mut parameters = lens.parameters();
        for (index, value) in &self.0 {
            parameters[*index] = *value;
        }
        *lens = Lens::from_parameters(lens.model(), &parameters)?;
        Some(())
    }
}

impl FreeLens {
    /// The parameters of a lens of `model` that `options` leave free, and the given ones.
    pub(crate) fn from_options(
        model: LensModel,
        options: &CameraOptions,
    ) -> Result<(Self, Given), EstimationError> {
        let names = Lens::parameter_names(model);
        let mut given = Vec::new();
        for parameter in &options.given {
            let GivenParameter { name, value } = parameter;
            let unknown = || EstimationError::UnknownParameter {
                model,
                name: name.clone(),
                known: names.join(", "),
            };
            let index = names.iter().position(|known| known == name).ok_or_else(unknown)?;
            check_given_value(parameter)?;
            given.push((index, *value));
        }
        if options.square_pixels {
            // With square pixels, one given focal length is both.
            for (one, other) in [(Lens::FX, Lens::FY), (Lens::FY, Lens::FX)] {
                let value = given.iter().find(|(index, _)| *index == one).map(|(_, value)| *value);
                if !given.iter().any(|(index, _)| *index == other) {
                    given.extend(value.map(|value| (other, value)));
                }
            }
        }
        let is_given = |index: usize| given.iter().any(|(known, _)| *known == index);
        let square_pixels = options.square_pixels && !is_given(Lens::FX) && !is_given(Lens::FY);
        let held = |index: usize| match index {
            Lens::FY => square_pixels,
            Lens::SKEW => !options.skew,
            _ => false,
        };
        let free = (0..names.len()).filter(|index| !is_given(*index) && !held(*index)).collect();
        Ok((Self { model, free, square_pixels }, Given(given)))
    }

    /// Whether a parameter of the lens is estimated, alone or with another.
    pub(crate) fn moves(&self, index: usize) -> bool {
        let counted = if self.square_pixels && index == Lens::FY { Lens::FX } else { index };
        self.free.contains(&counted)
    }

    /// The derivative of all parameters of the lens by the free ones: parameters × free.
    pub(crate) fn all_by_free(&self, lens: &Lens) -> DMatrix<f64> {
        let mut by_free = DMatrix::zeros(lens.parameters().len(), self.free.len());
        for (column, index) in self.free.iter().enumerate() {
            by_free[(*index, column)] = 1.0;
            if self.square_pixels && *index == Lens::FX {
                by_free[(Lens::FY, column)] = 1.0;
            }
        }
        by_free
    }

    /// The block of the free parameters in a covariance of all parameters of the lens.
    pub(crate) fn reduced(&self, covariance: &DMatrix<f64>) -> DMatrix<f64> {
        let size = self.free.len();
        DMatrix::from_fn(size, size, |i, j| covariance[(self.free[i], self.free[j])])
    }
}
