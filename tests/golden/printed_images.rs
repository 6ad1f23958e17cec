//! Images of printed boards with markers, with exact truth; `benches/tracking.rs` draws them, too.

use nalgebra::{Matrix3, Vector3};
use plumb::geometry::printed_board::PrintedBoard;
use plumb::imaging::gray::GrayImage;
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, Normal};

/// Pixels of the raster that a meter of the sheet takes.
const RASTER_PER_M: f64 = 2500.0;
const MARGIN_M: f64 = 0.02;

/// An image of `print`, with noise, while it goes through the places in the image that each of
/// `pixel_from_sheet` gives it.
pub fn rendered(
    print: &PrintedBoard,
    [width, height]: [usize; 2],
    pixel_from_sheet: &[Matrix3<f64>],
    rng: &mut ChaCha8Rng,
) -> GrayImage {
    let [across, down] = [print.width_m, print.height_m]
        .map(|side| ((side + 2.0 * MARGIN_M) * RASTER_PER_M).ceil() as usize);
    let mut raster = vec![1.0_f32; across * down];
    for rect in &print.rects {
        let edge = |meters: f64| ((meters + MARGIN_M) * RASTER_PER_M).round() as usize;
        for row in
            raster.chunks_exact_mut(across).take(edge(rect.y + rect.height)).skip(edge(rect.y))
        {
            row[edge(rect.x)..edge(rect.x + rect.width)].fill(f32::from(u8::from(rect.white)));
        }
    }
    let inverse = |map: &Matrix3<f64>| map.try_inverse().expect("a homography");
    let sheets_from_pixel: Vec<Matrix3<f64>> = pixel_from_sheet.iter().map(inverse).collect();
    let noise = Normal::new(0.0, 1.5).expect("a deviation");
    let mut pixels = Vec::with_capacity(width * height);
    for y in 0..height {
        for x in 0..width {
            let mut white = 0.0;
            for (sub, sheet_from_pixel) in
                (0..16).flat_map(|sub| sheets_from_pixel.iter().map(move |sheet| (sub, sheet)))
            {
                let at = |v: usize, k: usize| v as f64 - 0.5 + (k as f64 + 0.5) / 4.0;
                let p = sheet_from_pixel * Vector3::new(at(x, sub % 4), at(y, sub / 4), 1.0);
                let place = |v: f64| ((v / p.z + MARGIN_M) * RASTER_PER_M).floor();
                let (col, row) = (place(p.x), place(p.y));
                let inside = p.z > 0.0
                    && (0.0..across as f64).contains(&col)
                    && (0.0..down as f64).contains(&row);
                white += if inside { raster[row as usize * across + col as usize] } else { 0.6 };
            }
            let share = f64::from(white) / (16 * sheets_from_pixel.len()) as f64;
            let gray = 30.0 + 180.0 * share + noise.sample(rng);
            pixels.push(gray.round().clamp(0.0, 255.0) as u8);
        }
    }
    GrayImage::from_pixels(width, height, pixels).expect("so many pixels")
}
