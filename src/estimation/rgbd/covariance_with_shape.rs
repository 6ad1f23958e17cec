//! The covariance of the corners' estimate where color's solve estimated the board's shape too.

use nalgebra::DMatrix;

use crate::estimation::joint::SensorLayout;
use crate::estimation::shape_widening::widening;

/// `covariance`, of all parameters with the board's shape known, widened by the uncertainty of the
/// shape. `by_itself` is the covariance of color's lens that includes this uncertainty. With color
/// alone it is the result. The other sensors see the same board, so with them all variances are
/// multiplied by the mean factor between the two covariances of color's lens.
pub(super) fn covariance_with_shape(
    sensors: &[SensorLayout],
    covariance: DMatrix<f64>,
    by_itself: &DMatrix<f64>,
) -> DMatrix<f64> {
    let [color, others @ ..] = sensors else { return covariance };
    let own = color.lens.reduced(by_itself);
    if others.is_empty() {
        return own;
    }
    let (at, count) = (color.lens_at, color.lens.free.len());
    let known_shape = covariance.view((at, at), (count, count)).into_owned();
    covariance * widening(&own, &known_shape)
}
