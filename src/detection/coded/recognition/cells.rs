//! The markers of any dictionary that the cells of a lattice show.

use crate::detection::coded::chart::{Chart, ChartPair};
use crate::detection::coded::labels::cell_in_sheet;
use crate::detection::coded::recognition::codes::{self, CodeTable};
use crate::detection::coded::sheet::Sheets;
use crate::detection::grid::Grid;
use crate::detection::measure::edges::sample;
use crate::detection::verify::placement::BoardPlacement;
use crate::geometry::dictionary::Dictionary;
use crate::geometry::target::Target;
use crate::imaging::gray::GrayView;

/// Known corners of a cell from which on it is read. Chosen, not swept.
const LEAST_CORNERS: usize = 2;
/// Least difference of black and white in a payload, in parts of the crossings' contrast. Chosen,
/// not swept.
const LEAST_CONTRAST: f32 = 0.3;
/// Markers below which nothing is recognized: three that have their places by chance are one in 10⁴
/// lattices even of 16 bits.
pub(super) const LEAST_MARKERS: usize = 3;

/// Cells that are read of a lattice, those nearest to the square that it grew from: half of a board
/// of 20x20 squares. It bounds the time. Chosen.
const MOST_CELLS: usize = 200;

/// The least share of the markers that are the board's: a few cells without a marker have the
/// pattern of one by chance. Chosen, not swept.
const LEAST_OWN_SHARE: f32 = 0.85;

/// Where in its cell a marker's payload may start, in parts of the cell's side, with how many cells
/// along its side.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Payload {
    pub bits: usize,
    pub inset: f32,
    /// The marker's side over the cell's.
    pub ratio: f32,
    /// Black cells around the payload.
    pub border: u32,
}

/// Markers of one dictionary, all in one rotation.
#[derive(Debug, Clone)]
pub(super) struct SeenMarkers {
    pub dictionary: Dictionary,
    pub payload: Payload,
    /// The lattice's columns and rows in the board's rotation, from an arbitrary first one.
    pub placement: BoardPlacement,
    pub cells: Vec<MarkedCell>,
}

impl SeenMarkers {
    /// Whether `board` has nearly all of these markers: a smaller board fits a part of a larger
    /// one.
    pub(super) fn mostly_of(&self, board: &Target) -> bool {
        let (first, count) = match board {
            Target::Chessboard(_) => (0, 0),
            Target::Charuco(board) => (board.first_id, (board.cols * board.rows).div_ceil(2)),
            Target::AprilGrid(grid) => (grid.first_id, grid.cols * grid.rows),
        };
        let own = self.cells.iter().filter(|cell| (first..first + count).contains(&cell.marker));
        own.count() as f32 >= LEAST_OWN_SHARE * self.cells.len() as f32
    }
}

/// A cell with a marker.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct MarkedCell {
    /// Its column and row in the board's rotation.
    pub at: (i32, i32),
    /// The marker's number.
    pub marker: u32,
}

/// A cell of a lattice.
struct LatticeCell {
    at: (i32, i32),
    chart: Chart,
    contrast: f32,
}

/// The best reading of the cells of `grid` for each dictionary and payload, most markers first.
/// `printed`: quarters by which markers are printed on the board.
pub(super) fn seen_markers(
    view: GrayView<'_>,
    sheets: &Sheets,
    grid: &Grid,
    payloads: &[Payload],
    printed: u8,
) -> Vec<SeenMarkers> {
    let mut seen = Vec::new();
    let of_lattice = [grid.bright];
    let inversions = if sheets.alternates() { &of_lattice[..] } else { &[false, true] };
    for &inverted in inversions {
        let cells = cells(sheets, grid, sheets.in_bright != inverted);
        for payload in payloads {
            let patterns: Vec<_> = cells
                .iter()
                .filter_map(|cell| Some((cell.at, pattern(view, sheets, cell, payload)?)))
                .map(|(at, pattern)| {
                    (at, if inverted { !pattern & mask(payload) } else { pattern })
                })
                .collect();
            let tables = codes::all().iter().filter(|it| it.dictionary.bits() == payload.bits);
            seen.extend(tables.filter_map(|table| {
                most_alike(table, &patterns, printed).map(|(placement, cells)| SeenMarkers {
                    dictionary: table.dictionary,
                    payload: *payload,
                    placement,
                    cells,
                })
            }));
        }
    }
    seen.sort_by_key(|seen| usize::MAX - seen.cells.len());
    seen
}

fn mask(payload: &Payload) -> u64 {
    (1 << (payload.bits * payload.bits)) - 1
}

fn cells(sheets: &Sheets, grid: &Grid, in_bright: bool) -> Vec<LatticeCell> {
    let Some(bounds) = grid.bounds() else { return Vec::new() };
    let mut pairs: Vec<ChartPair> = Vec::new();
    let places = (bounds.j.0 - 1..=bounds.j.1)
        .flat_map(|j| (bounds.i.0 - 1..=bounds.i.1).map(move |i| (i, j)));
    let mut places: Vec<(i32, i32)> = places
        .filter(|&(i, j)| {
            let bright = grid.polarity(i, j) > 0.0;
            bright == in_bright && !(sheets.alternates() && (i & 1, j & 1) != (0, 0))
        })
        .collect();
    if places.len() > MOST_CELLS {
        places.sort_by_key(|&(i, j)| i * i + j * j);
        places.truncate(MOST_CELLS);
    }
    places
        .into_iter()
        .filter_map(|(i, j)| {
            let corners = [(i, j), (i + 1, j), (i, j + 1), (i + 1, j + 1)];
            let known = || corners.iter().filter_map(|at| grid.get(at.0, at.1));
            let count = known().count();
            let contrast =
                known().map(|node| node.contrast.abs()).sum::<f32>() / count.max(1) as f32;
            let chart = (count >= LEAST_CORNERS)
                .then(|| Chart::near(grid, sheets, (i, j), None, &mut pairs))??;
            Some(LatticeCell { at: (i, j), chart, contrast })
        })
        .collect()
}

/// Black and white of a payload; `None` where it is out of view or flat.
fn pattern(
    view: GrayView<'_>,
    sheets: &Sheets,
    cell: &LatticeCell,
    payload: &Payload,
) -> Option<u64> {
    let side = sheets.widths[0];
    let (left, top) = (sheets.line(cell.at.0), sheets.line(cell.at.1));
    let n = payload.bits;
    let at = |k: usize| {
        let step = (1.0 - 2.0 * payload.inset) / n as f32;
        (payload.inset + (k as f32 + 0.5) * step) * side
    };
    let mut values = [0.0_f32; 49];
    for (k, value) in values.iter_mut().enumerate().take(n * n) {
        *value = sample(view, cell.chart.at(left + at(k % n), top + at(k / n))?)?;
    }
    let values = &values[..n * n];
    let least = values.iter().copied().fold(f32::MAX, f32::min);
    let most = values.iter().copied().fold(f32::MIN, f32::max);
    (most - least > LEAST_CONTRAST * cell.contrast).then(|| {
        let middle = 0.5 * (least + most);
        values.iter().fold(0, |pattern, &value| pattern << 1 | u64::from(value > middle))
    })
}

/// The rotation in which most cells show markers of `table`, and these.
fn most_alike(
    table: &CodeTable,
    patterns: &[((i32, i32), u64)],
    printed: u8,
) -> Option<(BoardPlacement, Vec<MarkedCell>)> {
    let read: Vec<_> =
        patterns.iter().filter_map(|&(at, pattern)| Some((at, table.marker(pattern)?))).collect();
    let count = |quarter: u8| read.iter().filter(|cell| cell.1.1 == quarter).count();
    let quarter = (0..4).max_by_key(|&quarter| count(quarter))?;
    let placement =
        BoardPlacement { first: (0, 0), quarter_turns: (quarter + 4 - printed) % 4, known: true };
    (count(quarter) >= LEAST_MARKERS).then(|| {
        let cells = read
            .iter()
            .filter(|cell| cell.1.1 == quarter)
            .map(|&(at, (marker, _))| MarkedCell { at: cell_in_sheet(placement, at), marker });
        (placement, cells.collect())
    })
}
