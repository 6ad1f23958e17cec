//! Which images of a pool to take: a greedy order, in which each image adds most to those before
//! it.

use nalgebra::DMatrix;

use crate::calibration::information::candidate_views::{
    BoardPoints, CandidateSpace, base_rotation,
};
use crate::calibration::information::corner_noise::{CornerNoise, NoiseSample, side_px};
use crate::calibration::information::lens_information::LensInformation;
use crate::calibration::information::movement::description;
use crate::calibration::information::next_view::{SuggestedView, suggest_view};
use crate::calibration::information::projection_goal::{GoalFigure, ProjectionGoal};
use crate::calibration::information::view_information::{WeightedCorner, view_information};
use crate::estimation::camera::{CameraEstimate, ViewEstimate};
use crate::estimation::problem::{BoardView, CameraProblem};

/// One image of the order.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PoolStep {
    /// Its index among the problem's views.
    pub view: usize,
    /// The uncertainty without it, in pixels; without any view, that of the prior.
    pub before_px: f64,
    /// The same with it.
    pub after_px: f64,
}

/// The information of the views of a pool, at the estimate from all of them.
#[derive(Debug, Clone)]
pub struct Pool {
    nothing: LensInformation,
    goal: ProjectionGoal,
    /// Each usable view, with its information.
    views: Vec<(usize, DMatrix<f64>)>,
}

impl Pool {
    /// The pool of all views of a problem, with its estimate.
    pub fn of(problem: &CameraProblem, estimate: &CameraEstimate, figure: GoalFigure) -> Self {
        let nothing = LensInformation::prior(estimate.lens, estimate.image_size);
        let goal = ProjectionGoal::new(&estimate.lens, estimate.image_size, figure);
        let views = problem.views.iter().zip(&estimate.views).enumerate();
        let views = views
            .filter_map(|(at, (view, placed))| {
                Some((at, information_in(estimate, &nothing.free, view, placed)?))
            })
            .collect();
        Self { nothing, goal, views }
    }

    /// The views in greedy order: each is the one that most lowers the goal, given those before it.
    /// Views that the estimate did not use are left out.
    pub fn order(&self) -> Vec<PoolStep> {
        let mut left: Vec<&(usize, DMatrix<f64>)> = self.views.iter().collect();
        let mut known = self.nothing.clone();
        let mut before_px = self.figure(&known);
        let mut steps = Vec::with_capacity(left.len());
        while let Some((at, after_px, after)) = left
            .iter()
            .enumerate()
            .map(|(at, (_, view))| (at, known.with(view)))
            .map(|(at, after)| (at, self.figure(&after), after))
            .min_by(|a, b| a.1.total_cmp(&b.1))
        {
            let (view, _) = left.remove(at);
            steps.push(PoolStep { view: *view, before_px, after_px });
            (known, before_px) = (after, after_px);
        }
        steps
    }

    /// The `count` views that together leave the lowest goal, as ascending indices. Starts from the
    /// first of [`Self::order`] and exchanges views one by one as long as that lowers the goal (V.
    /// V. Fedorov's exchange).
    pub fn choose(&self, count: usize) -> Vec<usize> {
        let mut chosen: Vec<usize> =
            self.order().iter().take(count).map(|step| step.view).collect();
        for _ in 0..MOST_EXCHANGES {
            let Some(exchanged) = self.exchanged(&chosen) else { break };
            chosen = exchanged;
        }
        chosen.sort_unstable();
        chosen
    }

    /// The uncertainty with these views together, in pixels.
    pub fn uncertainty_px(&self, views: &[usize]) -> f64 {
        self.figure(&self.together(views))
    }

    fn together(&self, views: &[usize]) -> LensInformation {
        let parts = self.views.iter().filter(|(view, _)| views.contains(view));
        parts.fold(self.nothing.clone(), |known, (_, part)| known.with(part))
    }

    /// The best exchange of a chosen view for another one; `None` if none lowers the goal.
    fn exchanged(&self, chosen: &[usize]) -> Option<Vec<usize>> {
        let now_px = self.uncertainty_px(chosen);
        let others = || self.views.iter().filter(|(view, _)| !chosen.contains(view));
        let exchanges = (0..chosen.len()).flat_map(|out| {
            let mut rest = chosen.to_vec();
            rest.remove(out);
            let without = self.together(&rest);
            let figures = others().map(move |(view, part)| {
                (self.figure(&without.with(part)), [&rest[..], &[*view]].concat())
            });
            figures.collect::<Vec<_>>()
        });
        let best = exchanges.min_by(|a, b| a.0.total_cmp(&b.0))?;
        (best.0 < BETTER * now_px).then_some(best.1)
    }

    fn figure(&self, known: &LensInformation) -> f64 {
        let figure =
            known.covariance().and_then(|covariance| self.goal.uncertainty_px(&covariance));
        figure.unwrap_or(f64::INFINITY)
    }
}

/// An exchange must lower the uncertainty to less than this fraction of its value: a smaller gain
/// is rounding.
const BETTER: f64 = 0.999;
const MOST_EXCHANGES: usize = 50;

/// The information of one view of an estimate on the parameters in `free`, with the noise that the
/// estimate found; `None` for an unused view.
pub fn information_in(
    estimate: &CameraEstimate,
    free: &[usize],
    view: &BoardView,
    placed: &ViewEstimate,
) -> Option<DMatrix<f64>> {
    let camera_from_board = placed.camera_from_board.filter(|_| placed.fault.is_none())?;
    let wider = estimate.noise * estimate.variance_inflation.sqrt();
    let used = view.correspondences.iter().zip(&placed.used).filter(|(_, used)| **used);
    let corners: Vec<WeightedCorner> = used
        .map(|(seen, _)| WeightedCorner {
            point_in_board: seen.point_in_board,
            std_px: wider * seen.std_px.hypot(estimate.noise_floor_px),
        })
        .collect();
    view_information(&estimate.lens, free, &camera_from_board, &corners)
}

/// The view that would add most to a whole pool.
#[derive(Debug, Clone, PartialEq)]
pub struct SuggestedNext {
    /// Its pose, and how much the worst projection uncertainty would fall.
    pub view: SuggestedView,
    /// The same in words.
    pub message: String,
}

/// Edge blur is not measured for a pool's images: that of a lens in focus is assumed.
const POOL_BLUR_PX: f64 = 0.8;

impl SuggestedNext {
    /// The view that an estimate of `problem` lacks most; `None` where none can be suggested.
    pub fn of(problem: &CameraProblem, estimate: &CameraEstimate) -> Option<Self> {
        let known = LensInformation::of_estimate(estimate)?;
        let board = BoardPoints::of_problem(problem)?;
        let noise = CornerNoise::learn(&noise_samples(problem, estimate, &board));
        let goal = ProjectionGoal::new(&estimate.lens, estimate.image_size, GoalFigure::Worst);
        let (lens, size) = (&estimate.lens, estimate.image_size);
        let seen_from_board = estimate.views.iter().find_map(|view| view.camera_from_board)?;
        let base = base_rotation(&seen_from_board);
        let space = CandidateSpace { lens, size, board: &board, noise: &noise, base, avoided: &[] };
        let view = suggest_view(&known, &goal, &space, None, None)?;
        let message = description(&space, &view.camera_from_board)?;
        Some(Self { view, message })
    }
}

fn noise_samples(
    problem: &CameraProblem,
    estimate: &CameraEstimate,
    board: &BoardPoints,
) -> Vec<NoiseSample> {
    let wider = estimate.noise * estimate.variance_inflation.sqrt();
    let sample = |(view, placed): (&BoardView, &ViewEstimate)| {
        let camera_from_board = placed.camera_from_board.filter(|_| placed.fault.is_none())?;
        let mut stds: Vec<f64> = (view.correspondences.iter())
            .map(|corner| wider * corner.std_px.hypot(estimate.noise_floor_px))
            .collect();
        stds.sort_unstable_by(f64::total_cmp);
        let middle = board.middle();
        Some(NoiseSample {
            std_px: *stds.get(stds.len() / 2)?,
            side_px: side_px(&estimate.lens, &camera_from_board, &middle, board.side_m)?,
            blur_px: POOL_BLUR_PX,
            distance_m: (camera_from_board * middle).coords.norm(),
        })
    };
    problem.views.iter().zip(&estimate.views).filter_map(sample).collect()
}
