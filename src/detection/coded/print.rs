//! The print of a labeled board, in the form that the refinement of its corners takes.

use std::collections::HashSet;

use crate::detection::coded::chart::ChartPair;
use crate::detection::coded::curved_chart::CurvedChart;
use crate::detection::coded::labels::{BoardLabel, cell_in_grid, cell_in_sheet};
use crate::detection::coded::print_integral::PrintIntegral;
use crate::detection::coded::sheet::{Sheet, Sheets};
use crate::detection::grid::{Grid, Node};
use crate::detection::refine::print::BoardPrint;
use crate::detection::vec2::Vec2;
use crate::geometry::pixel::Pixel;

/// A narrower interval, as a fraction of the interval between lines, is empty.
const NO_WIDTH: f64 = 1e-6;

/// The distance in intervals beyond which no print is rendered, and half the width of the widest
/// sample, in intervals: near the horizon of a chart both are unbounded.
const FARTHEST_INTERVALS: f64 = 1000.0;
const WIDEST_HALF_INTERVALS: f64 = 2.0;

/// A board whose label is known.
pub(super) struct LabeledPrint<'a> {
    sheets: &'a Sheets,
    sheet: &'a Sheet,
    label: BoardLabel,
    grid: &'a mut Grid,
    /// Positions of edges in an interval between two lines, as fractions of it, in order.
    edges: Vec<f64>,
    /// Created when the print is placed for the first time: most boards do not need it.
    integral: Option<PrintIntegral>,
    pairs: Vec<ChartPair>,
    /// The grid's indices of the corners, in the order in which they are refined.
    corners: Vec<(i32, i32)>,
    /// For each corner, the map from the image to the lattice near it.
    charts: Vec<Option<CurvedChart>>,
}

impl<'a> LabeledPrint<'a> {
    /// The print of the board that lies in `grid` as in `label`; `corners` are the grid's indices.
    pub(super) fn new(
        sheets: &'a Sheets,
        label: BoardLabel,
        grid: &'a mut Grid,
        corners: Vec<(i32, i32)>,
    ) -> Self {
        let sheet = &sheets.ways[label.way];
        let edges = edges_of(sheets, sheet);
        Self {
            sheets,
            sheet,
            label,
            grid,
            edges,
            integral: None,
            pairs: Vec::new(),
            corners,
            charts: Vec::new(),
        }
    }

    /// Whether the print is bright at a place of the lattice.
    fn is_bright(&self, x: f64, y: f64) -> bool {
        let (i, across) = self.cell(x);
        let (j, down) = self.cell(y);
        let [cols, rows] = self.sheet.lines;
        let (col, row) = cell_in_sheet(self.label.placement, (i, j));
        if !(-1..cols).contains(&col) || !(-1..rows).contains(&row) {
            // Paper.
            return !self.label.inverted;
        }
        let bright = self.grid.polarity(i, j) > 0.0;
        let Some(marker) = self.sheet.marker(col, row) else { return bright };
        let (inset, margin) = (f64::from(self.sheet.inset), f64::from(self.sheets.margin));
        let inside = |part: f64, inset: f64| part > inset && part < 1.0 - inset;
        if inside(across, inset) && inside(down, inset) {
            let n = self.sheets.bits;
            let bit =
                |part: f64| (((part - inset) / (1.0 - 2.0 * inset) * n as f64) as usize).min(n - 1);
            let quarter = usize::from(self.label.placement.quarter_turns);
            let code = (marker as usize * 4 + quarter) * n * n;
            let white = self.sheets.codes[code + bit(down) * n + bit(across)] > 0.0;
            white != self.label.inverted
        } else if inside(across, margin) && inside(down, margin) {
            self.label.inverted
        } else {
            bright
        }
    }

    /// The integral of the print.
    fn integral(&self) -> PrintIntegral {
        let [cols, rows] = self.sheet.lines;
        let ends = [(-1, -1), (cols - 1, rows - 1)]
            .map(|(col, row)| cell_in_grid(self.label.placement, col, row));
        let nodes = |[first, last]: [i32; 2]| -> Vec<f64> {
            let intervals = first.min(last)..=first.max(last);
            let start = f64::from(self.sheets.line(first.min(last)));
            let within = intervals.flat_map(|index| {
                let [from, to] = [index, index + 1].map(|line| f64::from(self.sheets.line(line)));
                self.edges.iter().map(move |part| from + part * (to - from))
            });
            std::iter::once(start).chain(within).collect()
        };
        let lines = [nodes(ends.map(|(i, _)| i)), nodes(ends.map(|(_, j)| j))];
        let paper = if self.label.inverted { -1.0 } else { 1.0 };
        PrintIntegral::new(lines, paper, |x, y| self.is_bright(x, y))
    }

    /// The interval between lines that contains a place, and the position in it, 0 to 1.
    fn cell(&self, x: f64) -> (i32, f64) {
        let [wide, narrow] = self.sheets.widths.map(f64::from);
        let pitch = wide + narrow;
        let pairs = (x / pitch).floor();
        let rest = x - pairs * pitch;
        let first = 2 * pairs as i32;
        if rest < wide { (first, rest / wide) } else { (first + 1, (rest - wide) / narrow) }
    }
}

/// Whether a rectangle is near the horizon of its chart.
fn is_far([x, y]: [f64; 2], [half_x, half_y]: [f64; 2]) -> bool {
    let is_near =
        |at: f64, half: f64| at.abs() < FARTHEST_INTERVALS && half < WIDEST_HALF_INTERVALS;
    !(is_near(x, half_x) && is_near(y, half_y))
}

/// Positions of edges in an interval between two lines, as fractions of it, in order.
fn edges_of(sheets: &Sheets, sheet: &Sheet) -> Vec<f64> {
    let (inset, margin) = (f64::from(sheet.inset), f64::from(sheets.margin));
    let bits =
        (0..=sheets.bits).map(|bit| inset + (1.0 - 2.0 * inset) * bit as f64 / sheets.bits as f64);
    let mut edges: Vec<f64> = bits.chain([margin, 1.0 - margin, 1.0]).collect();
    edges.retain(|part| *part > 0.0);
    edges.sort_unstable_by(f64::total_cmp);
    edges.dedup_by(|next, edge| *next - *edge < NO_WIDTH);
    edges
}

impl BoardPrint for LabeledPrint<'_> {
    fn put(&mut self, corners: &[Option<Pixel>]) {
        if self.integral.is_none() {
            self.integral = Some(self.integral());
        }
        for (&(i, j), corner) in self.corners.iter().zip(corners) {
            if let (Some(node), Some(corner)) = (self.grid.get(i, j), corner) {
                let pixel = Vec2::new(corner.x as f32, corner.y as f32);
                self.grid.set(i, j, Node { pixel, ..node });
            }
        }
        let Self { sheets, grid, pairs, corners: all, charts, .. } = self;
        let known = all.iter().zip(corners).filter(|(_, corner)| corner.is_some());
        let known: HashSet<(i32, i32)> = known.map(|(&at, _)| at).collect();
        charts.clear();
        charts.extend(all.iter().map(|&at| CurvedChart::near(grid, sheets, at, &known, pairs)));
    }

    fn place_of(&self, corner: usize, pixel: [f64; 2]) -> Option<[f64; 2]> {
        Some(self.charts.get(corner)?.as_ref()?.place(pixel))
    }

    fn mean(&self, place: [f64; 2], half: [f64; 2]) -> f32 {
        if is_far(place, half) {
            return 0.0;
        }
        self.integral.as_ref().map_or(0.0, |integral| integral.mean(place, half)) as f32
    }

    fn mean_of_edges(&self, corner: usize, [x, y]: [f64; 2], half: [f64; 2]) -> f32 {
        if is_far([x, y], half) {
            return 0.0;
        }
        let (i, j) = self.corners[corner];
        let beyond = |at: f64, line: i32, half: f64| {
            ((at - f64::from(self.sheets.line(line))) / half).clamp(-1.0, 1.0)
        };
        let own = if self.grid.polarity(i, j) > 0.0 { 1.0 } else { -1.0 };
        (own * beyond(x, i, half[0]) * beyond(y, j, half[1])) as f32
    }

    fn expected(&self, corner: usize) -> Option<[f64; 2]> {
        let (i, j) = *self.corners.get(corner)?;
        let place = [self.sheets.line(i), self.sheets.line(j)].map(f64::from);
        self.charts.get(corner)?.as_ref()?.pixel(place)
    }

    fn room(&self) -> f64 {
        f64::from(2.0 * self.sheets.room / (self.sheets.widths[0] + self.sheets.widths[1]))
    }
}
