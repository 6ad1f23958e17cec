//! The next view to ask for that two cameras share: the one that lowers most how uncertain it is
//! where the second camera sees what the first one sees.

use nalgebra::DMatrix;

use crate::calibration::information::candidate_views::{CandidateSpace, CandidateView, Holding};
use crate::calibration::information::next_view::{
    AS_GOOD, COUNTED, HALF_AS_MUCH, effort, more_views,
};
use crate::calibration::information::pair_information::PairInformation;
use crate::calibration::information::transfer_goal::TransferGoal;
use crate::calibration::information::view_information::ViewNormal;
use crate::geometry::pose::Pose;

/// Where the board should be before two cameras.
#[derive(Debug, Clone, PartialEq)]
pub struct SharedView {
    /// Before the first and the second.
    pub camera_from_board: [Pose; 2],
    /// What each camera would learn of its own lens: the view's normal matrix.
    pub normals: [ViewNormal; 2],
    /// The figure of transferred pixels now, in pixels of the second camera.
    pub uncertainty_px: f64,
    /// The same after that view.
    pub expected_uncertainty_px: f64,
    /// The relative drop of [`TransferGoal::criterion_px`], 0 to 1.
    pub drop: f64,
    /// How many more such views reach the goal, as
    /// [`crate::calibration::information::next_view::SuggestedView::views_to_go`].
    pub views_to_go: Option<[u32; 2]>,
}

/// Candidates of the sequence for each camera, and in the corners of its image: many of them are
/// out of the other one's image.
const CANDIDATES: usize = 80;
const IN_CORNERS: usize = 12;
/// Around the best, within this part of the range.
const REFINED: [(usize, f64); 2] = [(8, 0.12), (8, 0.05)];
/// Of so many candidates the coming views are taken in counting them, one after another.
const SHORTLIST: usize = 6;

struct ScoredSharedView {
    /// Which camera's image the board is placed in.
    camera: usize,
    views: [CandidateView; 2],
    normals: [ViewNormal; 2],
    information: DMatrix<f64>,
    score: f64,
}

/// The next view to ask for of what both cameras see; `from` is where the board is now before the
/// first camera, and `goal_px` the figure to reach. `None` where no view of the board is seen by
/// both.
pub fn suggest_shared_view(
    known: &PairInformation,
    goal: &TransferGoal,
    spaces: [&CandidateSpace<'_>; 2],
    (from, goal_px): (Option<&Pose>, Option<f64>),
) -> Option<SharedView> {
    let now = goal.std_px(&known.matrix)?;
    let now_px = goal.criterion_px(&now);
    let drop = |after: &[f64]| 1.0 - goal.criterion_px(after) / now_px;
    let score = |camera: usize, holding: &Holding| -> Option<ScoredSharedView> {
        let own = spaces[camera].view(holding)?;
        let other_from_camera = [known.b_from_a, known.b_from_a.inverse()][camera];
        let place = other_from_camera * own.camera_from_board;
        let other = spaces[1 - camera].view_at(holding, place)?;
        let views = if camera == 0 { [own, other] } else { [other, own] };
        let normals = [0, 1].map(|k| {
            ViewNormal::of(spaces[k].lens, &views[k].camera_from_board, &views[k].corners)
        });
        let information = known.of_view([&normals[0], &normals[1]])?;
        let after = goal.std_px(&(&known.matrix + &information))?;
        let score = views[0].likely.min(views[1].likely) * drop(&after);
        Some(ScoredSharedView { camera, views, normals, information, score })
    };
    let mut scored: Vec<ScoredSharedView> = Vec::new();
    for camera in 0..2 {
        scored.extend(
            (0..CANDIDATES).filter_map(|index| score(camera, &Holding::of_sequence(index))),
        );
        scored
            .extend((0..IN_CORNERS).filter_map(|index| score(camera, &Holding::in_corner(index))));
    }
    for (count, step) in REFINED {
        let best = scored.iter().max_by(|a, b| a.score.total_cmp(&b.score))?;
        let (camera, holding) = (best.camera, best.views[best.camera].holding);
        scored.extend((0..count).filter_map(|index| score(camera, &holding.near(index, step))));
    }
    scored.sort_by(|a, b| b.score.total_cmp(&a.score));
    let least = AS_GOOD * scored.first()?.score;
    let as_good = scored.iter().take_while(|scored| scored.score >= least);
    let middle = spaces[0].board.middle();
    let effort = |scored: &ScoredSharedView| {
        from.map_or(0.0, |from| effort(from, &scored.views[0].camera_from_board, middle))
    };
    let chosen = as_good.min_by(|a, b| effort(a).total_cmp(&effort(b)))?;
    let shortlist: Vec<&DMatrix<f64>> =
        scored.iter().step_by(3).take(SHORTLIST).map(|scored| &scored.information).collect();
    let views_to_go = goal_px.map(|goal_px| {
        [1.0, HALF_AS_MUCH].map(|part| views_to_go((known, goal), (&shortlist, part), goal_px))
    });
    let after = goal.std_px(&(&known.matrix + &chosen.information))?;
    Some(SharedView {
        camera_from_board: [0, 1].map(|k| chosen.views[k].camera_from_board),
        normals: chosen.normals.clone(),
        uncertainty_px: goal.figure_px(&now),
        expected_uncertainty_px: goal.figure_px(&after),
        drop: drop(&after),
        views_to_go,
    })
}

/// How many views reach the goal if those of `shortlist` come one after another, each with this
/// part of its information.
fn views_to_go(
    (known, goal): (&PairInformation, &TransferGoal),
    (shortlist, part): (&[&DMatrix<f64>], f64),
    goal_px: f64,
) -> u32 {
    let mut matrix = known.matrix.clone();
    let mut figures = Vec::new();
    for count in 0..=COUNTED {
        let Some(std_px) = goal.std_px(&matrix) else { return u32::MAX };
        let figure_px = goal.figure_px(&std_px);
        if figure_px <= goal_px {
            return count;
        }
        figures.push(figure_px);
        matrix += shortlist[count as usize % shortlist.len()] * part;
    }
    more_views(&figures, goal_px).saturating_add(COUNTED)
}
