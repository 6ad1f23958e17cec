//! Looking for the board in a frame set's picture: decoded to luma, then searched, or followed from
//! the frame before.

use crate::detection::board_detection::DetectOptions;
use crate::detection::finder::TargetFinder;
use crate::detection::tracking::Sighting;
use crate::geometry::target::Target;
use crate::imaging::decode;
use crate::imaging::frame::{Frame, FrameSet, SensorKind};
use crate::imaging::gray::GrayImage;
use crate::pipeline::guarded::guarded;
use crate::pipeline::live_frame::LookError;

/// How a frame is looked at.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Manner {
    /// By itself: the answer is the picture's alone, as exact as it can be.
    Searched,
    /// Where the board was before, else by itself: a fraction of the time, and corners that are
    /// good enough to decide on.
    Followed,
}

/// Looks for boards; its buffers are kept from frame to frame.
#[derive(Default)]
pub(super) struct BoardLook {
    finder: Option<TargetFinder>,
    luma: GrayImage,
}

impl BoardLook {
    pub(super) fn look(
        &mut self,
        frame_set: &FrameSet,
        target: &Target,
        manner: Manner,
    ) -> Result<Sighting, LookError> {
        guarded(|| self.try_look(frame_set, target, manner)).unwrap_or_else(|detail| {
            // What it was doing when it broke off is not to be trusted.
            self.finder = None;
            Err(LookError::Unreadable { detail })
        })
    }

    fn try_look(
        &mut self,
        frame_set: &FrameSet,
        target: &Target,
        manner: Manner,
    ) -> Result<Sighting, LookError> {
        let unreadable = |detail: String| LookError::Unreadable { detail };
        let frame = picture_of(frame_set)
            .ok_or_else(|| unreadable("there is none in this frame set".to_owned()))?;
        decode::luma(frame, &mut self.luma).map_err(|error| unreadable(error.to_string()))?;
        let finder = match &mut self.finder {
            Some(finder) if finder.target() == target => finder,
            other => other.insert(TargetFinder::new(target)),
        };
        let (image, options) = (self.luma.view(), DetectOptions::default());
        Ok(match manner {
            Manner::Searched => {
                Sighting { detection: finder.find(image, &options)?, followed: false }
            }
            Manner::Followed => finder.track(image, &options)?,
        })
    }
}

/// The frame that boards are looked for in.
pub(super) fn picture_of(frame_set: &FrameSet) -> Option<&Frame> {
    frame_set.frame(SensorKind::Color).or_else(|| frame_set.frame(SensorKind::Infrared))
}
