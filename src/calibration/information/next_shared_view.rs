//! The next view to suggest that two cameras share: the one that most lowers the uncertainty of
//! where the second camera sees what the first one sees.

use nalgebra::{DMatrix, Point3};

use crate::calibration::information::candidate_views::{CandidateSpace, PlacementInImage};
use crate::calibration::information::pair_information::PairInformation;
use crate::calibration::information::transfer_goal::TransferGoal;
use crate::calibration::information::view_information::ViewNormal;
use crate::calibration::information::view_search::{
    Objective, ObjectiveCandidate, ObjectiveValues, SearchSize, find_view,
};
use crate::geometry::pose::Pose;

/// The suggested pose of the board in two cameras.
#[derive(Debug, Clone, PartialEq)]
pub struct SharedView {
    /// Its pose in the first and in the second camera.
    pub camera_from_board: [Pose; 2],
    /// The view's normal matrix in each camera, for the information about that camera's own lens.
    pub normals: [ViewNormal; 2],
    /// The present uncertainty of transferred pixels, in pixels of the second camera.
    pub uncertainty_px: f64,
    /// The same after that view.
    pub expected_uncertainty_px: f64,
    /// The relative drop of [`TransferGoal::criterion_px`], 0 to 1.
    pub drop: f64,
    /// How many more such views reach the goal, as
    /// [`crate::calibration::information::next_view::SuggestedView::views_to_go`].
    pub views_to_go: Option<[u32; 2]>,
}

/// Many candidates of one camera are outside the other camera's image.
const SIZE: SearchSize =
    SearchSize { sequence: 80, in_corners: 12, refined: [(8, 0.12), (8, 0.05)] };

/// The search of a view for two cameras.
struct PairObjective<'a> {
    known: &'a PairInformation,
    goal: &'a TransferGoal,
    spaces: [&'a CandidateSpace<'a>; 2],
}

/// A board in front of both.
struct PairCandidate {
    camera_from_board: [Pose; 2],
    normals: [ViewNormal; 2],
}

impl Objective for PairObjective<'_> {
    type View = PairCandidate;
    type Information = DMatrix<f64>;
    type Known = DMatrix<f64>;

    const IMAGES: usize = 2;

    fn known(&self) -> &DMatrix<f64> {
        &self.known.matrix
    }

    fn view(
        &self,
        image: usize,
        placement: &PlacementInImage,
    ) -> Option<ObjectiveCandidate<PairCandidate>> {
        let own = self.spaces[image].view(placement)?;
        let other_from_camera = [self.known.b_from_a, self.known.b_from_a.inverse()][image];
        let other_from_board = other_from_camera * own.camera_from_board;
        let other = self.spaces[1 - image].view_at(placement, other_from_board)?;
        let visibility = own.visibility.min(other.visibility);
        let views = if image == 0 { [own, other] } else { [other, own] };
        let normals = [0, 1].map(|k| {
            ViewNormal::of(self.spaces[k].lens, &views[k].camera_from_board, &views[k].corners)
        });
        let camera_from_board = views.map(|view| view.camera_from_board);
        let first_from_board = camera_from_board[0];
        let view = PairCandidate { camera_from_board, normals };
        Some(ObjectiveCandidate { view, camera_from_board: first_from_board, visibility })
    }

    fn information(&self, view: &PairCandidate) -> Option<DMatrix<f64>> {
        self.known.of_view([&view.normals[0], &view.normals[1]])
    }

    fn after(&self, known: &DMatrix<f64>, view: &DMatrix<f64>, part: f64) -> DMatrix<f64> {
        known + view * part
    }

    fn uncertainty_px(&self, known: &DMatrix<f64>) -> Option<ObjectiveValues> {
        let std_px = self.goal.std_px(known)?;
        let (figure, criterion) = (self.goal.figure_px(&std_px), self.goal.criterion_px(&std_px));
        Some(ObjectiveValues { figure, criterion })
    }

    fn middle(&self) -> Point3<f64> {
        self.spaces[0].board.middle()
    }
}

/// The next shared view to suggest; `from` is the present pose of the board in the first camera,
/// and `goal_px` the uncertainty to reach. `None` where no view of the board is visible in both.
pub fn suggest_shared_view(
    known: &PairInformation,
    goal: &TransferGoal,
    spaces: [&CandidateSpace<'_>; 2],
    (from, goal_px): (Option<&Pose>, Option<f64>),
) -> Option<SharedView> {
    let objective = PairObjective { known, goal, spaces };
    let now = objective.uncertainty_px(&known.matrix)?;
    let found = find_view(&objective, &SIZE, from, goal_px)?;
    let after = objective.uncertainty_px(&(&known.matrix + &found.information))?;
    Some(SharedView {
        camera_from_board: found.view.camera_from_board,
        normals: found.view.normals,
        uncertainty_px: now.figure,
        expected_uncertainty_px: after.figure,
        drop: 1.0 - after.criterion / now.criterion,
        views_to_go: found.views_to_go,
    })
}
