//! A view: a detection that a session kept.

use crate::detection::board_detection::Detection;
use crate::estimation::problem::{BoardView, Correspondence};
use crate::geometry::pixel::ImageSize;
use crate::geometry::target::Target;

/// What a session has to know about a frame besides what was seen in it. Time arrives here, from
/// the frame, and nowhere else.
#[derive(Debug, Clone, PartialEq)]
pub struct FrameFacts {
    /// Counts the source's frames; a gap is a lost one.
    pub sequence: u64,
    /// A name where the source has names (a file's path).
    pub name: Option<String>,
    /// When the host received it, nanoseconds since the Unix epoch.
    pub host_time_ns: i64,
    /// When the device took it, nanoseconds of its own monotonic clock, where it states it.
    pub device_time_ns: Option<i64>,
    /// The size of the image that was searched.
    pub image_size: ImageSize,
}

impl FrameFacts {
    /// The time that differences are taken of: the device's, else the host's, in nanoseconds.
    pub fn time_ns(&self) -> i64 {
        self.device_time_ns.unwrap_or(self.host_time_ns)
    }

    /// What the frame is called in results: its name, else its sequence number.
    pub fn display_name(&self) -> String {
        self.name.clone().unwrap_or_else(|| self.sequence.to_string())
    }
}

/// A detection that a session kept, with the frame it came from.
#[derive(Debug, Clone, PartialEq)]
pub struct View {
    /// Counts the session's kept views from 0: the `n` of `…/views/{n}.jpg`.
    pub number: u32,
    /// The frame it was seen in.
    pub frame: FrameFacts,
    /// What was seen.
    pub detection: Detection,
}

/// `target`, with what the markers in the first of `views` say of how it is printed.
pub fn target_as_seen<'a>(target: &Target, views: impl IntoIterator<Item = &'a View>) -> Target {
    let markers = views.into_iter().find_map(|view| view.detection.markers);
    markers.map_or(*target, |markers| markers.as_printed(target))
}

impl View {
    /// The view as the solve takes it: each corner of `target` with the pixel it was seen at.
    pub fn to_board_view(&self, target: &Target) -> BoardView {
        let corners = self.detection.corners.iter();
        let correspondences = corners.filter_map(|corner| {
            Some(Correspondence {
                point_in_board: target.corner_at(corner.index.col, corner.index.row)?,
                pixel: corner.pixel,
                std_px: corner.std_px,
            })
        });
        BoardView { name: self.frame.display_name(), correspondences: correspondences.collect() }
    }
}
