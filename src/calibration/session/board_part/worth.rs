//! The information that a frame would add about one camera of a session, and whether that is worth
//! keeping.

use crate::calibration::admission::Rejection;
use crate::calibration::information::teaching::TaughtView;
use crate::calibration::placement::Placement;
use crate::calibration::session::board_part::{BoardPart, Taught};
use crate::calibration::session::depth_part::DepthFrame;
use crate::calibration::view::{FrameFacts, View, target_as_seen};
use crate::detection::board_detection::Detection;
use crate::geometry::pose::Pose;

/// Before the lens is estimated, a view whose placement differs from all others by at least this
/// many steps is kept.
const FIRST_STEPS: f64 = 0.6;
/// While the board approaches the suggested view, a frame is kept only if it adds at least this
/// fraction of the information that is expected of that view.
const GOOD_PART: f64 = 0.7;

impl BoardPart {
    /// The information in a detection; `None` where no pose of the whole board explains it.
    pub(super) fn taught(&self, frame: &FrameFacts, detection: &Detection) -> Option<TaughtView> {
        let fits = self.image_size().is_none_or(|expected| expected == frame.image_size);
        let teaching = self.teaching.as_ref().filter(|_| fits && detection.position_known)?;
        let number = self.views.len() as u32;
        let view = View { number, frame: frame.clone(), detection: detection.clone() };
        let target = target_as_seen(&self.target, [&view]);
        teaching.view(number, view.to_board_view(&target), detection.blur_px)
    }

    /// The same with what its depth image shows.
    pub(super) fn taught_by(
        &mut self,
        frame: &FrameFacts,
        detection: &Detection,
        depth: Option<&DepthFrame>,
    ) -> Taught {
        let taught = self.taught(frame, detection);
        let seen = (frame, depth, taught.as_ref());
        let seen = self.depth.seen(&self.target, self.teaching.as_ref(), seen);
        (taught, seen)
    }

    /// Whether a view adds enough information to be kept: `Ok` with the index of the view it
    /// replaces, or `None` while there is room. A view whose worth cannot be predicted is kept: the
    /// solve decides.
    pub(super) fn room_for(
        &self,
        frame: &FrameFacts,
        placement: &Placement,
        (taught, depth): &Taught,
    ) -> Result<Option<u32>, Rejection> {
        let full = Rejection::Full { limit: self.options.view_limit };
        let is_full = self.views.len() >= self.options.view_limit as usize;
        let (Some(teaching), Some(taught)) = (&self.teaching, taught) else {
            return if is_full { Err(full) } else { Ok(None) };
        };
        let (gain, needed) = (teaching.gain(taught), self.share());
        let awaited = self.awaited(frame, &taught.camera_from_board);
        // Before the lens is estimated, every view at a new placement helps to estimate it.
        let steps = self.placements.iter().map(|kept| kept.steps_to(placement));
        let counts = !teaching.is_estimated() && steps.fold(f64::INFINITY, f64::min) >= FIRST_STEPS;
        let counts = counts || self.depth.is_taught(taught, depth, self.options.worth);
        if !self.views.is_empty() && gain < needed && !counts {
            return Err(Rejection::TeachesLittle { gain, needed });
        }
        if let Some(needed) = awaited {
            let by_depth = self.depth.drop(taught, depth);
            let (gain, needed) = match by_depth {
                Some([gain, asked]) => (gain, GOOD_PART * asked),
                None => (teaching.drop(taught), needed),
            };
            if gain < needed {
                return Err(Rejection::TeachesLittle { gain, needed });
            }
        }
        if !is_full {
            return Ok(None);
        }
        match teaching.least_informative() {
            Some((least, loss)) if loss < gain => Ok(Some(least)),
            _ => Err(full),
        }
    }

    /// The information that a view must add to be kept: half of `worth` over the number of views.
    pub(super) fn share(&self) -> f64 {
        0.5 * self.options.worth / self.views.len().max(1) as f64
    }

    /// While the board is about to arrive at the suggested view: how much another view must lower
    /// the goal's figure, as a good part of what that view would.
    pub(super) fn awaited(&self, frame: &FrameFacts, camera_from_board: &Pose) -> Option<f64> {
        let (teaching, suggested) = (self.teaching.as_ref()?, self.advice.suggested.as_ref()?);
        let poses = [camera_from_board, &suggested.camera_from_board];
        let arriving = self.approach.is_arriving(frame, poses, teaching);
        arriving.then_some(GOOD_PART * suggested.drop)
    }
}
