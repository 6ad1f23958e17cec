//! JSON in and out: errors that name the field, numbers that keep every bit.

use serde::de::{DeserializeOwned, IgnoredAny};
use serde::{Deserialize, Deserializer, Serialize};
use serde_json::error::Category;

use crate::document::error::DocumentError;
use crate::document::objects_only::ObjectsOnly;

/// What some editors begin UTF-8 text with; it is no part of the text.
pub(super) const BYTE_ORDER_MARK: &str = "\u{feff}";

/// Reads a document.
///
/// # Errors
/// [`DocumentError::Field`] with the field's path when a field is missing, unknown, of the wrong
/// shape (an array is no object), or holds what JSON has no number for (`NaN`, `Infinity`, 1e999);
/// [`DocumentError::Syntax`] when the text is not JSON at all.
pub fn from_json<T: DeserializeOwned>(json: &[u8]) -> Result<T, DocumentError> {
    // RFC 8259, section 8.1: nobody should write it, and a reader may ignore it.
    let json = json.strip_prefix(BYTE_ORDER_MARK.as_bytes()).unwrap_or(json);
    let mut reader = serde_json::Deserializer::from_slice(json);
    let document = serde_path_to_error::deserialize(ObjectsOnly(&mut reader)).map_err(|e| {
        let path = e.path().to_string();
        located(json, &path, &e.into_inner())
    })?;
    reader.end().map_err(|e| syntax(json, &e))?;
    Ok(document)
}

/// A field that is there, null or not; serde alone takes null for a field that is not.
pub(super) fn null_is_a_value<'de, D: Deserializer<'de>, T: Deserialize<'de>>(
    deserializer: D,
) -> Result<Option<Option<T>>, D::Error> {
    Option::deserialize(deserializer).map(Some)
}

/// Writes a document on one line. Doubles are written with as few digits as read back to the same
/// bits.
///
/// # Errors
/// [`DocumentError::Field`] never happens for the documents of this layer: all their keys are
/// strings.
pub fn to_json<T: Serialize>(document: &T) -> Result<String, DocumentError> {
    serde_json::to_string(document).map_err(unwritable)
}

/// As [`to_json`], indented for people.
///
/// # Errors
/// As [`to_json`].
pub fn to_json_pretty<T: Serialize>(document: &T) -> Result<String, DocumentError> {
    serde_json::to_string_pretty(document).map_err(unwritable)
}

#[expect(clippy::needless_pass_by_value, reason = "the shape that map_err wants")]
fn unwritable(error: serde_json::Error) -> DocumentError {
    DocumentError::field("document", format!("cannot be written as JSON: {error}"))
}

fn located(json: &[u8], path: &str, error: &serde_json::Error) -> DocumentError {
    // An array that is too long ends, to the parser, where the last element it wants does.
    if error.classify() == Category::Syntax
        && error.to_string().starts_with("trailing characters")
        && serde_json::from_slice::<IgnoredAny>(json).is_ok()
    {
        return DocumentError::field(path, "has too many elements");
    }
    let not_a_number = not_a_number_at(json, error);
    match error.classify() {
        Category::Syntax
            if not_a_number.is_none() && !error.to_string().starts_with("number out of range") =>
        {
            syntax(json, error)
        }
        Category::Eof | Category::Io => syntax(json, error),
        _ => {
            let problem =
                not_a_number.unwrap_or_else(|| in_terms_of_json(&without_position(error)));
            let missing =
                problem.strip_prefix("missing field `").and_then(|rest| rest.split('`').next());
            match missing {
                Some(name) if path == "." => DocumentError::field(name, "is missing"),
                Some(name) => DocumentError::field(format!("{path}.{name}"), "is missing"),
                None if path == "." => DocumentError::field("document", problem),
                None => DocumentError::field(path, problem),
            }
        }
    }
}

fn syntax(json: &[u8], error: &serde_json::Error) -> DocumentError {
    let problem = if json.iter().all(u8::is_ascii_whitespace) {
        "nothing there".into()
    } else {
        without_position(error)
    };
    DocumentError::Syntax { line: error.line(), column: error.column(), problem }
}

/// The parser's words without its " at line 1 column 2".
fn without_position(error: &serde_json::Error) -> String {
    let text = error.to_string();
    text.split(" at line ").next().unwrap_or_default().to_owned()
}

/// The parser's words for a reader who knows JSON but not the types that it is read into.
fn in_terms_of_json(problem: &str) -> String {
    let parts = problem.strip_prefix("invalid ").and_then(|rest| rest.split_once(", expected "));
    let Some((found, wanted)) = parts else { return problem.to_owned() };
    let wanted = match wanted {
        "f64" => "a number",
        "u8" => "a whole number from 0 to 255",
        "u16" => "a whole number from 0 to 65535",
        "u32" => "a whole number from 0 to 4294967295",
        "u64" | "usize" => "a whole number, 0 or more",
        "i64" => "a whole number",
        "a sequence" => "an array",
        structure if structure.starts_with("struct ") => "an object",
        other => other,
    };
    if let Some(length) = found.strip_prefix("length ") {
        return format!("has length {length}, expected {wanted}");
    }
    let found = match found.trim_start_matches("type: ").trim_start_matches("value: ") {
        "sequence" => "an array",
        "map" => "an object",
        value => ["integer ", "floating point ", "boolean ", "string "]
            .into_iter()
            .find_map(|kind| value.strip_prefix(kind))
            .unwrap_or(value),
    };
    format!("is {found}, expected {wanted}")
}

/// Names the word when the parser stumbled over what other languages print for a double that is no
/// number.
fn not_a_number_at(json: &[u8], error: &serde_json::Error) -> Option<String> {
    let line = json.split(|&b| b == b'\n').nth(error.line().checked_sub(1)?)?;
    // The parser points at the offending byte or one past it.
    let around = line.get(error.column().saturating_sub(3)..)?;
    let around = String::from_utf8_lossy(around.get(..around.len().min(12))?).into_owned();
    let word = ["-Infinity", "Infinity", "NaN", "-inf", "inf", "nan"].into_iter().find(|word| {
        let at = around.find(word);
        at.is_some_and(|at| at <= 2)
    })?;
    Some(format!("{word} is not a number; every number must be finite"))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::document::problem::ProblemDocument;
    use crate::document::session::StartDocument;

    #[test]
    fn errors_name_the_field_in_one_line() {
        let view = |image: &str| {
            format!(
                r#"{{"image_size":[640,480],"views":[{{"object":[[0,0,0]],"image":{image}}}]}}"#
            )
        };
        let table = [
            (
                view("[[1,NaN]]"),
                "views[0].image[0][1]: NaN is not a number; every number must be finite",
            ),
            (
                view("[[1, Infinity]]"),
                "views[0].image[0][1]: Infinity is not a number; every number must be finite",
            ),
            (
                view("[[-Infinity,2]]"),
                "views[0].image[0][0]: -Infinity is not a number; every number must be finite",
            ),
            (
                view("[[nan,2]]"),
                "views[0].image[0][0]: nan is not a number; every number must be finite",
            ),
            (view("[[1,1e999]]"), "views[0].image[0][1]: number out of range"),
            (view("[[1,null]]"), "views[0].image[0][1]: is null, expected a number"),
            (view("[[1]]"), "views[0].image[0]: has length 1, expected an array of length 2"),
            (view("[[1,2,3]]"), "views[0].image[0]: has too many elements"),
            (view("[1,2]"), "views[0].image[0]: is `1`, expected an array of length 2"),
            (view("{}"), "views[0].image: is an object, expected an array"),
            (view(r#""x""#), r#"views[0].image: is "x", expected an array"#),
            (r#"{"image_size":[640,480]}"#.into(), "views: is missing"),
            (
                r#"{"image_size":[640,480],"views":[{"image":[]}]}"#.into(),
                "views[0].object: is missing",
            ),
            (
                r#"{"image_size":[640],"views":[]}"#.into(),
                "image_size: has length 1, expected an array of length 2",
            ),
            (
                r#"{"image_size":[640,-1],"views":[]}"#.into(),
                "image_size[1]: is `-1`, expected a whole number from 0 to 4294967295",
            ),
            ("".into(), "not JSON at line 1, column 0: nothing there"),
            ("{".into(), "not JSON at line 1, column 1: EOF while parsing an object"),
            ("7".into(), "document: is `7`, expected an object"),
        ];
        for (json, expected) in table {
            let error = from_json::<ProblemDocument>(json.as_bytes()).unwrap_err();
            assert_eq!(error.to_string(), expected, "for {json}");
        }
    }

    #[test]
    fn an_array_is_no_object_at_any_depth() {
        let table = [
            (r#"[["chessboard",9,6,0.025]]"#, "document"),
            (r#"{"target":["chessboard",9,6,0.025]}"#, "target"),
            (r#"{"target":{"kind":"scene"},"finish":[5]}"#, "finish"),
            (r#"{"target":{"kind":"scene"},"finish":[]}"#, "finish"),
        ];
        for (json, field) in table {
            let error = from_json::<StartDocument>(json.as_bytes()).unwrap_err();
            assert_eq!(error.to_string(), format!("{field}: is an array, expected an object"));
        }
        let views = br#"{"image_size":[640,480],"views":[["a",[[0,0,0]],[[1,2]]]]}"#;
        let error = from_json::<ProblemDocument>(views).unwrap_err();
        assert_eq!(error.to_string(), "views[0]: is an array, expected an object");
    }

    #[test]
    fn text_after_the_document_is_refused() {
        let error = from_json::<[f64; 1]>(b"[1] 2").unwrap_err();
        assert_eq!(error.to_string(), "not JSON at line 1, column 5: trailing characters");
    }

    #[test]
    fn doubles_keep_every_bit() {
        let mut bits = 0x9e37_79b9_7f4a_7c15_u64;
        for _ in 0..10_000 {
            bits ^= bits << 13;
            bits ^= bits >> 7;
            bits ^= bits << 17;
            let value = f64::from_bits(bits);
            if value.is_finite() {
                let [back] = from_json::<[f64; 1]>(to_json(&[value]).unwrap().as_bytes()).unwrap();
                assert_eq!(back.to_bits(), value.to_bits());
            }
        }
    }
}
