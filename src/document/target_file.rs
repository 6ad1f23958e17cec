//! A target from a file: the contract's object as JSON or TOML, or Kalibr's YAML.

use crate::document::error::DocumentError;
use crate::document::reading::{BYTE_ORDER_MARK, from_json, to_json_pretty};
use crate::document::target::{TargetDocument, TargetKind};
use crate::geometry::target::Target;

/// Reads a target.
///
/// # Errors
/// [`DocumentError`] names the field that is missing, unknown or impossible.
pub fn target_from_text(text: &str) -> Result<Target, DocumentError> {
    let text = text.strip_prefix(BYTE_ORDER_MARK).unwrap_or(text);
    let begins = |entry: &str| entry.trim_start().trim_matches(QUOTES).starts_with("target_type");
    let document = if entries(text).any(begins) {
        from_kalibr(text)?
    } else if text.trim_start().starts_with('{') {
        from_json(text.as_bytes())?
    } else {
        from_toml(text)?
    };
    Target::try_from(&document)
}

/// Writes a target so that [`target_from_text`] reads it.
///
/// # Errors
/// As [`to_json_pretty`].
pub fn target_to_json(target: &Target) -> Result<String, DocumentError> {
    to_json_pretty(&TargetDocument::from(*target))
}

fn from_toml(text: &str) -> Result<TargetDocument, DocumentError> {
    toml::from_str(text).map_err(|error| {
        let problem = error.message().lines().next().unwrap_or_default().to_owned();
        let before = error.span().map_or("", |span| text.get(..span.start).unwrap_or_default());
        let line = before.lines().count().max(1);
        DocumentError::field(format!("line {line}"), problem)
    })
}

const QUOTES: [char; 2] = ['\'', '"'];

/// The `key: value` entries of YAML that has no others: on lines of their own, or within braces on
/// one line. A `#` begins a comment.
fn entries(text: &str) -> impl Iterator<Item = &str> {
    let lines = text.lines().map(|line| line.split('#').next().unwrap_or_default());
    lines.flat_map(|line| line.split(['{', '}', ','])).map(str::trim)
}

/// Kalibr's `target.yaml`.
fn from_kalibr(text: &str) -> Result<TargetDocument, DocumentError> {
    let (mut kind, mut cols, mut rows) = (None, None, None);
    let mut read = TargetDocument::of_size(TargetKind::AprilGrid, 0, 0);
    for entry in entries(text) {
        let Some((key, value)) = entry.split_once(':') else { continue };
        let [key, value] = [key, value].map(|text| text.trim().trim_matches(QUOTES));
        let wrong = || DocumentError::field(key, format!("`{value}` is not a number"));
        let count = || value.parse::<u32>().map(Some).map_err(|_| wrong());
        let real = || value.parse::<f64>().map(Some).map_err(|_| wrong());
        match key {
            "target_type" => kind = Some(kind_of_kalibr(value)?),
            "tagCols" | "targetCols" => cols = count()?,
            "tagRows" | "targetRows" => rows = count()?,
            "tagSize" => read.tag_m = real()?,
            "tagSpacing" => read.spacing = real()?,
            "codeOffset" => read.first_id = count()?,
            "rowSpacingMeters" | "colSpacingMeters" => {
                let side = real()?;
                if read.square_m.is_some() && read.square_m != side {
                    return Err(DocumentError::field(key, "squares must be square"));
                }
                read.square_m = side;
            }
            _ => {}
        }
    }
    let missing = |key: &str, example: &str| {
        DocumentError::field(key, format!("is missing; add it, as in `{key}: {example}`"))
    };
    let kind = kind.ok_or_else(|| missing("target_type", "'aprilgrid'"))?;
    let is_grid = kind == TargetKind::AprilGrid;
    let [cols_key, rows_key] =
        if is_grid { ["tagCols", "tagRows"] } else { ["targetCols", "targetRows"] };
    let cols = cols.ok_or_else(|| missing(cols_key, "6"))?;
    let rows = rows.ok_or_else(|| missing(rows_key, "6"))?;
    if is_grid && read.tag_m.is_none() {
        return Err(missing("tagSize", "0.088 # a tag's side, in meters"));
    }
    if is_grid && read.spacing.is_none() {
        return Err(missing("tagSpacing", "0.3 # the gap between tags over a tag's side"));
    }
    if !is_grid && read.square_m.is_none() {
        return Err(missing("rowSpacingMeters", "0.06 # a square's side"));
    }
    Ok(TargetDocument { kind, cols: Some(cols), rows: Some(rows), ..read })
}

fn kind_of_kalibr(name: &str) -> Result<TargetKind, DocumentError> {
    match name {
        "aprilgrid" => Ok(TargetKind::AprilGrid),
        "checkerboard" => Ok(TargetKind::Chessboard),
        other => Err(DocumentError::field(
            "target_type",
            format!("`{other}` is none of aprilgrid, checkerboard"),
        )),
    }
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
        let on_one_line = "{target_type: aprilgrid, \"tagCols\": 6, tagRows: 5,\n\
                           tagSize: 0.088, tagSpacing: 0.3} # as YAML may be written\n";
        assert_eq!(target_from_text(on_one_line), Ok(target));
        for text in [json, toml, yaml] {
            assert_eq!(target_from_text(&format!("{BYTE_ORDER_MARK}{text}")), Ok(target));
        }
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
        assert!(said(r#"{"kind":"circles"}"#).contains("`circles`"));
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
        let lines = [
            ("target_type: 'aprilgrid'", "target_type: 'aprilgrid'"),
            ("tagCols: 6", "tagCols: 6"),
            ("tagRows: 5", "tagRows: 6"),
            ("tagSize: 0.088", "tagSize: 0.088"),
            ("tagSpacing: 0.3", "tagSpacing: 0.3"),
        ];
        let without = |left_out: usize| {
            let kept = lines.iter().enumerate().filter(|(index, _)| *index != left_out);
            kept.map(|(_, (line, _))| format!("{line}\n")).collect::<String>()
        };
        for (index, (line, example)) in lines.iter().enumerate().skip(1) {
            let key = line.split(':').next().unwrap_or_default();
            let expected = format!("{key}: is missing; add it, as in `{example}");
            assert!(said(&without(index)).starts_with(&expected), "{}", said(&without(index)));
        }
        assert!(said("target_type: checkerboard\n").starts_with("targetCols: is missing"));
        assert!(said("kind = \"charuco\"\ncols = -1\n").starts_with("line 2"));
    }
}
