//! From images to a calibration or a refusal.

use nalgebra::DMatrix;

use crate::calibration::result::{Checks, ProjectionUncertainty};
use crate::calibration::scene::conditions::SceneConditions;
use crate::calibration::scene::correspondence::{ImagePairs, SceneImage, correspond};
use crate::calibration::scene::fitted_lens::LensFit;
use crate::calibration::scene::lens_differences::{self, other_lenses};
use crate::calibration::scene::lens_fit::{fit_lens, with_free_distortion};
use crate::calibration::scene::localization::localize;
use crate::calibration::scene::one_camera::{check_one_camera, states_cropping};
use crate::calibration::scene::refusal::SceneRefusal;
use crate::calibration::scene::result::{SceneCalibration, SceneSensor, SceneView};
use crate::calibration::scene::scene_frame::{SceneFrame, coverage, scene_points, view};
use crate::calibration::scene::verdict::{self, Evidence, GivenEvidence};
use crate::estimation::camera::check_given;
use crate::estimation::error::EstimationError;
use crate::estimation::given_misfit::{FreeEstimate, GivenDifference, GivenMisfit, comparable};
use crate::estimation::interrupt::Interrupt;
use crate::estimation::problem::{GivenParameter, LensChoice};
use crate::estimation::scene::bundle::{BundleStop, CameraMotion};
use crate::estimation::scene::hypotheses::reconstruct_best;
use crate::estimation::scene::reconstruction::Reconstruction;
use crate::estimation::scene::rotation_only::reconstruct_rotations;
use crate::estimation::uncertainty::{
    Distance, MedianAndWorst, PixelGrid, UncertaintyMap, projection_uncertainty,
};
use crate::geometry::lens::{Lens, LensModel};
use crate::geometry::pixel::ImageSize;
use crate::imaging::nominal_focal::NominalFocal;

/// Options of a calibration without a target.
#[derive(Debug, Clone, PartialEq)]
pub struct SceneOptions {
    /// Which lens model.
    pub lens: LensChoice,
    /// Lens parameters that are known, by name.
    pub given: Vec<GivenParameter>,
    /// The focal length that the images' files state; compared with the estimate.
    pub nominal_focal: Option<NominalFocal>,
    /// Threads; the result does not depend on it.
    pub threads: usize,
    /// Ends the calibration early.
    pub interrupt: Interrupt,
}

impl Default for SceneOptions {
    fn default() -> Self {
        let interrupt = Interrupt::default();
        let (lens, given, nominal_focal) = (LensChoice::Auto, Vec::new(), None);
        Self { lens, given, nominal_focal, threads: 1, interrupt }
    }
}

/// Fewer images do not determine a lens.
const LEAST_VIEWS: usize = 3;

/// Images with fewer features (median) cannot be matched.
const LEAST_FEATURES: usize = 60;

/// Motion within this angle of the optical axis, in degrees, is forward motion: its parallax is a
/// third of that of a sideways motion, and none in the middle of the image.
const FORWARD_DEG: f64 = 20.0;

/// Forward motion is accepted if the camera also rotated by this about its axis, in degrees.
const ROLLED_DEG: f64 = 45.0;

/// A camera that only rotated must have rotated by at least this, in degrees: any focal length
/// explains a smaller rotation.
const ROTATED_DEG: f64 = 15.0;

/// For a camera that only rotated, the greatest fraction of outliers; more are parallax.
const ROTATED_OUTLIERS: f64 = 0.2;

/// The least number of image pairs with an epipolar geometry that a reconstruction starts from.
const LEAST_GENERAL_PAIRS: usize = 2;

/// The images are explained by a rotation if its noise is less than this times that of a motion. Of
/// rendered worlds, half of them with something that moves, 20 rotations have 1.04 to 1.19 times,
/// 11 motions 12.9 times and more.
const ROTATION_NOISE_RATIO: f64 = 2.0;

/// The limit of Cauchy's loss for that comparison, in standard deviations.
const ROBUST_LIMIT_SIGMAS: f64 = 2.4;

const COMPARISON_STOP: BundleStop = BundleStop { max_steps: 10, least_decrease: 1e-3 };

/// The texture repeats if more than this fraction of an image's features match several places of
/// the next image: between what photographs have, 0.27 at most, and what repeats, 0.77 at least.
const REPEATED_FRACTION: f64 = 0.5;

/// With less parallax than this, in degrees, noise decides on focal length and depth.
const LEAST_PARALLAX_DEG: f64 = 2.0;

/// A focal length with a greater relative standard deviation is not determined.
const UNDETERMINED_FOCAL_STD: f64 = 0.2;

/// Calibrates from `images` of a static scene by one camera.
///
/// # Errors
/// [`SceneRefusal`] where they do not determine the lens, and why;
/// [`SceneRefusal::Interrupted`] once that was requested.
pub fn calibrate_scene(
    images: &[SceneImage],
    options: &SceneOptions,
) -> Result<SceneCalibration, SceneRefusal> {
    check_options(options)?;
    let size = checked_size(images)?;
    let goes_on = || options.interrupt.check().map_err(|_| SceneRefusal::Interrupted);
    let found = correspond(images, size, options.threads, &options.interrupt);
    goes_on()?;
    let fitted = match fitted(images, &found, options) {
        Ok(fitted) => fitted,
        Err(refusal) => {
            let given = given_evidence(images, &found, options, None);
            goes_on()?;
            return Err(given.misfit.map_or(refusal, SceneRefusal::Contradicted));
        }
    };
    let given = given_evidence(images, &found, options, Some(&fitted.fit.fit.state.lens));
    goes_on()?;
    let mut calibration = finished(images, &fitted, &found, &given);
    let sensor = &calibration.sensor;
    let focal = (sensor.lens.matrix.fx, sensor.lens_std[Lens::FX]);
    let unfit = options.nominal_focal.and_then(|nominal| verdict::unfit_focal(nominal, focal));
    calibration.verdict.reasons.extend(unfit);
    Ok(calibration)
}

/// A lens that was fitted to the images.
struct FittedScene {
    start: Reconstruction,
    fit: LensFit,
    conditions: SceneConditions,
    /// The reason to give if the images differ in focal length or principal point.
    different_lenses: Option<String>,
}

/// Fits the lens to what the images have in common.
fn fitted(
    images: &[SceneImage],
    found: &ImagePairs,
    options: &SceneOptions,
) -> Result<FittedScene, SceneRefusal> {
    let goes_on = || options.interrupt.check().map_err(|_| SceneRefusal::Interrupted);
    let start = reconstruction(found, options).map_err(|refusal| explained(refusal, found));
    goes_on()?;
    let mut start = start?;
    check_rotation(&start).map_err(|refusal| explained(refusal, found))?;
    settle(&mut start);
    localize(images, &mut start, options.threads);
    goes_on()?;
    start.bundle.prior.cropped = states_cropping(images);
    let fit = fit_lens(&start, options.lens, &options.given);
    goes_on()?;
    let mut fit = fit?;
    let others = other_lenses(&start, &fit);
    others.iter().for_each(|others| lens_differences::widen(&mut fit, others));
    let conditions = SceneConditions::of(&fit.fit.bundle, &fit.fit.state);
    check_determined(&fit, &conditions, found, &start)
        .map_err(|refusal| explained(refusal, found))?;
    let name = |pose: usize| images[start.images[pose]].name.clone();
    let different_lenses = others.first().map(|others| lens_differences::reason(others, name));
    Ok(FittedScene { start, fit, conditions, different_lenses })
}

/// What the images say of the given parameters, by a fit without them; `held` is the lens with
/// them, if there is one.
fn given_evidence(
    images: &[SceneImage],
    found: &ImagePairs,
    options: &SceneOptions,
    held: Option<&Lens>,
) -> GivenEvidence {
    let Some((given, lens)) = comparable(&options.given, options.lens, held) else {
        return GivenEvidence::default();
    };
    let free = SceneOptions { lens, given: Vec::new(), ..options.clone() };
    let Ok(FittedScene { fit, .. }) = fitted(images, found, &free) else {
        let parameters = given.iter().filter_map(GivenDifference::unknown).collect();
        return GivenEvidence { misfit: None, parameters };
    };
    let lens = &fit.fit.state.lens;
    let covariance = full_covariance(lens, &fit.fit.bundle.free, &fit.covariance.matrix);
    let image_size = found.problem.image_size;
    let free = FreeEstimate { lens, covariance: &covariance, widening: 1.0, image_size };
    let parameters = given.iter().filter_map(|given| free.difference(given)).collect();
    GivenEvidence { misfit: GivenMisfit::of(&given, held, free), parameters }
}

/// Whether the lens model, or one of those to choose from, has the given parameters.
fn check_options(options: &SceneOptions) -> Result<(), EstimationError> {
    let models = match options.lens {
        LensChoice::Model(model) => vec![model],
        LensChoice::Auto => LensModel::compared().collect(),
    };
    let refusal = |model: LensModel| check_given(model, &options.given).err();
    // The error of the largest model names the most parameters.
    let refusals: Option<Vec<EstimationError>> = models.into_iter().map(refusal).collect();
    refusals.and_then(|mut refusals| refusals.pop()).map_or(Ok(()), Err)
}

/// The cause of `refusal`: if the texture repeats, matches join places that only resemble each
/// other, and the motion that they suggest is accidental.
fn explained(refusal: SceneRefusal, found: &ImagePairs) -> SceneRefusal {
    let part = found.repeated_part();
    let is_of_matches = matches!(
        refusal,
        SceneRefusal::NothingAgrees { .. }
            | SceneRefusal::OnePlane
            | SceneRefusal::HardlyAnyParallax
            | SceneRefusal::TooFewConnected { .. }
            | SceneRefusal::ForwardMotion { .. }
            | SceneRefusal::FocalUndetermined { .. }
    );
    if is_of_matches && part > REPEATED_FRACTION {
        SceneRefusal::RepeatedTexture { percent: 100.0 * part }
    } else {
        refusal
    }
}

/// The size of all images, if there are enough and they have features.
fn checked_size(images: &[SceneImage]) -> Result<ImageSize, SceneRefusal> {
    if images.len() < LEAST_VIEWS {
        return Err(SceneRefusal::TooFewImages { images: images.len() });
    }
    let count = |size: ImageSize| images.iter().filter(|image| image.size == size).count();
    let sizes = images.iter().map(|image| image.size);
    let size = sizes.max_by_key(|size| count(*size)).unwrap_or(images[0].size);
    if let Some(other) = images.iter().find(|image| image.size != size) {
        let (name, expected) = (other.name.clone(), size);
        return Err(SceneRefusal::DifferentSizes { name, size: other.size, expected });
    }
    check_one_camera(images)?;
    let features = images.iter().map(SceneImage::feature_count).collect();
    let median = middle(features);
    if median < LEAST_FEATURES {
        return Err(SceneRefusal::NoTexture { median });
    }
    Ok(size)
}

fn middle(mut counts: Vec<usize>) -> usize {
    counts.sort_unstable();
    counts.get(counts.len() / 2).copied().unwrap_or(0)
}

fn reconstruction(
    found: &ImagePairs,
    options: &SceneOptions,
) -> Result<Reconstruction, SceneRefusal> {
    let between_neighbors = middle(found.between_neighbors.clone());
    let verified = found.general.len() + found.rotated.len();
    let (images, views) = (found.problem.images, found.views());
    if views == 1 {
        return Err(SceneRefusal::Still);
    }
    if views < LEAST_VIEWS {
        return Err(SceneRefusal::TooFewViews { images, views });
    }
    if verified == 0 && found.still > 0 {
        return Err(SceneRefusal::OnlyWhatStays { pairs: found.still });
    }
    if verified == 0 {
        return Err(SceneRefusal::NothingAgrees { between_neighbors });
    }
    let given = options.given.iter().find(|given| given.name == "fx" || given.name == "fy");
    let focal = given.map(|given| given.value);
    let rotating = reconstruct_rotations(&found.problem, &found.homographies);
    let moving = (found.general.len() >= LEAST_GENERAL_PAIRS)
        .then(|| reconstruct_best(&found.problem, &found.general, focal))
        .flatten();
    match (rotating, moving) {
        (Some(rotating), Some(moving)) if explains_as_well(&rotating, &moving) => Ok(rotating),
        (_, Some(moving)) => Ok(moving),
        (Some(rotating), None) => Ok(rotating),
        (None, None) if is_one_plane(found) => Err(SceneRefusal::OnePlane),
        (None, None) => Err(SceneRefusal::HardlyAnyParallax),
    }
}

/// Refines poses, points and the lens with the keypoints, before patches are matched.
fn settle(start: &mut Reconstruction) {
    let free = std::mem::replace(
        &mut start.bundle.free,
        vec![Lens::FX, Lens::FY, Lens::CX, Lens::CY, Lens::FIRST_COEFFICIENT],
    );
    start.bundle.robust_limit = ROBUST_LIMIT_SIGMAS * start.bundle.median_noise(&start.state);
    start.state = start.bundle.minimize(start.state.clone(), COMPARISON_STOP);
    start.bundle.free = free;
}

/// Whether most pairs of images fit a homography, as one plane or a rotation gives.
fn is_one_plane(found: &ImagePairs) -> bool {
    let verified = found.general.len() + found.rotated.len();
    found.general.len() < LEAST_GENERAL_PAIRS || 4 * verified < 5 * found.nearly_planar
}

/// Whether a pure rotation explains the images nearly as well: the moving model has translations
/// and depths in addition, which fit even noise a little better.
fn explains_as_well(rotating: &Reconstruction, moving: &Reconstruction) -> bool {
    let noise = |of: &Reconstruction| {
        let (mut bundle, start) = with_free_distortion(of);
        bundle.robust_limit = ROBUST_LIMIT_SIGMAS * bundle.median_noise(&start);
        let state = bundle.minimize(start, COMPARISON_STOP);
        bundle.median_noise(&state)
    };
    let is_complete = rotating.images.len() >= moving.images.len();
    is_complete && noise(rotating) < ROTATION_NOISE_RATIO * noise(moving)
}

/// Refuses a camera that neither translated nor rotated enough.
fn check_rotation(start: &Reconstruction) -> Result<(), SceneRefusal> {
    let conditions = SceneConditions::of(&start.bundle, &start.state);
    let rotated_deg = conditions.rotated_deg.max(conditions.rolled_deg);
    if conditions.motion == CameraMotion::RotationOnly && rotated_deg < ROTATED_DEG {
        return Err(SceneRefusal::HardlyAnyParallax);
    }
    Ok(())
}

fn check_determined(
    fit: &LensFit,
    conditions: &SceneConditions,
    found: &ImagePairs,
    start: &Reconstruction,
) -> Result<(), SceneRefusal> {
    let (used, images) = (start.images.len(), found.views());
    let between_neighbors = middle(found.between_neighbors.clone());
    if used < 3 || used * 2 < images {
        return Err(SceneRefusal::TooFewConnected { used, images, between_neighbors });
    }
    let moving = conditions.motion == CameraMotion::Moving;
    if moving && is_one_plane(found) && conditions.relief < verdict::RELIEF {
        return Err(SceneRefusal::OnePlane);
    }
    let forward = conditions.sideways_deg < FORWARD_DEG && conditions.rolled_deg < ROLLED_DEG;
    if moving && forward {
        return Err(SceneRefusal::ForwardMotion { angle_deg: conditions.sideways_deg });
    }
    let kept: usize = fit.fit.bundle.observations.iter().map(Vec::len).sum();
    let outliers = fit.fit.dropped as f64 / (kept + fit.fit.dropped).max(1) as f64;
    if (moving && conditions.parallax_deg < LEAST_PARALLAX_DEG)
        || (!moving && outliers > ROTATED_OUTLIERS)
    {
        return Err(SceneRefusal::HardlyAnyParallax);
    }
    let focal_std = verdict::relative_focal_std(fit);
    if !(focal_std < UNDETERMINED_FOCAL_STD) {
        return Err(SceneRefusal::FocalUndetermined { percent: 100.0 * focal_std });
    }
    Ok(())
}

fn finished(
    images: &[SceneImage],
    fitted: &FittedScene,
    found: &ImagePairs,
    given: &GivenEvidence,
) -> SceneCalibration {
    let FittedScene { start, fit, conditions, different_lenses } = fitted;
    let (state, bundle) = (&fit.fit.state, &fit.fit.bundle);
    let (lens, size) = (state.lens, found.problem.image_size);
    let frame = SceneFrame::of(start, &state.cameras_from_scene);
    let points = scene_points(start, fit, &frame);
    let views: Vec<SceneView> = images
        .iter()
        .enumerate()
        .map(|(image, of)| {
            let same_as = found.same_as[image].map(|other| images[other].name.as_str());
            view(of, same_as, image, &frame, &points, &lens)
        })
        .collect();
    let covariance = full_covariance(&lens, &bundle.free, &fit.covariance.matrix);
    let lens_std: Vec<f64> = covariance.diagonal().iter().map(|v| v.max(0.0).sqrt()).collect();
    let grid = PixelGrid::over(size, 16);
    let map = projection_uncertainty(&lens, &covariance, grid, Distance::Infinity);
    let MedianAndWorst { median_px: median, worst_px: worst } =
        map.as_ref().and_then(UncertaintyMap::median_and_worst).unwrap_or(MedianAndWorst::UNKNOWN);
    let center = map.as_ref().and_then(UncertaintyMap::center).unwrap_or(f64::INFINITY);
    let (count, sum) = points.iter().fold((0, 0.0), |(count, sum), point| {
        (count + point.seen.len(), sum + point.rms_px.powi(2) * point.seen.len() as f64)
    });
    let all = count + fit.fit.dropped;
    let checks = Checks {
        split_half_ratio: None,
        held_out_rms_px: None,
        outlier_fraction: fit.fit.dropped as f64 / all.max(1) as f64,
        coverage: coverage(&points, size),
    };
    let held_by_prior = held_by_prior(&lens, fit);
    let evidence = Evidence {
        fit,
        conditions,
        map: map.as_ref(),
        used: start.images.len(),
        views: found.views(),
        different_lenses: different_lenses.clone(),
        given,
        held_by_prior: &held_by_prior,
        aspect_held: is_aspect_held(&lens, fit),
    };
    let sensor = SceneSensor {
        image_size: size,
        lens,
        lens_std,
        lens_covariance: covariance.row_iter().map(|row| row.iter().copied().collect()).collect(),
        rms_px: (sum / count.max(1) as f64).sqrt(),
        uncertainty_px: ProjectionUncertainty { center, median, worst },
    };
    let verdict = verdict::judge(&evidence);
    let (scale, conditions) = (None, *conditions);
    SceneCalibration { sensor, views, points, checks, verdict, held_by_prior, conditions, scale }
}

/// The covariance of all lens parameters: 0 for fixed ones.
fn full_covariance(lens: &Lens, free: &[usize], matrix: &DMatrix<f64>) -> DMatrix<f64> {
    let count = lens.parameters().len();
    let mut full = DMatrix::zeros(count, count);
    for (i, a) in free.iter().enumerate() {
        for (j, b) in free.iter().enumerate() {
            full[(*a, *b)] = matrix[(i, j)];
        }
    }
    full
}

/// A parameter is held by its prior if its posterior standard deviation exceeds this fraction of
/// the prior's.
const HELD_STD_RATIO: f64 = 0.67;

fn held_by_prior(lens: &Lens, fit: &LensFit) -> Vec<&'static str> {
    let (model, bundle) = (lens.model(), &fit.fit.bundle);
    let (names, before) = (Lens::parameter_names(model), bundle.prior.std(model));
    let held = bundle.free.iter().enumerate().filter(|(k, parameter)| {
        let after = fit.covariance.independent[(*k, *k)].sqrt();
        after > HELD_STD_RATIO * before[**parameter]
    });
    held.map(|(_, parameter)| names[*parameter]).collect()
}

/// Whether the prior of fy / fx holds it.
fn is_aspect_held(lens: &Lens, fit: &LensFit) -> bool {
    let bundle = &fit.fit.bundle;
    let covariance = full_covariance(lens, &bundle.free, &fit.covariance.independent);
    let [x, y] = [1.0 / lens.matrix.fx, 1.0 / lens.matrix.fy];
    let variance = x * x * covariance[(Lens::FX, Lens::FX)]
        + y * y * covariance[(Lens::FY, Lens::FY)]
        - 2.0 * x * y * covariance[(Lens::FX, Lens::FY)];
    variance.sqrt() > HELD_STD_RATIO * bundle.prior.aspect_std()
}
