//! Tracking for live use: the board near its last position, at a fraction of the cost of a search.
//!
//! Each corner is measured in the image itself, in a window as wide as its squares, at its last
//! position and at the position that its motion predicts. The result must pass the tests of a
//! search: every corner of the board, every edge, none beyond. Otherwise the whole image is
//! searched.

use super::board_detection::{DetectOptions, DetectedCorner, Detection, NoBoard};
use super::detector::Detector;
use super::placement::{BoardPlacement, place};
use crate::imaging::gray::GrayView;

/// Corners of a tracked board that are refined, to estimate the blur and the error of the others.
const SAMPLED: usize = 4;
/// Least standard deviation that is stated for a corner that is not refined, in pixels.
const LEAST_STD_PX: f64 = 0.05;

/// A board in a live image.
#[derive(Debug, Clone, PartialEq)]
pub struct TrackedBoard {
    /// The board.
    pub detection: Detection,
    /// Whether it was tracked instead of searched for: then only the corners that estimate blur and
    /// error are refined, and `std_px` is the same for all.
    pub followed: bool,
}

pub use TrackedBoard as Sighting;

impl Detector {
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
        if let Some(detection) = self.follow_board(image) {
            self.last.blur_px = detection.blur_px as f32;
            return Ok(TrackedBoard { detection, followed: true });
        }
        let searched = self.find_board(image, options);
        match self.whole.filter(|_| searched.as_ref().is_ok_and(|detection| !detection.partial)) {
            Some(placement) => self.last.remember(&self.part, placement, self.board),
            None => self.last.forget(),
        }
        self.last.blur_px = searched.as_ref().map_or(0.0, |detection| detection.blur_px as f32);
        searched.map(|detection| TrackedBoard { detection, followed: false })
    }

    /// The board near its last position.
    fn follow_board(&mut self, image: GrayView<'_>) -> Option<Detection> {
        if self.last.nodes.len() != self.board.corner_count() {
            return None;
        }
        let moved = !self.last.motion.is_empty() && self.measure_at_predictions(image, true);
        if !moved && !self.measure_at_predictions(image, false) {
            return None;
        }
        if !self.is_whole() {
            self.measure_between_neighbors(image);
        }
        if !self.is_whole() || !self.holds_together(image) || self.goes_on_beyond(image) {
            return None;
        }
        let placement = place(&self.grid, self.grid.bounds()?, [false; 4], self.board)?;
        std::mem::swap(&mut self.grid, &mut self.part);
        self.last.remember(&self.part, placement, self.board);
        self.report_followed(image, placement)
    }

    /// The tracked corners of `part`; a few of them refined, to estimate the blur and the error of
    /// the others.
    fn report_followed(
        &mut self,
        image: GrayView<'_>,
        placement: BoardPlacement,
    ) -> Option<Detection> {
        self.take_guesses(placement);
        let mut corners = std::mem::take(&mut self.spare);
        corners.clear();
        corners.extend(self.guesses.iter().map(|guess| DetectedCorner {
            index: guess.index,
            pixel: guess.pixel,
            std_px: 0.0,
        }));
        let last = self.guesses.len() - 1;
        for nth in 0..SAMPLED {
            self.guesses[nth] = self.guesses[nth + (last - SAMPLED + 1) * nth / (SAMPLED - 1)];
        }
        self.guesses.truncate(SAMPLED);
        self.refiner.refine(image, &self.guesses, &mut self.refined);
        self.blurs.clear();
        let mut squares = 0.0;
        for (guess, refined) in self.guesses.iter().zip(self.refined.iter().flatten()) {
            self.blurs.push(refined.blur_px);
            squares +=
                refined.pixel.distance_px(guess.pixel).powi(2) + 2.0 * refined.std_px.powi(2);
        }
        let seen = self.blurs.len();
        if 2 * seen < SAMPLED {
            self.spare = corners;
            return None;
        }
        let std_px = (squares / (2 * seen) as f64).sqrt().max(LEAST_STD_PX);
        corners.iter_mut().for_each(|corner| corner.std_px = std_px);
        Some(self.detection(placement, corners))
    }
}
