//! A board with markers followed from image to image: never a wrong corner, whatever the board does
//! between two images.

use nalgebra::{Matrix3, Rotation2, Vector2, Vector3};
use plumb::detection::board_detection::DetectOptions;
use plumb::detection::coded::detector::TargetDetector;
use plumb::detection::coded::tracking::TrackedTarget;
use plumb::detection::finder::TargetFinder;
use plumb::geometry::dictionary::Dictionary;
use plumb::geometry::printed_board::PrintedBoard;
use plumb::geometry::target::{AprilGrid, CharucoBoard, Target};
use plumb::imaging::gray::GrayImage;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

use crate::coded_targets::{HEIGHT, WIDTH, paint};
use crate::printed_images::rendered;

fn charuco(rows: u32, first_id: u32, legacy: bool) -> Target {
    Target::Charuco(CharucoBoard {
        cols: 7,
        rows,
        square_m: 0.04,
        marker_m: 0.032,
        dictionary: Dictionary::named("DICT_4X4_250").expect("a dictionary"),
        first_id,
        legacy: Some(legacy),
    })
}

fn april_grid(first_id: u32) -> Target {
    Target::AprilGrid(AprilGrid {
        cols: 4,
        rows: 3,
        tag_m: 0.04,
        spacing: 0.3,
        family: Dictionary::named("tag36h11").expect("a family"),
        border_bits: Some(2),
        first_id,
    })
}

/// Images of one board.
struct Stream {
    rng: ChaCha8Rng,
    board: Target,
    pixel_from_sheet: Matrix3<f64>,
}

impl Stream {
    fn new(board: Target, seed: u64) -> Self {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        let print = PrintedBoard::of(&board);
        let scale = 0.7 * (WIDTH as f64 / print.width_m).min(HEIGHT as f64 / print.height_m);
        let (s, c) = rng.random_range(-0.4..0.4_f64).sin_cos();
        let slant = [0, 1].map(|_| rng.random_range(-0.7..0.7));
        let (x, y) = (print.width_m / 2.0, print.height_m / 2.0);
        let centered = Matrix3::new_translation(&Vector2::new(-x, -y));
        let (a, b) = (scale * c, scale * s);
        let slanted = Matrix3::new(a, -b, 0.0, b, a, 0.0, slant[0], slant[1], 1.0);
        let middle = Vector2::new(WIDTH as f64 / 2.0, HEIGHT as f64 / 2.0);
        let pixel_from_sheet = Matrix3::new_translation(&middle) * slanted * centered;
        Self { rng, board, pixel_from_sheet }
    }

    /// One image, exposed while the board goes through `places`.
    fn exposed(&mut self, places: &[Matrix3<f64>]) -> GrayImage {
        rendered(&PrintedBoard::of(&self.board), [WIDTH, HEIGHT], places, &mut self.rng)
    }

    fn image(&mut self) -> GrayImage {
        self.exposed(&[self.pixel_from_sheet])
    }

    /// A step of a hand, so many pixels at most, that leaves the middle of the board in the middle
    /// of the image.
    fn walk(&mut self, most_px: f64) {
        let print = PrintedBoard::of(&self.board);
        let [x, y] = self.pixel(print.width_m / 2.0, print.height_m / 2.0);
        let away = [x - WIDTH as f64 / 2.0, y - HEIGHT as f64 / 2.0];
        let [dx, dy] = away.map(|v| self.rng.random_range(-most_px..most_px) - 0.2 * v);
        let rotation = Rotation2::new(self.rng.random_range(-0.01..0.01)).to_homogeneous();
        let nearer = Matrix3::new_scaling(1.0 + self.rng.random_range(-0.01..0.01));
        let about = Matrix3::new_translation(&Vector2::new(x, y));
        let back = Matrix3::new_translation(&Vector2::new(-x, -y));
        let moved = Matrix3::new_translation(&Vector2::new(dx, dy));
        self.pixel_from_sheet = moved * about * rotation * nearer * back * self.pixel_from_sheet;
    }

    fn pixel(&self, x: f64, y: f64) -> [f64; 2] {
        let p = self.pixel_from_sheet * Vector3::new(x, y, 1.0);
        [p.x / p.z, p.y / p.z]
    }

    fn corner(&self, id: u32) -> [f64; 2] {
        let corner = PrintedBoard::of(&self.board).corner(&self.board, id).expect("an id");
        self.pixel(corner.x, corner.y)
    }

    /// What `detector` answers, which must be right.
    fn track(&self, detector: &mut TargetDetector, image: &GrayImage) -> Option<TrackedTarget> {
        let tracked = detector.track(image.view()).ok()?;
        for corner in &tracked.detection.corners {
            let [x, y] = self.corner(corner.id);
            let off = (corner.pixel.x - x).hypot(corner.pixel.y - y);
            let most = f64::max(0.75, 5.0 * corner.std_px);
            assert!(off < most, "{}: corner {} is {off} px off", self.board, corner.id);
        }
        Some(tracked)
    }
}

fn boards() -> [Target; 3] {
    [charuco(5, 0, false), charuco(6, 20, true), april_grid(0)]
}

fn detector(board: &Target) -> TargetDetector {
    // Layout and border are left for it to find.
    let asked = match *board {
        Target::Charuco(board) => Target::Charuco(CharucoBoard { legacy: None, ..board }),
        Target::AprilGrid(grid) => Target::AprilGrid(AprilGrid { border_bits: None, ..grid }),
        plain => plain,
    };
    TargetDetector::new(asked).expect("a target with markers")
}

#[test]
fn a_board_that_moves_is_followed_to_within_its_std() {
    let (mut followed, mut images) = (0, 0);
    let (mut corners, mut searched, mut squares) = (0, 0, 0.0);
    for (kind, board) in boards().into_iter().enumerate() {
        for seed in 0..2 {
            let mut stream = Stream::new(board, 10 * kind as u64 + seed);
            let (mut tracker, mut searcher) = (detector(&board), detector(&board));
            for number in 0..7 {
                let image = stream.image();
                let tracked = stream.track(&mut tracker, &image).expect("a board in full view");
                let exact = searcher.find(image.view()).expect("a board in full view");
                if number > 0 {
                    images += 1;
                    followed += usize::from(tracked.followed);
                    assert_eq!(tracked.detection.markers, exact.markers);
                }
                searched += exact.corners.len();
                for corner in tracked.detection.corners.iter().filter(|_| tracked.followed) {
                    let Some(exact) = exact.corners.iter().find(|it| it.id == corner.id) else {
                        continue;
                    };
                    let off_px = corner.pixel.distance_px(exact.pixel);
                    squares += (off_px / corner.std_px).powi(2) / 2.0;
                    corners += 1;
                }
                stream.walk(5.0);
            }
        }
    }
    assert!(followed == images, "{followed} of {images} images followed");
    // But for the six first images.
    assert!(corners * 100 >= 97 * (searched * 6 / 7), "{corners} of {searched} corners");
    let ratio = (squares / corners as f64).sqrt();
    println!("{corners} of {searched} corners, error over std {ratio:.2}");
    assert!((0.6..1.4).contains(&ratio), "error over std {ratio:.2}");
}

#[test]
fn a_board_that_jumps_by_squares_keeps_its_ids() {
    for (kind, board) in boards().into_iter().enumerate() {
        let step = if kind == 2 { 0.052 } else { 0.04 };
        let mut stream = Stream::new(board, 100 + kind as u64);
        let mut tracker = detector(&board);
        let mut found = 0;
        let jumps = [
            (1.0, 0.0),
            (0.0, -1.0),
            (-2.0, 0.0),
            (0.5, 0.5),
            (0.5, -0.5),
            (0.0, 1.0),
            (0.25, 0.0),
        ];
        for (across, down) in jumps {
            let image = stream.image();
            found += usize::from(stream.track(&mut tracker, &image).is_some());
            let jump = Matrix3::new_translation(&Vector2::new(across * step, down * step));
            stream.pixel_from_sheet *= jump;
        }
        assert!(found >= 6, "{board}: {found} of 7");
    }
}

#[test]
fn another_board_in_its_place_is_not_taken_for_it() {
    for (kind, (board, others)) in [
        (charuco(5, 0, false), vec![charuco(5, 30, false), april_grid(0)]),
        (charuco(6, 0, false), vec![charuco(6, 1, false), charuco(6, 0, true)]),
        (april_grid(0), vec![april_grid(12), april_grid(1)]),
    ]
    .into_iter()
    .enumerate()
    {
        let mut stream = Stream::new(board, 200 + kind as u64);
        let mut tracker = TargetDetector::new(board).expect("a target with markers");
        for other in others {
            stream.board = board;
            let shown = stream.image();
            assert!(stream.track(&mut tracker, &shown).is_some());
            stream.board = other;
            let swapped = stream.image();
            let answer = tracker.track(swapped.view());
            assert!(answer.is_err(), "{other} for {board}: {answer:?}");
        }
        stream.board = board;
        let shown = stream.image();
        let again = stream.track(&mut tracker, &shown).expect("the board again");
        assert!(!again.followed);
    }
}

#[test]
fn an_occluder_that_enters_costs_what_it_covers() {
    let (mut answered, mut visible) = (0, 0);
    for (kind, board) in boards().into_iter().enumerate() {
        let mut stream = Stream::new(board, 300 + kind as u64);
        let mut tracker = detector(&board);
        for number in 0..9 {
            // It comes as far as the middle and goes.
            let edge = 60.0 * (4.0 - f64::from(4 - number).abs());
            let gray = 70.0 + 30.0 * kind as f64;
            let covered = |x: f64| (edge - x + 0.5).clamp(0.0, 1.0);
            let image = paint(&stream.image(), |x, _| (covered(x), gray));
            let tracked = stream.track(&mut tracker, &image);
            let ids = (0..board.corner_count() as u32).map(|slot| {
                let [cols, _] = board.corners_each_way();
                board.corner_id(slot % cols, slot / cols)
            });
            visible += ids.filter(|&id| stream.corner(id)[0] > edge + 5.0).count();
            answered += tracked.map_or(0, |it| it.detection.corners.len());
            stream.walk(2.0);
        }
    }
    assert!(answered * 100 >= 93 * visible, "{answered} of {visible} corners");
}

#[test]
fn motion_within_an_exposure_makes_no_corner_wrong() {
    let (mut answered, mut corners) = (0, 0);
    for (kind, board) in boards().into_iter().enumerate() {
        let mut stream = Stream::new(board, 400 + kind as u64);
        let mut tracker = detector(&board);
        for number in 0..6 {
            let length_px = [0.0, 4.0, 7.0, 4.0, 0.0, 0.0][number];
            let parts = if length_px > 0.0 { 8 } else { 1 };
            let place = |part: i32| {
                let along = length_px * ((f64::from(part) + 0.5) / f64::from(parts) - 0.5);
                let moved = Matrix3::new_translation(&Vector2::new(along * 0.8, along * 0.6));
                moved * stream.pixel_from_sheet
            };
            let places: Vec<Matrix3<f64>> = (0..parts).map(place).collect();
            let image = stream.exposed(&places);
            let tracked = stream.track(&mut tracker, &image);
            answered += tracked.map_or(0, |it| it.detection.corners.len());
            corners += board.corner_count();
            stream.walk(4.0);
        }
    }
    assert!(answered * 100 >= 90 * corners, "{answered} of {corners} corners");
}

#[test]
fn a_search_in_between_changes_nothing() {
    let board = charuco(5, 0, false);
    let (mut stream, mut other) = (Stream::new(board, 500), Stream::new(board, 501));
    let elsewhere = other.image();
    let images: Vec<GrayImage> = (0..4)
        .map(|_| {
            stream.walk(4.0);
            stream.image()
        })
        .collect();
    let options = DetectOptions::default();
    let (mut plain, mut disturbed) = (TargetFinder::new(&board), TargetFinder::new(&board));
    let mut followed = 0;
    for image in &images {
        let expected = plain.track(image.view(), &options).expect("a board");
        disturbed.find(elsewhere.view(), &options).expect("a board");
        assert_eq!(disturbed.track(image.view(), &options).expect("a board"), expected);
        followed += usize::from(expected.followed);
    }
    assert_eq!(followed, 3);
}
