//! The next view to ask for so that color knows where it sees what depth measures: the one that
//! lowers that uncertainty most.

use nalgebra::{DMatrix, Point3};

use crate::calibration::information::candidate_views::{CandidateSpace, Holding};
use crate::calibration::information::depth_information::{DepthInformation, DepthNormal};
use crate::calibration::information::depth_teaching::{DepthNow, DepthTeaching};
use crate::calibration::information::teaching::Teaching;
use crate::calibration::information::view_information::ViewNormal;
use crate::calibration::information::view_search::{
    Lesson, LessonCandidate, LessonFigures, SearchSize, find_view,
};
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

const SIZE: SearchSize =
    SearchSize { sequence: 80, in_corners: 12, refined: [(10, 0.12), (10, 0.05)] };

/// What a depth camera beside color is to be known by.
struct DepthLesson<'a> {
    depth: &'a DepthTeaching,
    now: &'a DepthNow,
    color: &'a Teaching,
    space: &'a CandidateSpace<'a>,
}

/// A board before color.
struct BeforeColor {
    camera_from_board: Pose,
    normal: ViewNormal,
}

impl Lesson for DepthLesson<'_> {
    type View = BeforeColor;
    type Information = (DMatrix<f64>, Option<DepthNormal>);
    type Known = DepthInformation;

    fn known(&self) -> &DepthInformation {
        &self.now.known
    }

    fn view(&self, _image: usize, holding: &Holding) -> Option<LessonCandidate<BeforeColor>> {
        let view = self.space.view(holding)?;
        let (camera_from_board, likely) = (view.camera_from_board, view.likely);
        let normal = ViewNormal::of(self.space.lens, &camera_from_board, &view.corners);
        let view = BeforeColor { camera_from_board, normal };
        Some(LessonCandidate { view, camera_from_board, likely })
    }

    fn information(&self, view: &BeforeColor) -> Option<Self::Information> {
        self.depth.expected(self.color, (&view.camera_from_board, &view.normal))
    }

    fn after(
        &self,
        known: &DepthInformation,
        (of_color, of_depth): &Self::Information,
        part: f64,
    ) -> DepthInformation {
        let of_depth = of_depth.as_ref().map(|view| view.scaled(part));
        known.with(&(of_color * part), of_depth.as_ref())
    }

    fn uncertainty_px(&self, known: &DepthInformation) -> Option<LessonFigures> {
        let goal = &self.now.goal;
        let std_px = goal.std_px(known)?;
        let (figure, criterion) = (goal.figure_px(&std_px), goal.criterion_px(&std_px));
        Some(LessonFigures { figure, criterion })
    }

    fn middle(&self) -> Point3<f64> {
        self.space.board.middle()
    }
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
    let avoided = color.avoided();
    let space = color.space(&noise, &avoided);
    let lesson = DepthLesson { depth, now, color, space: &space };
    let from = color.views().last().map(|view| &view.camera_from_board);
    let found = find_view(&lesson, &SIZE, (from, goal_px))?;
    let before = lesson.uncertainty_px(&now.known)?;
    let after = lesson.uncertainty_px(&lesson.after(&now.known, &found.information, 1.0))?;
    Some(NextDepthView {
        camera_from_board: found.view.camera_from_board,
        normal: found.view.normal,
        uncertainty_px: before.figure,
        expected_uncertainty_px: after.figure,
        drop: 1.0 - after.criterion / before.criterion,
        views_to_go: found.views_to_go,
    })
}
