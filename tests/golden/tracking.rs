//! A board followed from image to image: as right as a search, whatever the board does between
//! two images.

use nalgebra::{Matrix3, Rotation2};
use plumb::detection::board_detection::DetectOptions;
use plumb::detection::detector::Detector;
use plumb::detection::tracking::TrackedBoard;
use plumb::geometry::board::BoardSize;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

use crate::detection::{Light, Occluder, Scene, pixel_from_board};

const BOARDS: [&str; 6] = ["9x6", "7x5", "5x4", "4x4", "6x9", "8x5"];

/// Images of one board in one light.
struct Stream {
    rng: ChaCha8Rng,
    board: BoardSize,
    light: Light,
    inverted: bool,
    pixel_from_board: Matrix3<f64>,
    /// How it goes on from one image to the next.
    motion: Matrix3<f64>,
}

impl Stream {
    fn new(seed: u64, board: BoardSize) -> Self {
        let mut rng = ChaCha8Rng::seed_from_u64(900_000 + seed);
        let pixel_from_board = pixel_from_board(&mut rng, board, false);
        let inverted = rng.random_bool(0.3);
        let light = Light::new(&mut rng, inverted);
        let motion = Matrix3::identity();
        Self { rng, board, light, inverted, pixel_from_board, motion }
    }

    fn scene(&mut self, occluder: Option<&Occluder>) -> Scene {
        Scene::of(
            &mut self.rng,
            &self.pixel_from_board,
            self.board,
            occluder,
            (&self.light, self.inverted),
        )
    }

    /// Moves on, with a little more or less speed; goes back where the board would leave the
    /// image.
    fn walk(&mut self, speed_px: f64) {
        let mut change = |most: f64| self.rng.random_range(-most..most);
        let rotation = Rotation2::new(change(0.01));
        let (x, y, scale) = (change(speed_px), change(speed_px), 1.0 + change(0.01));
        let about = Matrix3::new_translation(&nalgebra::Vector2::new(119.5, 89.5));
        let step = about
            * Matrix3::new_scaling(scale)
            * rotation.to_homogeneous()
            * about.try_inverse().unwrap();
        self.motion = Matrix3::new_translation(&nalgebra::Vector2::new(x, y)) * step;
        let next = self.motion * self.pixel_from_board;
        if inside(&next, self.board) {
            self.pixel_from_board = next;
        }
    }

    /// What no stream should do: a jump by whole squares, a half turn, or to somewhere else.
    fn jump(&mut self) {
        let (cols, rows) = (f64::from(self.board.cols), f64::from(self.board.rows));
        let by = |c: f64, r: f64| Matrix3::new_translation(&nalgebra::Vector2::new(c, r));
        let half_turn = Matrix3::new(-1.0, 0.0, cols - 1.0, 0.0, -1.0, rows - 1.0, 0.0, 0.0, 1.0);
        let jumps = [
            by(1.0, 0.0),
            by(0.0, 2.0),
            by(1.0, 1.0),
            by(-2.0, 0.0),
            by(0.5, 0.0),
            by(0.0, -0.7),
            half_turn,
        ];
        let chosen = self.rng.random_range(0..jumps.len() + 1);
        self.pixel_from_board = match jumps.get(chosen) {
            Some(jump) => self.pixel_from_board * jump,
            None => pixel_from_board(&mut self.rng, self.board, false),
        };
    }
}

fn inside(pixel_from_board: &Matrix3<f64>, board: BoardSize) -> bool {
    let (c, r) = (f64::from(board.cols), f64::from(board.rows));
    [(-1.0, -1.0), (c, -1.0), (-1.0, r), (c, r)].into_iter().all(|(c, r)| {
        let p = pixel_from_board * nalgebra::Vector3::new(c, r, 1.0);
        p.z > 0.0 && (2.0..237.0).contains(&(p.x / p.z)) && (2.0..177.0).contains(&(p.y / p.z))
    })
}

fn search(detector: &mut Detector, scene: &Scene) -> Option<TrackedBoard> {
    let tracked =
        detector.track_board(scene.image.view(), &DetectOptions { allow_partial: false }).ok()?;
    assert!(scene.is_right(&tracked.detection), "board {}: {tracked:?}", scene.board);
    Some(tracked)
}

#[test]
fn a_board_that_moves_is_followed() {
    let (mut followed, mut seen) = (0, 0);
    for (kind, board) in BOARDS.iter().enumerate() {
        for stream in 0..12 {
            let mut stream = Stream::new(10 * kind as u64 + stream, board.parse().unwrap());
            if stream.scene(None).shortest_step_px() < 9.0
                || !inside(&stream.pixel_from_board, stream.board)
            {
                continue;
            }
            let mut detector = Detector::new(stream.board);
            for number in 0..16 {
                let tracked = search(&mut detector, &stream.scene(None));
                if number > 0 {
                    seen += 1;
                    followed += u32::from(tracked.is_some_and(|tracked| tracked.followed));
                }
                stream.walk(1.5);
            }
        }
    }
    assert!(seen > 100 && followed * 100 >= 97 * seen, "{followed} of {seen} followed");
}

#[test]
fn a_board_that_jumps_is_searched_again_and_never_mislabeled() {
    let (mut found, mut seen) = (0, 0);
    for (kind, board) in BOARDS.iter().enumerate() {
        for stream in 0..3 {
            let mut stream = Stream::new(500 + 10 * kind as u64 + stream, board.parse().unwrap());
            let mut detector = Detector::new(stream.board);
            for number in 0..20 {
                let occluder = (number % 7 == 5).then(|| Occluder::new(&mut stream.rng));
                let scene = stream.scene(occluder.as_ref());
                let whole_board = inside(&stream.pixel_from_board, stream.board)
                    && scene.shortest_step_px() > 8.0;
                let tracked = search(&mut detector, &scene);
                if number % 7 != 5 && whole_board {
                    seen += 1;
                    found += u32::from(tracked.is_some());
                }
                stream.jump();
                if !inside(&stream.pixel_from_board, stream.board) && stream.rng.random_bool(0.5) {
                    stream.pixel_from_board =
                        pixel_from_board(&mut stream.rng, stream.board, false);
                }
            }
        }
    }
    assert!(seen > 60 && found * 100 >= 95 * seen, "{found} of {seen} found");
}

#[test]
fn another_board_in_its_place_is_not_taken_for_it() {
    for seed in 0..12 {
        let mut stream = Stream::new(2000 + seed, "7x5".parse().unwrap());
        let mut detector = Detector::new(stream.board);
        search(&mut detector, &stream.scene(None));
        let board = stream.board;
        for other in ["8x5", "7x6", "9x7"] {
            // One more line of squares, the others where they were.
            stream.board = other.parse().unwrap();
            if !inside(&stream.pixel_from_board, stream.board) {
                continue;
            }
            let scene = stream.scene(None);
            let answer = detector.track_board(scene.image.view(), &DetectOptions::default());
            assert!(answer.is_err(), "a {other} board is answered as {board}: {answer:?}");
            stream.board = board;
            search(&mut detector, &stream.scene(None));
        }
    }
}

#[test]
fn a_smaller_board_in_its_place_is_answered_as_by_a_search() {
    for (asked, shown) in [("7x6", "7x5"), ("7x6", "6x6"), ("9x6", "8x6"), ("5x4", "4x4")] {
        for (seed, allow_partial) in (0..16).flat_map(|seed| [(seed, false), (seed, true)]) {
            let mut stream = Stream::new(7000 + seed, asked.parse().unwrap());
            let mut detector = Detector::new(stream.board);
            let board = stream.board;
            search(&mut detector, &stream.scene(None));
            stream.board = shown.parse().unwrap();
            let scene = stream.scene(None);
            let options = DetectOptions { allow_partial };
            let tracked = detector.track_board(scene.image.view(), &options).ok();
            let searched = Detector::new(board).find_board(scene.image.view(), &options).ok();
            assert!(tracked.as_ref().is_none_or(|it| !it.followed), "{asked} as {shown}, {seed}");
            assert_eq!(tracked.map(|it| it.detection), searched, "{asked} as {shown}, {seed}");
        }
    }
}

/// Of all that `a_smaller_board_in_its_place` shows, and other such images, those in which coarse
/// pixels hide a line of corners that the image itself shows.
#[test]
fn a_board_that_goes_on_is_not_taken_for_a_smaller_one() {
    for (asked, shown, seed) in [("4x4", "5x4", 106), ("4x4", "5x4", 128), ("7x5", "7x6", 1)] {
        let mut stream = Stream::new(7000 + seed, asked.parse().unwrap());
        let board = stream.board;
        stream.board = shown.parse().unwrap();
        let scene = stream.scene(None);
        let answer = Detector::new(board).find_board(scene.image.view(), &DetectOptions::default());
        assert!(answer.is_err(), "a {shown} board, {seed}, is answered as {asked}: {answer:?}");
    }
}

#[test]
fn the_same_images_give_the_same_bits() {
    let walk = || {
        let mut stream = Stream::new(3000, "9x6".parse().unwrap());
        let mut detector = Detector::new(stream.board);
        let answers = (0..12).map(|_| {
            stream.walk(2.0);
            detector.track_board(stream.scene(None).image.view(), &DetectOptions::default())
        });
        answers.collect::<Vec<_>>()
    };
    let (once, again) = (walk(), walk());
    assert!(once.iter().flatten().any(|tracked| tracked.followed));
    assert_eq!(once, again);
}

#[test]
fn the_std_of_followed_corners_covers_their_error() {
    let (mut squares, mut count) = (0.0, 0);
    for seed in 0..8 {
        let mut stream = Stream::new(4000 + seed, "7x5".parse().unwrap());
        let mut detector = Detector::new(stream.board);
        for _ in 0..8 {
            let scene = stream.scene(None);
            let Some(TrackedBoard { detection, followed: true }) = search(&mut detector, &scene)
            else {
                stream.walk(1.0);
                continue;
            };
            let mut refined = Detector::new(stream.board);
            let searched =
                refined.find_board(scene.image.view(), &DetectOptions::default()).unwrap();
            for (corner, exact) in detection.corners.iter().zip(&searched.corners) {
                squares += (corner.pixel.distance_px(exact.pixel) / corner.std_px).powi(2) / 2.0;
                count += 1;
            }
            stream.walk(1.0);
        }
    }
    let ratio = (squares / f64::from(count)).sqrt();
    assert!(count > 500 && (0.4..1.3).contains(&ratio), "error/std {ratio:.2} of {count} corners");
}
