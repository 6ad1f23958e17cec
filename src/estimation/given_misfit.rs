//! Whether the images contradict lens parameters that were given: these are compared with the lens
//! that the images determine without them.

use nalgebra::{DMatrix, DVector};

use crate::estimation::problem::{GivenParameter, LensChoice};
use crate::estimation::split_halves::LensDifference;
use crate::geometry::lens::{Lens, LensModel};
use crate::geometry::pixel::ImageSize;

/// Given parameters that the images contradict.
#[derive(Debug, Clone, PartialEq)]
pub struct GivenMisfit {
    /// Those that are off, the farthest first; of a whole lens only the farthest of its camera
    /// matrix.
    pub parameters: Vec<GivenDifference>,
    /// Whether every parameter of the lens was given: then its projections are compared.
    pub is_whole_lens: bool,
    /// The difference over its predicted standard deviation (root mean square): of the given
    /// parameters, or of the projections of a whole lens.
    pub ratio: f64,
}

/// A given parameter and its estimate.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct GivenDifference {
    /// Its name.
    pub name: &'static str,
    /// The given value.
    pub given: f64,
    /// The estimate without what is given.
    pub estimated: f64,
    /// Its standard deviation.
    pub std: f64,
}

/// What is known of given parameters.
#[derive(Debug, Clone, PartialEq, Default)]
pub enum GivenCheck {
    /// None was given.
    #[default]
    NothingGiven,
    /// The images do not determine a lens without them.
    Unknown,
    /// They fit the images.
    Fits,
    /// They do not.
    Contradicted(GivenMisfit),
}

/// The lens that was estimated without the given parameters.
#[derive(Debug, Clone, Copy)]
pub(crate) struct FreeEstimate<'a> {
    pub(crate) lens: &'a Lens,
    /// Of all its parameters.
    pub(crate) covariance: &'a DMatrix<f64>,
    /// The factor by which its halves differ more than that predicts, at least 1.
    pub(crate) widening: f64,
    pub(crate) image_size: ImageSize,
}

/// Larger differences, in standard deviations, contradict the estimate: chance gives one in 370.
const CONTRADICTED_SIGMAS: f64 = 3.0;
/// A parameter that hardly affects projections may be well-known and off: if the projections differ
/// by less than their predicted uncertainty, that is no matter.
const LEAST_PROJECTION_RATIO: f64 = 1.0;
/// Smaller differences relative to a value are rounding.
const ROUNDING: f64 = 1e-6;

/// What of `given` can be compared with a solve without it, and the lens choice of that solve.
/// `held` is the lens that was estimated with it, where there is one. `None` if there is nothing to
/// compare.
pub(crate) fn comparable(
    given: &[GivenParameter],
    choice: LensChoice,
    held: Option<&Lens>,
) -> Option<(Vec<GivenParameter>, LensChoice)> {
    // Coefficients of equal names differ between models.
    let has_in_matrix = |model: &LensModel, name: &str| {
        Lens::parameter_names(*model)[..Lens::FIRST_COEFFICIENT].contains(&name)
    };
    let is_shared = |it: &GivenParameter| {
        LensModel::ALL.iter().all(|model| has_in_matrix(model, it.name.as_str()))
    };
    let (given, choice) = match (choice, held) {
        (LensChoice::Auto, _) if given.iter().all(is_shared) => (given.to_vec(), choice),
        (LensChoice::Auto, Some(held)) => (given.to_vec(), LensChoice::Model(held.model())),
        (LensChoice::Auto, None) => {
            (given.iter().filter(|it| is_shared(it)).cloned().collect(), choice)
        }
        (LensChoice::Model(_), _) => (given.to_vec(), choice),
    };
    (!given.is_empty()).then_some((given, choice))
}

impl FreeEstimate<'_> {
    /// A given parameter compared with this estimate; `None` if this lens has none of its name.
    pub(crate) fn difference(&self, given: &GivenParameter) -> Option<GivenDifference> {
        let names = Lens::parameter_names(self.lens.model());
        let index = names.iter().position(|name| *name == given.name)?;
        let std = self.covariance[(index, index)].sqrt() * self.widening;
        let estimated = self.lens.parameters()[index];
        Some(GivenDifference { name: names[index], given: given.value, estimated, std })
    }
}

impl GivenMisfit {
    /// `None` if `given` fits. `held` is the lens that was estimated with it, where there is one.
    pub(crate) fn of(
        given: &[GivenParameter],
        held: Option<&Lens>,
        free: FreeEstimate<'_>,
    ) -> Option<Self> {
        let FreeEstimate { lens, covariance, widening, image_size } = free;
        let names = Lens::parameter_names(lens.model());
        // Skew is 0 unless it is estimated.
        let compared = |parameter: &GivenParameter| {
            let index = names.iter().position(|name| *name == parameter.name)?;
            let difference = free.difference(parameter).filter(|it| it.std > 0.0)?;
            Some((index, difference))
        };
        let (indices, mut parameters): (Vec<usize>, Vec<GivenDifference>) =
            given.iter().filter_map(compared).unzip();
        let is_whole_lens = given.len() >= names.len();
        let all = || Lens::from_parameters(lens.model(), &values(&names, given)?);
        let whole = if is_whole_lens && held.is_none() { all() } else { None };
        let projections = held.or(whole.as_ref()).and_then(|held| {
            let lenses = [held, lens];
            LensDifference::between(lenses, lens, Some(covariance), image_size).ratio
        });
        let projections = projections.map(|ratio| ratio / widening);
        let is_rounding = |it: &GivenDifference| {
            (it.given - it.estimated).abs() <= ROUNDING * it.estimated.abs().max(1.0)
        };
        if parameters.iter().all(is_rounding) {
            return None;
        }
        let ratio = if is_whole_lens {
            parameters.retain(|it| names[..Lens::FIRST_COEFFICIENT].contains(&it.name));
            projections?
        } else {
            let block = DMatrix::from_fn(indices.len(), indices.len(), |i, j| {
                covariance[(indices[i], indices[j])]
            });
            rms_in_sigmas(&parameters, &block)? / widening
        };
        let matters = projections.is_none_or(|ratio| ratio > LEAST_PROJECTION_RATIO);
        if !(ratio > CONTRADICTED_SIGMAS && matters) {
            return None;
        }
        parameters.sort_by(|a, b| b.sigmas().total_cmp(&a.sigmas()));
        let is_off = |it: &GivenDifference| it.sigmas() > CONTRADICTED_SIGMAS;
        let off = parameters.iter().filter(|it| is_off(it)).count();
        parameters.truncate(if is_whole_lens { 1 } else { off.max(1) });
        Some(Self { parameters, is_whole_lens, ratio })
    }
}

impl GivenDifference {
    /// A parameter of a camera matrix that the images do not determine.
    pub(crate) fn unknown(given: &GivenParameter) -> Option<Self> {
        let model = LensModel::ALL.first()?;
        let mut names = Lens::parameter_names(*model).into_iter().take(Lens::FIRST_COEFFICIENT);
        let name = names.find(|name| *name == given.name)?;
        Some(Self { name, given: given.value, estimated: f64::NAN, std: f64::INFINITY })
    }

    fn sigmas(&self) -> f64 {
        ((self.given - self.estimated) / self.std).abs()
    }
}

/// The value of each of `names`, if all are `given`.
fn values(names: &[&str], given: &[GivenParameter]) -> Option<Vec<f64>> {
    let value = |name: &&str| Some(given.iter().find(|it| it.name == **name)?.value);
    names.iter().map(value).collect()
}

/// The root mean square of the differences in units of their standard deviations, with their
/// `covariance`.
fn rms_in_sigmas(differences: &[GivenDifference], covariance: &DMatrix<f64>) -> Option<f64> {
    let count = differences.len();
    // Pixels and coefficients differ by orders of magnitude, hence units of standard deviations.
    let std = covariance.diagonal().map(f64::sqrt);
    let scaled = DMatrix::from_fn(count, count, |i, j| covariance[(i, j)] / (std[i] * std[j]));
    let off = differences.iter().zip(&std).map(|(it, std)| (it.given - it.estimated) / std);
    let off = DVector::from_iterator(count, off);
    let ratio = (off.dot(&scaled.cholesky()?.solve(&off)) / count as f64).sqrt();
    ratio.is_finite().then_some(ratio)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::camera_matrix::CameraMatrix;

    fn given(name: &str, value: f64) -> GivenParameter {
        GivenParameter { name: name.to_owned(), value }
    }

    fn pinhole(fx: f64) -> Lens {
        Lens::pinhole(CameraMatrix { fx, fy: fx, cx: 320.0, cy: 240.0, skew: 0.0 })
    }

    /// Of a pinhole with focal lengths of 600 ± 1 px; `held` are those with what is given.
    fn misfit(all: &[GivenParameter], held: f64, widening: f64) -> Option<GivenMisfit> {
        let free = pinhole(600.0);
        let covariance =
            DMatrix::from_diagonal(&DVector::from_column_slice(&[1.0, 1.0, 1.0, 1.0, 0.0]));
        let image_size = ImageSize::new(640, 480);
        let free = FreeEstimate { lens: &free, covariance: &covariance, widening, image_size };
        GivenMisfit::of(all, Some(&pinhole(held)), free)
    }

    #[test]
    fn what_is_off_is_named_with_its_estimate() {
        let both = [given("cx", 320.5), given("fx", 620.0)];
        let found = misfit(&both, 620.0, 1.0).unwrap();
        let fx = GivenDifference { name: "fx", given: 620.0, estimated: 600.0, std: 1.0 };
        assert_eq!(found.parameters, [fx]);
        assert!(!found.is_whole_lens && (found.ratio - 14.1).abs() < 0.1, "{found:?}");
        assert_eq!(misfit(&both, 620.0, 8.0), None, "halves differ as much");
        assert_eq!(misfit(&[given("fx", 602.0)], 602.0, 1.0), None);
        assert_eq!(misfit(&[given("skew", 3.0)], 602.0, 1.0), None, "it is not estimated");
    }

    #[test]
    fn a_whole_lens_is_compared_by_its_projections() {
        let whole = |fx: f64| misfit(&GivenParameter::all_of(&pinhole(fx)), fx, 1.0);
        let found = whole(620.0).unwrap();
        assert!(found.is_whole_lens && found.parameters.len() == 1, "{found:?}");
        assert_eq!(whole(601.0), None);
    }
}
