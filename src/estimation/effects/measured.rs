//! The board's shape and the rolling shutter as a solve found them, in meters, for people and for
//! the next solve.

use nalgebra::{DMatrix, DVector, Point3, Vector3};

use crate::estimation::effects::effects_fit::EffectsFit;
use crate::estimation::measured_board::{MeasuredBoard, RollingShutter, bow_m};
use crate::estimation::view_motion::ViewMotion;
use crate::geometry::pose::Pose;

impl MeasuredBoard {
    /// `None` where the board's shape is not in the model; `center` is that of the problem's
    /// points.
    pub(crate) fn of(effects: &EffectsFit, center: Vector3<f64>) -> Option<Self> {
        if !effects.variances.shapes() {
            return None;
        }
        let basis = &effects.basis;
        let coefficients = &effects.state.shape;
        let offsets = basis.offsets(coefficients);
        let rigid = rigid_and_scale(&basis.points);
        let std_m = standard_deviations(effects, &rigid);
        let count = offsets.len() as f64;
        let mean_square = offsets.iter().map(Vector3::norm_squared).sum::<f64>() / count;
        let unevenness_m = mean_square.sqrt();
        // Errors of neighboring points are correlated, hence the covariance of the coefficients: d
        // rms = oᵀ B dc / (n rms). The offsets contain no rigid motion any more.
        let pull = DVector::from_vec(basis.projections(&offsets));
        let variance = pull.dot(&(&effects.shape_covariance * &pull)).max(0.0);
        let bow_m = bow_m(&basis.points, &offsets);
        Some(Self {
            points: basis.points.iter().map(|point| point + center).collect(),
            unevenness_std_m: variance.sqrt() / (count * unevenness_m).max(f64::MIN_POSITIVE),
            offsets_m: offsets,
            std_m,
            unevenness_m,
            bow_m,
        })
    }
}

impl RollingShutter {
    /// `None` where motion is not in the model.
    pub(crate) fn of(effects: &EffectsFit, good: &[usize]) -> Option<Self> {
        if !effects.variances.moves() || good.is_empty() {
            return None;
        }
        let rms = |from: usize| {
            let square =
                |view: &usize| effects.state.motions[*view].fixed_rows::<3>(from).norm_squared();
            (good.iter().map(square).sum::<f64>() / good.len() as f64).sqrt()
        };
        Some(Self {
            translation_m: rms(3),
            rotation_rad: rms(0) / effects.basis.lever(),
            agreement: effects.shutter_agreement,
        })
    }
}

impl ViewMotion {
    /// The motion of the board in one observation at one frame set, with the board at
    /// `camera_from_board`. Pose and motion are relative to `center`, the center of the problem's
    /// points. `None` without motion.
    pub(crate) fn of(
        effects: &EffectsFit,
        place: (usize, usize),
        camera_from_board: &Pose,
        center: &Vector3<f64>,
    ) -> Option<Self> {
        let [rotation, translation] = effects.state.motion_in_board(&effects.basis, place)?;
        Some(Self {
            rotation_rad: camera_from_board.rotation() * rotation,
            translation_m: camera_from_board.rotation() * translation,
            center_m: Point3::from(*center),
        })
    }
}

/// Orthonormal columns over (x, y) of all points: two translations, a rotation, a scale.
fn rigid_and_scale(points: &[Point3<f64>]) -> DMatrix<f64> {
    let mean = points.iter().map(|p| p.coords).sum::<Vector3<f64>>() / points.len() as f64;
    let mut columns = DMatrix::zeros(2 * points.len(), 4);
    for (k, point) in points.iter().enumerate() {
        let p = point.coords - mean;
        let rows = [[1.0, 0.0, -p.y, p.x], [0.0, 1.0, p.x, p.y]];
        for (axis, row) in rows.iter().enumerate() {
            (0..4).for_each(|c| columns[(2 * k + axis, c)] = row[c]);
        }
    }
    for mut column in columns.column_iter_mut() {
        let norm = column.norm();
        column /= norm.max(f64::MIN_POSITIVE);
    }
    columns
}

/// Per point and axis. In the plane, rigid motion and scale are projected out.
fn standard_deviations(effects: &EffectsFit, rigid: &DMatrix<f64>) -> Vec<Vector3<f64>> {
    let (basis, covariance) = (&effects.basis, &effects.shape_covariance);
    let (heights, count) = (basis.heights.len(), basis.points.len());
    let planar = planar_variances(effects, rigid);
    let out_of_plane = covariance.view((0, 0), (heights, heights));
    let values = DMatrix::from_fn(count, heights, |point, k| basis.heights[k].1[point]);
    let height = &values * out_of_plane;
    (0..count)
        .map(|point| {
            let z = height.row(point).dot(&values.row(point));
            let variances = Vector3::new(planar[2 * point], planar[2 * point + 1], z);
            variances.map(|variance| variance.max(0.0).sqrt())
        })
        .collect()
}

/// Variances of x and y of each point. The dense covariance of all points is computed only where
/// each has its own offset, and then they are few.
fn planar_variances(effects: &EffectsFit, rigid: &DMatrix<f64>) -> Vec<f64> {
    let (basis, covariance) = (&effects.basis, &effects.shape_covariance);
    let (heights, smooth) = (basis.heights.len(), basis.smooth_len());
    let size = 2 * basis.points.len();
    let stretches = DMatrix::from_fn(size, smooth - heights, |row, column| {
        basis.stretches[column][row / 2][row % 2]
    });
    let common = covariance.view((heights, heights), (smooth - heights, smooth - heights));
    if !basis.has_point_offsets {
        let rest = &stretches - rigid * (rigid.transpose() * &stretches);
        let carried = &rest * common;
        return (0..size).map(|k| carried.row(k).dot(&rest.row(k))).collect();
    }
    let cross = covariance.view((smooth, heights), (size, smooth - heights));
    let crossed = cross * stretches.transpose();
    let mut in_plane = covariance.view((smooth, smooth), (size, size)).into_owned();
    in_plane += &stretches * common * stretches.transpose() + &crossed + crossed.transpose();
    let carried = rigid.transpose() * &in_plane;
    let inner = &carried * rigid;
    let variance = |k: usize| {
        let row = rigid.row(k);
        let removed = 2.0 * (row * carried.column(k))[0];
        in_plane[(k, k)] - removed + (row * &inner * row.transpose())[0]
    };
    (0..size).map(variance).collect()
}
