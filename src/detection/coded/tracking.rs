//! Finds the board in the next image of a stream, near its position in the last one: at a fraction
//! of the cost of a search.
//!
//! Each corner is measured where its own motion and that of a few others (`offset_search`) predict
//! it. The markers are read again: by themselves they must give the same place on the board, with
//! the evidence that a search needs. Each corner must be where the others predict it. Otherwise the
//! whole image is searched.

use crate::detection::coded::answer::TargetDetection;
use crate::detection::coded::detector::TargetDetector;
use crate::detection::coded::labels::{BoardLabel, BoardLabels};
use crate::detection::coded::last_target::LastTarget;
use crate::detection::coded::lattice::{Expected, LatticeScene};
use crate::detection::coded::no_target::NoTarget;
use crate::detection::coded::offset_search::{PredictionOffset, ReferenceCorner};
use crate::detection::grid::{LARGEST_RADIUS, Node};
use crate::detection::measure::Probe;
use crate::detection::measure::cross::CrossWindow;
use crate::detection::refine::GridCorner;
use crate::detection::thresholds::Thresholds;
use crate::detection::tracking::last_corners::LastCorners;
use crate::detection::tracking::sampled::{keep_spread, measured_std_px};
use crate::detection::vec2::Vec2;
use crate::geometry::pixel::Pixel;
use crate::imaging::gray::GrayView;

/// Reference corners are the nearest ones to this many points along each side of the visible part
/// of the board. Chosen, not swept.
const REFERENCES_A_SIDE: usize = 3;

/// Of the images of a stream without a target, one in this many is searched in every way, at all
/// scales and for an inverted grid: that takes several times as long, and a target in front of a
/// camera stays for a second.
const EVERY_WAY_EVERY: u32 = 8;

/// A target in a stream of images.
#[derive(Debug, Clone, PartialEq)]
pub struct TrackedTarget {
    /// The target.
    pub detection: TargetDetection,
    /// Whether it was tracked instead of searched for: then only the corners that estimate blur and
    /// error are refined, and `std_px` is the same for all.
    pub followed: bool,
}

impl TargetDetector {
    /// Finds the target in the next image of a stream: first near its last position, else by
    /// [`TargetDetector::find`], in the same call. The result depends on the images given to this
    /// function since the detector was made, and on nothing else.
    ///
    /// # Errors
    /// [`NoTarget`] says why there is none.
    pub fn track(&mut self, image: GrayView<'_>) -> Result<TrackedTarget, NoTarget> {
        if let Some((detection, label)) = self.follow(image) {
            self.remember(label, self.last.level, detection.blur_px);
            return Ok(TrackedTarget { detection, followed: true });
        }
        let in_every_way = self.last.between || self.last.missed.is_multiple_of(EVERY_WAY_EVERY);
        let searched = self.search_all(image, in_every_way);
        match &searched {
            Ok(found) => {
                self.remember(found.label, found.level, found.detection.blur_px);
                (self.last.between, self.last.missed) = (found.between, 0);
            }
            Err(_) => self.last.forget(),
        }
        searched.map(|found| TrackedTarget { detection: found.detection, followed: false })
    }

    /// Remembers the corners of the board that was just found.
    fn remember(&mut self, label: BoardLabel, level: usize, blur_px: f64) {
        let [across, down] = self.sheets.ways[label.way].lines;
        let Self { last, grid, guesses, sheets, .. } = self;
        let corners = (0..down).flat_map(|row| (0..across).map(move |col| (col, row)));
        last.corners.remember(corners.map(|(col, row)| {
            let (i, j) = label.placement.in_grid(col, row);
            grid.get(i, j)
        }));
        last.steps.clear();
        last.steps.resize((across * down) as usize, [Vec2::zeros(); 2]);
        let reach = sheets.reach();
        for guess in guesses.iter() {
            let (col, row) = label.placement.in_board(guess.index.col, guess.index.row);
            if (0..across).contains(&col) && (0..down).contains(&row) {
                last.steps[(row * across + col) as usize] = steps_of(guess, reach);
            }
        }
        last.label = Some((label, grid.bright));
        last.inverted = label.inverted;
        (last.level, last.blur_px) = (level, blur_px as f32);
    }

    /// Tracks the board near its last position; `None` if it must be searched for.
    fn follow(&mut self, image: GrayView<'_>) -> Option<(TargetDetection, BoardLabel)> {
        let (label, bright) = self.last.label?;
        if image.width().min(image.height()) < self.thresholds.lattice.least_side_px {
            return None;
        }
        let with_motion = self.last.corners.moved();
        let moved = with_motion && self.measure_moved(image, label, bright, true);
        if !moved && !self.measure_moved(image, label, bright, false) {
            return None;
        }
        self.complete(image, label);
        let BoardLabels::One(seen) = self.label(image, Some(label)) else { return None };
        let is_same = (seen.placement, seen.way, seen.inverted)
            == (label.placement, label.way, label.inverted);
        if !is_same {
            return None;
        }
        let detection = if self.grid.members.len() <= self.thresholds.marker_tracking.refined {
            self.finish(image, 0, seen)?
        } else {
            self.report_measured(image, seen)?
        };
        Some((detection, seen))
    }

    /// Reports the corners as measured, verified against each other as after a search; a few are
    /// refined, to estimate the blur and the error of the others.
    fn report_measured(
        &mut self,
        image: GrayView<'_>,
        label: BoardLabel,
    ) -> Option<TargetDetection> {
        let Thresholds { marker_corners: limits, marker_tracking: tracking, .. } = self.thresholds;
        if !self.drop_misplaced(limits.most_refined_off) {
            return None;
        }
        self.drop_unfit();
        self.take_guesses();
        if self.guesses.len() < limits.least_corners {
            return None;
        }
        let measured = self.guesses.clone();
        keep_spread(&mut self.guesses, tracking.refined);
        self.refine_guesses(image, label);
        let std_px = measured_std_px(&self.guesses, &self.refined, tracking.least_std_px)?;
        let blurs = self.refined.iter().flatten().map(|refined| refined.blur_px).collect();
        self.guesses = measured;
        let corners = self.guesses.iter();
        let corners = corners.map(|it| self.labeled(label, it.index, it.pixel, std_px)).collect();
        Some(self.answer(label, corners, blurs))
    }

    /// Fills the grid with the corners that are found at their predictions. Returns false if too
    /// many are not.
    fn measure_moved(
        &mut self,
        image: GrayView<'_>,
        label: BoardLabel,
        bright: bool,
        with_motion: bool,
    ) -> bool {
        let Some(offset) = self.offset(image, label, bright, with_motion) else { return false };
        self.forget_candidates(image);
        let [across, _] = self.sheets.ways[label.way].lines;
        let Self { last, grid, sheets, neighborhood, thresholds, .. } = self;
        let scene = LatticeScene {
            image,
            candidates: &[],
            neighborhood,
            sheets,
            thresholds: &thresholds.lattice,
        };
        grid.clear(LARGEST_RADIUS, bright);
        let limits = &thresholds.tracking;
        let exact_px = limits.exact_px.max(limits.exact_blurs * last.blur_px);
        let mut count = 0;
        for (index, node) in last.corners.seen() {
            count += 1;
            let (col, row) = (index as i32 % across, index as i32 / across);
            let (i, j) = label.placement.in_grid(col, row);
            let expected = expected(&last.corners, index, node.pixel, with_motion);
            let place = Expected {
                pixel: expected + offset.at(expected),
                steps: offset.stretched(last.steps[index]),
                polarity: grid.polarity(i, j),
                contrast: node.contrast.abs(),
                labeled: true,
            };
            if let Some(node) = place.detect(scene) {
                grid.set(i, j, exact(node, scene, place.steps, exact_px));
            }
        }
        grid.members.len() as f32 >= thresholds.marker_tracking.least_kept * count as f32
    }

    /// The offset of the corners from their predictions.
    fn offset(
        &mut self,
        image: GrayView<'_>,
        label: BoardLabel,
        bright: bool,
        with_motion: bool,
    ) -> Option<PredictionOffset> {
        let [across, _] = self.sheets.ways[label.way].lines;
        let narrow = self.sheets.widths[0].min(self.sheets.widths[1]);
        let Self { last, thresholds, .. } = self;
        let LastTarget { corners, steps, offsets, references, level, .. } = last;
        references.clear();
        references.extend(spread(corners, across).into_iter().filter_map(|index| {
            let node = corners.get(index)?;
            let (i, j) = label.placement.in_grid(index as i32 % across, index as i32 / across);
            let is_bright = ((i + j) & 1 == 0) == bright;
            Some(ReferenceCorner {
                expected: expected(corners, index, node.pixel, with_motion),
                cell: steps[index].map(|step| step * narrow),
                polarity: if is_bright { 1.0 } else { -1.0 },
            })
        }));
        offsets.search(Probe { image, thresholds }, *level, references)
    }
}

/// Measures the crossing again, in a window of at most this many pixels that no other edge reaches.
fn exact(node: Node, scene: LatticeScene<'_>, [u, v]: [Vec2; 2], reach_px: f32) -> Node {
    let reach = scene.thresholds.reach * scene.sheets.room;
    let window = CrossWindow::on_board(node.pixel, u, v, reach, reach_px);
    match window.measure(scene.image) {
        Some(cross) if (cross.center - node.pixel).norm() < reach_px => {
            Node { pixel: cross.center, ..node }
        }
        _ => node,
    }
}

/// The position of corner `index`, last seen at `pixel`, if it keeps moving as before.
fn expected(corners: &LastCorners, index: usize, pixel: Vec2, with_motion: bool) -> Vec2 {
    let motion = corners.motion(index).filter(|_| with_motion);
    pixel + motion.unwrap_or_else(Vec2::zeros)
}

/// One unit of the lattice along each axis, from the neighbors of a corner, which are `reach` units
/// away.
fn steps_of(guess: &GridCorner, reach: f32) -> [Vec2; 2] {
    let at = |neighbor: usize| {
        let Pixel { x, y } = guess.neighbors[neighbor].unwrap_or(guess.pixel);
        Vec2::new(x as f32, y as f32)
    };
    [(at(0) - at(2)) / (2.0 * reach), (at(1) - at(3)) / (2.0 * reach)]
}

/// Corners far from each other, on a board with this many columns.
fn spread(corners: &LastCorners, across: i32) -> Vec<usize> {
    let place = |index: usize| [index as i32 % across, index as i32 / across];
    let (mut least, mut most) = ([i32::MAX; 2], [i32::MIN; 2]);
    for (index, _) in corners.seen() {
        for k in 0..2 {
            (least[k], most[k]) = (least[k].min(place(index)[k]), most[k].max(place(index)[k]));
        }
    }
    let mut chosen: Vec<usize> = Vec::with_capacity(REFERENCES_A_SIDE * REFERENCES_A_SIDE);
    for point in 0..REFERENCES_A_SIDE * REFERENCES_A_SIDE {
        let part = [point % REFERENCES_A_SIDE, point / REFERENCES_A_SIDE];
        let anchor = [0, 1].map(|k| {
            let length = (most[k] - least[k]) * part[k] as i32;
            least[k] + length / (REFERENCES_A_SIDE as i32 - 1)
        });
        let away = |index: usize| {
            let [col, row] = place(index);
            (col - anchor[0]).pow(2) + (row - anchor[1]).pow(2)
        };
        let nearest = corners.seen().map(|(index, _)| index).min_by_key(|&index| away(index));
        if let Some(nearest) = nearest.filter(|nearest| !chosen.contains(nearest)) {
            chosen.push(nearest);
        }
    }
    chosen
}
