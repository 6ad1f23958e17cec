//! Fits that take other print off the corners' windows, where blur brings it in.

use crate::detection::refine::beside::{Beside, Nearby};
use crate::detection::refine::fitted::Fitted;
use crate::detection::refine::grid_corner::GridCorner;
use crate::detection::refine::lattice::{Known, axes_of};
use crate::detection::refine::print::{BoardPrint, PrintBlur, disturbs, linear_power};
use crate::detection::refine::refiner::Refiner;
use crate::detection::refine::window::Window;
use crate::geometry::median::median_of;
use crate::geometry::pixel::Pixel;
use crate::imaging::gray::GrayView;

impl Refiner {
    /// Where blur brings other edges of the print into the corners' windows: fits that take them
    /// off, each with what the one before it says of blur, black and white. `None` where it does
    /// not.
    pub(super) fn fit_printed(
        &mut self,
        image: GrayView<'_>,
        corners: &[GridCorner],
        print: &mut dyn BoardPrint,
    ) -> Option<(PrintBlur, f64)> {
        let blur_px = self.median_blur_px()?;
        let disturbed = corners
            .iter()
            .filter_map(axes_of)
            .filter(|&axes| disturbs(print.room(), axes, blur_px));
        if 2 * disturbed.count() < corners.len() {
            return None;
        }
        self.place(print);
        let mut power = self.median_power()?;
        let mut blur = PrintBlur::round(blur_px);
        for _ in 0..self.thresholds.print_rounds {
            let noise = self.noise.of_pixels();
            self.noise.clear();
            for (slot, corner) in corners.iter().enumerate() {
                let Some(first) = self.fitted[slot] else { continue };
                let print = Some((slot, Nearby { print: &*print, blur, power }));
                let beside = Beside { print, shaded: self.shaded[slot] };
                let second = self
                    .fit_within_board(image, corner, &first, noise, beside)
                    .filter(|second| second.may_be_corner(corner, &self.thresholds));
                if let Some(second) = second {
                    self.noise.take(second.fit.residuals.flat, second.window.bin);
                    self.fitted[slot] = Some(second);
                }
            }
            self.compare_fits();
            self.lattice.fill(corners, &self.known);
            self.place(print);
            power = self.median_power()?;
            blur = self.blur_as_seen(image, &*print, power)?;
        }
        Some((blur, power))
    }

    pub(super) fn place(&mut self, print: &mut dyn BoardPrint) {
        self.placed.clear();
        let center = |known: &Option<Known>| known.map(|it| Pixel::new(it.at[0], it.at[1]));
        self.placed.extend(self.known.iter().map(center));
        print.put(&self.placed);
    }

    /// Median width of the blur at the corners.
    fn median_blur_px(&mut self) -> Option<f64> {
        let blurs = &mut self.blurs_px;
        blurs.clear();
        blurs.extend(self.fitted.iter().flatten().map(Fitted::blur_px));
        median_of(blurs)
    }

    /// Median of the powers of the corners' gray values that are in proportion to light.
    fn median_power(&mut self) -> Option<f64> {
        let powers = &mut self.powers;
        powers.clear();
        powers.extend(self.fitted.iter().flatten().map(|it| linear_power(&it.fit.model)));
        median_of(powers)
    }

    /// The blur that makes the print most like the image, of those that blur the edges as the
    /// corners' fits say: round, or a motion in some direction.
    fn blur_as_seen(
        &mut self,
        image: GrayView<'_>,
        print: &dyn BoardPrint,
        power: f64,
    ) -> Option<PrintBlur> {
        let blur_px = self.median_blur_px()?;
        let round = PrintBlur::round(blur_px);
        if blur_px < self.thresholds.least_motion_px {
            return Some(round);
        }
        let fitted = std::mem::take(&mut self.fitted);
        let compared: Vec<(usize, &Fitted)> = (fitted.iter().enumerate())
            .filter_map(|(slot, fitted)| Some((slot, fitted.as_ref()?)))
            .filter(|(slot, _)| self.known[*slot].is_some())
            .collect();
        let every = (compared.len() / self.thresholds.compared_corners).max(1);
        let mut misfit = |blur: PrintBlur| -> f64 {
            let each = compared.iter().step_by(every).filter_map(|(slot, fitted)| {
                let axes = fitted.window.axes;
                let window =
                    Window::new(fitted.center(), axes, blur_px, self.thresholds.second_reach, 1.0);
                self.gather(image, &window)?;
                self.patch.render(print, *slot, &window, blur);
                let bins = [fitted.window.bin, window.bin].map(|bin| bin as f64);
                let model = fitted.fit.model.rescaled(bins[0], bins[1]);
                Some(self.patch.misfit(&mut self.samples, &model, power))
            });
            each.sum()
        };
        let best = PrintBlur::best(blur_px, &mut misfit);
        self.fitted = fitted;
        Some(best)
    }
}
