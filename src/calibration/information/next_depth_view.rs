//! The next view to suggest for the depth camera: the one that most lowers the uncertainty of where
//! color sees what depth measures.

use std::rc::Rc;

use nalgebra::Point3;

use crate::calibration::information::candidate_views::{CandidateSpace, Holding};
use crate::calibration::information::depth_goal::DepthGoal;
use crate::calibration::information::depth_information::DepthInformation;
use crate::calibration::information::depth_teaching::{BoardBefore, DepthTeaching, ExpectedView};
use crate::calibration::information::teaching::Teaching;
use crate::calibration::information::view_information::ViewNormal;
use crate::calibration::information::view_search::{
    Lesson, LessonCandidate, LessonFigures, SearchSize, find_view,
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
struct DepthLesson<'a> {
    depth: &'a DepthTeaching,
    known: KnownDepth,
    color: &'a Teaching,
    space: &'a CandidateSpace<'a>,
    /// The candidate space of infrared, if its corners are used.
    infrared: Option<&'a CandidateSpace<'a>>,
}

/// The information on depth, and the goal.
#[derive(Clone)]
struct KnownDepth {
    information: DepthInformation,
    goal: Rc<DepthGoal>,
    /// The distances that the goal is for.
    seen_m: [f64; 2],
}

/// A board in front of color.
struct BeforeColor {
    camera_from_board: Pose,
    normal: ViewNormal,
    /// Its normal matrix in infrared, if infrared sees it.
    in_infrared: Option<ViewNormal>,
}

impl Lesson for DepthLesson<'_> {
    type View = BeforeColor;
    type Information = ExpectedView;
    type Known = KnownDepth;

    /// About as many views as sessions take once the count is shown.
    const COMING: usize = 5;

    fn known(&self) -> &KnownDepth {
        &self.known
    }

    fn view(&self, _image: usize, holding: &Holding) -> Option<LessonCandidate<BeforeColor>> {
        let view = self.space.view(holding)?;
        let (camera_from_board, likely) = (view.camera_from_board, view.likely);
        let normal = ViewNormal::of(self.space.lens, &camera_from_board, &view.corners);
        let in_infrared = self.infrared.and_then(|space| {
            let infrared_from_board = self.depth.depth().depth_from_color * camera_from_board;
            let view = space.view_at(holding, infrared_from_board)?;
            Some(ViewNormal::of(space.lens, &view.camera_from_board, &view.corners))
        });
        let view = BeforeColor { camera_from_board, normal, in_infrared };
        Some(LessonCandidate { view, camera_from_board, likely })
    }

    fn information(&self, view: &BeforeColor) -> Option<ExpectedView> {
        let board = BoardBefore {
            color_from_board: &view.camera_from_board,
            in_color: &view.normal,
            in_infrared: view.in_infrared.as_ref(),
        };
        self.depth.expected(self.color, &board)
    }

    fn after(&self, known: &KnownDepth, view: &ExpectedView, part: f64) -> KnownDepth {
        let of_depth = view.of_depth.as_ref().map(|view| view.scaled(part));
        let information = known.information.with(&(&view.of_color * part), of_depth.as_ref());
        KnownDepth { information, ..known.clone() }
    }

    fn uncertainty_px(&self, known: &KnownDepth) -> Option<LessonFigures> {
        let std_px = known.goal.std_px(&known.information)?;
        let (figure, criterion) = (known.goal.figure_px(&std_px), known.goal.criterion_px(&std_px));
        Some(LessonFigures { figure, criterion })
    }

    /// A board nearer or farther than any before extends the goal to that distance. Nearer boards
    /// add more information, so they are suggested.
    fn kept(&self, known: KnownDepth, view: &ExpectedView) -> KnownDepth {
        let [near_m, far_m] = known.seen_m;
        let beyond = view.z_m.filter(|z_m| !(near_m..=far_m).contains(z_m));
        let seen_m = beyond.map(|z_m| [near_m.min(z_m), far_m.max(z_m)]);
        let goal = seen_m.and_then(|seen_m| {
            let goal = self.depth.goal(self.color, &known.information.free, seen_m)?;
            Some((Rc::new(goal), seen_m))
        });
        match goal {
            Some((goal, seen_m)) => KnownDepth { goal, seen_m, ..known },
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
    depth: &DepthTeaching,
    color: &Teaching,
    goal_px: Option<f64>,
) -> Option<NextDepthView> {
    let now = depth.now()?;
    let noise = color.corner_noise();
    let avoided = color.avoided();
    let space = color.space(&noise, &avoided);
    let (information, goal) = (now.known.clone(), Rc::new(now.goal.clone()));
    let known = KnownDepth { information, goal, seen_m: depth.seen_m()? };
    let of_infrared = depth.infrared().map(|infrared| (infrared, infrared.corner_noise()));
    let infrared = of_infrared.as_ref().map(|(infrared, noise)| infrared.space(noise, &[]));
    let lesson = DepthLesson { depth, known, color, space: &space, infrared: infrared.as_ref() };
    let from = color.views().last().map(|view| &view.camera_from_board);
    let found = find_view(&lesson, &SIZE, from, goal_px)?;
    let before = lesson.uncertainty_px(&lesson.known)?;
    let after = lesson.uncertainty_px(&lesson.after(&lesson.known, &found.information, 1.0))?;
    Some(NextDepthView {
        camera_from_board: found.view.camera_from_board,
        normal: found.view.normal,
        uncertainty_px: before.figure,
        expected_uncertainty_px: after.figure,
        drop: 1.0 - after.criterion / before.criterion,
        views_to_go: found.views_to_go,
    })
}
