//! The next view to suggest for one camera's lens: the one that most lowers the uncertainty of
//! projections.

use nalgebra::{DMatrix, Point3};

use crate::calibration::information::candidate_views::{
    CandidateSpace, CandidateView, PlacementInImage,
};
use crate::calibration::information::lens_information::LensInformation;
use crate::calibration::information::projection_goal::ProjectionGoal;
use crate::calibration::information::view_information::view_information;
use crate::calibration::information::view_search::{
    Objective, ObjectiveCandidate, ObjectiveValues, SearchSize, find_view,
};
use crate::estimation::uncertainty::CompensatedSamples;
use crate::geometry::pixel::Pixel;
use crate::geometry::pose::Pose;

/// A suggested view.
#[derive(Debug, Clone, PartialEq)]
pub struct SuggestedView {
    /// The board's pose.
    pub camera_from_board: Pose,
    /// The pixels of its outer corners: the one at the board's least x and y first, then along x.
    pub outline_px: [Pixel; 4],
    /// The goal's figure now, in pixels.
    pub uncertainty_px: f64,
    /// The same after that view; `None` while the pose of the depth camera beside this one is
    /// unknown.
    pub expected_uncertainty_px: Option<f64>,
    /// The relative drop of the goal's criterion, as in [`ProjectionGoal::drop`].
    pub drop: f64,
    /// The information on the lens that it would add.
    pub information: DMatrix<f64>,
    /// How many more views reach the goal: the first number if each is as suggested, the second if
    /// each adds a quarter of that information. `None` without a goal.
    pub views_to_go: Option<[u32; 2]>,
    /// It is suggested for the depth camera beside this one, whose uncertainty is larger.
    pub is_for_depth: bool,
}

const SIZE: SearchSize =
    SearchSize { sequence: 112, in_corners: 24, refined: [(12, 0.12), (12, 0.05)] };

/// The search of a view for one camera's lens.
struct LensObjective<'a> {
    known: &'a LensInformation,
    goal: &'a ProjectionGoal,
    near: CompensatedSamples,
    space: &'a CandidateSpace<'a>,
}

impl Objective for LensObjective<'_> {
    type View = CandidateView;
    type Information = DMatrix<f64>;
    type Known = LensInformation;

    fn known(&self) -> &LensInformation {
        self.known
    }

    fn view(
        &self,
        _image: usize,
        placement: &PlacementInImage,
    ) -> Option<ObjectiveCandidate<CandidateView>> {
        let view = self.space.view(placement)?;
        let (camera_from_board, visibility) = (view.camera_from_board, view.visibility);
        Some(ObjectiveCandidate { view, camera_from_board, visibility })
    }

    fn information(&self, view: &CandidateView) -> Option<DMatrix<f64>> {
        let LensInformation { lens, free, .. } = self.known;
        view_information(lens, free, &view.camera_from_board, &view.corners)
    }

    fn after(&self, known: &LensInformation, view: &DMatrix<f64>, part: f64) -> LensInformation {
        known.with(&(view * part))
    }

    fn uncertainty_px(&self, known: &LensInformation) -> Option<ObjectiveValues> {
        let map = self.near.uncertainty(&known.covariance()?);
        let (figure, criterion) = (self.goal.figure_px(&map)?, self.goal.criterion_px(&map)?);
        Some(ObjectiveValues { figure, criterion })
    }

    fn middle(&self) -> Point3<f64> {
        self.space.board.middle()
    }
}

/// The next view to suggest, given what is `known` of the lens; `from` is the board's present pose,
/// and `goal_px` the uncertainty to reach. `None` where no view of the board can be suggested.
pub fn suggest_view(
    known: &LensInformation,
    goal: &ProjectionGoal,
    space: &CandidateSpace<'_>,
    from: Option<&Pose>,
    goal_px: Option<f64>,
) -> Option<SuggestedView> {
    let now = goal.map(&known.covariance()?)?;
    let objective = LensObjective { known, goal, near: goal.near(&now)?, space };
    let found = find_view(&objective, &SIZE, from, goal_px)?;
    let after = goal.map(&known.covariance_with(&found.information)?)?;
    Some(SuggestedView {
        camera_from_board: found.view.camera_from_board,
        outline_px: space.outline_px(&found.view.camera_from_board)?,
        uncertainty_px: goal.figure_px(&now)?,
        expected_uncertainty_px: Some(goal.figure_px(&after)?),
        drop: goal.drop(&now, &after),
        information: found.information,
        views_to_go: found.views_to_go,
        is_for_depth: false,
    })
}
