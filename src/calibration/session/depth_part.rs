//! What one camera of an instrument has collected about its depth in a session, and the view to
//! request for it.
//!
//! Depth counts from the first view that has it, or from the view that determines the meaning of
//! its numbers (`raw_depth`), where nobody states that. Boards seen by the infrared camera that
//! measures depth count with it, as in the solve.

use crate::calibration::information::board_in_depth::BoardInDepth;
use crate::calibration::information::camera_information::{CameraInformation, ViewInformation};
use crate::calibration::information::depth_camera_information::{
    DepthCameraInformation, DeviceDepth,
};
use crate::calibration::information::next_depth_view::{NextDepthView, suggest_depth_view};
use crate::calibration::information::next_view::SuggestedView;
use crate::calibration::session::depth_frame::DepthFrame;
use crate::calibration::session::raw_depth::{RawDepthFrame, RawDepthViews, raw_depth};
use crate::calibration::view::{FrameFacts, View, target_as_seen};
use crate::detection::board_detection::Detection;
use crate::geometry::depth_camera::DepthReading;
use crate::geometry::target::Target;

/// A depth camera's part of a session.
#[derive(Debug, Clone, Default)]
pub(super) struct DepthPart {
    information: Option<DepthCameraInformation>,
    /// The views whose depth has no stated meaning.
    raw: RawDepthViews,
    next: Option<NextDepthView>,
    /// The suggested view is the most informative one for depth.
    is_requested: bool,
}

/// What the depth camera shows of one view.
#[derive(Debug, Clone, Default)]
pub(super) struct SeenDepth {
    board: BoardInDepth,
    /// The frame, if its depth has no stated meaning.
    raw: Option<RawDepthFrame>,
}

/// Depth that no model fits after this many views is left to the verdict: a session that waited for
/// it would never end.
const GIVEN_UP_VIEWS: usize = 10;
/// Depth stops counting at this many views. This is a guard: of 31 seeded sessions, 15 of them
/// begun with three frontal boards, none took more than 11 views with depth (docs/guidance.md).
const MOST_DEPTH_VIEWS: usize = 40;

impl DepthPart {
    /// What the depth image shows that was taken with `added`.
    pub(super) fn seen(
        &mut self,
        target: &Target,
        color: Option<&CameraInformation>,
        facts: &FrameFacts,
        frame: Option<&DepthFrame>,
        added: Option<&ViewInformation>,
    ) -> SeenDepth {
        let (Some(color), Some(frame), Some(added)) = (color, frame, added) else {
            return SeenDepth::default();
        };
        if let Some(reading) = frame.encoding.reading {
            let nothing = || no_information(target, color, frame, reading);
            self.information.get_or_insert_with(nothing);
        }
        let seen = (facts, frame, added);
        let board = self.information.as_mut().map(|it| board_in_depth(it, target, color, seen));
        SeenDepth { board: board.unwrap_or_default(), raw: raw_depth(target, color, seen) }
    }

    /// Whether a view is worth keeping for its information about depth: at least `worth` times half
    /// of what the views with depth added on average, or any while the meaning of depth is open.
    /// `false` while depth does not count.
    pub(super) fn is_informative(
        &self,
        added: &ViewInformation,
        seen: &SeenDepth,
        worth: f64,
    ) -> bool {
        if seen.raw.is_some() && self.raw.is_open() {
            return true;
        }
        let (Some(information), seen) = (self.counted(), &seen.board) else { return false };
        (seen.surface.is_some() || seen.infrared.is_some())
            && information.gain(added, seen) >= 0.5 * worth / information.measured().max(1) as f64
    }

    /// How much this view lowers the depth uncertainty, and how much the suggested view would;
    /// `None` unless the suggested view is for depth.
    pub(super) fn drop(&self, added: &ViewInformation, seen: &SeenDepth) -> Option<[f64; 2]> {
        let next = self.next.as_ref().filter(|_| self.is_requested)?;
        Some([self.counted()?.drop(added, &seen.board), next.drop])
    }

    /// Adds a kept view, number `number` of `color`.
    pub(super) fn add(
        &mut self,
        target: &Target,
        (number, seen): (u32, SeenDepth),
        color: &CameraInformation,
    ) {
        if let Some(information) = &mut self.information {
            information.add(number, seen.board, color);
        }
        let counts = self.raw.is_open() || self.counted().is_some();
        let Some(raw) = seen.raw.filter(|_| counts) else { return };
        self.raw.add(number, raw);
        if let Some(reading) = self.raw.meaning(target, color) {
            self.information = self.read_as(reading, target, color);
        }
    }

    /// The information in the views whose depth means `reading`.
    fn read_as(
        &self,
        reading: DepthReading,
        target: &Target,
        color: &CameraInformation,
    ) -> Option<DepthCameraInformation> {
        let mut views = self.raw.with_color(color).peekable();
        let (_, (_, first)) = views.peek()?;
        let mut information = no_information(target, color, first, reading);
        for (added, (facts, frame)) in views {
            let seen = board_in_depth(&mut information, target, color, (facts, frame, added));
            information.add(added.number, seen, color);
        }
        Some(information)
    }

    /// The color view with this number was removed.
    pub(super) fn remove(&mut self, number: u32) {
        self.raw.remove(number);
        self.information.iter_mut().for_each(|information| information.remove(number));
    }

    /// Whether depth is known to `goal_px`, as far as it counts.
    pub(super) fn reaches(&self, goal_px: f64) -> bool {
        let is_known =
            |depth: &DepthCameraInformation| depth.uncertainty_px().is_some_and(|px| px <= goal_px);
        !self.raw.is_awaited() && self.counted().is_none_or(is_known)
    }

    /// The view to ask for: color's `own`, unless depth is known less well than color and another
    /// view lowers that more. Its `views_to_go` covers both.
    pub(super) fn request(
        &mut self,
        color: &CameraInformation,
        own: Option<&SuggestedView>,
        goal_px: Option<f64>,
    ) -> Option<SuggestedView> {
        let next = self.counted().and_then(|depth| suggest_depth_view(depth, color, goal_px));
        (self.next, self.is_requested) = (next, false);
        let Some(depth) = self.counted() else { return own.cloned() };
        // While the pose of depth is only a guess, neither the uncertainty after a view nor the
        // number of views can be predicted.
        let is_placed = depth.is_placed(color);
        let next = self.next.as_ref();
        let views_to_go = own.zip(next).filter(|_| is_placed).and_then(|(own, next)| {
            let ([a, b], [c, d]) = (own.views_to_go?, next.views_to_go?);
            Some([a.max(c), b.max(d)])
        });
        let own = own.map(|own| {
            let after_px = depth.uncertainty_with_color(&own.information).filter(|_| is_placed);
            let both_px = own.expected_uncertainty_px.zip(after_px);
            let expected_uncertainty_px = both_px.map(|(own_px, depth_px)| own_px.max(depth_px));
            SuggestedView { views_to_go, expected_uncertainty_px, ..own.clone() }
        });
        let is_less_known = |next: &&NextDepthView| {
            own.as_ref().is_none_or(|own| own.uncertainty_px < next.uncertainty_px)
        };
        let Some(next) = next.filter(is_less_known) else { return own };
        let requested = color.suggested(next.camera_from_board, &next.normal, views_to_go);
        let requested = requested.map(|requested| SuggestedView {
            uncertainty_px: next.uncertainty_px,
            expected_uncertainty_px: (requested.expected_uncertainty_px.filter(|_| is_placed))
                .map(|color_px| color_px.max(next.expected_uncertainty_px)),
            is_for_depth: true,
            ..requested
        });
        self.is_requested = requested.is_some();
        requested.or(own)
    }

    /// The information in the views about depth, as long as depth counts.
    pub(super) fn counted(&self) -> Option<&DepthCameraInformation> {
        let information = self.information.as_ref()?;
        let is_fitted =
            information.uncertainty_px().is_some() || information.measured() < GIVEN_UP_VIEWS;
        let counts = (1..MOST_DEPTH_VIEWS).contains(&information.measured());
        (counts && is_fitted).then_some(information)
    }
}

/// No information yet on the depth camera that took `frame`.
fn no_information(
    target: &Target,
    color: &CameraInformation,
    frame: &DepthFrame,
    reading: DepthReading,
) -> DepthCameraInformation {
    let (size, invalid) = (frame.image.size(), frame.encoding.invalid);
    let stated = DeviceDepth { size, reading, invalid, factory: frame.factory };
    DepthCameraInformation::new(target, color, &stated)
}

/// What depth and infrared show of the board that color sees as `added`.
fn board_in_depth(
    information: &mut DepthCameraInformation,
    target: &Target,
    color: &CameraInformation,
    (facts, frame, added): (&FrameFacts, &DepthFrame, &ViewInformation),
) -> BoardInDepth {
    let surface = information.measure(&frame.image, color, added);
    // Corners whose numbering may start at either end of the board do not determine its pose.
    let is_placed = |seen: &&Detection| seen.position_known && !seen.orientation_ambiguous;
    let infrared = frame.infrared.as_ref().filter(is_placed).and_then(|seen| {
        let size = frame.image.size();
        let facts = FrameFacts { image_size: size, ..facts.clone() };
        let view = View { number: added.number, frame: facts, detection: seen.clone() };
        let target = target_as_seen(target, [&view]);
        information.see(view.to_board_view(&target), seen.blur_px, color, added)
    });
    BoardInDepth { surface, infrared }
}
