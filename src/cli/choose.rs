//! `plumb calibrate --choose N` and `--order`: selects the images of a pool with the most
//! information.

use serde::Serialize;

use crate::calibration::information::pool::{Pool, PoolStep, SuggestedNext};
use crate::calibration::information::projection_goal::GoalFigure;
use crate::calibration::result::CalibratedView;
use crate::calibration::solve::{SolvedCamera, solve_views};
use crate::cli::gather::unused;
use crate::cli::{Failure, output};
use crate::document::pose::PoseDocument;
use crate::estimation::camera::{CameraEstimate, CameraOptions, calibrate_camera};
use crate::estimation::problem::{CameraProblem, LensChoice};
use crate::estimation::relabeled::RelabeledProblem;
use crate::geometry::target::Target;

/// Which images of many to take.
#[derive(Debug, clap::Args)]
pub struct ChooseArgs {
    /// Calibrate from the N images that are together the most informative.
    #[arg(long, value_name = "N", conflicts_with = "order",
        value_parser = clap::value_parser!(u32).range(3..))]
    choose: Option<u32>,
    /// Instead of the calibration, print the images in order of information gain (each given those
    /// before it), and the most informative next view.
    #[arg(long, conflicts_with_all = ["out", "format"])]
    order: bool,
}

/// An image that reduces the uncertainty by a smaller fraction than this is called uninformative:
/// it would be printed as 0 %.
const SEEN_GAIN: f64 = 0.005;

/// A problem's images: its views, and the others with their positions.
pub type ViewsAndOthers = (CameraProblem, Vec<(usize, CalibratedView)>);

/// The order of a pool's images, as printed.
#[derive(Debug, Serialize)]
struct OrderDocument {
    /// The most informative image comes first.
    order: Vec<ImageGainDocument>,
    /// The view that would add the most information to all of them.
    next: Option<NextDocument>,
}

/// The information of one image.
#[derive(Debug, Serialize)]
struct ImageGainDocument {
    name: String,
    /// The worst projection uncertainty over the image, from this image and those before it, in
    /// pixels.
    uncertainty_px: f64,
    /// The fraction by which it reduced the uncertainty, 0 to 1.
    gain: f64,
}

/// A view that would add more information.
#[derive(Debug, Serialize)]
struct NextDocument {
    message: String,
    target_pose: PoseDocument,
    uncertainty_px: f64,
    expected_uncertainty_px: f64,
}

impl ChooseArgs {
    /// Whether either option was given.
    pub fn is_asked(&self) -> bool {
        self.choose.is_some() || self.order
    }

    /// # Errors
    /// When either option was given; `what` is what it cannot be used for.
    pub fn refuse(&self, what: &str) -> Result<(), Failure> {
        if self.is_asked() {
            return Err(Failure::usage(format!(
                "--choose and --order work for images of a single camera, not for {what}: remove these options"
            )));
        }
        Ok(())
    }

    /// The images of `target` to calibrate from, and the lens model; `None` if the order was
    /// printed instead.
    ///
    /// # Errors
    /// When the images do not determine the lens, or stdout is closed.
    pub fn pick(
        &self,
        (problem, others): ViewsAndOthers,
        target: &Target,
        options: &CameraOptions,
        json: bool,
    ) -> Result<Option<(ViewsAndOthers, CameraOptions)>, Failure> {
        if !self.is_asked() {
            return Ok(Some(((problem, others), options.clone())));
        }
        let alike = RelabeledProblem::labeled_alike(&problem, &target.symmetries(), options);
        let problem = alike.map_or(problem, |alike| alike.problem);
        let Some(count) = self.choose else {
            let solved = solve_views(&problem, options).map_err(Failure::failed)?;
            return print_order(&problem, &solved, json).map(|()| None);
        };
        let estimate = calibrate_camera(&problem, options).map_err(Failure::failed)?;
        let pool = Pool::of(&problem, &estimate, GoalFigure::Worst);
        let chosen = pool.choose(count as usize);
        // A few images do not discriminate between lens models as well as all of them.
        let lens = LensChoice::Model(estimate.lens.model());
        let options = CameraOptions { lens, ..options.clone() };
        Ok(Some((chosen_images((problem, others), &estimate, &pool, &chosen), options)))
    }
}

/// The chosen views as the problem; the others with the uncertainty reduction that each would give.
fn chosen_images(
    (problem, others): ViewsAndOthers,
    estimate: &CameraEstimate,
    pool: &Pool,
    chosen: &[usize],
) -> ViewsAndOthers {
    let together_px = pool.uncertainty_px(chosen);
    let mut images: Vec<Result<_, CalibratedView>> = Vec::new();
    for (at, view) in problem.views.into_iter().enumerate() {
        if chosen.contains(&at) {
            images.push(Ok(view));
            continue;
        }
        let with_it = || pool.uncertainty_px(&[chosen, &[at]].concat());
        let reason = estimate.views[at]
            .fault
            .map_or_else(|| not_chosen(1.0 - with_it() / together_px), |fault| fault.to_string());
        images.push(Err(unused(view.name, &reason)));
    }
    for (place, other) in others {
        images.insert(place.min(images.len()), Err(other));
    }
    let (mut views, mut left) = (Vec::new(), Vec::new());
    for (place, image) in images.into_iter().enumerate() {
        match image {
            Ok(view) => views.push(view),
            Err(other) => left.push((place, other)),
        }
    }
    (CameraProblem { views, ..problem }, left)
}

/// The reason for leaving out an image that would reduce the uncertainty by the fraction `gain`.
/// This is predicted from its corners, under the assumption that all images have the same noise; if
/// an image has larger residuals, the solve with it is more conclusive.
fn not_chosen(gain: f64) -> String {
    if !(gain >= SEEN_GAIN) {
        return "not chosen: it adds little information to the chosen images".to_owned();
    }
    format!(
        "not chosen: it would lower the uncertainty by {:.0} %, if its residuals are as small as the others'",
        100.0 * gain
    )
}

/// Prints the order of a problem's images. The uncertainty from all of them is the one that their
/// calibration states. If effects other than the noise of corners (differences between images, a
/// board that is not flat) increase it, the figures of fewer images are increased by the same
/// factor.
fn print_order(problem: &CameraProblem, solved: &SolvedCamera, json: bool) -> Result<(), Failure> {
    let estimate = &solved.estimate;
    let stated_px = solved.sensor.uncertainty_px.worst;
    let order = Pool::of(problem, estimate, GoalFigure::Worst).order();
    let wider = order.last().map_or(1.0, |last| stated_px / last.after_px);
    let with_gain = |step: &PoolStep| ImageGainDocument {
        name: problem.views[step.view].name.clone(),
        uncertainty_px: wider * step.after_px,
        gain: 1.0 - step.after_px / step.before_px,
    };
    let next = SuggestedNext::of(problem, estimate).and_then(|SuggestedNext { view, message }| {
        Some(NextDocument {
            message,
            target_pose: (&view.camera_from_board).into(),
            uncertainty_px: stated_px,
            expected_uncertainty_px: stated_px * view.expected_uncertainty_px?
                / view.uncertainty_px,
        })
    });
    let document = OrderDocument { order: order.iter().map(with_gain).collect(), next };
    if json {
        return output::print_json(&document);
    }
    let mut lines: Vec<String> = (document.order.iter().enumerate())
        .map(|(place, image)| {
            let ImageGainDocument { name, uncertainty_px, gain } = image;
            let less = if *gain < SEEN_GAIN {
                "adds little".to_owned()
            } else {
                format!("{:.1} % less", 100.0 * gain)
            };
            format!("{:>4} {uncertainty_px:>10.3} px worst {less:>14}  {name}", place + 1)
        })
        .collect();
    lines.extend(document.next.map(|next| {
        let NextDocument { message, uncertainty_px, expected_uncertainty_px, .. } = next;
        format!("next: {message}: worst uncertainty {expected_uncertainty_px:.3} px instead of {uncertainty_px:.3} px")
    }));
    output::print_line(&lines.join("\n"))
}
