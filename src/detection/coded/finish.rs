//! From a labeled lattice on some level to the detection: refined on the image itself, without
//! doubtful corners.

use crate::detection::board_detection::{BoardMarkers, GridIndex};
use crate::detection::coded::answer::{LabeledCorner, TargetDetection};
use crate::detection::coded::compared_crossing::ComparedCrossing;
use crate::detection::coded::detector::TargetDetector;
use crate::detection::coded::labels::BoardLabel;
use crate::detection::coded::lattice::{CURVED, LatticeScene, off_lines, predict_curved, settle};
use crate::detection::coded::print::LabeledPrint;
use crate::detection::grid::Node;
use crate::detection::grid::in_steps;
use crate::detection::refine::GridCorner;
use crate::detection::thresholds::Thresholds;
use crate::detection::vec2::Vec2;
use crate::geometry::median::{median, median_of};
use crate::geometry::pixel::Pixel;
use crate::imaging::gray::GrayView;

/// The fraction of a limit within which a crossing passes however intervals are measured: intervals
/// between its neighbors and those of a homography differ by less than a factor of two.
const WELL_WITHIN_PART: f32 = 0.5;

impl TargetDetector {
    /// The detection of the board that lies in `grid` as in `label`, found on `level`.
    pub(super) fn finish(
        &mut self,
        image: GrayView<'_>,
        level: usize,
        label: BoardLabel,
    ) -> Option<TargetDetection> {
        let pyramid = std::mem::take(&mut self.pyramid);
        for finer in (0..level).rev() {
            let view = pyramid.level(image, finer);
            self.scale_grid(2.0);
            self.sharpen_on(view, label);
        }
        self.pyramid = pyramid;
        if !self.drop_misplaced(self.thresholds.marker_corners.most_off) {
            return None;
        }
        self.refine(image, label);
        self.drop_displaced();
        let most = self.thresholds.marker_corners.most_refined_off;
        if !self.drop_farthest(most, Self::compare_on_lines) {
            return None;
        }
        Some(self.detection(image, label)).filter(|detection| {
            detection.corners.len() >= self.thresholds.marker_corners.least_corners
        })
    }

    /// Moves each crossing to its position in `view`, a finer level than the last one, and searches
    /// `view` for missing crossings.
    pub(super) fn sharpen_on(&mut self, view: GrayView<'_>, label: BoardLabel) {
        self.forget_candidates(view);
        self.sharpen(view);
        self.complete(view, label);
    }

    /// Moves each crossing to its position on a finer level.
    fn sharpen(&mut self, view: GrayView<'_>) {
        let Thresholds { marker_corners: limits, lattice, .. } = self.thresholds;
        for index in 0..self.grid.members.len() {
            let (i, j) = self.grid.members[index];
            let (Some(node), Some((_, steps))) =
                (self.grid.get(i, j), self.growth.predict(&self.sheets, &self.grid, (i, j)))
            else {
                continue;
            };
            let scene = LatticeScene {
                image: view,
                candidates: &[],
                neighborhood: &self.neighborhood,
                sheets: &self.sheets,
                thresholds: &self.thresholds.lattice,
            };
            let narrow = self.sheets.widths[0].min(self.sheets.widths[1]);
            let near = |p: Vec2| {
                in_steps(p - node.pixel, steps.map(|step| step * narrow))
                    .is_some_and(|off| off.x.abs().max(off.y.abs()) < limits.most_sharpened)
            };
            if let Some(sharp) =
                settle(scene, node.pixel, steps, lattice.least_known_score, lattice.most_reach_px)
                    .filter(|sharp| near(sharp.pixel))
            {
                self.grid.set(i, j, sharp);
            }
        }
    }

    /// Drops the crossing that is farthest from where the others predict it, until all are within
    /// `most`. Returns false if too many must go. The distances are left in `compared`.
    pub(super) fn drop_misplaced(&mut self, most: f32) -> bool {
        self.drop_farthest(most, Self::compare)
    }

    /// The same, with `compare` to compare a crossing with the others.
    fn drop_farthest(
        &mut self,
        most: f32,
        compare: fn(&mut Self, (i32, i32), f32) -> ComparedCrossing,
    ) -> bool {
        let limits = self.thresholds.marker_corners;
        let budget = (limits.most_misplaced * self.grid.members.len() as f32) as usize + 1;
        let mut compared = std::mem::take(&mut self.compared);
        compared.clear();
        compared.extend(self.grid.members.iter().map(|&at| ComparedCrossing::unknown(at)));
        let mut holds = false;
        for _ in 0..=budget {
            let mut worst = (most, None);
            for (index, crossing) in compared.iter_mut().enumerate() {
                if !crossing.is_current {
                    *crossing = compare(self, crossing.at, most);
                }
                if crossing.off > worst.0 {
                    worst = (crossing.off, Some(index));
                }
            }
            let Some(index) = worst.1 else {
                holds = true;
                break;
            };
            let (i, j) = compared.remove(index).at;
            self.grid.remove(i, j);
            for crossing in &mut compared {
                let away = (crossing.at.0 - i).abs().max((crossing.at.1 - j).abs());
                crossing.is_current &= away > crossing.reach;
            }
        }
        self.compared = compared;
        holds
    }

    /// The distance of the crossing `at` from where the others predict it.
    fn compare(&mut self, at: (i32, i32), most: f32) -> ComparedCrossing {
        let suspect_share = self.thresholds.marker_corners.suspect_share;
        let narrow = self.sheets.widths[0].min(self.sheets.widths[1]);
        let (expected, reach) = self.growth.predict_within(&self.sheets, &self.grid, at);
        let compared =
            ComparedCrossing { reach: reach.max(CURVED), ..ComparedCrossing::unknown(at) };
        let compared = ComparedCrossing { is_current: true, ..compared };
        let (Some((expected, steps)), Some(node)) = (expected, self.grid.get(at.0, at.1)) else {
            return compared;
        };
        let cell = steps.map(|step| step * narrow);
        let off_from = |expected| {
            in_steps(node.pixel - expected, cell)
                .map_or(f32::MAX, |off| off.x.abs().max(off.y.abs()))
        };
        let mut off = off_from(expected);
        // Under lens distortion, the lines through a crossing at the border are curved.
        if off > most
            && let Some(curved) = predict_curved(&self.sheets, &self.grid, at)
        {
            off = off.min(off_from(curved));
        }
        let off = if node.tight { off / suspect_share } else { off };
        let off_px = (node.pixel - expected).amax();
        ComparedCrossing { off, off_px, steps: Some(steps), ..compared }
    }

    /// The same, if only distances beyond `most` matter: a crossing that is well within `most` of
    /// the continued lines next to it needs no homography, which takes ten times as long.
    fn compare_on_lines(&mut self, at: (i32, i32), most: f32) -> ComparedCrossing {
        let is_suspect = self.grid.get(at.0, at.1).is_none_or(|node| node.tight);
        let is_near = |off: f32| off <= WELL_WITHIN_PART * most;
        if !is_suspect && off_lines(&self.sheets, &self.grid, at).is_some_and(is_near) {
            return ComparedCrossing {
                reach: CURVED,
                is_current: true,
                ..ComparedCrossing::unknown(at)
            };
        }
        self.compare(at, most)
    }

    /// Sets `guesses` to the crossings in `compared`, for the refinement.
    pub(super) fn take_guesses(&mut self) {
        self.guesses.clear();
        let reach = self.sheets.reach();
        self.compared.sort_unstable_by_key(|compared| (compared.at.1, compared.at.0));
        for compared in &self.compared {
            let (i, j) = compared.at;
            let (Some(p), Some([u, v])) = (self.grid.pixel(i, j), compared.steps) else { continue };
            let pixel = |p: Vec2| Pixel::new(f64::from(p.x), f64::from(p.y));
            self.guesses.push(GridCorner {
                index: GridIndex { col: i, row: j },
                pixel: pixel(p),
                neighbors: [u, v, -u, -v].map(|step| Some(pixel(p + step * reach))),
            });
        }
    }

    /// Refines `guesses`. Returns true if all corners come from aligning the whole print.
    pub(super) fn refine_guesses(&mut self, image: GrayView<'_>, label: BoardLabel) -> bool {
        let corners = self.guesses.iter().map(|it| (it.index.col, it.index.row)).collect();
        let mut print = LabeledPrint::new(&self.sheets, label, &mut self.grid, corners);
        self.refiner.refine_printed(image, &self.guesses, Some(&mut print), &mut self.refined)
    }

    /// Refines all crossings of `grid`, and removes those that are no crossings.
    fn refine(&mut self, image: GrayView<'_>, label: BoardLabel) {
        let limits = self.thresholds.marker_corners;
        self.grid.members.sort_unstable_by_key(|&(i, j)| (j, i));
        self.take_guesses();
        let by_print = self.refine_guesses(image, label);
        let stds = self.refined.iter().flatten().map(|it| it.std_px).collect();
        let most_std_px = limits.suspect_stds * median(stds).unwrap_or(0.0);
        for (guess, refined) in self.guesses.iter().zip(&mut self.refined) {
            let GridIndex { col, row } = guess.index;
            let nearest = guess.neighbors.iter().flatten();
            let cell = nearest.map(|p| p.distance_px(guess.pixel)).fold(f64::MAX, f64::min);
            *refined = refined.filter(|refined| {
                refined.pixel.distance_px(guess.pixel) < (limits.most_moved * cell).max(1.0)
            });
            let Some(node) = self.grid.get(col, row) else { continue };
            match refined {
                Some(refined) => {
                    let pixel = Vec2::new(refined.pixel.x as f32, refined.pixel.y as f32);
                    let tight = refined.std_px > most_std_px;
                    self.grid.set(col, row, Node { pixel, tight, ..node });
                }
                None if by_print || node.score < limits.standing_score => {
                    self.grid.remove(col, row);
                }
                None => self.grid.set(col, row, Node { tight: true, ..node }),
            }
        }
    }

    /// Drops crossings that were not refined and whose distance from their neighbors' prediction is
    /// too large for their standard deviation: the edge of an occluder may pass for one of theirs.
    fn drop_displaced(&mut self) {
        let unrefined = self.guesses.iter().zip(&self.refined).filter(|(_, it)| it.is_none());
        let unrefined = unrefined.map(|(it, _)| (it.index.col, it.index.row));
        let mut displaced: Vec<(i32, i32)> = unrefined.collect();
        displaced.retain(|&at| self.is_displaced(at));
        displaced.into_iter().for_each(|(i, j)| self.grid.remove(i, j));
    }

    /// Drops those crossings in `compared` that a search would report only after refining them.
    pub(super) fn drop_unfit(&mut self) {
        let limits = self.thresholds.marker_corners;
        let most_px = (limits.most_standing_off * limits.standing_std_px) as f32;
        let compared = std::mem::take(&mut self.compared);
        for &ComparedCrossing { at, off_px, .. } in &compared {
            let stands =
                self.grid.get(at.0, at.1).is_some_and(|it| it.score >= limits.standing_score);
            if !stands || off_px > most_px && self.is_displaced(at) {
                self.grid.remove(at.0, at.1);
            }
        }
        self.compared = compared;
    }

    /// Whether a crossing that is not refined is too far from where its neighbors predict it.
    pub(super) fn is_displaced(&mut self, at: (i32, i32)) -> bool {
        let limits = self.thresholds.marker_corners;
        let most_px = (limits.most_standing_off * limits.standing_std_px) as f32;
        let Some(pixel) = self.grid.pixel(at.0, at.1) else { return false };
        let Some((expected, _)) = self.growth.predict(&self.sheets, &self.grid, at) else {
            return false;
        };
        let curved = predict_curved(&self.sheets, &self.grid, at);
        let off_px = |expected: Vec2| (pixel - expected).amax();
        curved.map_or(f32::MAX, off_px).min(off_px(expected)) > most_px
    }

    fn detection(&mut self, image: GrayView<'_>, label: BoardLabel) -> TargetDetection {
        let mut blurs = Vec::new();
        let mut corners: Vec<LabeledCorner> = Vec::with_capacity(self.guesses.len());
        for (guess, refined) in self.guesses.iter().zip(&self.refined) {
            let GridIndex { col: i, row: j } = guess.index;
            // A corner that is not refined is reported where it was last found.
            let Some(found) = self.grid.pixel(i, j) else { continue };
            blurs.extend(refined.map(|refined| refined.blur_px));
            let found = Pixel::new(f64::from(found.x), f64::from(found.y));
            let pixel = refined.map_or(found, |refined| refined.pixel);
            let std_px = refined
                .map_or(self.thresholds.marker_corners.standing_std_px, |refined| refined.std_px);
            corners.push(self.labeled(label, guess.index, pixel, std_px));
        }
        let blur_px = median_of(&mut blurs).unwrap_or(0.0);
        let Self { meeting, sheets, grid, thresholds, .. } = self;
        let meeting = meeting.points(image, sheets, grid, label, thresholds, blur_px);
        let met = meeting.iter().map(|it| self.labeled(label, it.at, it.pixel, it.std_px));
        corners.extend(met);
        self.answer(label, corners, blurs)
    }

    /// The corner of the board at (i, j) of the grid.
    pub(super) fn labeled(
        &self,
        label: BoardLabel,
        GridIndex { col: i, row: j }: GridIndex,
        pixel: Pixel,
        std_px: f64,
    ) -> LabeledCorner {
        let (col, row) = label.placement.in_board(i, j);
        let id = self.target.corner_id(col as u32, row as u32);
        LabeledCorner { id, index: GridIndex { col, row }, pixel, std_px }
    }

    /// The detection with these corners, of the board that lies as in `label`.
    pub(super) fn answer(
        &self,
        label: BoardLabel,
        mut corners: Vec<LabeledCorner>,
        blurs: Vec<f64>,
    ) -> TargetDetection {
        let sheet = &self.sheets.ways[label.way];
        corners.sort_unstable_by_key(|corner| corner.id);
        TargetDetection {
            partial: corners.len() < self.target.corner_count(),
            corners,
            markers: BoardMarkers {
                read: label.markers,
                legacy: sheet.legacy,
                border_bits: sheet.border_bits,
                inverted: label.inverted,
            },
            blur_px: median(blurs).unwrap_or(0.0),
        }
    }
}
