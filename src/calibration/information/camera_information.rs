//! The information in a session's views so far, and the information that one more would add. It
//! depends on the frames and their order alone, and not on estimates that other threads make
//! meanwhile: a replay keeps the same views and suggests the same ones.
//!
//! The lens is nominal until three views determine one. It is estimated anew whenever the views
//! have grown by a third, which costs a few milliseconds a dozen times in a session.

use std::f64::consts::PI;

use nalgebra::{DMatrix, UnitQuaternion, Vector3};

use crate::calibration::information::candidate_views::{
    AvoidedPose, BoardPoints, CandidateSpace, base_rotation, effort,
};
use crate::calibration::information::corner_noise::{CornerNoise, NoiseSample, side_px};
use crate::calibration::information::lens_information::LensInformation;
use crate::calibration::information::next_view::{SuggestedView, suggest_view};
use crate::calibration::information::projection_goal::{GoalFigure, ProjectionGoal};
use crate::calibration::information::view_information::{ViewNormal, WeightedCorner};
use crate::calibration::placement::NOMINAL_FOCAL;
use crate::estimation::board_pose::board_poses;
use crate::estimation::camera::{CameraEstimate, CameraOptions, CameraStart, calibrate_camera};
use crate::estimation::problem::{BoardView, CameraProblem, LensChoice};
use crate::estimation::uncertainty::UncertaintyMap;
use crate::geometry::lens::{Lens, LensModel};
use crate::geometry::pixel::ImageSize;
use crate::geometry::pose::Pose;
use crate::geometry::target::Target;

/// The information in the views of one camera.
#[derive(Debug, Clone)]
pub struct CameraInformation {
    size: ImageSize,
    choice: LensChoice,
    board: BoardPoints,
    /// Whether the board frame's z axis points at a camera that sees its front.
    towards_camera: bool,
    views: Vec<ViewInformation>,
    /// Poses at which a board was not worth keeping.
    refused_camera_from_board: Vec<Pose>,
    /// The start for the next estimate, from the newest one; `None` while the lens is nominal.
    start: Option<CameraStart>,
    estimated_among: usize,
    noise: SessionNoise,
    known: LensInformation,
    goal: ProjectionGoal,
    now: Option<UncertaintyMap>,
}

/// One view, and its information at the present lens.
#[derive(Debug, Clone)]
pub struct ViewInformation {
    /// Which of the session's views it is.
    pub number: u32,
    seen: BoardView,
    blur_px: f64,
    /// The board's pose at the present lens.
    pub camera_from_board: Pose,
    normal: ViewNormal,
    information: DMatrix<f64>,
}

/// The scatter of corners relative to what their detector predicts.
#[derive(Debug, Clone, Copy)]
struct SessionNoise {
    factor: f64,
    floor_px: f64,
}

/// The least noise factor, in units of a corner's own standard deviation.
const LEAST_NOISE: f64 = 0.01;
/// A board within this effort of a kept view may repeat it: a tenth of its distance, or twelve
/// degrees. Admission rejects that.
const NEAR_KEPT: f64 = 0.2;
/// The same for a refused pose.
const NEAR_REFUSED: f64 = 0.3;
/// Fewer views do not determine the lens.
const LEAST_VIEWS: usize = 3;
/// The lens is estimated anew when the views have grown by this factor.
const GROWTH: f64 = 1.3;
/// `auto` takes the second model only if its residuals are below this fraction of the first one's.
const CLEARLY_BETTER: f64 = 0.8;

impl CameraInformation {
    /// No information yet: a camera with images of `size`, in front of `target`, whose lens is of
    /// the chosen model. `figure` is the quantity in which the goal is stated.
    pub fn new(target: &Target, size: ImageSize, choice: LensChoice, figure: GoalFigure) -> Self {
        let lens = nominal_lens(size, choice);
        let mut information = Self {
            size,
            choice,
            board: BoardPoints::of_target(target),
            towards_camera: matches!(target, Target::AprilGrid(_)),
            views: Vec::new(),
            refused_camera_from_board: Vec::new(),
            start: None,
            estimated_among: 0,
            noise: SessionNoise { factor: 1.0, floor_px: 0.0 },
            known: LensInformation::prior(lens, size),
            goal: ProjectionGoal::new(&lens, size, figure),
            now: None,
        };
        information.sum_up();
        information
    }

    /// The lens, as far as it is known.
    pub fn lens(&self) -> &Lens {
        &self.known.lens
    }

    /// The board's points.
    pub fn board(&self) -> &BoardPoints {
        &self.board
    }

    /// The information on the lens.
    pub fn known(&self) -> &LensInformation {
        &self.known
    }

    /// The size of its images.
    pub fn size(&self) -> ImageSize {
        self.size
    }

    /// The lens model that was chosen.
    pub fn choice(&self) -> LensChoice {
        self.choice
    }

    /// The figure that the goal is stated in.
    pub fn figure(&self) -> GoalFigure {
        self.goal.figure()
    }

    /// A suggested view at a pose that [`Self::suggest`] did not find; `normal` is its normal
    /// matrix.
    pub fn suggested(
        &self,
        camera_from_board: Pose,
        normal: &ViewNormal,
        views_to_go: Option<[u32; 2]>,
    ) -> Option<SuggestedView> {
        let information = normal.lens_information(&self.known.free)?;
        let now = self.now.as_ref()?;
        let after = self.goal.map(&self.known.covariance_with(&information)?)?;
        let noise = self.corner_noise();
        Some(SuggestedView {
            camera_from_board,
            outline_px: self.space(&noise, &[]).outline_px(&camera_from_board)?,
            uncertainty_px: self.goal.figure_px(now)?,
            expected_uncertainty_px: Some(self.goal.figure_px(&after)?),
            drop: self.goal.drop(now, &after),
            information,
            views_to_go,
            is_for_depth: false,
        })
    }

    /// Whether the lens was estimated, and is no longer nominal.
    pub fn is_estimated(&self) -> bool {
        self.start.is_some()
    }

    /// The views, in order.
    pub fn views(&self) -> &[ViewInformation] {
        &self.views
    }

    /// The information that a view with this number would add, with the present lens; `None` where
    /// no pose fits it.
    pub fn view(&self, number: u32, seen: BoardView, blur_px: f64) -> Option<ViewInformation> {
        let camera_from_board = board_poses(self.lens(), &seen).ok()?.first()?.camera_from_board;
        self.placed(number, seen, blur_px, camera_from_board)
    }

    /// How much one more view would lower the uncertainty of projections: the mean over the image
    /// of the relative drop of the standard deviation, 0 to 1.
    pub fn gain(&self, view: &ViewInformation) -> f64 {
        let after = self.known.covariance_with(&view.information);
        let after = after.and_then(|covariance| self.goal.map(&covariance));
        match (&self.now, after) {
            (Some(now), Some(after)) => self.goal.gain(now, &after),
            _ => 0.0,
        }
    }

    /// The relative drop of the goal's criterion with one more view, as in
    /// [`ProjectionGoal::drop`].
    pub fn drop(&self, view: &ViewInformation) -> f64 {
        let after = self.known.covariance_with(&view.information);
        match (&self.now, after.and_then(|covariance| self.goal.map(&covariance))) {
            (Some(now), Some(after)) => self.goal.drop(now, &after),
            _ => 0.0,
        }
    }

    /// Adds a view.
    pub fn add(&mut self, view: ViewInformation) {
        self.views.push(view);
        self.refused_camera_from_board.clear();
        let count = self.views.len();
        if count >= LEAST_VIEWS && count as f64 >= GROWTH * self.estimated_among as f64 {
            self.estimated_among = count;
            self.estimate();
        }
        self.sum_up();
    }

    /// The number of the view that adds least to the others, and how much the others' uncertainty
    /// falls with it (as [`Self::gain`]).
    pub fn least_informative(&self) -> Option<(u32, f64)> {
        let losses = self.views.iter().filter_map(|view| {
            let matrix = &self.known.matrix - &view.information;
            let without = LensInformation { matrix, ..self.known.clone() };
            let before = self.goal.map(&without.covariance()?)?;
            Some((view.number, self.goal.gain(&before, self.now.as_ref()?)))
        });
        losses.min_by(|a, b| a.1.total_cmp(&b.1))
    }

    /// Removes the view with this number.
    pub fn remove(&mut self, number: u32) {
        if let Some(at) = self.views.iter().position(|view| view.number == number) {
            self.views.remove(at);
            if let Some(start) = &mut self.start
                && at < start.camera_from_board.len()
            {
                start.camera_from_board.remove(at);
            }
            self.sum_up();
        }
    }

    /// The goal's figure with the present views, in pixels.
    pub fn uncertainty_px(&self) -> Option<f64> {
        self.goal.uncertainty_px(&self.known.covariance()?)
    }

    /// The next view to suggest, with `goal_px` as the uncertainty to reach. The search starts from
    /// the last view.
    pub fn suggest(&self, goal_px: Option<f64>) -> Option<SuggestedView> {
        let noise = self.corner_noise();
        let from = self.views.last().map(|view| &view.camera_from_board);
        let avoided = self.avoided();
        suggest_view(&self.known, &self.goal, &self.space(&noise, &avoided), from, goal_px)
    }

    /// A board at this pose was not worth keeping: views near it are not suggested until another
    /// view is kept.
    pub fn refuse(&mut self, camera_from_board: Pose) {
        self.refused_camera_from_board.push(camera_from_board);
    }

    /// Poses near a kept view, which would repeat it, or near a refused one.
    pub fn avoided(&self) -> Vec<AvoidedPose> {
        let kept = self.views.iter().map(|view| (view.camera_from_board, NEAR_KEPT));
        let refused = self.refused_camera_from_board.iter().map(|pose| (*pose, NEAR_REFUSED));
        let avoided = |(camera_from_board, effort)| AvoidedPose { camera_from_board, effort };
        kept.chain(refused).map(avoided).collect()
    }

    /// The noise of corners, estimated from the views.
    pub fn corner_noise(&self) -> CornerNoise {
        let samples: Vec<NoiseSample> =
            self.views.iter().filter_map(|view| self.noise_sample(view)).collect();
        CornerNoise::learn(&samples)
    }

    /// The effort from one pose of the board to another, in radians of rotation.
    pub fn effort(&self, here_from_board: &Pose, there_from_board: &Pose) -> f64 {
        effort(here_from_board, there_from_board, self.board.middle())
    }

    /// The space of views to suggest, without the `avoided` poses.
    pub fn space<'a>(
        &'a self,
        noise: &'a CornerNoise,
        avoided: &'a [AvoidedPose],
    ) -> CandidateSpace<'a> {
        let unseen = if self.towards_camera { Vector3::x() * PI } else { Vector3::zeros() };
        let base = self.views.last().map_or_else(
            || UnitQuaternion::from_scaled_axis(unseen),
            |view| base_rotation(&view.camera_from_board),
        );
        let (lens, size, board) = (self.lens(), self.size, &self.board);
        CandidateSpace { lens, size, board, noise, base, avoided }
    }

    fn placed(
        &self,
        number: u32,
        seen: BoardView,
        blur_px: f64,
        camera_from_board: Pose,
    ) -> Option<ViewInformation> {
        let corners: Vec<WeightedCorner> = (seen.correspondences.iter())
            .map(|corner| WeightedCorner {
                point_in_board: corner.point_in_board,
                std_px: self.noise.of(corner.std_px),
            })
            .collect();
        let normal = ViewNormal::of(self.lens(), &camera_from_board, &corners);
        let information = normal.lens_information(&self.known.free)?;
        Some(ViewInformation { number, seen, blur_px, camera_from_board, normal, information })
    }

    fn noise_sample(&self, view: &ViewInformation) -> Option<NoiseSample> {
        let mut stds: Vec<f64> =
            view.seen.correspondences.iter().map(|corner| self.noise.of(corner.std_px)).collect();
        stds.sort_unstable_by(f64::total_cmp);
        let middle = self.board.middle();
        Some(NoiseSample {
            std_px: *stds.get(stds.len() / 2)?,
            side_px: side_px(self.lens(), &view.camera_from_board, &middle, self.board.side_m)?,
            blur_px: view.blur_px,
            distance_m: (view.camera_from_board * middle).coords.norm(),
        })
    }

    /// Estimates the lens from the views; if that fails, it stays as it was.
    fn estimate(&mut self) {
        let views = self.views.iter().map(|view| view.seen.clone()).collect();
        let problem = CameraProblem { image_size: self.size, views };
        let of = |model: LensModel| {
            let start = self.start.clone().filter(|start| start.lens.model() == model);
            let lens = LensChoice::Model(model);
            let options = CameraOptions { lens, start, ..CameraOptions::default() }.as_stated();
            calibrate_camera(&problem, &options).ok()
        };
        let estimate = match self.choice {
            LensChoice::Model(model) => of(model),
            LensChoice::Auto => better(of(LensModel::Brown), of(LensModel::KannalaBrandt)),
        };
        let Some(estimate) = estimate else { return };
        self.noise = SessionNoise {
            factor: estimate.noise * estimate.variance_inflation.sqrt(),
            floor_px: estimate.noise_floor_px,
        };
        self.known = LensInformation::prior(estimate.lens, self.size);
        self.goal = ProjectionGoal::new(&estimate.lens, self.size, self.goal.figure());
        let mut start = estimate.to_start();
        let poses = std::mem::take(&mut start.camera_from_board);
        let views = std::mem::take(&mut self.views);
        (self.views, start.camera_from_board) = views
            .into_iter()
            .zip(&estimate.views)
            .zip(poses)
            .filter_map(|((view, placed), pose)| {
                let camera_from_board = placed.camera_from_board.unwrap_or(view.camera_from_board);
                let view = self.placed(view.number, view.seen, view.blur_px, camera_from_board)?;
                Some((view, pose))
            })
            .unzip();
        self.start = Some(start);
    }

    fn sum_up(&mut self) {
        let nothing = LensInformation::prior(self.known.lens, self.size);
        self.known = self.views.iter().fold(nothing, |known, view| known.with(&view.information));
        self.now = self.known.covariance().and_then(|covariance| self.goal.map(&covariance));
    }
}

impl ViewInformation {
    /// The board's pose with its origin in the middle of the corners seen: the point that rotations
    /// of its normal matrix are about.
    pub fn centered(&self) -> Pose {
        Pose::new(self.camera_from_board.rotation(), self.normal.middle_in_camera)
    }

    /// Its normal matrix.
    pub fn normal(&self) -> &ViewNormal {
        &self.normal
    }

    /// Its information on the lens.
    pub fn information(&self) -> &DMatrix<f64> {
        &self.information
    }

    /// The same with this number.
    #[must_use]
    pub fn numbered(self, number: u32) -> Self {
        Self { number, ..self }
    }
}

impl SessionNoise {
    fn of(&self, std_px: f64) -> f64 {
        self.factor.max(LEAST_NOISE) * std_px.hypot(self.floor_px)
    }
}

/// The estimate with smaller residuals; the first unless the second is clearly better.
fn better(first: Option<CameraEstimate>, second: Option<CameraEstimate>) -> Option<CameraEstimate> {
    match (first, second) {
        (Some(first), Some(second)) if second.rms_px < CLEARLY_BETTER * first.rms_px => {
            Some(second)
        }
        (Some(first), _) => Some(first),
        (None, second) => second,
    }
}

/// A lens of the chosen model without distortion, with an ordinary field of view.
fn nominal_lens(size: ImageSize, choice: LensChoice) -> Lens {
    let model = match choice {
        LensChoice::Model(model) => model,
        LensChoice::Auto => LensModel::Brown,
    };
    let focal_px = NOMINAL_FOCAL * f64::from(size.width.max(size.height));
    let center = size.center();
    let mut parameters = vec![0.0; Lens::parameter_names(model).len()];
    parameters[..4].copy_from_slice(&[focal_px, focal_px, center.x, center.y]);
    let matrix = crate::geometry::camera_matrix::CameraMatrix {
        fx: focal_px,
        fy: focal_px,
        cx: center.x,
        cy: center.y,
        skew: 0.0,
    };
    Lens::from_parameters(model, &parameters).unwrap_or_else(|| Lens::pinhole(matrix))
}
