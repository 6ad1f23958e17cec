//! Refined corners of rendered boards: no bias, scatter as predicted, and near what the noise
//! allows.
//!
//! Each condition renders views of a board, develops each several times with other noise, and
//! refines from guesses up to a pixel (or a seventh of a cell) off. The mean over the noise of one
//! corner's error shows the bias that the blur, the tilt or the lens leave; error over predicted
//! standard deviation shows whether that is honest.

use nalgebra::{UnitQuaternion, Vector3};
use plumb::detection::board_detection::GridIndex;
use plumb::detection::refine::{GridCorner, RefinedCorner, Refiner};
use plumb::detection::thresholds::refinement::RefinementThresholds;
use plumb::geometry::board::{BoardSize, Chessboard};
use plumb::geometry::lens::{Lens, LensModel};
use plumb::geometry::pixel::{ImageSize, Pixel};
use plumb::geometry::pose::Pose;
use plumb::simulation::{Background, BoardPattern, ImageSensor, Renderer};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

/// What is photographed, and how exact its corners must be.
pub(crate) struct Condition {
    pub(crate) name: &'static str,
    pub(crate) lens: Lens,
    pub(crate) blur_px: f64,
    pub(crate) full_well_e: f64,
    pub(crate) gamma: f64,
    pub(crate) vignetting: f64,
    pub(crate) cell_px: f64,
    pub(crate) tilt_deg: f64,
    /// 2-D rms error, in pixels, that may not be exceeded.
    pub(crate) rms_px: f64,
    /// What may be left of a corner's error in the mean over the noise, 2-D rms in pixels.
    pub(crate) bias_px: f64,
}

pub(crate) const SIZE: ImageSize = ImageSize { width: 640, height: 480 };
const VIEWS: u64 = 2;
const DEVELOPMENTS: u64 = 8;

pub(crate) fn ordinary_lens() -> Lens {
    let parameters = [560.0, 559.0, 328.0, 235.0, 0.0, -0.12, 0.06, 0.0004, -0.0003, -0.01];
    Lens::from_parameters(LensModel::Brown, &parameters).unwrap()
}

/// The ordinary condition: an accurate machine-vision camera, held steady.
pub(crate) fn ordinary(name: &'static str, rms_px: f64) -> Condition {
    Condition {
        name,
        lens: ordinary_lens(),
        blur_px: 0.7,
        full_well_e: 10_000.0,
        gamma: 1.0,
        vignetting: 0.0,
        cell_px: 38.0,
        tilt_deg: 30.0,
        rms_px,
        bias_px: 0.0015,
    }
}

impl Condition {
    pub(crate) fn sensor(&self) -> ImageSensor {
        ImageSensor {
            blur_px: self.blur_px,
            full_well_e: self.full_well_e,
            gamma: self.gamma,
            vignetting: self.vignetting,
            ..ImageSensor::new(SIZE, self.lens)
        }
    }

    /// A board whose middle is near the image's, its cells about as large as the condition says.
    pub(crate) fn pose(&self, board: &Chessboard, rng: &mut ChaCha8Rng) -> Pose {
        let mut random = |reach: f64| rng.random_range(-reach..reach);
        let azimuth = random(std::f64::consts::PI);
        let tilt = Vector3::new(azimuth.cos(), azimuth.sin(), 0.0) * self.tilt_deg.to_radians();
        let roll = Vector3::z() * random(0.6);
        let rotation =
            UnitQuaternion::from_scaled_axis(tilt) * UnitQuaternion::from_scaled_axis(roll);
        let distance_m = board.square_m * self.lens.matrix.fx / self.cell_px;
        let aim = Vector3::new(random(0.05), random(0.05), 1.0) * distance_m;
        let size = board.size;
        let middle = Vector3::new(f64::from(size.cols - 1), f64::from(size.rows - 1), 0.0)
            * (board.square_m / 2.0);
        Pose::new(rotation, aim - rotation * middle)
    }
}

/// What was found of a condition.
#[derive(Default)]
struct Figures {
    corners: f64,
    missing: usize,
    squares: f64,
    normalized_squares: f64,
    /// Variance over the noise, corner by corner, in units of what was predicted.
    scatter: f64,
    bias_squares: f64,
    places: f64,
}

impl Figures {
    /// Adds the errors of one corner over all developments.
    fn add(&mut self, errors: &[[f64; 3]]) {
        let count = errors.len() as f64;
        let mean = [0, 1].map(|k| errors.iter().map(|error| error[k]).sum::<f64>() / count);
        let squares: f64 = errors.iter().map(|[x, y, _]| x * x + y * y).sum();
        let scatter = (squares - count * (mean[0] * mean[0] + mean[1] * mean[1])) / (count - 1.0);
        self.corners += count;
        self.squares += squares;
        self.normalized_squares +=
            errors.iter().map(|[x, y, std]| (x * x + y * y) / (2.0 * std * std)).sum::<f64>();
        let predicted = errors.iter().map(|[_, _, std]| 2.0 * std * std).sum::<f64>() / count;
        self.scatter += scatter / predicted;
        self.bias_squares += mean[0] * mean[0] + mean[1] * mean[1] - scatter / count;
        self.places += 1.0;
    }

    fn rms_px(&self) -> f64 {
        (self.squares / self.corners).sqrt()
    }

    fn normalized(&self) -> f64 {
        (self.normalized_squares / self.corners).sqrt()
    }

    /// Scatter over predicted standard deviation.
    fn scatter(&self) -> f64 {
        (self.scatter / self.places).sqrt()
    }

    fn bias_px(&self) -> f64 {
        (self.bias_squares / self.places).max(0.0).sqrt()
    }
}

pub(crate) fn board() -> Chessboard {
    Chessboard::new(BoardSize::new(9, 6).unwrap(), 0.03).unwrap()
}

/// Guesses of the corners that lie well inside the image, each moved by up to `reach_px`.
fn guesses(
    truth: &[Pixel],
    size: BoardSize,
    reach_px: f64,
    rng: &mut ChaCha8Rng,
) -> Vec<(usize, GridCorner)> {
    let moved: Vec<Option<Pixel>> = truth
        .iter()
        .map(|pixel| {
            let radius = reach_px * rng.random_range(0.0_f64..1.0).sqrt();
            let angle = rng.random_range(0.0..std::f64::consts::TAU);
            let moved = Pixel::new(pixel.x + radius * angle.cos(), pixel.y + radius * angle.sin());
            let inside = (4.0..f64::from(SIZE.width) - 5.0).contains(&moved.x)
                && (4.0..f64::from(SIZE.height) - 5.0).contains(&moved.y);
            inside.then_some(moved)
        })
        .collect();
    let (cols, rows) = (size.cols as i32, size.rows as i32);
    let at = |col: i32, row: i32| {
        let inside = (0..cols).contains(&col) && (0..rows).contains(&row);
        inside.then(|| moved[(row * cols + col) as usize]).flatten()
    };
    let place = |slot: usize| (slot as i32 % cols, slot as i32 / cols);
    let corner = |slot: usize| {
        let (col, row) = place(slot);
        let neighbors = [at(col + 1, row), at(col, row + 1), at(col - 1, row), at(col, row - 1)];
        Some((slot, GridCorner { index: GridIndex { col, row }, pixel: at(col, row)?, neighbors }))
    };
    (0..truth.len()).filter_map(corner).collect()
}

fn measure(condition: &Condition) -> Figures {
    let board = board();
    let sensor = condition.sensor();
    let mut renderer =
        Renderer::new(sensor.clone(), BoardPattern::new(board), &Background::new(1, 0));
    let (mut refiner, mut refined) = (Refiner::new(RefinementThresholds::DEFAULT), Vec::new());
    let mut rng = ChaCha8Rng::seed_from_u64(7);
    let mut figures = Figures::default();
    for view in 0..VIEWS {
        let camera_from_board = condition.pose(&board, &mut rng);
        let seen = board
            .corners_in_board()
            .iter()
            .map(|p| condition.lens.pixel_from_point(&(camera_from_board * *p)).unwrap())
            .collect::<Vec<_>>();
        let light = renderer.light(&[camera_from_board]);
        let mut errors = vec![Vec::new(); seen.len()];
        for development in 0..DEVELOPMENTS {
            let image = sensor.develop(&light, view, development);
            let reach_px = f64::min(1.0, condition.cell_px / 7.0);
            let (slots, corners): (Vec<usize>, Vec<GridCorner>) =
                guesses(&seen, board.size, reach_px, &mut rng).into_iter().unzip();
            refiner.refine(image.view(), &corners, &mut refined);
            for (slot, refined) in slots.iter().zip(&refined) {
                match refined {
                    Some(RefinedCorner { pixel, std_px, .. }) => {
                        errors[*slot].push([
                            pixel.x - seen[*slot].x,
                            pixel.y - seen[*slot].y,
                            *std_px,
                        ]);
                    }
                    None => figures.missing += 1,
                }
            }
        }
        errors.iter().filter(|errors| errors.len() > 1).for_each(|errors| figures.add(errors));
    }
    figures
}

fn hold(conditions: &[Condition]) {
    let mut broken = Vec::new();
    for condition in conditions {
        let figures = measure(condition);
        let (rms, normalized, bias) = (figures.rms_px(), figures.normalized(), figures.bias_px());
        let scatter = figures.scatter();
        let Figures { corners, missing, .. } = figures;
        let name = condition.name;
        let line = format!(
            "{name}: rms {rms:.5} px, error/std {normalized:.3}, scatter/std {scatter:.3}, bias {bias:.5} px, \
             {corners} corners, {missing} missing"
        );
        println!("{line}");
        let exact = rms <= condition.rms_px && bias <= condition.bias_px;
        let honest = (0.85..1.15).contains(&normalized) && (0.8..1.15).contains(&scatter);
        if !exact || !honest || missing > 0 || corners < 300.0 {
            broken.push(line);
        }
    }
    assert!(broken.is_empty(), "{broken:#?}");
}

#[test]
fn sharp_images_leave_no_bias_and_scatter_as_predicted() {
    hold(&[
        Condition { blur_px: 0.5, ..ordinary("blur 0.5", 0.005) },
        ordinary("blur 0.7", 0.0055),
        Condition { blur_px: 1.0, ..ordinary("blur 1.0", 0.0065) },
        Condition { tilt_deg: 65.0, cell_px: 60.0, ..ordinary("tilt of 65 degrees", 0.007) },
        Condition { gamma: 2.2, vignetting: 0.5, ..ordinary("gamma and vignetting", 0.006) },
        Condition { cell_px: 8.0, ..ordinary("cells of 8 px", 0.0095) },
    ]);
}

#[test]
fn noise_scatters_as_predicted() {
    hold(&[
        Condition { full_well_e: 2e3, ..ordinary("2000 electrons", 0.012) },
        Condition { full_well_e: 500.0, ..ordinary("500 electrons", 0.026) },
    ]);
}

#[test]
fn places_between_corners_are_refused() {
    let board = board();
    let condition = ordinary("between", 0.0);
    let sensor = condition.sensor();
    let mut renderer =
        Renderer::new(sensor.clone(), BoardPattern::new(board), &Background::new(1, 12));
    let mut rng = ChaCha8Rng::seed_from_u64(11);
    let camera_from_board = condition.pose(&board, &mut rng);
    let image = sensor.develop(&renderer.light(&[camera_from_board]), 3, 0);
    let (mut refiner, mut refined) = (Refiner::new(RefinementThresholds::DEFAULT), Vec::new());
    for (x, y) in [(0.5, 0.0), (0.0, 0.5), (0.5, 0.5), (0.25, 0.25)] {
        let step = Vector3::new(x, y, 0.0) * board.square_m;
        let places = board
            .corners_in_board()
            .iter()
            .map(|p| condition.lens.pixel_from_point(&(camera_from_board * (*p + step))).unwrap())
            .collect::<Vec<_>>();
        let corners: Vec<GridCorner> = guesses(&places, board.size, 0.5, &mut rng)
            .into_iter()
            .map(|(_, corner)| corner)
            .collect();
        refiner.refine(image.view(), &corners, &mut refined);
        let taken = refined.iter().flatten().count();
        assert_eq!(
            taken,
            0,
            "{taken} of {} places ({x}, {y}) cells beside corners were taken for corners",
            corners.len()
        );
    }
}
