//! The binary as its users run it.

use std::ffi::OsStr;
use std::process::{Command, Stdio};

/// What a finished command left.
#[derive(Debug)]
pub struct Finished {
    /// Its exit code; `None` for one that a signal ended.
    pub code: Option<i32>,
    /// What it printed.
    pub stdout: String,
    /// What it said besides.
    pub stderr: String,
}

/// Runs `plumb` with `arguments` to its end, with nothing on standard input.
pub fn plumb<A: AsRef<OsStr>>(arguments: impl IntoIterator<Item = A>) -> Finished {
    let mut command = Command::new(env!("CARGO_BIN_EXE_plumb"));
    let output =
        command.args(arguments).stdin(Stdio::null()).env_remove("RUST_LOG").output().unwrap();
    Finished {
        code: output.status.code(),
        stdout: String::from_utf8(output.stdout).unwrap(),
        stderr: String::from_utf8(output.stderr).unwrap(),
    }
}
