//! What is known of a format. Each format states it in its own file; the list is in `mod.rs`.

use crate::calibration::result::Calibration;
use crate::export::error::ExportError;
use crate::export::exported::{ExportOptions, ExportedFile};

/// What is known of a format.
pub(super) struct FormatFacts {
    /// Its name on the command line and in `?format=`.
    pub name: &'static str,
    /// What it is, as lists of formats say it.
    pub description: &'static str,
    pub media_type: &'static str,
    pub file_name: FileName,
    /// Whether it holds every sensor of a calibration, in the calibration's order.
    pub holds_all: bool,
    /// Writes a calibration.
    pub write: fn(&Calibration, &ExportOptions) -> Result<Formatted, ExportError>,
}

/// What a format's file is called.
pub(super) enum FileName {
    /// The name of the camera or the sensor, and this.
    WithSuffix(&'static str),
    /// Always this: its readers search for it.
    Fixed(&'static str),
}

impl FileName {
    /// For the camera or the sensor `name`.
    pub fn of(&self, name: &str) -> String {
        match self {
            Self::WithSuffix(suffix) => format!("{name}{suffix}"),
            Self::Fixed(file_name) => (*file_name).to_owned(),
        }
    }
}

/// A calibration in a format.
pub(super) struct Formatted {
    /// The file's content.
    pub text: String,
    /// Its files, where the format has several.
    pub files: Vec<ExportedFile>,
    /// The camera or the sensor that it is of, which the file is named after.
    pub of: String,
    /// What the reader must know.
    pub note: Option<String>,
}

impl Formatted {
    /// One file `of` a camera or a sensor.
    pub fn one_file(of: &str, text: String, note: Option<String>) -> Self {
        Self { text, files: Vec::new(), of: of.to_owned(), note }
    }
}

/// The name of the camera or the rig, or what stands for it.
pub(super) fn camera_name(calibration: &Calibration) -> &str {
    calibration.camera.as_deref().unwrap_or("camera")
}
