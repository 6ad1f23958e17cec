//! Documents in files, with failures that name the file.

use std::fs;
use std::path::Path;

use serde::de::DeserializeOwned;

use crate::calibration::result::Calibration;
use crate::cli::Failure;
use crate::document::calibration::CalibrationDocument;
use crate::document::reading::from_json;

/// Reads a JSON document.
///
/// # Errors
/// When the file cannot be read, or its content is not such a document.
pub fn read_document<T: DeserializeOwned>(path: &Path) -> Result<T, Failure> {
    let bytes = fs::read(path).map_err(|error| {
        Failure::failed(format!("{}: cannot be read ({error}); check the path", path.display()))
    })?;
    from_json(&bytes).map_err(|error| Failure::failed(format!("{}: {error}", path.display())))
}

/// Reads a calibration document.
///
/// # Errors
/// As [`read_document`].
pub fn read_calibration(path: &Path) -> Result<Calibration, Failure> {
    let document: CalibrationDocument = read_document(path)?;
    Calibration::try_from(&document)
        .map_err(|error| Failure::failed(format!("{}: {error}", path.display())))
}

/// Writes a file whole or not at all: beside its name first, then into place.
///
/// # Errors
/// When the folder cannot be written to.
pub fn write_file(path: &Path, bytes: &[u8]) -> Result<(), Failure> {
    let cannot = |error| {
        Failure::failed(format!(
            "{}: cannot be written ({error}); check the folder",
            path.display()
        ))
    };
    let mut beside = path.as_os_str().to_owned();
    beside.push(".part");
    fs::write(&beside, bytes).map_err(cannot)?;
    fs::rename(&beside, path).map_err(cannot)
}
