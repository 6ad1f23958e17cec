//! How the uncertainty of a board's shape widens the covariance of a solve that took the shape as
//! known.

use nalgebra::DMatrix;

/// The factor on the variances of a lens if the board's shape is estimated too (`with_shape`),
/// relative to a board of known shape (`known_shape`), as the mean over the estimated parameters:
/// tr(Σ Σ₀⁻¹) / n, which is independent of the parameters' scales; at least 1.
pub(crate) fn widening(with_shape: &DMatrix<f64>, known_shape: &DMatrix<f64>) -> f64 {
    let estimated: Vec<usize> =
        (0..known_shape.nrows()).filter(|k| known_shape[(*k, *k)] > 0.0).collect();
    let size = estimated.len();
    // In units of the parameters' own standard deviations, which differ by orders of magnitude.
    let of = |covariance: &DMatrix<f64>| {
        DMatrix::from_fn(size, size, |i, j| {
            let [a, b] = [estimated[i], estimated[j]];
            covariance[(a, b)] / (known_shape[(a, a)] * known_shape[(b, b)]).sqrt()
        })
    };
    let factor = of(known_shape).cholesky().map(|factor| factor.solve(&of(with_shape)).trace());
    factor.filter(|sum| sum.is_finite()).map_or(1.0, |sum| sum / size.max(1) as f64).max(1.0)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn it_is_the_mean_factor_of_what_is_estimated() {
        let known = DMatrix::from_row_slice(3, 3, &[4.0, 0.1, 0.0, 0.1, 1e-6, 0.0, 0.0, 0.0, 0.0]);
        let known = known.map_with_location(|i, j, v| if i == j { v } else { v * 1e-3 });
        assert!((widening(&known, &known) - 1.0).abs() < 1e-12);
        assert!((widening(&(&known * 3.0), &known) - 3.0).abs() < 1e-12);
        assert_eq!(widening(&(&known * 0.5), &known), 1.0, "nothing is known better for it");
    }
}
