//! Where no board is answered, the reason is the true one: a rendered image for each.

use plumb::detection::board_detection::{DetectOptions, Detection, NoBoard};
use plumb::detection::detector::Detector;
use plumb::geometry::board::BoardSize;
use plumb::imaging::gray::GrayImage;

const BOARD: BoardSize = BoardSize { cols: 9, rows: 6 };

/// A board of `cols` × `rows` inner corners, seen straight on, with the middle of its squares at
/// `middle`.
pub(crate) struct Straight {
    pub(crate) size: (usize, usize),
    pub(crate) corners: (u32, u32),
    pub(crate) square_px: f64,
    pub(crate) middle: (f64, f64),
    pub(crate) colors: [f64; 2],
    pub(crate) blur_px: f64,
}

impl Straight {
    pub(crate) fn new(square_px: f64) -> Self {
        Self {
            size: (320, 240),
            corners: (9, 6),
            square_px,
            middle: (160.0, 120.0),
            colors: [40.0, 210.0],
            blur_px: 0.7,
        }
    }

    pub(crate) fn image(&self) -> GrayImage {
        let (width, height) = self.size;
        let pixels = (0..width * height)
            .map(|at| self.light((at % width) as f64, (at / width) as f64) as u8)
            .collect();
        GrayImage::from_pixels(width, height, pixels).unwrap()
    }

    /// Squares in blur: a product of two waves, each blurred along its own axis, on white paper.
    fn light(&self, x: f64, y: f64) -> f64 {
        let [dark, bright] = self.colors;
        let (across, within_x) = self.wave(x - self.middle.0, self.corners.0);
        let (down, within_y) = self.wave(y - self.middle.1, self.corners.1);
        bright + (dark - bright) * 0.5 * (within_x * within_y + across * down)
    }

    /// 1 and −1 alternating from square to square, and 1 from the first to the last.
    fn wave(&self, at: f64, corners: u32) -> (f64, f64) {
        let last = corners + 1;
        let rise = |k: u32| {
            step((at - (f64::from(k) - f64::from(last) / 2.0) * self.square_px) / self.blur_px)
        };
        let sign = |k: u32| if k.is_multiple_of(2) { 1.0 } else { -1.0 };
        let inner: f64 = (1..last).map(|k| 2.0 * sign(k) * rise(k)).sum();
        (rise(0) + inner + sign(last) * rise(last), rise(0) - rise(last))
    }
}

/// A step in blur of one, by a logistic curve.
fn step(t: f64) -> f64 {
    1.0 / (1.0 + (-1.702 * t).exp())
}

fn search(image: &GrayImage, allow_partial: bool) -> Result<Detection, NoBoard> {
    Detector::new(BOARD).find_board(image.view(), &DetectOptions { allow_partial })
}

fn reason(board: &Straight) -> NoBoard {
    search(&board.image(), false).expect_err("no board")
}

#[test]
fn the_board_itself_is_found() {
    let found = search(&Straight::new(24.0).image(), false).unwrap();
    assert_eq!(found.corners.len(), 54);
}

#[test]
fn a_flat_image_has_too_little_contrast() {
    let flat = Straight { colors: [100.0, 104.0], ..Straight::new(24.0) };
    assert!(
        matches!(reason(&flat), NoBoard::LowContrast { range } if range <= 4),
        "{}",
        reason(&flat)
    );
}

#[test]
fn an_image_out_of_focus_is_too_blurred() {
    for blur_px in [22.0, 30.0] {
        let soft = Straight { blur_px, ..Straight::new(24.0) };
        let reason = reason(&soft);
        assert!(matches!(reason, NoBoard::Blurred { blur_px } if blur_px > 4.0), "{reason}");
        assert_eq!(reason.kind(), "blurred");
    }
}

#[test]
fn a_board_of_another_size_is_named_with_its_size() {
    let other = Straight { corners: (7, 5), ..Straight::new(24.0) };
    let reason = reason(&other);
    assert_eq!(reason, NoBoard::OtherSize { cols: 7, rows: 5, board: BOARD });
    assert!(reason.to_string().starts_with("a board of 7x5 is seen, not 9x6"), "{reason}");
}

#[test]
fn a_board_beyond_the_border_is_cut_off() {
    for middle in [(90.0, 120.0), (160.0, 60.0), (240.0, 150.0)] {
        let cut = Straight { middle, ..Straight::new(24.0) };
        let reason = reason(&cut);
        assert!(
            matches!(reason, NoBoard::CutOff { seen, .. } if (20..54).contains(&seen)),
            "{middle:?}: {reason}"
        );
        let part = search(&cut.image(), true).unwrap();
        assert!(part.partial);
    }
}

#[test]
fn an_occluded_board_is_incomplete() {
    let mut pixels = Straight::new(24.0).image().into_pixels();
    for y in 90..135 {
        pixels[y * 320 + 120..y * 320 + 190].fill(128);
    }
    let occluded = GrayImage::from_pixels(320, 240, pixels).unwrap();
    let reason = search(&occluded, false).expect_err("occluded");
    assert!(
        matches!(reason, NoBoard::Incomplete { seen, .. } if (30..54).contains(&seen)),
        "{reason}"
    );
}

/// The image of `board` with its pixels changed by `paint`, given their column and row.
fn painted(board: &Straight, paint: impl Fn(usize, usize, u8) -> u8) -> GrayImage {
    let width = board.size.0;
    let mut pixels = board.image().into_pixels();
    for (at, pixel) in pixels.iter_mut().enumerate() {
        *pixel = paint(at % width, at / width, *pixel);
    }
    GrayImage::from_pixels(width, board.size.1, pixels).unwrap()
}

#[test]
fn a_corner_of_something_beyond_the_board_does_not_hide_it() {
    // The squares end at row 204, where the next line of corners would be. The side between a dark
    // and a bright square meets there the edge of something gray below the bright one.
    for gray in [130, 140, 150] {
        let beyond = painted(
            &Straight::new(24.0),
            |x, y, light| {
                if y >= 204 && x >= 208 { gray } else { light }
            },
        );
        for allow_partial in [false, true] {
            let found =
                search(&beyond, allow_partial).unwrap_or_else(|none| panic!("{gray}: {none}"));
            assert_eq!((found.corners.len(), found.partial), (54, false), "{gray}");
        }
    }
}

#[test]
fn a_single_corner_of_a_further_line_is_that_of_a_larger_board() {
    // Corners with a spacing of 22 px, from 72 to 248 and from 54 to 186: of the seventh line one
    // is left, whatever hides the others.
    let larger = Straight { corners: (9, 7), ..Straight::new(22.0) };
    for (corner, light) in [(72, 210), (72, 128), (160, 128), (160, 210), (248, 40), (248, 128)] {
        for around in [10, 13, 16] {
            let hidden = painted(&larger, |x, y, seen| {
                if y >= 172 && x.abs_diff(corner) > around { light } else { seen }
            });
            for allow_partial in [false, true] {
                let found = search(&hidden, allow_partial);
                assert!(
                    found.is_err(),
                    "{corner}, {light}, {around}: {:?}",
                    found.map(|f| f.corners.len())
                );
            }
        }
    }
}

#[test]
fn an_image_too_small_for_the_board_says_so() {
    let reason = search(&GrayImage::filled(30, 20, 0), false).expect_err("too small");
    assert!(matches!(reason, NoBoard::ImageTooSmall { .. }), "{reason}");
}

#[test]
fn an_image_without_a_board_has_no_corners_of_one() {
    let stripes = (0..320 * 240).map(|at| if at % 320 / 16 % 2 == 0 { 40 } else { 200 }).collect();
    let reason =
        search(&GrayImage::from_pixels(320, 240, stripes).unwrap(), false).expect_err("stripes");
    assert!(matches!(reason, NoBoard::NoCorners | NoBoard::NoGrid { .. }), "{reason}");
}
