//! The detector: search, refinement and report, with buffers that are reused from image to image.

use crate::detection::board_detection::{DetectOptions, Detection, NoBoard};
use crate::detection::measure::Probe;
use crate::detection::reasons::not_whole;
use crate::detection::report::{ReportBuffers, report};
use crate::detection::search::{FoundGrid, SearchBuffers, find};
use crate::detection::thresholds::Thresholds;
use crate::detection::tracking::{TrackedBoard, Tracker};
use crate::geometry::board::BoardSize;
use crate::imaging::gray::GrayView;

/// Finds one kind of board in images. Buffers are reused from image to image.
#[derive(Debug)]
pub struct Detector {
    board: BoardSize,
    thresholds: Thresholds,
    pub(in crate::detection) search: SearchBuffers,
    report: ReportBuffers,
    tracker: Tracker,
}

impl Detector {
    /// A detector of `board`.
    pub fn new(board: BoardSize) -> Self {
        Self::with_thresholds(board, Thresholds::DEFAULT)
    }

    /// A detector of `board` with other thresholds, to measure their effect.
    pub fn with_thresholds(board: BoardSize, thresholds: Thresholds) -> Self {
        Self {
            board,
            thresholds,
            search: SearchBuffers::default(),
            report: ReportBuffers::new(thresholds.refinement),
            tracker: Tracker::default(),
        }
    }

    /// Takes back a detection; the next one reuses its memory.
    pub fn reuse(&mut self, detection: Detection) {
        self.report.spare = detection.corners;
    }

    /// The board searched for.
    pub fn board(&self) -> BoardSize {
        self.board
    }

    /// Finds the board in `image`.
    ///
    /// # Errors
    /// [`NoBoard`] says why there is none.
    pub fn find_board(
        &mut self,
        image: GrayView<'_>,
        options: &DetectOptions,
    ) -> Result<Detection, NoBoard> {
        let probe = Probe { image, thresholds: &self.thresholds };
        find_and_report(probe, self.board, options, &mut self.search, &mut self.report)
            .map(|(detection, _)| detection)
    }

    /// Finds the board in the next image of a stream: first near its last position, else by
    /// [`Detector::find_board`], in the same call. The result depends on the images since this
    /// detector was made, and on nothing else.
    ///
    /// # Errors
    /// [`NoBoard`] says why there is none.
    pub fn track_board(
        &mut self,
        image: GrayView<'_>,
        options: &DetectOptions,
    ) -> Result<TrackedBoard, NoBoard> {
        let Self { board, thresholds, search, report, tracker } = self;
        let probe = Probe { image, thresholds };
        if let Some(detection) = tracker.follow(probe, *board, report) {
            return Ok(TrackedBoard { detection, followed: true });
        }
        let searched = find_and_report(probe, *board, options, search, report);
        let whole = searched.as_ref().ok().filter(|(_, found)| found.whole);
        match whole {
            Some((detection, found)) => tracker.begin(found, *board, detection.blur_px),
            None => tracker.forget(),
        }
        searched.map(|(detection, _)| TrackedBoard { detection, followed: false })
    }
}

/// Search, refinement and report of one image.
fn find_and_report<'b>(
    probe: Probe<'_>,
    board: BoardSize,
    options: &DetectOptions,
    search: &'b mut SearchBuffers,
    buffers: &mut ReportBuffers,
) -> Result<(Detection, FoundGrid<'b>), NoBoard> {
    let mut found = find(probe.image, board, probe.thresholds, search)?;
    if !found.whole && !options.allow_partial {
        return Err(not_whole(probe.image, found.grid, board, found.grid.members.len()));
    }
    let detection = report(probe, board, &mut found, options, buffers)?;
    Ok((detection, found))
}
