//! Candidates for chessboard corners: the strongest local maxima of the response, each verified by
//! a second measurement.
//!
//! However cluttered the image, only a bounded number of maxima and at most
//! [`CandidateThresholds::most`] candidates pass: the time is bounded by the number of pixels.

use crate::detection::measure::Probe;
use crate::detection::measure::cross::CrossWindow;
use crate::detection::search::response::{HALF_RING, REACH, Response};
use crate::detection::thresholds::chessboard::CandidateThresholds;
use crate::detection::vec2::Vec2;
use crate::imaging::gray::GrayView;

/// Side of the tiles whose largest response is examined, in pixels.
const TILE: usize = 4;
/// Tiles that are skipped together if none is strong.
const GROUP: usize = 32;
/// Half the side of the window that a candidate is measured in, in pixels: within the ring of the
/// response. Chosen, not swept.
const HALF_SIDE_PX: f32 = 3.0;

/// A candidate for a chessboard corner.
#[derive(Debug, Clone, Copy)]
pub(in crate::detection) struct Candidate {
    /// Its position, in pixels of the level.
    pub pixel: Vec2,
    /// Unit vectors along the two edges, ordered so that the bright wedges are those from the first
    /// to the second and opposite, from +x to +y.
    pub edges: [Vec2; 2],
    /// Bright minus dark wedges, in gray levels.
    pub contrast: f32,
}

impl Candidate {
    /// Whether each of its edges agrees with these, up to an angle with this sine.
    pub(in crate::detection) fn has_edges(&self, edges: [Vec2; 2], most_sine: f32) -> bool {
        let sine = |a: Vec2, b: Vec2| (a.x * b.y - a.y * b.x).abs();
        (0..2).all(|k| sine(self.edges[k], edges[k]) < most_sine)
    }
}

/// The edges, in a candidate's order, of a lattice crossing with these `steps` to its neighbors and
/// a contrast with the sign of `polarity` between them.
pub(in crate::detection) fn edges_along(steps: [Vec2; 2], polarity: f32) -> [Vec2; 2] {
    let [first, second] = steps.map(|step| step / step.norm().max(1e-3));
    if polarity > 0.0 { [first, second] } else { [second, first] }
}

/// Finds candidates. Buffers are kept from image to image.
#[derive(Debug, Default)]
pub(in crate::detection) struct CandidateSearch {
    /// The largest response of each tile, in raster order.
    tiles: Vec<u8>,
    /// The largest of each group of tiles.
    groups: Vec<u8>,
    /// The strongest tiles: the largest response and where it is.
    sorted: Vec<(u8, u32, u32)>,
    /// The most tiles to keep.
    most_tiles: usize,
    maxima: [Vec<u8>; 2],
    /// The candidates found last, in raster order of tiles.
    pub found: Vec<Candidate>,
}

impl CandidateSearch {
    /// Finds the candidates of an image, whose response is `response`, for a board of so many
    /// `corners`.
    pub(in crate::detection) fn search(
        &mut self,
        probe: Probe<'_>,
        response: &Response,
        corners: usize,
    ) {
        let thresholds = &probe.thresholds.candidates;
        self.most_tiles = (thresholds.tiles_a_corner * corners)
            .min(thresholds.most_tiles)
            .max(thresholds.fewest_tiles);
        self.collect_tiles(response, thresholds);
        self.found.clear();
        for &(value, x, y) in &self.sorted {
            if self.found.len() == thresholds.most {
                break;
            }
            if is_peak(response, value, x as usize, y as usize)
                && let Some(candidate) = examine(probe, x as usize, y as usize)
            {
                self.found.push(candidate);
            }
        }
    }

    /// The strongest pixel of each tile, strongest tiles first.
    fn collect_tiles(&mut self, response: &Response, thresholds: &CandidateThresholds) {
        self.sorted.clear();
        self.tiles.clear();
        let (across, down) = (response.width() / TILE, response.height() / TILE);
        if across == 0 {
            return;
        }
        self.tiles.resize(across * down, 0);
        for (row, tiles) in self.tiles.chunks_exact_mut(across).enumerate() {
            let rows = std::array::from_fn(|i| &response.row(row * TILE + i)[..across * TILE]);
            pulp::Arch::new().dispatch(TileMaxima { rows, maxima: &mut self.maxima, tiles });
        }
        self.groups.clear();
        self.groups.extend(
            self.tiles
                .chunks(GROUP)
                .map(|tiles| tiles.iter().fold(0, |most, &tile| tile.max(most))),
        );
        // At least this many tiles are as strong, so weaker ones are never kept.
        let mut counts = [0; 256];
        self.groups.iter().for_each(|&group| counts[usize::from(group)] += 1);
        let strongest = counts.iter().rposition(|&count| count > 0).unwrap_or(0);
        let weakest =
            usize::from(thresholds.least_response).max(strongest / thresholds.least_share.max(1));
        let least = self.least_kept(&counts, weakest).0;
        counts.fill(0);
        for (tiles, _) in self
            .tiles
            .chunks(GROUP)
            .zip(&self.groups)
            .filter(|(_, group)| usize::from(**group) >= least)
        {
            tiles.iter().for_each(|&tile| counts[usize::from(tile)] += 1);
        }
        let (least, kept) = self.least_kept(&counts, least);
        self.keep_strongest(response, &mut counts, least, kept);
    }

    /// Histogram cut-off that keeps at most `most_tiles` peaks of strength `weakest` or more, and
    /// how many it keeps.
    fn least_kept(&self, counts: &[usize; 256], weakest: usize) -> (usize, usize) {
        let mut kept = 0;
        for value in (weakest..256).rev() {
            kept += counts[value];
            if kept >= self.most_tiles {
                return (value, self.most_tiles);
            }
        }
        (weakest, kept)
    }

    /// Leaves the `kept` strongest tiles (all at least `least`), strongest first and equal ones in
    /// raster order, with the position of their maximum.
    fn keep_strongest(
        &mut self,
        response: &Response,
        counts: &mut [usize; 256],
        least: usize,
        kept: usize,
    ) {
        // The position of the first tile of each strength.
        let mut stronger = 0;
        for slot in counts[least..].iter_mut().rev() {
            stronger += std::mem::replace(slot, stronger);
        }
        self.sorted.resize(kept, (0, 0, 0));
        let across = response.width() / TILE;
        for (group, tiles) in self.tiles.chunks(GROUP).enumerate() {
            if usize::from(self.groups[group]) < least {
                continue;
            }
            for (tile, &value) in tiles.iter().enumerate() {
                let slot = &mut counts[usize::from(value)];
                if usize::from(value) < least || *slot >= kept {
                    continue;
                }
                let tile = group * GROUP + tile;
                let (left, top) = (tile % across * TILE, tile / across * TILE);
                let places = (0..TILE).map(|y| (y, &response.row(top + y)[left..left + TILE]));
                let strongest = |(y, row): (usize, &[u8])| {
                    Some((row.iter().position(|&other| other == value)?, y))
                };
                let (x, y) = places.filter_map(strongest).next().unwrap_or_default();
                self.sorted[*slot] = (value, (left + x) as u32, (top + y) as u32);
                *slot += 1;
            }
        }
    }
}

/// The maximum of each tile in one row of tiles. A struct, not a closure: all of it must be inlined
/// to be compiled for the processor.
struct TileMaxima<'a> {
    rows: [&'a [u8]; TILE],
    /// Scratch: the maximum of each column, then of each two columns.
    maxima: &'a mut [Vec<u8>; 2],
    tiles: &'a mut [u8],
}

impl pulp::NullaryFnOnce for TileMaxima<'_> {
    type Output = ();

    #[inline(always)]
    fn call(self) {
        let length = self.tiles.len() * TILE;
        let [columns, pairs] = self.maxima;
        columns.resize(length + TILE, 0);
        pairs.resize(length + TILE, 0);
        let [first, second, third, fourth] = self.rows;
        let (first, second, third, fourth) =
            (&first[..length], &second[..length], &third[..length], &fourth[..length]);
        for (i, most) in columns[..length].iter_mut().enumerate() {
            *most = first[i].max(second[i]).max(third[i].max(fourth[i]));
        }
        let (from, next) = (&columns[..length + 1], &columns[1..length + 2]);
        for (i, most) in pairs[..length + 1].iter_mut().enumerate() {
            *most = from[i].max(next[i]);
        }
        for (tile, pairs) in self.tiles.iter_mut().zip(pairs.chunks_exact(TILE)) {
            *tile = pairs[0].max(pairs[2]);
        }
    }
}

/// Whether no response within two pixels is larger; of equal ones the first in raster order counts.
fn is_peak(response: &Response, value: u8, x: usize, y: usize) -> bool {
    if x < REACH || y < REACH || x + REACH >= response.width() || y + REACH >= response.height() {
        return false;
    }
    let (mut before, mut after) = (0, 0);
    for row in 0..5 {
        let Some(&[a, b, c, d, e]) = response.row(y + row - 2).get(x - 2..x + 3) else {
            return false;
        };
        match row {
            0 | 1 => before = a.max(b).max(c).max(d.max(e)).max(before),
            2 => (before, after) = (a.max(b).max(before), d.max(e)),
            _ => after = a.max(b).max(c).max(d.max(e)).max(after),
        }
    }
    before < value && after <= value
}

/// Estimates the two edges from the ring around (`x`, `y`), and the exact position from a window
/// along them.
fn examine(probe: Probe<'_>, x: usize, y: usize) -> Option<Candidate> {
    let center = Vec2::new(x as f32, y as f32);
    let (image, thresholds) = (probe.image, &probe.thresholds.candidates);
    let edges = ring_edges(image, [x, y], thresholds.least_straight)?;
    let window = CrossWindow { center, a: edges[0] * HALF_SIDE_PX, b: edges[1] * HALF_SIDE_PX };
    let first = window.measure_above(image, thresholds.least_first_score)?;
    let in_place = first.score >= thresholds.clear_score
        && (first.center - center).norm() < thresholds.settled_px;
    let cross = if in_place {
        first
    } else {
        CrossWindow { center: first.center, ..window }.measure(image)?
    };
    let holds = cross.score >= thresholds.least_score
        && cross.contrast >= thresholds.least_contrast
        && (cross.center - center).norm() <= thresholds.most_moved_px;
    holds.then_some(Candidate { pixel: cross.center, edges, contrast: cross.contrast })
}

/// The edges through the middle of the ring. The ring must cross its own middle gray four times, in
/// two pairs of opposite places.
fn ring_edges(image: GrayView<'_>, [x, y]: [usize; 2], least_straight: f32) -> Option<[Vec2; 2]> {
    let ring = ring_about(image, x, y)?;
    let (least, most) = (ring.into_iter().fold(255, u8::min), ring.into_iter().fold(0, u8::max));
    let twice_middle = u16::from(least) + u16::from(most);
    // The integer comparison is exact: above half of an odd sum means above that half rounded down.
    let middle_gray = (twice_middle / 2) as u8;
    let mut above = 0u16;
    for (k, &gray) in ring.iter().enumerate() {
        above |= u16::from(gray > middle_gray) << k;
    }
    let mut changes = above ^ above.rotate_right(1);
    if changes.count_ones() != 4 {
        return None;
    }
    let offset = |k: usize| {
        let (dx, dy) = HALF_RING[k % 8];
        if k % 16 < 8 { (dx, dy) } else { (-dx, -dy) }
    };
    let place = |k: usize| Vec2::new(offset(k).0 as f32, offset(k).1 as f32);
    let middle = 0.5 * f32::from(twice_middle);
    let starts_rising = above >> ((changes.trailing_zeros() + 1) % 16) & 1 == 1;
    let mut crossings = [Vec2::zeros(); 4];
    for crossing in &mut crossings {
        let k = changes.trailing_zeros() as usize;
        changes &= changes - 1;
        let (from, to) = (f32::from(ring[k]) - middle, f32::from(ring[(k + 1) % 16]) - middle);
        *crossing = place(k).lerp(&place(k + 1), from / (from - to));
    }
    let opposite = |p: Vec2, q: Vec2| p.dot(&q) < -least_straight * p.norm() * q.norm();
    if !opposite(crossings[0], crossings[2]) || !opposite(crossings[1], crossings[3]) {
        return None;
    }
    let first = (crossings[0] - crossings[2]).normalize();
    let second = (crossings[1] - crossings[3]).normalize();
    Some(if starts_rising { [first, second] } else { [second, -first] })
}

/// The pixels of the ring around (`x`, `y`), in order of their angle; `None` too close to the
/// border.
fn ring_about(image: GrayView<'_>, x: usize, y: usize) -> Option<[u8; 16]> {
    const SIDE: usize = 2 * REACH + 1;
    let (left, top) = (x.checked_sub(REACH)?, y.checked_sub(REACH)?);
    let mut rows = [&[0u8; SIDE]; SIDE];
    for (k, row) in rows.iter_mut().enumerate() {
        *row = image.bytes().get((top + k) * image.stride() + left..)?.first_chunk()?;
    }
    let mut ring = [0; 16];
    for (k, (dx, dy)) in HALF_RING.into_iter().enumerate() {
        let (x, y) = ((REACH as i32 + dx) as usize, (REACH as i32 + dy) as usize);
        (ring[k], ring[k + 8]) = (rows[y][x], rows[SIDE - 1 - y][SIDE - 1 - x]);
    }
    Some(ring)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::detection::thresholds::Thresholds;
    use crate::imaging::gray::GrayImage;

    /// The candidates of an image of 60×60 `pixels`.
    fn candidates_of(pixels: Vec<u8>) -> Vec<Candidate> {
        let image = GrayImage::from_pixels(60, 60, pixels).expect("3600 pixels");
        let mut response = Response::default();
        response.compute(image.view(), 1);
        let mut search = CandidateSearch::default();
        let probe = Probe { image: image.view(), thresholds: &Thresholds::DEFAULT };
        search.search(probe, &response, 54);
        search.found
    }

    #[test]
    fn the_corners_of_a_small_checker_are_found_with_their_edges() {
        let pixels = (0..60 * 60)
            .map(|i| if (i % 60 / 12 + i / 60 / 12) % 2 == 0 { 30 } else { 220 })
            .collect();
        let found = candidates_of(pixels);
        assert_eq!(found.len(), 16);
        for candidate in &found {
            let nearest = candidate.pixel.map(|v| (v + 0.5) / 12.0);
            assert!((nearest - nearest.map(f32::round)).norm() < 0.03, "{candidate:?}");
            let [first, second] = candidate.edges;
            assert!(first.x * second.y - first.y * second.x > 0.99, "{candidate:?}");
        }
    }

    #[test]
    fn edges_run_as_those_of_a_crossing_in_their_order() {
        let edges = [Vec2::new(1.0, 0.0), Vec2::new(0.0, 1.0)];
        let candidate = Candidate { pixel: Vec2::zeros(), edges, contrast: 100.0 };
        let steps = [Vec2::new(9.0, 2.0), Vec2::new(-1.0, 7.0)];
        assert!(candidate.has_edges(edges_along(steps, 1.0), 0.3));
        assert!(!candidate.has_edges(edges_along(steps, 1.0), 0.2), "the sine is 0.217");
        assert!(!candidate.has_edges(edges_along(steps, -1.0), 0.3));
        let exchanged = Candidate { edges: [edges[1], edges[0]], ..candidate };
        assert!(exchanged.has_edges(edges_along(steps, -1.0), 0.3));
    }

    #[test]
    fn edges_stripes_and_flat_images_have_none() {
        for pixels in [
            vec![90; 3600],
            (0..3600).map(|i| if i % 60 < 30 { 20 } else { 200 }).collect(),
            (0..3600).map(|i| if i % 60 / 4 % 2 == 0 { 20 } else { 200 }).collect::<Vec<u8>>(),
        ] {
            assert_eq!(candidates_of(pixels).len(), 0);
        }
    }
}
