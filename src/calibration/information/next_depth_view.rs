//! The next view to ask for so that color knows where it sees what depth measures: the one that
//! lowers that uncertainty most.

use crate::calibration::information::candidate_views::{CandidateView, Holding};
use crate::calibration::information::depth_information::DepthNormal;
use crate::calibration::information::depth_teaching::DepthTeaching;
use crate::calibration::information::next_view::{
    AS_GOOD, COUNTED, HALF_AS_MUCH, effort, more_views,
};
use crate::calibration::information::teaching::Teaching;
use crate::calibration::information::view_information::ViewNormal;
use crate::geometry::pose::Pose;

/// Where the board should be before color.
#[derive(Debug, Clone, PartialEq)]
pub struct NextDepthView {
    /// Where.
    pub camera_from_board: Pose,
    /// What color would learn of its own lens: the view's normal matrix.
    pub normal: ViewNormal,
    /// The figure of depth's pixels in color now, in pixels of color.
    pub uncertainty_px: f64,
    /// The same after that view.
    pub expected_uncertainty_px: f64,
    /// The relative drop of the goal's criterion, 0 to 1.
    pub drop: f64,
    /// How many such views reach the goal, as
    /// [`crate::calibration::information::next_view::SuggestedView::views_to_go`].
    pub views_to_go: Option<[u32; 2]>,
}

/// Candidates of the sequence, in the corners of the image, and around the best, within this part
/// of the range.
const CANDIDATES: usize = 80;
const IN_CORNERS: usize = 12;
const REFINED: [(usize, f64); 2] = [(10, 0.12), (10, 0.05)];
/// What is so near to a refused view is refused with it.
const NEAR_REFUSED: f64 = 0.3;
/// Of so many candidates the coming views are taken in counting them, one after another: out of
/// the better half, since views that are much like the best leave open what it leaves open.
const SHORTLIST: usize = 6;

struct ScoredDepthView {
    view: CandidateView,
    normal: ViewNormal,
    information: (nalgebra::DMatrix<f64>, Option<DepthNormal>),
    score: f64,
}

/// The next view to ask for; `color` is what depth was taught beside, and `goal_px` the figure to
/// reach. `None` as long as nothing is known of depth, or where no view can be asked for.
pub fn suggest_depth_view(
    depth: &DepthTeaching,
    color: &Teaching,
    goal_px: Option<f64>,
) -> Option<NextDepthView> {
    let now = depth.now()?;
    let noise = color.corner_noise();
    let space = color.space(&noise);
    let score = |holding: &Holding| -> Option<ScoredDepthView> {
        let view = space.view(holding)?;
        let is_refused = |refused| color.effort(refused, &view.camera_from_board) < NEAR_REFUSED;
        if depth.refused().iter().any(is_refused) {
            return None;
        }
        let normal = ViewNormal::of(space.lens, &view.camera_from_board, &view.corners);
        let information = depth.expected(color, (&view.camera_from_board, &normal))?;
        let after = now.known.with(&information.0, information.1.as_ref());
        let score = view.likely * now.drop(&now.goal.std_px(&after)?);
        Some(ScoredDepthView { view, normal, information, score })
    };
    let mut scored: Vec<ScoredDepthView> =
        (0..CANDIDATES).filter_map(|index| score(&Holding::of_sequence(index))).collect();
    scored.extend((0..IN_CORNERS).filter_map(|index| score(&Holding::in_corner(index))));
    for (count, step) in REFINED {
        let best = scored.iter().max_by(|a, b| a.score.total_cmp(&b.score))?.view.holding;
        scored.extend((0..count).filter_map(|index| score(&best.near(index, step))));
    }
    scored.sort_by(|a, b| b.score.total_cmp(&a.score));
    let least = AS_GOOD * scored.first()?.score;
    let from = color.views().last().map(|view| &view.camera_from_board);
    let effort = |scored: &ScoredDepthView| {
        from.map_or(0.0, |from| effort(from, &scored.view.camera_from_board, space.board.middle()))
    };
    let as_good = scored.iter().take_while(|scored| scored.score >= least);
    let chosen = as_good.min_by(|a, b| effort(a).total_cmp(&effort(b)))?;
    let stride = (scored.len() / 2 / SHORTLIST).max(1);
    let shortlist: Vec<&ScoredDepthView> = scored.iter().step_by(stride).take(SHORTLIST).collect();
    let views_to_go = goal_px.map(|goal_px| {
        [1.0, HALF_AS_MUCH].map(|part| views_to_go(depth, (&shortlist, part), goal_px))
    });
    let (of_color, of_depth) = &chosen.information;
    let after = now.goal.std_px(&now.known.with(of_color, of_depth.as_ref()))?;
    Some(NextDepthView {
        camera_from_board: chosen.view.camera_from_board,
        normal: chosen.normal.clone(),
        uncertainty_px: now.goal.figure_px(&now.std_px),
        expected_uncertainty_px: now.goal.figure_px(&after),
        drop: now.drop(&after),
        views_to_go,
    })
}

/// How many views reach the goal if those of `shortlist` come one after another, each with this
/// part of its information.
fn views_to_go(
    depth: &DepthTeaching,
    (shortlist, part): (&[&ScoredDepthView], f64),
    goal_px: f64,
) -> u32 {
    let Some(now) = depth.now() else { return u32::MAX };
    let (mut known, mut figures) = (now.known.clone(), Vec::new());
    for count in 0..=COUNTED {
        let Some(std_px) = now.goal.std_px(&known) else { return u32::MAX };
        let figure_px = now.goal.figure_px(&std_px);
        if figure_px <= goal_px {
            return count;
        }
        figures.push(figure_px);
        let (of_color, of_depth) = &shortlist[count as usize % shortlist.len()].information;
        let of_depth = of_depth.as_ref().map(|view| view.scaled(part));
        known = known.with(&(of_color * part), of_depth.as_ref());
    }
    more_views(&figures, goal_px).saturating_add(COUNTED)
}
