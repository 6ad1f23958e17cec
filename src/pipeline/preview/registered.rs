//! Depth in the color image and color in the depth image, by a camera's current calibration.

use image::RgbImage;

use crate::geometry::pixel::ImageSize;
use crate::imaging::decode;
use crate::imaging::depth_image::DepthImage;
use crate::imaging::draw;
use crate::imaging::draw::depth_shading;
use crate::imaging::frame::{FrameSet, SensorKind};
use crate::imaging::registration::DepthRegistration;
use crate::pipeline::preview::error::PreviewError;

/// How depth of a calibrated camera is mapped into the color image.
#[derive(Debug)]
pub(super) struct Registration {
    pub(super) map: DepthRegistration,
    pub(super) invalid: Option<u16>,
    pub(super) depth_size: ImageSize,
    pub(super) color_size: ImageSize,
}

impl Registration {
    /// Depth in the color image: its edges drawn over color, or by itself.
    pub(super) fn depth_in_color(
        &self,
        frames: &FrameSet,
        over_color: bool,
    ) -> Result<RgbImage, PreviewError> {
        let depths = self.depths(frames)?;
        let nearest = self.map.nearest_in_color(&depths);
        if !over_color {
            return Ok(depth_shading::shaded(&nearest, self.color_size));
        }
        let mut image = self.color(frames)?;
        let edges = depth_shading::edges(&nearest, self.color_size);
        image
            .pixels_mut()
            .zip(edges)
            .filter(|(_, is_edge)| *is_edge)
            .for_each(|(pixel, _)| *pixel = draw::FOUND);
        Ok(image)
    }

    /// Color in the depth image.
    pub(super) fn color_in_depth(&self, frames: &FrameSet) -> Result<RgbImage, PreviewError> {
        let depths = self.depths(frames)?;
        Ok(self.map.color_in_depth(&depths, &self.color(frames)?))
    }

    fn depths(&self, frames: &FrameSet) -> Result<Vec<f32>, PreviewError> {
        let image = raw_depth(frames)?;
        if image.size() != self.depth_size {
            return Err(PreviewError::OtherSize { sensor: SensorKind::Depth });
        }
        Ok(self.map.depths_m(&image, self.invalid))
    }

    fn color(&self, frames: &FrameSet) -> Result<RgbImage, PreviewError> {
        let sensor = SensorKind::Color;
        let frame = frames.frame(sensor).ok_or(PreviewError::Missing { sensor })?;
        let image = decode::rgb(frame)?;
        let size = self.color_size;
        if image.dimensions() == (size.width, size.height) {
            Ok(image)
        } else {
            Err(PreviewError::OtherSize { sensor })
        }
    }
}

/// The depth image without registration, near bright and far dark; readings are taken as
/// millimeters.
pub(super) fn shaded_depth(frames: &FrameSet) -> Result<RgbImage, PreviewError> {
    let image = raw_depth(frames)?;
    let depths: Vec<f32> =
        image.readings().iter().map(|reading| f32::from(*reading) * 1e-3).collect();
    Ok(depth_shading::shaded(&depths, image.size()))
}

fn raw_depth(frames: &FrameSet) -> Result<DepthImage, PreviewError> {
    let sensor = SensorKind::Depth;
    let frame = frames.frame(sensor).ok_or(PreviewError::Missing { sensor })?;
    Ok(DepthImage::from_frame(frame)?)
}
