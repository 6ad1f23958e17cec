//! The calibration of one camera from views of a board: lens, poses, rejected views with the
//! reason, and all covariances.

pub use crate::estimation::camera_estimate::{CameraEstimate, ViewEstimate};
use crate::estimation::camera_estimate::{Part, assemble};
use crate::estimation::camera_fit::{CameraFit, fit_camera};
use crate::estimation::clustered_covariance::FitCovariance;
use crate::estimation::error::EstimationError;
use crate::estimation::given_misfit::{
    FreeEstimate, GivenCheck, GivenDifference, GivenMisfit, comparable,
};
use crate::estimation::jackknife::with_jackknife;
use crate::estimation::joint::FreeLens;
use crate::estimation::lens_choice::lens_misfit::LensMisfit;
use crate::estimation::lens_choice::other_minimum::closer_of_two_minima;
use crate::estimation::lens_choice::without_pole::FitWithEffects;
use crate::estimation::lens_choice::{ChosenLens, choose_lens};
use crate::estimation::model_check::ModelCheck;
use crate::estimation::model_error::{noise_floor_px_of, with_noise_floor};
pub use crate::estimation::problem::{CameraOptions, CameraStart};
use crate::estimation::problem::{CameraProblem, GivenParameter, LensChoice, check};
use crate::estimation::start::Prepared;
use crate::estimation::view_order::ViewOrder;
use crate::geometry::lens::{Lens, LensModel};

/// Checks that a lens of `model` has the `given` parameters, by name, and that their values are
/// possible.
///
/// # Errors
/// [`EstimationError::UnknownParameter`], [`EstimationError::GivenValue`].
pub fn check_given(model: LensModel, given: &[GivenParameter]) -> Result<(), EstimationError> {
    let options = CameraOptions { given: given.to_vec(), ..CameraOptions::default() };
    FreeLens::from_options(model, &options).map(|_| ())
}

/// Calibrates a camera: starts from Zhang's closed form (or `options.start`), then runs
/// Levenberg–Marquardt over the lens and all poses, with a robust selection of corners and views.
/// Deterministic, and the same in any order of the views.
///
/// # Errors
/// Numbers that are not finite, too few usable views, or views that do not determine the lens. Each
/// error says what to do.
pub fn calibrate_camera(
    problem: &CameraProblem,
    options: &CameraOptions,
) -> Result<CameraEstimate, EstimationError> {
    let order = ViewOrder::of(problem);
    let (estimate, _) = solve(&order.problem(problem), &order.options(options))?;
    Ok(order.as_given(estimate))
}

/// As [`calibrate_camera`], with the check whether the model is right
/// ([`crate::estimation::model_check`]).
///
/// # Errors
/// As [`calibrate_camera`].
pub fn calibrate_and_check(
    problem: &CameraProblem,
    options: &CameraOptions,
) -> Result<(CameraEstimate, ModelCheck), EstimationError> {
    let order = ViewOrder::of(problem);
    let (estimate, fit) = solve(&order.problem(problem), &order.options(options))?;
    let check = ModelCheck::of(&fit, &estimate, options);
    options.interrupt.check()?;
    Ok((order.as_given(estimate), check))
}

/// As [`calibrate_and_check`]. Where the scatter between views exceeds that of their corners, the
/// covariance of the lens comes from repeated solves, each without one view or group of views.
/// Where a larger lens model than the requested or chosen one predicts views better, the difference
/// from it counts as an error of the lens. Given lens parameters are compared with a solve without
/// them.
///
/// # Errors
/// As [`calibrate_camera`].
pub fn calibrate_with_jackknife(
    problem: &CameraProblem,
    options: &CameraOptions,
) -> Result<(CameraEstimate, ModelCheck), EstimationError> {
    let order = ViewOrder::of(problem);
    let (estimate, check) = solve_with_jackknife(&order.problem(problem), &order.options(options))?;
    Ok((order.as_given(estimate), check))
}

fn solve_with_jackknife(
    problem: &CameraProblem,
    options: &CameraOptions,
) -> Result<(CameraEstimate, ModelCheck), EstimationError> {
    let (estimate, fit) =
        solve(problem, options).map_err(|error| of_given(error, problem, options))?;
    let weighted = with_noise_floor(problem, estimate.noise_floor_px);
    let mut estimate = with_jackknife(&weighted, options, estimate, &fit);
    let mut check = ModelCheck::of(&fit, &estimate, options);
    if check.is_beyond_noise(&fit, &estimate) {
        check.lens_misfit = LensMisfit::of(&weighted, options, &estimate, &fit);
    }
    if let Some(misfit) = &check.lens_misfit {
        estimate.lens_covariance *= misfit.widening * misfit.widening;
    }
    check.given = check_of_given(problem, options, Some(&estimate.lens));
    options.interrupt.check()?;
    Ok((estimate, check))
}

/// Compares the given parameters with a solve without them; `held` is the lens with them, if there
/// is one.
fn check_of_given(
    problem: &CameraProblem,
    options: &CameraOptions,
    held: Option<&Lens>,
) -> GivenCheck {
    let Some((given, lens)) = comparable(&options.given, options.lens, held) else {
        return GivenCheck::NothingGiven;
    };
    let free = CameraOptions { given: Vec::new(), lens, start: None, ..options.clone() };
    let Ok((estimate, check)) = solve_with_jackknife(problem, &free) else {
        return GivenCheck::Unknown;
    };
    let free = FreeEstimate {
        lens: &estimate.lens,
        covariance: &estimate.lens_covariance,
        widening: check.split_half_ratio.map_or(1.0, |ratio| ratio.max(1.0)),
        image_size: problem.image_size,
    };
    GivenMisfit::of(&given, held, free).map_or(GivenCheck::Fits, GivenCheck::Contradicted)
}

/// `error`; or that the views contradict given parameters, if they fit without them.
fn of_given(
    error: EstimationError,
    problem: &CameraProblem,
    options: &CameraOptions,
) -> EstimationError {
    let is_of_views = matches!(
        error,
        EstimationError::NoFit
            | EstimationError::NoCameraMatrix
            | EstimationError::TooFewViews { .. }
            | EstimationError::Undetermined { .. }
            | EstimationError::OpenCoefficient { .. }
    );
    if !is_of_views {
        return error;
    }
    match check_of_given(problem, options, None) {
        GivenCheck::Contradicted(misfit) => misfit.parameters.first().map_or(error, |worst| {
            let GivenDifference { name, given, estimated, std } = *worst;
            EstimationError::Contradicted { name, given, estimated, std }
        }),
        _ => error,
    }
}

fn solve(
    problem: &CameraProblem,
    options: &CameraOptions,
) -> Result<(CameraEstimate, CameraFit), EstimationError> {
    check(problem)?;
    let solved = solve_twice(problem, options);
    let solved = solved.map_err(|error| of_lens_or_views(error, problem, options));
    // An interrupted solve has no result, and its error says nothing about the views.
    options.interrupt.check()?;
    solved
}

/// `error`; or, where these views do determine another lens model, an error that names the
/// undetermined coefficient of this one.
fn of_lens_or_views(
    error: EstimationError,
    problem: &CameraProblem,
    options: &CameraOptions,
) -> EstimationError {
    let (EstimationError::Undetermined { .. }, LensChoice::Model(model)) = (&error, options.lens)
    else {
        return error;
    };
    let Some(parameter) = model.facts().focal_coefficient else { return error };
    if options.given.iter().any(|given| given.name == parameter) {
        return error;
    }
    let shared = options.clone().without_given_coefficients(model);
    let any = CameraOptions { lens: LensChoice::Auto, start: None, ..shared };
    match solve_twice(problem, &any) {
        Ok((CameraEstimate { lens, .. }, _)) => {
            EstimationError::OpenCoefficient { model, parameter, instead: lens.model() }
        }
        Err(_) => error,
    }
}

/// More equal weights lower the rms. So a second solve whose rms is this many times that of the
/// first ended in another minimum.
const ANOTHER_MINIMUM_RATIO: f64 = 1.5;

/// Solves a second time, with the noise floor that the first solve shows.
fn solve_twice(
    problem: &CameraProblem,
    options: &CameraOptions,
) -> Result<(CameraEstimate, CameraFit), EstimationError> {
    let known_px = options.start.as_ref().map_or(0.0, |start| start.noise_floor_px);
    let (first, first_fit) = solve_weighted(problem, known_px, options, Minima::BothSides)?;
    let Some(noise_floor_px) = noise_floor_px_of(problem, &first) else {
        return Ok((first, first_fit));
    };
    let model = LensChoice::Model(first.lens.model());
    let again = CameraOptions { lens: model, start: Some(first.to_start()), ..options.clone() };
    match solve_weighted(problem, noise_floor_px, &again, Minima::Nearest) {
        Ok((estimate, _)) if estimate.rms_px > ANOTHER_MINIMUM_RATIO * first.rms_px => {
            Ok((first, first_fit))
        }
        Ok((mut estimate, mut fit)) => {
            if let Some(between_models) = first_fit.between_models {
                estimate.lens_covariance += &between_models;
                fit.between_models = Some(between_models);
            }
            let CameraEstimate { compared, other_minimum, .. } = first;
            Ok((CameraEstimate { compared, other_minimum, ..estimate }, fit))
        }
        Err(_) => Ok((first, first_fit)),
    }
}

/// Which minima of the cost are searched for.
#[derive(Clone, Copy, PartialEq)]
enum Minima {
    /// The one that iterations from the start reach.
    Nearest,
    /// Where the model may have two, the closer fit
    /// ([`crate::estimation::lens_choice::other_minimum`]).
    BothSides,
}

/// As [`solve`], with `noise_floor_px` added to every corner's own standard deviation, in
/// quadrature.
fn solve_weighted(
    problem: &CameraProblem,
    noise_floor_px: f64,
    options: &CameraOptions,
    minima: Minima,
) -> Result<(CameraEstimate, CameraFit), EstimationError> {
    let problem = &*with_noise_floor(problem, noise_floor_px);
    let mut prepared = Prepared::of(problem);
    prepared.name_copies(options);
    if let Some(board) = &options.measured_board {
        prepared.place_on(board)?;
    }
    let (fit, compared, other_minimum) = match options.lens {
        LensChoice::Model(model) => {
            let plain = fit_camera(&mut prepared, model, options)?;
            let (plain, other) = match minima {
                Minima::Nearest => (plain, None),
                Minima::BothSides => closer_of_two_minima(plain, &prepared),
            };
            (FitWithEffects::of(plain, &mut prepared, options).full, Vec::new(), other)
        }
        LensChoice::Auto => {
            let ChosenLens { fit, compared } = choose_lens(&mut prepared, options)?;
            (fit.full, compared, None)
        }
    };
    Ok((
        CameraEstimate {
            noise_floor_px,
            compared,
            other_minimum,
            ..assemble(problem, &prepared, &fit, FitCovariance::of(&fit).as_ref(), Part::WHOLE)?
        },
        fit,
    ))
}
