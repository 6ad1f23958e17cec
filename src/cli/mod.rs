//! The command line: one file for each command, with its `Args` and its `run`.
//!
//! A command writes its result to stdout through [`output`], and nothing else is written there:
//! logs and progress go to stderr. With `--json`, the result is exactly one JSON document, or one
//! line of JSON for each item where the command states it. An error is a [`Failure`]: one line and
//! an exit code, printed here and nowhere else.
//!
//! A new command is a file, a variant of `Command`, and an arm of `dispatch`.

pub mod autocalibrate;
pub mod board;
mod board_check;
pub mod calibrate;
mod calibrate_rgbd;
pub mod calibration_output;
mod choose;
pub mod correct;
pub mod detect;
mod detect_args;
pub mod devices;
pub mod estimated;
pub mod export;
pub mod failure;
pub mod files;
pub mod focus;
pub mod gather;
pub mod in_order;
pub mod length;
mod lens_change;
pub mod lens_name;
pub mod output;
mod plane_errors;
pub mod progress;
mod recognize;
pub mod record;
pub mod rectify;
mod result_image;
pub mod rig;
mod row_differences;
mod scene_depth;
mod scene_images;
pub mod search;
pub mod search_args;
pub mod serve;
pub mod simulate;
pub mod solve;
pub mod sources;
pub mod store;
pub mod target;
pub mod target_args;
mod target_sheet;
pub mod token;
pub mod uncertainty;
pub mod undistort;
mod verified;
pub mod verify;
mod verify_depth;
mod verify_scene;

use std::ffi::OsString;
use std::io::IsTerminal;
use std::process::ExitCode;

use clap::error::ErrorKind;
use clap::{Parser, Subcommand};

pub use failure::Failure;

/// Detect calibration boards, calibrate cameras, and state the uncertainty of the result.
#[derive(Debug, Parser)]
#[command(name = "plumb", version, max_term_width = 100)]
struct Arguments {
    #[command(subcommand)]
    command: Command,
}

#[derive(Debug, Subcommand)]
enum Command {
    Autocalibrate(autocalibrate::Args),
    Board(board::Args),
    Detect(detect::Args),
    Calibrate(calibrate::Args),
    Correct(correct::Args),
    Serve(serve::Args),
    Solve(solve::Args),
    Devices(devices::Args),
    Export(export::Args),
    Focus(focus::Args),
    Record(record::Args),
    Rectify(rectify::Args),
    Simulate(simulate::Args),
    Store(store::Args),
    Target(target::Args),
    Token(token::Args),
    Uncertainty(uncertainty::Args),
    Undistort(undistort::Args),
    Verify(verify::Args),
}

fn dispatch(command: Command) -> Result<(), Failure> {
    match command {
        Command::Autocalibrate(args) => autocalibrate::run(&args),
        Command::Board(args) => board::run(&args),
        Command::Detect(args) => detect::run(&args),
        Command::Calibrate(args) => calibrate::run(&args),
        Command::Correct(args) => correct::run(&args),
        Command::Serve(args) => serve::run(&args),
        Command::Solve(args) => solve::run(&args),
        Command::Devices(args) => devices::run(&args),
        Command::Export(args) => export::run(&args),
        Command::Focus(args) => focus::run(&args),
        Command::Record(args) => record::run(&args),
        Command::Rectify(args) => rectify::run(&args),
        Command::Simulate(args) => simulate::run(&args),
        Command::Store(args) => store::run(&args),
        Command::Target(args) => target::run(&args),
        Command::Token(args) => token::run(&args),
        Command::Uncertainty(args) => uncertainty::run(&args),
        Command::Undistort(args) => undistort::run(&args),
        Command::Verify(args) => verify::run(&args),
    }
}

/// Runs the command that `arguments` (the program's name first) request, and prints an error as one
/// line on stderr.
pub fn run(arguments: impl IntoIterator<Item = OsString>) -> ExitCode {
    let outcome = match Arguments::try_parse_from(arguments) {
        Ok(arguments) => {
            log_to_stderr();
            dispatch(arguments.command)
        }
        Err(asked)
            if matches!(asked.kind(), ErrorKind::DisplayHelp | ErrorKind::DisplayVersion) =>
        {
            output::print_text(&asked.render().to_string())
        }
        Err(error) => Err(Failure::usage(one_line(&error))),
    };
    match outcome {
        Ok(()) => ExitCode::SUCCESS,
        Err(failure) => {
            if let Some(line) = failure.line() {
                output::print_error(line);
            }
            ExitCode::from(failure.exit_code())
        }
    }
}

/// clap's message on one line: what was wrong, its suggestion, and where to read more.
fn one_line(error: &clap::Error) -> String {
    if error.kind() == ErrorKind::DisplayHelpOnMissingArgumentOrSubcommand {
        return "a command is missing; see `plumb --help`".to_owned();
    }
    let rendered = error.render().to_string();
    let line = rendered.split("\n\nUsage:").next().unwrap_or(&rendered);
    let line = line.strip_prefix("error: ").unwrap_or(line);
    let line = line.split("\n\nFor more information").next().unwrap_or(line);
    let one = |paragraph: &str| paragraph.split_whitespace().collect::<Vec<_>>().join(" ");
    let paragraphs: Vec<String> = line.split("\n\n").map(one).filter(|p| !p.is_empty()).collect();
    format!("{}; see --help", paragraphs.join("; "))
}

/// Logs the events of the libraries and the daemon at the level in the environment variable
/// `RUST_LOG`; without it, warnings, and information from this program.
fn log_to_stderr() {
    let filter = tracing_subscriber::EnvFilter::try_from_default_env()
        .unwrap_or_else(|_| tracing_subscriber::EnvFilter::new("warn,plumb=info"));
    // If several commands run in one process, only the first one sets up logging.
    let _ = tracing_subscriber::fmt()
        .with_env_filter(filter)
        .with_ansi(std::io::stderr().is_terminal())
        .with_writer(std::io::stderr)
        .try_init();
}

#[cfg(test)]
mod tests {
    use super::*;
    use clap::CommandFactory;

    #[test]
    fn a_tip_is_set_off_from_what_was_wrong() {
        let asked = ["plumb", "verify", "--calibration", "a.json", "--square", "1", "b.png"];
        let line = one_line(&Arguments::try_parse_from(asked).unwrap_err());
        assert!(line.starts_with("unexpected argument '--square' found; tip: "), "{line}");
        assert!(line.ends_with("; see --help") && !line.contains('\n'), "{line}");
    }

    #[test]
    fn the_arguments_are_consistent() {
        Arguments::command().debug_assert();
    }
}
