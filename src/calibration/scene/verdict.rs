//! How far to trust a lens that came from a scene, in words that a person can act on.

use crate::calibration::given_misfit::contradiction;
use crate::calibration::known_image::KnownImage;
use crate::calibration::result::{Finding, Grade, Verdict};
use crate::calibration::rounded::value_with_std;
use crate::calibration::scene::conditions::SceneConditions;
use crate::calibration::scene::fitted_lens::LensFit;
use crate::estimation::given_misfit::{GivenDifference, GivenMisfit};
use crate::estimation::scene::bundle::CameraMotion;
use crate::estimation::uncertainty::UncertaintyMap;
use crate::imaging::nominal_focal::NominalFocal;

/// A focal length whose relative standard deviation is below the first is good, below the second
/// usable.
const FOCAL_STD: [f64; 2] = [0.002, 0.01];
/// The same limits for how many times greater the uncertainty is than if the observations' errors
/// were independent. Residuals that keep half of the errors show half as much.
const SHARED_ERROR_FACTORS: [f64; 2] = [6.0, 18.0];
/// The same limits for the fraction of outliers.
const OUTLIERS: [f64; 2] = [0.15, 0.4];
/// The median parallax, in degrees, below which depth is weak.
const PARALLAX_DEG: f64 = 5.0;
/// A relief ([`SceneConditions::relief`]) below which points are one plane.
pub(super) const RELIEF: f64 = 0.02;
/// If all images have about the same roll, only the parallax determines the principal point.
const ROLLED_DEG: f64 = 30.0;
/// A stated focal length that is off by more standard deviations contradicts the estimate: chance
/// gives one in 370.
const EXCLUDED_SIGMAS: f64 = 3.0;

/// What the images alone say of given parameters.
#[derive(Debug, Clone, PartialEq, Default)]
pub(super) struct GivenEvidence {
    /// What they contradict.
    pub misfit: Option<GivenMisfit>,
    /// Each given parameter with its estimate; with an infinite standard deviation where there is
    /// none.
    pub parameters: Vec<GivenDifference>,
}

/// What the verdict rests on.
pub(super) struct Evidence<'a> {
    pub fit: &'a LensFit,
    pub conditions: &'a SceneConditions,
    pub map: Option<&'a UncertaintyMap>,
    pub used: usize,
    /// Images of different views.
    pub views: usize,
    /// The reason to give if the images differ in focal length or principal point.
    pub different_lenses: Option<String>,
    /// What the images alone say of the given parameters.
    pub given: &'a GivenEvidence,
    pub held_by_prior: &'a [&'static str],
    /// Whether fy / fx is held by its prior.
    pub aspect_held: bool,
}

/// The standard deviation of fx over fx; 0 where it was given.
pub(super) fn relative_focal_std(fit: &LensFit) -> f64 {
    let matrix = &fit.covariance.matrix;
    let focal = fit.fit.bundle.free.iter().position(|parameter| *parameter == 0);
    focal.map_or(0.0, |k| matrix[(k, k)].sqrt() / fit.fit.state.lens.matrix.fx)
}

/// The grade, with its reasons.
pub(super) fn judge(evidence: &Evidence<'_>) -> Verdict {
    let findings = [
        contradicted(evidence),
        unverified(evidence),
        evidence.different_lenses.clone().map(|reason| Finding { grade: Grade::Poor, reason }),
        cropped(evidence),
        stretched(evidence),
        unused_images(evidence),
        focal(evidence),
        projections(evidence),
        shared_error(evidence),
        outliers(evidence),
        motion(evidence),
        held(evidence),
    ];
    Verdict::of(findings.into_iter().flatten().collect())
}

fn contradicted(evidence: &Evidence<'_>) -> Option<Finding> {
    let reason = contradiction(evidence.given.misfit.as_ref()?, "images");
    Some(Finding { grade: Grade::Poor, reason })
}

/// Given parameters of the camera matrix that the images alone know less well than a good
/// calibration would.
fn unverified(evidence: &Evidence<'_>) -> Option<Finding> {
    let greatest_std = FOCAL_STD[0] * evidence.fit.fit.state.lens.matrix.fx;
    let is_named = |it: &&GivenDifference| {
        ["fx", "fy", "cx", "cy"].contains(&it.name) && !(it.std <= greatest_std)
    };
    let each = |it: &GivenDifference| match it.std.is_finite() {
        true => format!("{} only as {}", it.name, value_with_std(it.estimated, it.std)),
        false => format!("{} not at all", it.name),
    };
    let GivenEvidence { misfit, parameters } = evidence.given;
    let names: Vec<String> = parameters.iter().filter(is_named).map(each).collect();
    let names = names.join(", ");
    let reason = format!("the images cannot verify what is given: alone they determine {names}");
    (misfit.is_none() && !names.is_empty()).then_some(Finding { grade: Grade::Usable, reason })
}

fn unused_images(evidence: &Evidence<'_>) -> Option<Finding> {
    let unused = evidence.views - evidence.used;
    let part = unused as f64 / evidence.views as f64;
    Finding::worse_than_good(
        Grade::of_figure(part, [0.1, 0.4]),
        format!(
            "{unused} of {} images have too little in common with the others: take smaller steps",
            evidence.views
        ),
    )
}

fn focal(evidence: &Evidence<'_>) -> Option<Finding> {
    let std = relative_focal_std(evidence.fit);
    let percent = 100.0 * std;
    Finding::worse_than_good(
        Grade::of_figure(std, FOCAL_STD),
        format!(
            "the focal length is uncertain by {percent:.2} % (1 sigma): add images from more places around the scene, some rotated by 90 degrees"
        ),
    )
}

fn projections(evidence: &Evidence<'_>) -> Option<Finding> {
    let Some(map) = evidence.map else {
        let reason = "the projection uncertainty cannot be computed: add images that show texture in all parts of the image".to_owned();
        return Some(Finding { grade: Grade::Poor, reason });
    };
    let known = KnownImage::of(map);
    let worst_px = map.std_px.iter().flatten().copied().fold(0.0, f64::max);
    let (good_px, percent) = (known.good_px(), known.beyond_good_percent());
    Finding::worse_than_good(
        known.grade(),
        format!(
            "the projection uncertainty exceeds {good_px:.2} px (1 sigma) in {percent:.0} % of the image, and reaches {worst_px:.2} px: add images that show texture there"
        ),
    )
}

fn shared_error(evidence: &Evidence<'_>) -> Option<Finding> {
    let factor = evidence.fit.covariance.shared.sqrt();
    if evidence.fit.fit.bundle.motion == CameraMotion::RotationOnly
        && factor > SHARED_ERROR_FACTORS[0]
    {
        // Panned by hand 3 and 8 cm before the axis, a camera 3 m from a wall was off by 4 and 5 of
        // its standard deviations: a lens that is too long takes up most of the parallax.
        let reason = format!(
            "the residuals are correlated ({factor:.1} times the uncertainty of independent observations): the camera center moved during the rotation, which biases the focal length upwards by more than the stated uncertainty; rotate the camera about its lens, or step sideways between images"
        );
        return Some(Finding { grade: Grade::Poor, reason });
    }
    Finding::worse_than_good(
        Grade::of_figure(factor, SHARED_ERROR_FACTORS),
        format!(
            "the residuals are correlated, which makes the result {factor:.1} times as uncertain as independent noise would: try another lens model, and check that the scene is static"
        ),
    )
}

fn outliers(evidence: &Evidence<'_>) -> Option<Finding> {
    let kept: usize = evidence.fit.fit.bundle.observations.iter().map(Vec::len).sum();
    let part = evidence.fit.fit.dropped as f64 / (kept + evidence.fit.fit.dropped).max(1) as f64;
    let percent = 100.0 * part;
    Finding::worse_than_good(
        Grade::of_figure(part, OUTLIERS),
        format!(
            "{percent:.0} % of the observations are outliers: check for moving objects, reflections and blur"
        ),
    )
}

fn motion(evidence: &Evidence<'_>) -> Option<Finding> {
    let SceneConditions { motion, parallax_deg, relief, rolled_deg, .. } = *evidence.conditions;
    let reason = if motion == CameraMotion::RotationOnly {
        "the camera only rotated, so the lens is determined from rotation alone: also move it sideways".to_owned()
    } else if parallax_deg < PARALLAX_DEG {
        format!(
            "little parallax ({parallax_deg:.1} degrees in the median): move the camera further around the scene"
        )
    } else if relief < RELIEF && rolled_deg < ROLLED_DEG {
        "the scene is nearly one plane: include things at different depths".to_owned()
    } else {
        return None;
    };
    Some(Finding { grade: Grade::Usable, reason })
}

/// The reason to give if the estimate (fx, its standard deviation) contradicts the stated focal
/// length.
pub(super) fn unfit_focal(nominal: NominalFocal, (fx, std): (f64, f64)) -> Option<String> {
    let NominalFocal { focal_px, std_px } = nominal;
    let excluded = (fx - focal_px).abs() > EXCLUDED_SIGMAS * std.hypot(std_px);
    excluded.then(|| {
        format!(
            "the EXIF focal length {focal_px:.0} px (± {std_px:.0} from rounding) does not fit the \
             estimate of {fx:.0} ± {std:.0} px: check for cropped or scaled images, or close focus"
        )
    })
}

fn cropped(evidence: &Evidence<'_>) -> Option<Finding> {
    let LensFit { fit, cropped, .. } = evidence.fit;
    let (size, matrix) = (fit.bundle.prior.image_size, fit.state.lens.matrix);
    let middle = size.center();
    let parts = [
        (matrix.cx - middle.x) / f64::from(size.width),
        (matrix.cy - middle.y) / f64::from(size.height),
    ];
    let [x, y] = parts.map(|part| 100.0 * part);
    let reason = format!(
        "the images seem to be cropped: the principal point is {x:+.0} % of the width and {y:+.0} % of the height from the image center; use uncropped images if available"
    );
    (*cropped > 0.5).then_some(Finding { grade: Grade::Good, reason })
}

fn stretched(evidence: &Evidence<'_>) -> Option<Finding> {
    let matrix = evidence.fit.fit.state.lens.matrix;
    let ratio = matrix.fy / matrix.fx;
    let reason = format!(
        "the images seem to be stretched: fy / fx is {ratio:.3}; use images as the camera made them if available"
    );
    (evidence.fit.stretched > 0.5).then_some(Finding { grade: Grade::Good, reason })
}

fn held(evidence: &Evidence<'_>) -> Option<Finding> {
    let mut names = evidence.held_by_prior.to_vec();
    if evidence.aspect_held {
        names.push("fy / fx");
    }
    let is_center = ["cx", "cy"].iter().any(|name| evidence.held_by_prior.contains(name));
    let assumed = match (is_center, evidence.aspect_held) {
        (true, true) => " (which assumes uncropped images with square pixels)",
        (true, false) => " (which assumes uncropped images)",
        (false, true) => " (which assumes square pixels)",
        (false, false) => "",
    };
    let list = names.join(", ");
    let reason = format!(
        "the images do not determine {list} beyond the prior for ordinary lenses{assumed}: rotate the camera by 90 degrees about its axis for some images"
    );
    (!names.is_empty()).then_some(Finding { grade: Grade::Usable, reason })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_stated_focal_length_that_is_excluded_is_named() {
        let nominal = NominalFocal { focal_px: 2866.0, std_px: 24.0 };
        let said = unfit_focal(nominal, (2976.0, 8.0)).unwrap();
        assert!(said.starts_with("the EXIF focal length 2866 px"), "{said}");
        assert!(said.contains("does not fit the estimate of 2976 ± 8 px"), "{said}");
        assert_eq!(unfit_focal(nominal, (2920.0, 8.0)), None);
        assert_eq!(unfit_focal(nominal, (2976.0, 80.0)), None);
    }
}
