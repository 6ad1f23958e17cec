//! The information in a session's views about the depth camera beside color: its lens, its pose,
//! its depth error, and where color sees the points that it measures. Like the information about
//! color, it depends on the frames alone.
//!
//! The depth camera is fitted anew whenever the views with depth have grown by a third, or color's
//! lens was estimated anew. In that fit, color's corners constrain the boards' poses. In between,
//! views only add information.
//!
//! Once its infrared camera has seen three boards, corners determine lens and pose, as in the
//! solve, and planes only the depth error.

use nalgebra::{DMatrix, Point3};

use crate::calibration::information::board_in_depth::{BoardInDepth, MeasuredView, distance_m};
use crate::calibration::information::camera_information::{CameraInformation, ViewInformation};
use crate::calibration::information::corner_noise::side_px;
use crate::calibration::information::depth_fit::{FittedDepth, fit_depth, sample};
use crate::calibration::information::depth_goal::{DepthColorPair, DepthGoal};
use crate::calibration::information::depth_information::{DepthInformation, DepthNormal};
use crate::calibration::information::expected_depth::DepthTileNoise;
use crate::calibration::information::infrared_corners::InfraredNormal;
use crate::calibration::information::view_information::ViewNormal;
use crate::calibration::solve::rgbd_guess::{board_outline, initial_depth, same_view};
use crate::detection::board_plane::{DepthInput, NoPlane, PlaneOptions, find_board_plane};
use crate::estimation::problem::BoardView;
use crate::estimation::rgbd::plane_information::{PlacedDepth, PlaneNormal, TileSample};
use crate::geometry::depth_camera::{DepthReading, PosedDepthLens};
use crate::geometry::lens::Lens;
use crate::geometry::median::median_pose;
use crate::geometry::pixel::ImageSize;
use crate::geometry::pose::Pose;
use crate::geometry::target::Target;
use crate::imaging::depth_image::DepthImage;

/// The information in one camera's views about its depth.
#[derive(Debug, Clone)]
pub struct DepthCameraInformation {
    target: Target,
    size: ImageSize,
    invalid: Option<u16>,
    /// The device states its lens and pose.
    is_stated: bool,
    guess: PlacedDepth,
    depth: PlacedDepth,
    views: Vec<MeasuredView>,
    estimated_among: usize,
    /// Color's lens at that estimate, and that of infrared if it was used.
    estimated_with_lenses: Option<(Lens, Option<Lens>)>,
    /// The information about the infrared camera that measures depth; `None` before it sees a
    /// board.
    infrared: Option<CameraInformation>,
    /// In that estimate, infrared corners determined the depth camera's lens and pose.
    by_infrared: bool,
    /// As [`FittedDepth::scatter`].
    scatter: [f64; 2],
    pub(super) noise: DepthTileNoise,
    now: Option<DepthUncertainty>,
}

/// The present information, with the uncertainty that it leaves.
#[derive(Debug, Clone)]
pub(super) struct DepthUncertainty {
    pub(super) known: DepthInformation,
    pub(super) goal: DepthGoal,
    /// The uncertainty of each transferred pixel.
    pub(super) std_px: Vec<f64>,
}

/// The information that is expected of a suggested view.
pub(super) struct ExpectedInformation {
    /// Of color's lens.
    pub(super) of_color: DMatrix<f64>,
    /// Of depth; `None` where it would not be measured.
    pub(super) of_depth: Option<DepthNormal>,
    /// The distance that depth would measure, in meters.
    pub(super) z_m: Option<f64>,
}

/// A board to suggest: its pose in color, and the normal matrix of its corners in color and, if
/// infrared sees it, in infrared.
pub(super) struct CandidateBoard<'a> {
    pub(super) color_from_board: &'a Pose,
    pub(super) in_color: &'a ViewNormal,
    pub(super) in_infrared: Option<&'a ViewNormal>,
}

/// A depth camera before a session, as far as the device states it.
#[derive(Debug, Clone, PartialEq)]
pub struct DeviceDepth {
    /// The size of its images.
    pub size: ImageSize,
    /// What its numbers mean.
    pub reading: DepthReading,
    /// The reading that means none.
    pub invalid: Option<u16>,
    /// What the device states of its lens and pose.
    pub factory: Option<PosedDepthLens>,
}

/// Views with depth that a fit needs, as in the solve.
const LEAST_VIEWS: usize = 3;
/// The depth camera is fitted anew when its views have grown by this factor.
const GROWTH: f64 = 1.3;
/// The correction is made for distances this many times nearer and farther than those seen.
const BEYOND_SEEN: f64 = 4.0;
/// The board's surface is measured this far beyond its outer corners, as in the solve …
const MARGIN_SQUARES: f64 = 0.8;
/// … but only this far inside them while its place in the depth image is uncertain.
const UNKNOWN_MARGIN_SQUARES: f64 = -1.0;
/// The margin allows for this many standard deviations of that place.
const CERTAIN: f64 = 2.0;

impl DepthCameraInformation {
    /// No information yet; `color` is the camera beside it.
    pub fn new(target: &Target, color: &CameraInformation, stated: &DeviceDepth) -> Self {
        let size = stated.size;
        let PosedDepthLens { lens, depth_from_color } =
            initial_depth((color.lens(), color.size()), size, stated.factory);
        let guess = PlacedDepth::new(lens, size, depth_from_color, stated.reading, [0.3, 3.0]);
        Self {
            target: *target,
            size,
            invalid: stated.invalid,
            is_stated: stated.factory.is_some(),
            depth: guess.clone(),
            guess,
            views: Vec::new(),
            estimated_among: 0,
            estimated_with_lenses: None,
            infrared: None,
            by_infrared: false,
            scatter: [1.0; 2],
            noise: DepthTileNoise::default(),
            now: None,
        }
    }

    /// The depth camera, as far as it is known.
    pub fn depth(&self) -> &PlacedDepth {
        &self.depth
    }

    /// The size of its images.
    pub fn size(&self) -> ImageSize {
        self.size
    }

    /// How many views have depth.
    pub fn measured(&self) -> usize {
        self.views.len()
    }

    /// The board's surface in the depth image that was taken with `in_color`; `None` where it was
    /// not measured. Holes or a surface that is not flat are remembered for its distance.
    pub fn measure(
        &mut self,
        image: &DepthImage,
        color: &CameraInformation,
        in_color: &ViewInformation,
    ) -> Option<MeasuredView> {
        if image.size() != self.size {
            return None;
        }
        let known_margin = self.margin_squares(color, in_color);
        let depth = match known_margin {
            Some(_) => self.depth.posed_lens(),
            None => self.guess(color),
        };
        let margin = known_margin.unwrap_or(UNKNOWN_MARGIN_SQUARES);
        let outline = board_outline(&self.target, &depth, &in_color.camera_from_board, margin);
        let options = PlaneOptions { invalid: self.invalid, ..PlaneOptions::default() };
        let input = DepthInput { image, reading: self.depth.reading, lens: &depth.lens };
        match find_board_plane(input, &outline, &options) {
            Ok(tiles) => Some(MeasuredView::new(in_color.number, tiles)),
            Err(NoPlane::Holes { .. } | NoPlane::NotFlat { .. }) => {
                let middle = Point3::from(in_color.normal().middle_in_camera);
                self.noise.miss((depth.depth_from_color * middle).z);
                None
            }
            Err(_) => None,
        }
    }

    /// Whether the views determine better than the initial guess where a board is in the depth
    /// image. Only then does that uncertainty follow from the views, and not from the priors.
    pub fn is_placed(&self, color: &CameraInformation) -> bool {
        let newest = color.views().last();
        newest.is_some_and(|in_color| self.fitted_margin_squares(color, in_color).is_some())
    }

    /// How far beyond its outer corners the board's surface is searched for, depending on how well
    /// its place is known; `None` where the fit is no better than the initial guess. A fit of few
    /// views may be off by more than the board's width: searched for there, the board would never
    /// be found again.
    fn margin_squares(&self, color: &CameraInformation, in_color: &ViewInformation) -> Option<f64> {
        if self.is_stated {
            return Some(MARGIN_SQUARES);
        }
        self.fitted_margin_squares(color, in_color)
    }

    fn fitted_margin_squares(
        &self,
        color: &CameraInformation,
        in_color: &ViewInformation,
    ) -> Option<f64> {
        let middle = color.board().middle();
        let side_m = color.board().side_m;
        let side_px = side_px(color.lens(), &in_color.camera_from_board, &middle, side_m)?;
        let unknown_squares = CERTAIN * self.uncertainty_px()? / side_px;
        let margin = MARGIN_SQUARES - unknown_squares;
        (margin > UNKNOWN_MARGIN_SQUARES).then_some(margin)
    }

    /// The depth camera that a fit starts from: as stated, or with color's field of view.
    fn guess(&self, color: &CameraInformation) -> PosedDepthLens {
        let guess = self.guess.posed_lens();
        if self.is_stated {
            return guess;
        }
        PosedDepthLens { lens: same_view(color.lens(), color.size(), self.size), ..guess }
    }

    /// The information in the corners `seen` in the infrared image; depth and infrared share one
    /// image geometry. `color` is the camera beside it.
    pub fn see(
        &mut self,
        seen: BoardView,
        blur_px: f64,
        color: &CameraInformation,
        in_color: &ViewInformation,
    ) -> Option<ViewInformation> {
        let nothing =
            || CameraInformation::new(&self.target, self.size, color.choice(), color.figure());
        self.infrared.get_or_insert_with(nothing).view(in_color.number, seen, blur_px)
    }

    /// Adds a view, number `number` of `color`.
    pub fn add(&mut self, number: u32, view: BoardInDepth, color: &CameraInformation) {
        self.views.extend(view.surface.map(|surface| surface.numbered(number)));
        let infrared = self.infrared.as_mut().zip(view.infrared);
        infrared.into_iter().for_each(|(all, view)| all.add(view.numbered(number)));
        self.sum_up(color);
    }

    /// Removes the view with this number.
    pub fn remove(&mut self, number: u32) {
        self.views.retain(|view| view.number != number);
        self.infrared.iter_mut().for_each(|infrared| infrared.remove(number));
    }

    /// The information about infrared, if its corners determine the depth camera's lens and pose.
    pub(super) fn infrared(&self) -> Option<&CameraInformation> {
        self.infrared.as_ref().filter(|_| self.by_infrared)
    }

    /// Updates the estimate and the information after views were added to `color`.
    pub fn sum_up(&mut self, color: &CameraInformation) {
        let count = self.views.len();
        let grown = count as f64 >= GROWTH * self.estimated_among as f64;
        let infrared = self.usable_infrared().map(|infrared| *infrared.lens());
        let is_due = grown || self.estimated_with_lenses != Some((*color.lens(), infrared));
        if count >= LEAST_VIEWS && is_due && color.is_estimated() {
            self.estimate(color);
        }
        self.now = self.known(color);
    }

    /// The 1-σ uncertainty of where color sees what depth measures at the distances seen: the
    /// session's figure over the depth image, in pixels of color. `None` before the first fit,
    /// which needs three views with depth.
    pub fn uncertainty_px(&self) -> Option<f64> {
        let now = self.now.as_ref().filter(|_| self.estimated_among > 0)?;
        Some(now.goal.figure_px(&now.std_px))
    }

    /// The same with one more view that only adds information on color's lens.
    pub fn uncertainty_with_color(&self, of_color: &DMatrix<f64>) -> Option<f64> {
        let now = self.now.as_ref().filter(|_| self.estimated_among > 0)?;
        let fits = of_color.nrows() == now.known.free.len();
        let after = fits.then(|| now.known.with(of_color, None))?;
        Some(now.goal.figure_px(&now.goal.std_px(&after)?))
    }

    /// The present information; `None` before the first view with depth.
    pub fn information(&self) -> Option<&DepthInformation> {
        self.now.as_ref().map(|now| &now.known)
    }

    /// How much one more view would lower that uncertainty: the mean over the image of the relative
    /// drop of the standard deviation, 0 to 1. A view without depth only adds information on
    /// color's lens.
    pub fn gain(&self, in_color: &ViewInformation, view: &BoardInDepth) -> f64 {
        let Some((now, after)) = self.after(in_color, view) else { return 0.0 };
        let drops = now.std_px.iter().zip(&after).map(|(now, after)| 1.0 - after / now);
        drops.sum::<f64>() / now.std_px.len() as f64
    }

    /// How much one more view would lower the goal's criterion, relatively, 0 to 1.
    pub fn drop(&self, in_color: &ViewInformation, view: &BoardInDepth) -> f64 {
        let after = self.after(in_color, view);
        after.map_or(0.0, |(now, after)| now.drop(&after))
    }

    /// The information that is expected of a suggested view.
    pub(super) fn expected(
        &self,
        color: &CameraInformation,
        board: &CandidateBoard<'_>,
    ) -> Option<ExpectedInformation> {
        let now = self.now.as_ref()?;
        let of_color = board.in_color.lens_information(&now.known.free)?;
        let surface =
            self.noise.expected(&self.depth, self.size, color.board(), board.color_from_board);
        let z_m = surface.as_ref().map(|surface| distance_m(&surface.tiles));
        let corners = (board.in_color, board.in_infrared);
        let seen = (board.color_from_board, corners);
        let of_depth = self.normal(&now.known, seen, surface.as_ref());
        Some(ExpectedInformation { of_color, z_m: z_m.filter(|_| of_depth.is_some()), of_depth })
    }

    /// The nearest and the farthest distance at which boards were measured; `None` before the
    /// first.
    pub(super) fn seen_m(&self) -> Option<[f64; 2]> {
        let of = |of: fn(f64, f64) -> f64| self.views.iter().map(|view| view.z_m).reduce(of);
        Some([of(f64::min)?, of(f64::max)?])
    }

    /// The goal for boards from the nearest to the farthest of `seen_m`.
    pub(super) fn goal(
        &self,
        color: &CameraInformation,
        free: &[usize],
        [near_m, far_m]: [f64; 2],
    ) -> Option<DepthGoal> {
        let sensors = DepthColorPair {
            depth: &self.depth,
            depth_size: self.size,
            color: color.lens(),
            free,
            color_size: color.size(),
        };
        DepthGoal::new(sensors, &[near_m, (near_m * far_m).sqrt(), far_m], color.figure())
    }

    pub(super) fn now(&self) -> Option<&DepthUncertainty> {
        self.now.as_ref()
    }

    fn after(
        &self,
        in_color: &ViewInformation,
        view: &BoardInDepth,
    ) -> Option<(&DepthUncertainty, Vec<f64>)> {
        let now = self.now.as_ref()?;
        if in_color.information().nrows() != now.known.free.len() {
            return None;
        }
        let seen = (view.surface.as_ref(), view.infrared.as_ref());
        let depth = self.normal_of(&now.known, in_color, seen);
        let after = now.known.with(in_color.information(), depth.as_ref());
        Some((now, now.goal.std_px(&after)?))
    }

    fn normal_of(
        &self,
        known: &DepthInformation,
        in_color: &ViewInformation,
        (surface, infrared): (Option<&MeasuredView>, Option<&ViewInformation>),
    ) -> Option<DepthNormal> {
        let corners = (in_color.normal(), infrared.map(ViewInformation::normal));
        let sample = surface.map(|surface| &surface.sample);
        self.normal(known, (&in_color.camera_from_board, corners), sample)
    }

    /// What one view adds for depth: by color's corners, by infrared's corners where they are used,
    /// and by a sample of tiles on the board's surface.
    fn normal(
        &self,
        known: &DepthInformation,
        (color_from_board, (color, infrared)): (&Pose, (&ViewNormal, Option<&ViewNormal>)),
        surface: Option<&TileSample>,
    ) -> Option<DepthNormal> {
        let centered = Pose::new(color_from_board.rotation(), color.middle_in_camera);
        let [tile_scatter, together] = self.scatter.map(|scatter| scatter * scatter);
        // If corners determine lens and pose, the inflation by correlated errors applies to the
        // planes only; else to all of depth.
        let variance = if self.by_infrared { tile_scatter * together } else { tile_scatter };
        let planes =
            surface.and_then(|tiles| PlaneNormal::of(&self.depth, &centered, tiles, variance));
        let infrared = infrared.filter(|_| self.by_infrared);
        let infrared = infrared
            .map(|corners| InfraredNormal::of(&self.depth, &color.middle_in_camera, corners));
        match (infrared, planes) {
            (Some(infrared), planes) => {
                known.of_view_with_infrared(color, &infrared, planes.as_ref())
            }
            (None, Some(planes)) => known.of_view(color, &planes),
            (None, None) => None,
        }
    }

    fn known(&self, color: &CameraInformation) -> Option<DepthUncertainty> {
        let mut known = DepthInformation::prior(color.known(), &self.depth);
        if self.by_infrared {
            known = known.with_infrared(&self.depth);
        } else {
            known.together = self.scatter[1] * self.scatter[1];
        }
        for in_color in color.views() {
            let surface = self.views.iter().find(|view| view.number == in_color.number);
            let view = self.normal_of(&known, in_color, (surface, self.in_infrared(in_color)));
            view.into_iter().for_each(|view| known.add(&view));
        }
        let goal = self.goal(color, &known.free, self.seen_m()?)?;
        let std_px = goal.std_px(&known)?;
        Some(DepthUncertainty { known, goal, std_px })
    }

    /// The same view in infrared.
    fn in_infrared(&self, in_color: &ViewInformation) -> Option<&ViewInformation> {
        self.infrared.as_ref()?.views().iter().find(|view| view.number == in_color.number)
    }

    /// Infrared, if it has enough views for its corners to determine its lens.
    fn usable_infrared(&self) -> Option<&CameraInformation> {
        let infrared = self.infrared.as_ref()?;
        (infrared.is_estimated() && infrared.views().len() >= LEAST_VIEWS).then_some(infrared)
    }

    /// The depth camera's lens and pose from infrared corners.
    fn posed_by_infrared(&self, color: &CameraInformation) -> Option<PosedDepthLens> {
        let infrared = self.usable_infrared()?;
        let both = color.views().iter().filter_map(|in_color| {
            let board_from_color = in_color.camera_from_board.inverse();
            Some(self.in_infrared(in_color)?.camera_from_board * board_from_color)
        });
        let depth_from_color: Vec<Pose> = both.collect();
        let depth_from_color = median_pose(&depth_from_color)?;
        Some(PosedDepthLens { lens: *infrared.lens(), depth_from_color })
    }

    /// Each view with depth, paired with its color view.
    fn with_color<'a>(
        &'a self,
        color: &'a CameraInformation,
    ) -> impl Iterator<Item = (&'a ViewInformation, &'a MeasuredView)> {
        self.views.iter().filter_map(|measured| {
            let in_color =
                color.views().iter().find(|in_color| in_color.number == measured.number)?;
            Some((in_color, measured))
        })
    }

    fn estimate(&mut self, color: &CameraInformation) {
        let [near, far] = self.seen_m().unwrap_or([1.0; 2]);
        let mut start = self.guess.clone();
        start.correction.seen_m = [near / BEYOND_SEEN, far * BEYOND_SEEN];
        let by_infrared = self.posed_by_infrared(color);
        let posed = by_infrared.unwrap_or_else(|| self.guess(color));
        (start.lens, start.depth_from_color) = (posed.lens, posed.depth_from_color);
        self.by_infrared = by_infrared.is_some();
        if self.by_infrared {
            start = start.with_open_lens();
        }
        self.estimated_with_lenses = Some((*color.lens(), by_infrared.map(|posed| posed.lens)));
        // With infrared, the prior includes what corners alone determine.
        self.depth = start.clone();
        let mut known = DepthInformation::prior(color.known(), &start);
        for in_color in color.views().iter().filter(|_| self.by_infrared) {
            let view = self.normal_of(&known, in_color, (None, self.in_infrared(in_color)));
            view.into_iter().for_each(|view| known.add(&view));
        }
        let prior = known.depth.by_depth;
        let views: Vec<_> = self.with_color(color).collect();
        let each: Vec<_> = (views.iter())
            .map(|(in_color, measured)| (*in_color, measured.tiles.as_slice()))
            .collect();
        let Some(fitted) = fit_depth(&start, &prior, &each) else { return };
        let numbers: Vec<u32> = views.iter().map(|(_, measured)| measured.number).collect();
        let FittedDepth { depth, scatter, used, .. } = fitted;
        (self.depth, self.scatter) = (depth, scatter);
        for (number, used) in numbers.into_iter().zip(used) {
            let view = self.views.iter_mut().find(|view| view.number == number);
            view.into_iter().for_each(|view| view.sample = sample(&view.tiles, &used));
        }
        self.estimated_among = self.views.len();
        self.noise.learn(self.views.iter().map(|view| (view.z_m, view.tiles.as_slice())));
    }
}

impl DepthUncertainty {
    /// The relative drop of the criterion.
    pub(super) fn drop(&self, after: &[f64]) -> f64 {
        1.0 - self.goal.criterion_px(after) / self.goal.criterion_px(&self.std_px)
    }
}
