//! Locates a lattice on the board: by its markers, and by the ends of the board where two places
//! fit equally.

use std::ops::Range;

use crate::detection::coded::detector::TargetDetector;
use crate::detection::coded::ends::{LatticeInImage, by_sides};
use crate::detection::coded::labels::{BestLabel, BoardLabel, BoardLabels, contradicted_around};
use crate::detection::coded::reading::SheetCells;
use crate::imaging::gray::GrayView;

impl TargetDetector {
    /// Reads the markers of `grid`, first in the way in which the board was `expected`.
    pub(super) fn label(
        &mut self,
        view: GrayView<'_>,
        expected: Option<BoardLabel>,
    ) -> BoardLabels {
        let mut believed = BoardLabels::None;
        for (inverted, ways) in self.readings(expected) {
            let is_stated = ways.start < self.sheets.stated;
            if !is_stated {
                if let BoardLabels::One(other) =
                    self.label_as(view, (inverted, ways), BoardLabels::None)
                    && self.is_other_print(&other, believed)
                {
                    return BoardLabels::OtherPrint(other);
                }
                continue;
            }
            believed = self.label_as(view, (inverted, ways), believed);
            if let BoardLabels::One(label) = believed
                && label.agreement > self.sheets.ways[label.way].certain()
            {
                break;
            }
        }
        match believed {
            BoardLabels::One(label) => {
                self.contradicted(view, &label).map_or(believed, BoardLabels::Elsewhere)
            }
            _ => believed,
        }
    }

    /// Reads all markers inverted or not and in these `ways`; the result, or what was `believed`
    /// before if that is more certain.
    fn label_as(
        &mut self,
        view: GrayView<'_>,
        (inverted, ways): (bool, Range<usize>),
        mut believed: BoardLabels,
    ) -> BoardLabels {
        let in_bright = self.sheets.in_bright != inverted;
        let Self { reading, sheets, grid, .. } = self;
        let sheet = &sheets.ways[ways.start];
        reading.read(view, SheetCells { sheets, sheet, grid, in_bright });
        for beyond in [0, self.thresholds.labels.most_beyond] {
            let mut best = BestLabel::default();
            for way in ways.clone() {
                best.weigh(&self.sheets, way, &self.grid, &self.reading, inverted, beyond);
            }
            let labels = best.labels(&self.reading, &self.sheets);
            believed = better(believed, self.by_ends(view, labels));
            if matches!(believed, BoardLabels::One(_)) {
                break;
            }
        }
        believed
    }

    /// Whether the board is certainly printed as in the label `other`, and not in the way that is
    /// stated of it, read in which it is `believed` to be there or not.
    fn is_other_print(&self, other: &BoardLabel, believed: BoardLabels) -> bool {
        let ways = &self.sheets.ways;
        let printed = &ways[other.way];
        // Where both ways give nearly the same payload, no correlation is certain by itself.
        let least = printed.certain().min(self.thresholds.labels.clear_agreement);
        let exceeds = match believed {
            BoardLabels::One(label) => {
                other.agreement > printed.least_ratio(&ways[label.way]) * label.agreement
            }
            _ => true,
        };
        other.agreement > least && exceeds
    }

    /// The ways in which cells may be read: inverted or not, and which sheets; sheets that differ
    /// only in their cells are read together. The way of the `expected` label comes first.
    fn readings(&self, expected: Option<BoardLabel>) -> Vec<(bool, Range<usize>)> {
        // Tags are in the cells of the lattice that have wide sides, so their color is known.
        let of_lattice = [self.grid.bright];
        let inversions = if self.sheets.alternates() { &of_lattice[..] } else { &[false, true] };
        let mut readings = Vec::with_capacity(4);
        for &inverted in inversions {
            let mut way = 0;
            while way < self.sheets.ways.len() {
                let inset = self.sheets.ways[way].inset;
                let alike =
                    self.sheets.ways[way..].iter().take_while(|other| other.inset == inset).count();
                readings.push((inverted, way..way + alike));
                way += alike;
            }
        }
        let first = expected.and_then(|label| {
            readings.iter().position(|(inverted, ways)| {
                *inverted == label.inverted && ways.contains(&label.way)
            })
        });
        readings[..first.map_or(0, |first| first + 1)].rotate_right(usize::from(first.is_some()));
        readings
    }

    /// How many of the cells around the lattice contradict `label`.
    fn contradicted(&mut self, view: GrayView<'_>, label: &BoardLabel) -> Option<usize> {
        let Self { reading, sheets, grid, .. } = self;
        let sheet = &sheets.ways[label.way];
        let in_bright = sheets.in_bright != label.inverted;
        reading.read_around(view, SheetCells { sheets, sheet, grid, in_bright });
        contradicted_around(sheet, reading, label)
    }

    /// Chooses between two places that fit equally by the board's ends.
    fn by_ends(&mut self, view: GrayView<'_>, labels: BoardLabels) -> BoardLabels {
        let BoardLabels::Two(first, second) = labels else { return labels };
        let lattice = LatticeInImage {
            image: view,
            grid: &self.grid,
            sheets: &self.sheets,
            limits: &self.thresholds.labels,
        };
        let both = [first, second];
        by_sides(lattice, both, &mut self.pairs).map_or(labels, |seen| BoardLabels::One(both[seen]))
    }
}

/// The more certain of two results.
fn better(one: BoardLabels, other: BoardLabels) -> BoardLabels {
    match (one, other) {
        (BoardLabels::One(a), BoardLabels::One(b)) if b.significance > a.significance => other,
        (BoardLabels::One(_), _) => one,
        (_, BoardLabels::One(_)) => other,
        (BoardLabels::Two(..), _) => one,
        (_, BoardLabels::Two(..)) => other,
        (BoardLabels::Elsewhere(a), BoardLabels::Elsewhere(b)) => BoardLabels::Elsewhere(a.max(b)),
        (BoardLabels::Elsewhere(_), _) => one,
        _ => other,
    }
}
