//! Whether one camera's list of frames is shifted against another's: as when one of two began to
//! record a frame later. Two cameras that are fixed to each other see each board from the same
//! relative pose; with a shifted list the pose scatters as the board moves, but for one shift.

use crate::estimation::consistent_labels::FrameSetPose;
use crate::geometry::median::median;
use crate::geometry::pose::Pose;

/// The longest shift that is tried, in frame sets.
const LONGEST_SHIFT: isize = 10;
/// Fewer shared frame sets prove nothing: three relative poses may agree by chance.
const LEAST_SHARED_FRAME_SETS: usize = 4;
/// A shift explains a scatter that is this many times its own. Poses of a board are known to a few
/// parts in a thousand of their scatter over views that differ; any factor from 3 to 30 holds.
const LEAST_SCATTER_RATIO: f64 = 10.0;

/// By how many frame sets `other` lags behind `reference`, negative where it leads; `None` where
/// it fits as it is, or no shift fits clearly better.
pub(super) fn list_shift(reference: &[FrameSetPose], other: &[FrameSetPose]) -> Option<isize> {
    let as_it_is = scatter(reference, other, 0)?;
    let shifts = (-LONGEST_SHIFT..=LONGEST_SHIFT).filter(|shift| *shift != 0);
    let scattered = shifts.filter_map(|shift| Some((shift, scatter(reference, other, shift)?)));
    let (shift, least) = scattered.min_by(|a, b| a.1.total_cmp(&b.1))?;
    (least * LEAST_SCATTER_RATIO < as_it_is).then_some(shift)
}

/// The median distance of the relative poses to the one in their middle, in radians and meters
/// together; `None` where too few frame sets are shared.
fn scatter(reference: &[FrameSetPose], other: &[FrameSetPose], shift: isize) -> Option<f64> {
    let shared = other.iter().filter_map(|other| {
        let frame_set = other.frame_set.checked_add_signed(-shift)?;
        let first = reference.iter().find(|first| first.frame_set == frame_set)?;
        Some(other.sensor_from_board * first.sensor_from_board.inverse())
    });
    let other_from_first: Vec<Pose> = shared.collect();
    if other_from_first.len() < LEAST_SHARED_FRAME_SETS {
        return None;
    }
    let median_distance = |a_from_b: &Pose| {
        let distance = |c_from_d: &Pose| {
            a_from_b.angle_to(c_from_d) + (a_from_b.translation() - c_from_d.translation()).norm()
        };
        median(other_from_first.iter().map(distance).collect())
    };
    other_from_first.iter().filter_map(median_distance).min_by(f64::total_cmp)
}

#[cfg(test)]
mod tests {
    use nalgebra::Vector3;

    use super::*;

    fn first_from_board(k: usize) -> Pose {
        let k = k as f64;
        let rotation = Vector3::new((1.7 * k).sin(), (2.3 * k).cos(), 0.1 * k) * 0.4;
        Pose::from_axis_angle(rotation, Vector3::new(0.1 * k.sin(), 0.1 * k.cos(), 0.6))
    }

    #[test]
    fn a_shift_is_found_and_no_shift_is_none() {
        let other_from_first =
            Pose::from_axis_angle(Vector3::y() * 0.2, Vector3::new(-0.1, 0.0, 0.0));
        let seen = |frame_set, sensor_from_board| FrameSetPose { frame_set, sensor_from_board };
        let reference: Vec<_> = (0..20).map(|k| seen(k, first_from_board(k))).collect();
        for shift in [-3_isize, 0, 1, 7] {
            let moved = |k: usize| Some((k, k.checked_add_signed(-shift)?));
            let other: Vec<_> = (0..20)
                .filter_map(moved)
                .map(|(k, at)| seen(k, other_from_first * first_from_board(at)))
                .collect();
            let found = list_shift(&reference, &other);
            assert_eq!(found, (shift != 0).then_some(shift), "{shift}");
        }
        assert_eq!(list_shift(&reference, &reference[..3]), None);
    }
}
