//! Which coefficients of a lens its views determine only together: they trade against each other,
//! so that projections are known while each number by itself is not.

use nalgebra::Point3;

use crate::geometry::lens::Lens;
use crate::geometry::pixel::{ImageSize, Pixel};

/// The parameters before a lens's coefficients: fx, fy, cx, cy, skew.
const MATRIX: usize = 5;

/// The names of the coefficients whose standard deviations, each by itself, move some corner of the
/// image farther than all of the lens's distortion does: by itself such a coefficient says nothing
/// of the lens. `lens_std` is in the order of [`Lens::parameter_names`]. Corners 90 degrees and more
/// off the axis, where no lens without distortion sees, are left out.
///
/// ```
/// use plumb::estimation::known_together::known_only_together;
/// use plumb::geometry::lens::{Lens, LensModel};
/// use plumb::geometry::pixel::ImageSize;
///
/// let brown = [700.0, 700.0, 320.0, 240.0, 0.0, -0.3, 0.1, 0.0, 0.0, 0.0];
/// let lens = Lens::from_parameters(LensModel::Brown, &brown).expect("ten parameters");
/// let std = [1.0, 1.0, 1.0, 1.0, 0.0, 0.01, 20.0, 1e-4, 1e-4, 60.0];
/// assert_eq!(known_only_together(&lens, &std, ImageSize::new(640, 480)), ["k2", "k3"]);
/// ```
pub fn known_only_together(lens: &Lens, lens_std: &[f64], size: ImageSize) -> Vec<&'static str> {
    let (right, bottom) = (f64::from(size.width) - 1.0, f64::from(size.height) - 1.0);
    let corners = [(0.0, 0.0), (right, 0.0), (0.0, bottom), (right, bottom)];
    let mut names = Lens::parameter_names(lens.model());
    let mut unknown = vec![false; names.len()];
    for (x, y) in corners {
        let seen = lens.bearing_from_pixel(Pixel::new(x, y));
        let Some(point) = seen.map(|bearing| Point3::from(bearing.into_inner())) else { continue };
        let undistorted = Lens::pinhole(lens.matrix).pixel_from_point(&point);
        let (Some(undistorted), Some(projection)) = (undistorted, lens.project(&point)) else {
            continue;
        };
        let distortion_px = projection.pixel.distance_px(undistorted);
        for (index, std) in lens_std.iter().enumerate().take(names.len()).skip(MATRIX) {
            let moved_px = projection.by_parameters.column(index).norm() * std;
            unknown[index] |= moved_px > distortion_px;
        }
    }
    let mut unknown = unknown.into_iter();
    names.retain(|_| unknown.next() == Some(true));
    names
}
