//! Tests of the information from two cameras: compared with numeric derivatives and with the
//! scatter of solves of simulated rigs; and of suggested views that both cameras see, with known
//! ground truth.

use nalgebra::{DMatrix, DVector, Point3, UnitQuaternion, Vector3, Vector6};

use crate::calibration::information::candidate_views::{
    BoardPoints, CandidateSpace, PlacementInImage,
};
use crate::calibration::information::corner_noise::CornerNoise;
use crate::calibration::information::information_tests::{SIZE, board, fisheye, lens, noise};
use crate::calibration::information::lens_information::LensInformation;
use crate::calibration::information::next_shared_view::suggest_shared_view;
use crate::calibration::information::pair_information::{PairInformation, stepped};
use crate::calibration::information::projection_goal::GoalFigure;
use crate::calibration::information::transfer_goal::TransferGoal;
use crate::calibration::information::view_information::{ViewNormal, WeightedCorner};
use crate::estimation::camera::CameraOptions;
use crate::estimation::problem::{BoardView, Correspondence, LensChoice};
use crate::estimation::rig::{FrameSetView, RigEstimate, RigProblem, RigSensor, calibrate_rig};
use crate::estimation::scaled_factor::scaled_inverse;
use crate::estimation::uncertainty::PixelGrid;
use crate::geometry::lens::Lens;
use crate::geometry::pixel::Pixel;
use crate::geometry::pose::Pose;

const NOISE_PX: f64 = 0.1;

fn b_from_a() -> Pose {
    Pose::from_axis_angle(Vector3::new(0.02, -0.11, 0.015), Vector3::new(-0.12, 0.01, 0.008))
}

fn corners() -> Vec<WeightedCorner> {
    let corner = |point_in_board| WeightedCorner { point_in_board, std_px: NOISE_PX };
    board().corners_in_board().into_iter().map(corner).collect()
}

fn space<'a>(lens: &'a Lens, board: &'a BoardPoints, noise: &'a CornerNoise) -> CandidateSpace<'a> {
    CandidateSpace {
        lens,
        size: SIZE,
        board,
        noise,
        base: UnitQuaternion::identity(),
        avoided: &[],
    }
}

/// Poses of the board in which both cameras see all of it.
fn shared_poses(lenses: [&Lens; 2], indices: impl Iterator<Item = usize>) -> Vec<Pose> {
    let (board, noise) = (BoardPoints::of_chessboard(&board()), CornerNoise::default());
    let spaces = lenses.map(|lens| space(lens, &board, &noise));
    let view = |index| {
        let placement = PlacementInImage::of_sequence(index);
        let own = spaces[0].view(&placement)?;
        spaces[1].view_at(&placement, b_from_a() * own.camera_from_board)?;
        Some(own.camera_from_board)
    };
    indices.filter_map(view).collect()
}

fn nothing_known(lenses: [&Lens; 2]) -> PairInformation {
    let priors = lenses.map(|lens| LensInformation::prior(*lens, SIZE));
    PairInformation::of_lenses([&priors[0], &priors[1]], b_from_a())
}

fn normals(lenses: [&Lens; 2], a_from_board: &Pose) -> [ViewNormal; 2] {
    [
        ViewNormal::of(lenses[0], a_from_board, &corners()),
        ViewNormal::of(lenses[1], &(b_from_a() * *a_from_board), &corners()),
    ]
}

/// Both lenses and the relative pose after a step of the pair's parameters.
fn moved(known: &PairInformation, lenses: [&Lens; 2], step: &[f64]) -> ([Lens; 2], Pose) {
    let (of_a, rest) = step.split_at(known.free[0].len());
    let (of_b, of_pose) = rest.split_at(known.free[1].len());
    let steps = [of_a, of_b];
    let lenses = [0, 1].map(|k| {
        let mut parameters = lenses[k].parameters();
        known.free[k].iter().zip(steps[k]).for_each(|(index, step)| parameters[*index] += step);
        Lens::from_parameters(lenses[k].model(), &parameters).unwrap()
    });
    let vector = |at: usize| Vector3::new(of_pose[at], of_pose[at + 1], of_pose[at + 2]);
    (lenses, stepped(&known.b_from_a, [vector(0), vector(3)]))
}

/// Central differences of a function of `count` numbers, column by column.
fn numeric(count: usize, function: impl Fn(&[f64]) -> Vec<f64>) -> DMatrix<f64> {
    let column = |k: usize| {
        let at = |step: f64| {
            let mut steps = vec![0.0; count];
            steps[k] = step;
            DVector::from_vec(function(&steps))
        };
        (at(1e-5) - at(-1e-5)) / 2e-5
    };
    DMatrix::from_columns(&(0..count).map(column).collect::<Vec<_>>())
}

#[test]
fn what_a_shared_view_says_is_that_of_numeric_derivatives() {
    for (a, b) in [(lens(), fisheye()), (fisheye(), lens()), (lens(), lens())] {
        let (lenses, known) = ([&a, &b], nothing_known([&a, &b]));
        let count = known.matrix.nrows();
        for a_from_board in shared_poses(lenses, 0..300).iter().take(4) {
            let seen = |steps: &[f64]| {
                let (lenses, b_from_a) = moved(&known, lenses, &steps[..count]);
                let of_board = &steps[count..];
                let step = |at| Vector3::new(of_board[at], of_board[at + 1], of_board[at + 2]);
                let a_from_board = stepped(a_from_board, [step(0), step(3)]);
                let pixels = |k: usize, camera_from_board: Pose| {
                    let lens = lenses[k];
                    corners().into_iter().flat_map(move |corner| {
                        let pixel = lens
                            .pixel_from_point(&(camera_from_board * corner.point_in_board))
                            .unwrap();
                        [pixel.x / NOISE_PX, pixel.y / NOISE_PX]
                    })
                };
                pixels(0, a_from_board).chain(pixels(1, b_from_a * a_from_board)).collect()
            };
            let jacobian = numeric(count + 6, seen);
            let normal = jacobian.transpose() * &jacobian;
            let coupling = normal.view((0, count), (count, 6));
            let of_board = normal.view((count, count), (6, 6)).into_owned();
            let expected = normal.view((0, 0), (count, count))
                - coupling * of_board.try_inverse().unwrap() * coupling.transpose();
            let [own, other] = normals(lenses, a_from_board);
            let information = known.of_view([&own, &other]).unwrap();
            // Relative to the uncertainty of a parameter if the others were given.
            for (i, j) in (0..count).flat_map(|i| (0..count).map(move |j| (i, j))) {
                let scale = (normal[(i, i)] * normal[(j, j)]).sqrt();
                let difference = (information[(i, j)] - expected[(i, j)]).abs() / scale;
                assert!(difference < 1e-5, "{i}, {j}: {difference}");
            }
        }
    }
}

#[test]
fn one_shared_view_says_of_the_lenses_what_two_separate_ones_say() {
    let (a, b) = (lens(), fisheye());
    let known = nothing_known([&a, &b]);
    let pose = shared_poses([&a, &b], 3..20)[0];
    let [own, other] = normals([&a, &b], &pose);
    let joint = known.of_view([&own, &other]).unwrap();
    let lenses = joint.nrows() - 6;
    let coupling = joint.view((0, lenses), (lenses, 6));
    let of_place = joint.view((lenses, lenses), (6, 6)).into_owned();
    let rest = joint.view((0, 0), (lenses, lenses))
        - coupling * of_place.try_inverse().unwrap() * coupling.transpose();
    for (camera, normal) in [own, other].iter().enumerate() {
        let alone = normal.lens_information(&known.free[camera]).unwrap();
        let at = camera * known.free[0].len();
        let shape = (alone.nrows(), alone.nrows());
        for (i, j) in (0..shape.0).flat_map(|i| (0..shape.1).map(move |j| (i, j))) {
            let scale = (joint[(at + i, at + i)] * joint[(at + j, at + j)]).sqrt();
            let difference = (rest[(at + i, at + j)] - alone[(i, j)]).abs() / scale;
            assert!(difference < 1e-6, "camera {camera}, {i}, {j}: {difference}");
        }
    }
}

/// The pixel of b that sees the point which a sees at `pixel` and at a distance.
fn transferred(
    [a, b]: [&Lens; 2],
    b_from_a: &Pose,
    pixel: Pixel,
    distance_m: f64,
) -> Option<Pixel> {
    let bearing = a.bearing_from_pixel(pixel)?.into_inner();
    b.pixel_from_point(&(*b_from_a * Point3::from(bearing * distance_m)))
}

#[test]
fn transfers_have_the_uncertainty_of_numeric_derivatives() {
    // The second camera sees much of what the first one sees.
    for (a, b) in [(lens(), fisheye()), (lens(), lens())] {
        let mut known = nothing_known([&a, &b]);
        for pose in shared_poses([&a, &b], 0..300) {
            let [own, other] = normals([&a, &b], &pose);
            let view = known.of_view([&own, &other]).unwrap();
            known.matrix += view;
        }
        let goal =
            TransferGoal::new(&known, [(&a, SIZE), (&b, SIZE)], 0.6, GoalFigure::Median).unwrap();
        let covariance = scaled_inverse(&known.matrix).unwrap();
        let grid = PixelGrid::over(SIZE, 7);
        let mut expected = Vec::new();
        for pixel in grid.pixels() {
            let at = |step: &[f64]| {
                let (lenses, b_from_a) = moved(&known, [&a, &b], step);
                let lenses = [&lenses[0], &lenses[1]];
                // At the edge of a lens's valid region, a step may leave the region.
                let pixel = transferred(lenses, &b_from_a, pixel, 0.6);
                pixel.map_or(vec![f64::NAN; 2], |pixel| vec![pixel.x, pixel.y])
            };
            let in_b = transferred([&a, &b], &known.b_from_a, pixel, 0.6);
            if in_b.is_some_and(|pixel| SIZE.contains(pixel)) {
                let jacobian = numeric(known.matrix.nrows(), at);
                let of_pixel = &jacobian * &covariance * jacobian.transpose();
                let is_whole = jacobian.iter().all(|value| value.is_finite());
                expected.push(is_whole.then(|| of_pixel.symmetric_eigenvalues().max().sqrt()));
            }
        }
        let std_px = goal.std_px(&known.matrix).unwrap();
        assert_eq!(std_px.len(), expected.len());
        assert!(2 * expected.iter().flatten().count() > expected.len());
        for (std, expected) in std_px.iter().zip(expected) {
            let Some(expected) = expected else { continue };
            assert!((std / expected - 1.0).abs() < 1e-3, "{std} for {expected}");
        }
    }
}

/// Frame sets that both cameras see, that only the first sees, that only the second sees.
fn rig_problem(lenses: [&Lens; 2], seen: &[(Pose, [bool; 2])], mut seed: u64) -> RigProblem {
    let sensors = [0, 1].map(|camera| {
        let views = seen.iter().enumerate().filter(|(_, (_, seen_by))| seen_by[camera]);
        let view = |(frame_set, (a_from_board, _)): (usize, &(Pose, [bool; 2]))| {
            let pose = [*a_from_board, b_from_a() * *a_from_board][camera];
            let mut corner = |point_in_board: Point3<f64>| {
                let pixel = lenses[camera].pixel_from_point(&(pose * point_in_board)).unwrap();
                let [x, y] = [pixel.x, pixel.y].map(|at| at + NOISE_PX * noise(&mut seed));
                Correspondence { point_in_board, pixel: Pixel::new(x, y), std_px: NOISE_PX }
            };
            let correspondences = board().corners_in_board().into_iter().map(&mut corner).collect();
            let view = BoardView { name: frame_set.to_string(), correspondences };
            FrameSetView { frame_set, view }
        };
        let lens = LensChoice::Model(lenses[camera].model());
        RigSensor {
            name: camera.to_string(),
            image_size: SIZE,
            views: views.map(view).collect(),
            options: CameraOptions { lens, ..CameraOptions::default() }.as_stated(),
            lens_covariance_with_shape: None,
        }
    });
    RigProblem { sensors: sensors.into(), frame_sets: seen.len() }
}

#[test]
fn what_is_predicted_of_a_rig_is_what_its_solves_scatter_by() {
    const SEEDS: u64 = 40;
    let (a, b) = (lens(), lens());
    let poses = shared_poses([&a, &b], 0..90);
    // Of 16 views, four are shared, and six are seen by each camera alone.
    let seen: Vec<(Pose, [bool; 2])> = (poses.iter().take(16).enumerate())
        .map(|(k, pose)| (*pose, [k % 8 < 5, k % 8 > 2]))
        .collect();
    let mut known = nothing_known([&a, &b]);
    for (pose, seen_by) in &seen {
        let [own, other] = normals([&a, &b], pose);
        let view = match seen_by {
            [true, true] => known.of_view([&own, &other]).unwrap(),
            [true, false] => known.of_one(0, &own.lens_information(&known.free[0]).unwrap()),
            _ => known.of_one(1, &other.lens_information(&known.free[1]).unwrap()),
        };
        known.matrix += view;
    }
    let covariance = known.place_covariance().unwrap();
    let goal =
        TransferGoal::new(&known, [(&a, SIZE), (&b, SIZE)], 0.6, GoalFigure::Median).unwrap();
    let predicted_px = goal.figure_px(&goal.std_px(&known.matrix).unwrap());
    let (mut errors, mut transfers) = (Vec::new(), Vec::new());
    let (middle, distance_m) = (Pixel::new(213.0, 240.0), 0.6);
    let truth = transferred([&a, &b], &b_from_a(), middle, distance_m).unwrap();
    for seed in 0..SEEDS {
        let problem = rig_problem([&a, &b], &seen, 77 + 1000 * seed);
        let RigEstimate { cameras, sensor_poses, .. } = calibrate_rig(&problem).unwrap();
        let found = sensor_poses[1].sensor_from_rig;
        let rotation = (found.rotation() * b_from_a().rotation().inverse()).scaled_axis();
        let translation = found.translation() - b_from_a().translation();
        errors.push(Vector6::from_iterator(rotation.iter().chain(&translation).copied()));
        let lenses = [&cameras[0].lens, &cameras[1].lens];
        transfers.push(transferred(lenses, &found, middle, distance_m).unwrap().distance_px(truth));
    }
    let inverse = covariance.try_inverse().unwrap();
    let mean_square =
        errors.iter().map(|error| error.dot(&(inverse * error))).sum::<f64>() / (6 * SEEDS) as f64;
    eprintln!("mean square of errors over their prediction: {mean_square:.2}");
    // 240 independent numbers: 1 ± 0.09.
    assert!((mean_square - 1.0).abs() < 0.3, "{mean_square}");
    let mean = errors.iter().sum::<Vector6<f64>>() / SEEDS as f64;
    for k in 0..6 {
        let expected = (covariance[(k, k)] / SEEDS as f64).sqrt();
        eprintln!("{k}: mean {:.2} of its own standard deviations", mean[k] / expected);
        assert!(mean[k].abs() < 3.5 * expected, "{k}: {} of {expected}", mean[k]);
    }
    let rms_px = (transfers.iter().map(|px| px * px).sum::<f64>() / SEEDS as f64).sqrt();
    eprintln!(
        "transfers: {rms_px:.4} px rms, {predicted_px:.4} px predicted in the worst direction"
    );
    assert!(rms_px > 0.5 * predicted_px && rms_px < 1.7 * predicted_px, "{rms_px}, {predicted_px}");
}

#[test]
fn a_suggested_shared_view_is_seen_by_both_and_teaches_what_it_says() {
    let (a, b) = (lens(), fisheye());
    let (points, noise) = (BoardPoints::of_chessboard(&board()), CornerNoise::default());
    let spaces = [space(&a, &points, &noise), space(&b, &points, &noise)];
    let mut known = nothing_known([&a, &b]);
    for (count, pose) in shared_poses([&a, &b], 0..60).iter().enumerate() {
        let [own, other] = normals([&a, &b], pose);
        let view = if count < 2 {
            known.of_view([&own, &other]).unwrap()
        } else {
            known.of_one(0, &own.lens_information(&known.free[0]).unwrap())
                + known.of_one(1, &other.lens_information(&known.free[1]).unwrap())
        };
        known.matrix += view;
    }
    let goal =
        TransferGoal::new(&known, [(&a, SIZE), (&b, SIZE)], 0.6, GoalFigure::Median).unwrap();
    let goal_px = 0.5 * goal.figure_px(&goal.std_px(&known.matrix).unwrap());
    let suggest = |known: &PairInformation| {
        suggest_shared_view(known, &goal, [&spaces[0], &spaces[1]], (None, Some(goal_px))).unwrap()
    };
    let first = suggest(&known);
    for (camera, pose) in first.camera_from_board.iter().enumerate() {
        let outline = spaces[camera].outline_px(pose).unwrap();
        assert!(outline.iter().all(|corner| SIZE.contains(*corner)), "{camera}: {outline:?}");
    }
    let placed = b_from_a() * first.camera_from_board[0];
    assert!(placed.angle_to(&first.camera_from_board[1]) < 1e-9);
    assert!(first.drop > 0.05, "{}", first.drop);
    let [few, many] = first.views_to_go.unwrap();
    assert!(few > 0 && few <= many, "{few} to {many}");
    let mut now = first;
    for _ in 0..many {
        let view = known.of_view([&now.normals[0], &now.normals[1]]).unwrap();
        known.matrix += view;
        let next = suggest(&known);
        assert!((next.uncertainty_px / now.expected_uncertainty_px - 1.0).abs() < 1e-9);
        now = next;
    }
    assert!(now.uncertainty_px <= goal_px, "{} of {goal_px}", now.uncertainty_px);
}
