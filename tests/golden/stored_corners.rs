//! Beside corners that others found in the same photographs and stored: OpenCV's own test data.
//!
//! What is stored is no truth: in the first set it is good to about 0.1 px, in the second it is
//! what `cornerSubPix` with a window of 11×11 answers. A board is flat, so which of two answers is
//! nearer to it shows in how far each leaves a plane.

use std::path::{Path, PathBuf};

use nalgebra::Point2;
use plumb::detection::board_detection::{Detection, NoBoard};
use plumb::detection::detector::Detector;
use plumb::geometry::board::BoardSize;
use plumb::geometry::homography::Homography;
use plumb::geometry::pixel::Pixel;

use crate::real_boards::{images, search};
use crate::shared_data::shared_data;

fn find(path: &Path, board: &str, allow_partial: bool) -> Result<Detection, NoBoard> {
    search(&mut Detector::new(board.parse().unwrap()), path, allow_partial)
}

/// The matrix of points in OpenCV's YAML: its columns, its rows, and the points row by row.
fn stored(path: &Path) -> (BoardSize, Vec<Pixel>) {
    let text = std::fs::read_to_string(path).unwrap();
    let after = |key: &str| text.split_once(key).unwrap().1;
    let count = |key: &str| after(key).lines().next().unwrap().trim().parse::<u32>().unwrap();
    let numbers: Vec<f64> = after("data: [")
        .split_once(']')
        .unwrap()
        .0
        .split(',')
        .map(|number| number.trim().parse().unwrap())
        .collect();
    let pixels = numbers.chunks(2).map(|pair| Pixel::new(pair[0], pair[1])).collect();
    (BoardSize::new(count("cols:"), count("rows:")).unwrap(), pixels)
}

/// What was found beside what was stored.
struct Compared {
    /// Found less stored, 2-D: mean along x and y, rms and largest, in pixels.
    mean_px: [f64; 2],
    rms_px: f64,
    largest_px: f64,
    /// Rms distance from a plane in perspective, in pixels: found, stored.
    off_plane_px: [f64; 2],
}

/// Finds the board in `image` and compares its corners with those stored in `reference`, which
/// may count from another corner of the board.
fn compare(image: &Path, reference: &Path) -> Compared {
    let (board, stored) = stored(reference);
    let found = find(image, &board.to_string(), true).unwrap();
    assert!(!found.partial, "{}: {} corners", image.display(), found.corners.len());
    let (cols, rows) = (board.cols as usize, board.rows as usize);
    let slot = |symmetry: usize, k: usize| {
        let (col, row) = (k % cols, k / cols);
        let (col, row) = (
            if symmetry & 1 == 0 { col } else { cols - 1 - col },
            if symmetry & 2 == 0 { row } else { rows - 1 - row },
        );
        row * cols + col
    };
    let ordered =
        |symmetry: usize| (0..stored.len()).map(|k| stored[slot(symmetry, k)]).collect::<Vec<_>>();
    let squares = |stored: &[Pixel]| -> f64 {
        stored
            .iter()
            .zip(&found.corners)
            .map(|(stored, corner)| corner.pixel.distance_px(*stored).powi(2))
            .sum()
    };
    let stored = (0..4).map(ordered).min_by(|a, b| squares(a).total_cmp(&squares(b))).unwrap();
    let count = stored.len() as f64;
    let pixels: Vec<Pixel> = found.corners.iter().map(|corner| corner.pixel).collect();
    let differences = || {
        pixels.iter().zip(&stored).map(|(found, stored)| [found.x - stored.x, found.y - stored.y])
    };
    Compared {
        mean_px: [0, 1]
            .map(|axis| differences().map(|difference| difference[axis]).sum::<f64>() / count),
        rms_px: (squares(&stored) / count).sqrt(),
        largest_px: differences().map(|[x, y]| x.hypot(y)).fold(0.0, f64::max),
        off_plane_px: [off_plane_px(board, &pixels), off_plane_px(board, &stored)],
    }
}

/// Rms distance of a board's corners from the homography that fits them best.
fn off_plane_px(board: BoardSize, pixels: &[Pixel]) -> f64 {
    let place =
        |k: usize| Point2::new((k as u32 % board.cols).into(), (k as u32 / board.cols).into());
    let pairs: Vec<(Point2<f64>, Point2<f64>)> = pixels
        .iter()
        .enumerate()
        .map(|(k, pixel)| (place(k), Point2::new(pixel.x, pixel.y)))
        .collect();
    let image_from_board = Homography::fit(&pairs).unwrap();
    let squares: f64 = pairs
        .iter()
        .map(|(place, seen)| (image_from_board.apply(*place).unwrap() - seen).norm_squared())
        .sum();
    (squares / pairs.len() as f64).sqrt()
}

/// Compares all of `pairs` and prints the list.
fn compare_all(pairs: &[(PathBuf, PathBuf)]) -> Vec<(String, Compared)> {
    println!(
        "| image | mean x, y px | rms px | largest px | off a plane px: Plumb, stored |\n| --- | --- | --- | --- | --- |"
    );
    let compared = pairs.iter().map(|(image, reference)| {
        let name = image.file_stem().unwrap().to_string_lossy().into_owned();
        let compared = compare(image, reference);
        let Compared { mean_px: [x, y], rms_px, largest_px, off_plane_px: [ours, theirs] } =
            compared;
        println!(
            "| {name} | {x:.2}, {y:.2} | {rms_px:.2} | {largest_px:.2} | {ours:.3}, {theirs:.3} |"
        );
        (name, compared)
    });
    compared.collect()
}

#[test]
fn boards_of_opencv_s_chess_set_are_where_they_are_stored() {
    let Some(folder) = shared_data("opencv-extra-chess") else { return };
    let pairs: Vec<(PathBuf, PathBuf)> = (1..=9)
        .map(|k| (format!("chess{k}.png"), format!("chess_corners{k}.dat")))
        .chain(
            (1..=3)
                .map(|k| (format!("small_chessboard{k}.png"), format!("small_chessboard{k}.dat"))),
        )
        .map(|(image, reference)| (folder.join(image), folder.join(reference)))
        .collect();
    for (name, compared) in compare_all(&pairs) {
        // The eighth image is black and white only, its edges ragged by a pixel: OpenCV's own
        // refinement is up to 0.6 px off.
        let bound_px = if name == "chess8" { 1.0 } else { 0.5 };
        assert!(
            compared.largest_px < bound_px,
            "{name}: {} px from what is stored",
            compared.largest_px
        );
        let [ours, theirs] = compared.off_plane_px;
        assert!(
            ours < theirs,
            "{name}: {ours} px off a plane, where what is stored is {theirs} px off"
        );
    }
}

#[test]
fn both_cameras_of_opencv_s_stereo_board_see_all_of_it() {
    let Some(folder) = shared_data("opencv-extra-chess") else { return };
    for name in
        ["L", "R"].iter().flat_map(|side| (1..=6).map(move |k| format!("BoardStereo{side}{k}.png")))
    {
        let found = find(&folder.join(&name), "5x7", true).unwrap();
        assert!(
            !found.partial && found.corners.len() == 35,
            "{name}: {} corners",
            found.corners.len()
        );
    }
}

/// The image's border cuts off one or two of the board's corners.
#[test]
fn boards_that_opencv_calls_absent_are_never_whole() {
    let Some(folder) = shared_data("opencv-extra-chess") else { return };
    for k in 1..=3 {
        let image = folder.join(format!("negative_{k}.png"));
        assert!(find(&image, "6x7", false).is_err(), "negative_{k}");
        assert!(find(&image, "6x7", true).is_ok_and(|found| found.partial), "negative_{k}");
    }
}

#[test]
fn small_corners_lie_nearer_to_a_plane_than_those_stored() {
    let Some(paths) = images("opencv-extra-subpixel", 33) else { return };
    let pairs: Vec<(PathBuf, PathBuf)> =
        paths.into_iter().map(|path| (path.clone(), path.with_extension("yml"))).collect();
    let compared = compare_all(&pairs);
    let (mut mean, mut off_plane) = ([0.0; 2], [0.0; 2]);
    for (name, Compared { mean_px, largest_px, off_plane_px: [ours, theirs], .. }) in &compared {
        assert!(
            *largest_px < 0.6 && ours < theirs,
            "{name}: {largest_px} px away, {ours} px and {theirs} px off a plane"
        );
        for axis in 0..2 {
            mean[axis] += mean_px[axis] / 33.0;
        }
        off_plane[0] += ours * ours / 33.0;
        off_plane[1] += theirs * theirs / 33.0;
    }
    let [ours, theirs] = off_plane.map(f64::sqrt);
    println!(
        "all: mean {:.3}, {:.3} px; off a plane {ours:.3} px, stored {theirs:.3} px",
        mean[0], mean[1]
    );
    assert!(
        mean.iter().all(|mean| mean.abs() < 0.03),
        "{mean:?} px: another convention of where a pixel is"
    );
    assert!(ours < 0.5 * theirs, "{ours} px off a plane, where what is stored is {theirs} px off");
}
