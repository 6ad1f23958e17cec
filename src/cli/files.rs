//! Reading and writing files, with failures that name the file.

use std::fs;
use std::path::Path;

use serde::de::DeserializeOwned;

use crate::calibration::result::{Calibration, ImageCalibration};
use crate::calibration::sensor::SensorId;
use crate::cli::Failure;
use crate::document::calibration::CalibrationDocument;
use crate::document::reading::from_json;
use crate::imaging::image_file::is_image;
use crate::recording::is_recording_file;

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

/// The image sensor of a calibration with the requested name, which is `camera` or `camera.sensor`
/// in a rig; without a name, that of a single camera. `file` is the calibration's path.
///
/// # Errors
/// When there is no such sensor, or there are several and none was requested.
pub fn image_sensor<'a>(
    calibration: &'a Calibration,
    asked: Option<&str>,
    file: &str,
) -> Result<(&'a SensorId, &'a ImageCalibration), Failure> {
    let mut sensors = calibration.image_sensors();
    let found = sensors.find(|(id, _)| match asked {
        Some(asked) => calibration.name_of(id) == asked,
        None => id.camera.is_none(),
    });
    let names = calibration.image_sensors().map(|(id, _)| calibration.name_of(id));
    let known = names.collect::<Vec<_>>().join(", ");
    found.ok_or_else(|| {
        Failure::failed(match asked {
            _ if known.is_empty() => format!("{file}: calibrates no image sensor"),
            Some(asked) => format!("{file}: there is no image sensor `{asked}`; it has {known}"),
            None => format!("{file}: holds several cameras: give --sensor, one of {known}"),
        })
    })
}

/// Whether both paths refer to the same existing file or folder.
pub fn same_file(one: &Path, other: &Path) -> bool {
    matches!((one.canonicalize(), other.canonicalize()), (Ok(one), Ok(other)) if one == other)
}

/// Refuses to overwrite a file that the command reads.
///
/// # Errors
/// When `out` is one of `read`.
pub fn check_not_read(out: &Path, read: &[&Path]) -> Result<(), Failure> {
    if read.iter().any(|read| same_file(out, read)) {
        return Err(Failure::usage(format!(
            "{} is an input of this command and would be overwritten: choose another output name",
            out.display()
        )));
    }
    Ok(())
}

/// Refuses to overwrite an image or a recording with something else: an option whose value was
/// forgotten takes the first source as its value.
///
/// # Errors
/// When `out` is one.
pub fn check_no_image(option: &str, out: &Path) -> Result<(), Failure> {
    if out.is_file() && (is_image(out) || is_recording_file(out)) {
        return Err(Failure::usage(format!(
            "{option} {}: an image or a recording already exists there: choose another name",
            out.display()
        )));
    }
    Ok(())
}

/// Writes a file completely or not at all: first to a temporary name beside it, then renamed. A
/// link is kept and its target is written. A device or a pipe is written to directly.
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
    let file = fs::canonicalize(path).unwrap_or_else(|_| path.to_owned());
    let before = fs::metadata(&file).ok();
    if before.as_ref().is_some_and(|before| !before.is_file()) {
        return fs::write(&file, bytes).map_err(cannot);
    }
    let mut beside = file.as_os_str().to_owned();
    beside.push(".part");
    fs::write(&beside, bytes).map_err(cannot)?;
    if let Some(before) = before {
        fs::set_permissions(&beside, before.permissions()).map_err(cannot)?;
    }
    fs::rename(&beside, &file).map_err(cannot)
}

#[cfg(unix)]
#[cfg(test)]
mod tests {
    use std::os::unix::fs::{PermissionsExt, symlink};

    use super::*;

    #[test]
    fn links_stay_and_so_do_permissions() {
        let folder = tempfile::tempdir().unwrap();
        let [file, link] = ["file.json", "link.json"].map(|name| folder.path().join(name));
        write_file(&file, b"before").unwrap();
        fs::set_permissions(&file, fs::Permissions::from_mode(0o640)).unwrap();
        symlink(&file, &link).unwrap();
        write_file(&link, b"after").unwrap();
        assert!(fs::symlink_metadata(&link).unwrap().is_symlink());
        assert_eq!(fs::read(&file).unwrap(), b"after");
        assert_eq!(fs::metadata(&file).unwrap().permissions().mode() & 0o777, 0o640);
        assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 2, "nothing beside them");
    }

    #[test]
    fn a_device_is_written_to_and_a_folder_is_none() {
        write_file(Path::new("/dev/null"), b"nothing").unwrap();
        assert!(!fs::metadata("/dev/null").unwrap().is_file());
        assert!(write_file(tempfile::tempdir().unwrap().path(), b"nothing").is_err());
    }
}
