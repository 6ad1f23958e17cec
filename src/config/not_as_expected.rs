//! TOML that is none, or in which something else stands than a configuration has there.

use crate::config::error::ConfigError;
use crate::config::place::Place;

/// What the parser and serde say of types, and what a user says.
const TYPES: [(&str, &str); 7] = [
    ("invalid type: map", "invalid type: a table"),
    ("expected a sequence", "expected a list"),
    ("expected a map", "expected a table"),
    ("expected u64", "expected a whole number from 0 on"),
    ("expected u32", "expected a whole number from 0 on"),
    ("expected u16", "expected a whole number from 0 on"),
    ("expected f64", "expected a number"),
];

/// The refusal of what `error` is about.
pub(super) fn not_as_expected(error: &toml::de::Error, place: &Place) -> ConfigError {
    let (message, span) = (error.message(), error.span().unwrap_or(0..0));
    let written = place.text.get(span.clone()).unwrap_or_default();
    let header = written.strip_prefix('[').and_then(|name| name.strip_suffix(']'));
    let is_header_of_other_type = message.starts_with("invalid type");
    if let Some(name) = header.filter(|_| is_header_of_other_type) {
        return match name.strip_prefix('[').and_then(|name| name.strip_suffix(']')) {
            Some(name) => place.refuse(&span, name, format!("there is one; write [{name}]")),
            None => {
                let problem = format!("there can be several; write [[{name}]] for each");
                place.refuse(&span, name, problem)
            }
        };
    }
    if message == "duplicate key" {
        return place.refuse(&span, written, "it is written twice; keep one");
    }
    let named = message.split('`').nth(1).filter(|_| message.contains(" field `"));
    let key = named.map(str::to_owned).or_else(|| place.key_before(&span));
    let of = |message: String, (theirs, ours): &(&str, &str)| message.replace(theirs, ours);
    let problem = TYPES.iter().fold(one_line(message), of);
    place.refuse(&span, key.as_deref().unwrap_or("not TOML"), problem)
}

/// A message without line breaks.
pub(super) fn one_line(message: &str) -> String {
    message.split_whitespace().collect::<Vec<_>>().join(" ")
}

#[cfg(test)]
mod tests {
    use std::path::Path;

    use crate::config::written::Written;

    fn refusal(text: &str) -> String {
        Written::parse(text, Path::new("p.toml")).unwrap_err().to_string()
    }

    #[test]
    fn what_is_not_as_expected_is_named_by_its_key() {
        let named = [
            (
                "[camera]\nname = \"a\"\n",
                "p.toml:1: camera: there can be several; write [[camera]] for each",
            ),
            ("\n[[server]]\n", "p.toml:2: server: there is one; write [server]"),
            ("server = 3\n", "p.toml:1: server: invalid type: integer `3`, expected a table"),
            (
                "[store]\nkeep_mb = 1\nkeep_mb = 2\n",
                "p.toml:3: keep_mb: it is written twice; keep one",
            ),
            (
                "[server]\nsolve_seconds = -3\n",
                "p.toml:2: solve_seconds: invalid value: integer `-3`, expected a whole number from 0 on",
            ),
            ("[server\n", "p.toml:1: not TOML: unclosed table, expected `]`"),
        ];
        for (text, expected) in named {
            assert_eq!(refusal(text), expected);
        }
        let source = refusal("[[camera]]\nname = \"a\"\nsource = \"/dev/video0\"\n");
        assert!(source.starts_with("p.toml:3: source: "), "{source}");
        assert!(source.ends_with("expected a table"), "{source}");
    }
}
