//! What a session's views have taught of the depth camera beside color: of its lens, its place and
//! its error, and of where color sees what it measures. Follows from the frames alone, as what
//! color has been taught.
//!
//! The depth camera is fitted anew whenever the views with depth have grown by a third or color's
//! lens was estimated anew, with color's poses held as well as their corners hold them; in between
//! information only adds up.

use nalgebra::{DMatrix, Point3};

use crate::calibration::information::corner_noise::side_px;
use crate::calibration::information::depth_fit::{FittedDepth, few, fit_depth};
use crate::calibration::information::depth_goal::DepthGoal;
use crate::calibration::information::depth_information::{DepthInformation, DepthNormal};
use crate::calibration::information::expected_depth::DepthTileNoise;
use crate::calibration::information::teaching::{TaughtView, Teaching};
use crate::calibration::information::view_information::ViewNormal;
use crate::calibration::rgbd_guess::{board_outline, same_view};
use crate::detection::board_plane::{NoPlane, PlaneOptions, find_board_plane};
use crate::estimation::rgbd::plane_information::{PlacedDepth, PlaneNormal};
use crate::geometry::depth_camera::{DepthReading, DepthTile};
use crate::geometry::lens::Lens;
use crate::geometry::pixel::ImageSize;
use crate::geometry::pose::Pose;
use crate::geometry::target::Target;
use crate::imaging::depth_image::DepthImage;

/// What the views of one camera teach of its depth.
#[derive(Debug, Clone)]
pub struct DepthTeaching {
    target: Target,
    size: ImageSize,
    invalid: Option<u16>,
    /// Its lens and pose were stated.
    is_stated: bool,
    guess: PlacedDepth,
    depth: PlacedDepth,
    views: Vec<MeasuredView>,
    estimated_among: usize,
    /// Color's lens at that estimate.
    estimated_beside: Option<Lens>,
    /// By how much tiles scatter more than their readings do, and neighbors together.
    scatter: [f64; 2],
    pub(super) noise: DepthTileNoise,
    now: Option<DepthNow>,
}

/// What is known by now.
#[derive(Debug, Clone)]
pub(super) struct DepthNow {
    pub(super) known: DepthInformation,
    pub(super) goal: DepthGoal,
    /// The uncertainty of each transferred pixel.
    pub(super) std_px: Vec<f64>,
}

/// What a board that nobody holds yet would teach.
pub(super) struct ExpectedView {
    /// Of color's lens.
    pub(super) of_color: DMatrix<f64>,
    /// Of depth, with the distance that it would measure, in meters; `None` where it would not.
    pub(super) of_depth: Option<(DepthNormal, f64)>,
}

/// What a depth camera is before a session, as far as anyone states it.
#[derive(Debug, Clone, PartialEq)]
pub struct DeviceDepth {
    /// The size of its images.
    pub size: ImageSize,
    /// What its numbers mean.
    pub reading: DepthReading,
    /// The reading that means none.
    pub invalid: Option<u16>,
    /// Its lens, and where color is.
    pub factory: Option<(Lens, Pose)>,
}

/// The board's surface in the depth image of one view.
#[derive(Debug, Clone, PartialEq)]
pub struct MeasuredView {
    /// Which of the session's views it is.
    pub number: u32,
    tiles: Vec<DepthTile>,
    /// Some of them, and for how many each stands.
    few: (Vec<DepthTile>, f64),
    /// The distance of the surface, in meters.
    z_m: f64,
}

/// The solve takes as many views with depth.
const LEAST_VIEWS: usize = 3;
/// The depth camera is fitted anew when views have grown by this factor.
const GROWTH: f64 = 1.3;
/// The correction is meant to hold so many times nearer and farther than was seen.
const BEYOND_SEEN: f64 = 4.0;
/// The board's surface is measured this far past its outer corners, as in the solve …
const MARGIN_SQUARES: f64 = 0.8;
/// … and only so far before them as long as nobody knows where that is.
const UNKNOWN_MARGIN_SQUARES: f64 = -1.0;
/// It is within so many standard deviations.
const CERTAIN: f64 = 2.0;

impl DepthTeaching {
    /// Nothing taught yet of a depth camera beside the one that `color` is of.
    pub fn new(target: &Target, color: &Teaching, stated: &DeviceDepth) -> Self {
        let size = stated.size;
        let guess = || (same_view(color.lens(), color.size(), size), Pose::identity());
        let (lens, depth_from_color) = stated.factory.unwrap_or_else(guess);
        let guess = PlacedDepth::new((lens, size), depth_from_color, (stated.reading, [0.3, 3.0]));
        Self {
            target: *target,
            size,
            invalid: stated.invalid,
            is_stated: stated.factory.is_some(),
            depth: guess.clone(),
            guess,
            views: Vec::new(),
            estimated_among: 0,
            estimated_beside: None,
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

    /// The board's surface in the depth image that was taken with `taught`; `None` where it was
    /// not measured, which is remembered of its distance.
    pub fn measure(
        &mut self,
        image: &DepthImage,
        (color, taught): (&Teaching, &TaughtView),
    ) -> Option<MeasuredView> {
        if image.size() != self.size {
            return None;
        }
        let known_margin = self.margin_squares(color, taught);
        let (lens, depth_from_color) = match known_margin {
            Some(_) => (self.depth.lens, self.depth.depth_from_color),
            None => self.guess(color),
        };
        let margin = known_margin.unwrap_or(UNKNOWN_MARGIN_SQUARES);
        let place = (&lens, &depth_from_color);
        let outline = board_outline(&self.target, place, &taught.camera_from_board, margin);
        let options = PlaneOptions { invalid: self.invalid, ..PlaneOptions::default() };
        let meaning = (self.depth.reading, &lens);
        match find_board_plane(image, meaning, &outline, &options) {
            Ok(tiles) => Some(MeasuredView::new(taught.number, tiles)),
            Err(NoPlane::Holes { .. } | NoPlane::NotFlat { .. }) => {
                let middle = Point3::from(taught.normal().middle_in_camera);
                self.noise.miss((depth_from_color * middle).z);
                None
            }
            Err(_) => None,
        }
    }

    /// Whether views say better than guesses where in the depth image a board is: only then is how
    /// uncertain that is a number of the views, and not of what was taken for known before them.
    pub fn is_placed(&self, color: &Teaching) -> bool {
        let newest = color.views().last();
        newest.is_some_and(|taught| self.fitted_margin_squares(color, taught).is_some())
    }

    /// How far past its outer corners the board's surface is searched for, by how well it is known
    /// where that is; `None` where the fit knows no better than the guess that it began with. A fit
    /// of few views may be off by more than the board is wide: searched for there, the board would
    /// never be found again.
    fn margin_squares(&self, color: &Teaching, taught: &TaughtView) -> Option<f64> {
        if self.is_stated {
            return Some(MARGIN_SQUARES);
        }
        self.fitted_margin_squares(color, taught)
    }

    fn fitted_margin_squares(&self, color: &Teaching, taught: &TaughtView) -> Option<f64> {
        let middle = color.board().middle();
        let side_m = color.board().side_m;
        let side_px = side_px(color.lens(), &taught.camera_from_board, &middle, side_m)?;
        let unknown_squares = CERTAIN * self.uncertainty_px()? / side_px;
        let margin = MARGIN_SQUARES - unknown_squares;
        (margin > UNKNOWN_MARGIN_SQUARES).then_some(margin)
    }

    /// The depth camera that a fit begins with: as stated, or one that sees what color sees.
    fn guess(&self, color: &Teaching) -> (Lens, Pose) {
        if self.is_stated {
            return (self.guess.lens, self.guess.depth_from_color);
        }
        let lens = same_view(color.lens(), color.size(), self.size);
        (lens, self.guess.depth_from_color)
    }

    /// Takes a view in; `color` has it already.
    pub fn add(&mut self, view: MeasuredView, color: &Teaching) {
        self.views.push(view);
        self.sum_up(color);
    }

    /// Takes the view with this number out.
    pub fn remove(&mut self, number: u32) {
        self.views.retain(|view| view.number != number);
    }

    /// Takes in what `color` has been taught meanwhile.
    pub fn sum_up(&mut self, color: &Teaching) {
        let count = self.views.len();
        let grown = count as f64 >= GROWTH * self.estimated_among as f64;
        let is_due = grown || self.estimated_beside != Some(*color.lens());
        if count >= LEAST_VIEWS && is_due && color.is_estimated() {
            self.estimate(color);
        }
        self.now = self.known(color);
    }

    /// The 1-σ uncertainty of where color sees what depth measures at the distances seen: the
    /// session's figure over the depth image, in pixels of color. `None` as long as fewer than
    /// three views have depth.
    pub fn uncertainty_px(&self) -> Option<f64> {
        let now = self.now.as_ref().filter(|_| self.estimated_among > 0)?;
        Some(now.goal.figure_px(&now.std_px))
    }

    /// The same with one more view that teaches of color's lens alone.
    pub fn uncertainty_beside(&self, of_color: &DMatrix<f64>) -> Option<f64> {
        let now = self.now.as_ref().filter(|_| self.estimated_among > 0)?;
        let fits = of_color.nrows() == now.known.free.len();
        let after = fits.then(|| now.known.with(of_color, None))?;
        Some(now.goal.figure_px(&now.goal.std_px(&after)?))
    }

    /// What is known; `None` as long as nothing is.
    pub fn information(&self) -> Option<&DepthInformation> {
        self.now.as_ref().map(|now| &now.known)
    }

    /// How much surer that would be with one more view: the mean over the image of the relative
    /// drop of its standard deviation, 0 to 1. One without depth teaches of color's lens alone.
    pub fn gain(&self, taught: &TaughtView, measured: Option<&MeasuredView>) -> f64 {
        let Some((now, after)) = self.after(taught, measured) else { return 0.0 };
        let drops = now.std_px.iter().zip(&after).map(|(now, after)| 1.0 - after / now);
        drops.sum::<f64>() / now.std_px.len() as f64
    }

    /// By how much the goal's criterion would fall with one more view, 0 to 1.
    pub fn drop(&self, taught: &TaughtView, measured: Option<&MeasuredView>) -> f64 {
        let after = self.after(taught, measured);
        after.map_or(0.0, |(now, after)| now.drop(&after))
    }

    /// As [`Self::drop`], of a view that color's corners would have `normal` of.
    pub(super) fn expected(
        &self,
        color: &Teaching,
        (color_from_board, normal): (&Pose, &ViewNormal),
    ) -> Option<ExpectedView> {
        let now = self.now.as_ref()?;
        let of_color = normal.lens_information(&now.known.free)?;
        let board = color.board();
        let tiles = self.noise.expected((&self.depth, self.size), (board, color_from_board));
        let of_depth = tiles.and_then(|(tiles, weight)| {
            let centered = Pose::new(color_from_board.rotation(), normal.middle_in_camera);
            let planes = PlaneNormal::of(&self.depth, &centered, (&tiles, self.weight(weight)))?;
            Some((now.known.of_view(normal, &planes)?, distance_m(&tiles)))
        });
        Some(ExpectedView { of_color, of_depth })
    }

    /// The nearest and the farthest distance that boards were measured at; `None` before the first.
    pub(super) fn seen_m(&self) -> Option<[f64; 2]> {
        let of = |of: fn(f64, f64) -> f64| self.views.iter().map(|view| view.z_m).reduce(of);
        Some([of(f64::min)?, of(f64::max)?])
    }

    /// What is to be known where boards are seen from the nearest to the farthest of `seen_m`.
    pub(super) fn goal(
        &self,
        color: &Teaching,
        (free, [near_m, far_m]): (&[usize], [f64; 2]),
    ) -> Option<DepthGoal> {
        DepthGoal::new(
            (&self.depth, self.size),
            (color.lens(), free, color.size()),
            (&[near_m, (near_m * far_m).sqrt(), far_m], color.figure()),
        )
    }

    pub(super) fn now(&self) -> Option<&DepthNow> {
        self.now.as_ref()
    }

    fn after(
        &self,
        taught: &TaughtView,
        measured: Option<&MeasuredView>,
    ) -> Option<(&DepthNow, Vec<f64>)> {
        let now = self.now.as_ref()?;
        if taught.information().nrows() != now.known.free.len() {
            return None;
        }
        let depth = measured.and_then(|measured| self.normal(&now.known, taught, measured));
        let after = now.known.with(taught.information(), depth.as_ref());
        Some((now, now.goal.std_px(&after)?))
    }

    /// How much a tile counts that stands for `count` of them.
    fn weight(&self, count: f64) -> f64 {
        count / (self.scatter[0] * self.scatter[0])
    }

    fn normal(
        &self,
        known: &DepthInformation,
        taught: &TaughtView,
        measured: &MeasuredView,
    ) -> Option<DepthNormal> {
        let (tiles, count) = &measured.few;
        let planes =
            PlaneNormal::of(&self.depth, &taught.centered(), (tiles, self.weight(*count)))?;
        known.of_view(taught.normal(), &planes)
    }

    fn known(&self, color: &Teaching) -> Option<DepthNow> {
        let mut known = DepthInformation::prior(color.known(), &self.depth);
        known.together = self.scatter[1] * self.scatter[1];
        for (taught, measured) in self.with_color(color) {
            self.normal(&known, taught, measured).into_iter().for_each(|view| known.add(&view));
        }
        let goal = self.goal(color, (&known.free, self.seen_m()?))?;
        let std_px = goal.std_px(&known)?;
        Some(DepthNow { known, goal, std_px })
    }

    /// Each view with what color saw in it.
    fn with_color<'a>(
        &'a self,
        color: &'a Teaching,
    ) -> impl Iterator<Item = (&'a TaughtView, &'a MeasuredView)> {
        self.views.iter().filter_map(|measured| {
            let taught = color.views().iter().find(|taught| taught.number == measured.number)?;
            Some((taught, measured))
        })
    }

    fn estimate(&mut self, color: &Teaching) {
        let [near, far] = self.seen_m().unwrap_or([1.0; 2]);
        let mut start = self.guess.clone();
        start.correction.seen_m = [near / BEYOND_SEEN, far * BEYOND_SEEN];
        start.lens = self.guess(color).0;
        let prior = DepthInformation::prior(color.known(), &start).depth.by_depth;
        let views: Vec<_> = self.with_color(color).collect();
        let each: Vec<_> =
            (views.iter()).map(|(taught, measured)| (*taught, measured.tiles.as_slice())).collect();
        let Some(fitted) = fit_depth(&start, &prior, &each) else { return };
        let numbers: Vec<u32> = views.iter().map(|(_, measured)| measured.number).collect();
        let FittedDepth { depth, scatter, used, .. } = fitted;
        (self.depth, self.scatter) = (depth, scatter);
        for (number, used) in numbers.into_iter().zip(used) {
            let view = self.views.iter_mut().find(|view| view.number == number);
            view.into_iter().for_each(|view| view.few = few(&view.tiles, &used));
        }
        self.estimated_among = self.views.len();
        self.estimated_beside = Some(*color.lens());
        self.noise.learn(self.views.iter().map(|view| (view.z_m, view.tiles.as_slice())));
    }
}

impl DepthNow {
    /// The relative drop of the criterion.
    pub(super) fn drop(&self, after: &[f64]) -> f64 {
        1.0 - self.goal.criterion_px(after) / self.goal.criterion_px(&self.std_px)
    }
}

impl MeasuredView {
    fn new(number: u32, tiles: Vec<DepthTile>) -> Self {
        let z_m = distance_m(&tiles);
        let few = few(&tiles, &vec![true; tiles.len()]);
        Self { number, tiles, few, z_m }
    }

    /// The same as the `number`-th view.
    #[must_use]
    pub fn numbered(self, number: u32) -> Self {
        Self { number, ..self }
    }
}

/// The distance of a surface, in meters.
fn distance_m(tiles: &[DepthTile]) -> f64 {
    let sum = tiles.iter().map(|tile| tile.inverse_depth).sum::<f64>();
    tiles.len() as f64 / sum.max(f64::MIN_POSITIVE)
}
