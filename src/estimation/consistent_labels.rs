//! Consistent labels of a symmetric board, which each view may label from either end: the first
//! corner of one camera may be the last of another. Since the cameras are fixed to each other,
//! their relative poses determine which views have to be relabeled.

use crate::geometry::median::median;
use crate::geometry::pose::Pose;

/// The pose of the board that a sensor found by itself in one frame set.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct FrameSetPose {
    /// The frame set, counted from 0.
    pub frame_set: usize,
    /// The board's pose with this sensor's labels.
    pub sensor_from_board: Pose,
}

/// For each view of each sensor, the index into `board_from_labels` of the symmetry to apply:
/// `sensor_from_board · board_from_labels` is the board's pose with corners labeled as by the
/// sensor that was placed first. `board_from_labels` are the rotations that map the board's pattern
/// to itself, including the identity. Sensors are placed one after the other, those with the most
/// frame sets in common first. A view whose frame set no other sensor has keeps its labels.
pub fn consistent_labels(
    sensors: &[Vec<FrameSetPose>],
    board_from_labels: &[Pose],
) -> Vec<Vec<usize>> {
    let frame_sets = sensors.iter().flatten().map(|own| own.frame_set + 1).max().unwrap_or(0);
    let mut chosen: Vec<Vec<usize>> = sensors.iter().map(|views| vec![0; views.len()]).collect();
    let mut reference_from_board: Vec<Option<Pose>> = vec![None; frame_sets];
    let mut left: Vec<usize> = (0..sensors.len()).collect();
    while !left.is_empty() {
        let shared = |sensor: &usize| {
            sensors[*sensor]
                .iter()
                .filter(|own| reference_from_board[own.frame_set].is_some())
                .count()
        };
        // The first of those with the most in common.
        let next = left
            .iter()
            .enumerate()
            .rev()
            .max_by_key(|(_, sensor)| shared(sensor))
            .map_or(0, |(at, _)| at);
        let sensor = left.remove(next);
        let sensor_from_reference =
            agreed(&sensors[sensor], &reference_from_board, board_from_labels);
        for (view, own) in sensors[sensor].iter().enumerate() {
            let FrameSetPose { frame_set, sensor_from_board } = *own;
            let Some(sensor_from_reference) = sensor_from_reference else {
                reference_from_board[frame_set].get_or_insert(sensor_from_board);
                continue;
            };
            if let Some(known) = reference_from_board[frame_set] {
                chosen[sensor][view] = nearest_symmetry(
                    &sensor_from_board,
                    &(sensor_from_reference * known),
                    board_from_labels,
                )
                .symmetry;
            } else {
                reference_from_board[frame_set] =
                    Some(sensor_from_reference.inverse() * sensor_from_board);
            }
        }
    }
    chosen
}

/// The relative pose with the least median distance over the shared frame sets, each under its
/// nearest symmetry; `None` for a sensor that shares none.
fn agreed(
    views: &[FrameSetPose],
    reference_from_board: &[Option<Pose>],
    board_from_labels: &[Pose],
) -> Option<Pose> {
    let shared: Vec<(Pose, Pose)> = views
        .iter()
        .filter_map(|own| Some((own.sensor_from_board, reference_from_board[own.frame_set]?)))
        .collect();
    let candidates = shared.iter().flat_map(|(pose, reference)| {
        board_from_labels.iter().map(move |symmetry| *pose * *symmetry * reference.inverse())
    });
    let scatter = |sensor_from_reference: &Pose| {
        let distances = shared.iter().map(|(pose, reference)| {
            let expected_from_board = *sensor_from_reference * *reference;
            nearest_symmetry(pose, &expected_from_board, board_from_labels).distance
        });
        median(distances.collect()).unwrap_or(f64::INFINITY)
    };
    candidates
        .map(|candidate| (scatter(&candidate), candidate))
        .min_by(|a, b| a.0.total_cmp(&b.0))
        .map(|(_, pose)| pose)
}

/// The symmetry under which a pose is nearest to the expected one.
#[derive(Debug, Clone, Copy)]
pub(crate) struct NearestLabels {
    /// The index of the symmetry.
    pub(crate) symmetry: usize,
    /// The distance from the expected pose, in radians plus meters.
    distance: f64,
}

/// The symmetry under which `sensor_from_board` is nearest to the expected pose.
pub(crate) fn nearest_symmetry(
    sensor_from_board: &Pose,
    expected_from_board: &Pose,
    board_from_labels: &[Pose],
) -> NearestLabels {
    let distance = |board_from_labels: &Pose| {
        let relabeled = *sensor_from_board * *board_from_labels;
        relabeled.angle_to(expected_from_board)
            + (relabeled.translation() - expected_from_board.translation()).norm()
    };
    let all = board_from_labels.iter().map(distance).enumerate();
    let nearest = all
        .map(|(symmetry, distance)| NearestLabels { symmetry, distance })
        .min_by(|a, b| a.distance.total_cmp(&b.distance));
    nearest.unwrap_or(NearestLabels { symmetry: 0, distance: f64::INFINITY })
}

#[cfg(test)]
mod tests {
    use std::f64::consts::PI;

    use nalgebra::Vector3;
    use rand::{RngExt, SeedableRng};

    use super::*;

    #[test]
    fn views_labeled_by_chance_agree() {
        let half = Pose::from_axis_angle(Vector3::z() * PI, Vector3::new(0.16, 0.16, 0.0));
        let quarter =
            Pose::from_axis_angle(Vector3::z() * (PI / 2.0), Vector3::new(0.16, 0.0, 0.0));
        let symmetries = [Pose::identity(), quarter, half, half * quarter];
        let mut rng = rand_chacha::ChaCha8Rng::seed_from_u64(5);
        let sensor_from_rig = [
            Pose::identity(),
            Pose::from_axis_angle(Vector3::new(0.1, -0.3, 0.02), Vector3::new(-0.2, 0.01, 0.03)),
            Pose::from_axis_angle(Vector3::new(-0.2, 0.5, 1.2), Vector3::new(0.4, 0.1, 0.0)),
        ];
        let rig_from_board: Vec<Pose> = (0..12)
            .map(|_| {
                let mut random = || Vector3::from_fn(|_, _| rng.random_range(-0.5..0.5));
                Pose::from_axis_angle(random(), random() * 0.4 + Vector3::z())
            })
            .collect();
        let mut applied = Vec::new();
        let mut seen = |sensor: usize, frame_sets: std::ops::Range<usize>| -> Vec<FrameSetPose> {
            let view = |frame_set: usize| {
                let symmetry = rng.random_range(0..symmetries.len());
                applied.push((sensor, frame_set, symmetry));
                let rig_from_labels = rig_from_board[frame_set] * symmetries[symmetry];
                let sensor_from_board = sensor_from_rig[sensor] * rig_from_labels;
                FrameSetPose { frame_set, sensor_from_board }
            };
            frame_sets.map(view).collect()
        };
        // The last shares frame sets with the second only.
        let sensors = [seen(0, 0..7), seen(1, 2..12), seen(2, 7..12)];
        let chosen = consistent_labels(&sensors, &symmetries);
        for frame_set in 0..12 {
            let views = sensors.iter().zip(&chosen).zip(&sensor_from_rig).filter_map(
                |((views, chosen), from_rig)| {
                    let at = views.iter().position(|own| own.frame_set == frame_set)?;
                    let sensor_from_board = views[at].sensor_from_board;
                    Some(from_rig.inverse() * sensor_from_board * symmetries[chosen[at]])
                },
            );
            let first_from_board: Vec<Pose> = views.collect();
            for other in &first_from_board[1..] {
                assert!(first_from_board[0].angle_to(other) < 1e-9, "frame set {frame_set}");
            }
        }
        assert!(applied.iter().any(|(_, _, symmetry)| *symmetry > 0), "the test relabels some");
    }

    #[test]
    fn a_board_without_a_twin_keeps_its_labels() {
        let sensor_from_board = Pose::from_axis_angle(Vector3::x(), Vector3::z());
        let seen = |frame_set| FrameSetPose { frame_set, sensor_from_board };
        let sensors = [vec![seen(0)], vec![seen(0), seen(4)], vec![]];
        assert_eq!(consistent_labels(&sensors, &[Pose::identity()]), [vec![0], vec![0, 0], vec![]]);
    }
}
