//! The first fit of each corner: in a small window by itself, started from the previous corner's
//! fit.

use crate::detection::refine::corner_model::{CornerModel, length};
use crate::detection::refine::fit::FitOptions;
use crate::detection::refine::fitted::Fitted;
use crate::detection::refine::grid_corner::GridCorner;
use crate::detection::refine::lattice::axes_of;
use crate::detection::refine::normal_equations::Noise;
use crate::detection::refine::refiner::Refiner;
use crate::detection::refine::window::{PIXEL_VARIANCE, Window};
use crate::imaging::gray::GrayView;

/// Start values that neighboring corners share. The last three are in units of half the difference
/// of the quadrants' means, which blur makes smaller than that of black and white.
#[derive(Debug, Clone, Copy, PartialEq)]
struct StartValues {
    blur_px: f64,
    /// The model's amplitude, without its sign.
    contrast: f64,
    /// The model's level minus the mean of the quadrants' means.
    offset: f64,
    gamma_term: f64,
}

impl StartValues {
    /// That of a sharp corner in an ordinary image: only the start of the first fit.
    const TYPICAL: Self = Self { blur_px: 1.0, contrast: 1.3, offset: 0.0, gamma_term: 0.0 };
}

/// Orders `corners` line by line of the grid, as a page is read: along its longer side, where lines
/// end least often, or along the image's rows where both are equal. Each fit starts from the one
/// before and ends within a tolerance of its minimum, so the order must not depend on how the grid
/// is labeled: a 9x6 board is a 6x9 board too.
fn order_in_image(corners: &[GridCorner], order: &mut Vec<usize>) {
    let axis = |k: usize| {
        let sides = |corner: &GridCorner| {
            let ahead = corner.neighbors[k].map(|p| [p.x - corner.pixel.x, p.y - corner.pixel.y]);
            let behind = corner.neighbors[k + 2];
            [ahead, behind.map(|p| [corner.pixel.x - p.x, corner.pixel.y - p.y])]
        };
        let steps = corners.iter().flat_map(sides).flatten();
        steps.fold([0.0; 2], |sum, step| [sum[0] + step[0], sum[1] + step[1]])
    };
    let axes = [axis(0), axis(1)];
    let extent = |of: &dyn Fn(&GridCorner) -> i32| {
        let (least, most) = corners
            .iter()
            .map(of)
            .fold((i32::MAX, i32::MIN), |(least, most), at| (least.min(at), most.max(at)));
        i64::from(most) - i64::from(least)
    };
    let [cols, rows] = [extent(&|corner| corner.index.col), extent(&|corner| corner.index.row)];
    let [col, row] = axes.map(|axis| axis[0].abs() / length(axis).max(f64::MIN_POSITIVE));
    let is_along_cols = cols > rows || (cols == rows && col >= row);
    let (along, across) = if is_along_cols { (0, 1) } else { (1, 0) };
    let (forward, down) = (axes[along][0] >= 0.0, axes[across][1] >= 0.0);
    order.clear();
    order.extend(0..corners.len());
    order.sort_unstable_by_key(|slot| {
        let index = corners[*slot].index;
        let place = [i64::from(index.col), i64::from(index.row)];
        let signed = |k: usize, positive: bool| if positive { place[k] } else { -place[k] };
        (signed(across, down), signed(along, forward))
    });
}

impl Refiner {
    /// The first fits.
    pub(super) fn fit_each(&mut self, image: GrayView<'_>, corners: &[GridCorner]) {
        self.fitted.clear();
        self.fitted.resize(corners.len(), None);
        self.noise.clear();
        self.scatter.clear();
        let mut order = std::mem::take(&mut self.order);
        order_in_image(corners, &mut order);
        let (mut start_values, mut clear) = (StartValues::TYPICAL, StartValues::TYPICAL);
        for &slot in &order {
            let corner = &corners[slot];
            let mut fitted = self.fit_from(image, corner, &start_values);
            // A fit to an occluder is a bad start for the corners after it.
            if fitted.is_none() && start_values != clear {
                fitted = self.fit_from(image, corner, &clear);
            }
            if let Some(fitted) = &fitted {
                start_values = self.as_start_values(fitted);
                if fitted.inlier_ratio > self.thresholds.clear_inliers {
                    clear = start_values;
                }
                self.noise.take(fitted.fit.residuals.flat, fitted.window.bin);
            }
            self.fitted[slot] = fitted;
        }
        self.order = order;
    }

    /// The first fit of a corner, if it may be the requested one.
    fn fit_from(
        &mut self,
        image: GrayView<'_>,
        corner: &GridCorner,
        start_values: &StartValues,
    ) -> Option<Fitted> {
        self.fit_alone(image, corner, start_values)
            .filter(|fitted| fitted.may_be_corner(corner, &self.thresholds))
    }

    /// The first fit of a corner: in a small window, whose size follows the blur and which moves
    /// with the corner. If it fails, the initial position may be far off: a window with larger bins
    /// covers more.
    fn fit_alone(
        &mut self,
        image: GrayView<'_>,
        corner: &GridCorner,
        start_values: &StartValues,
    ) -> Option<Fitted> {
        let axes = axes_of(corner)?;
        let guess = [corner.pixel.x, corner.pixel.y];
        let (mut origin, mut blur_px, mut coarser) =
            (guess, start_values.blur_px.max(self.thresholds.least_start_blur_px), 1);
        let mut best = None;
        for _ in 0..self.thresholds.most_windows {
            let window = Window::new(
                origin,
                axes,
                blur_px,
                self.thresholds.first_reach * coarser as f64,
                1.0 - self.taken,
            )
            .coarsened(coarser);
            let Some(first) = self
                .fit_in(image, window, &StartValues { blur_px, ..*start_values })
                .filter(|fitted| fitted.has_settled(&self.thresholds))
            else {
                (origin, coarser) = (guess, 2 * coarser);
                continue;
            };
            let (center, seen) = (first.center(), first.blur_px());
            let stayed = length([center[0] - origin[0], center[1] - origin[1]])
                < self.thresholds.recenter * window.bin as f64;
            if coarser == 1 {
                best = Some(first);
                if seen < self.thresholds.wider * blur_px && stayed {
                    break;
                }
                blur_px = blur_px.max(seen);
            }
            (origin, coarser) = (center, 1);
        }
        best
    }

    /// Start values for the next corner, from the one just fitted.
    fn as_start_values(&self, fitted: &Fitted) -> StartValues {
        let model = &fitted.fit.model;
        let [minus, plus] = self.quarter_means;
        let half = ((plus - minus) / 2.0).abs().max(self.thresholds.least_start_amplitude);
        StartValues {
            blur_px: fitted.blur_px(),
            contrast: (model.amplitude.abs() / half)
                .clamp(1.0, self.thresholds.most_start_contrast),
            offset: ((model.level - (plus + minus) / 2.0) / half)
                .clamp(-self.thresholds.most_start_offset, self.thresholds.most_start_offset),
            gamma_term: (model.gamma_term / half)
                .clamp(-self.thresholds.most_start_offset, self.thresholds.most_start_offset),
        }
    }

    fn fit_in(
        &mut self,
        image: GrayView<'_>,
        window: Window,
        start_values: &StartValues,
    ) -> Option<Fitted> {
        self.gather(image, &window)?;
        let start = self.start(&window, start_values)?;
        // The noise is not known yet: black and white get the same; the scale does not matter.
        let noise = Noise {
            black: 1.0,
            white: 1.0,
            tolerance: self.thresholds.first_tolerance * start.amplitude.abs()
                + self.thresholds.first_tolerance_levels,
        };
        // The first step may keep the position and only find black, white and blur.
        let options = FitOptions {
            iterations: [2, 8],
            enough: self.thresholds.first_enough,
            alike: self.thresholds.first_alike,
            with_flat: true,
        };
        self.fit(window, start, &noise, &options)
    }

    /// The start of the first fit: along the axes, with black and white from the means of the four
    /// quadrants, corrected as at the previous corner.
    fn start(&mut self, window: &Window, start_values: &StartValues) -> Option<CornerModel> {
        let bin = window.bin as f64;
        let along = window.axes.map(|axis| axis.map(|v| v / length(axis)));
        self.quarter_means = self.samples.quarter_means(along);
        let [minus, plus] = self.quarter_means;
        let sigma =
            (start_values.blur_px * start_values.blur_px + PIXEL_VARIANCE * bin * bin).sqrt() / bin;
        let amplitude = (plus - minus) / 2.0;
        (amplitude.abs() > self.thresholds.least_start_amplitude).then_some(CornerModel {
            center: [0.0; 2],
            along,
            sharpness: [1.0 / sigma; 2],
            curvature: [0.0; 2],
            level: (plus + minus) / 2.0 + start_values.offset * amplitude.abs(),
            amplitude: start_values.contrast * amplitude,
            gamma_term: start_values.gamma_term * amplitude.abs(),
            gradient: [0.0; 2],
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::detection::board_detection::GridIndex;
    use crate::geometry::pixel::Pixel;

    const COLS: i32 = 4;
    const ROWS: i32 = 3;

    /// A grid whose lines are rotated by 20 degrees in the image, with its labels rotated by
    /// `quarters` of a full rotation.
    fn grid(quarters: u32) -> Vec<GridCorner> {
        let (sin, cos) = 20f64.to_radians().sin_cos();
        let pixel = |[x, y]: [i32; 2]| {
            let [x, y] = [f64::from(x), f64::from(y)].map(|v| 30.0 * v);
            Pixel::new(cos * x - sin * y, sin * x + cos * y)
        };
        let is_on_board = |[x, y]: [i32; 2]| (0..COLS).contains(&x) && (0..ROWS).contains(&y);
        let rotated = |[x, y]: [i32; 2]| match quarters {
            0 => [x, y],
            1 => [y, -x],
            2 => [-x, -y],
            _ => [-y, x],
        };
        let places = (0..ROWS).flat_map(|y| (0..COLS).map(move |x| [x, y]));
        let mut corners: Vec<GridCorner> = places
            .map(|place| {
                let [col, row] = rotated(place);
                let mut neighbors = [None; 4];
                for step in [[1, 0], [0, 1], [-1, 0], [0, -1]] {
                    let beside = [place[0] + step[0], place[1] + step[1]];
                    let side = match rotated(step) {
                        [1, 0] => 0,
                        [0, 1] => 1,
                        [-1, 0] => 2,
                        _ => 3,
                    };
                    neighbors[side] = is_on_board(beside).then(|| pixel(beside));
                }
                GridCorner { index: GridIndex { col, row }, pixel: pixel(place), neighbors }
            })
            .collect();
        corners.sort_by_key(|corner| (corner.index.row, corner.index.col));
        corners
    }

    #[test]
    fn the_order_is_that_of_the_image_however_the_grid_is_labeled() {
        let mut order = Vec::new();
        let expected: Vec<Pixel> = grid(0).iter().map(|corner| corner.pixel).collect();
        for quarters in 0..4 {
            let corners = grid(quarters);
            order_in_image(&corners, &mut order);
            let pixels: Vec<Pixel> = order.iter().map(|slot| corners[*slot].pixel).collect();
            assert_eq!(pixels, expected, "{quarters}");
        }
    }
}
