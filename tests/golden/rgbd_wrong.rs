//! What can be wrong with color and depth: each is one line that says what, never a silent wrong
//! answer.

use nalgebra::{Point3, Vector3};
use plumb::calibration::depth_calibration::{DepthCalibration, judge_depth};
use plumb::calibration::solve::rgbd_input::RgbdInput;
use plumb::calibration::solve::solve_rgbd::solve_rgbd;
use plumb::geometry::depth_camera::DepthReading;
use plumb::geometry::pose::Pose;
use plumb::imaging::depth_image::DepthImage;

use crate::seeded_camera::SeededCamera;
use crate::seeded_rgbd::SeededRgbd;

fn input(rig: &SeededRgbd) -> RgbdInput {
    let poses = rig.poses(11, &mut SeededCamera::rng(3));
    rig.input(&poses, &mut SeededCamera::rng(4))
}

/// Every depth image changed.
fn with_depth(mut input: RgbdInput, change: impl Fn(usize, &DepthImage) -> Vec<u16>) -> RgbdInput {
    for (index, capture) in input.frame_sets.iter_mut().enumerate() {
        capture.depth = capture
            .depth
            .take()
            .and_then(|depth| DepthImage::new(depth.size(), change(index, &depth)));
    }
    input
}

fn mirrored(input: RgbdInput) -> RgbdInput {
    let mirrored = |depth: &DepthImage| {
        let rows = depth.readings().chunks(depth.size().width as usize);
        rows.flat_map(|row| row.iter().rev().copied()).collect()
    };
    with_depth(input, |_, depth| mirrored(depth))
}

fn flipped(input: RgbdInput) -> RgbdInput {
    let flipped = |depth: &DepthImage| {
        let rows = depth.readings().chunks(depth.size().width as usize);
        rows.rev().flatten().copied().collect()
    };
    with_depth(input, |_, depth| flipped(depth))
}

/// The error, or the reasons of the verdict.
fn reasons(input: &RgbdInput) -> Vec<String> {
    match solve_rgbd(input, &SeededRgbd::options()) {
        Err(error) => vec![error.to_string()],
        Ok(solved) => {
            let depth = DepthCalibration::of(&solved.joint, None);
            let views = input.frame_sets.iter().filter(|capture| capture.depth.is_some()).count();
            let verdict = [Some(&solved.color), solved.infrared.as_ref()].into_iter().flatten();
            let own = verdict.flat_map(|camera| camera.verdict.reasons.clone()).collect::<Vec<_>>();
            let judged = judge_depth(
                solved.color.verdict.clone(),
                &depth,
                solved.without_depth.len(),
                views,
            );
            [own, judged.reasons].concat()
        }
    }
}

fn expect(what: &str, input: &RgbdInput, word: &str) {
    let lines = reasons(input);
    println!("{what}: {lines:?}");
    assert!(
        lines.iter().any(|line| line.contains(word) && !line.contains('\n')),
        "{what}: {lines:?}"
    );
}

#[test]
fn each_wrong_thing_is_one_clear_line() {
    let with = SeededRgbd::new();
    let without = SeededRgbd { with_infrared: false, ..SeededRgbd::new() };
    for (rig, name) in [(&with, "with infrared"), (&without, "without infrared")] {
        let right = input(rig);
        assert!(
            solve_rgbd(&right, &SeededRgbd::options()).is_ok(),
            "{name}: {:?}",
            reasons(&right)
        );
        expect(
            &format!("{name}: mirrored depth"),
            &mirrored(right.clone()),
            "depth images are mirrored (left and right exchanged)",
        );
        expect(
            &format!("{name}: depth upside down"),
            &flipped(right.clone()),
            "depth images are flipped (top and bottom exchanged)",
        );
        expect(
            &format!("{name}: depth rotated by 180 degrees"),
            &mirrored(flipped(right.clone())),
            "depth images are rotated by 180 degrees",
        );
        expect(
            &format!("{name}: a depth frame of zeros each"),
            &with_depth(right.clone(), |_, depth| vec![0; depth.readings().len()]),
            "none of 11 depth images has a valid reading",
        );
        let mut unit = right.clone();
        unit.depth.reading = Some(DepthReading::Metric { unit_m: 0.001 });
        expect(&format!("{name}: another unit"), &unit, "check the depth unit");
        let mut shuffled = right.clone();
        let depths: Vec<_> = right.frame_sets.iter().map(|capture| capture.depth.clone()).collect();
        for (index, capture) in shuffled.frame_sets.iter_mut().enumerate() {
            capture.depth = depths[(index + 5) % depths.len()].clone();
        }
        expect(&format!("{name}: depth of other moments"), &shuffled, "check that depth and color");
    }
}

#[test]
fn a_board_that_is_not_flat_is_reported() {
    let rig = SeededRgbd::new();
    let mut input = input(&rig);
    let poses = rig.poses(11, &mut SeededCamera::rng(3));
    for (capture, pose) in input.frame_sets.iter_mut().zip(&poses) {
        // Bent by 6 mm in the middle of its rows.
        let bent = |camera: &SeededCamera, camera_from_board: Pose, corners: &mut Vec<_>| {
            for corner in corners.iter_mut() {
                let corner: &mut plumb::estimation::problem::Correspondence = corner;
                let along = corner.point_in_board.x / 0.24;
                let up = Vector3::z() * (0.006 * 4.0 * along * (1.0 - along));
                let at: Point3<f64> = corner.point_in_board + up;
                corner.pixel = camera.lens.pixel_from_point(&(camera_from_board * at)).unwrap();
            }
        };
        bent(&rig.color, *pose, &mut capture.color);
        bent(&rig.depth, rig.depth_from_color * *pose, &mut capture.infrared);
    }
    expect("a bent board", &input, "uneven");
}

#[test]
fn depth_without_color_in_half_the_views_is_reported() {
    let mut input = input(&SeededRgbd::new());
    let all = input.frame_sets.len();
    for capture in input.frame_sets.iter_mut().skip(1).step_by(2) {
        capture.color.clear();
    }
    assert!(solve_rgbd(&input, &SeededRgbd::options()).is_ok(), "{:?}", reasons(&input));
    let line = plumb::calibration::solve::rgbd_calibration::without_color(&input).unwrap();
    assert!(line.contains(&format!("{} of {all}", all / 2)) && !line.contains('\n'), "{line}");
}
