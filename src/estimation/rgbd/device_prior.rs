//! The prior of a depth camera's lens. Few boards, or boards in similar poses, do not determine all
//! of it, and without a prior the fit would diverge in the undetermined directions.

use crate::estimation::joint::normal::NormalEquations;
use crate::geometry::lens::Lens;
use crate::geometry::pixel::ImageSize;

/// The parameters of a depth lens that planes determine: focal lengths and principal point.
pub const LENS_PARAMETERS: usize = 4;

/// Standard deviation of ln(fx / fy): depth images have square pixels. Two published calibrations
/// of one Kinect by planes have −0.012 and 0.004 (D. Herrera C., J. Kannala, J. Heikkilä, PAMI
/// 2012). With eighteen of that Kinect's views, any value from 0.01 to 0.03 changes no result by a
/// tenth of its standard deviation, and with seven it keeps the lens from diverging, which it does
/// from 0.1 on. At 0.003 the lens of mirrored images is accepted.
const ASPECT_STD: f64 = 0.01;

/// Standard deviation of the principal point about the image's center, in widths of the image. It
/// is larger than a lens's offset from its sensor, since some depth images are cropped.
const CENTER_STD_WIDTHS: f64 = 0.05;

/// A lens further from the prior than this, in standard deviations of the prior, is not that of a
/// depth camera: a principal point a quarter of the width off center, or pixels one by 1.05 wide.
/// The lenses from those views lie within 1, that of their mirrored images at 9, so any limit
/// between separates them.
const IMPLAUSIBLE_STDS: f64 = 5.0;

/// A residual of the prior in standard deviations, with its derivatives by the focal lengths and
/// the principal point.
struct PriorRow {
    residual: f64,
    by_lens: [f64; LENS_PARAMETERS],
}

/// The prior's residuals of `lens`, whose image has this size.
fn rows(lens: &Lens, size: ImageSize) -> [PriorRow; 3] {
    let matrix = &lens.matrix;
    let center = [size.width, size.height].map(|side| 0.5 * (f64::from(side) - 1.0));
    let per_px = 1.0 / (CENTER_STD_WIDTHS * f64::from(size.width));
    let per_ln = 1.0 / ASPECT_STD;
    [
        PriorRow {
            residual: (matrix.fx / matrix.fy).ln() * per_ln,
            by_lens: [per_ln / matrix.fx, -per_ln / matrix.fy, 0.0, 0.0],
        },
        PriorRow { residual: (matrix.cx - center[0]) * per_px, by_lens: [0.0, 0.0, per_px, 0.0] },
        PriorRow { residual: (matrix.cy - center[1]) * per_px, by_lens: [0.0, 0.0, 0.0, per_px] },
    ]
}

/// Whether this lens is plausible for a depth camera with images of this size.
///
/// ```
/// use plumb::estimation::rgbd::device_prior::is_plausible;
/// use plumb::geometry::camera_matrix::CameraMatrix;
/// use plumb::geometry::lens::Lens;
/// use plumb::geometry::pixel::ImageSize;
///
/// let of = |cx| Lens::pinhole(CameraMatrix { fx: 580.0, fy: 580.0, cx, cy: 240.0, skew: 0.0 });
/// assert!(is_plausible(&of(320.0), ImageSize::new(640, 480)));
/// assert!(!is_plausible(&of(610.0), ImageSize::new(640, 480)));
/// ```
pub fn is_plausible(lens: &Lens, size: ImageSize) -> bool {
    rows(lens, size).iter().all(|row| row.residual.abs() <= IMPLAUSIBLE_STDS)
}

/// Adds the prior of a lens whose focal lengths and principal point are the global parameters from
/// `at` on.
pub(super) fn add_prior(equations: &mut NormalEquations, at: usize, lens: &Lens, size: ImageSize) {
    for PriorRow { residual, by_lens } in rows(lens, size) {
        equations.cost += residual * residual;
        for (i, di) in by_lens.iter().enumerate() {
            equations.global_gradient[at + i] += di * residual;
            for (j, dj) in by_lens.iter().enumerate() {
                equations.global[(at + i, at + j)] += di * dj;
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::camera_matrix::CameraMatrix;

    #[test]
    fn derivatives_agree_with_numeric_differences() {
        let at = [583.0, 590.0, 301.0, 246.0];
        let of = |[fx, fy, cx, cy]: [f64; 4]| {
            let lens = Lens::pinhole(CameraMatrix { fx, fy, cx, cy, skew: 0.0 });
            rows(&lens, ImageSize::new(640, 480))
        };
        for (k, row) in of(at).iter().enumerate() {
            for (i, analytic) in row.by_lens.iter().enumerate() {
                let moved = |step: f64| {
                    let mut lens = at;
                    lens[i] += step;
                    of(lens)[k].residual
                };
                let numeric = (moved(1e-3) - moved(-1e-3)) / 2e-3;
                assert!((numeric - analytic).abs() < 1e-7, "{k} {i}: {numeric} {analytic}");
            }
        }
    }
}
