//! The median of numbers and of poses, on which a minority of outliers has little effect.

use crate::geometry::pose::Pose;

/// The median absolute value of normally distributed numbers of mean 0, in their standard
/// deviations: the standard normal quantile of 3/4.
pub const NORMAL_MEDIAN: f64 = 0.6745;

/// The standard deviation of normally distributed numbers over the median of their absolute
/// deviations: 1 over the same quantile, which is 0.67449.
pub const STD_PER_MAD: f64 = 1.4826;

/// The upper median in the total order of floating-point numbers; `None` of none.
pub fn median(mut values: Vec<f64>) -> Option<f64> {
    median_of(&mut values)
}

/// The same, for numbers that may be reordered.
pub fn median_of(values: &mut [f64]) -> Option<f64> {
    let middle = values.len() / 2;
    (middle < values.len()).then(|| *values.select_nth_unstable_by(middle, f64::total_cmp).1)
}

/// The pose with the least median distance to all of these (radians plus meters); `None` of none.
pub fn median_pose(a_from_b: &[Pose]) -> Option<Pose> {
    let median_distance = |a_from_candidate: &Pose| {
        let distance = |other: &Pose| {
            let translation_m = (other.translation() - a_from_candidate.translation()).norm();
            other.angle_to(a_from_candidate) + translation_m
        };
        median(a_from_b.iter().map(distance).collect()).unwrap_or(f64::INFINITY)
    };
    let each = a_from_b.iter().map(|one| (median_distance(one), one));
    each.min_by(|a, b| a.0.total_cmp(&b.0)).map(|(_, pose)| *pose)
}

#[cfg(test)]
mod tests {
    use nalgebra::Vector3;

    use super::*;

    #[test]
    fn the_upper_one_of_two_middles() {
        assert_eq!(median(Vec::new()), None);
        assert_eq!(median(vec![3.0]), Some(3.0));
        assert_eq!(median(vec![4.0, 1.0]), Some(4.0));
        assert_eq!(median(vec![5.0, -1.0, 2.0]), Some(2.0));
        assert_eq!(median(vec![f64::INFINITY, 2.0, 1.0, f64::NAN]), Some(f64::INFINITY));
    }

    #[test]
    fn less_than_half_of_wrong_poses_do_not_move_it() {
        let pose = |x: f64| Pose::from_axis_angle(Vector3::x() * x, Vector3::new(x, 0.0, 1.0));
        let poses = [5.0, 0.01, 0.0, -3.0, 0.02].map(pose);
        assert_eq!(median_pose(&poses), Some(pose(0.01)));
        assert_eq!(median_pose(&[]), None);
    }
}
