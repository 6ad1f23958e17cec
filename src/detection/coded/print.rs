//! The print of a labeled board, as the refinement of its corners wants it.

use nalgebra::{Matrix3, Vector3};

use crate::detection::coded::chart::{Chart, ChartPair};
use crate::detection::coded::labels::{BoardLabel, cell_in_sheet};
use crate::detection::coded::sheet::{Sheet, Sheets};
use crate::detection::grid::{Grid, Node};
use crate::detection::measure::cross::Vec2;
use crate::detection::refine::print::BoardPrint;
use crate::geometry::pixel::Pixel;

/// A board whose label is known.
pub(super) struct LabeledPrint<'a> {
    sheets: &'a Sheets,
    sheet: &'a Sheet,
    label: BoardLabel,
    grid: &'a mut Grid,
    pairs: Vec<ChartPair>,
    /// The grid's indices of the corners in the order in which they are refined.
    corners: Vec<(i32, i32)>,
    /// For each corner the homography from the image to the lattice near it.
    charts: Vec<Option<Matrix3<f64>>>,
}

impl<'a> LabeledPrint<'a> {
    /// The print of the board that lies in `grid` as `label` says; `corners`: the grid's indices.
    pub(super) fn new(
        sheets: &'a Sheets,
        label: BoardLabel,
        grid: &'a mut Grid,
        corners: Vec<(i32, i32)>,
    ) -> Self {
        let sheet = &sheets.ways[label.way];
        Self { sheets, sheet, label, grid, pairs: Vec::new(), corners, charts: Vec::new() }
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

    /// The interval between lines in which a place lies, and how far along it, 0 to 1.
    fn cell(&self, x: f64) -> (i32, f64) {
        let [wide, narrow] = self.sheets.widths.map(f64::from);
        let pitch = wide + narrow;
        let pairs = (x / pitch).floor();
        let rest = x - pairs * pitch;
        let first = 2 * pairs as i32;
        if rest < wide { (first, rest / wide) } else { (first + 1, (rest - wide) / narrow) }
    }
}

impl BoardPrint for LabeledPrint<'_> {
    fn place(&mut self, corners: &[Option<Pixel>]) {
        for (&(i, j), corner) in self.corners.iter().zip(corners) {
            if let (Some(node), Some(corner)) = (self.grid.get(i, j), corner) {
                let pixel = Vec2::new(corner.x as f32, corner.y as f32);
                self.grid.set(i, j, Node { pixel, ..node });
            }
        }
        let Self { sheets, grid, pairs, corners, charts, .. } = self;
        charts.clear();
        charts.extend(
            corners
                .iter()
                .map(|&at| Chart::near(grid, sheets, at, None, pairs)?.matrix().try_inverse()),
        );
    }

    fn near(&self, corner: usize, [px, py]: [f64; 2]) -> Option<[f32; 2]> {
        let chart = self.charts.get(corner)?.as_ref()?;
        let (i, j) = self.corners[corner];
        let place = chart * Vector3::new(px, py, 1.0);
        let (x, y) = (place.x / place.z, place.y / place.z);
        let (from_x, from_y) =
            (x - f64::from(self.sheets.line(i)), y - f64::from(self.sheets.line(j)));
        let own = self.grid.polarity(i, j) > 0.0;
        let alone = (from_x * from_y > 0.0) == own;
        let sign = |bright: bool| if bright { 1.0 } else { -1.0 };
        Some([sign(self.is_bright(x, y)), sign(alone)])
    }

    fn room(&self) -> f64 {
        f64::from(2.0 * self.sheets.room / (self.sheets.widths[0] + self.sheets.widths[1]))
    }
}
