//! A target from a file: the contract's object as JSON or TOML, or Kalibr's YAML.

use serde::{Deserialize, Serialize};

use crate::document::error::DocumentError;
use crate::document::reading::{from_json, to_json_pretty};
use crate::geometry::dictionary::Dictionary;
use crate::geometry::target::{AprilGrid, CharucoBoard, Target, TargetError, chessboard};

/// All fields that a target of any kind has.
#[derive(Debug, Clone, Default, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
struct TargetFields {
    #[serde(skip_serializing_if = "Option::is_none")]
    kind: Option<String>,
    #[serde(skip_serializing_if = "Option::is_none")]
    cols: Option<u32>,
    #[serde(skip_serializing_if = "Option::is_none")]
    rows: Option<u32>,
    #[serde(skip_serializing_if = "Option::is_none")]
    square_m: Option<f64>,
    #[serde(skip_serializing_if = "Option::is_none")]
    marker_m: Option<f64>,
    #[serde(skip_serializing_if = "Option::is_none")]
    dictionary: Option<String>,
    #[serde(skip_serializing_if = "Option::is_none")]
    first_id: Option<u32>,
    #[serde(skip_serializing_if = "Option::is_none")]
    legacy: Option<bool>,
    #[serde(skip_serializing_if = "Option::is_none")]
    tag_m: Option<f64>,
    #[serde(skip_serializing_if = "Option::is_none")]
    spacing: Option<f64>,
    #[serde(skip_serializing_if = "Option::is_none")]
    family: Option<String>,
    #[serde(skip_serializing_if = "Option::is_none")]
    border_bits: Option<u32>,
}

/// Reads a target.
///
/// # Errors
/// [`DocumentError`] names the field that is missing, unknown or impossible.
pub fn target_from_text(text: &str) -> Result<Target, DocumentError> {
    let fields = if text.trim_start().starts_with('{') {
        from_json(text.as_bytes())?
    } else if text.lines().any(|line| line.trim_start().starts_with("target_type")) {
        from_kalibr(text)?
    } else {
        from_toml(text)?
    };
    let target = fields.target()?;
    let checked = match &target {
        Target::Chessboard(_) => Ok(()),
        Target::Charuco(board) => board.check(),
        Target::AprilGrid(grid) => grid.check(),
    };
    checked.map(|()| target).map_err(|error| in_field(&error))
}

/// Writes a target so that [`target_from_text`] reads it.
///
/// # Errors
/// As [`to_json_pretty`].
pub fn target_to_json(target: &Target) -> Result<String, DocumentError> {
    let kind = Some(target.kind().to_owned());
    let fields = match target {
        Target::Chessboard(board) => TargetFields {
            cols: Some(board.size.cols),
            rows: Some(board.size.rows),
            square_m: Some(board.square_m),
            ..TargetFields::default()
        },
        Target::Charuco(board) => TargetFields {
            cols: Some(board.cols),
            rows: Some(board.rows),
            square_m: Some(board.square_m),
            marker_m: Some(board.marker_m),
            dictionary: Some(board.dictionary.name().to_owned()),
            first_id: Some(board.first_id),
            legacy: board.legacy,
            ..TargetFields::default()
        },
        Target::AprilGrid(grid) => TargetFields {
            cols: Some(grid.cols),
            rows: Some(grid.rows),
            tag_m: Some(grid.tag_m),
            spacing: Some(grid.spacing),
            family: Some(grid.family.family().unwrap_or(grid.family.name()).to_owned()),
            first_id: Some(grid.first_id),
            border_bits: grid.border_bits,
            ..TargetFields::default()
        },
    };
    to_json_pretty(&TargetFields { kind, ..fields })
}

/// The error with the field that it is about.
fn in_field(error: &TargetError) -> DocumentError {
    let field = match error {
        TargetError::Chessboard(_) | TargetError::Size { .. } => "cols",
        TargetError::Dictionary(unknown) if unknown.name.starts_with("tag") => "family",
        TargetError::Dictionary(_) => "dictionary",
        TargetError::Length { field, .. } => field,
        TargetError::Marker { .. } => "marker_m",
        TargetError::Spacing { .. } => "spacing",
        TargetError::Ids { .. } => "first_id",
        TargetError::Border { .. } => "border_bits",
    };
    DocumentError::field(field, error.to_string())
}

fn from_toml(text: &str) -> Result<TargetFields, DocumentError> {
    toml::from_str(text).map_err(|error| {
        let problem = error.message().lines().next().unwrap_or_default().to_owned();
        let before = error.span().map_or("", |span| text.get(..span.start).unwrap_or_default());
        let line = before.lines().count().max(1);
        DocumentError::field(format!("line {line}"), problem)
    })
}

/// Kalibr's `target.yaml`: plain `key: value` lines.
fn from_kalibr(text: &str) -> Result<TargetFields, DocumentError> {
    let mut fields = TargetFields::default();
    for line in text.lines() {
        let line = line.split('#').next().unwrap_or_default().trim();
        let Some((key, value)) = line.split_once(':') else { continue };
        let value = value.trim().trim_matches(['\'', '"']);
        let wrong = || DocumentError::field(key, format!("`{value}` is not a number"));
        let count = || value.parse::<u32>().map(Some).map_err(|_| wrong());
        let real = || value.parse::<f64>().map(Some).map_err(|_| wrong());
        match key.trim() {
            "target_type" => {
                fields.kind = Some(match value {
                    "aprilgrid" => "aprilgrid".to_owned(),
                    "checkerboard" => "chessboard".to_owned(),
                    other => other.to_owned(),
                });
            }
            "tagCols" | "targetCols" => fields.cols = count()?,
            "tagRows" | "targetRows" => fields.rows = count()?,
            "tagSize" => fields.tag_m = real()?,
            "tagSpacing" => fields.spacing = real()?,
            "codeOffset" => fields.first_id = count()?,
            "rowSpacingMeters" | "colSpacingMeters" => {
                let side = real()?;
                if fields.square_m.is_some() && fields.square_m != side {
                    return Err(DocumentError::field(key, "squares must be square"));
                }
                fields.square_m = side;
            }
            _ => {}
        }
    }
    if fields.kind.as_deref() == Some("aprilgrid") {
        fields.family = Some("tag36h11".to_owned());
    }
    Ok(fields)
}

impl TargetFields {
    fn target(&self) -> Result<Target, DocumentError> {
        let kind = needed("kind", self.kind.as_deref())?;
        let (cols, rows) = (needed("cols", self.cols), needed("rows", self.rows));
        let first_id = self.first_id.unwrap_or(0);
        let dictionary =
            |name: &str| Dictionary::named(name).map_err(|error| in_field(&error.into()));
        match kind {
            "chessboard" => chessboard(cols?, rows?, needed("square_m", self.square_m)?)
                .map_err(|error| in_field(&error)),
            "charuco" => Ok(Target::Charuco(CharucoBoard {
                cols: cols?,
                rows: rows?,
                square_m: needed("square_m", self.square_m)?,
                marker_m: needed("marker_m", self.marker_m)?,
                dictionary: dictionary(needed("dictionary", self.dictionary.as_deref())?)?,
                first_id,
                legacy: self.legacy,
            })),
            "aprilgrid" => Ok(Target::AprilGrid(AprilGrid {
                cols: cols?,
                rows: rows?,
                tag_m: needed("tag_m", self.tag_m)?,
                spacing: needed("spacing", self.spacing)?,
                family: dictionary(self.family.as_deref().unwrap_or("tag36h11"))?,
                border_bits: self.border_bits,
                first_id,
            })),
            other => Err(DocumentError::field(
                "kind",
                format!("`{other}` is none of chessboard, charuco, aprilgrid"),
            )),
        }
    }
}

fn needed<T>(name: &str, value: Option<T>) -> Result<T, DocumentError> {
    value.ok_or_else(|| DocumentError::field(name, "is missing"))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn one_board_in_three_languages() {
        let json = r#"{"kind":"aprilgrid","cols":6,"rows":5,"tag_m":0.088,"spacing":0.3}"#;
        let toml = "kind = \"aprilgrid\"\ncols = 6\nrows = 5\ntag_m = 0.088\nspacing = 0.3\n";
        let yaml = "target_type: 'aprilgrid' #gridtype\ntagCols: 6\ntagRows: 5\n\
                    tagSize: 0.088 # of one tag [m]\ntagSpacing: 0.3\n";
        let target = target_from_text(json).expect("a target");
        assert_eq!(target.to_string(), "6x5 AprilGrid (tag36h11)");
        assert_eq!(target_from_text(toml), Ok(target));
        assert_eq!(target_from_text(yaml), Ok(target));
        let written = target_to_json(&target).expect("JSON");
        assert_eq!(target_from_text(&written), Ok(target));
    }

    #[test]
    fn what_is_wrong_is_named() {
        let said = |text: &str| target_from_text(text).unwrap_err().to_string();
        let charuco = |rest: &str| {
            format!(r#"{{"kind":"charuco","cols":8,"rows":6,"square_m":0.03,{rest}}}"#)
        };
        assert!(said("{}").starts_with("kind: is missing"));
        assert!(said(r#"{"kind":"circles"}"#).contains("`circles` is none of"));
        assert!(said(&charuco(r#""marker_m":0.02"#)).starts_with("dictionary: is missing"));
        assert!(
            said(&charuco(r#""marker_m":0.02,"dictionary":"DICT_9X9_50""#))
                .starts_with("dictionary: there is no dictionary `DICT_9X9_50`")
        );
        assert!(
            said(&charuco(r#""marker_m":0.04,"dictionary":"DICT_4X4_50""#))
                .starts_with("marker_m: a marker of 0.04 m does not fit")
        );
        assert!(said(&charuco(r#""size":1"#)).contains("size"));
        assert!(said("kind = \"charuco\"\ncols = -1\n").starts_with("line 2"));
    }
}
