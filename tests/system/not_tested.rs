//! What this machine does not let a test check.

use std::io::Write;
use std::path::Path;

/// Says that something is not tested here, and why: on standard error, which is shown of tests that
/// fail, and at the end of `make test`, which prints this file.
pub fn not_tested(what: &str) {
    eprintln!("NOT TESTED: {what}");
    let path = Path::new(env!("CARGO_TARGET_TMPDIR")).join("not-tested");
    let file = std::fs::OpenOptions::new().create(true).append(true).open(path);
    // One write, so that lines of tests that run side by side stay whole.
    file.and_then(|mut file| file.write_all(format!("{what}\n").as_bytes())).unwrap();
}
