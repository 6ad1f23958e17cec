//! The search for the next view to ask for, whatever views are to teach: of all candidates that
//! lower the goal about as far as the best one, the one that is nearest to how the board is held
//! now; and how many more such views the goal takes.
//!
//! What differs is a [`Lesson`]: one camera's lens (`next_view`), two cameras together
//! (`next_shared_view`), depth beside color (`next_depth_view`).

use nalgebra::Point3;

use crate::calibration::information::candidate_views::{Holding, effort};
use crate::geometry::pose::Pose;

/// What views are to teach.
pub(super) trait Lesson {
    /// A board that is held somewhere, as it is seen wherever it has to be.
    type View;
    /// What a view adds to what is known.
    type Information;
    /// What is known.
    type Known: Clone;

    /// How many images the board can be placed in.
    const IMAGES: usize = 1;
    /// So many of the coming views may add to what is to be known; 0 where none does.
    const COMING: usize = 0;

    /// What is known now.
    fn known(&self) -> &Self::Known;

    /// The view of a board that is held so in one of the images; `None` where it cannot be asked
    /// for.
    fn view(&self, image: usize, holding: &Holding) -> Option<LessonCandidate<Self::View>>;

    /// What it would add; `None` where it says nothing.
    fn information(&self, view: &Self::View) -> Option<Self::Information>;

    /// What is known with this part of a view.
    fn after(&self, known: &Self::Known, view: &Self::Information, part: f64) -> Self::Known;

    /// How uncertain that leaves what is to be known; `None` where it leaves something open.
    fn uncertainty_px(&self, known: &Self::Known) -> Option<LessonFigures>;

    /// The same once that view is kept: there may be more to know then.
    fn kept(&self, known: Self::Known, _view: &Self::Information) -> Self::Known {
        known
    }

    /// The board's middle in its own frame.
    fn middle(&self) -> Point3<f64>;
}

/// An uncertainty, in pixels.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct LessonFigures {
    /// What the goal is stated in.
    pub(super) figure: f64,
    /// What views are compared by.
    pub(super) criterion: f64,
}

/// A view that can be asked for.
#[derive(Debug, Clone)]
pub(super) struct LessonCandidate<View> {
    pub(super) view: View,
    /// Where the board would be before the first camera.
    pub(super) camera_from_board: Pose,
    /// How likely it is seen when hands hold it about there.
    pub(super) likely: f64,
}

/// What is asked for.
pub(super) struct FoundView<L: Lesson> {
    pub(super) view: L::View,
    pub(super) information: L::Information,
    /// How many more views reach the goal: as few as this if each is as suggested and there is no
    /// more to know than now; as many as that if each teaches a quarter as much, or if all that
    /// coming ones add is to be known too, whichever takes longer. `None` without a goal.
    pub(super) views_to_go: Option<[u32; 2]>,
}

/// How many candidates are tried.
#[derive(Debug, Clone, Copy)]
pub(super) struct SearchSize {
    /// Of the sequence that fills all of them evenly, in each image.
    pub(super) sequence: usize,
    /// In the image's corners, where lenses are known worst.
    pub(super) in_corners: usize,
    /// Around the best of them, within this part of the range.
    pub(super) refined: [(usize, f64); 2],
}

/// Candidates whose drop of the goal is at least this part of the best one's are as good.
const AS_GOOD: f64 = 0.9;
/// Of so many candidates the coming views are taken in counting them: out of the better half,
/// since views that are much like the best leave open what it leaves open.
const SHORTLIST: usize = 12;
/// So many views are gone through one by one; beyond, information grows by as much with each.
const COUNTED: u32 = 12;
/// So many views are none that anybody shows.
const UNREACHABLE: u32 = 1_000_000;
/// How much coming views teach at least, relative to what is expected of them: a quarter where they
/// are held otherwise, or where corners and planes scatter twice as far as few views let expect.
const LEAST_PART: f64 = 0.25;

struct ScoredView<L: Lesson> {
    candidate: LessonCandidate<L::View>,
    /// Which image the board is placed in, and how it is held there.
    placed: (usize, Holding),
    information: L::Information,
    /// The drop of the goal's criterion that is to be expected of hands.
    score: f64,
}

/// The next view to ask for; `from` is where the board is now before the first camera and
/// `goal_px` the figure to reach. `None` where no view can be asked for.
pub(super) fn find_view<L: Lesson>(
    lesson: &L,
    size: &SearchSize,
    from: Option<&Pose>,
    goal_px: Option<f64>,
) -> Option<FoundView<L>> {
    let now_px = lesson.uncertainty_px(lesson.known())?.criterion;
    let score = |image: usize, holding: &Holding| -> Option<ScoredView<L>> {
        let candidate = lesson.view(image, holding)?;
        let information = lesson.information(&candidate.view)?;
        let after = lesson.uncertainty_px(&lesson.after(lesson.known(), &information, 1.0))?;
        let drop = 1.0 - after.criterion / now_px.max(f64::MIN_POSITIVE);
        let score = candidate.likely * drop;
        Some(ScoredView { candidate, placed: (image, *holding), information, score })
    };
    let mut scored: Vec<ScoredView<L>> = Vec::new();
    for image in 0..L::IMAGES {
        let sequence = (0..size.sequence).map(Holding::of_sequence);
        let all = sequence.chain((0..size.in_corners).map(Holding::in_corner));
        scored.extend(all.filter_map(|holding| score(image, &holding)));
    }
    for (count, step) in size.refined {
        let best = scored.iter().max_by(|a, b| a.score.total_cmp(&b.score))?;
        let (image, holding) = best.placed;
        scored.extend((0..count).filter_map(|index| score(image, &holding.near(index, step))));
    }
    scored.sort_by(|a, b| b.score.total_cmp(&a.score));
    let least = AS_GOOD * scored.first()?.score;
    let as_good = scored.iter().take_while(|scored| scored.score >= least);
    let effort = |scored: &ScoredView<L>| {
        let there = &scored.candidate.camera_from_board;
        from.map_or(0.0, |from| effort(from, there, lesson.middle()))
    };
    let by_effort = |(_, a): &(usize, &ScoredView<L>), (_, b): &(usize, &ScoredView<L>)| {
        effort(a).total_cmp(&effort(b))
    };
    let chosen = as_good.enumerate().min_by(by_effort)?.0;
    let stride = (scored.len() / 2 / SHORTLIST).max(1);
    let shortlist = scored.iter().step_by(stride).take(SHORTLIST);
    let shortlist: Vec<&L::Information> = shortlist.map(|scored| &scored.information).collect();
    let views_to_go = goal_px.map(|goal_px| {
        let begin = || lesson.known().clone();
        let grown = grown(lesson, &shortlist);
        let count =
            |known: L::Known, part: f64| views_to_go(lesson, known, &shortlist, part, goal_px);
        let few = count(begin(), 1.0);
        [few, few.max(count(begin(), LEAST_PART)).max(count(grown, 1.0))]
    });
    let ScoredView { candidate, information, .. } = scored.swap_remove(chosen);
    Some(FoundView { view: candidate.view, information, views_to_go })
}

/// What is known, and all that the views which would be asked for next add to what is to be known.
fn grown<L: Lesson>(lesson: &L, shortlist: &[&L::Information]) -> L::Known {
    let (mut known, mut grown) = (lesson.known().clone(), lesson.known().clone());
    for _ in 0..L::COMING {
        let Some((view, after)) = best_after(lesson, &known, shortlist, 1.0) else { break };
        known = lesson.kept(after, view);
        grown = lesson.kept(grown, view);
    }
    grown
}

/// The view that this part of lowers the criterion most, with what is known after it.
fn best_after<'a, L: Lesson>(
    lesson: &L,
    known: &L::Known,
    views: &[&'a L::Information],
    part: f64,
) -> Option<(&'a L::Information, L::Known)> {
    let after = views.iter().copied().filter_map(|view| {
        let after = lesson.after(known, view, part);
        Some((lesson.uncertainty_px(&after)?.criterion, view, after))
    });
    after.min_by(|a, b| a.0.total_cmp(&b.0)).map(|(_, view, after)| (view, after))
}

/// How many views out of `shortlist`, each with this part of its information and each the best at
/// its next step, reach the goal from what is `known`.
fn views_to_go<L: Lesson>(
    lesson: &L,
    mut known: L::Known,
    shortlist: &[&L::Information],
    part: f64,
    goal_px: f64,
) -> u32 {
    let figures = |known: &L::Known| lesson.uncertainty_px(known);
    let mut figures_px: Vec<f64> = figures(&known).map(|px| px.figure).into_iter().collect();
    for count in 0..=COUNTED {
        if figures_px.last().is_none_or(|now_px| *now_px <= goal_px) {
            return count;
        }
        let Some((_, after)) = best_after(lesson, &known, shortlist, part) else {
            return UNREACHABLE;
        };
        known = after;
        figures_px.extend(figures(&known).map(|px| px.figure));
    }
    COUNTED + more_views(&figures_px, goal_px)
}

/// How many more views reach the goal if information grows by as much with each as it did lately;
/// `figures_px` are those after each view so far.
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
