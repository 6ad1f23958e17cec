//! Depth of which nobody states what its numbers mean: the views of a session say it, as those of
//! the solve do.
//!
//! Until boards at different distances were seen, what a view would teach of depth cannot be said:
//! the first views with depth are kept. From then on it counts as stated depth does; what it means
//! is found anew as views with depth grow.

use crate::calibration::disparity_meaning::{KnownReading, disparity_through, reading_in_middle};
use crate::calibration::information::depth_teaching::guessed_depth;
use crate::calibration::information::teaching::{TaughtView, Teaching};
use crate::calibration::session::depth_frame::DepthFrame;
use crate::calibration::view::FrameFacts;
use crate::geometry::depth_camera::DepthReading;
use crate::geometry::target::Target;

/// A frame with its depth image.
pub(super) type UnreadFrame = (FrameFacts, DepthFrame);

/// The views with such depth.
#[derive(Debug, Clone, Default)]
pub(super) struct UnreadDepth {
    views: Vec<(u32, UnreadFrame)>,
    /// What its numbers mean, once that was found among so many views.
    found_among: Option<usize>,
}

/// Depth that fits no camera after so many views is left to the verdict: a session that waited for
/// it would never end.
pub(super) const GIVEN_UP: usize = 10;
/// A line takes two views, and one more shows that it is one; the solve takes as many with depth.
const LEAST_VIEWS: usize = 3;
/// Boards whose distances differ by less than this factor determine no line.
const LEAST_RANGE: f64 = 1.3;
/// The meaning is found anew when views have grown by this factor.
const GROWTH: f64 = 1.3;

/// What `frame` reads in the middle of the board that color sees as `taught`.
fn known_reading(
    target: &Target,
    color: &Teaching,
    frame: &DepthFrame,
    taught: &TaughtView,
) -> Option<KnownReading> {
    let depth = guessed_depth(color, frame.image.size(), frame.factory);
    let image = (&*frame.image, frame.encoding.invalid);
    reading_in_middle(image, &depth, target, &taught.camera_from_board)
}

/// The frame, where nobody states what its depth means and the board is measured in it.
pub(super) fn unread(
    target: &Target,
    color: &Teaching,
    (facts, frame, taught): (&FrameFacts, &DepthFrame, &TaughtView),
) -> Option<UnreadFrame> {
    let is_read = || known_reading(target, color, frame, taught).is_some();
    let is_unread = frame.encoding.reading.is_none() && is_read();
    is_unread.then(|| (facts.clone(), frame.clone()))
}

impl UnreadDepth {
    /// Whether views are kept for what they may say of it: what the numbers mean is open, and there
    /// are few.
    pub(super) fn is_open(&self) -> bool {
        self.found_among.is_none() && self.len() < GIVEN_UP
    }

    pub(super) fn len(&self) -> usize {
        self.views.len()
    }

    pub(super) fn add(&mut self, number: u32, seen: UnreadFrame) {
        self.views.push((number, seen));
    }

    pub(super) fn remove(&mut self, number: u32) {
        self.views.retain(|(other, _)| *other != number);
    }

    /// Each view with what color saw in it.
    pub(super) fn with_color<'a>(
        &'a self,
        color: &'a Teaching,
    ) -> impl Iterator<Item = (&'a TaughtView, &'a UnreadFrame)> {
        self.views.iter().filter_map(|(number, seen)| {
            Some((color.views().iter().find(|taught| taught.number == *number)?, seen))
        })
    }

    /// What the numbers mean, where the views say it now that did not before, or say it better.
    pub(super) fn meaning(&mut self, target: &Target, color: &Teaching) -> Option<DepthReading> {
        let grown = |before: usize| self.views.len() as f64 >= GROWTH * before as f64;
        if !(self.found_among.is_none_or(grown) && color.is_estimated()) {
            return None;
        }
        let in_middle = |(taught, (_, frame)): (&TaughtView, &UnreadFrame)| {
            known_reading(target, color, frame, taught)
        };
        let known: Vec<_> = self.with_color(color).filter_map(in_middle).collect();
        let each = || known.iter().map(|it| it.inverse_depth);
        let (far, near) = (each().fold(f64::INFINITY, f64::min), each().fold(0.0, f64::max));
        if known.len() < LEAST_VIEWS || near < LEAST_RANGE * far {
            return None;
        }
        let meaning = disparity_through(&known)?;
        // A hole of which nobody says that it is one must not hide what the others say.
        let read = known.iter().filter(|it| meaning.inverse_depth(it.reading).is_some());
        if 2 * read.count() <= known.len() {
            return None;
        }
        self.found_among = Some(self.views.len());
        Some(meaning)
    }
}
