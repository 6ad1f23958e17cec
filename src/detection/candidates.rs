//! Which pixels could be chessboard corners: the strongest local maxima of the response, each looked at once more.
//!
//! However busy the picture, no more than [`MOST_TILES`] maxima and [`MOST`] candidates go on: time is bounded by pixels.

use super::cross::{Vec2, Window};
use super::response::{HALF_RING, REACH, Response};
use crate::imaging::gray::GrayView;

/// Tiles of the response, 4×4 pixels each, whose maximum is looked at.
const MOST_TILES: usize = 1024;
/// Candidates that go on.
pub(super) const MOST: usize = 700;
const TILE: usize = 4;
/// Weaker responses are noise even in an image of low contrast.
const LEAST_RESPONSE: u8 = 4;
/// Responses below the strongest divided by this are not looked at.
const LEAST_SHARE: usize = 32;
/// Least correlation with a chessboard corner, before and after moving to where its edges cross.
const LEAST_FIRST_SCORE: f32 = 0.35;
const LEAST_SCORE: f32 = 0.45;

/// A place that looks like a chessboard corner.
#[derive(Debug, Clone, Copy)]
pub(super) struct Candidate {
    /// Where, in pixels of the level.
    pub pixel: Vec2,
    /// Unit vectors along the two edges, in an order such that the bright wedges are those from the first to the second
    /// and opposite, turning from +x to +y.
    pub edges: [Vec2; 2],
    /// Bright wedges less dark wedges, in grey levels.
    pub contrast: f32,
}

/// Finds candidates. Buffers are kept from image to image.
#[derive(Debug, Default)]
pub(super) struct CandidateSearch {
    tiles: Vec<(u8, u32, u32)>,
    sorted: Vec<(u8, u32, u32)>,
    maxima: Vec<u8>,
    /// What was found last, in raster order of tiles.
    pub found: Vec<Candidate>,
}

impl CandidateSearch {
    /// Finds the candidates of `image`, whose response is `response`.
    pub(super) fn search(&mut self, image: GrayView<'_>, response: &Response) {
        self.collect_tiles(response);
        self.found.clear();
        for &(value, x, y) in &self.sorted {
            if self.found.len() == MOST {
                break;
            }
            if is_peak(response, value, x as usize, y as usize)
                && let Some(candidate) = examine(image, x as usize, y as usize)
            {
                self.found.push(candidate);
            }
        }
    }

    /// The strongest pixel of each tile, strongest tiles first.
    fn collect_tiles(&mut self, response: &Response) {
        self.tiles.clear();
        let across = response.width() / TILE;
        self.maxima.resize(across * TILE, 0);
        let mut counts = [0usize; 256];
        for top in (0..(response.height() / TILE) * TILE).step_by(TILE) {
            let rows: [&[u8]; TILE] = std::array::from_fn(|i| &response.row(top + i)[..across * TILE]);
            column_maxima(&rows, &mut self.maxima);
            for (tile, columns) in self.maxima.chunks_exact(TILE).enumerate() {
                let most = columns[0].max(columns[1]).max(columns[2].max(columns[3]));
                if most >= LEAST_RESPONSE {
                    counts[most as usize] += 1;
                    self.tiles.push((most, (tile * TILE) as u32, top as u32));
                }
            }
        }
        self.keep_strongest(response, &mut counts);
    }

    /// Leaves the strongest tiles, strongest first and equal ones in raster order, with the place of their maximum.
    fn keep_strongest(&mut self, response: &Response, counts: &mut [usize; 256]) {
        let strongest = counts.iter().rposition(|&count| count > 0).unwrap_or(0);
        let least = usize::from(LEAST_RESPONSE).max(strongest / LEAST_SHARE);
        let mut kept = 0;
        for value in (0..256).rev() {
            let count = if value < least { 0 } else { counts[value] };
            counts[value] = kept;
            kept = (kept + count).min(MOST_TILES);
        }
        self.sorted.clear();
        self.sorted.resize(kept, (0, 0, 0));
        for &(value, x, y) in &self.tiles {
            let slot = &mut counts[value as usize];
            if usize::from(value) < least || *slot >= kept {
                continue;
            }
            let (left, top) = (x as usize, y as usize);
            let at = (0..TILE * TILE).find(|i| response.row(top + i / TILE)[left + i % TILE] == value).unwrap_or(0);
            self.sorted[*slot] = (value, x + (at % TILE) as u32, y + (at / TILE) as u32);
            *slot += 1;
        }
    }
}

fn column_maxima(rows: &[&[u8]; TILE], out: &mut [u8]) {
    pulp::Arch::new().dispatch(ColumnMaxima { rows, out });
}

/// A struct, not a closure: all of it must be inlined to be compiled for the processor.
struct ColumnMaxima<'a> {
    rows: &'a [&'a [u8]; TILE],
    out: &'a mut [u8],
}

impl pulp::NullaryFnOnce for ColumnMaxima<'_> {
    type Output = ();

    #[inline(always)]
    fn call(self) {
        let [first, second, third, fourth] = self.rows.map(|row| &row[..self.out.len()]);
        for (i, out) in self.out.iter_mut().enumerate() {
            *out = first[i].max(second[i]).max(third[i].max(fourth[i]));
        }
    }
}

/// Whether no response within two pixels is larger; of equal ones the first in raster order counts.
fn is_peak(response: &Response, value: u8, x: usize, y: usize) -> bool {
    if x < REACH || y < REACH || x + REACH >= response.width() || y + REACH >= response.height() {
        return false;
    }
    (y - 2..=y + 2).all(|row| {
        let values = &response.row(row)[x - 2..=x + 2];
        values.iter().enumerate().all(|(i, &other)| {
            let before = row < y || (row == y && i < 2);
            if before { other < value } else { other <= value }
        })
    })
}

/// Reads the two edges from the ring about (`x`, `y`) and the exact place from a window along them.
fn examine(image: GrayView<'_>, x: usize, y: usize) -> Option<Candidate> {
    let center = Vec2::new(x as f32, y as f32);
    let edges = ring_edges(image, x, y)?;
    let window = Window { center, a: edges[0] * 3.0, b: edges[1] * 3.0 };
    let first = window.look(image)?;
    if first.score < LEAST_FIRST_SCORE {
        return None;
    }
    let cross = Window { center: first.center, ..window }.look(image)?;
    if cross.score < LEAST_SCORE || cross.contrast < 3.0 || (cross.center - center).norm() > 2.5 {
        return None;
    }
    Some(Candidate { pixel: cross.center, edges, contrast: cross.contrast })
}

/// The edges that leave the middle of the ring: it must cross its own middle grey four times, at opposite places in pairs.
fn ring_edges(image: GrayView<'_>, x: usize, y: usize) -> Option<[Vec2; 2]> {
    let offset = |k: usize| {
        let (dx, dy) = HALF_RING[k % 8];
        if k % 16 < 8 { (dx, dy) } else { (-dx, -dy) }
    };
    let ring: [f32; 16] = std::array::from_fn(|k| {
        let (dx, dy) = offset(k);
        f32::from(image.row((y as i32 + dy) as usize)[(x as i32 + dx) as usize])
    });
    let (least, most) = ring.iter().fold((255.0f32, 0.0f32), |(l, m), &v| (l.min(v), m.max(v)));
    let middle = 0.5 * (least + most);
    let mut crossings = [Vec2::zeros(); 4];
    let mut rises = [false; 4];
    let mut count = 0;
    for k in 0..16 {
        let (from, to) = (ring[k] - middle, ring[(k + 1) % 16] - middle);
        if (from > 0.0) == (to > 0.0) {
            continue;
        }
        if count == 4 {
            return None;
        }
        let place = |k: usize| Vec2::new(offset(k).0 as f32, offset(k).1 as f32);
        crossings[count] = place(k).lerp(&place(k + 1), from / (from - to));
        rises[count] = to > 0.0;
        count += 1;
    }
    if count != 4 {
        return None;
    }
    let opposite = |p: Vec2, q: Vec2| p.dot(&q) < -0.6 * p.norm() * q.norm();
    if !opposite(crossings[0], crossings[2]) || !opposite(crossings[1], crossings[3]) {
        return None;
    }
    let first = (crossings[0] - crossings[2]).normalize();
    let second = (crossings[1] - crossings[3]).normalize();
    Some(if rises[0] { [first, second] } else { [second, -first] })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::imaging::gray::GrayImage;

    #[test]
    fn the_corners_of_a_small_checker_are_found_with_their_edges() {
        let pixels = (0..60 * 60).map(|i| if (i % 60 / 12 + i / 60 / 12) % 2 == 0 { 30 } else { 220 }).collect();
        let image = GrayImage::from_pixels(60, 60, pixels).expect("3600 pixels");
        let mut response = Response::default();
        response.compute(image.view());
        let mut search = CandidateSearch::default();
        search.search(image.view(), &response);
        assert_eq!(search.found.len(), 16);
        for candidate in &search.found {
            let nearest = candidate.pixel.map(|v| (v + 0.5) / 12.0);
            assert!((nearest - nearest.map(f32::round)).norm() < 0.03, "{candidate:?}");
            let [first, second] = candidate.edges;
            assert!(first.x * second.y - first.y * second.x > 0.99, "{candidate:?}");
        }
    }

    #[test]
    fn edges_stripes_and_flat_images_have_none() {
        for pixels in [
            vec![90; 3600],
            (0..3600).map(|i| if i % 60 < 30 { 20 } else { 200 }).collect(),
            (0..3600).map(|i| if i % 60 / 4 % 2 == 0 { 20 } else { 200 }).collect::<Vec<u8>>(),
        ] {
            let image = GrayImage::from_pixels(60, 60, pixels).expect("3600 pixels");
            let mut response = Response::default();
            response.compute(image.view());
            let mut search = CandidateSearch::default();
            search.search(image.view(), &response);
            assert_eq!(search.found.len(), 0);
        }
    }
}
