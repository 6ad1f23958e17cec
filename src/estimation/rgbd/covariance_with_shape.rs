//! The covariance of what corners say, on a board whose shape color measured.

use nalgebra::DMatrix;

use crate::estimation::joint::SensorLayout;
use crate::estimation::shape_widening::widening;

/// `covariance`, of all parameters on a board of known shape, widened by what is not known of the
/// shape: of color's lens it is `by_itself`, which counts that. The other sensors see the same
/// board, and their variances are wider by the mean factor of color's.
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
