//! Seeded randomness: each purpose has its own stream, so that an additional draw for one changes
//! nothing for the others.

use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;

/// The purpose of random numbers.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[repr(u64)]
pub(super) enum Purpose {
    Lens = 1,
    Waypoint = 2,
    Background = 3,
    Image = 4,
    Rig = 5,
    Depth = 6,
    Seat = 7,
    Operator = 8,
    Mover = 9,
}

/// The stream of `seed` for `purpose`, the `index`-th of its kind.
pub(super) fn stream(seed: u64, purpose: Purpose, index: u64) -> ChaCha8Rng {
    let mut key = [0; 32];
    for (slot, word) in key.chunks_exact_mut(8).zip([seed, purpose as u64, index, 0]) {
        slot.copy_from_slice(&word.to_le_bytes());
    }
    ChaCha8Rng::from_seed(key)
}
