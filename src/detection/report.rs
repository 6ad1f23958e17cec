//! From the corners of a grid to the detection: refined, in the board's order, without suspect
//! corners.

use crate::detection::board_detection::{
    DetectOptions, DetectedCorner, Detection, GridIndex, NoBoard,
};
use crate::detection::grid::Grid;
use crate::detection::grid::extent::least_part;
use crate::detection::measure::Probe;
use crate::detection::reasons::not_whole;
use crate::detection::refine::{GridCorner, RefinedCorner, Refiner};
use crate::detection::search::FoundGrid;
use crate::detection::thresholds::refinement::RefinementThresholds;
use crate::detection::verify::corners::{CornerTest, drop_outliers};
use crate::detection::verify::ends::seen_ends;
use crate::detection::verify::placement::{BoardPlacement, place};
use crate::geometry::board::BoardSize;
use crate::geometry::median::median_of;
use crate::geometry::pixel::Pixel;

/// Buffers of refinement and report, reused from image to image.
#[derive(Debug, Default)]
pub(in crate::detection) struct ReportBuffers {
    pub(in crate::detection) guesses: Vec<GridCorner>,
    pub(in crate::detection) refined: Vec<Option<RefinedCorner>>,
    pub(in crate::detection) blurs: Vec<f64>,
    stds: Vec<f64>,
    pub(in crate::detection) refiner: Refiner,
    /// Memory for the corners of the next detection.
    pub(in crate::detection) spare: Vec<DetectedCorner>,
}

impl ReportBuffers {
    /// Empty buffers, and a refiner with these thresholds.
    pub(in crate::detection) fn new(refinement: RefinementThresholds) -> Self {
        Self { refiner: Refiner::new(refinement), ..Self::default() }
    }
}

/// The refined corners of `found`, in the board's order.
///
/// # Errors
/// [`NoBoard`] if corners are missing and parts are not allowed, or too few are left.
pub(in crate::detection) fn report(
    probe: Probe<'_>,
    board: BoardSize,
    found: &mut FoundGrid<'_>,
    options: &DetectOptions,
    buffers: &mut ReportBuffers,
) -> Result<Detection, NoBoard> {
    let placement = found.placement;
    take_guesses(found.grid, placement, &mut buffers.guesses);
    let ReportBuffers { guesses, refined, blurs, stds, refiner, spare } = buffers;
    refiner.refine(probe.image, guesses, refined);
    let mut corners = std::mem::take(spare);
    corners.clear();
    blurs.clear();
    let test = CornerTest { probe, grid: found.grid, placement, board };
    for (guess, refined) in guesses.iter().zip(refined.iter()) {
        let refined = refined.as_ref().filter(|refined| test.stays(guess, refined));
        blurs.extend(refined.map(|refined| refined.blur_px));
        corners.extend(test.accept(guess, refined));
    }
    if corners.len() < board.corner_count() {
        stds.clear();
        stds.extend(corners.iter().map(|corner| corner.std_px));
        let median_std_px = median_of(stds).unwrap_or(0.0);
        drop_outliers(probe, found.grid, placement, &mut corners, median_std_px);
    }
    let partial = corners.len() < board.corner_count();
    let least = least_part(board, &probe.thresholds.search);
    if partial && (!options.allow_partial || corners.len() < least) {
        let seen = corners.len();
        *spare = corners;
        return Err(not_whole(probe.image, found.grid, board, seen));
    }
    found.whole = !partial;
    if partial {
        found.placement = determined_by(probe, board, found, &corners);
    }
    Ok(detection(board, found.placement, corners, blurs))
}

/// The detection of `corners`, with the median of `blurs`.
pub(in crate::detection) fn detection(
    board: BoardSize,
    placement: BoardPlacement,
    corners: Vec<DetectedCorner>,
    blurs: &mut [f64],
) -> Detection {
    Detection {
        board,
        partial: corners.len() < board.corner_count(),
        position_known: placement.known,
        markers: None,
        orientation_ambiguous: board.orientation_ambiguous(),
        blur_px: median_of(blurs).unwrap_or(0.0),
        corners,
    }
}

/// The corners of `grid` in the board's order, as input of the refiner.
pub(in crate::detection) fn take_guesses(
    grid: &Grid,
    placement: BoardPlacement,
    guesses: &mut Vec<GridCorner>,
) {
    let at = |col: i32, row: i32| {
        let (i, j) = placement.in_grid(col, row);
        grid.pixel(i, j).map(|p| Pixel::new(f64::from(p.x), f64::from(p.y)))
    };
    guesses.clear();
    guesses.extend(grid.members.iter().filter_map(|&(i, j)| {
        let (col, row) = placement.in_board(i, j);
        let seen = [at(col + 1, row), at(col, row + 1), at(col - 1, row), at(col, row - 1)];
        let neighbors = if (seen[0].or(seen[2])).and(seen[1].or(seen[3])).is_some() {
            seen
        } else {
            // No neighbor on its line: the nearest corners predict the next one.
            let ahead = |col, row| {
                let (k, l) = placement.in_grid(col, row);
                let [u, v] = grid.steps(i, j)?;
                let p = grid.pixel(i, j)? + u * (k - i) as f32 + v * (l - j) as f32;
                Some(Pixel::new(f64::from(p.x), f64::from(p.y)))
            };
            [
                seen[0].or(seen[2]).map_or_else(|| ahead(col + 1, row), |_| seen[0]),
                seen[1].or(seen[3]).map_or_else(|| ahead(col, row + 1), |_| seen[1]),
                seen[2],
                seen[3],
            ]
        };
        Some(GridCorner { index: GridIndex { col, row }, pixel: at(col, row)?, neighbors })
    }));
    guesses.sort_unstable_by_key(|guess| (guess.index.row, guess.index.col));
}

/// The placement of a part. It is known only if the reported corners determine it without the lines
/// that hold a single corner.
fn determined_by(
    probe: Probe<'_>,
    board: BoardSize,
    found: &mut FoundGrid<'_>,
    corners: &[DetectedCorner],
) -> BoardPlacement {
    let FoundGrid { grid, placement, .. } = found;
    let placement = *placement;
    if !placement.known {
        return placement;
    }
    for index in (0..grid.members.len()).rev() {
        let (i, j) = grid.members[index];
        let (col, row) = placement.in_board(i, j);
        // Corners are in row-major order.
        let reported = corners
            .binary_search_by_key(&(row, col), |corner| (corner.index.row, corner.index.col));
        if reported.is_err() {
            grid.remove(i, j);
        }
    }
    let again = grid
        .anchored_bounds()
        .and_then(|bounds| place(grid, bounds, seen_ends(probe, grid, bounds).sure, board));
    BoardPlacement { known: again == Some(placement), ..placement }
}
