//! Boards with something in front of them: what is answered beside an occluder is as certain as it
//! says.
//!
//! An occluder ends beside a corner, crosses its window or hides a part of it. Its edge may be
//! taken for one of the corner's own, and it darkens or brightens what the window sees: such
//! corners must be left out or stated to be uncertain, and must mislead no other.

use plumb::detection::board_detection::DetectOptions;
use plumb::detection::detector::Detector;
use plumb::geometry::pixel::Pixel;
use plumb::simulation::{Background, BoardPattern, Renderer};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

use crate::corner_accuracy::{Condition, SIZE, board, ordinary};

const BOARDS: u64 = 8;
const OCCLUDERS: u64 = 8;

/// A rectangle in front of the board, with an edge as soft as the image's.
struct Occluder {
    middle: Pixel,
    along: [f64; 2],
    half: [f64; 2],
    value: f64,
    softness_px: f64,
}

impl Occluder {
    /// One of whose longer edges passes within half a cell of `corner`.
    fn beside(corner: Pixel, cell_px: f64, blur_px: f64, rng: &mut ChaCha8Rng) -> Self {
        let angle = rng.random_range(0.0..std::f64::consts::TAU);
        let along = [f64::cos(angle), f64::sin(angle)];
        let half = [rng.random_range(0.8..3.0) * cell_px, rng.random_range(0.4..1.5) * cell_px];
        let aside = half[1] + rng.random_range(-0.5..0.5) * cell_px;
        let middle = Pixel::new(corner.x + along[1] * aside, corner.y - along[0] * aside);
        // As often as not as black or as white as the board.
        let value = match rng.random_range(0..4) {
            0 => 0.03,
            1 => 0.85,
            _ => rng.random_range(0.05..0.85),
        };
        Self {
            middle,
            along,
            half,
            value,
            softness_px: 3.0 * (blur_px * blur_px + 1.0 / 12.0).sqrt(),
        }
    }

    /// How far within it a pixel is, along it and across; negative outside.
    fn depths_px(&self, pixel: Pixel) -> [f64; 2] {
        let (dx, dy) = (pixel.x - self.middle.x, pixel.y - self.middle.y);
        let [c, s] = self.along;
        [self.half[0] - (c * dx + s * dy).abs(), self.half[1] - (c * dy - s * dx).abs()]
    }

    fn is_clear_of(&self, pixel: Pixel) -> bool {
        self.depths_px(pixel).into_iter().fold(f64::INFINITY, f64::min) < -self.softness_px / 2.0
    }

    fn shade(&self, light: &mut [f32]) {
        for (k, light) in light.iter_mut().enumerate() {
            let pixel =
                Pixel::new((k % SIZE.width as usize) as f64, (k / SIZE.width as usize) as f64);
            let [along, across] =
                self.depths_px(pixel).map(|depth| (0.5 + depth / self.softness_px).clamp(0.0, 1.0));
            *light += (along * across * (self.value - f64::from(*light))) as f32;
        }
    }
}

/// What was answered of many occluded boards.
#[derive(Default)]
struct Figures {
    visible: usize,
    seen: usize,
    answered: usize,
    squares: f64,
    /// The worst error in standard deviations, per axis.
    worst: f64,
}

impl Figures {
    fn add_board(&mut self, condition: &Condition, seed: u64) {
        let board = board();
        let sensor = condition.sensor();
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        let camera_from_board = condition.pose(&board, &mut rng);
        let truth: Vec<Pixel> = board
            .corners_in_board()
            .iter()
            .map(|p| condition.lens.pixel_from_point(&(camera_from_board * *p)).unwrap())
            .collect();
        let mut renderer =
            Renderer::new(sensor.clone(), BoardPattern::new(board), &Background::new(seed, 4));
        let bare = renderer.light(&[camera_from_board]);
        let mut detector = Detector::new(board.size);
        for index in 0..OCCLUDERS {
            let near = truth[rng.random_range(0..truth.len())];
            let occluder = Occluder::beside(near, condition.cell_px, condition.blur_px, &mut rng);
            let mut light = bare.clone();
            occluder.shade(&mut light);
            let image = sensor.develop(&light, seed, index);
            let options = DetectOptions { allow_partial: true };
            let visible: Vec<bool> =
                truth.iter().map(|corner| occluder.is_clear_of(*corner)).collect();
            self.visible += visible.iter().filter(|&&visible| visible).count();
            let Ok(detection) = detector.find_board(image.view(), &options) else { continue };
            for corner in &detection.corners {
                let off = |k: &usize| truth[*k].distance_px(corner.pixel);
                let nearest = (0..truth.len()).min_by(|a, b| off(a).total_cmp(&off(b))).unwrap();
                let off = off(&nearest) / corner.std_px / f64::sqrt(2.0);
                self.seen += usize::from(visible[nearest]);
                self.answered += 1;
                self.squares += off * off;
                self.worst = self.worst.max(off);
            }
        }
    }
}

#[test]
fn no_corner_beside_an_occluder_is_far_off_and_nearly_all_are_seen() {
    let mut figures = Figures::default();
    for seed in 0..BOARDS {
        let condition = Condition {
            blur_px: [0.6, 1.2][seed as usize % 2],
            gamma: [1.0, 2.2][seed as usize / 2 % 2],
            cell_px: [20.0, 34.0][seed as usize / 4 % 2],
            ..ordinary("beside an occluder", 0.0)
        };
        figures.add_board(&condition, 500 + seed);
    }
    let Figures { visible, seen, answered, squares, worst } = figures;
    let rms = (squares / answered as f64).sqrt();
    println!(
        "{answered} corners, {seen} of {visible} visible ones; error/std {rms:.3}, at worst {worst:.2}"
    );
    assert!(worst < 5.0, "at worst {worst:.2} standard deviations off");
    assert!((0.85..1.15).contains(&rms), "error/std {rms:.3}");
    assert!(
        seen as f64 > 0.97 * visible as f64 && visible > 3000,
        "{seen} of {visible} visible corners"
    );
}
