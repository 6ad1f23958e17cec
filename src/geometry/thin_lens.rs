//! The thin lens: the range of distances that is sharp.
//!
//! 1/f = 1/s + 1/v. The image of a point at distance d, with a lens focused at s, is a disc on the
//! sensor of diameter A · f/(s − f) · |d − s|/d, where A = f/N is the aperture (E. Hecht, *Optics*,
//! chapter 5).

/// A lens in front of a sensor.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ThinLens {
    /// Focal length, in meters.
    pub focal_m: f64,
    /// Focal length over the aperture's diameter.
    pub f_number: f64,
    /// The width of one pixel, in meters.
    pub pixel_m: f64,
    /// The distance in focus, in meters from the lens; infinite for a lens focused at infinity.
    pub focus_m: f64,
}

/// A lens that is not possible.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum ThinLensError {
    /// A length or number that is not positive.
    #[error("{what} cannot be {value}: give a positive number")]
    NotPositive {
        /// Which.
        what: &'static str,
        /// What was given.
        value: f64,
    },
    /// A focus nearer than twice the focal length.
    #[error(
        "a lens of {focal_m} m focal length cannot focus at {focus_m} m: give a distance beyond twice the focal length"
    )]
    FocusTooNear {
        /// The focal length.
        focal_m: f64,
        /// The requested distance.
        focus_m: f64,
    },
}

/// The range of distances that is sharp, in meters from the lens.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct DepthOfField {
    /// The nearest.
    pub near_m: f64,
    /// The farthest; infinite from the hyperfocal distance on.
    pub far_m: f64,
}

impl ThinLens {
    /// Checks that such a lens is possible.
    ///
    /// # Errors
    /// A number that is not positive, or a focus nearer than twice the focal length.
    pub fn check(self) -> Result<Self, ThinLensError> {
        let numbers = [
            ("the focal length", self.focal_m),
            ("the f-number", self.f_number),
            ("the pixel's width", self.pixel_m),
            ("the distance in focus", self.focus_m),
        ];
        for (what, value) in numbers {
            let finite = value.is_finite() || what == "the distance in focus";
            if !(value > 0.0 && finite) {
                return Err(ThinLensError::NotPositive { what, value });
            }
        }
        if self.focus_m < 2.0 * self.focal_m {
            return Err(ThinLensError::FocusTooNear {
                focal_m: self.focal_m,
                focus_m: self.focus_m,
            });
        }
        Ok(self)
    }

    /// The diameter of the blur disc of a point at `distance_m`, in pixels.
    pub fn blur_px(self, distance_m: f64) -> f64 {
        let aperture_m = self.focal_m / self.f_number;
        // In terms of 1/d and 1/s, which also holds for infinite distances.
        let magnified = self.focal_m / (1.0 - self.focal_m / self.focus_m);
        aperture_m * magnified * (1.0 / self.focus_m - 1.0 / distance_m).abs() / self.pixel_m
    }

    /// The range of distances at which a point's blur disc is at most `blur_px` pixels wide.
    pub fn depth_of_field(self, blur_px: f64) -> DepthOfField {
        let aperture_m = self.focal_m / self.f_number;
        let magnified = self.focal_m / (1.0 - self.focal_m / self.focus_m);
        let difference = blur_px * self.pixel_m / (aperture_m * magnified);
        let (near, far) = (1.0 / self.focus_m + difference, 1.0 / self.focus_m - difference);
        DepthOfField {
            near_m: 1.0 / near,
            far_m: if far > 0.0 { 1.0 / far } else { f64::INFINITY },
        }
    }

    /// The nearest focus that keeps infinity sharp to `blur_px` pixels: f²/(N c) + f.
    pub fn hyperfocal_m(self, blur_px: f64) -> f64 {
        self.focal_m * self.focal_m / (self.f_number * blur_px * self.pixel_m) + self.focal_m
    }

    /// The focal length in pixels that a calibration should find: the distance from lens to sensor
    /// over a pixel's width.
    pub fn focal_px(self) -> f64 {
        self.focal_m / (1.0 - self.focal_m / self.focus_m) / self.pixel_m
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const LENS: ThinLens =
        ThinLens { focal_m: 0.008, f_number: 2.0, pixel_m: 3.45e-6, focus_m: 1.0 };

    #[test]
    fn agrees_with_the_textbook_formulas() {
        let (f, n, c, s) = (0.008, 2.0, 3.45e-6, 1.0);
        let hyperfocal = f * f / (n * c) + f;
        assert!((LENS.hyperfocal_m(1.0) - hyperfocal).abs() < 1e-12);
        let depth = LENS.depth_of_field(1.0);
        assert!((depth.near_m - s * (hyperfocal - f) / (hyperfocal + s - 2.0 * f)).abs() < 1e-9);
        assert!((depth.far_m - s * (hyperfocal - f) / (hyperfocal - s)).abs() < 1e-9);
        assert!((LENS.blur_px(depth.near_m) - 1.0).abs() < 1e-9 && LENS.blur_px(1.0) == 0.0);
        let far = ThinLens { focus_m: f64::INFINITY, ..LENS };
        assert_eq!(far.depth_of_field(1.0).far_m, f64::INFINITY);
        assert!((far.focal_px() - 0.008 / 3.45e-6).abs() < 1e-6);
    }

    #[test]
    fn impossible_lenses_are_refused() {
        for bad in [
            ThinLens { focal_m: 0.0, ..LENS },
            ThinLens { f_number: f64::NAN, ..LENS },
            ThinLens { focus_m: 0.01, ..LENS },
        ] {
            assert!(bad.check().is_err(), "{bad:?}");
        }
        assert!(ThinLens { focus_m: f64::INFINITY, ..LENS }.check().is_ok());
    }
}
