//! Which board with markers an image shows, if nothing is known of it.
//!
//! A lattice is grown as of any such board; its cells are compared with every dictionary, and how
//! the markers' numbers rise along the lattice gives its size. What is guessed so is searched for
//! as if it had been asked for, so a board is named only if all of detection agrees.

mod cells;
mod codes;
mod end_rows;
mod lattices;
mod measure;
mod shape;

use std::fmt;

use crate::detection::coded::answer::TargetDetection;
use crate::detection::coded::detector::TargetDetector;
use crate::detection::coded::recognition::cells::{Payload, seen_markers};
use crate::detection::coded::recognition::lattices::SeenCandidates;
use crate::detection::coded::recognition::shape::{ANY_SIDE_M, april_grids, charuco_boards};
use crate::detection::coded::sheet::{Sheets, charuco_inset, tag_inset};
use crate::detection::grid::Grid;
use crate::geometry::dictionary::Dictionary;
use crate::geometry::target::{AprilGrid, CharucoBoard, Target};
use crate::imaging::gray::GrayView;

/// Gaps of grids of tags, in parts of a tag's side, with which a lattice is grown: what a grid
/// truly has may differ by a tenth. Chosen, not swept.
const SPACINGS: [f64; 4] = [0.3, 0.25, 0.2, 0.36];
/// Sides of markers, in parts of a square's, at which payloads are sampled. Chosen, not swept.
const RATIOS: [f32; 6] = [0.5, 0.6, 0.67, 0.75, 0.82, 0.9];
/// Lattices of fewer crossings are not read. Chosen, not swept.
pub const LEAST_CROSSINGS: usize = 9;
/// Readings of a lattice that are followed up, those with most markers first: it bounds the time.
/// Chosen, not swept.
const MOST_READINGS: usize = 3;

/// A board that was recognized.
#[derive(Debug, Clone, PartialEq)]
pub struct RecognizedBoard {
    /// The board with the layout or border that it has. Its lengths are in proportion only.
    pub target: Target,
    /// Its corners in the image.
    pub detection: TargetDetection,
    /// Its end above or below is hidden, or beyond the image: it may have more rows.
    pub may_go_on: bool,
}

impl fmt::Display for RecognizedBoard {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}", self.target.with_proportions())?;
        if let Target::AprilGrid(grid) = &self.target {
            write!(f, ", borders of {} cells", grid.border_bits.unwrap_or(2))?;
        }
        if self.detection.markers.inverted {
            write!(f, ", black and white inverted")?;
        }
        if self.may_go_on {
            write!(f, " (possibly more rows, occluded or outside the image)")?;
        }
        Ok(())
    }
}

/// The ChArUco board or AprilGrid that `image` shows; `None` if it shows none, or so little of it
/// that its size is not determined.
pub fn recognize(image: GrayView<'_>) -> Option<RecognizedBoard> {
    let mut seen = SeenCandidates::default();
    let inverted = templates().into_iter().filter(|it| matches!(it, Target::AprilGrid(_)));
    let templates = templates().into_iter().map(|template| (template, false));
    templates.chain(inverted.map(|template| (template, true))).find_map(|(template, inverted)| {
        let payloads = payloads(&template);
        let mut lattices = TargetDetector::new(template)?;
        lattices.growth.inverted = inverted;
        let read = |view: GrayView<'_>, sheets: &Sheets, grid: &Grid| {
            let printed = if sheets.alternates() { 2 } else { 0 };
            seen_markers(view, sheets, grid, &payloads, printed)
        };
        let shows =
            |view: GrayView<'_>, sheets: &Sheets, grid: &Grid| !read(view, sheets, grid).is_empty();
        lattices.find_map_lattice(image, LEAST_CROSSINGS, &mut seen, shows, |view, sheets, grid| {
            read(view, sheets, grid).iter().take(MOST_READINGS).find_map(|seen| {
                let boards = match &template {
                    Target::AprilGrid(like) => april_grids(seen, grid, like.spacing),
                    _ => charuco_boards(seen, grid),
                };
                confirmed(image, boards.into_iter().filter(|board| seen.mostly_of(board)))
            })
        })
    })
}

/// Boards whose lattices are like those of all others.
fn templates() -> Vec<Target> {
    let Some(dictionary) = Dictionary::all().next() else { return Vec::new() };
    let (cols, rows, side) = (5, 5, ANY_SIDE_M);
    let charuco = CharucoBoard {
        cols,
        rows,
        square_m: side,
        marker_m: 0.8 * side,
        dictionary,
        first_id: 0,
        legacy: None,
    };
    let grids = SPACINGS.map(|spacing| {
        Target::AprilGrid(AprilGrid {
            cols,
            rows,
            tag_m: side,
            spacing,
            family: dictionary,
            border_bits: None,
            first_id: 0,
        })
    });
    std::iter::once(Target::Charuco(charuco)).chain(grids).collect()
}

/// Where the payloads of such a board's markers may lie.
fn payloads(template: &Target) -> Vec<Payload> {
    let sizes = 4..=7_usize;
    match template {
        Target::AprilGrid(_) => sizes
            .flat_map(|bits| [2_u32, 1].map(|border| (bits, border)))
            .map(|(bits, border)| {
                let inset = tag_inset(border, bits);
                Payload { bits, inset, ratio: 1.0, border }
            })
            .collect(),
        _ => sizes
            .flat_map(|bits| RATIOS.map(|ratio| (bits, ratio)))
            .map(|(bits, ratio)| {
                let inset = charuco_inset(ratio, bits);
                Payload { bits, inset, ratio, border: 1 }
            })
            .collect(),
    }
}

/// That one of `boards` that explains most of what is seen.
fn confirmed(image: GrayView<'_>, boards: impl Iterator<Item = Target>) -> Option<RecognizedBoard> {
    let found = boards.filter_map(|target| {
        let mut detector = TargetDetector::new(target)?;
        let detection = detector.find(image).ok()?;
        let rows = detector.unseen_rows(image, &detection);
        // Corners first: a smaller board fits a part of a larger one. Markers come last: they are
        // read until they prove the labels, no further.
        let rank = (
            detection.corners.len(),
            !detection.partial,
            !rows.missing_in_view,
            first_id(&target) == 0,
            detection.markers.read,
        );
        let target = detector.measured(image, &detection);
        Some((rank, RecognizedBoard { target, detection, may_go_on: rows.may_go_on }))
    });
    let mut best: Option<(_, RecognizedBoard)> = None;
    for (rank, board) in found {
        if best.as_ref().is_none_or(|best| rank > best.0) {
            best = Some((rank, board));
        }
    }
    best.map(|best| best.1)
}

fn first_id(target: &Target) -> u32 {
    match target {
        Target::Chessboard(_) => 0,
        Target::Charuco(board) => board.first_id,
        Target::AprilGrid(grid) => grid.first_id,
    }
}
