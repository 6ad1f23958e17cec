//! The textbook's exercises (Principles of Robot Autonomy, chapter 6) on its own photographs: board
//! coordinates, homographies, the camera matrix in closed form, the extrinsics for a given camera
//! matrix, world to pixel.

use std::path::Path;

use nalgebra::{Point2, Point3};
use plumb::detection::board_detection::{DetectOptions, Detection};
use plumb::detection::detector::Detector;
use plumb::estimation::zhang::{Skew, camera_from_board, camera_matrix_in_pixels};
use plumb::geometry::board::{BoardSize, Chessboard};
use plumb::geometry::camera_matrix::CameraMatrix;
use plumb::geometry::homography::Homography;
use plumb::geometry::lens::Lens;
use plumb::imaging::decode::luma;
use plumb::imaging::frame::SensorKind;
use plumb::imaging::gray::GrayImage;
use plumb::imaging::image_file::frame_from_file;

use crate::shared_data::shared_data;

/// The photographs that the exercise uses.
const NUMBERS: [u32; 9] = [1, 4, 9, 13, 14, 15, 16, 17, 23];
/// The camera matrix that the exercise gives, from these photographs in closed form with skew.
const PUBLISHED: CameraMatrix = CameraMatrix {
    fx: 471.876_619_74,
    fy: 435.608_046_8,
    cx: 289.246_942_23,
    cy: 219.344_184_27,
    skew: 8.080_646_42,
};

fn board() -> Chessboard {
    Chessboard::new(BoardSize::new(9, 7).unwrap(), 0.0205).unwrap()
}

/// Board points and pixels of each photograph; `None` where the photographs are absent.
#[expect(clippy::type_complexity, reason = "a list of lists of pairs is what it is")]
fn photographs() -> Option<Vec<Vec<(Point2<f64>, Point2<f64>)>>> {
    let folder = shared_data("pora")?;
    let mut detector = Detector::new(board().size);
    let pairs = |number: &u32| {
        pairs_of(&find(&mut detector, &folder.join(format!("board-{number:02}.png"))))
    };
    Some(NUMBERS.iter().map(pairs).collect())
}

fn find(detector: &mut Detector, path: &Path) -> Detection {
    let mut image = GrayImage::default();
    luma(&frame_from_file(SensorKind::Color, std::fs::read(path).unwrap()), &mut image).unwrap();
    let found = detector.find_board(image.view(), &DetectOptions::default());
    found.unwrap_or_else(|no_board| panic!("{}: {no_board}", path.display()))
}

fn pairs_of(detection: &Detection) -> Vec<(Point2<f64>, Point2<f64>)> {
    let pair = |corner: &plumb::detection::board_detection::DetectedCorner| {
        let point = board().corner_in_board(corner.index.col, corner.index.row);
        (point.xy(), Point2::new(corner.pixel.x, corner.pixel.y))
    };
    detection.corners.iter().map(pair).collect()
}

fn homographies(photographs: &[Vec<(Point2<f64>, Point2<f64>)>]) -> Vec<Homography> {
    photographs.iter().map(|pairs| Homography::fit(pairs).unwrap()).collect()
}

#[test]
fn board_coordinates() {
    let points = board().corners_in_board();
    assert_eq!(points.len(), 63);
    assert_eq!((points[0], points[8]), (Point3::origin(), Point3::new(8.0 * 0.0205, 0.0, 0.0)));
    assert_eq!(points[62], Point3::new(8.0 * 0.0205, 6.0 * 0.0205, 0.0));
}

#[test]
fn homographies_map_the_board_onto_its_image() {
    let Some(photographs) = photographs() else { return };
    for (number, (pairs, homography)) in
        NUMBERS.iter().zip(photographs.iter().zip(homographies(&photographs)))
    {
        let rms_px = homography.rms(pairs);
        assert!(rms_px < 1.0, "board-{number:02}: {rms_px} px");
    }
}

/// From the corners that the exercise itself uses (`cv::findChessboardCorners`, unrefined, as
/// `tests/python/textbook.py` writes them): the closed form is so sensitive on these photographs
/// that better corners move fx by 1 %.
#[test]
fn the_camera_matrix_in_closed_form_is_the_published_one() {
    let corners: Vec<Vec<[f64; 2]>> =
        serde_json::from_str(include_str!("textbook_corners.json")).unwrap();
    let points = board().corners_in_board();
    let pairs = |pixels: &Vec<[f64; 2]>| -> Vec<(Point2<f64>, Point2<f64>)> {
        assert_eq!(pixels.len(), points.len());
        points.iter().zip(pixels).map(|(point, pixel)| (point.xy(), Point2::from(*pixel))).collect()
    };
    let photographs: Vec<_> = corners.iter().map(pairs).collect();
    let found = camera_matrix_in_pixels(&homographies(&photographs), Skew::Free).unwrap();
    assert_published(found, 0.005);
}

#[test]
fn its_own_corners_give_nearly_the_same_camera_matrix() {
    let Some(photographs) = photographs() else { return };
    assert_published(
        camera_matrix_in_pixels(&homographies(&photographs), Skew::Free).unwrap(),
        0.02,
    );
}

fn assert_published(found: CameraMatrix, by: f64) {
    let table = [
        ("fx", found.fx, PUBLISHED.fx),
        ("fy", found.fy, PUBLISHED.fy),
        ("cx", found.cx, PUBLISHED.cx),
        ("cy", found.cy, PUBLISHED.cy),
    ];
    for (name, found, published) in table {
        assert!((found / published - 1.0).abs() < by, "{name}: {found}, published {published}");
    }
    // Skew is a small difference of large numbers: what it is compared with is the focal length.
    assert!((found.skew - PUBLISHED.skew).abs() < by * PUBLISHED.fx, "skew: {}", found.skew);
}

#[test]
fn extrinsics_for_the_given_camera_matrix_put_the_board_where_it_is_seen() {
    let Some(photographs) = photographs() else { return };
    let lens = Lens::pinhole(PUBLISHED);
    for (number, (pairs, homography)) in
        NUMBERS.iter().zip(photographs.iter().zip(homographies(&photographs)))
    {
        let camera_from_board = camera_from_board(PUBLISHED, &homography).unwrap();
        let rotation = camera_from_board.rotation_matrix();
        assert!((rotation.transpose() * rotation - nalgebra::Matrix3::identity()).norm() < 1e-12);
        assert!(
            (0.2..2.0).contains(&camera_from_board.translation().z),
            "board-{number:02}: {camera_from_board:?}"
        );
        let squares = pairs.iter().map(|(point, pixel)| {
            let seen = lens
                .pixel_from_point(&(camera_from_board * Point3::new(point.x, point.y, 0.0)))
                .unwrap();
            (seen.x - pixel.x).powi(2) + (seen.y - pixel.y).powi(2)
        });
        let rms_px = (squares.sum::<f64>() / pairs.len() as f64).sqrt();
        assert!(rms_px < 5.0, "board-{number:02}: {rms_px} px");
    }
}
