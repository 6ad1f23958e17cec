//! Corners hidden by a small occluder, located where the sides of their squares meet.
//!
//! A ball, a clip or a highlight on a corner hides its crossing, but leaves most of the sides that
//! meet in it. Each side is measured across at several places, relative to the line that the
//! crossings around it predict. A straight line through these offsets gives the offset of the side
//! at the corner. The line must also lead to the known corner at the other end of the side, which
//! the edge of an occluder does not.
//!
//! The same sides are measured at known corners. These show how far blur and gamma displace an edge
//! towards black, and the accuracy of the method.

use crate::detection::board_detection::GridIndex;
use crate::detection::coded::chart::{Chart, ChartPair};
use crate::detection::coded::edge_line::{
    EdgeLine, EdgePlaces, NORMAL_MEDIAN, OUTLIER_STDS, Offset, PLACES, median,
};
use crate::detection::coded::labels::BoardLabel;
use crate::detection::coded::lattice::predict_curved;
use crate::detection::coded::sheet::Sheets;
use crate::detection::grid::{Grid, in_steps};
use crate::detection::measure::edges::sample;
use crate::detection::thresholds::Thresholds;
use crate::detection::vec2::Vec2;
use crate::geometry::pixel::Pixel;
use crate::imaging::gray::GrayView;

/// How far to either side an edge is sampled, in standard deviations of the blur, plus one pixel:
/// there it is entirely black or white, to a thousandth of a Gaussian.
const SAMPLED_BLURS: f32 = 3.0;
/// Standard deviation of a hidden corner in addition to the scatter of its sides, in pixels along
/// an axis: 68 of hard sets have 0.09 in all, and scatter alone states as little as 0.02. What
/// hides a corner may hide part of its sides too.
const COVERED_STD_PX: f64 = 0.1;
/// The most known corners that are measured, and the least number of offsets of their sides.
/// Chosen, not swept.
const MOST_REFERENCES: usize = 12;
const ENOUGH_OFFSETS: usize = 8;

/// A corner located by its sides.
#[derive(Debug, Clone, Copy)]
pub(super) struct MeetingPoint {
    pub at: GridIndex,
    pub pixel: Pixel,
    pub std_px: f64,
}

/// A measured side.
#[derive(Debug, Clone, Copy)]
struct MeasuredSide {
    /// Offsets from the prediction at the corner, and from the known corner at its other end.
    line: EdgeLine,
    /// 1 if the square beyond it, along the axis that crosses it, is bright, else −1.
    bright: f32,
}

impl MeasuredSide {
    /// Its offset at the corner, given that edges are displaced by `bias_px` towards bright, and
    /// that it ends in the known corner.
    fn pinned(&self, bias_px: f32) -> Offset {
        let bias_px = bias_px * self.bright;
        let EdgeLine { here, there, covariance } = self.line;
        let slope = covariance / there.variance;
        Offset {
            px: here.px - bias_px - slope * (there.px - bias_px),
            variance: here.variance - slope * covariance,
        }
    }
}

/// The scatter of the sides of known corners.
#[derive(Debug, Clone, Copy)]
struct SideScatter {
    /// How far edges are displaced towards bright.
    bias_px: f32,
    /// Robust standard deviation of one place, without outliers.
    common_px: f32,
    /// Standard deviation of one place, including outliers.
    std_px: f32,
}

/// Measures sides; its buffers are reused.
#[derive(Debug, Default)]
pub(super) struct MeetingSides {
    pairs: Vec<ChartPair>,
    places: EdgePlaces,
    references: Vec<MeasuredSide>,
    sorted: Vec<f32>,
}

/// The image and the lattice to measure in.
#[derive(Clone, Copy)]
struct SideScene<'a> {
    image: GrayView<'a>,
    sheets: &'a Sheets,
    grid: &'a Grid,
    /// How far to either side an edge is sampled, in units of the lattice, and the bounds of that
    /// in pixels.
    half: f32,
    half_px: (f32, f32),
}

/// A corner with its surroundings.
struct CornerChart {
    at: (i32, i32),
    chart: Chart,
    /// Its predicted pixel, and one unit of the lattice along each axis there.
    pixel: Vec2,
    steps: [Vec2; 2],
}

impl SideScene<'_> {
    /// Whether the corner is missing, and on each of its lines a side leads to a known corner.
    fn is_between_known(&self, i: i32, j: i32) -> bool {
        let known =
            |axis| [1, -1].into_iter().any(|way| self.side_length(i, j, axis, way).is_some());
        self.grid.holds(i, j) && self.grid.pixel(i, j).is_none() && known(0) && known(1)
    }

    /// The length of the side that leads from the corner along an axis, in units of the lattice, if
    /// it belongs to a marker's square and ends in a known corner.
    fn side_length(&self, i: i32, j: i32, axis: usize, way: i32) -> Option<f32> {
        let (line, (k, l)) = if axis == 0 { (i, (i + way, j)) } else { (j, (i, j + way)) };
        let is_of_marker = line.min(line + way).rem_euclid(2) == 0 || !self.sheets.alternates();
        self.grid.pixel(k, l).filter(|_| is_of_marker).map(|_| self.sheets.widths[0])
    }

    /// Predicts the corner from those around it.
    fn corner(&self, at: (i32, i32), pairs: &mut Vec<ChartPair>) -> Option<CornerChart> {
        let chart = Chart::near(self.grid, self.sheets, at, Some(at), pairs)?;
        let (x, y) = (self.sheets.line(at.0), self.sheets.line(at.1));
        let (pixel, steps) = (chart.at(x, y)?, chart.steps(x, y)?);
        Some(CornerChart { at, chart, pixel, steps })
    }
}

impl CornerChart {
    /// A unit vector across a side that leads along an axis, towards the end of the other axis.
    fn across(&self, axis: usize) -> Vec2 {
        let [along, other] = [self.steps[axis], self.steps[1 - axis]];
        let across = Vec2::new(-along.y, along.x) / along.norm().max(1e-3);
        if across.dot(&other) < 0.0 { -across } else { across }
    }
}

impl MeetingSides {
    /// The corners of the board that are missing in `grid` and whose sides meet.
    pub(super) fn points(
        &mut self,
        image: GrayView<'_>,
        sheets: &Sheets,
        grid: &Grid,
        label: BoardLabel,
        thresholds: &Thresholds,
        blur_px: f64,
    ) -> Vec<MeetingPoint> {
        let [across, down] = sheets.ways[label.way].lines;
        let places = (0..down).flat_map(|row| (0..across).map(move |col| (col, row)));
        let missing = places.map(|(col, row)| label.placement.in_grid(col, row));
        let limits = thresholds.marker_corners;
        let scene = SideScene {
            image,
            sheets,
            grid,
            half: thresholds.lattice.reach * sheets.room,
            half_px: (
                thresholds.lattice.least_reach_px,
                (SAMPLED_BLURS * blur_px as f32 + 1.0).max(thresholds.lattice.least_reach_px),
            ),
        };
        let narrow = sheets.widths[0].min(sheets.widths[1]);
        let mut scatter = None;
        let mut points = Vec::new();
        for at in missing.filter(|&(i, j)| scene.is_between_known(i, j)) {
            let Some(corner) = scene.corner(at, &mut self.pairs) else { continue };
            if sample(image, corner.pixel).is_none() {
                continue;
            }
            let Some(scatter) = *scatter.get_or_insert_with(|| self.scatter(scene)) else {
                break;
            };
            let Some((pixel, std_px)) = self.meet(scene, &corner, scatter) else { continue };
            let cell = corner.steps.map(|step| step * narrow);
            let off =
                |expected: Vec2| in_steps(pixel - expected, cell).map_or(f32::MAX, |o| o.amax());
            let curved = predict_curved(sheets, grid, at).map_or(f32::MAX, off);
            let is_near = off(corner.pixel).min(curved) <= limits.most_refined_off;
            if is_near && std_px <= limits.standing_std_px as f32 && sample(image, pixel).is_some()
            {
                points.push(MeetingPoint {
                    at: GridIndex { col: at.0, row: at.1 },
                    pixel: Pixel::new(f64::from(pixel.x), f64::from(pixel.y)),
                    std_px: f64::from(std_px).hypot(COVERED_STD_PX),
                });
            }
        }
        points
    }

    /// Measures one side of the corner.
    fn side(
        &mut self,
        scene: SideScene<'_>,
        corner: &CornerChart,
        axis: usize,
        way: i32,
    ) -> Option<MeasuredSide> {
        let (i, j) = corner.at;
        let length = scene.side_length(i, j, axis, way)?;
        let cell = if way > 0 { 0 } else { 1 };
        let [k, l] = if axis == 0 { [i - cell, j] } else { [i, j - cell] };
        let bright = scene.grid.polarity(k, l);
        let origin = [scene.sheets.line(i), scene.sheets.line(j)];
        let at = |part: f32| {
            let mut place = origin;
            place[axis] += way as f32 * part * length;
            place
        };
        let across = corner.across(axis);
        let [x, y] = at(1.0);
        let width = |steps: [Vec2; 2]| steps[1 - axis].dot(&across);
        let narrowest = width(corner.steps).min(width(corner.chart.steps(x, y)?));
        let half_px = (scene.half * narrowest).min(scene.half_px.1);
        if half_px < scene.half_px.0 {
            return None;
        }
        let margin = scene.half / length;
        self.places.clear();
        for place in 0..PLACES {
            let part = (place as f32 + 0.5) / PLACES as f32;
            let [x, y] = at(margin + (1.0 - 2.0 * margin) * part);
            let center = corner.chart.at(x, y)?;
            let along = (center - corner.pixel).norm();
            self.places.measure(scene.image, center, along, across, half_px);
        }
        self.places.keep_alike(bright)?;
        let end = if axis == 0 { (i + way, j) } else { (i, j + way) };
        let end = scene.grid.pixel(end.0, end.1)?;
        let expected = corner.chart.at(x, y)?;
        let mut line = self.places.line((expected - corner.pixel).norm())?;
        line.there.px -= (end - expected).dot(&across);
        Some(MeasuredSide { line, bright })
    }

    /// Measures the scatter at known corners; `None` if there are too few.
    fn scatter(&mut self, scene: SideScene<'_>) -> Option<SideScatter> {
        self.references.clear();
        let members = &scene.grid.members;
        let step = members.len().div_ceil(MOST_REFERENCES).max(1);
        for &at in members.iter().step_by(step) {
            let Some(node) = scene.grid.get(at.0, at.1).filter(|node| !node.tight) else {
                continue;
            };
            let Some(corner) = scene.corner(at, &mut self.pairs) else { continue };
            for (axis, way) in [(0, 1), (0, -1), (1, 1), (1, -1)] {
                let Some(mut side) = self.side(scene, &corner, axis, way) else { continue };
                side.line.here.px -= (node.pixel - corner.pixel).dot(&corner.across(axis));
                self.references.push(side);
            }
        }
        if self.references.len() < ENOUGH_OFFSETS {
            return None;
        }
        let Self { references, sorted, .. } = self;
        let both = references
            .iter()
            .flat_map(|it| [it.line.here, it.line.there].map(|at| at.px * it.bright));
        let bias_px = median(sorted, both);
        let off = |it: &MeasuredSide| {
            let Offset { px, variance } = it.pinned(bias_px);
            px.abs() / variance.sqrt()
        };
        let common_px = median(sorted, references.iter().map(off)) / NORMAL_MEDIAN;
        let squares: f32 = references.iter().map(|it| off(it).powi(2)).sum();
        let std_px = (squares / references.len() as f32).sqrt();
        Some(SideScatter { bias_px, common_px, std_px })
    }

    /// The point where the sides of the corner meet, with its standard deviation.
    fn meet(
        &mut self,
        scene: SideScene<'_>,
        corner: &CornerChart,
        scatter: SideScatter,
    ) -> Option<(Vec2, f32)> {
        let [(a, p), (b, q)] = [0, 1].map(|axis| {
            let sides = [1, -1].map(|way| {
                self.side(scene, corner, axis, way).filter(|side| scatter.is_side(side))
            });
            (combined(sides, scatter), corner.across(axis))
        });
        let (a, b) = (a?, b?);
        let area = p.x * q.y - p.y * q.x;
        let off = Vec2::new(a.px * q.y - b.px * p.y, p.x * b.px - q.x * a.px) / area;
        let std_px = scatter.std_px * ((a.variance + b.variance) / 2.0).sqrt() / area.abs();
        (std_px.is_finite()).then_some((corner.pixel + off, std_px))
    }
}

/// The offset of a line of which one or both sides are measured; `None` if these contradict each
/// other.
fn combined(sides: [Option<MeasuredSide>; 2], scatter: SideScatter) -> Option<Offset> {
    let pinned = |side: MeasuredSide| side.pinned(scatter.bias_px);
    match sides.map(|side| side.map(pinned)) {
        [Some(a), Some(b)] => {
            let sum = a.variance + b.variance;
            let px = (a.px * b.variance + b.px * a.variance) / sum;
            let both = Offset { px, variance: a.variance * b.variance / sum };
            scatter.is_none(Offset { px: a.px - b.px, variance: sum }).then_some(both)
        }
        [side, None] | [None, side] => side,
    }
}

impl SideScatter {
    /// Whether chance explains an offset.
    fn is_none(&self, offset: Offset) -> bool {
        offset.px.abs() <= OUTLIER_STDS * self.common_px * offset.variance.sqrt()
    }

    /// Whether it may be the side that ends in the known corner.
    fn is_side(&self, side: &MeasuredSide) -> bool {
        let px = side.line.there.px - side.bright * self.bias_px;
        self.is_none(Offset { px, ..side.line.there })
    }
}
