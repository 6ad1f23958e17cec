//! The board that is seen in place of the one that was asked for is named.

use plumb::detection::board_detection::DetectOptions;
use plumb::detection::coded::recognition::recognize;
use plumb::detection::finder::{RECOGNIZED_EVERY, TargetFinder};
use plumb::detection::stated_board::{SeenBoard, WronglyStated};
use plumb::geometry::dictionary::Dictionary;
use plumb::geometry::target::{CharucoBoard, Target, chessboard};
use plumb::imaging::gray::GrayImage;

use crate::coded_targets::{april_grid, charuco, image};
use crate::real_boards::decoded;
use crate::shared_data::shared_data;

/// Frames for which a chessboard may be lost before another board is searched for.
const A_SECOND: u32 = RECOGNIZED_EVERY;

/// Why the board is not found in an image alone.
fn reason_of(finder: &mut TargetFinder, image: &GrayImage) -> String {
    finder.find(image.view(), &DetectOptions::default()).expect_err("another board").to_string()
}

#[test]
fn another_board_with_markers_is_named() {
    let board = charuco("DICT_4X4_50", 5, true);
    let shown = Target::Charuco(CharucoBoard { marker_m: 0.02, ..board });
    let asked = Target::Charuco(charuco("DICT_5X5_100", 6, false));
    let (image, _) = image(&shown, 400);
    let mut finder = TargetFinder::new(&asked);
    let reason = reason_of(&mut finder, &image);
    for word in ["7x5 ChArUco board (DICT_4X4_50)", "of a square", "7x6 ChArUco board"] {
        assert!(reason.contains(word), "{reason}");
    }
    // In a sequence the name stands while that board is seen.
    for _ in 0..3 {
        let none = finder.track(image.view(), &DetectOptions::default());
        assert_eq!(none.expect_err("another board").to_string(), reason);
    }
    let plain = chessboard(6, 5, 0.04).expect("a board");
    assert_eq!(recognize(self::image(&plain, 601).0.view()), None);
}

#[test]
fn a_board_with_markers_is_named_where_a_chessboard_is_asked_for() {
    let asked = chessboard(9, 6, 0.04).expect("a board");
    let options = DetectOptions::default();
    for (shown, name) in [
        (Target::Charuco(charuco("DICT_5X5_100", 6, true)), "7x6 ChArUco board (DICT_5X5"),
        (Target::AprilGrid(april_grid("tag36h11", 2, 0)), "AprilGrid (tag36h11)"),
    ] {
        let (image, _) = image(&shown, 402);
        let mut finder = TargetFinder::new(&asked);
        let reason = reason_of(&mut finder, &image);
        assert!(reason.contains(name) && reason.contains("not the 9x6 chessboard"), "{reason}");
        for _ in 0..3 {
            let none = finder.track(image.view(), &options).expect_err("another board");
            assert_eq!(none.to_string(), reason);
        }
        // Where the chessboard was found before, another one is named after a second.
        let (own, _) = self::image(&asked, 403);
        finder.track(own.view(), &options).expect("the board that is asked for");
        for frame in 0..=A_SECOND {
            let none = finder.track(image.view(), &options).expect_err("another board");
            assert_eq!(frame == A_SECOND, none.kind() == "other_board", "frame {frame}: {none}");
        }
    }
}

/// Photographs of a webcam: nobody who asks for a chessboard there should read of a small one.
#[test]
fn a_real_charuco_board_is_named_where_a_chessboard_is_asked_for() {
    let Some(folder) = shared_data("charuco-lifecam") else { return };
    let folder = folder.join("2024-05-07_lifecam_1280");
    let mut photographs: Vec<_> =
        std::fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().path()).collect();
    photographs.sort();
    let mut finder = TargetFinder::new(&chessboard(9, 6, 0.04).expect("a board"));
    let mut is_named = |path: &std::path::PathBuf| {
        reason_of(&mut finder, &decoded(path)).contains("ChArUco board (DICT_4X4")
    };
    let named = photographs.iter().take(8).filter(|path| is_named(path)).count();
    assert!(named >= 6, "named in {named} of 8");
}

/// How these images of a board differ from what is stated of it.
fn wrongly(images: &[GrayImage], stated: &CharucoBoard) -> String {
    let seen: Vec<SeenBoard> =
        images.iter().filter_map(|image| SeenBoard::of(image.view(), stated)).collect();
    assert_eq!(seen.len(), images.len(), "it is found all the same");
    WronglyStated::by(stated, &seen).map_or_else(String::new, |wrongly| wrongly.to_string())
}

/// Of a board without the legacy layout, or with an odd number of rows, the first rows are as those
/// of one with more.
fn is_named_if_wrongly_stated(images: &[GrayImage], board: &CharucoBoard, may_differ: bool) {
    assert_eq!(wrongly(images, board), "");
    for more in [-0.15, 0.08] {
        let marker_m = board.marker_m + more * board.square_m;
        let line = wrongly(images, &CharucoBoard { marker_m, ..*board });
        let stated = format!("of a square, not {:.2}", marker_m / board.square_m);
        assert!(line.contains(&stated) && !line.contains("rows"), "{line}");
    }
    for rows in [board.rows - 1, board.rows + 1] {
        if may_differ {
            let line = wrongly(images, &CharucoBoard { rows, ..*board });
            let expected = format!("{} rows of squares are seen, not {rows}", board.rows);
            assert!(line.contains(&expected) && !line.contains("markers"), "{line}");
        }
    }
}

#[test]
fn a_real_board_that_is_stated_wrongly_is_named() {
    let board = |cols, square_m, marker_m, dictionary| CharucoBoard {
        cols,
        rows: 8,
        square_m,
        marker_m,
        dictionary: Dictionary::named(dictionary).unwrap(),
        first_id: 0,
        legacy: None,
    };
    let lifecam = board(8, 0.0254, 0.01905, "DICT_4X4_1000");
    let wpical = board(12, 0.018009, 0.013995, "DICT_5X5_1000");
    for (folder, board, is_legacy) in [
        ("charuco-lifecam/2024-05-07_lifecam_1280", lifecam, false),
        ("charuco-lifecam/2024-06-19_lifecam_480_Old_Pattern", lifecam, true),
        ("charuco-wpical/images", wpical, false),
    ] {
        let Some(folder) = shared_data(folder) else { return };
        let mut photographs: Vec<_> =
            std::fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().path()).collect();
        photographs.sort();
        let images: Vec<GrayImage> = photographs[..3].iter().map(|path| decoded(path)).collect();
        is_named_if_wrongly_stated(&images, &board, !is_legacy);
    }
}
