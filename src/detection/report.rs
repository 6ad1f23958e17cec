//! From the corners of a grid to the detection: refined, in the board's order, without suspect
//! corners.

use super::board_detection::{DetectOptions, DetectedCorner, Detection, GridIndex, NoBoard};
use super::cross::Vec2;
use super::detector::Detector;
use super::edges::{EdgeCount, count_edges};
use super::ends::seen_ends;
use super::grid::Node;
use super::perspective::Perspective;
use super::placement::{BoardPlacement, place};
use super::refine::{GridCorner, RefinedCorner};
use super::verification::{off_curve, off_neighbors, outlier};
use crate::geometry::pixel::Pixel;
use crate::imaging::gray::GrayView;

/// Minimum correlation with a chessboard corner of one that is reported without refinement.
const STANDING_SCORE: f32 = 0.7;
/// Largest distance of such a corner from its neighbors' prediction, in steps.
const STANDING_OFF: f32 = 0.05;
/// Minimum standard deviation of a corner with an occluder a few pixels away, whose edge may pull
/// it, in pixels.
const TIGHT_STD_PX: f64 = 0.3;
/// Largest distance of a corner of a part from its neighbors' prediction, in steps; and of one next
/// to an occluder.
const MAX_OFFSET: f32 = 0.12;
const MAX_OFFSET_NEAR_OCCLUDER: f32 = 0.08;
/// Corners with a standard deviation above this multiple of the median are suspect and get the
/// tight bound.
const SUSPECT_STDS: f64 = 5.0;
/// Minimum corners that predict those without a square of their own.
const LEAST_FIRM: usize = 8;

impl Detector {
    /// The refined corners of `part`, in the board's order.
    pub(super) fn report(
        &mut self,
        image: GrayView<'_>,
        placement: BoardPlacement,
        options: &DetectOptions,
    ) -> Result<Detection, NoBoard> {
        self.take_guesses(placement);
        self.refiner.refine(image, &self.guesses, &mut self.refined);
        let mut corners = std::mem::take(&mut self.spare);
        corners.clear();
        self.blurs.clear();
        for (guess, refined) in self.guesses.iter().zip(&self.refined) {
            let GridCorner { index, pixel, .. } = *guess;
            match refined {
                Some(refined) if stays(guess, refined) => {
                    let (i, j) = placement.in_grid(index.col, index.row);
                    let tight = self.part.get(i, j).is_some_and(|node| node.tight);
                    let std_px =
                        if tight { refined.std_px.max(TIGHT_STD_PX) } else { refined.std_px };
                    corners.push(DetectedCorner { index, pixel: refined.pixel, std_px });
                    self.blurs.push(refined.blur_px);
                }
                _ if self.stands(image, placement, guess) => {
                    corners.push(DetectedCorner { index, pixel, std_px: guess_std_px(guess) });
                }
                _ => {}
            }
        }
        if corners.len() < self.board.corner_count() {
            self.drop_outliers(placement, &mut corners);
        }
        let partial = corners.len() < self.board.corner_count();
        if partial && (!options.allow_partial || corners.len() < self.least_part()) {
            let seen = corners.len();
            self.spare = corners;
            return Err(self.part_reason(image, seen));
        }
        let placement =
            if partial { self.as_far_as_reported(image, placement, &corners) } else { placement };
        self.whole = Some(placement).filter(|_| !partial);
        Ok(self.detection(placement, corners))
    }

    /// The detection of `corners`, with the median blur.
    pub(super) fn detection(
        &mut self,
        placement: BoardPlacement,
        corners: Vec<DetectedCorner>,
    ) -> Detection {
        Detection {
            board: self.board,
            partial: corners.len() < self.board.corner_count(),
            position_known: placement.known,
            orientation_ambiguous: self.board.orientation_ambiguous(),
            blur_px: middle_one(&mut self.blurs),
            corners,
        }
    }

    /// The corners of `part`, in the board's order, as the refiner takes them.
    pub(super) fn take_guesses(&mut self, placement: BoardPlacement) {
        let part = &self.part;
        let at = |col: i32, row: i32| {
            let (i, j) = placement.in_grid(col, row);
            part.pixel(i, j).map(|p| Pixel::new(f64::from(p.x), f64::from(p.y)))
        };
        self.guesses.clear();
        self.guesses.extend(part.members.iter().filter_map(|&(i, j)| {
            let (col, row) = placement.in_board(i, j);
            let seen = [at(col + 1, row), at(col, row + 1), at(col - 1, row), at(col, row - 1)];
            let neighbors = if (seen[0].or(seen[2])).and(seen[1].or(seen[3])).is_some() {
                seen
            } else {
                // Alone on its line: the nearest corners predict the next one.
                let ahead = |col, row| {
                    let (k, l) = placement.in_grid(col, row);
                    let [u, v] = part.steps(i, j)?;
                    let p = part.pixel(i, j)? + u * (k - i) as f32 + v * (l - j) as f32;
                    Some(Pixel::new(f64::from(p.x), f64::from(p.y)))
                };
                [
                    seen[0].or(seen[2]).map_or_else(|| ahead(col + 1, row), |_| seen[0]),
                    seen[1].or(seen[3]).map_or_else(|| ahead(col, row + 1), |_| seen[1]),
                    seen[2],
                    seen[3],
                ]
            };
            Some(GridCorner { index: GridIndex { col, row }, pixel: at(col, row)?, neighbors })
        }));
        self.guesses.sort_unstable_by_key(|guess| (guess.index.row, guess.index.col));
    }

    /// Drops refined corners that are not where their refined neighbors predict them: an occluder
    /// may end beside a corner, and be taken for one of its edges.
    fn drop_outliers(&mut self, placement: BoardPlacement, corners: &mut Vec<DetectedCorner>) {
        let part = &mut self.part;
        for corner in corners.iter() {
            let (i, j) = placement.in_grid(corner.index.col, corner.index.row);
            if let Some(node) = part.get(i, j) {
                let pixel = Vec2::new(corner.pixel.x as f32, corner.pixel.y as f32);
                part.set(i, j, Node { pixel, ..node });
            }
        }
        let (part, perspective) = (&self.part, Perspective::fit(&self.part));
        let firm = |i: i32, j: i32| part.is_firm(i, j);
        let known = part.members.iter().filter(|&&(i, j)| firm(i, j)).count();
        let of_firm = Perspective::fit_to(part, firm).filter(|_| known >= LEAST_FIRM);
        self.stds.clear();
        self.stds.extend(corners.iter().map(|corner| corner.std_px));
        let median_px = middle_one(&mut self.stds);
        corners.retain(|corner| {
            let (i, j) = placement.in_grid(corner.index.col, corner.index.row);
            let suspect = corner.std_px > SUSPECT_STDS * median_px;
            let most = if suspect { MAX_OFFSET_NEAR_OCCLUDER } else { MAX_OFFSET };
            let near = |off: f32| off < most;
            if !firm(i, j)
                && let Some(off) = of_firm.as_ref().and_then(|board| board.off(part, i, j, firm))
            {
                // A line along an occluder's edge is no reference for itself: it may follow that
                // edge, corner by corner.
                let tight = part.get(i, j).is_some_and(|node| node.tight);
                let bent = off_curve(part, i, j).filter(|_| tight).unwrap_or(off);
                return if tight { off.min(bent) < MAX_OFFSET_NEAR_OCCLUDER } else { near(off) };
            }
            // At the end of a line there are few neighbors, and slant or curvature biases their
            // prediction; the whole board predicts better.
            outlier(part, i, j, most).is_none_or(near)
                || perspective
                    .as_ref()
                    .and_then(|board| board.off(part, i, j, |_, _| true))
                    .is_some_and(near)
        });
    }

    /// The placement of a part, known only if the reported corners determine it, and no line of a
    /// single one.
    fn as_far_as_reported(
        &mut self,
        image: GrayView<'_>,
        placement: BoardPlacement,
        corners: &[DetectedCorner],
    ) -> BoardPlacement {
        if !placement.known {
            return placement;
        }
        let part = &mut self.part;
        for index in (0..part.members.len()).rev() {
            let (i, j) = part.members[index];
            let (col, row) = placement.in_board(i, j);
            // Corners are in row-major order.
            let reported = corners
                .binary_search_by_key(&(row, col), |corner| (corner.index.row, corner.index.col));
            if reported.is_err() {
                part.remove(i, j);
            }
        }
        let again = part.firm_bounds().and_then(|bounds| {
            let (_, sure) = seen_ends(image, part, bounds);
            place(part, bounds, sure, self.board)
        });
        BoardPlacement { known: again == Some(placement), ..placement }
    }

    /// Whether a corner that could not be refined is certain all the same: visible among all its
    /// neighbors, with all edges to them.
    fn stands(&self, image: GrayView<'_>, placement: BoardPlacement, guess: &GridCorner) -> bool {
        let GridIndex { col, row } = guess.index;
        let (cols, rows) = (self.board.cols as i32, self.board.rows as i32);
        let around = [(col + 1, row), (col, row + 1), (col - 1, row), (col, row - 1)];
        let on_board = |&(c, r): &(i32, i32)| (0..cols).contains(&c) && (0..rows).contains(&r);
        let complete =
            around.iter().zip(&guess.neighbors).all(|(at, seen)| seen.is_some() || !on_board(at));
        let (i, j) = placement.in_grid(col, row);
        let EdgeCount { held, seen } = count_edges(image, &self.part, i, j);
        let clear = self.part.get(i, j).is_some_and(|node| node.score >= STANDING_SCORE);
        let in_place =
            clear && off_neighbors(&self.part, i, j).is_some_and(|off| off < STANDING_OFF);
        complete && seen >= 2 && held == seen && in_place
    }
}

/// The median of `values`, which are sorted for it; 0 if there are none.
fn middle_one(values: &mut [f64]) -> f64 {
    values.sort_unstable_by(f64::total_cmp);
    values.get(values.len() / 2).copied().unwrap_or(0.0)
}

/// Standard deviation of a corner that was found but could not be refined, in pixels: a fiftieth of
/// a square, at least 0.3.
fn guess_std_px(guess: &GridCorner) -> f64 {
    let nearest = guess
        .neighbors
        .iter()
        .flatten()
        .map(|p| p.distance_px(guess.pixel))
        .fold(f64::MAX, f64::min);
    (0.02 * nearest).clamp(0.3, 3.0)
}

/// Whether a refined corner is still the one that was guessed: within a quarter of the distance to
/// its nearest neighbor.
fn stays(guess: &GridCorner, refined: &RefinedCorner) -> bool {
    let nearest = guess
        .neighbors
        .iter()
        .flatten()
        .map(|p| p.distance_px(guess.pixel))
        .fold(f64::MAX, f64::min);
    refined.pixel.distance_px(guess.pixel) < 0.25 * nearest
}
