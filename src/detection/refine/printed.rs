//! Fits with other print removed from the corners' windows, where blur brings it in.

use crate::detection::refine::fitted::Fitted;
use crate::detection::refine::grid_corner::GridCorner;
use crate::detection::refine::lattice::{FittedCorner, axes_of};
use crate::detection::refine::print::{BoardPrint, disturbs};
use crate::detection::refine::print_blur::{PrintBlur, PrintRendering};
use crate::detection::refine::refiner::Refiner;
use crate::detection::refine::transfer::linear_power;
use crate::detection::refine::window_context::{NearbyPrint, WindowContext};
use crate::geometry::median::median_of;
use crate::geometry::pixel::Pixel;
use crate::imaging::gray::GrayView;

impl Refiner {
    /// Where blur brings other edges of the print into the corners' windows: repeats the fits with
    /// these removed, each time with black and white from the previous round, and with the blur and
    /// the gamma that then match the image best. `None` where blur does not.
    pub(super) fn fit_printed(
        &mut self,
        image: GrayView<'_>,
        corners: &[GridCorner],
        print: &mut dyn BoardPrint,
    ) -> Option<PrintRendering> {
        let blur_px = self.median_blur_px()?;
        let disturbed = corners
            .iter()
            .filter_map(axes_of)
            .filter(|&axes| disturbs(print.room(), axes, blur_px));
        if 2 * disturbed.count() < corners.len() {
            return None;
        }
        self.place(print);
        let mut rendering = self.median_rendering()?;
        for round in 0..self.thresholds.print_rounds {
            let noise = self.noise.of_pixels();
            self.noise.clear();
            for (slot, corner) in corners.iter().enumerate() {
                let Some(first) = self.fitted[slot] else { continue };
                let print = Some((slot, NearbyPrint { print: &*print, rendering }));
                let context = WindowContext { print, shaded: self.shaded[slot], light: None };
                let second = self
                    .fit_within_board(image, corner, &first, noise, context)
                    .filter(|second| second.may_be_corner(corner, &self.thresholds));
                if let Some(second) = second {
                    self.noise.take(second.fit.residuals.flat, second.window.bin);
                    self.fitted[slot] = Some(second);
                }
            }
            self.compare_fits();
            self.lattice.fill(corners, &self.known);
            self.place(print);
            let nearby_print = NearbyPrint { print: &*print, rendering };
            rendering = match round {
                0 => self.aligned_rendering(image, corners, nearby_print),
                _ => self.aligned_again(image, corners, nearby_print),
            };
        }
        Some(rendering)
    }

    pub(super) fn place(&mut self, print: &mut dyn BoardPrint) {
        self.placed.clear();
        let center = |known: &Option<FittedCorner>| known.map(|it| Pixel::new(it.at[0], it.at[1]));
        self.placed.extend(self.known.iter().map(center));
        print.put(&self.placed);
    }

    /// Blur and gamma as the median over the corners' fits, without motion.
    pub(super) fn median_rendering(&mut self) -> Option<PrintRendering> {
        let blur = PrintBlur::round(self.median_blur_px()?);
        Some(PrintRendering { blur, power: self.median_power()? })
    }

    /// Median width of the blur at the corners.
    fn median_blur_px(&mut self) -> Option<f64> {
        let blurs = &mut self.blurs_px;
        blurs.clear();
        blurs.extend(self.fitted.iter().flatten().map(Fitted::blur_px));
        median_of(blurs)
    }

    /// The median over the corners of the power that makes gray values proportional to light.
    pub(super) fn median_power(&mut self) -> Option<f64> {
        let powers = &mut self.powers;
        powers.clear();
        powers.extend(self.fitted.iter().flatten().map(|it| linear_power(&it.fit.model)));
        median_of(powers)
    }
}
