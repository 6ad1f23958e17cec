//! How well a calibration knows where things are seen, as a picture: a heat map over the image, with contours.

use std::sync::Arc;

use axum::extract::State;
use axum::http::header::CONTENT_TYPE;
use axum::response::IntoResponse;
use image::{ImageFormat, Rgb, RgbImage};
use nalgebra::DMatrix;

use crate::calibration::calibration::SensorCalibration;
use crate::estimation::uncertainty::{Distance, PixelGrid, UncertaintyMap, projection_uncertainty};
use crate::http::calibrations::calibration;
use crate::http::problem::Problem;
use crate::http::request::{Address, Parameters};
use crate::http::{Shared, on_a_blocking_thread};
use crate::imaging::draw;

/// Grid columns along the image's longer side.
const COLUMNS: u32 = 49;
/// The picture's longer side, in pixels.
const LONGER_SIDE: u32 = 640;
/// Contours lie at these values, in pixels; colours go from the first to the last.
const LEVELS_PX: [f64; 8] = [0.01, 0.02, 0.05, 0.1, 0.2, 0.5, 1.0, 2.0];
/// Where the lens sees nothing.
const BLIND: Rgb<u8> = Rgb([128, 128, 128]);

/// The predicted 1-σ projection uncertainty over the image as a heat map: contours at 0.01, 0.02, 0.05, 0.1, 0.2, 0.5, 1
/// and 2 pixels.
#[utoipa::path(get, path = "/v1/calibrations/{id}/uncertainty.png", tag = "calibrations",
    params(
        ("id" = String, Path, description = "the calibration's"),
        ("sensor" = Option<String>, Query, description = "color, infrared, infrared2, or a rig's camera; the first there is when left out"),
        ("distance_m" = Option<f64>, Query, description = "how far away things are, in metres; at infinity when left out"),
    ),
    responses(
        (status = 200, description = "the picture", body = Vec<u8>, content_type = "image/png"),
        (status = 404, description = "no such calibration, or it knows no covariance of this sensor", body = Problem, content_type = "application/problem+json"),
        (status = 422, description = "an unknown sensor, or a distance that cannot be", body = Problem, content_type = "application/problem+json"),
    ))]
pub(super) async fn picture(
    State(shared): State<Arc<Shared>>,
    Address(id): Address<String>,
    parameters: Parameters,
) -> Result<impl IntoResponse, Problem> {
    let distance = parameters.positive("distance_m")?.map_or(Distance::Infinity, Distance::Meters);
    let found = calibration(&shared, &id).await?;
    let own = ["color", "infrared", "infrared2"];
    let known: Vec<&str> = own.into_iter().chain(found.cameras.iter().map(|c| c.name.as_str())).collect();
    let is_known = |name: &str| known.contains(&name).then(|| name.to_owned());
    let asked = parameters.one_of("sensor", is_known, &known.join(", "))?;
    let mut sensors = found.picture_sensors();
    let sensor = sensors.find(|(name, _)| asked.as_ref().is_none_or(|asked| asked == name));
    let unknown = || Problem::not_found(format!("calibration {id} tells no covariance of this sensor; solve it again"));
    let sensor = sensor
        .map(|(_, sensor)| sensor.clone())
        .filter(|sensor| !sensor.lens_covariance.is_empty())
        .ok_or_else(unknown)?;
    let png = on_a_blocking_thread(move || heat_map(&sensor, distance)).await?.ok_or_else(unknown)?;
    Ok(([(CONTENT_TYPE, "image/png")], png))
}

fn heat_map(sensor: &SensorCalibration, distance: Distance) -> Option<Vec<u8>> {
    let rows = &sensor.lens_covariance;
    let covariance = DMatrix::from_fn(rows.len(), rows.len(), |i, j| rows[i][j]);
    let grid = PixelGrid::over(sensor.image_size, COLUMNS);
    let map = projection_uncertainty(&sensor.lens, &covariance, grid, distance)?;
    let mut png = std::io::Cursor::new(Vec::new());
    drawn(&map).write_to(&mut png, ImageFormat::Png).ok()?;
    Some(png.into_inner())
}

fn drawn(map: &UncertaintyMap) -> RgbImage {
    let size = map.grid.size;
    let scale = f64::from(LONGER_SIDE) / f64::from(size.width.max(size.height));
    let side = |length: u32| ((f64::from(length) * scale).round() as u32).max(1);
    let (width, height) = (side(size.width), side(size.height));
    let level = |x: u32, y: u32| {
        let part = |place: u32, length: u32| f64::from(place) / f64::from((length - 1).max(1));
        interpolated(map, part(x.min(width - 1), width), part(y.min(height - 1), height)).map(level_of)
    };
    RgbImage::from_fn(width, height, |x, y| {
        let Some(here) = level(x, y) else { return BLIND };
        let band = |level: f64| level.floor();
        let differs = |other: Option<f64>| other.is_some_and(|other| band(other) != band(here));
        if differs(level(x + 1, y)) || differs(level(x, y + 1)) { Rgb([255, 255, 255]) } else { color(here) }
    })
}

/// The map at a place given as parts of the width and height, 0 to 1, between the grid's points.
fn interpolated(map: &UncertaintyMap, across: f64, down: f64) -> Option<f64> {
    let (cols, rows) = (map.grid.cols as usize, map.grid.rows as usize);
    let (x, y) = (across * (cols - 1) as f64, down * (rows - 1) as f64);
    let (col, row) = ((x as usize).min(cols - 2), (y as usize).min(rows - 2));
    let (right, below) = (x - col as f64, y - row as f64);
    let at = |col: usize, row: usize| map.std_px.get(row * cols + col).copied().flatten();
    let (a, b, c, d) = (at(col, row)?, at(col + 1, row)?, at(col, row + 1)?, at(col + 1, row + 1)?);
    Some((a * (1.0 - right) + b * right) * (1.0 - below) + (c * (1.0 - right) + d * right) * below)
}

/// Where a value lies among the levels: 0 at the first, 7 at the last, in equal steps of the logarithm between.
fn level_of(std_px: f64) -> f64 {
    let below = LEVELS_PX.iter().filter(|level| **level <= std_px).count();
    match below {
        0 => -0.5,
        n if n == LEVELS_PX.len() => (n - 1) as f64,
        n => {
            let (low, high) = (LEVELS_PX[n - 1], LEVELS_PX[n]);
            (n - 1) as f64 + (std_px / low).ln() / (high / low).ln()
        }
    }
}

/// Dark is certain, bright is not.
fn color(level: f64) -> Rgb<u8> {
    draw::shade((level / (LEVELS_PX.len() - 1) as f64) as f32)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::pixel::ImageSize;

    #[test]
    fn levels_are_met_exactly_and_grow() {
        for (i, level) in LEVELS_PX.into_iter().enumerate() {
            assert_eq!(level_of(level), i as f64);
        }
        assert!(level_of(0.0) < 0.0 && level_of(0.03) > 1.0 && level_of(0.03) < 2.0);
        assert_eq!(level_of(f64::INFINITY), 7.0);
    }

    #[test]
    fn the_picture_is_dark_where_it_is_certain_with_a_contour_between() {
        let grid = PixelGrid::over(ImageSize::new(640, 480), 9);
        let std_px = grid.pixels().map(|pixel| Some(if pixel.x < 320.0 { 0.012 } else { 1.5 })).collect();
        let picture = drawn(&UncertaintyMap { grid, std_px, square_px2: Vec::new() });
        assert_eq!(picture.dimensions(), (640, 480));
        let light = |x: u32| picture.get_pixel(x, 240).0.iter().map(|&c| u32::from(c)).sum::<u32>();
        assert!(light(20) < 200 && light(620) > 300, "{} {}", light(20), light(620));
        assert!((0..640).any(|x| picture.get_pixel(x, 240) == &Rgb([255, 255, 255])));
    }

    #[test]
    fn where_the_lens_is_blind_there_is_no_color() {
        let grid = PixelGrid::over(ImageSize::new(64, 48), 4);
        let std_px = grid.pixels().map(|_| None).collect();
        let picture = drawn(&UncertaintyMap { grid, std_px, square_px2: Vec::new() });
        assert!(picture.pixels().all(|pixel| *pixel == BLIND));
    }
}
