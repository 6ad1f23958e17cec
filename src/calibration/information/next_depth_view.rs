//! The next view to suggest for the depth camera: the one that most lowers the uncertainty of where
//! color sees what depth measures.

use std::rc::Rc;

use nalgebra::Point3;

use crate::calibration::information::camera_information::CameraInformation;
use crate::calibration::information::candidate_views::{CandidateSpace, PlacementInImage};
use crate::calibration::information::depth_camera_information::{
    CandidateBoard, DepthCameraInformation, ExpectedInformation,
};
use crate::calibration::information::depth_goal::DepthGoal;
use crate::calibration::information::depth_information::DepthInformation;
use crate::calibration::information::view_information::ViewNormal;
use crate::calibration::information::view_search::{
    Objective, ObjectiveCandidate, ObjectiveValues, SearchSize, find_view,
};
use crate::geometry::pose::Pose;

/// The suggested pose of the board in color.
#[derive(Debug, Clone, PartialEq)]
pub struct NextDepthView {
    /// Where.
    pub camera_from_board: Pose,
    /// The view's normal matrix in color, for the information about color's own lens.
    pub normal: ViewNormal,
    /// The present uncertainty of depth's pixels in color, in pixels of color.
    pub uncertainty_px: f64,
    /// The same after that view.
    pub expected_uncertainty_px: f64,
    /// The relative drop of the goal's criterion, 0 to 1.
    pub drop: f64,
    /// How many such views reach the goal, as
    /// [`crate::calibration::information::next_view::SuggestedView::views_to_go`].
    pub views_to_go: Option<[u32; 2]>,
}

const SIZE: SearchSize =
    SearchSize { sequence: 80, in_corners: 12, refined: [(10, 0.12), (10, 0.05)] };

/// The search of a view for depth beside color.
struct DepthObjective<'a> {
    depth: &'a DepthCameraInformation,
    known: DepthObjectiveState,
    color: &'a CameraInformation,
    space: &'a CandidateSpace<'a>,
    /// The candidate space of infrared, if its corners are used.
    infrared: Option<&'a CandidateSpace<'a>>,
}

/// The information on depth, and the goal.
#[derive(Clone)]
struct DepthObjectiveState {
    information: DepthInformation,
    goal: Rc<DepthGoal>,
    /// The distances that the goal is for.
    seen_m: [f64; 2],
}

/// A board in front of color.
struct ColorCandidate {
    camera_from_board: Pose,
    normal: ViewNormal,
    /// Its normal matrix in infrared, if infrared sees it.
    in_infrared: Option<ViewNormal>,
}

impl Objective for DepthObjective<'_> {
    type View = ColorCandidate;
    type Information = ExpectedInformation;
    type Known = DepthObjectiveState;

    /// About as many views as sessions take once the count is shown.
    const COMING: usize = 5;

    fn known(&self) -> &DepthObjectiveState {
        &self.known
    }

    fn view(
        &self,
        _image: usize,
        placement: &PlacementInImage,
    ) -> Option<ObjectiveCandidate<ColorCandidate>> {
        let view = self.space.view(placement)?;
        let (camera_from_board, visibility) = (view.camera_from_board, view.visibility);
        let normal = ViewNormal::of(self.space.lens, &camera_from_board, &view.corners);
        let in_infrared = self.infrared.and_then(|space| {
            let infrared_from_board = self.depth.depth().depth_from_color * camera_from_board;
            let view = space.view_at(placement, infrared_from_board)?;
            Some(ViewNormal::of(space.lens, &view.camera_from_board, &view.corners))
        });
        let view = ColorCandidate { camera_from_board, normal, in_infrared };
        Some(ObjectiveCandidate { view, camera_from_board, visibility })
    }

    fn information(&self, view: &ColorCandidate) -> Option<ExpectedInformation> {
        let board = CandidateBoard {
            color_from_board: &view.camera_from_board,
            in_color: &view.normal,
            in_infrared: view.in_infrared.as_ref(),
        };
        self.depth.expected(self.color, &board)
    }

    fn after(
        &self,
        known: &DepthObjectiveState,
        view: &ExpectedInformation,
        part: f64,
    ) -> DepthObjectiveState {
        let of_depth = view.of_depth.as_ref().map(|view| view.scaled(part));
        let information = known.information.with(&(&view.of_color * part), of_depth.as_ref());
        DepthObjectiveState { information, ..known.clone() }
    }

    fn uncertainty_px(&self, known: &DepthObjectiveState) -> Option<ObjectiveValues> {
        let std_px = known.goal.std_px(&known.information)?;
        let (figure, criterion) = (known.goal.figure_px(&std_px), known.goal.criterion_px(&std_px));
        Some(ObjectiveValues { figure, criterion })
    }

    /// A board nearer or farther than any before extends the goal to that distance. Nearer boards
    /// add more information, so they are suggested.
    fn kept(&self, known: DepthObjectiveState, view: &ExpectedInformation) -> DepthObjectiveState {
        let [near_m, far_m] = known.seen_m;
        let beyond = view.z_m.filter(|z_m| !(near_m..=far_m).contains(z_m));
        let seen_m = beyond.map(|z_m| [near_m.min(z_m), far_m.max(z_m)]);
        let goal = seen_m.and_then(|seen_m| {
            let goal = self.depth.goal(self.color, &known.information.free, seen_m)?;
            Some((Rc::new(goal), seen_m))
        });
        match goal {
            Some((goal, seen_m)) => DepthObjectiveState { goal, seen_m, ..known },
            None => known,
        }
    }

    fn middle(&self) -> Point3<f64> {
        self.space.board.middle()
    }
}

/// The next view to suggest. `color` is the camera beside depth, and `goal_px` the uncertainty to
/// reach. `None` while there is no information on depth, or where no view can be suggested.
pub fn suggest_depth_view(
    depth: &DepthCameraInformation,
    color: &CameraInformation,
    goal_px: Option<f64>,
) -> Option<NextDepthView> {
    let now = depth.now()?;
    let noise = color.corner_noise();
    let avoided = color.avoided();
    let space = color.space(&noise, &avoided);
    let (information, goal) = (now.known.clone(), Rc::new(now.goal.clone()));
    let known = DepthObjectiveState { information, goal, seen_m: depth.seen_m()? };
    let of_infrared = depth.infrared().map(|infrared| (infrared, infrared.corner_noise()));
    let infrared = of_infrared.as_ref().map(|(infrared, noise)| infrared.space(noise, &[]));
    let objective =
        DepthObjective { depth, known, color, space: &space, infrared: infrared.as_ref() };
    let from = color.views().last().map(|view| &view.camera_from_board);
    let found = find_view(&objective, &SIZE, from, goal_px)?;
    let before = objective.uncertainty_px(&objective.known)?;
    let after =
        objective.uncertainty_px(&objective.after(&objective.known, &found.information, 1.0))?;
    Some(NextDepthView {
        camera_from_board: found.view.camera_from_board,
        normal: found.view.normal,
        uncertainty_px: before.figure,
        expected_uncertainty_px: after.figure,
        drop: 1.0 - after.criterion / before.criterion,
        views_to_go: found.views_to_go,
    })
}
