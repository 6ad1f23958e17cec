//! The next view to ask for that teaches one camera's lens: the one that lowers most how uncertain
//! projections are.

use nalgebra::{DMatrix, Point3};

use crate::calibration::information::candidate_views::{CandidateSpace, CandidateView, Holding};
use crate::calibration::information::lens_information::LensInformation;
use crate::calibration::information::projection_goal::ProjectionGoal;
use crate::calibration::information::view_information::view_information;
use crate::calibration::information::view_search::{
    Lesson, LessonCandidate, LessonFigures, SearchSize, find_view,
};
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
    /// The same after that view; `None` as long as nobody knows where the depth camera beside this
    /// one is.
    pub expected_uncertainty_px: Option<f64>,
    /// By how much the goal's criterion would fall, as [`ProjectionGoal::drop`] has it.
    pub drop: f64,
    /// What it would add to what is known of the lens.
    pub information: DMatrix<f64>,
    /// How many more views reach the goal: as few as this if each is as suggested, as many as that
    /// if each teaches a quarter as much. `None` without a goal.
    pub views_to_go: Option<[u32; 2]>,
    /// It is asked for on behalf of a depth camera beside this one, which is known less.
    pub is_for_depth: bool,
}

const SIZE: SearchSize =
    SearchSize { sequence: 112, in_corners: 24, refined: [(12, 0.12), (12, 0.05)] };

/// What one camera's lens is to be known by.
struct LensLesson<'a> {
    known: &'a LensInformation,
    goal: &'a ProjectionGoal,
    near: CompensatedSamples,
    space: &'a CandidateSpace<'a>,
}

impl Lesson for LensLesson<'_> {
    type View = CandidateView;
    type Information = DMatrix<f64>;
    type Known = LensInformation;

    fn known(&self) -> &LensInformation {
        self.known
    }

    fn view(&self, _image: usize, holding: &Holding) -> Option<LessonCandidate<CandidateView>> {
        let view = self.space.view(holding)?;
        let (camera_from_board, likely) = (view.camera_from_board, view.likely);
        Some(LessonCandidate { view, camera_from_board, likely })
    }

    fn information(&self, view: &CandidateView) -> Option<DMatrix<f64>> {
        let LensInformation { lens, free, .. } = self.known;
        view_information(lens, free, &view.camera_from_board, &view.corners)
    }

    fn after(&self, known: &LensInformation, view: &DMatrix<f64>, part: f64) -> LensInformation {
        known.with(&(view * part))
    }

    fn uncertainty_px(&self, known: &LensInformation) -> Option<LessonFigures> {
        let map = self.near.uncertainty(&known.covariance()?);
        let (figure, criterion) = (self.goal.figure_px(&map)?, self.goal.criterion_px(&map)?);
        Some(LessonFigures { figure, criterion })
    }

    fn middle(&self) -> Point3<f64> {
        self.space.board.middle()
    }
}

/// The next view to ask for, with what is `known` of the lens; `from` is where the board is now and
/// `goal_px` the figure to reach. `None` where no view of the board can be asked for.
pub fn suggest_view(
    known: &LensInformation,
    goal: &ProjectionGoal,
    space: &CandidateSpace<'_>,
    from: Option<&Pose>,
    goal_px: Option<f64>,
) -> Option<SuggestedView> {
    let now = goal.map(&known.covariance()?)?;
    let lesson = LensLesson { known, goal, near: goal.near(&now)?, space };
    let found = find_view(&lesson, &SIZE, from, goal_px)?;
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
