//! Images of boards with markers under hard conditions drawn at random, with exact truth: what
//! `thresholds` searches beside chessboards.

use std::error::Error;

use image::GrayImage as Luma;
use image::codecs::jpeg::{JpegDecoder, JpegEncoder};
use nalgebra::{Matrix3, Vector3};
use plumb::detection::coded::answer::{LabeledCorner, TargetDetection};
use plumb::detection::coded::detector::TargetDetector;
use plumb::detection::thresholds::Thresholds;
use plumb::geometry::dictionary::Dictionary;
use plumb::geometry::pixel::Pixel;
use plumb::geometry::printed_board::PrintedBoard;
use plumb::geometry::target::{AprilGrid, CharucoBoard, Target};
use plumb::imaging::gray::GrayImage;
use rand::{Rng, RngExt};
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, Normal};

use crate::Score;

const WIDTH: usize = 640;
const HEIGHT: usize = 480;
/// Pixels of the print's raster per meter.
const RASTER_PER_M: f64 = 2500.0;
const PAPER_M: f64 = 0.02;
/// A corner farther off than this is wrong, in pixels.
const WRONG_PX: f64 = 1.5;

/// How far the board moves from an image to the next, in units of half the image's width.
const STEP: f64 = 0.01;

/// Two images of one board, between which it moves.
pub struct MarkerScene {
    asked: Target,
    /// Whether the board searched for is the one in the images.
    pub same_board: bool,
    images: [MarkerImage; 2],
}

/// An image, and the corners to be seen in it.
struct MarkerImage {
    pixels: GrayImage,
    /// Each corner by its id, and whether it is to be seen.
    corners: Vec<(u32, Pixel, bool)>,
}

/// What disturbs the image.
struct Disturbance {
    blur_px: f64,
    noise: f64,
    /// Difference of white and black, in gray levels.
    contrast: f64,
    scale: f64,
    slant: [f64; 2],
    /// k₁ of the lens, for a radius of half the width.
    distortion: f64,
    aside: [f64; 2],
    bar: Option<[usize; 4]>,
    jpeg: Option<u8>,
}

impl Disturbance {
    fn draw(random: &mut impl Rng) -> Self {
        let mut drawn = Self {
            blur_px: random.random_range(0.4..1.0),
            noise: random.random_range(1.0..3.0),
            contrast: random.random_range(100.0..190.0),
            scale: random.random_range(0.6..0.9),
            slant: [0, 1].map(|_| random.random_range(-0.9..0.9)),
            distortion: 0.0,
            aside: [0.0; 2],
            bar: None,
            jpeg: None,
        };
        for _ in 0..random.random_range(1..3) {
            match random.random_range(0..7) {
                0 => drawn.blur_px = random.random_range(1.5..3.5),
                1 => drawn.noise = random.random_range(6.0..16.0),
                2 => drawn.scale = random.random_range(0.25..0.4),
                3 => drawn.distortion = random.random_range(-0.25..0.05),
                4 => drawn.jpeg = Some(random.random_range(8..35)),
                5 => {
                    let [left, top] = [160..400, 100..300].map(|range| random.random_range(range));
                    let [wide, high] = [(); 2].map(|()| random.random_range(30..200));
                    drawn.bar = Some([left, top, left + wide, top + high]);
                }
                _ => drawn.aside = [random.random_range(0.2..0.5), random.random_range(-0.4..0.4)],
            }
        }
        drawn
    }

    /// From the middle of the sheet, in units of half the image's width, to pixels.
    fn pixel(&self, x: f64, y: f64) -> Pixel {
        let stretch = 1.0 + self.distortion * (x * x + y * y);
        let half = WIDTH as f64 / 2.0;
        Pixel::new(half * (1.0 + x * stretch), HEIGHT as f64 / 2.0 + half * y * stretch)
    }

    /// The inverse, by fixed point iterations.
    fn ideal(&self, px: f64, py: f64) -> [f64; 2] {
        let half = WIDTH as f64 / 2.0;
        let seen = [(px - half) / half, (py - HEIGHT as f64 / 2.0) / half];
        (0..20).fold(seen, |[x, y], _| seen.map(|v| v / (1.0 + self.distortion * (x * x + y * y))))
    }

    fn is_seen(&self, at: Pixel) -> bool {
        let inside = |[left, top, right, bottom]: [f64; 4]| {
            (left..right).contains(&at.x) && (top..bottom).contains(&at.y)
        };
        let covered = self.bar.is_some_and(|bar| {
            let [left, top, right, bottom] = bar.map(|v| v as f64);
            inside([left - 4.0, top - 4.0, right + 3.0, bottom + 3.0])
        });
        inside([3.0, 3.0, WIDTH as f64 - 4.0, HEIGHT as f64 - 4.0]) && !covered
    }
}

/// A board, and another one that must not be taken for it.
fn draw_boards(random: &mut impl Rng) -> Result<[Target; 2], Box<dyn Error>> {
    let charuco = |dictionary: &str, cols, rows| -> Result<Target, Box<dyn Error>> {
        Ok(Target::Charuco(CharucoBoard {
            cols,
            rows,
            square_m: 0.04,
            marker_m: 0.03,
            dictionary: Dictionary::named(dictionary)?,
            first_id: 0,
            legacy: Some(false),
        }))
    };
    let grid = |cols, rows, first_id| -> Result<Target, Box<dyn Error>> {
        Ok(Target::AprilGrid(AprilGrid {
            cols,
            rows,
            tag_m: 0.04,
            spacing: 0.3,
            family: Dictionary::named("tag36h11")?,
            border_bits: Some(2),
            first_id,
        }))
    };
    Ok(match random.random_range(0..4) {
        0 => [charuco("DICT_4X4_50", 7, 5)?, charuco("DICT_5X5_100", 7, 5)?],
        1 => [charuco("DICT_5X5_100", 8, 8)?, charuco("DICT_6X6_250", 8, 8)?],
        2 => [grid(4, 3, 0)?, grid(4, 3, 40)?],
        _ => [grid(6, 6, 0)?, grid(6, 6, 100)?],
    })
}

/// Draws a scene; one in eight shows another board than the one searched for.
pub fn draw_marker_scene(random: &mut ChaCha8Rng) -> Result<MarkerScene, Box<dyn Error>> {
    let [shown, other] = draw_boards(random)?;
    let disturbed = Disturbance::draw(random);
    let print = PrintedBoard::of(&shown);
    let half = WIDTH as f64 / 2.0;
    let fit = (WIDTH as f64 / print.width_m).min(HEIGHT as f64 / print.height_m);
    let scale = disturbed.scale * fit / half;
    let (s, c) = random.random_range(-0.5..0.5_f64).sin_cos();
    let [u, v] = disturbed.slant;
    let [aside_x, aside_y] = disturbed.aside;
    let slanted = Matrix3::new(scale * c, -scale * s, 0.0, scale * s, scale * c, 0.0, u, v, 1.0);
    let [mx, my] = [print.width_m / 2.0, print.height_m / 2.0];
    let centered = Matrix3::new(1.0, 0.0, -mx, 0.0, 1.0, -my, 0.0, 0.0, 1.0);
    let mut image = |step: f64| -> Result<MarkerImage, Box<dyn Error>> {
        let [x, y] = [aside_x + step, aside_y + step];
        let moved = Matrix3::new(1.0, 0.0, x, 0.0, 1.0, y, 0.0, 0.0, 1.0);
        let ideal_from_sheet = moved * slanted * centered;
        let corners = corners_in(&shown, &print, &disturbed, ideal_from_sheet);
        Ok(MarkerImage { pixels: render(&print, &disturbed, ideal_from_sheet, random)?, corners })
    };
    let images = [image(0.0)?, image(STEP)?];
    let same_board = random.random_range(0..8) > 0;
    Ok(MarkerScene { asked: if same_board { shown } else { other }, same_board, images })
}

/// Where the corners of the board are in an image, and whether each is to be seen.
fn corners_in(
    shown: &Target,
    print: &PrintedBoard,
    disturbed: &Disturbance,
    ideal_from_sheet: Matrix3<f64>,
) -> Vec<(u32, Pixel, bool)> {
    let place = |at: Vector3<f64>| disturbed.pixel(at.x / at.z, at.y / at.z);
    let [cols, _] = shown.corners_each_way();
    let corners = (0..shown.corner_count() as u32).filter_map(|slot| {
        let id = shown.corner_id(slot % cols, slot / cols);
        let truth = print.corner(shown, id)?;
        let pixel = place(ideal_from_sheet * Vector3::new(truth.x, truth.y, 1.0));
        Some((id, pixel, disturbed.is_seen(pixel)))
    });
    corners.collect()
}

/// The print as a raster of white and black, with paper around it; its size in cells.
fn raster(print: &PrintedBoard) -> (Vec<f32>, [usize; 2]) {
    let [across, down] = [print.width_m, print.height_m]
        .map(|side| ((side + 2.0 * PAPER_M) * RASTER_PER_M).ceil() as usize);
    let mut raster = vec![1.0_f32; across * down];
    for rect in &print.rects {
        let edge = |meters: f64| ((meters + PAPER_M) * RASTER_PER_M).round() as usize;
        let rows = edge(rect.y)..edge(rect.y + rect.height);
        for row in raster.chunks_exact_mut(across).take(rows.end).skip(rows.start) {
            row[edge(rect.x)..edge(rect.x + rect.width)].fill(f32::from(u8::from(rect.white)));
        }
    }
    (raster, [across, down])
}

fn render(
    print: &PrintedBoard,
    disturbed: &Disturbance,
    ideal_from_sheet: Matrix3<f64>,
    random: &mut impl Rng,
) -> Result<GrayImage, Box<dyn Error>> {
    let (raster, [across, down]) = raster(print);
    let sheet_from_ideal = ideal_from_sheet.try_inverse().ok_or("a homography")?;
    let light = |px: f64, py: f64| {
        let [x, y] = disturbed.ideal(px, py);
        let p = sheet_from_ideal * Vector3::new(x, y, 1.0);
        let cell = |v: f64| ((v / p.z + PAPER_M) * RASTER_PER_M).floor();
        let (col, row) = (cell(p.x), cell(p.y));
        let inside =
            p.z > 0.0 && (0.0..across as f64).contains(&col) && (0.0..down as f64).contains(&row);
        if inside { raster[row as usize * across + col as usize] } else { 0.6 }
    };
    let mean = |x: usize, y: usize| {
        let at = |v: usize, k: usize| v as f64 - 0.5 + (k as f64 + 0.5) / 4.0;
        (0..16).map(|sub| light(at(x, sub % 4), at(y, sub / 4))).sum::<f32>() / 16.0
    };
    let lit: Vec<f32> = (0..WIDTH * HEIGHT).map(|k| mean(k % WIDTH, k / WIDTH)).collect();
    let lit = image::ImageBuffer::<image::Luma<f32>, _>::from_raw(WIDTH as u32, HEIGHT as u32, lit);
    let lit = image::imageops::blur(&lit.ok_or("its size")?, disturbed.blur_px as f32);
    let noise = Normal::new(0.0, disturbed.noise).map_err(|_| "a deviation")?;
    let mut pixels: Vec<u8> = Vec::with_capacity(WIDTH * HEIGHT);
    for (x, y, white) in lit.enumerate_pixels() {
        let covered = disturbed.bar.is_some_and(|[left, top, right, bottom]| {
            (left..right).contains(&(x as usize)) && (top..bottom).contains(&(y as usize))
        });
        let white = if covered { 0.55 } else { f64::from(white.0[0]) };
        let gray = 30.0 + disturbed.contrast * white + noise.sample(random);
        pixels.push(gray.round().clamp(0.0, 255.0) as u8);
    }
    if let Some(quality) = disturbed.jpeg {
        let mut bytes = Vec::new();
        let plain = Luma::from_raw(WIDTH as u32, HEIGHT as u32, pixels).ok_or("its size")?;
        JpegEncoder::new_with_quality(&mut bytes, quality).encode_image(&plain)?;
        let decoder = JpegDecoder::new(std::io::Cursor::new(bytes))?;
        pixels = image::DynamicImage::from_decoder(decoder)?.into_luma8().into_raw();
    }
    Ok(GrayImage::from_pixels(WIDTH, HEIGHT, pixels).ok_or("its size")?)
}

impl MarkerScene {
    /// Corners to be seen of the board searched for.
    pub fn to_be_seen(&self) -> usize {
        if !self.same_board {
            return 0;
        }
        self.images[0].corners.iter().filter(|corner| corner.2).count()
    }

    /// Adds what a detector with these thresholds finds in the first image, and whether it tracks
    /// that into the second one.
    pub fn search(&self, thresholds: Thresholds, score: &mut Score) {
        let Some(mut detector) = TargetDetector::with_thresholds(self.asked, thresholds) else {
            return;
        };
        let [first, second] = &self.images;
        let Ok(found) = detector.track(first.pixels.view()) else { return };
        let Some(offs) = self.right(first, &found.detection) else {
            score.wrong += 1;
            return;
        };
        score.found += offs.len();
        score.squares += offs.iter().map(|off| off * off).sum::<f64>();
        let Ok(tracked) = detector.track(second.pixels.view()) else { return };
        match self.right(second, &tracked.detection) {
            Some(_) => score.tracked += usize::from(tracked.followed),
            None => score.wrong += 1,
        }
    }

    /// How far off those corners are that are answered and to be seen; `None` if one that is
    /// answered, covered ones too, is wrong.
    fn right(&self, image: &MarkerImage, answer: &TargetDetection) -> Option<Vec<f64>> {
        let off = |corner: &LabeledCorner| {
            let truth = image.corners.iter().find(|truth| truth.0 == corner.id);
            truth.map_or((f64::MAX, false), |(_, truth, is_seen)| {
                (truth.distance_px(corner.pixel), *is_seen)
            })
        };
        let offs: Vec<(f64, bool)> = answer.corners.iter().map(off).collect();
        let is_right = self.same_board && offs.iter().all(|(off, _)| *off <= WRONG_PX);
        let seen = offs.into_iter().filter(|(_, is_seen)| *is_seen);
        is_right.then(|| seen.map(|(off, _)| off).collect())
    }
}
