//! Reads the cells of a lattice, and correlates each with the code of every marker.

use std::ops::RangeInclusive;

use crate::detection::coded::chart::{Chart, ChartLine, ChartPair};
use crate::detection::coded::sheet::{IN_CODE_CELL, Sheet, Sheets, unit};
use crate::detection::grid::Grid;
use crate::detection::measure::edges::sample;
use crate::detection::thresholds::markers::LabelThresholds;
use crate::imaging::gray::GrayView;

/// The number of known corners of a cell that is read.
const WELL_KNOWN: RangeInclusive<usize> = 3..=4;
/// The same in a lattice with fewer than `FEW_CELLS` such cells: if one square fills the image, the
/// cells around it share only an edge with it.
const BARELY_KNOWN: RangeInclusive<usize> = 2..=4;
/// The same for the cells around a lattice.
const AROUND: RangeInclusive<usize> = 2..=2;
/// With fewer cells than this, cells with fewer known corners are read as well. Chosen, not swept.
const FEW_CELLS: usize = 3;

/// Cells of a lattice, to be read as those of a sheet.
#[derive(Debug, Clone, Copy)]
pub(super) struct SheetCells<'a> {
    pub sheets: &'a Sheets,
    pub sheet: &'a Sheet,
    pub grid: &'a Grid,
    /// Whether markers are in the bright cells, or in the dark ones.
    pub in_bright: bool,
}

/// A cell that may hold a marker.
#[derive(Debug, Clone, Copy)]
pub(super) struct MarkerCell {
    /// Its place in the grid.
    pub at: (i32, i32),
    /// The relative contrast of its pattern, up to 1, as a weight.
    pub weight: f32,
}

/// Reads cells; its buffers are reused.
#[derive(Debug, Default)]
pub(super) struct MarkerReading {
    /// The thresholds of readings.
    pub limits: LabelThresholds,
    /// The cells that were read.
    pub cells: Vec<MarkerCell>,
    /// For each cell, marker and quarter turn: the correlation with its code; each cell has as many
    /// values as the padded columns of codes.
    agreement: Vec<f32>,
    codes: usize,
    /// The best correlation of each cell.
    best: Vec<f32>,
    values: Vec<f32>,
    /// For the payload of a cell: its columns, at the positions where its cells are sampled.
    columns: Vec<[ChartLine; 4]>,
    pairs: Vec<ChartPair>,
}

impl MarkerReading {
    /// One with empty buffers.
    pub(super) fn new(limits: LabelThresholds) -> Self {
        Self { limits, ..Self::default() }
    }

    /// Reads all cells of the lattice: those with at least three known corners, and if these are
    /// few, those with two.
    pub(super) fn read(&mut self, image: GrayView<'_>, cells: SheetCells<'_>) {
        for known in [WELL_KNOWN, BARELY_KNOWN] {
            self.read_known(image, cells, known);
            if self.cells.len() >= FEW_CELLS {
                break;
            }
        }
    }

    /// Reads the cells around the lattice that share an edge with it.
    pub(super) fn read_around(&mut self, image: GrayView<'_>, cells: SheetCells<'_>) {
        self.read_known(image, cells, AROUND);
    }

    /// Reads the cells with this many known corners.
    fn read_known(
        &mut self,
        image: GrayView<'_>,
        cells: SheetCells<'_>,
        corners_known: RangeInclusive<usize>,
    ) {
        let SheetCells { sheets, grid, in_bright, .. } = cells;
        self.cells.clear();
        self.agreement.clear();
        self.codes = sheets.columns.room;
        let Some(bounds) = grid.bounds() else { return };
        for j in bounds.j.0 - 1..=bounds.j.1 {
            for i in bounds.i.0 - 1..=bounds.i.1 {
                let bright = grid.polarity(i, j) > 0.0;
                if bright != in_bright || sheets.alternates() && (i & 1, j & 1) != (0, 0) {
                    continue;
                }
                let corners = [(i, j), (i + 1, j), (i, j + 1), (i + 1, j + 1)];
                let known = corners.iter().filter(|at| grid.get(at.0, at.1).is_some()).count();
                if corners_known.contains(&known)
                    && let Some(depth) = self.sample(image, cells, (i, j))
                {
                    self.compare(sheets, (i, j), depth, contrast(grid, &corners));
                }
            }
        }
        if sheets.in_bright != in_bright {
            self.agreement.iter_mut().for_each(|value| *value = -*value);
        }
        let best = |all: &[f32]| {
            all[..sheets.columns.count].iter().copied().fold(-1.0, |a, b| if b > a { b } else { a })
        };
        self.best.clear();
        self.best.extend(self.agreement.chunks_exact(self.codes.max(1)).map(best));
    }

    /// Samples the payload of a cell into `values`, normalized to a zero-mean unit vector; returns
    /// its standard deviation before.
    fn sample(
        &mut self,
        image: GrayView<'_>,
        cells: SheetCells<'_>,
        (i, j): (i32, i32),
    ) -> Option<f32> {
        let SheetCells { sheets, sheet, grid, .. } = cells;
        let chart = Chart::near(grid, sheets, (i, j), None, &mut self.pairs)?;
        let side = sheets.widths[0];
        let step = (1.0 - 2.0 * sheet.inset) * side / sheets.bits as f32;
        let first = [i, j].map(|k| sheets.line(k));
        let at = |axis: usize, part: f32| first[axis] + (sheet.inset * side + part * step);
        let Self { values, columns, .. } = self;
        columns.clear();
        columns.extend(
            (0..sheets.bits)
                .map(|col| IN_CODE_CELL.map(|(dx, _)| chart.column(at(0, col as f32 + dx)))),
        );
        values.clear();
        for row in 0..sheets.bits {
            let rows = IN_CODE_CELL.map(|(_, dy)| chart.row(at(1, row as f32 + dy)));
            let cells = SampleCells { image, chart: &chart, columns, rows, values };
            pulp::Arch::new().dispatch(cells)?;
        }
        Some(unit(values) / sheets.bits as f32)
    }

    fn compare(&mut self, sheets: &Sheets, at: (i32, i32), depth: f32, contrast: f32) {
        // A pattern of black and white in equal parts has a standard deviation of half its
        // contrast.
        let depth = 2.0 * depth / contrast.max(1.0);
        let weight = (depth / self.limits.least_payload_contrast).min(1.0).powi(2);
        self.cells.push(MarkerCell { at, weight });
        sheets.columns.compare(&self.values, &mut self.agreement);
    }

    /// The correlation of the `cell`-th cell with `marker` rotated by this many quarter turns, −1
    /// to 1.
    pub(super) fn agreement(&self, cell: usize, marker: u32, quarter_turns: u8) -> f32 {
        let slot = cell * self.codes + marker as usize * 4 + usize::from(quarter_turns);
        self.agreement.get(slot).copied().unwrap_or(0.0)
    }

    /// The best correlation of the `cell`-th cell with any marker in any rotation.
    pub(super) fn best(&self, cell: usize) -> f32 {
        self.best.get(cell).copied().unwrap_or(-1.0)
    }
}

/// Samples a row of a payload's cells. A struct, not a closure: all of it must be inlined to be
/// compiled for the processor.
struct SampleCells<'a> {
    image: GrayView<'a>,
    chart: &'a Chart,
    columns: &'a [[ChartLine; 4]],
    rows: [ChartLine; 4],
    values: &'a mut Vec<f32>,
}

impl pulp::NullaryFnOnce for SampleCells<'_> {
    type Output = Option<()>;

    #[inline(always)]
    fn call(self) -> Option<()> {
        let Self { image, chart, columns, rows, values } = self;
        for columns in columns {
            let mut sum = 0.0;
            for (column, row) in columns.iter().zip(rows) {
                sum += sample(image, chart.at_crossing(*column, row)?)?;
            }
            values.push(sum / 4.0);
        }
        Some(())
    }
}

fn contrast(grid: &Grid, corners: &[(i32, i32); 4]) -> f32 {
    let known = corners.iter().filter_map(|at| grid.get(at.0, at.1));
    let (sum, count) =
        known.fold((0.0, 0.0), |(sum, count), node| (sum + node.contrast.abs(), count + 1.0));
    sum / f32::max(count, 1.0)
}
