//! Arguments in, an exit code out.

use std::process::ExitCode;

fn main() -> ExitCode {
    plumb::cli::run(std::env::args_os())
}
