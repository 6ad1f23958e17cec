//! The board's motion from poses in time order, and by how much a second sensor takes its images
//! later than the first.
//!
//! Let u be the board's velocity (angular and linear) in the second sensor's frame when the first
//! takes its image, and T the sensors' relative pose. An image that the second sensor takes δ later
//! then shows the board at T · first_from_board, moved by δ · u. The difference between this pose
//! and the observed one is linear in δ and in the error of T. Velocities are the slopes of cubic
//! splines through the first sensor's poses: they follow motion up to the frame rate, where finite
//! differences of neighbors would flatten it.

use nalgebra::{Matrix3, SMatrix, SVector, Vector3, Vector6};

use crate::estimation::joint::moved;
use crate::geometry::median::median;
use crate::geometry::pose::{Pose, pose_step};

/// The pose of a board at a time.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct TimedPose {
    /// The time, in seconds from an arbitrary origin.
    pub time_s: f64,
    /// The pose.
    pub camera_from_board: Pose,
}

/// How fast a board moves, in a camera's frame.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct BoardMotion {
    /// Its rotation about the camera's axes, in rad/s.
    pub angular_velocity: Vector3<f64>,
    /// The velocity of its origin, in m/s.
    pub velocity: Vector3<f64>,
}

/// By how much a sensor takes its images later than the first.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct TimeOffset {
    /// In seconds.
    pub seconds: f64,
    /// Its standard deviation, in seconds.
    pub std_s: f64,
    /// Standard deviation of a single image's offset, in seconds; includes the effect of errors in
    /// velocity.
    pub jitter_s: f64,
}

/// Poses further separated in time than this many times the median interval belong to different
/// motions.
const GAP_INTERVALS: f64 = 2.5;

/// The longest time between poses that determine a velocity, in seconds.
const LONGEST_S: f64 = 0.5;

/// The board's motion at each of `moments`, whose times rise; `None` at the ends of a motion and
/// where frames are missing.
pub fn board_motions(moments: &[TimedPose]) -> Vec<Option<BoardMotion>> {
    let mut motions = vec![None; moments.len()];
    let gaps = gaps_s(moments);
    let Some(longest_s) = longest_gap_s(&gaps) else { return motions };
    let together = |gap: f64| gap > 0.0 && gap <= longest_s;
    let mut first = 0;
    for end in 1..=moments.len() {
        if end < moments.len() && together(gaps[end - 1]) {
            continue;
        }
        if end - first >= 4 {
            spline_motions(&moments[first..end], &mut motions[first..end]);
        }
        first = end;
    }
    motions
}

/// The times between each of `moments` and the next, in seconds.
fn gaps_s(moments: &[TimedPose]) -> Vec<f64> {
    moments.windows(2).map(|pair| pair[1].time_s - pair[0].time_s).collect()
}

/// The longest interval between two frames of one motion, in seconds, given all `gaps`.
fn longest_gap_s(gaps: &[f64]) -> Option<f64> {
    let median_gap = median(gaps.iter().copied().filter(|gap| *gap > 0.0).collect())?;
    Some((GAP_INTERVALS * median_gap).min(LONGEST_S))
}

/// A board in a frame, and its possible poses shortly after.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct MovingBoard {
    /// Its pose in the frame.
    pub camera_from_board: Pose,
    /// Its pose later, by the mean of `steps`.
    pub camera_from_later: Pose,
    /// Two extrapolations of its motion until then, from the frame before and to the frame after:
    /// each a rotation about the camera's axes in radians, then a translation of its origin in
    /// meters.
    pub steps: [Vector6<f64>; 2],
}

/// The board's possible poses `later_s` seconds after each of `moments`, which are in time order.
/// Where there is no frame before or after in the same motion, a board is assumed to have stood
/// still on that side.
pub fn boards_after(moments: &[TimedPose], later_s: f64) -> Vec<MovingBoard> {
    let gaps = gaps_s(moments);
    let longest_s = longest_gap_s(&gaps).unwrap_or(0.0);
    let step = |pair: &[TimedPose]| {
        let [before, after] = [pair[0].camera_from_board, pair[1].camera_from_board];
        let gap_s = pair[1].time_s - pair[0].time_s;
        let rotation = (after.rotation() * before.rotation().inverse()).scaled_axis();
        let whole = pose_step(&rotation, &(after.translation() - before.translation()));
        let is_one_motion = gap_s > 0.0 && gap_s <= longest_s;
        if is_one_motion { whole * (later_s / gap_s) } else { Vector6::zeros() }
    };
    let steps: Vec<Vector6<f64>> = moments.windows(2).map(step).collect();
    let later = |(index, moment): (usize, &TimedPose)| {
        let camera_from_board = moment.camera_from_board;
        let before = index.checked_sub(1).map_or(Vector6::zeros(), |index| steps[index]);
        let after = steps.get(index).copied().unwrap_or_default();
        MovingBoard {
            camera_from_board,
            camera_from_later: moved(&camera_from_board, ((before + after) / 2.0).as_slice()),
            steps: [before, after],
        }
    };
    moments.iter().enumerate().map(later).collect()
}

/// Rotation matrix and translation as one row of numbers.
fn numbers(a_from_b: &Pose) -> [f64; 12] {
    let (rotation, translation) = (a_from_b.rotation_matrix(), a_from_b.translation());
    std::array::from_fn(|k| if k < 9 { rotation[(k / 3, k % 3)] } else { translation[k - 9] })
}

fn spline_motions(moments: &[TimedPose], motions: &mut [Option<BoardMotion>]) {
    let times_s: Vec<f64> = moments.iter().map(|moment| moment.time_s).collect();
    let rows: Vec<[f64; 12]> =
        moments.iter().map(|moment| numbers(&moment.camera_from_board)).collect();
    let slopes_of = |k: usize| slopes(&times_s, &rows.iter().map(|row| row[k]).collect::<Vec<_>>());
    let slopes: Vec<Vec<f64>> = (0..12).map(slopes_of).collect();
    for index in 1..moments.len() - 1 {
        let by_time = Matrix3::from_fn(|i, j| slopes[3 * i + j][index]);
        let rotation = moments[index].camera_from_board.rotation_matrix();
        // Ṙ Rᵀ is the cross-product matrix of the angular velocity, except for small errors of the
        // spline.
        let spin = by_time * rotation.transpose();
        motions[index] = Some(BoardMotion {
            angular_velocity: Vector3::new(
                spin[(2, 1)] - spin[(1, 2)],
                spin[(0, 2)] - spin[(2, 0)],
                spin[(1, 0)] - spin[(0, 1)],
            ) * 0.5,
            velocity: Vector3::from_fn(|k, _| slopes[9 + k][index]),
        });
    }
}

/// The slopes at the nodes of the natural cubic spline through `values` at increasing `times`.
fn slopes(times: &[f64], values: &[f64]) -> Vec<f64> {
    let count = times.len();
    let step = |k: usize| times[k + 1] - times[k];
    let rise = |k: usize| (values[k + 1] - values[k]) / step(k);
    // Second derivatives by the tridiagonal system: forward elimination, back substitution.
    let (mut factor, mut second) = (vec![0.0; count], vec![0.0; count]);
    for k in 1..count - 1 {
        let pivot = 2.0 * (step(k - 1) + step(k)) - step(k - 1) * factor[k - 1];
        factor[k] = step(k) / pivot;
        second[k] = (6.0 * (rise(k) - rise(k - 1)) - step(k - 1) * second[k - 1]) / pivot;
    }
    for k in (1..count - 1).rev() {
        second[k] -= factor[k] * second[k + 1];
    }
    let slope = |k: usize| match k + 1 < count {
        true => rise(k) - step(k) / 6.0 * (2.0 * second[k] + second[k + 1]),
        false => rise(k - 1) + step(k - 1) / 6.0 * (second[k - 1] + 2.0 * second[k]),
    };
    (0..count).map(slope).collect()
}

/// One frame set in which both sensors saw the board.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SharedFrameSet {
    /// The board's pose by the first sensor.
    pub first_from_board: Pose,
    /// The board's velocity then, in the first sensor's frame.
    pub motion: BoardMotion,
    /// The board's pose by the second sensor.
    pub second_from_board: Pose,
}

/// The center of the board's corners in the board frame, and their extent.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct BoardExtent {
    /// The center, in meters.
    pub center_in_board: Vector3<f64>,
    /// About the board's half width, in meters: the length by which rotations are weighted against
    /// translations.
    pub radius_m: f64,
}

/// Fewer frame sets than this do not determine a time offset.
const LEAST_FRAME_SETS: usize = 8;

/// A frame set is an outlier, with images of different times, if its residual exceeds this many
/// standard deviations, and this many times what the estimated offset explains.
const OUTLIER_LIMITS: [f64; 2] = [6.0, 2.0];

/// The median of χ² with six degrees of freedom.
const MEDIAN_OF_SIX: f64 = 5.348;

/// By how much the second sensor is later, given an approximate pose between the two. `None` for
/// too few frame sets, or a board that never moves.
///
/// Where frames are too far from each other in time to follow the motion, velocities are too high
/// at one frame and too low at the next. These errors cancel in least squares, but not in a robust
/// fit. So all frame sets that are not outliers have the same weight, and the variance is that of
/// the residuals (H. White, *A heteroskedasticity-consistent covariance matrix estimator*, 1980).
pub fn time_offset(
    second_from_first: &Pose,
    moments: &[SharedFrameSet],
    board: BoardExtent,
) -> Option<TimeOffset> {
    let rows: Vec<OffsetRow> =
        moments.iter().map(|seen| OffsetRow::of(second_from_first, seen, board)).collect();
    let mut weights = vec![1.0; rows.len()];
    let mut fit = solve(&rows, &weights)?;
    for _ in 0..20 {
        let lengths: Vec<f64> = rows.iter().map(|row| row.rest(&fit.answer).norm()).collect();
        let middle = median(lengths.clone())?.max(1e-9);
        weights = lengths.iter().map(|length| 1.0 / length.max(0.1 * middle)).collect();
        fit = solve(&rows, &weights)?;
    }
    for _ in 0..3 {
        let lengths: Vec<f64> = rows.iter().map(|row| row.rest(&fit.answer).norm()).collect();
        let std = (median(lengths.iter().map(|length| length * length).collect())? / MEDIAN_OF_SIX)
            .sqrt();
        let median_speed = median(rows.iter().map(|row| row.speed).collect())?;
        let explained = |row: &OffsetRow| fit.answer[6].abs() * (row.speed + median_speed);
        let wrong = |(row, length): (&OffsetRow, &f64)| {
            *length > OUTLIER_LIMITS[0] * std * 6.0_f64.sqrt()
                && *length > OUTLIER_LIMITS[1] * explained(row)
        };
        weights =
            rows.iter().zip(&lengths).map(|pair| if wrong(pair) { 0.0 } else { 1.0 }).collect();
        fit = solve(&rows, &weights)?;
    }
    if weights.iter().filter(|weight| **weight > 0.0).count() < LEAST_FRAME_SETS {
        return None;
    }
    let OffsetFit { answer, inverse } = fit;
    let (mut pulls, mut left, mut moved) = (SMatrix::<f64, 7, 7>::zeros(), 0.0, 0.0);
    for (row, weight) in rows.iter().zip(&weights) {
        let rest = row.rest(&answer) * *weight;
        let pull = row.by.transpose() * rest;
        pulls += pull * pull.transpose();
        left += rest.norm_squared();
        moved += weight * row.speed * row.speed;
    }
    let std_s = (inverse * pulls * inverse)[(6, 6)].max(0.0).sqrt();
    let jitter_s = (left / moved.max(f64::MIN_POSITIVE)).sqrt();
    (answer[6].is_finite() && std_s.is_finite()).then_some(TimeOffset {
        seconds: answer[6],
        std_s,
        jitter_s,
    })
}

/// The difference of the two sensors' board poses in one frame set, in meters (rotations times
/// radius), and its derivatives.
struct OffsetRow {
    difference: SVector<f64, 6>,
    /// By a rotation and a translation of the sensors' relative pose, and by time.
    by: SMatrix<f64, 6, 7>,
    /// The length of its last column, in m/s.
    speed: f64,
}

impl OffsetRow {
    fn of(second_from_first: &Pose, seen: &SharedFrameSet, board: BoardExtent) -> Self {
        let BoardExtent { center_in_board: center, radius_m: radius } = board;
        let expected = *second_from_first * seen.first_from_board;
        let middle = |a_from_b: &Pose| a_from_b.translation() + *a_from_b * center;
        let rotation = (seen.second_from_board.rotation() * expected.rotation().inverse())
            .scaled_axis()
            * radius;
        let translation = middle(&seen.second_from_board) - middle(&expected);
        let lever = middle(&expected) - second_from_first.translation();
        let motion = seen.motion.in_frame(second_from_first).about(&(expected * center));
        let (spin, speed) = (motion.angular_velocity * radius, motion.velocity);
        let mut by = SMatrix::<f64, 6, 7>::zeros();
        by.fixed_view_mut::<3, 3>(0, 0).copy_from(&(Matrix3::identity() * radius));
        by.fixed_view_mut::<3, 3>(3, 0).copy_from(&-lever.cross_matrix());
        by.fixed_view_mut::<3, 3>(3, 3).copy_from(&Matrix3::identity());
        by.fixed_view_mut::<3, 1>(0, 6).copy_from(&spin);
        by.fixed_view_mut::<3, 1>(3, 6).copy_from(&speed);
        let difference = SVector::from_iterator(rotation.iter().chain(translation.iter()).copied());
        Self { difference, by, speed: spin.norm().hypot(speed.norm()) }
    }

    fn rest(&self, answer: &SVector<f64, 7>) -> SVector<f64, 6> {
        self.difference - self.by * answer
    }
}

/// The weighted least-squares solution for `rows`.
struct OffsetFit {
    /// A rotation (radians) and a translation (meters) of the sensors' relative pose, and the time
    /// offset (seconds).
    answer: SVector<f64, 7>,
    /// The inverse of the normal equations.
    inverse: SMatrix<f64, 7, 7>,
}

fn solve(rows: &[OffsetRow], weights: &[f64]) -> Option<OffsetFit> {
    let (mut square, mut right) = (SMatrix::<f64, 7, 7>::zeros(), SVector::<f64, 7>::zeros());
    for (row, weight) in rows.iter().zip(weights) {
        square += row.by.transpose() * row.by * *weight;
        right += row.by.transpose() * row.difference * *weight;
    }
    let inverse = square.cholesky()?.inverse();
    Some(OffsetFit { answer: inverse * right, inverse })
}

impl BoardMotion {
    /// The same motion in another camera's frame.
    pub(crate) fn in_frame(&self, other_from_this: &Pose) -> Self {
        Self {
            angular_velocity: *other_from_this * self.angular_velocity,
            velocity: *other_from_this * self.velocity,
        }
    }

    /// The motion with the velocity of a point that is `lever` away from the origin, in the same
    /// frame.
    pub(crate) fn about(&self, lever: &Vector3<f64>) -> Self {
        Self {
            angular_velocity: self.angular_velocity,
            velocity: self.velocity + self.angular_velocity.cross(lever),
        }
    }

    /// The step (ω, τ) of this motion in `seconds`.
    pub(crate) fn step(&self, seconds: f64) -> [f64; 6] {
        let (rotation, translation) = (self.angular_velocity * seconds, self.velocity * seconds);
        [rotation.x, rotation.y, rotation.z, translation.x, translation.y, translation.z]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A board that is carried from place to place, at `time_s`.
    fn pose(time_s: f64) -> Pose {
        let wave = |frequency: f64, phase: f64| (frequency * time_s + phase).sin();
        Pose::from_axis_angle(
            Vector3::new(0.4 * wave(3.0, 0.2), 0.5 * wave(2.3, 1.0), 0.2 * wave(1.7, 2.0)),
            Vector3::new(0.2 * wave(2.9, 0.0), 0.15 * wave(2.1, 0.7), 0.8 + 0.2 * wave(1.3, 1.5)),
        )
    }

    fn at(time_s: f64) -> TimedPose {
        TimedPose { time_s, camera_from_board: pose(time_s) }
    }

    #[test]
    fn a_board_moves_on_as_far_as_the_frames_follow_it() {
        for fps in [30.0, 5.0] {
            let times: Vec<f64> = (0..40).map(|k| f64::from(k) / fps).collect();
            let moments: Vec<TimedPose> = times.into_iter().map(at).collect();
            let later_s = 0.012;
            let later = boards_after(&moments, later_s);
            let off_m = |at: Vector3<f64>, truth: Vector3<f64>| (at - truth).norm();
            let (mut left, mut open, mut whole) = (0.0, 0.0, 0.0);
            for (moment, board) in moments.iter().zip(&later).skip(1).take(38) {
                let truth = pose(moment.time_s + later_s).translation();
                left += off_m(board.camera_from_later.translation(), truth).powi(2);
                let [before, after] = board.steps;
                open += (after - before).fixed_rows::<3>(3).norm_squared() / 4.0;
                whole += off_m(moment.camera_from_board.translation(), truth).powi(2);
            }
            // At 30 fps a tenth of the motion remains; at 5 fps no more than the two steps differ
            // by.
            assert!(left < if fps > 20.0 { 0.01 * whole } else { whole }, "{fps}: {left} {whole}");
            assert!(left < 1.5 * open, "{fps}: {left} {open}");
        }
        let still = boards_after(&[at(0.0), TimedPose { time_s: 9.0, ..at(1.0) }], 0.012);
        assert_eq!(still[0].camera_from_later, pose(0.0));
        assert_eq!(still[0].steps, [Vector6::zeros(); 2]);
    }

    #[test]
    fn motion_is_the_poses_slope_and_a_gap_ends_it() {
        let times: Vec<f64> =
            (0..40).map(|k| f64::from(k) / 30.0 + if k >= 20 { 2.0 } else { 0.0 }).collect();
        let moments: Vec<TimedPose> = times.into_iter().map(at).collect();
        let motions = board_motions(&moments);
        for (index, TimedPose { time_s, camera_from_board }) in moments.iter().enumerate() {
            let Some(motion) = motions[index] else {
                assert!([0, 19, 20, 39].contains(&index), "{index}");
                continue;
            };
            let later = pose(time_s + 1e-6);
            let rotation =
                (later.rotation() * camera_from_board.rotation().inverse()).scaled_axis() * 1e6;
            let translation = (later.translation() - camera_from_board.translation()) * 1e6;
            let near_end = [1, 18, 21, 38].contains(&index);
            let limit = if near_end { 0.05 } else { 0.01 };
            assert!(
                (motion.angular_velocity - rotation).norm() < limit
                    && (motion.velocity - translation).norm() < limit,
                "{index} {motion:?}"
            );
        }
        assert_eq!(board_motions(&moments[..3]), [None; 3]);
    }

    #[test]
    fn the_time_between_two_sensors_is_found_with_their_pose_off() {
        let truth = Pose::from_axis_angle(
            Vector3::new(0.01, -0.02, 0.005),
            Vector3::new(-0.025, 0.001, 0.002),
        );
        let assumed = Pose::from_axis_angle(
            Vector3::new(0.012, -0.019, 0.005),
            Vector3::new(-0.026, 0.001, 0.003),
        );
        let board = BoardExtent { center_in_board: Vector3::new(0.16, 0.1, 0.0), radius_m: 0.2 };
        let moments: Vec<TimedPose> = (0..60).map(|k| at(f64::from(k) / 15.0)).collect();
        for offset_s in [-0.02, 0.0, 0.012] {
            let both = moments.iter().zip(board_motions(&moments)).enumerate().filter_map(
                |(k, (moment, motion))| {
                    // Every tenth image was taken at another time altogether.
                    let late = if k % 10 == 7 { 0.3 } else { offset_s };
                    Some(SharedFrameSet {
                        first_from_board: moment.camera_from_board,
                        motion: motion?,
                        second_from_board: truth * pose(moment.time_s + late),
                    })
                },
            );
            let found = time_offset(&assumed, &both.collect::<Vec<_>>(), board).unwrap();
            assert!((found.seconds - offset_s).abs() < 3e-4, "{found:?} not {offset_s}");
            assert!(found.std_s < 1e-3, "{found:?}");
        }
        assert_eq!(time_offset(&assumed, &[], board), None);
    }
}
