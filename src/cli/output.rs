//! A command's result on stdout, where nothing else is written.

use std::io::{self, Write};

use serde::Serialize;

use crate::cli::Failure;

/// Writes `document` as one line of JSON.
///
/// # Errors
/// When stdout cannot be written to.
pub fn print_json(document: &impl Serialize) -> Result<(), Failure> {
    let json = serde_json::to_string(document).map_err(|error| {
        Failure::failed(format!("the result cannot be written as JSON: {error}"))
    })?;
    print_line(&json)
}

/// Writes `line` and a newline.
///
/// # Errors
/// When stdout cannot be written to.
pub fn print_line(line: &str) -> Result<(), Failure> {
    let mut stdout = io::stdout().lock();
    stdout
        .write_all(line.as_bytes())
        .and_then(|()| stdout.write_all(b"\n"))
        .map_err(|error| closed(&error))
}

/// Writes `text` unchanged.
///
/// # Errors
/// When stdout cannot be written to.
pub fn print_text(text: &str) -> Result<(), Failure> {
    print_bytes(text.as_bytes())
}

/// Writes `bytes` unchanged.
///
/// # Errors
/// When stdout cannot be written to.
pub fn print_bytes(bytes: &[u8]) -> Result<(), Failure> {
    let mut stdout = io::stdout().lock();
    stdout.write_all(bytes).and_then(|()| stdout.flush()).map_err(|error| closed(&error))
}

/// Writes the one line of a failure to stderr.
pub fn print_error(line: &str) {
    // If stderr is closed, there is nothing to do about it.
    let _ = writeln!(io::stderr(), "plumb: {line}");
}

fn closed(error: &io::Error) -> Failure {
    if error.kind() == io::ErrorKind::BrokenPipe {
        Failure::output_closed()
    } else {
        Failure::failed(format!("cannot write to standard output: {error}"))
    }
}
