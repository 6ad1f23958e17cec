//! Gray values of 16 bits as 8: many sensors fill only the lower 10, 12 or 14.

/// Pixels, of all, that may be brighter than white: defects of a sensor that always read full
/// scale. Chosen, not swept: 31 pixels of 640x480.
const MOST_DEFECTIVE_PART: f64 = 1e-4;

/// Sensors whose images come in 16 bits have at least this many.
const FEWEST_BITS: u32 = 10;

/// Values whose lower bits are all 0, as many as these or more, were moved up to fill 16 bits, as
/// V4L2's 10 and 12 bits are here.
const EMPTY_BITS: u32 = 4;

/// How many lower bits of `values` are dropped so that white fits 8: 2, 4, 6 or 8, for values of
/// 10, 12, 14 or 16 bits. All but a few, which may be defects, then stay below white.
///
/// Even, so that images of one sensor are not shown differently when the brightest pixel changes a
/// little; 8 for values that use all 16 bits, as OpenCV's `imread` reads such a file in gray.
pub fn bits_to_drop(values: impl Iterator<Item = u16>) -> u32 {
    let (mut pixels_of_bits, mut set) = ([0_usize; 17], 0);
    for value in values {
        pixels_of_bits[(u16::BITS - value.leading_zeros()) as usize] += 1;
        set |= value;
    }
    if set.trailing_zeros() >= EMPTY_BITS {
        return 8;
    }
    let allowed = (pixels_of_bits.iter().sum::<usize>() as f64 * MOST_DEFECTIVE_PART) as usize;
    let mut brighter = 0;
    let bits = (FEWEST_BITS..=16).rev().find(|bits| {
        brighter += pixels_of_bits[*bits as usize];
        brighter > allowed
    });
    bits.unwrap_or(FEWEST_BITS).next_multiple_of(2) - 8
}

/// `value` without its lower `dropped` bits; 255 for what is brighter than white.
pub fn upper_8_bits(value: u16, dropped: u32) -> u8 {
    u8::try_from(value >> dropped).unwrap_or(u8::MAX)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn white_fits_8_bits_whatever_the_sensor_fills() {
        for (white, dropped) in
            [(1, 2), (255, 2), (1023, 2), (1024, 4), (4095, 4), (9000, 6), (16_384, 8), (65_535, 8)]
        {
            let ramp = (0..1000_u32).map(|k| (white * k / 999) as u16);
            assert_eq!(bits_to_drop(ramp), dropped, "{white}");
            assert!(white >> dropped <= 255);
        }
        assert_eq!(bits_to_drop(std::iter::empty()), 8);
    }

    /// A lens cap on a sensor of 10 bits, which V4L2 passes on in the upper ones.
    #[test]
    fn values_that_were_moved_up_stay_dark() {
        assert_eq!(bits_to_drop((0..400).map(|k| (k % 4) << 6)), 8);
    }

    #[test]
    fn a_defect_that_reads_full_scale_does_not_darken_the_image() {
        let with = |defects: usize| {
            (0..100_000).map(move |k| if k < defects { u16::MAX } else { (k % 4096) as u16 })
        };
        assert_eq!(bits_to_drop(with(10)), 4);
        assert_eq!(bits_to_drop(with(11)), 8);
        assert_eq!(
            (upper_8_bits(4095, 4), upper_8_bits(u16::MAX, 4), upper_8_bits(0, 4)),
            (255, 255, 0)
        );
    }
}
