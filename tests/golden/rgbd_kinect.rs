//! A real Kinect (raw disparity and color), judged by planes on views that were not fitted to,
//! beside the published calibration (D. Herrera C., J. Kannala, J. Heikkilä, *Joint depth and color
//! camera calibration with distortion correction*, PAMI 2012), computed with its own color lens,
//! extrinsics and distortion map on the same pixels.

use std::path::Path;
use std::process::{Command, Output};

use nalgebra::Vector3;
use plumb::calibration::result::{Calibration, Grade};
use plumb::calibration::sensor::SensorId;
use plumb::calibration::solve::rgbd_input::{DepthSensor, RgbdFrameSet, RgbdInput};
use plumb::calibration::solve::solve_rgbd::solve_rgbd;
use plumb::calibration::view::{FrameFacts, View};
use plumb::detection::board_detection::DetectOptions;
use plumb::detection::detector::Detector;
use plumb::document::calibration::CalibrationDocument;
use plumb::estimation::board_pose::board_poses;
use plumb::estimation::measured_board::MeasuredBoard;
use plumb::estimation::problem::{BoardView, Correspondence};
use plumb::geometry::board::{BoardSize, Chessboard};
use plumb::geometry::depth_camera::DepthCamera;
use plumb::geometry::lens::Lens;
use plumb::geometry::pixel::Pixel;
use plumb::geometry::pose::Pose;
use plumb::imaging::decode::luma;
use plumb::imaging::depth_image::DepthImage;
use plumb::imaging::frame::SensorKind;
use plumb::imaging::gray::GrayImage;
use plumb::imaging::image_file::frame_from_file;
use serde_json::Value;

use crate::seeded_rgbd::SeededRgbd;
use crate::shared_data::shared_data;

/// A view by distance, and what the published calibration of ten views leaves of it: the mean
/// distance from color's plane, with its sign, and the root mean square, in mm.
struct Published {
    view: usize,
    /// It is one of the ten.
    is_fitted: bool,
    mean_mm: f64,
    rms_mm: f64,
}

const fn published(view: usize, is_fitted: bool, mean_mm: f64, rms_mm: f64) -> Published {
    Published { view, is_fitted, mean_mm, rms_mm }
}

const UP_TO_1_45_M: [Published; 11] = [
    published(0, true, 0.43, 1.21),
    published(1, false, -0.06, 1.23),
    published(16, true, 0.02, 1.22),
    published(3, true, 0.41, 2.17),
    published(26, true, 0.07, 0.93),
    published(5, false, 1.02, 3.11),
    published(18, false, 0.37, 1.67),
    published(28, false, -1.29, 1.88),
    published(19, true, 0.66, 2.09),
    published(8, true, 0.43, 5.12),
    published(31, true, -0.89, 3.77),
];
const UP_TO_2_2_M: [Published; 3] = [
    published(10, false, -0.46, 8.65),
    published(33, false, -6.51, 8.71),
    published(22, false, 5.44, 7.49),
];
const UP_TO_3_4_M: [Published; 4] = [
    published(12, false, 0.71, 17.43),
    published(24, true, 8.09, 15.47),
    published(15, true, 2.78, 26.13),
    published(37, true, -5.65, 21.51),
];
const RANGES: [(&str, &[Published]); 3] = [
    ("0.6 to 1.45 m", &UP_TO_1_45_M),
    ("1.45 to 2.2 m", &UP_TO_2_2_M),
    ("2.2 to 3.4 m", &UP_TO_3_4_M),
];

/// The ten views that the published calibration was fitted to.
fn fitted() -> Vec<usize> {
    let all = RANGES.iter().flat_map(|(_, views)| views.iter());
    let mut fitted: Vec<usize> = all.filter(|view| view.is_fitted).map(|view| view.view).collect();
    fitted.sort_unstable();
    fitted
}

fn calibrated(data: &Path, views: &[usize]) -> Calibration {
    let output = answered(data, views);
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let document: CalibrationDocument = serde_json::from_slice(&output.stdout).unwrap();
    Calibration::try_from(&document).unwrap()
}

/// What the command line answers for these views.
fn answered(data: &Path, views: &[usize]) -> Output {
    let folder = tempfile::tempdir().unwrap();
    for (sensor, ending, source) in [("color", "jpg", "c1.jpg"), ("depth", "pgm", "d.pgm")] {
        std::fs::create_dir(folder.path().join(sensor)).unwrap();
        for view in views {
            let to = folder.path().join(sensor).join(format!("{view:04}.{ending}"));
            std::fs::copy(data.join(format!("{view:04}-{source}")), to).unwrap();
        }
    }
    let said = "[depth]\nkind = \"disparity\"\ninvalid = 2047\n";
    std::fs::write(folder.path().join("sensors.toml"), said).unwrap();
    let place = folder.path().display().to_string();
    let asked =
        ["calibrate", "--json", "--lens", "brown", "--board", "8x6", "--square", "40mm", &place];
    Command::new(env!("CARGO_BIN_EXE_plumb")).args(asked).output().unwrap()
}

/// What the calibration says of its lenses and of where depth is: numbers with their deviations.
fn stated(calibration: &Calibration) -> Vec<(f64, f64)> {
    let color = calibration.color().unwrap();
    let depth = calibration.depth().unwrap();
    let [target, source] = [SensorKind::Color, SensorKind::Depth].map(SensorId::own);
    let place = calibration.pose(&target, &source).unwrap();
    let pose = &place.target_from_source;
    let lens = |lens: &Lens, std: &[f64]| -> Vec<(f64, f64)> {
        (0..4).map(|k| (lens.parameters()[k], std[k])).collect()
    };
    let (rotation, translation) = (pose.rotation().scaled_axis(), pose.translation());
    let of_rotation = (0..3).map(|k| (rotation[k], place.rotation_std[k]));
    let of_translation = (0..3).map(|k| (translation[k], place.translation_std_m[k]));
    let lenses =
        [lens(&color.lens, &color.lens_std), lens(&depth.camera.lens, &depth.lens_std)].concat();
    lenses.into_iter().chain(of_rotation).chain(of_translation).collect()
}

/// Most are far away and nearly frontal, and leave the depth lens open: without a prior the focal
/// lengths that fit are 629 and 11 px.
#[test]
fn few_views_are_answered_as_uncertainly_as_they_are() {
    let Some(data) = shared_data("kinect1-herrera") else { return };
    let calibration = calibrated(&data, &[0, 3, 12, 15, 18, 24, 33]);
    // Depth's lens as published from 54 views, and color's from all views with depth: the published
    // one takes the board as stated, and its pixels are not square.
    let of_all = stated(&calibrated(&data, &fitted()));
    let color = of_all[..4].iter().copied();
    let published = [586.4, 583.9, 322.9, 229.8].map(|number| (number, 0.0));
    let known = color.chain(published);
    for ((number, std), (known, known_std)) in stated(&calibration).into_iter().zip(known) {
        println!("{number:.1} ± {std:.1}, known {known:.1} ± {known_std:.1}");
        assert!((number - known).abs() < 4.0 * std.hypot(known_std));
    }
    for (number, std) in &stated(&calibration)[4..8] {
        assert!(*std > 0.004 * number, "{number} ± {std}");
    }
    assert_eq!(calibration.verdict.grade, Grade::Poor);
}

/// Halves of the views differ by as much as they say: what views share that no model has (how depth
/// is off over the image, a board that is uneven) is in what they say.
#[test]
fn halves_of_the_views_agree_within_what_they_state() {
    let Some(data) = shared_data("kinect1-herrera") else { return };
    let mut views: Vec<usize> =
        RANGES.iter().flat_map(|(_, views)| views.iter().map(|view| view.view)).collect();
    views.sort_unstable();
    let half = |rest: &[usize]| {
        let own = views.iter().enumerate().filter(|(k, _)| rest.contains(&(k % 4)));
        stated(&calibrated(&data, &own.map(|(_, view)| *view).collect::<Vec<_>>()))
    };
    let mut squares = Vec::new();
    for (first, second) in [([0, 2], [1, 3]), ([0, 1], [2, 3]), ([0, 3], [1, 2])] {
        let both = half(&first).into_iter().zip(half(&second));
        squares.extend(
            both.map(|((a, a_std), (b, b_std))| (a - b).powi(2) / a_std.hypot(b_std).powi(2)),
        );
    }
    let z_rms = (squares.iter().sum::<f64>() / squares.len() as f64).sqrt();
    println!("{z_rms:.2} rms of {} differences over their deviations", squares.len());
    assert!((0.6..1.25).contains(&z_rms), "{z_rms}");
}

fn numbers(value: &Value) -> Vec<f64> {
    value.as_array().unwrap().iter().map(|number| number.as_f64().unwrap()).collect()
}

/// Color as it was solved, and the board that it measured.
type SolvedColor<'a> = (&'a Lens, Option<&'a MeasuredBoard>);

/// The plane of the board as color sees it: a unit normal and its distance, in the color camera's
/// frame.
fn plane((lens, board): SolvedColor<'_>, capture: &RgbdFrameSet) -> (Vector3<f64>, f64) {
    let placed = |corner: &Correspondence| board.map_or(*corner, |board| corner.placed_on(board));
    let correspondences = capture.color.iter().map(placed).collect();
    let view = BoardView { name: "held out".to_owned(), correspondences };
    let color_from_board = board_poses(lens, &view).unwrap()[0].camera_from_board;
    let normal = color_from_board * Vector3::z();
    (normal, normal.dot(&color_from_board.translation()))
}

fn inside(polygon: &[Pixel], pixel: Pixel) -> bool {
    let sides = polygon.iter().zip(polygon.iter().cycle().skip(1));
    let left = sides.filter(|(a, b)| {
        (a.y <= pixel.y) != (b.y <= pixel.y)
            && a.x + (pixel.y - a.y) / (b.y - a.y) * (b.x - a.x) < pixel.x
    });
    left.count() % 2 == 1
}

/// Distances from the plane of every reading on it, in mm.
fn off(
    (color, camera, pose): (SolvedColor<'_>, &DepthCamera, &Pose),
    capture: &RgbdFrameSet,
    view: &Value,
) -> Vec<f64> {
    let (normal, distance) = plane(color, capture);
    let image = capture.depth.as_ref().unwrap();
    let corners =
        view["plane_polygon_depth_px"].as_array().unwrap().iter().map(numbers).collect::<Vec<_>>();
    let polygon: Vec<Pixel> = match corners.len() {
        2 => corners[0].iter().zip(&corners[1]).map(|(x, y)| Pixel::new(*x, *y)).collect(),
        _ => corners.iter().map(|corner| Pixel::new(corner[0], corner[1])).collect(),
    };
    let size = image.size();
    let pixels = (0..size.width * size.height)
        .map(|k| Pixel::new(f64::from(k % size.width), f64::from(k / size.width)));
    let each = pixels
        .zip(image.readings())
        .filter(|(pixel, raw)| **raw < 2047 && inside(&polygon, *pixel));
    let point = |(pixel, raw): (Pixel, &u16)| camera.point_from_reading(pixel, f64::from(*raw));
    each.filter_map(point).map(|p| 1e3 * (normal.dot(&(*pose * p).coords) - distance)).collect()
}

/// Mean and root mean square distance of a view's readings from color's plane, in mm.
fn mean_and_rms(
    camera: (SolvedColor<'_>, &DepthCamera, &Pose),
    captures: &[(usize, RgbdFrameSet)],
    views: &[Value],
    number: usize,
) -> [f64; 2] {
    let view = views.iter().find(|view| view["index"] == number).unwrap();
    let capture = captures.iter().find(|(own, _)| *own == number).unwrap();
    let off = off(camera, &capture.1, view);
    let mean = |sum: f64| sum / off.len() as f64;
    [mean(off.iter().sum()), mean(off.iter().map(|mm| mm * mm).sum()).sqrt()]
}

/// Over views: the mean of their means with their signs left out, and the root mean square.
fn over_views(views: &[[f64; 2]]) -> [f64; 2] {
    let mean = |sum: f64| sum / views.len() as f64;
    [
        mean(views.iter().map(|[of_view, _]| of_view.abs()).sum()),
        mean(views.iter().map(|[_, rms]| rms * rms).sum()).sqrt(),
    ]
}

fn reference(data: &Path) -> Vec<Value> {
    let reference: Value =
        serde_json::from_slice(&std::fs::read(data.join("full_set_reference.json")).unwrap())
            .unwrap();
    reference["views"].as_array().unwrap().clone()
}

/// By the same ten views.
#[test]
fn planes_of_held_out_views_lie_closer_than_by_the_published_calibration() {
    let Some(data) = shared_data("kinect1-herrera") else { return };
    let (calibration, views) = (calibrated(&data, &fitted()), reference(&data));
    let board = Chessboard::new(BoardSize::new(8, 6).unwrap(), 0.04).unwrap();
    let captures = captures(&data, &board);
    let color = calibration.color().unwrap();
    let color = (&color.lens, color.board_shape.as_ref());
    let [target, source] = [SensorKind::Color, SensorKind::Depth].map(SensorId::own);
    let pose = &calibration.pose(&target, &source).unwrap().target_from_source;
    let corrected = &calibration.depth().unwrap().camera;
    let uncorrected = DepthCamera { correction: None, ..corrected.clone() };
    for (range, published) in RANGES {
        let held_out: Vec<&Published> = published.iter().filter(|view| !view.is_fitted).collect();
        let by = |camera: &DepthCamera| {
            let each = held_out
                .iter()
                .map(|view| mean_and_rms((color, camera, pose), &captures, &views, view.view));
            over_views(&each.collect::<Vec<_>>())
        };
        let ([mean, rms], before) = (by(corrected), by(&uncorrected));
        let theirs: Vec<[f64; 2]> =
            held_out.iter().map(|view| [view.mean_mm, view.rms_mm]).collect();
        let [their_mean, their_rms] = over_views(&theirs);
        let line = format!(
            "{range}, ten views fitted: {rms:.2} mm rms, {mean:.2} mm mean; published {their_rms:.2} and {their_mean:.2} mm; \
             without correction {:.2} and {:.2} mm",
            before[1], before[0]
        );
        println!("{line}");
        // The mean of the single view beyond 2.2 m is chance: see the test that leaves out each
        // view.
        assert!(rms <= their_rms && (mean <= their_mean || held_out.len() == 1), "{line}");
    }
    // What planes alone leave open is reported: the published answers lie within it.
    let depth = calibration.depth().unwrap();
    for (axis, published) in [(0, 580.0..586.5), (1, 583.9..586.8)] {
        let (focal, std) = (depth.camera.lens.parameters()[axis], depth.lens_std[axis]);
        println!("f{axis}: {focal:.1} ± {std:.1}, published {published:?}");
        assert!(
            std > 0.005 * focal
                && focal - 2.0 * std < published.end
                && focal + 2.0 * std > published.start
        );
    }
    let reasons = calibration.verdict.reasons.join("\n");
    assert!(
        reasons.contains("fx is uncertain by") && reasons.contains("along the optical axis"),
        "{reasons}"
    );
}

/// Lens and poses of one document are of one solve: they project the board's corners to where they
/// were seen, as far off as the document says.
#[test]
fn the_document_reprojects_as_it_says() {
    let Some(data) = shared_data("kinect1-herrera") else { return };
    let calibration = calibrated(&data, &fitted());
    let color = calibration.color().unwrap();
    let board = Chessboard::new(BoardSize::new(8, 6).unwrap(), 0.04).unwrap();
    let (mut squares, mut count) = (0.0, 0.0);
    for (number, capture) in captures(&data, &board) {
        let view = color.views.iter().find(|view| view.name.contains(&format!("{number:04}")));
        let Some(view) = view.filter(|view| view.used) else { continue };
        let pose = view.camera_from_board.unwrap();
        let (mut of_view, mut corners) = (0.0, 0.0);
        for corner in &capture.color {
            let placed =
                color.board_shape.as_ref().map_or(*corner, |board| corner.placed_on(board));
            let pixel = color.lens.pixel_from_point(&(pose * placed.point_in_board)).unwrap();
            let off_px = pixel.distance_px(corner.pixel);
            // Outliers are not in the figure; which these are it does not say.
            if off_px < 5.0 * view.rms_px.unwrap() {
                (of_view, corners) = (of_view + off_px * off_px, corners + 1.0);
            }
        }
        let ratio = f64::sqrt(of_view / corners) / view.rms_px.unwrap();
        assert!((0.8..1.25).contains(&ratio), "view {number}: {ratio} times what it says");
        (squares, count) = (squares + of_view, count + corners);
    }
    let ratio = f64::sqrt(squares / count) / color.rms_px;
    assert!(count > 450.0 && (0.9..1.1).contains(&ratio), "{ratio} of {count} corners");
}

/// Everything that was taken with color and depth, by view.
fn captures(data: &Path, board: &Chessboard) -> Vec<(usize, RgbdFrameSet)> {
    let (mut detector, mut image) = (Detector::new(board.size), GrayImage::default());
    let mut numbers: Vec<usize> =
        RANGES.iter().flat_map(|(_, views)| views.iter().map(|view| view.view)).collect();
    numbers.sort_unstable();
    let capture = |number: usize| {
        let bytes =
            |ending: &str| std::fs::read(data.join(format!("{number:04}-{ending}"))).unwrap();
        luma(&frame_from_file(SensorKind::Color, bytes("c1.jpg")), &mut image).unwrap();
        let detection = detector.find_board(image.view(), &DetectOptions::default()).unwrap();
        let frame = FrameFacts {
            sequence: 0,
            name: None,
            host_time_ns: 0,
            device_time_ns: None,
            image_size: image.size(),
        };
        let depth =
            DepthImage::from_frame(&frame_from_file(SensorKind::Depth, bytes("d.pgm"))).unwrap();
        let capture = RgbdFrameSet {
            name: number.to_string(),
            time_s: None,
            is_view: true,
            color: View { number: 0, frame, detection }
                .to_board_view(&(*board).into())
                .correspondences,
            infrared: Vec::new(),
            depth: Some(depth),
        };
        (number, capture)
    };
    numbers.into_iter().map(capture).collect()
}

/// Each view is judged by a fit to all others: so every range has views, near and far. The
/// published figures are of the views that it was fitted to as well, which is in its favor.
#[test]
fn planes_of_each_view_lie_closer_by_all_others_than_by_the_published_calibration() {
    let Some(data) = shared_data("kinect1-herrera") else { return };
    let (views, board) =
        (reference(&data), Chessboard::new(BoardSize::new(8, 6).unwrap(), 0.04).unwrap());
    let all = captures(&data, &board);
    let color_size = plumb::geometry::pixel::ImageSize::new(1280, 1024);
    let without = |left_out: usize| {
        let others = all.iter().filter(|(number, _)| *number != left_out);
        let depth =
            DepthSensor { reading: None, invalid: Some(2047), factory: None, with_infrared: true };
        let frame_sets = others.map(|(_, frame_set)| frame_set.clone()).collect();
        let solved = solve_rgbd(
            &RgbdInput { board: board.into(), color_size, depth, frame_sets },
            &SeededRgbd::options(),
        )
        .unwrap();
        let joint = &solved.joint;
        let color = (&joint.color, solved.color.sensor.board_shape.as_ref());
        let camera = (color, &joint.depth, &joint.color_from_depth);
        mean_and_rms(camera, &all, &views, left_out)
    };
    for (range, published) in RANGES {
        // Two at a time.
        let ours: Vec<[f64; 2]> = published
            .chunks(2)
            .flat_map(|two| {
                std::thread::scope(|scope| {
                    let each: Vec<_> =
                        two.iter().map(|view| scope.spawn(|| without(view.view))).collect();
                    each.into_iter().map(|one| one.join().unwrap()).collect::<Vec<_>>()
                })
            })
            .collect();
        for is_all in [true, false] {
            let counted =
                || published.iter().zip(&ours).filter(|(view, _)| is_all || !view.is_fitted);
            let [mean, rms] = over_views(&counted().map(|(_, ours)| *ours).collect::<Vec<_>>());
            let theirs: Vec<[f64; 2]> =
                counted().map(|(view, _)| [view.mean_mm, view.rms_mm]).collect();
            let [their_mean, their_rms] = over_views(&theirs);
            let which = if is_all {
                "each of all views"
            } else {
                "each that the published one was not fitted to"
            };
            let line = format!(
                "{range}, {which}: {rms:.2} mm rms, {mean:.2} mm mean; published {their_rms:.2} and {their_mean:.2} mm"
            );
            println!("{line}");
            // Of views that the published calibration was fitted to, nearer than 1.45 m, it leaves
            // less in the mean than a fit to the others: 0.5 mm, where its authors state 1.
            let most_mm = if is_all { f64::max(their_mean, 1.0) } else { their_mean };
            assert!(rms <= their_rms && mean <= most_mm, "{line}");
        }
    }
}
