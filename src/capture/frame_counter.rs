//! A device's own frame count, which begins anew with every opening, as one that only rises.

/// Counts frame sets over all openings of one device.
#[derive(Debug)]
pub(super) struct FrameCounter {
    next: u64,
    last: Option<u64>,
}

impl FrameCounter {
    /// The next frame set has the number `next`.
    pub fn new(next: u64) -> Self {
        Self { next, last: None }
    }

    /// The number of the next frame set.
    pub fn next(&self) -> u64 {
        self.next
    }

    /// Counts a frame by the device's number; how many before it are missing.
    pub fn count(&mut self, number: u64) -> u64 {
        let ahead = self.last.map_or(1, |last| number.wrapping_sub(last));
        self.last = Some(number);
        // A count that stands still, or jumps back, is none.
        let missed = if (1..1 << 31).contains(&ahead) { ahead - 1 } else { 0 };
        self.next += missed + 1;
        missed
    }

    /// As [`Self::count`], of a number of 32 bits, which begins again at 0 after the largest.
    pub fn count_32(&mut self, number: u32) -> u64 {
        let last = self.last.unwrap_or(u64::from(number).wrapping_sub(1));
        let ahead = number.wrapping_sub(last as u32);
        self.count(last.wrapping_add(u64::from(ahead)))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn gaps_are_counted_and_numbers_only_rise() {
        let mut counter = FrameCounter::new(100);
        let steps =
            [(7, 0, 101), (8, 0, 102), (11, 2, 105), (11, 0, 106), (3, 0, 107), (4, 0, 108)];
        for (sequence, missed, next) in steps {
            assert_eq!((counter.count(sequence), counter.next()), (missed, next));
        }
    }

    #[test]
    fn a_count_of_32_bits_may_begin_again() {
        let mut counter = FrameCounter::new(0);
        assert_eq!((counter.count_32(u32::MAX), counter.next()), (0, 1));
        assert_eq!((counter.count_32(1), counter.next()), (1, 3), "0 was missed");
        assert_eq!((counter.count_32(0), counter.next()), (0, 4), "back to the start");
        assert_eq!((counter.count_32(1), counter.next()), (0, 5));
    }
}
