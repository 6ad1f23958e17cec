//! A view: a detection that a session kept.

use crate::detection::board_detection::Detection;
use crate::estimation::problem::{BoardView, Correspondence};
use crate::geometry::pixel::ImageSize;
use crate::geometry::target::Target;

/// What a session needs to know about a frame besides the detection. Time enters the session here,
/// with the frame, and nowhere else.
#[derive(Debug, Clone, PartialEq)]
pub struct FrameFacts {
    /// The source's frame counter; a gap is a lost frame.
    pub sequence: u64,
    /// Its name, if the source has names (a file's path).
    pub name: Option<String>,
    /// When the host received it, nanoseconds since the Unix epoch.
    pub host_time_ns: i64,
    /// When the device took it, in nanoseconds of its own monotonic clock, if it states that.
    pub device_time_ns: Option<i64>,
    /// The size of the image that was searched.
    pub image_size: ImageSize,
}

impl FrameFacts {
    /// The time for differences: the device's, else the host's, in nanoseconds.
    pub fn time_ns(&self) -> i64 {
        self.device_time_ns.unwrap_or(self.host_time_ns)
    }

    /// The frame's name in results: its name, else its sequence number.
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
    /// The detected board.
    pub detection: Detection,
}

/// `target`, with the print variant that the markers in the first of `views` show.
pub fn target_as_seen<'a>(target: &Target, views: impl IntoIterator<Item = &'a View>) -> Target {
    let markers = views.into_iter().find_map(|view| view.detection.markers);
    markers.map_or(*target, |markers| markers.as_printed(target))
}

impl View {
    /// The view as input of the solve: each corner of `target` with its pixel.
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
