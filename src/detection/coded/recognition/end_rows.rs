//! Whether the first and last row of a board are seen to be its ends, if nothing says how many it
//! has.
//!
//! That no corner is seen beyond a row is no proof: an occluder may hide the next one, or the image
//! end there. A row is the last if its cells stop where their sides do, and paper lies beyond.

use crate::detection::coded::answer::TargetDetection;
use crate::detection::coded::chart::{Chart, ChartPair};
use crate::detection::coded::detector::TargetDetector;
use crate::detection::coded::sheet::Sheets;
use crate::detection::measure::edges::sample;
use crate::geometry::target::Target;
use crate::imaging::gray::GrayView;

/// Corners nearest to an outer cell that say where it ends: twice the four that a homography
/// takes, and some that may lie on one line. Chosen, not swept.
const END_CORNERS: usize = 12;
/// Where print and paper are sampled at most, in sides of a cell from the end: as near as blur of a
/// tenth of a cell allows, as the edge of an occluder, which lies anywhere, is another. Swept with
/// 400 rendered boards from 0.1 to 0.2: the same wrong sizes, five needless hints fewer to two
/// more.
const BESIDE_END_SIDES: f32 = 0.15;
/// Places along a cell's side whose mean counts, in sides from its middle: where a marker of any
/// size has its border.
const ALONG_SIDES: [f32; 3] = [-0.2, 0.0, 0.2];
/// Least difference of neighboring cells that are seen, in parts of the row's contrast. Swept like
/// this from 0.2 to 0.6: the same wrong sizes, up to three needless hints fewer.
const LEAST_CONTRAST: f32 = 0.4;
/// Largest difference of paper from the print of its color, in parts of the cells' contrast. Swept
/// like this from 0.2 to 0.45: the same wrong sizes, up to two needless hints fewer.
const MOST_DIFFERENCE: f32 = 0.3;
/// Least cells that are seen to end, or pairs of a bright and a dark one: two that end on one line
/// do so by chance where they end on that of the lattice, too.
const LEAST_ENDING: usize = 2;

/// Paper beyond the print.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum PaperColor {
    Bright,
    /// As black and white exchanged make it, unless such a board is printed on bright paper.
    Dark,
}

/// The first row of a board's cells or the last.
#[derive(Debug, Clone, Copy)]
struct EndRow {
    /// Where its cells end, in units of the lattice.
    end: f32,
    /// 1 or −1: the way out of the board.
    outward: f32,
}

impl TargetDetector {
    /// Whether above and below what `detection` shows the print is seen to end.
    pub(super) fn ends_are_seen(&self, image: GrayView<'_>, detection: &TargetDetection) -> bool {
        let sheets = &self.sheets;
        let sheet = SeenSheet::new(image, sheets, detection);
        let lattice = self.target.lattice();
        let (across, down) = (lattice.cols as i32, lattice.rows as i32);
        let rows = |beyond: i32| {
            [(-beyond, -1.0), (down - 1 + beyond, 1.0)]
                .map(|(line, outward)| EndRow { end: sheets.line(line), outward })
        };
        if let Target::AprilGrid(grid) = self.target {
            let border = detection.markers.border_bits.or(grid.border_bits).unwrap_or(2) as f32;
            let black = border / (grid.family.bits() as f32 + 2.0 * border);
            let middles = (0..across).step_by(2).map(|col| sheets.line(col) + 0.5);
            let middles: Vec<f32> = middles.collect();
            let beside = BESIDE_END_SIDES.min(0.5 * black);
            return rows(0)
                .into_iter()
                .all(|row| sheet.tags_end(row, &middles, sheets.widths[1], beside));
        }
        let papers: &[PaperColor] = if detection.markers.inverted {
            &[PaperColor::Bright, PaperColor::Dark]
        } else {
            &[PaperColor::Bright]
        };
        let within = BESIDE_END_SIDES.min(0.5 * sheets.margin);
        let ends = rows(1).map(|row| sheet.squares_end(row, across as usize + 1, within));
        papers.iter().any(|&paper| ends.iter().all(|end| end.is_at(paper)))
    }
}

/// Corners of a board that were seen in an image, each with its place in the lattice.
struct SeenSheet<'a> {
    image: GrayView<'a>,
    pairs: Vec<ChartPair>,
    /// Of paper over print: 1, or −1 on an inverted board.
    sign: f32,
}

impl<'a> SeenSheet<'a> {
    fn new(image: GrayView<'a>, sheets: &Sheets, detection: &TargetDetection) -> Self {
        let pairs = detection.corners.iter().map(|corner| ChartPair {
            place: [corner.index.col, corner.index.row].map(|k| f64::from(sheets.line(k))),
            pixel: [corner.pixel.x, corner.pixel.y],
            weight: 1.0,
        });
        let sign = if detection.markers.inverted { -1.0 } else { 1.0 };
        Self { image, pairs: pairs.collect(), sign }
    }

    /// Gray values in the column `x` at these distances beyond the end of `row`, negative ones
    /// within; `None` where one of them is not in the image.
    fn across<const N: usize>(&self, row: EndRow, x: f32, beyond: [f32; N]) -> Option<[f32; N]> {
        let chart = self.chart([x, row.end])?;
        let mut values = [0.0; N];
        for (value, beyond) in values.iter_mut().zip(beyond) {
            for aside in ALONG_SIDES {
                let place = chart.at(x + aside, row.end + row.outward * beyond)?;
                *value += sample(self.image, place)? / ALONG_SIDES.len() as f32;
            }
        }
        Some(values)
    }

    /// Fitted to the corners nearest to a place: it follows a lens's distortion.
    fn chart(&self, place: [f32; 2]) -> Option<Chart> {
        let away = |pair: &ChartPair| {
            let [x, y] = [0, 1].map(|k| pair.place[k] - f64::from(place[k]));
            x.hypot(y)
        };
        let mut pairs = self.pairs.clone();
        pairs.sort_by(|a, b| away(a).total_cmp(&away(b)));
        pairs.truncate(END_CORNERS);
        Chart::fit(&pairs)
    }

    /// What `count` outer squares show, of which every other one is bright; their print is sampled
    /// so far `within`.
    fn squares_end(&self, row: EndRow, count: usize, within: f32) -> SquaresEnd {
        let squares: Vec<Option<[f32; 2]>> = (0..count)
            .map(|k| self.across(row, k as f32 - 0.5, [-within, BESIDE_END_SIDES]))
            .collect();
        let pairs = || {
            squares.windows(2).enumerate().filter_map(|(k, pair)| {
                let [a, b] = [pair[0]?, pair[1]?];
                Some(if k % 2 == 0 { [a, b] } else { [b, a] })
            })
        };
        // Of squares at even places over those at odd ones, in the mean.
        let contrast = pairs().map(|[even, odd]| even[0] - odd[0]).sum::<f32>()
            / pairs().count().max(1) as f32;
        let mut end = SquaresEnd::default();
        for [even, odd] in pairs() {
            let [bright, dark] = if contrast > 0.0 { [even, odd] } else { [odd, even] };
            end.take(bright, dark, contrast.abs());
        }
        end
    }

    /// Whether a row of tags, with these middles, is the last: no print where the next would begin,
    /// but paper as in the gap before it. The print within and beyond is sampled `beside` the ends
    /// of tags.
    fn tags_end(&self, row: EndRow, middles: &[f32], gap: f32, beside: f32) -> bool {
        let places = [-beside, -1.0 - 0.5 * gap, 0.5 * gap, gap + beside];
        let (mut seen, mut ending) = (0, 0);
        for &middle in middles {
            let Some([print, paper, gap, beyond]) = self.across(row, middle, places) else {
                continue;
            };
            let depth = self.sign * (paper - print);
            let is_paper = |value: f32| (value - paper).abs() < MOST_DIFFERENCE * depth;
            seen += 1;
            ending += usize::from(is_paper(gap) && is_paper(beyond));
        }
        ending >= LEAST_ENDING && 2 * ending >= seen
    }
}

/// What the outer squares of a row show, in pairs of a bright one and a dark one.
#[derive(Debug, Clone, Copy, Default)]
struct SquaresEnd {
    /// Pairs that are seen.
    seen: usize,
    /// Those beyond which there is bright paper, dark paper, and another such pair.
    bright: usize,
    dark: usize,
    going_on: usize,
}

impl SquaresEnd {
    /// A bright square and a dark one, each with what lies beyond it.
    fn take(&mut self, bright: [f32; 2], dark: [f32; 2], contrast: f32) {
        let depth = bright[0] - dark[0];
        if depth <= LEAST_CONTRAST * contrast {
            return;
        }
        let all_alike = |to: f32| {
            [bright[1], dark[1]].iter().all(|value| (value - to).abs() < MOST_DIFFERENCE * depth)
        };
        self.seen += 1;
        self.bright += usize::from(all_alike(bright[0]));
        self.dark += usize::from(all_alike(dark[0]));
        self.going_on += usize::from(dark[1] - bright[1] > LEAST_CONTRAST * contrast);
    }

    /// Whether the board is seen to end, with such paper beyond half of what is seen.
    fn is_at(&self, paper: PaperColor) -> bool {
        let ending = match paper {
            PaperColor::Bright => self.bright,
            PaperColor::Dark => self.dark,
        };
        self.going_on == 0 && ending >= LEAST_ENDING && 2 * ending >= self.seen
    }
}
