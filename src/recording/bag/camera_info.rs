//! `sensor_msgs/CameraInfo`: what a driver states of a lens.

use crate::geometry::lens::Lens;
use crate::geometry::pixel::ImageSize;
use crate::imaging::factory::StatedLens;
use crate::recording::bag::storage::{MessageEncoding, RosHeader};
use crate::recording::fields::TooShort;
use crate::recording::messages::lens_from_ros;

/// The most distortion coefficients that are believed: OpenCV has 14.
const MOST_COEFFICIENTS: usize = 32;

/// The part of the message that describes the lens, for the image as it is published.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct CameraInfo {
    pub image_size: ImageSize,
    model: String,
    distortion: Vec<f64>,
    matrix: [f64; 9],
}

impl CameraInfo {
    pub(super) fn read(layout: MessageEncoding, message: &[u8]) -> Result<Self, TooShort> {
        let mut fields = layout.fields(message)?;
        RosHeader::read(layout, &mut fields)?;
        let (height, width) = (fields.u32()?, fields.u32()?);
        let model = fields.text()?;
        let count = fields.length()?;
        if count > MOST_COEFFICIENTS {
            return Err(TooShort);
        }
        let distortion = fields.f64s(count)?;
        let mut matrix = [0.0; 9];
        matrix.copy_from_slice(&fields.f64s(9)?);
        let _rectification_and_projection = fields.f64s(9 + 12)?;
        let (binning_x, binning_y) = (fields.u32()?.max(1), fields.u32()?.max(1));
        let (x_offset, y_offset) = (fields.u32()?, fields.u32()?);
        let (roi_height, roi_width) = (fields.u32()?, fields.u32()?);
        // The matrix is of the whole sensor; images are of a region of it, binned.
        let part = |full: u32, of_region: u32, binning: u32| {
            (if of_region == 0 { full } else { of_region }) / binning
        };
        let image_size =
            ImageSize::new(part(width, roi_width, binning_x), part(height, roi_height, binning_y));
        let (x, y) = (f64::from(binning_x), f64::from(binning_y));
        matrix[0] /= x;
        matrix[1] /= x;
        matrix[2] = (matrix[2] - f64::from(x_offset)) / x;
        matrix[4] /= y;
        matrix[5] = (matrix[5] - f64::from(y_offset)) / y;
        Ok(Self { image_size, model, distortion, matrix })
    }

    /// The numbers as stated; `None` for a camera that is not calibrated: its matrix is zero.
    pub(super) fn stated(&self) -> Option<StatedLens> {
        let [fx, _, cx, _, fy, cy, ..] = self.matrix;
        (fx > 0.0 && fy > 0.0).then(|| StatedLens {
            model: self.model.clone(),
            focal_px: [fx, fy],
            principal_px: [cx, cy],
            coefficients: self.distortion.clone(),
        })
    }

    /// The same as a lens, where a model says the same.
    pub(super) fn lens(&self) -> Option<Lens> {
        lens_from_ros(&self.model, &self.distortion, &self.matrix)
    }
}
