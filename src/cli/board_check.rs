//! Compares a stated ChArUco board with the first images that show it.

use std::sync::Mutex;
use std::sync::atomic::{AtomicBool, Ordering};

use crate::detection::stated_board::{SeenBoard, WronglyStated};
use crate::geometry::target::{CharucoBoard, Target};
use crate::imaging::gray::GrayImage;
use crate::locks::lock;

/// Images that are compared: each takes several times as long as a search.
const COMPARED_IMAGES: usize = 3;

/// Compares images, in the order in which they are given, until there are enough.
#[derive(Debug)]
pub struct BoardCheck {
    stated: Option<CharucoBoard>,
    /// Whether more are needed. It is unset only when all images before were compared, so that
    /// which ones these are does not depend on the threads.
    is_open: AtomicBool,
    seen: Mutex<ComparedImages>,
}

#[derive(Debug, Default)]
struct ComparedImages {
    count: usize,
    boards: Vec<SeenBoard>,
}

impl BoardCheck {
    /// Of a ChArUco board; any other target is not compared.
    pub fn of(target: &Target) -> Self {
        let stated = match target {
            Target::Charuco(board) => Some(*board),
            Target::Chessboard(_) | Target::AprilGrid(_) => None,
        };
        let is_open = AtomicBool::new(stated.is_some());
        Self { stated, is_open, seen: Mutex::default() }
    }

    /// A copy of an image that shows the board, if it is to be compared.
    pub(super) fn copy(&self, image: &GrayImage) -> Option<GrayImage> {
        self.is_open.load(Ordering::Relaxed).then(|| image.clone())
    }

    /// Compares the next image, if it was kept for that.
    pub(super) fn take(&self, image: Option<&GrayImage>) {
        let (Some(image), Some(stated)) = (image, &self.stated) else { return };
        let mut seen = lock(&self.seen);
        if seen.count < COMPARED_IMAGES {
            seen.count += 1;
            seen.boards.extend(SeenBoard::of(image.view(), stated));
            self.is_open.store(seen.count < COMPARED_IMAGES, Ordering::Relaxed);
        }
    }

    /// Warns if the board is not as stated. Corners that are on both boards are right.
    pub fn warn(&self) {
        let Some(stated) = &self.stated else { return };
        if let Some(wrongly) = WronglyStated::by(stated, &lock(&self.seen).boards) {
            tracing::warn!("{wrongly}");
        }
    }
}
