//! The next view to ask for so that color knows where it sees what depth measures: the one that
//! lowers that uncertainty most.

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
    known: KnownDepth,
    color: &'a Teaching,
    space: &'a CandidateSpace<'a>,
    /// Where infrared can see boards, where its corners count.
    infrared: Option<&'a CandidateSpace<'a>>,
}

/// What is known of depth, and what is to be known of it.
#[derive(Clone)]
struct KnownDepth {
    information: DepthInformation,
    goal: Rc<DepthGoal>,
    /// The distances that the goal is for.
    seen_m: [f64; 2],
}

/// A board before color.
struct BeforeColor {
    camera_from_board: Pose,
    normal: ViewNormal,
    /// The same before infrared, where it sees the board.
    in_infrared: Option<ViewNormal>,
}

impl Lesson for DepthLesson<'_> {
    type View = BeforeColor;
    type Information = ExpectedView;
    type Known = KnownDepth;

    /// As many as sessions take from where this is said.
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

    /// A board that is nearer or farther than any before adds the depth there: nearer ones teach
    /// more, and are asked for.
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
