//! The camera matrix in closed form, from homographies of a flat board.
//!
//! Z. Zhang, *A flexible new technique for camera calibration*, PAMI 22(11), 2000. Each homography
//! H = [h1 h2 h3] that a lens without distortion makes of a plane gives two equations on B = K⁻ᵀK⁻¹
//! (his eq. 8: v12 b = 0, (v11 − v22) b = 0).

use nalgebra::{DMatrix, Matrix3, Vector3};

use crate::estimation::error::EstimationError;
use crate::geometry::camera_matrix::CameraMatrix;
use crate::geometry::homography::Homography;
use crate::geometry::pixel::ImageSize;
use crate::geometry::pose::Pose;

/// Whether the closed form may find skewed pixels.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Skew {
    /// Skew is 0, as for every ordinary sensor: B12 is left out of V b = 0.
    Zero,
    /// Skew is estimated: all six unknowns of V b = 0.
    Free,
}

/// The least ratio of the second smallest to the largest eigenvalue of VᵀV. Below it the views do
/// not determine K: for exactly parallel views it is rounding.
const RANK_TOLERANCE: f64 = 1e-13;

/// K from three or more homographies `pixel_from_board` (Zhang 2000, section 3.1 and appendix B).
///
/// # Errors
/// [`EstimationError::TooFewViews`] below 3; [`EstimationError::ParallelViews`] where the views'
/// planes are parallel, so that V loses rank; [`EstimationError::NoCameraMatrix`] where noise or
/// distortion makes B not positive definite.
pub fn camera_matrix(
    homographies: &[Homography],
    image_size: ImageSize,
    skew: Skew,
) -> Result<CameraMatrix, EstimationError> {
    // In pixels the magnitudes of B's entries differ by up to the fourth power of the image's size;
    // in half diagonals they are similar.
    let (center, unit) = (image_size.center(), image_size.diagonal_px() / 2.0);
    let to_units = Matrix3::new(
        1.0 / unit,
        0.0,
        -center.x / unit,
        0.0,
        1.0 / unit,
        -center.y / unit,
        0.0,
        0.0,
        1.0,
    );
    let balanced = |homography: &Homography| {
        let h = to_units * homography.matrix();
        // The board's scale must not weight the views: columns h1, h2 in units of their mean
        // length.
        h / (h.column(0).norm_squared() + h.column(1).norm_squared()).sqrt()
    };
    let in_units = closed_form(homographies.iter().map(balanced), skew)?;
    Ok(CameraMatrix {
        fx: in_units.fx * unit,
        fy: in_units.fy * unit,
        cx: in_units.cx * unit + center.x,
        cy: in_units.cy * unit + center.y,
        skew: in_units.skew * unit,
    })
}

/// As [`camera_matrix`], with V b = 0 in pixels and homographies of unit norm, as in textbooks.
/// Exact homographies give the same K. Noisy ones give another, in which views and unknowns of
/// large magnitude have more weight.
///
/// # Errors
/// As [`camera_matrix`].
pub fn camera_matrix_in_pixels(
    homographies: &[Homography],
    skew: Skew,
) -> Result<CameraMatrix, EstimationError> {
    closed_form(
        homographies.iter().map(|homography| homography.matrix() / homography.matrix().norm()),
        skew,
    )
}

/// K in the units of the homographies, from V b = 0 with the homographies as scaled.
fn closed_form(
    homographies: impl ExactSizeIterator<Item = Matrix3<f64>>,
    skew: Skew,
) -> Result<CameraMatrix, EstimationError> {
    if homographies.len() < 3 {
        return Err(EstimationError::TooFewViews {
            usable: homographies.len(),
            needed: 3,
            rejected: String::new(),
        });
    }
    let unknowns: &[usize] = match skew {
        Skew::Zero => &[0, 2, 3, 4, 5],
        Skew::Free => &[0, 1, 2, 3, 4, 5],
    };
    let mut normal = DMatrix::<f64>::zeros(unknowns.len(), unknowns.len());
    for h in homographies {
        let difference: Vec<f64> =
            v(&h, 0, 0).iter().zip(v(&h, 1, 1)).map(|(a, b)| a - b).collect();
        for row in [v(&h, 0, 1).as_slice(), &difference] {
            for (i, a) in unknowns.iter().enumerate() {
                for (j, b) in unknowns.iter().enumerate() {
                    normal[(i, j)] += row[*a] * row[*b];
                }
            }
        }
    }
    let eigen = normal.symmetric_eigen();
    let mut order: Vec<usize> = (0..unknowns.len()).collect();
    order.sort_by(|a, b| eigen.eigenvalues[*a].total_cmp(&eigen.eigenvalues[*b]));
    let (second, largest) =
        (eigen.eigenvalues[order[1]], eigen.eigenvalues[order[unknowns.len() - 1]]);
    if !(second > RANK_TOLERANCE * largest) {
        return Err(EstimationError::ParallelViews);
    }
    let mut b = [0.0; 6];
    for (i, index) in unknowns.iter().enumerate() {
        b[*index] = eigen.eigenvectors[(i, order[0])];
    }
    matrix_from_b(b).ok_or(EstimationError::NoCameraMatrix)
}

/// v_ij of Zhang 2000, eq. 7, for columns `i` and `j` of H, against b = [B11, B12, B22, B13, B23,
/// B33].
fn v(h: &Matrix3<f64>, i: usize, j: usize) -> [f64; 6] {
    let (a, b) = (h.column(i), h.column(j));
    [
        a[0] * b[0],
        a[0] * b[1] + a[1] * b[0],
        a[1] * b[1],
        a[2] * b[0] + a[0] * b[2],
        a[2] * b[1] + a[1] * b[2],
        a[2] * b[2],
    ]
}

/// The intrinsic parameters from B (Zhang 2000, appendix B); `None` unless B or −B is positive
/// definite.
fn matrix_from_b([b11, b12, b22, b13, b23, b33]: [f64; 6]) -> Option<CameraMatrix> {
    let minor = b11 * b22 - b12 * b12;
    let cy = (b12 * b13 - b11 * b23) / minor;
    let scale = b33 - (b13 * b13 + cy * (b12 * b13 - b11 * b23)) / b11;
    let fx = (scale / b11).sqrt();
    let fy = (scale * b11 / minor).sqrt();
    let skew = -b12 * fx * fx * fy / scale;
    let cx = skew * cy / fy - b13 * fx * fx / scale;
    let matrix = CameraMatrix { fx, fy, cx, cy, skew };
    let usable =
        [fx, fy, cx, cy, skew].iter().all(|v| v.is_finite()) && fx > 0.0 && fy > 0.0 && minor > 0.0;
    usable.then_some(matrix)
}

/// `camera_from_board` from K⁻¹H = λ [r1 r2 t] (Zhang 2000, section 3.1), the nearest rotation by
/// SVD (appendix C). The board is in front of the camera. `None` where H has no such form at all.
pub fn camera_from_board(matrix: CameraMatrix, pixel_from_board: &Homography) -> Option<Pose> {
    let inverse = matrix.to_matrix().try_inverse()?;
    pose_from_columns(&(inverse * pixel_from_board.matrix()))
}

/// The pose whose [r1 r2 t] is nearest to a multiple of `columns`, in front of the camera.
pub(crate) fn pose_from_columns(columns: &Matrix3<f64>) -> Option<Pose> {
    let lengths = columns.column(0).norm() * columns.column(1).norm();
    let mut scale = 1.0 / lengths.sqrt();
    if columns[(2, 2)] < 0.0 {
        scale = -scale;
    }
    let (r1, r2): (Vector3<f64>, Vector3<f64>) =
        (columns.column(0) * scale, columns.column(1) * scale);
    let translation: Vector3<f64> = columns.column(2) * scale;
    let rotation = nearest_rotation(&Matrix3::from_columns(&[r1, r2, r1.cross(&r2)]))?;
    translation.iter().all(|v| v.is_finite()).then(|| Pose::from_matrix(&rotation, translation))
}

/// The rotation nearest to `matrix` in the Frobenius norm.
pub(crate) fn nearest_rotation(matrix: &Matrix3<f64>) -> Option<Matrix3<f64>> {
    if !matrix.iter().all(|v| v.is_finite()) {
        return None;
    }
    let svd = matrix.svd(true, true);
    let (mut u, v_t) = (svd.u?, svd.v_t?);
    if (u * v_t).determinant() < 0.0 {
        u.column_mut(2).neg_mut();
    }
    let rotation = u * v_t;
    rotation.iter().all(|v| v.is_finite()).then_some(rotation)
}

#[cfg(test)]
mod tests {
    use nalgebra::Vector3;

    use super::*;

    const SIZE: ImageSize = ImageSize::new(640, 480);

    fn homography(matrix: CameraMatrix, camera_from_board: &Pose) -> Homography {
        let r = camera_from_board.rotation_matrix();
        let columns = Matrix3::from_columns(&[
            r.column(0).into(),
            r.column(1).into(),
            camera_from_board.translation(),
        ]);
        Homography::from_matrix(&(matrix.to_matrix() * columns)).unwrap()
    }

    fn poses() -> Vec<Pose> {
        [[0.4, 0.1, 0.2], [-0.3, 0.5, 0.1], [0.1, -0.6, -0.4], [0.5, 0.5, 1.0]]
            .iter()
            .map(|r| {
                Pose::from_axis_angle(Vector3::from(*r), Vector3::new(0.1 * r[1], -0.1 * r[0], 0.6))
            })
            .collect()
    }

    #[test]
    fn closed_form_is_exact_with_and_without_skew() {
        for (true_skew, skew) in [(0.0, Skew::Zero), (0.0, Skew::Free), (1.7, Skew::Free)] {
            let truth =
                CameraMatrix { fx: 530.0, fy: 541.0, cx: 301.0, cy: 255.0, skew: true_skew };
            let homographies: Vec<_> = poses().iter().map(|pose| homography(truth, pose)).collect();
            let found = camera_matrix(&homographies, SIZE, skew).unwrap();
            assert!((found.to_matrix() - truth.to_matrix()).norm() < 1e-7, "{found:?}");
            for (pose, h) in poses().iter().zip(&homographies) {
                let camera_from_board = camera_from_board(found, h).unwrap();
                assert!(camera_from_board.angle_to(pose) < 1e-9);
                assert!((camera_from_board.translation() - pose.translation()).norm() < 1e-9);
            }
        }
    }

    #[test]
    fn parallel_and_too_few_views_are_refused() {
        let truth = CameraMatrix { fx: 530.0, fy: 541.0, cx: 301.0, cy: 255.0, skew: 0.0 };
        let parallel: Vec<_> = (0..5)
            .map(|k| {
                Pose::from_axis_angle(
                    Vector3::zeros(),
                    Vector3::new(0.1, 0.05 * f64::from(k), 0.5 + 0.1 * f64::from(k)),
                )
            })
            .map(|pose| homography(truth, &pose))
            .collect();
        assert_eq!(camera_matrix(&parallel, SIZE, Skew::Zero), Err(EstimationError::ParallelViews));
        let two: Vec<_> = poses()[..2].iter().map(|pose| homography(truth, pose)).collect();
        assert!(matches!(
            camera_matrix(&two, SIZE, Skew::Zero),
            Err(EstimationError::TooFewViews { usable: 2, .. })
        ));
    }
}
