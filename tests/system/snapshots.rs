//! What the outside relies on, as it is written today: the OpenAPI document, the help of every
//! command, and each export of one calibration. A change of these is a change for users:
//! `INSTA_UPDATE=always cargo test --test system snapshots` accepts it, and the diff shows it.

use std::path::Path;

use crate::program::plumb;
use crate::served::Served;

/// Significant digits that a snapshot keeps of a number: the last ones of a refitted lens depend on
/// the processor's instructions.
const DIGITS: usize = 8;

fn settings() -> insta::Settings {
    let mut settings = insta::Settings::clone_current();
    settings.set_prepend_module_to_snapshot(false);
    settings.set_omit_expression(true);
    settings
}

/// `text` with each decimal number rounded to [`DIGITS`] significant digits.
fn rounded(text: &str) -> String {
    let in_number = |c: char| c.is_ascii_digit() || matches!(c, '.' | 'e' | 'E' | '-' | '+');
    let mut out = String::new();
    let mut rest = text;
    while !rest.is_empty() {
        let start = rest.find(|c: char| c.is_ascii_digit()).unwrap_or(rest.len());
        let (before, after) = rest.split_at(start);
        out += before;
        let end = after.find(|c| !in_number(c)).unwrap_or(after.len());
        let (number, after) = after.split_at(end);
        match number.parse::<f64>() {
            Ok(value) if number.contains('.') => {
                let value: f64 = format!("{value:.*e}", DIGITS - 1).parse().expect("a number");
                out += &value.to_string();
            }
            _ => out += number,
        }
        rest = after;
    }
    out
}

#[test]
fn numbers_are_rounded_and_the_rest_is_left() {
    let text = "[602.42824157376, -2.5e-20] v1.2.3 20 frames, a.b";
    assert_eq!(rounded(text), "[602.42824, -0.000000000000000000025] v1.2.3 20 frames, a.b");
}

#[test]
fn the_help_of_every_command() {
    let overview = plumb(["--help"]).stdout;
    let commands = overview
        .lines()
        .skip_while(|line| *line != "Commands:")
        .skip(1)
        .map_while(|line| line.split_whitespace().next())
        .filter(|name| *name != "help");
    settings().bind(|| {
        insta::assert_snapshot!("help", overview);
        for command in commands {
            let help = plumb([command, "--help"]);
            assert_eq!(help.code, Some(0), "{command}: {}", help.stderr);
            insta::assert_snapshot!(format!("help-{command}"), help.stdout);
        }
    });
}

#[test]
fn every_export_of_a_calibration() {
    let file =
        Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/system/snapshots/calibration.json");
    let formats = ["json", "ros", "opencv", "kalibr", "mrcal", "colmap", "urdf", "tf", "depth"];
    settings().bind(|| {
        for format in formats {
            let arguments =
                ["export", "--calibration", &file.display().to_string(), "--format", format]
                    .map(str::to_owned);
            let exported = plumb(arguments);
            assert_eq!(exported.code, Some(0), "{format}: {}", exported.stderr);
            insta::assert_snapshot!(format!("export-{format}"), rounded(&exported.stdout));
        }
    });
}

#[test]
fn the_openapi_document() {
    let folder = tempfile::tempdir().expect("a folder");
    let served = Served::start(folder.path(), "");
    let document = served.get("/openapi.json").json();
    let pretty = serde_json::to_string_pretty(&document).expect("JSON");
    settings().bind(|| insta::assert_snapshot!("openapi", pretty));
}
