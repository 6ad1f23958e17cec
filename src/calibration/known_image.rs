//! In how much of the image a lens is known well enough, by the same limits whatever it was
//! calibrated from.

use crate::calibration::result::Grade;
use crate::estimation::uncertainty::UncertaintyMap;

/// A good calibration and a usable one know at least this fraction of the image …
const KNOWN_FRACTIONS: [f64; 2] = [0.95, 0.67];
/// … to within this fraction of the image's diagonal (1 sigma): 0.4 and 1 px at 640x480, which with
/// a lens 60 degrees wide are 0.7 and 1.8 mm at a meter.
const KNOWN_DIAGONALS: [f64; 2] = [0.0005, 0.00125];

/// The uncertainty of projections over an image, with the limits to grade it by.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct KnownImage {
    /// 1 sigma at each pixel of the grid inside the lens's valid region.
    std_px: Vec<f64>,
    limits_px: [f64; 2],
}

impl KnownImage {
    /// That of `map`.
    pub(super) fn of(map: &UncertaintyMap) -> Self {
        Self {
            std_px: map.std_px.iter().flatten().copied().collect(),
            limits_px: KNOWN_DIAGONALS.map(|part| part * map.grid.size.diagonal_px()),
        }
    }

    /// The uncertainty that a good calibration stays within, in pixels.
    pub(super) fn good_px(&self) -> f64 {
        self.limits_px[0]
    }

    /// The percentage of the image that is less certain than that.
    pub(super) fn beyond_good_percent(&self) -> f64 {
        (1.0 - self.part_within(self.good_px())) * 100.0
    }

    /// Its grade.
    pub(super) fn grade(&self) -> Grade {
        self.grade_widened(1.0)
    }

    /// Its grade if uncertainties were allowed to be `factor` times as large.
    pub(super) fn grade_widened(&self, factor: f64) -> Grade {
        let [good_px, usable_px] = self.limits_px.map(|limit_px| limit_px * factor);
        match KNOWN_FRACTIONS {
            [good, _] if self.part_within(good_px) >= good => Grade::Good,
            [_, usable] if self.part_within(usable_px) >= usable => Grade::Usable,
            _ => Grade::Poor,
        }
    }

    fn part_within(&self, limit_px: f64) -> f64 {
        let within = self.std_px.iter().filter(|std_px| **std_px <= limit_px).count();
        within as f64 / self.std_px.len().max(1) as f64
    }
}
