//! Boards in real photographs: found, whole, and every corner labeled as its neighbors are.

use std::path::{Path, PathBuf};

use plumb::calibration::solve::{SolvedCamera, solve_views};
use plumb::calibration::view::{FrameFacts, View};
use plumb::detection::board_detection::{DetectOptions, Detection, NoBoard};
use plumb::detection::detector::Detector;
use plumb::estimation::camera::CameraOptions;
use plumb::estimation::problem::{BoardView, CameraProblem, LensChoice, Shutter};
use plumb::geometry::board::{BoardSize, Chessboard};
use plumb::geometry::lens::LensModel;
use plumb::geometry::pixel::{ImageSize, Pixel};
use plumb::imaging::decode::luma;
use plumb::imaging::frame::SensorKind;
use plumb::imaging::gray::GrayImage;
use plumb::imaging::image_file::frame_from_file;
use rand::SeedableRng;
use rand::seq::SliceRandom;
use rand_chacha::ChaCha8Rng;

use crate::shared_data::shared_data;

/// What `detector` answers of the image at `path`.
pub fn search(
    detector: &mut Detector,
    path: &Path,
    allow_partial: bool,
) -> Result<Detection, NoBoard> {
    detector.find_board(decoded(path).view(), &DetectOptions { allow_partial })
}

pub fn decoded(path: &Path) -> GrayImage {
    let mut image = GrayImage::default();
    luma(&frame_from_file(SensorKind::Color, std::fs::read(path).unwrap()), &mut image).unwrap();
    image
}

/// The images in the folder `name`, in the order of their names; there must be `count`.
pub fn images(name: &str, count: usize) -> Option<Vec<PathBuf>> {
    let entries = std::fs::read_dir(shared_data(name)?).unwrap().map(|entry| entry.unwrap().path());
    let is_image =
        |path: &PathBuf| path.extension().is_some_and(|kind| kind == "jpg" || kind == "png");
    let mut paths: Vec<PathBuf> = entries.filter(is_image).collect();
    paths.sort();
    assert_eq!(paths.len(), count, "{name}");
    Some(paths)
}

fn at(found: &Detection, col: i32, row: i32) -> Option<Pixel> {
    found
        .corners
        .iter()
        .find(|corner| (corner.index.col, corner.index.row) == (col, row))
        .map(|corner| corner.pixel)
}

/// Every square keeps the way round that boards have, and no step along a line is twice the one
/// before: a line that was skipped or counted twice would break that, whatever the lens.
fn assert_even_grid(found: &Detection, path: &Path) {
    let minus = |p: Pixel, q: Pixel| (p.x - q.x, p.y - q.y);
    let mut squares = 0;
    for (col, row) in found.corners.iter().map(|corner| (corner.index.col, corner.index.row)) {
        let Some(p) = at(found, col, row) else { continue };
        if let (Some(q), Some(r)) = (at(found, col + 1, row), at(found, col, row + 1)) {
            let ((ux, uy), (vx, vy)) = (minus(q, p), minus(r, p));
            assert!(ux * vy - uy * vx > 0.0, "{}: square at {col}, {row}", path.display());
            squares += 1;
        }
        for (dc, dr) in [(1, 0), (0, 1)] {
            if let (Some(q), Some(r)) =
                (at(found, col + dc, row + dr), at(found, col - dc, row - dr))
            {
                let ratio = p.distance_px(q) / p.distance_px(r);
                assert!(
                    (0.55..1.8).contains(&ratio),
                    "{}: step at {col}, {row}: {ratio}",
                    path.display()
                );
            }
        }
    }
    assert!(squares > 0);
}

/// All `count` images of a folder show the whole board.
fn assert_all_whole(folder: &str, count: usize, board: &str) {
    let Some(paths) = images(folder, count) else { return };
    let board: BoardSize = board.parse().unwrap();
    let mut detector = Detector::new(board);
    for path in &paths {
        let found = search(&mut detector, path, true)
            .unwrap_or_else(|reason| panic!("{}: {reason}", path.display()));
        assert!(
            !found.partial && found.position_known,
            "{}: {} corners",
            path.display(),
            found.corners.len()
        );
        assert_eq!(found.corners.len(), board.corner_count());
        assert_even_grid(&found, path);
    }
}

#[test]
fn a_corner_behind_the_plate_does_not_hide_the_board() {
    let Some(folder) = shared_data("opencv-samples") else { return };
    let mut detector = Detector::new(sample_board().size);
    let original = decoded(&folder.join("right07.jpg"));
    let at_once = DetectOptions::default();
    let unchanged = detector.find_board(original.view(), &at_once).unwrap();
    // What lies behind the plate's corner resembles a corner of a seventh line when the image is
    // darkened.
    for gamma in [1.0, 1.3, 1.6, 2.0] {
        let darker = |&light: &u8| (255.0 * (f64::from(light) / 255.0).powf(gamma)).round() as u8;
        let pixels = original.view().bytes().iter().map(darker).collect();
        let image = GrayImage::from_pixels(640, 480, pixels).unwrap();
        let found = detector.find_board(image.view(), &at_once);
        let found = found.unwrap_or_else(|reason| panic!("{gamma}: {reason}"));
        for (corner, same) in found.corners.iter().zip(&unchanged.corners) {
            assert_eq!(corner.index, same.index);
            assert!(corner.pixel.distance_px(same.pixel) < 0.2, "{gamma}: {corner:?}, {same:?}");
        }
    }
}

#[test]
fn every_board_in_a_full_fisheye_is_found_whole() {
    assert_all_whole("boofcv-fisheye-chess", 26, "4x6");
}

/// The views of the left or the right camera of OpenCV's samples; `None` where there are none.
fn sample_views(camera: &str) -> Option<Vec<BoardView>> {
    Some(views_of(&sample_paths(camera)?, sample_board(), ImageSize::new(640, 480)))
}

fn sample_board() -> Chessboard {
    Chessboard::new("9x6".parse().unwrap(), 0.03).unwrap()
}

fn sample_paths(camera: &str) -> Option<Vec<PathBuf>> {
    let mut paths = images("opencv-samples", 28)?;
    paths.retain(|path| {
        let name = path.file_name().unwrap_or_default().to_string_lossy().into_owned();
        name.strip_prefix(camera).is_some_and(|rest| rest.starts_with(['0', '1']))
    });
    Some(paths)
}

/// The board in each of the images at `paths`.
fn views_of(paths: &[PathBuf], board: Chessboard, image_size: ImageSize) -> Vec<BoardView> {
    let mut detector = Detector::new(board.size);
    let mut view = |path: &PathBuf| {
        let detection = search(&mut detector, path, false).unwrap();
        view_of(detection, path, board, image_size)
    };
    paths.iter().map(&mut view).collect()
}

fn view_of(detection: Detection, path: &Path, board: Chessboard, size: ImageSize) -> BoardView {
    let frame = FrameFacts {
        sequence: 0,
        name: Some(path.display().to_string()),
        host_time_ns: 0,
        device_time_ns: None,
        image_size: size,
    };
    View { number: 0, frame, detection }.to_board_view(&board.into())
}

fn solved(views: Vec<BoardView>) -> SolvedCamera {
    solved_with(LensModel::Brown, views)
}

fn solved_with(model: LensModel, views: Vec<BoardView>) -> SolvedCamera {
    let lens = LensChoice::Model(model);
    let options = CameraOptions { lens, ..CameraOptions::default() };
    let problem = CameraProblem { image_size: ImageSize::new(640, 480), views };
    solve_views(&problem, &options).unwrap()
}

/// The spread of the estimates without one view after the other is what the stated deviations mean.
#[test]
fn stated_deviations_are_those_of_leaving_views_out() {
    let Some(views) = sample_views("right") else { return };
    let whole = solved(views.clone());
    let left_out: Vec<Vec<f64>> = (0..views.len())
        .map(|out| {
            let mut rest = views.clone();
            rest.remove(out);
            solved(rest).estimate.lens.parameters()
        })
        .collect();
    let count = views.len() as f64;
    for (k, stated) in whole.estimate.lens_std().iter().take(4).enumerate() {
        let mean = left_out.iter().map(|one| one[k]).sum::<f64>() / count;
        let squares = left_out.iter().map(|one| (one[k] - mean).powi(2)).sum::<f64>();
        let ratio = (squares * (count - 1.0) / count).sqrt() / stated;
        assert!((0.7..1.4).contains(&ratio), "parameter {k}: {ratio}");
    }
    assert!(!whole.verdict.reasons.iter().any(|reason| reason.contains("does not fit")));
}

/// Six near views show the distortion. Radial by itself gives them up, and fits the others more
/// closely than larger models fit all of them.
#[test]
fn no_lens_is_chosen_for_the_views_that_it_gives_up() {
    let Some(mut paths) = images("kinect1-herrera", 24) else { return };
    paths.retain(|path| !path.ends_with("0005-c1.jpg"));
    let board = Chessboard::new("8x6".parse().unwrap(), 0.04).unwrap();
    let image_size = ImageSize::new(1280, 1024);
    let problem = CameraProblem { image_size, views: views_of(&paths, board, image_size) };
    let estimate = solve_views(&problem, &CameraOptions::default()).unwrap().estimate;
    assert_ne!(estimate.lens.model(), LensModel::Radial);
    assert!(estimate.views.iter().all(|view| view.fault.is_none()));
}

/// This lens is closest to a rational one, but the views determine one coefficient of its denominator
/// alone. Without it the result changed by three deviations where single views were left out.
#[test]
fn a_denominator_of_one_coefficient_is_chosen_whichever_view_is_left_out() {
    let Some(paths) = images("kinect1-herrera", 24) else { return };
    let board = Chessboard::new("8x6".parse().unwrap(), 0.04).unwrap();
    let image_size = ImageSize::new(1280, 1024);
    let views = views_of(&paths, board, image_size);
    let solved_without = |left_out: Option<&str>| {
        let views = views.iter().zip(&paths);
        let kept = views.filter(|(_, path)| left_out.is_none_or(|name| !path.ends_with(name)));
        let views = kept.map(|(view, _)| view.clone()).collect();
        solve_views(&CameraProblem { image_size, views }, &CameraOptions::default()).unwrap()
    };
    let whole = solved_without(None);
    assert!(!whole.verdict.reasons.iter().any(|reason| reason.contains("does not fit")));
    let std = whole.estimate.lens_std();
    for left_out in ["0056-c1.jpg", "0057-c1.jpg", "0058-c1.jpg"] {
        let lens = solved_without(Some(left_out)).estimate.lens;
        assert_eq!(lens.model(), LensModel::Rational, "{left_out}");
        assert_eq!(lens.distortion.as_rational().unwrap()[6..], [0.0; 2], "{left_out}");
        for (k, std) in std.iter().enumerate().take(4) {
            let moved = lens.parameters()[k] - whole.estimate.lens.parameters()[k];
            assert!(moved.abs() < *std, "{left_out}: parameter {k} by {moved}, {std}");
        }
    }
}

/// A photograph in mirror image, as one of another camera would be: motion while it was read explains
/// some of it, but no other view moves.
#[test]
fn a_mirrored_photograph_is_named_and_not_used() {
    const MIRRORED: usize = 2;
    let Some(mut views) = sample_views("left") else { return };
    for seen in &mut views[MIRRORED].correspondences {
        seen.pixel.x = 639.0 - seen.pixel.x;
        seen.point_in_board.x = 8.0 * 0.03 - seen.point_in_board.x;
    }
    assert_eq!(named(views), [MIRRORED]);
}

/// Of this camera's views a rolling shutter is reported in part: the mirrored one moved as they rule
/// out.
#[test]
fn a_mirrored_photograph_among_views_that_may_have_moved_is_named() {
    const MIRRORED: usize = 10;
    let Some(paths) = sample_paths("right") else { return };
    let (board, size) = (sample_board(), ImageSize::new(640, 480));
    let mut views = views_of(&paths, board, size);
    let mut image = decoded(&paths[MIRRORED]);
    image.pixels_mut().chunks_mut(640).for_each(<[u8]>::reverse);
    let options = DetectOptions { allow_partial: false };
    let detection = Detector::new(board.size).find_board(image.view(), &options).unwrap();
    views[MIRRORED] = view_of(detection, &paths[MIRRORED], board, size);
    assert_eq!(named(views), [MIRRORED]);
}

/// Motion explains these views nearly as well as it explains the others, and a rolling shutter is
/// reported in part without them: lens and board of the other views, read at once, rule them out.
#[test]
fn a_view_that_only_motion_would_explain_is_named() {
    const ODD: usize = 12;
    let (Some(paths), Some(of_other_camera)) = (sample_paths("right"), sample_paths("left")) else {
        return;
    };
    let (board, size) = (sample_board(), ImageSize::new(640, 480));
    let views = views_of(&paths, board, size);
    assert_eq!(named(views.clone()), [0; 0]);
    let mut mirrored = decoded(&paths[ODD]);
    mirrored.pixels_mut().chunks_mut(640).for_each(<[u8]>::reverse);
    for image in [mirrored, decoded(&of_other_camera[ODD])] {
        let options = DetectOptions { allow_partial: false };
        let detection = Detector::new(board.size).find_board(image.view(), &options).unwrap();
        let mut views = views.clone();
        views[ODD] = view_of(detection, &paths[ODD], board, size);
        assert_eq!(named(views), [ODD]);
    }
}

/// The views that are not used.
fn named(views: Vec<BoardView>) -> Vec<usize> {
    let views = solved(views).estimate.views;
    (0..views.len()).filter(|view| views[*view].fault.is_some()).collect()
}

/// These views do not determine eight coefficients: those that would only cancel are held at 0, and
/// what the lens does is the same as by five.
#[test]
fn eight_coefficients_see_as_five_do() {
    let Some(views) = sample_views("left") else { return };
    let [few, many] =
        [LensModel::Brown, LensModel::Rational].map(|model| solved_with(model, views.clone()));
    for k in 0..4 {
        let [(few, few_std), (many, many_std)] = [&few, &many]
            .map(|one| (one.estimate.lens.parameters()[k], one.estimate.lens_std()[k]));
        assert!((few - many).abs() < 2.0 * few_std.hypot(many_std), "{k}: {few} and {many}");
    }
    assert_eq!(many.estimate.lens.distortion.as_rational().unwrap()[6..], [0.0; 2]);
}

/// With all rows read at once all six coefficients would cancel but for a pole inside the image.
#[test]
fn coefficients_that_would_cancel_are_held() {
    let Some(views) = sample_views("left") else { return };
    let lens = LensChoice::Model(LensModel::Rational);
    let options = CameraOptions { lens, shutter: Shutter::Global, ..CameraOptions::default() };
    let problem = CameraProblem { image_size: ImageSize::new(640, 480), views };
    let solved = solve_views(&problem, &options).unwrap();
    assert_eq!(solved.estimate.lens.distortion.as_rational().unwrap()[6..], [0.0; 2]);
    let reasons = solved.verdict.reasons.join("; ");
    assert!(!reasons.contains("cancel"), "{reasons}");
}

/// Six or seven views hardly show whether rows were read one after another: what that would change
/// is in their deviations.
#[test]
fn halves_of_few_views_agree_within_their_deviations() {
    let Some(views) = sample_views("right") else { return };
    let mut rng = ChaCha8Rng::seed_from_u64(7);
    let (mut square, mut count) = (0.0, 0.0);
    for _ in 0..12 {
        let mut order: Vec<usize> = (0..views.len()).collect();
        order.shuffle(&mut rng);
        let (first, second) = order.split_at(views.len() / 2);
        let [a, b] = [first, second].map(|half| {
            let mut half = half.to_vec();
            half.sort_unstable();
            solved(half.into_iter().map(|k| views[k].clone()).collect()).estimate
        });
        let (a_std, b_std) = (a.lens_std(), b.lens_std());
        let differences = a.lens.parameters().into_iter().zip(b.lens.parameters());
        for (k, (of_a, of_b)) in differences.take(4).enumerate() {
            square += ((of_a - of_b) / a_std[k].hypot(b_std[k])).powi(2);
            count += 1.0;
        }
    }
    let ratio = (square / count).sqrt();
    assert!((0.5..1.4).contains(&ratio), "{ratio}");
}

/// Some are as sharp as pixels can show, with edges midway between two rows of them.
#[test]
fn every_small_board_on_a_large_plate_is_found() {
    assert_all_whole("opencv-extra-subpixel", 33, "4x5");
}
