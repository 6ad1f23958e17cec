//! Depth images of unknown meaning: the session's views determine it, as those of the solve do.
//!
//! Before boards at different distances were seen, the information that a view would add about
//! depth cannot be predicted: the first views with depth are kept. From then on depth counts as if its
//! meaning were stated; the meaning is estimated anew as the views with depth grow.

use crate::calibration::information::camera_information::{CameraInformation, ViewInformation};
use crate::calibration::session::depth_frame::DepthFrame;
use crate::calibration::solve::disparity_meaning::{
    KnownReading, disparity_through, reading_in_middle,
};
use crate::calibration::solve::rgbd_guess::initial_depth;
use crate::calibration::view::FrameFacts;
use crate::geometry::depth_camera::DepthReading;
use crate::geometry::target::Target;

/// A frame with its depth image.
pub(super) type RawDepthFrame = (FrameFacts, DepthFrame);

/// The views with such depth.
#[derive(Debug, Clone, Default)]
pub(super) struct RawDepthViews {
    views: Vec<(u32, RawDepthFrame)>,
    /// From how many views the meaning was estimated, if it was.
    found_among: Option<usize>,
}

/// Two views determine a line, and a third shows that it is one; the solve needs as many.
const LEAST_VIEWS: usize = 3;
/// Boards whose distances differ by less than this factor do not determine a line, as for the noise
/// of readings over the distance. Chosen, not swept.
const LEAST_RANGE: f64 = 1.3;
/// A meaning that this many views do not determine is left to the solve: a session that waited for
/// it might never end.
const MOST_OPEN_VIEWS: usize = 10;
/// The meaning is estimated anew when the views have grown by this factor, as the depth camera is.
const GROWTH: f64 = 1.3;

/// The reading of `frame` in the middle of the board that color sees as `in_color`.
fn known_reading(
    target: &Target,
    color: &CameraInformation,
    frame: &DepthFrame,
    in_color: &ViewInformation,
) -> Option<KnownReading> {
    let size = frame.image.size();
    let depth = initial_depth((color.lens(), color.size()), size, frame.factory);
    let image = (&*frame.image, frame.encoding.invalid);
    reading_in_middle(image, &depth, target, &in_color.camera_from_board)
}

/// The frame, if the meaning of its depth is unknown and it has a reading in the board's middle.
pub(super) fn raw_depth(
    target: &Target,
    color: &CameraInformation,
    (facts, frame, added): (&FrameFacts, &DepthFrame, &ViewInformation),
) -> Option<RawDepthFrame> {
    let is_raw =
        frame.encoding.reading.is_none() && known_reading(target, color, frame, added).is_some();
    is_raw.then(|| (facts.clone(), frame.clone()))
}

impl RawDepthViews {
    /// Whether the meaning is unknown, and more views may determine it.
    pub(super) fn is_open(&self) -> bool {
        self.found_among.is_none() && self.views.len() < MOST_OPEN_VIEWS
    }

    /// Whether there are views that need more to determine the meaning.
    pub(super) fn is_awaited(&self) -> bool {
        self.is_open() && !self.views.is_empty()
    }

    pub(super) fn add(&mut self, number: u32, seen: RawDepthFrame) {
        self.views.push((number, seen));
    }

    pub(super) fn remove(&mut self, number: u32) {
        self.views.retain(|(other, _)| *other != number);
    }

    /// Each view, paired with its color view.
    pub(super) fn with_color<'a>(
        &'a self,
        color: &'a CameraInformation,
    ) -> impl Iterator<Item = (&'a ViewInformation, &'a RawDepthFrame)> {
        self.views.iter().filter_map(|(number, seen)| {
            let in_color = color.views().iter().find(|in_color| in_color.number == *number)?;
            Some((in_color, seen))
        })
    }

    /// The meaning, if the views determine it now and did not before, or determine it better.
    pub(super) fn meaning(
        &mut self,
        target: &Target,
        color: &CameraInformation,
    ) -> Option<DepthReading> {
        let has_grown = |before: usize| self.views.len() as f64 >= GROWTH * before as f64;
        if !(self.found_among.is_none_or(has_grown) && color.is_estimated()) {
            return None;
        }
        let in_middle = |(in_color, (_, frame)): (&ViewInformation, &RawDepthFrame)| {
            known_reading(target, color, frame, in_color)
        };
        let known: Vec<_> = self.with_color(color).filter_map(in_middle).collect();
        let inverse = || known.iter().map(|it| it.inverse_depth);
        let [far, near] = [inverse().fold(f64::INFINITY, f64::min), inverse().fold(0.0, f64::max)];
        if known.len() < LEAST_VIEWS || near < LEAST_RANGE * far {
            return None;
        }
        let meaning = disparity_through(&known)?;
        if !known.iter().all(|it| meaning.inverse_depth(it.reading).is_some()) {
            return None;
        }
        self.found_among = Some(self.views.len());
        Some(meaning)
    }
}
