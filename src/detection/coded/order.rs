//! The order in which lattices are grown from candidates: those whose squares extend farthest come
//! first.
//!
//! A marker's payload is full of crossings of its own. Around them nothing is regular beyond one
//! payload cell, while a crossing of the board has the same black (on an inverted board white) on
//! both sides as far as a square or a marker's border extends.

use crate::detection::measure::edges::sample;
use crate::detection::search::candidates::Candidate;
use crate::detection::vec2::Vec2;
use crate::imaging::gray::GrayView;

/// Distances from a crossing at which its squares are sampled, along their diagonals in pixels: the
/// first is just outside a blurred crossing, and each is about 4/3 of the previous one.
const SQUARE_DISTANCES_PX: [f32; 8] = [4.0, 5.5, 7.5, 10.0, 13.5, 18.0, 24.0, 32.0];

/// Fills `order` with the indices of `candidates`, those whose squares extend farthest first.
pub(super) fn by_reach(
    image: GrayView<'_>,
    candidates: &[Candidate],
    order: &mut Vec<(usize, usize)>,
) {
    order.clear();
    order.extend(candidates.iter().enumerate().map(|(k, found)| (reach(image, found), k)));
    order.sort_unstable_by_key(|&(reach, index)| (usize::MAX - reach, index));
}

/// The number of distances to which both dark squares extend, or both bright ones.
fn reach(image: GrayView<'_>, candidate: &Candidate) -> usize {
    let [first, second] = candidate.edges;
    let (bright, dark) = (first + second, first - second);
    let middle = {
        let near = |way: Vec2| {
            let way = way / way.norm().max(1e-3) * SQUARE_DISTANCES_PX[0];
            Some(sample(image, candidate.pixel + way)? + sample(image, candidate.pixel - way)?)
        };
        match (near(bright), near(dark)) {
            (Some(a), Some(b)) => (a + b) / 4.0,
            _ => return 0,
        }
    };
    let reaches = |way: Vec2, sign: f32, distance: f32| {
        let holds = |p| sample(image, p).is_some_and(|v| (v - middle) * sign > 0.0);
        holds(candidate.pixel + way * distance) && holds(candidate.pixel - way * distance)
    };
    let run = |way: Vec2, sign: f32| {
        SQUARE_DISTANCES_PX.iter().take_while(|&&distance| reaches(way, sign, distance)).count()
    };
    let [bright, dark] = [bright, dark].map(|way| way / way.norm().max(1e-3));
    let of_dark = run(dark, -1.0);
    // The bright squares matter only where they extend farther.
    match SQUARE_DISTANCES_PX.get(of_dark) {
        Some(&farther) if reaches(bright, 1.0, farther) => of_dark.max(run(bright, 1.0)),
        _ => of_dark,
    }
}
