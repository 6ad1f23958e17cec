//! The search for the next view to suggest, whatever the views are to determine. Of all candidates
//! that lower the goal about as much as the best one, it takes the one nearest to the board's
//! present pose; and it counts how many more such views the goal takes.
//!
//! An [`Objective`] states what is to be determined: one camera's lens (`next_view`), a pair of
//! cameras (`next_shared_view`), depth beside color (`next_depth_view`).

use nalgebra::Point3;

use crate::calibration::information::candidate_views::{PlacementInImage, effort};
use crate::geometry::pose::Pose;

/// What the views are to determine.
pub(super) trait Objective {
    /// A board at some pose, as each camera involved sees it.
    type View;
    /// What a view adds to the present information.
    type Information;
    /// The present information.
    type Known: Clone;

    /// The number of images that the board can be placed in.
    const IMAGES: usize = 1;
    /// How many of the coming views may extend the goal; 0 where none does.
    const COMING: usize = 0;

    /// The present information.
    fn known(&self) -> &Self::Known;

    /// The view of a board that is held like this in one of the images; `None` where it cannot be
    /// suggested.
    fn view(
        &self,
        image: usize,
        placement: &PlacementInImage,
    ) -> Option<ObjectiveCandidate<Self::View>>;

    /// What it would add; `None` where its corners do not determine the pose of the board.
    fn information(&self, view: &Self::View) -> Option<Self::Information>;

    /// The information `known`, with the fraction `part` of that in a view added.
    fn after(&self, known: &Self::Known, view: &Self::Information, part: f64) -> Self::Known;

    /// The uncertainty that remains; `None` where something is undetermined.
    fn uncertainty_px(&self, known: &Self::Known) -> Option<ObjectiveValues>;

    /// The same once that view is kept, which may extend the goal.
    fn kept(&self, known: Self::Known, _view: &Self::Information) -> Self::Known {
        known
    }

    /// The board's middle in its own frame.
    fn middle(&self) -> Point3<f64>;
}

/// An uncertainty, in pixels.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct ObjectiveValues {
    /// The figure that the goal is stated in.
    pub(super) figure: f64,
    /// The criterion that views are compared by.
    pub(super) criterion: f64,
}

/// A view that could be suggested.
#[derive(Debug, Clone)]
pub(super) struct ObjectiveCandidate<View> {
    pub(super) view: View,
    /// The board's pose in the first camera.
    pub(super) camera_from_board: Pose,
    /// The probability that it is visible when it is held by hand near this pose.
    pub(super) visibility: f64,
}

/// The view to suggest.
pub(super) struct FoundView<L: Objective> {
    pub(super) view: L::View,
    pub(super) information: L::Information,
    /// How many more views reach the goal. The first number holds if each is as suggested and the
    /// goal is not extended. The second is the larger of two counts: if each view adds a quarter of
    /// that information, and if the goal is extended by all that the coming views add. `None`
    /// without a goal.
    pub(super) views_to_go: Option<[u32; 2]>,
}

/// The number of candidates that are tried.
#[derive(Debug, Clone, Copy)]
pub(super) struct SearchSize {
    /// Of the evenly distributed sequence, in each image.
    pub(super) sequence: usize,
    /// In the image's corners, where lenses are least known.
    pub(super) in_corners: usize,
    /// Around the best one, within this fraction of the range.
    pub(super) refined: [(usize, f64); 2],
}

/// A candidate is as good as the best one if its drop of the goal is at least this fraction of the
/// best one's.
const AS_GOOD: f64 = 0.9;
/// Candidates from which the coming views are taken for the count. They are spread over the better
/// half, since views much like the best one leave the same things undetermined.
const SHORTLIST: usize = 12;
/// Views that are counted one by one; beyond, information is taken to grow linearly.
const COUNTED: u32 = 12;
/// A count that means "never".
const UNREACHABLE: u32 = 1_000_000;
/// The least information that coming views add, relative to what is expected of them: a quarter if
/// they are held differently, or if corners and planes scatter twice as much as few views suggest.
const LEAST_PART: f64 = 0.25;

struct ScoredView<L: Objective> {
    candidate: ObjectiveCandidate<L::View>,
    /// The image that the board is placed in, and how it is held there.
    placed: (usize, PlacementInImage),
    information: L::Information,
    /// The expected drop of the goal's criterion, given that hands miss.
    score: f64,
}

/// The next view to suggest; `from` is the board's present pose in the first camera, and `goal_px`
/// the uncertainty to reach. `None` where no view can be suggested.
pub(super) fn find_view<L: Objective>(
    objective: &L,
    size: &SearchSize,
    from: Option<&Pose>,
    goal_px: Option<f64>,
) -> Option<FoundView<L>> {
    let now_px = objective.uncertainty_px(objective.known())?.criterion;
    let score = |image: usize, placement: &PlacementInImage| -> Option<ScoredView<L>> {
        let candidate = objective.view(image, placement)?;
        let information = objective.information(&candidate.view)?;
        let after =
            objective.uncertainty_px(&objective.after(objective.known(), &information, 1.0))?;
        let drop = 1.0 - after.criterion / now_px.max(f64::MIN_POSITIVE);
        let score = candidate.visibility * drop;
        Some(ScoredView { candidate, placed: (image, *placement), information, score })
    };
    let mut scored: Vec<ScoredView<L>> = Vec::new();
    for image in 0..L::IMAGES {
        let sequence = (0..size.sequence).map(PlacementInImage::of_sequence);
        let all = sequence.chain((0..size.in_corners).map(PlacementInImage::in_corner));
        scored.extend(all.filter_map(|placement| score(image, &placement)));
    }
    for (count, step) in size.refined {
        let best = scored.iter().max_by(|a, b| a.score.total_cmp(&b.score))?;
        let (image, placement) = best.placed;
        scored.extend((0..count).filter_map(|index| score(image, &placement.near(index, step))));
    }
    scored.sort_by(|a, b| b.score.total_cmp(&a.score));
    let least = AS_GOOD * scored.first()?.score;
    let as_good = scored.iter().take_while(|scored| scored.score >= least);
    let effort = |scored: &ScoredView<L>| {
        let there = &scored.candidate.camera_from_board;
        from.map_or(0.0, |from| effort(from, there, objective.middle()))
    };
    let by_effort = |(_, a): &(usize, &ScoredView<L>), (_, b): &(usize, &ScoredView<L>)| {
        effort(a).total_cmp(&effort(b))
    };
    let chosen = as_good.enumerate().min_by(by_effort)?.0;
    let stride = (scored.len() / 2 / SHORTLIST).max(1);
    let shortlist = scored.iter().step_by(stride).take(SHORTLIST);
    let shortlist: Vec<&L::Information> = shortlist.map(|scored| &scored.information).collect();
    let views_to_go = goal_px.map(|goal_px| {
        let begin = || objective.known().clone();
        let grown = grown(objective, &shortlist);
        let count =
            |known: L::Known, part: f64| views_to_go(objective, known, &shortlist, part, goal_px);
        let few = count(begin(), 1.0);
        [few, few.max(count(begin(), LEAST_PART)).max(count(grown, 1.0))]
    });
    let ScoredView { candidate, information, .. } = scored.swap_remove(chosen);
    Some(FoundView { view: candidate.view, information, views_to_go })
}

/// The present information, with the goal extended by all that the views to be suggested next add.
fn grown<L: Objective>(objective: &L, shortlist: &[&L::Information]) -> L::Known {
    let (mut known, mut grown) = (objective.known().clone(), objective.known().clone());
    for _ in 0..L::COMING {
        let Some((view, after)) = best_after(objective, &known, shortlist, 1.0) else { break };
        known = objective.kept(after, view);
        grown = objective.kept(grown, view);
    }
    grown
}

/// The view of which the fraction `part` lowers the criterion most, with the information after it.
fn best_after<'a, L: Objective>(
    objective: &L,
    known: &L::Known,
    views: &[&'a L::Information],
    part: f64,
) -> Option<(&'a L::Information, L::Known)> {
    let after = views.iter().copied().filter_map(|view| {
        let after = objective.after(known, view, part);
        Some((objective.uncertainty_px(&after)?.criterion, view, after))
    });
    after.min_by(|a, b| a.0.total_cmp(&b.0)).map(|(_, view, after)| (view, after))
}

/// How many views out of `shortlist` reach the goal from `known`; each adds the fraction `part` of
/// its information, and each is the best one at its step.
fn views_to_go<L: Objective>(
    objective: &L,
    mut known: L::Known,
    shortlist: &[&L::Information],
    part: f64,
    goal_px: f64,
) -> u32 {
    let figures = |known: &L::Known| objective.uncertainty_px(known);
    let mut figures_px: Vec<f64> = figures(&known).map(|px| px.figure).into_iter().collect();
    for count in 0..=COUNTED {
        if figures_px.last().is_none_or(|now_px| *now_px <= goal_px) {
            return count;
        }
        let Some((_, after)) = best_after(objective, &known, shortlist, part) else {
            return UNREACHABLE;
        };
        known = after;
        figures_px.extend(figures(&known).map(|px| px.figure));
    }
    COUNTED + more_views(&figures_px, goal_px)
}

/// How many more views reach the goal if each adds as much information as the latest did on
/// average; `figures_px` are the figures after each view so far.
fn more_views(figures_px: &[f64], goal_px: f64) -> u32 {
    let middle = figures_px.len() / 2;
    let [before, last] = [figures_px[middle], figures_px[figures_px.len() - 1]].map(|f| f.powi(-2));
    let each = (last - before) / (figures_px.len() - 1 - middle) as f64;
    let more = (goal_px.powi(-2) - last) / each;
    if more.is_finite() {
        more.ceil().clamp(1.0, f64::from(UNREACHABLE)) as u32
    } else {
        UNREACHABLE
    }
}
