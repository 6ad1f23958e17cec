//! Depth in color's picture and color in depth's, by a camera's current calibration.

use std::sync::Arc;

use image::RgbImage;

use crate::calibration::sensor::SensorId;
use crate::geometry::pixel::ImageSize;
use crate::http::kept::Kept;
use crate::http::problem::Problem;
use crate::http::{Shared, on_a_blocking_thread};
use crate::imaging::decode::{self, DecodeError};
use crate::imaging::depth_image::DepthImage;
use crate::imaging::depth_picture;
use crate::imaging::draw;
use crate::imaging::frame::{FrameSet, SensorKind};
use crate::imaging::registration::DepthRegistration;

/// The registrations used lately, by calibration.
pub(super) type Registrations = Kept<String, Registration>;

/// How depth of a calibrated camera is brought into color's picture.
#[derive(Debug)]
pub(super) struct Registration {
    map: DepthRegistration,
    invalid: Option<u16>,
    depth_size: ImageSize,
    color_size: ImageSize,
}

/// The registration of a camera by its current calibration.
///
/// # Errors
/// 404 for an unknown camera; 409 without a current calibration of color and depth.
pub(super) async fn registration(
    shared: &Shared,
    camera: &str,
) -> Result<Arc<Registration>, Problem> {
    let none = || {
        Problem::conflict(format!(
            "camera `{camera}` has no approved calibration of color and depth to register with; run a session, and approve it"
        ))
    };
    let id = shared.fleet.camera(camera)?.calibration.ok_or_else(none)?;
    if let Some(known) = shared.registrations.get(&id) {
        return Ok(known);
    }
    let asked = id.clone();
    let calibration =
        shared.stored(move |store| store.calibration(&asked)).await?.ok_or_else(none)?;
    let [color, depth] = [SensorKind::Color, SensorKind::Depth].map(SensorId::own);
    let color_from_depth = calibration.pose(&color, &depth).ok_or_else(none)?.target_from_source;
    let (color, depth) = calibration.color().zip(calibration.depth()).ok_or_else(none)?;
    let (color, depth) = (color.clone(), depth.clone());
    let made = on_a_blocking_thread(move || Registration {
        map: DepthRegistration::new(
            &depth.camera,
            &color.lens,
            color.image_size,
            &color_from_depth,
        ),
        invalid: depth.invalid,
        depth_size: depth.camera.image_size,
        color_size: color.image_size,
    });
    Ok(shared.registrations.keep(id, made.await?))
}

/// Depth in color's picture: its edges drawn over color, or by itself.
pub(super) fn depth_in_color(
    registration: &Registration,
    frames: &FrameSet,
    over_color: bool,
) -> Result<RgbImage, Problem> {
    let depths = depths(registration, frames)?;
    let nearest = registration.map.nearest_in_color(&depths);
    if !over_color {
        return Ok(depth_picture::shaded(&nearest, registration.color_size));
    }
    let mut picture = color(registration, frames)?;
    let edges = depth_picture::edges(&nearest, registration.color_size);
    picture
        .pixels_mut()
        .zip(edges)
        .filter(|(_, is_edge)| *is_edge)
        .for_each(|(pixel, _)| *pixel = draw::FOUND);
    Ok(picture)
}

/// Color in depth's picture.
pub(super) fn color_in_depth(
    registration: &Registration,
    frames: &FrameSet,
) -> Result<RgbImage, Problem> {
    let depths = depths(registration, frames)?;
    Ok(registration.map.color_in_depth(&depths, &color(registration, frames)?))
}

/// Depth as it comes, near bright and far dark; readings are taken as millimeters.
pub(super) fn shaded_depth(frames: &FrameSet) -> Result<RgbImage, Problem> {
    let picture = raw_depth(frames)?;
    let depths: Vec<f32> =
        picture.readings().iter().map(|reading| f32::from(*reading) * 1e-3).collect();
    Ok(depth_picture::shaded(&depths, picture.size()))
}

fn depths(registration: &Registration, frames: &FrameSet) -> Result<Vec<f32>, Problem> {
    let picture = raw_depth(frames)?;
    if picture.size() != registration.depth_size {
        return Err(other_size("depth"));
    }
    Ok(registration.map.depths_m(&picture, registration.invalid))
}

fn raw_depth(frames: &FrameSet) -> Result<DepthImage, Problem> {
    let frame = frames.frame(SensorKind::Depth).ok_or_else(|| missing("depth"))?;
    DepthImage::from_frame(frame).map_err(|error| unreadable(&error))
}

fn color(registration: &Registration, frames: &FrameSet) -> Result<RgbImage, Problem> {
    let frame = frames.frame(SensorKind::Color).ok_or_else(|| missing("color"))?;
    let picture = decode::rgb(frame).map_err(|error| unreadable(&error))?;
    let size = registration.color_size;
    if picture.dimensions() == (size.width, size.height) {
        Ok(picture)
    } else {
        Err(other_size("color"))
    }
}

fn missing(sensor: &str) -> Problem {
    Problem::conflict(format!("the newest frames have no {sensor} picture; ask again in a moment"))
}

fn unreadable(error: &DecodeError) -> Problem {
    Problem::conflict(format!("the newest frame cannot be read: {error}"))
}

fn other_size(sensor: &str) -> Problem {
    Problem::conflict(format!(
        "the current calibration is for {sensor} pictures of another size; calibrate again"
    ))
}
