//! Where in the target a lattice lies, by what all its cells together show.
//!
//! A lattice lies in the sheet by one of four quarter turns and a translation, in one of the ways
//! in which the sheet may be printed, black and white as they are or exchanged. For each of these
//! the agreement of every cell with the one code that it would have there is summed. Of cells that
//! show something else each agreement has mean 0 and deviation 1/√(n² − 1) over n² payload cells,
//! so the sum of K of them in units of √(K/(n² − 1)) is a standard normal variable; the least that
//! is believed is exceeded by chance in one of 10¹¹.

use crate::detection::coded::reading::MarkerReading;
use crate::detection::coded::sheet::{Sheet, Sheets};
use crate::detection::grid::{Bounds, Grid};
use crate::detection::thresholds::markers::LabelThresholds;
use crate::detection::verify::placement::BoardPlacement;

/// Fewer cells that clearly show markers of the target are not called another board's: a single one
/// may agree by chance. Chosen, not swept: it decides only which reason is given for no board.
const LEAST_ELSEWHERE: usize = 3;

/// Where a lattice lies.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct BoardLabel {
    /// How the sheet's columns and rows lie in the grid.
    pub placement: BoardPlacement,
    /// In which of the sheet's ways.
    pub way: usize,
    /// Black and white change places.
    pub inverted: bool,
    /// The sum of agreements in its deviations.
    pub significance: f32,
    /// The mean agreement of its cells.
    pub agreement: f32,
    /// Cells that were read and agree.
    pub markers: usize,
}

/// What the cells say.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum BoardLabels {
    /// One place.
    One(BoardLabel),
    /// Two places alike.
    Two(BoardLabel, BoardLabel),
    /// One place, but in a way in which the target is stated not to be printed.
    OtherPrint(BoardLabel),
    /// So many cells have codes of the target, but elsewhere.
    Elsewhere(usize),
    /// Nothing.
    None,
}

/// The best place so far and the next best.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct BestLabel {
    first: Option<BoardLabel>,
    second: Option<BoardLabel>,
    /// Cells that clearly show a marker of the target, the most of all that was weighed.
    clearly_read: usize,
}

impl BestLabel {
    /// Weighs all places of `grid`, whose cells are read, in the `way`-th sheet.
    pub(super) fn weigh(
        &mut self,
        sheets: &Sheets,
        way: usize,
        grid: &Grid,
        reading: &MarkerReading,
        inverted: bool,
        beyond: i32,
    ) {
        let Some(bounds) = grid.anchored_bounds() else { return };
        let (sheet, limits) = (&sheets.ways[way], &reading.limits);
        let is_clear = |cell: &usize| {
            reading.cells[*cell].weight >= limits.least_read_weight
                && reading.best(*cell) > limits.clear_agreement
        };
        let clear = (0..reading.cells.len()).filter(is_clear).count();
        self.clearly_read = self.clearly_read.max(clear);
        for quarter_turns in 0..4 {
            for first in firsts(sheet, bounds, quarter_turns, beyond) {
                let placement = BoardPlacement { first, quarter_turns, known: true };
                if !aligned(sheets, placement) || !covers(sheet, grid, placement, limits) {
                    continue;
                }
                if let Some(label) = weigh_one(sheets, sheet, reading, placement) {
                    let label = BoardLabel { way, inverted, ..label };
                    match self.first {
                        Some(best) if best.significance >= label.significance => {
                            let least = self.second.map_or(0.0, |second| second.significance);
                            if label.significance > least {
                                self.second = Some(label);
                            }
                        }
                        before => {
                            self.second = before;
                            self.first = Some(label);
                        }
                    }
                }
            }
        }
    }

    /// What is believed.
    pub(super) fn labels(&self, reading: &MarkerReading, sheets: &Sheets) -> BoardLabels {
        let Some(best) = self.first else { return self.none() };
        let (sheet, limits) = (&sheets.ways[best.way], &reading.limits);
        let Votes { agree, against, clear } = votes(sheet, reading, best.placement);
        let least = if clear >= 2 && clear == agree + against {
            limits.least_clear_significance
        } else {
            limits.least_significance
        };
        if best.significance < least || against as f32 > limits.most_contradictions * agree as f32 {
            return self.none();
        }
        let best = BoardLabel { markers: agree, ..best };
        match self.second {
            Some(second) if best.significance < second.significance + limits.margin => {
                BoardLabels::Two(best, BoardLabel { markers: agree, ..second })
            }
            _ => BoardLabels::One(best),
        }
    }

    fn none(&self) -> BoardLabels {
        if self.clearly_read >= LEAST_ELSEWHERE {
            BoardLabels::Elsewhere(self.clearly_read)
        } else {
            BoardLabels::None
        }
    }
}

/// Where the sheet's first corner may lie in the grid so that the sheet covers `bounds` but for so
/// many lines `beyond` it.
fn firsts(
    sheet: &Sheet,
    bounds: Bounds,
    quarter_turns: u8,
    beyond: i32,
) -> impl Iterator<Item = (i32, i32)> {
    let [across, down] = sheet.lines;
    let (width, height) =
        if quarter_turns.is_multiple_of(2) { (across, down) } else { (down, across) };
    // The grid's index of the least corner of the rotated sheet.
    let range =
        move |(least, most): (i32, i32), length: i32| most - length + 1 - beyond..=least + beyond;
    let (dx, dy) = match quarter_turns {
        0 => (0, 0),
        1 => (width - 1, 0),
        2 => (width - 1, height - 1),
        _ => (0, height - 1),
    };
    range(bounds.j, height).flat_map(move |j| range(bounds.i, width).map(move |i| (i + dx, j + dy)))
}

/// Whether nearly all crossings lie on the sheet.
fn covers(sheet: &Sheet, grid: &Grid, placement: BoardPlacement, limits: &LabelThresholds) -> bool {
    let [across, down] = sheet.lines;
    let on = grid.members.iter().filter(|&&(i, j)| {
        let (col, row) = placement.in_board(i, j);
        (0..across).contains(&col) && (0..down).contains(&row)
    });
    on.count() as f32 >= limits.least_on_board * grid.members.len() as f32
}

/// The grid's cell in which the sheet's cell (col, row) lies.
pub(super) fn cell_in_grid(placement: BoardPlacement, col: i32, row: i32) -> (i32, i32) {
    let (i, j) = placement.in_grid(col, row);
    let (k, l) = placement.in_grid(col + 1, row + 1);
    (i.min(k), j.min(l))
}

/// The sheet's cell that lies in the grid's cell (i, j).
pub(super) fn cell_in_sheet(placement: BoardPlacement, (i, j): (i32, i32)) -> (i32, i32) {
    let (a, b) = placement.in_board(i, j);
    let (c, d) = placement.in_board(i + 1, j + 1);
    (a.min(c), b.min(d))
}

/// Whether wide intervals lie on wide ones.
fn aligned(sheets: &Sheets, placement: BoardPlacement) -> bool {
    let (i, j) = cell_in_grid(placement, 0, 0);
    !sheets.alternates() || (i & 1, j & 1) == (0, 0)
}

/// What the cells say of a place.
#[derive(Debug, Clone, Copy, Default)]
struct Votes {
    agree: usize,
    /// Clearly another marker.
    against: usize,
    /// Agree without doubt.
    clear: usize,
}

fn votes(sheet: &Sheet, reading: &MarkerReading, placement: BoardPlacement) -> Votes {
    let limits = &reading.limits;
    let mut votes = Votes::default();
    for (index, cell) in reading.cells.iter().enumerate() {
        if cell.weight < limits.least_read_weight {
            continue;
        }
        let own = own_agreement(sheet, reading, index, placement).unwrap_or(0.0);
        votes.agree += usize::from(own > limits.contradicting_agreement);
        votes.clear += usize::from(own > limits.clear_agreement);
        votes.against += usize::from(
            own <= limits.contradicting_agreement && reading.best(index) > limits.clear_agreement,
        );
    }
    votes
}

/// How many of the cells around the lattice, which are read, clearly show markers of the target
/// that belong elsewhere; `None` if they agree with `label`. Within a lattice the markers of a
/// board are those of another that is one column narrower or has the other layout; at its ends they
/// are not.
pub(super) fn contradicted_around(
    sheet: &Sheet,
    reading: &MarkerReading,
    label: &BoardLabel,
) -> Option<usize> {
    let Votes { agree, against, .. } = votes(sheet, reading, label.placement);
    let most = reading.limits.most_contradictions * agree as f32;
    (against >= 2 && against as f32 > most).then_some(against)
}

fn own_agreement(
    sheet: &Sheet,
    reading: &MarkerReading,
    index: usize,
    placement: BoardPlacement,
) -> Option<f32> {
    let (col, row) = cell_in_sheet(placement, reading.cells[index].at);
    Some(reading.agreement(index, sheet.marker(col, row)?, placement.quarter_turns))
}

fn weigh_one(
    sheets: &Sheets,
    sheet: &Sheet,
    reading: &MarkerReading,
    placement: BoardPlacement,
) -> Option<BoardLabel> {
    let (mut sum, mut squares, mut weights) = (0.0, 0.0, 0.0);
    for (index, cell) in reading.cells.iter().enumerate() {
        // A cell of the board without a marker, or one beside it, speaks against the place.
        let own = own_agreement(sheet, reading, index, placement)
            .unwrap_or(-reading.limits.no_marker_penalty);
        sum += cell.weight * own;
        squares += cell.weight * cell.weight;
        weights += cell.weight;
    }
    let freedom = (sheets.bits * sheets.bits - 1) as f32;
    (squares > 0.0).then(|| BoardLabel {
        placement,
        way: 0,
        inverted: false,
        significance: sum * (freedom / squares).sqrt(),
        agreement: sum / weights,
        markers: 0,
    })
}
