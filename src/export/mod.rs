//! Calibrations in other programs' formats, one file a format. Uses geometry, calibration and
//! document.
//!
//! **Never truncates.** A lens that a format cannot hold exactly is refused by name
//! ([`ExportError::Lens`], [`ExportError::Skew`]), or refitted where the format's users would
//! otherwise have nothing, with the refit's error stated in the file and in [`Exported::note`].
//! Numbers are written with every digit of their double.
//!
//! A calibration of several sensors goes whole into the formats that hold several; of the others,
//! it is one sensor's: color's unless [`ExportOptions::sensor`] says another.

mod colmap;
pub mod colmap_scene;
mod depth;
mod error;
mod exported;
mod facts;
mod format;
mod json;
mod kalibr;
mod mrcal;
mod number;
mod opencv;
pub mod other_images;
mod refit;
mod ros;
mod sensors;
mod stereo;
mod transforms;

pub use error::ExportError;
pub use exported::{ExportOptions, Exported, ExportedFile};
pub use format::Format;

use crate::calibration::result::{Calibration, SensorResult};
use crate::export::facts::{FormatFacts, Formatted};

impl Format {
    /// What is known of it: the list of formats.
    fn facts(self) -> &'static FormatFacts {
        match self {
            Self::Json => &json::FACTS,
            Self::Ros => &ros::FACTS,
            Self::RosStereo => &stereo::ROS,
            Self::Opencv => &opencv::FACTS,
            Self::OpencvStereo => &stereo::OPENCV,
            Self::Kalibr => &kalibr::FACTS,
            Self::Mrcal => &mrcal::FACTS,
            Self::Colmap => &colmap::FACTS,
            Self::Urdf => &transforms::URDF,
            Self::Tf => &transforms::TF,
            Self::Depth => &depth::FACTS,
        }
    }

    /// Its name on the command line and in `?format=`.
    pub fn name(self) -> &'static str {
        self.facts().name
    }

    /// What it is, as lists of formats say it.
    pub fn description(self) -> &'static str {
        self.facts().description
    }

    /// The format with this name.
    pub fn from_name(name: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|format| format.name() == name)
    }
}

/// Writes `calibration` in `format`. A skew that is rounding alone is none, but in `json`.
///
/// # Errors
/// [`ExportError`] where the format cannot hold it.
pub fn export(
    calibration: &Calibration,
    format: Format,
    options: &ExportOptions,
) -> Result<Exported, ExportError> {
    let facts = format.facts();
    if facts.holds_all
        && let Some(asked) = options.sensor.as_ref().filter(|names| names.contains(','))
    {
        return Err(ExportError::Order { format, asked: asked.clone() });
    }
    let Formatted { text, files, of, note } = match format {
        Format::Json => (facts.write)(calibration, options)?,
        _ => (facts.write)(&without_rounding(calibration), options)?,
    };
    let (file_name, media_type) = (facts.file_name.of(&of), facts.media_type);
    Ok(Exported { bytes: text.into_bytes(), files, media_type, file_name, note })
}

/// The same with a skew of exactly 0 where there is none.
fn without_rounding(calibration: &Calibration) -> Calibration {
    let mut rounded = calibration.clone();
    for sensor in &mut rounded.sensors {
        let matrix = match &mut sensor.result {
            SensorResult::Image(image) => &mut image.lens.matrix,
            SensorResult::Depth(depth) => &mut depth.camera.lens.matrix,
        };
        if !matrix.has_skew() {
            matrix.skew = 0.0;
        }
    }
    rounded
}

#[cfg(test)]
#[path = "export_tests.rs"]
mod tests;
