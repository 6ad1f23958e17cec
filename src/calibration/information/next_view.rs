//! The next view to ask for: the one that lowers the goal most, of those about as good the one that
//! is nearest to how the board is held now; and how many more views the goal takes.

use nalgebra::{DMatrix, Point3};

use crate::calibration::information::candidate_views::{CandidateSpace, CandidateView, Holding};
use crate::calibration::information::lens_information::LensInformation;
use crate::calibration::information::projection_goal::ProjectionGoal;
use crate::calibration::information::view_information::view_information;
use crate::estimation::uncertainty::CompensatedSamples;
use crate::geometry::pixel::Pixel;
use crate::geometry::pose::Pose;

/// A view to ask for.
#[derive(Debug, Clone, PartialEq)]
pub struct SuggestedView {
    /// Where the board should be.
    pub camera_from_board: Pose,
    /// Where its outer corners would be seen: the one at the board's least x and y first, then
    /// along x.
    pub outline_px: [Pixel; 4],
    /// The goal's figure now, in pixels.
    pub uncertainty_px: f64,
    /// The same after that view.
    pub expected_uncertainty_px: f64,
    /// By how much the goal's criterion would fall, as [`ProjectionGoal::drop`] has it.
    pub drop: f64,
    /// What it would add to what is known of the lens.
    pub information: DMatrix<f64>,
    /// How many more views reach the goal: as few as this if each is as suggested, as many as that
    /// if each teaches half as much. `None` without a goal.
    pub views_to_go: Option<[u32; 2]>,
}

/// Candidates of the sequence, and around the best of them, within this part of the range.
const CANDIDATES: usize = 112;
/// Candidates in the image's corners, where lenses are known worst.
const IN_CORNERS: usize = 24;
const REFINED: [(usize, f64); 2] = [(12, 0.12), (12, 0.05)];
/// Candidates whose drop of the goal is at least this part of the best one's are as good.
pub(super) const AS_GOOD: f64 = 0.9;
/// A hand carries a board by half its distance, or rotates it by a radian, in the same time.
const EFFORT_PER_DISTANCE: f64 = 2.0;
/// Of so many candidates the coming views are taken in counting them.
const SHORTLIST: usize = 12;
/// So many views are gone through one by one; beyond, information grows by as much with each.
pub(super) const COUNTED: u32 = 12;
/// What a view teaches that is not held as suggested, relative to one that is.
pub(super) const HALF_AS_MUCH: f64 = 0.5;

struct ScoredView {
    view: CandidateView,
    information: DMatrix<f64>,
    /// The drop of the goal's criterion that is to be expected of hands.
    score: f64,
}

/// The next view to ask for, with what is `known` of the lens; `from` is where the board is now and
/// `goal_px` the figure to reach. `None` where no view of the board can be asked for.
pub fn suggest_view(
    known: &LensInformation,
    goal: &ProjectionGoal,
    space: &CandidateSpace<'_>,
    (from, goal_px): (Option<&Pose>, Option<f64>),
) -> Option<SuggestedView> {
    let now = goal.map(&known.covariance()?)?;
    let near = goal.near(&now)?;
    let score = |holding: &Holding| -> Option<ScoredView> {
        let view = space.view(holding)?;
        let information =
            view_information(&known.lens, &known.free, &view.camera_from_board, &view.corners)?;
        let after = near.uncertainty(&known.covariance_with(&information)?);
        let score = view.likely * goal.drop(&now, &after);
        Some(ScoredView { view, information, score })
    };
    let mut scored: Vec<ScoredView> =
        (0..CANDIDATES).filter_map(|index| score(&Holding::of_sequence(index))).collect();
    scored.extend((0..IN_CORNERS).filter_map(|index| score(&Holding::in_corner(index))));
    for (count, step) in REFINED {
        let best = scored.iter().max_by(|a, b| a.score.total_cmp(&b.score))?.view.holding;
        scored.extend((0..count).filter_map(|index| score(&best.near(index, step))));
    }
    scored.sort_by(|a, b| b.score.total_cmp(&a.score));
    let least = AS_GOOD * scored.first()?.score;
    let as_good = scored.iter().take_while(|scored| scored.score >= least);
    let effort = |scored: &ScoredView| {
        from.map_or(0.0, |from| effort(from, &scored.view.camera_from_board, space.board.middle()))
    };
    let chosen = as_good.min_by(|a, b| effort(a).total_cmp(&effort(b)))?;
    let shortlist: Vec<&DMatrix<f64>> =
        scored.iter().step_by(3).take(SHORTLIST).map(|scored| &scored.information).collect();
    let views_to_go = goal_px.map(|goal_px| {
        [1.0, HALF_AS_MUCH]
            .map(|part| views_to_go(known, (goal, &near), (&shortlist, part), goal_px))
    });
    let after = goal.map(&known.covariance_with(&chosen.information)?)?;
    Some(SuggestedView {
        camera_from_board: chosen.view.camera_from_board,
        outline_px: space.outline_px(&chosen.view.camera_from_board)?,
        uncertainty_px: goal.figure_px(&now)?,
        expected_uncertainty_px: goal.figure_px(&after)?,
        drop: goal.drop(&now, &after),
        information: chosen.information.clone(),
        views_to_go,
    })
}

/// How far it is from one pose to another for a board with this middle, in rotations by a radian.
pub fn effort(here_from_board: &Pose, there_from_board: &Pose, middle: Point3<f64>) -> f64 {
    let poses = [here_from_board, there_from_board];
    let [here, there] = poses.map(|pose| (*pose * middle).coords);
    let translation = (there - here).norm() / here.norm().max(f64::MIN_POSITIVE);
    EFFORT_PER_DISTANCE * translation
        + here_from_board.rotation().angle_to(&there_from_board.rotation())
}

/// How many views out of `shortlist`, each with this part of its information and each the best at
/// its next step, reach the goal.
fn views_to_go(
    known: &LensInformation,
    (goal, near): (&ProjectionGoal, &CompensatedSamples),
    (shortlist, part): (&[&DMatrix<f64>], f64),
    goal_px: f64,
) -> u32 {
    let mut known = known.clone();
    let figure = |known: &LensInformation| {
        known.covariance().and_then(|covariance| goal.figure_px(&near.uncertainty(&covariance)))
    };
    let mut figures: Vec<f64> = figure(&known).into_iter().collect();
    for count in 0..=COUNTED {
        if figures.last().is_none_or(|now_px| *now_px <= goal_px) {
            return count;
        }
        let next = shortlist
            .iter()
            .map(|view| known.with(&(*view * part)))
            .filter_map(|after| Some((figure(&after)?, after)))
            .min_by(|a, b| a.0.total_cmp(&b.0));
        let Some((after_px, after)) = next else { return u32::MAX };
        figures.push(after_px);
        known = after;
    }
    COUNTED + more_views(&figures, goal_px)
}

/// How many more views reach the goal if information grows by as much with each as it did lately;
/// `figures_px` are those after each view so far.
pub(super) fn more_views(figures_px: &[f64], goal_px: f64) -> u32 {
    let middle = figures_px.len() / 2;
    let [before, last] = [figures_px[middle], figures_px[figures_px.len() - 1]].map(|f| f.powi(-2));
    let each = (last - before) / (figures_px.len() - 1 - middle) as f64;
    let more = (goal_px.powi(-2) - last) / each;
    if more.is_finite() { more.ceil().clamp(1.0, 1e6) as u32 } else { 1_000_000 }
}
