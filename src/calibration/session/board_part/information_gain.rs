//! The information that a frame would add about one camera of a session, and whether that is worth
//! keeping.

use crate::calibration::admission::Rejection;
use crate::calibration::information::camera_information::ViewInformation;
use crate::calibration::placement::Placement;
use crate::calibration::session::board_part::{AddedInformation, BoardPart};
use crate::calibration::session::depth_frame::DepthFrame;
use crate::calibration::view::{FrameFacts, View, target_as_seen};
use crate::detection::board_detection::Detection;
use crate::geometry::pose::Pose;

/// Before the lens is estimated, a view whose placement differs from all others by at least this
/// many steps is kept. Chosen, not swept.
const FIRST_VIEW_STEPS: f64 = 0.6;
/// While the board approaches the suggested view, a frame is kept only if it lowers the goal's
/// criterion by at least this fraction of what that view would. Chosen, not swept; the time for
/// which it is waited for was swept (docs/guidance.md).
const LEAST_DROP_FRACTION: f64 = 0.7;

impl BoardPart {
    /// The information in a detection; `None` where no pose of the whole board explains it.
    pub(super) fn view_information(
        &self,
        frame: &FrameFacts,
        detection: &Detection,
    ) -> Option<ViewInformation> {
        let fits = self.image_size().is_none_or(|expected| expected == frame.image_size);
        let information = self.information.as_ref().filter(|_| fits && detection.position_known)?;
        let number = self.views.len() as u32;
        let view = View { number, frame: frame.clone(), detection: detection.clone() };
        let target = target_as_seen(&self.target, [&view]);
        information.view(number, view.to_board_view(&target), detection.blur_px)
    }

    /// The same with what its depth image shows.
    pub(super) fn view_information_with_depth(
        &mut self,
        frame: &FrameFacts,
        detection: &Detection,
        depth: Option<&DepthFrame>,
    ) -> AddedInformation {
        let added = self.view_information(frame, detection);
        let color = self.information.as_ref();
        let seen = self.depth.seen(&self.target, color, frame, depth, added.as_ref());
        (added, seen)
    }

    /// Whether a view adds enough information to be kept: `Ok` with the index of the view it
    /// replaces, or `None` while there is room. While there is room, a view whose information
    /// cannot be predicted is kept: the solve decides.
    pub(super) fn room_for(
        &self,
        frame: &FrameFacts,
        placement: &Placement,
        (added, depth): &AddedInformation,
    ) -> Result<Option<u32>, Rejection> {
        let full = Rejection::Full { limit: self.options.view_limit };
        let is_full = self.views.len() >= self.options.view_limit as usize;
        let (Some(information), Some(added)) = (&self.information, added) else {
            return if is_full { Err(full) } else { Ok(None) };
        };
        let (gain, needed) = (information.gain(added), self.least_gain());
        let awaited = self.awaited(frame, &added.camera_from_board);
        // Before the lens is estimated, every view at a new placement helps to estimate it.
        let steps = self.placements.iter().map(|kept| kept.steps_to(placement));
        let counts =
            !information.is_estimated() && steps.fold(f64::INFINITY, f64::min) >= FIRST_VIEW_STEPS;
        let counts = counts || self.depth.is_informative(added, depth, self.options.worth);
        if !self.views.is_empty() && gain < needed && !counts {
            return Err(Rejection::LittleInformation { gain, needed });
        }
        if let Some(needed) = awaited {
            let by_depth = self.depth.drop(added, depth);
            let (gain, needed) = match by_depth {
                Some([gain, requested]) => (gain, LEAST_DROP_FRACTION * requested),
                None => (information.drop(added), needed),
            };
            if gain < needed {
                return Err(Rejection::LittleInformation { gain, needed });
            }
        }
        if !is_full {
            return Ok(None);
        }
        match information.least_informative() {
            Some((least, loss)) if loss < gain => Ok(Some(least)),
            _ => Err(full),
        }
    }

    /// The gain that a view must have to be kept: half of `worth` over the number of views.
    pub(super) fn least_gain(&self) -> f64 {
        0.5 * self.options.worth / self.views.len().max(1) as f64
    }

    /// While the board is about to arrive at the suggested view: how much another view must lower
    /// the goal's criterion, as a good part of what that view would.
    pub(super) fn awaited(&self, frame: &FrameFacts, camera_from_board: &Pose) -> Option<f64> {
        let (information, suggested) =
            (self.information.as_ref()?, self.advice.suggested.as_ref()?);
        let poses = [camera_from_board, &suggested.camera_from_board];
        let arriving = self.approach.is_arriving(frame, poses, information);
        arriving.then_some(LEAST_DROP_FRACTION * suggested.drop)
    }
}
