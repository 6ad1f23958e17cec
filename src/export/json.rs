//! Plumb's own calibration document.

use crate::calibration::result::Calibration;
use crate::document::calibration::CalibrationDocument;
use crate::document::reading::to_json_pretty;
use crate::export::facts::{FileName, FormatFacts, Formatted, camera_name};
use crate::export::{ExportError, ExportOptions, Format};

pub(super) const FACTS: FormatFacts = FormatFacts {
    name: "json",
    description: "Plumb's calibration document",
    media_type: "application/json",
    file_name: FileName::WithSuffix(".json"),
    holds_all: true,
    write,
};

fn write(calibration: &Calibration, _: &ExportOptions) -> Result<Formatted, ExportError> {
    let document = CalibrationDocument::from(calibration);
    let text = to_json_pretty(&document)
        .map_err(|error| ExportError::Text { format: Format::Json, reason: error.to_string() })?;
    Ok(Formatted::one_file(camera_name(calibration), text, None))
}
