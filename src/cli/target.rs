//! `plumb target`: a board to print at its true size, with its description in a file beside it.

use std::path::PathBuf;
use std::str::FromStr;

use crate::cli::files::{check_not_read, same_file, write_file};
use crate::cli::target_args::read_target;
use crate::cli::target_sheet::PaperSheet;
use crate::cli::{Failure, output};
use crate::document::target_file::target_to_json;
use crate::geometry::printed_board::PrintedBoard;

/// Draw a board to print: a chessboard, a ChArUco board or an AprilGrid.
#[derive(Debug, clap::Args)]
pub struct Args {
    /// The target, as JSON or TOML, or Kalibr's YAML.
    #[arg(long, value_name = "FILE")]
    target: PathBuf,
    /// The paper: a4, a3, letter, or its size as in 594x841mm.
    #[arg(long, default_value = "a4")]
    paper: Paper,
    /// Dots per inch of a PNG.
    #[arg(long, default_value_t = 300, value_parser = clap::value_parser!(u32).range(20..=2400))]
    dpi: u32,
    /// The file to write: .pdf, .svg or .png. The target definition is written beside it as JSON.
    #[arg(long, value_name = "FILE")]
    out: PathBuf,
}

/// A size of paper.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Paper {
    /// Width and height, in millimeters.
    mm: [f64; 2],
}

/// Not a size of paper.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("`{text}` is no paper: give a4, a3, letter, or a size as in 594x841mm")]
struct NotPaper {
    text: String,
}

impl FromStr for Paper {
    type Err = NotPaper;
    fn from_str(text: &str) -> Result<Self, NotPaper> {
        let not_paper = || NotPaper { text: text.to_owned() };
        let mm = match text.to_ascii_lowercase().as_str() {
            "a4" => [210.0, 297.0],
            "a3" => [297.0, 420.0],
            "letter" => [215.9, 279.4],
            other => {
                let sides = other.strip_suffix("mm").and_then(|sides| sides.split_once('x'));
                let (width, height) = sides.ok_or_else(not_paper)?;
                let side = |text: &str| {
                    let side: f64 = text.trim().parse().map_err(|_| not_paper())?;
                    if (20.0..=3000.0).contains(&side) { Ok(side) } else { Err(not_paper()) }
                };
                [side(width)?, side(height)?]
            }
        };
        Ok(Self { mm })
    }
}

/// Runs the command.
///
/// # Errors
/// When the target cannot be read or does not fit the paper, or the files cannot be written.
pub fn run(args: &Args) -> Result<(), Failure> {
    let target = read_target(&args.target)?;
    check_not_read(&args.out, &[&args.target])?;
    let sheet = PaperSheet::new(&PrintedBoard::of(&target), args.paper.mm, &target.to_string())
        .map_err(Failure::usage)?;
    let ending = args.out.extension().and_then(|ending| ending.to_str()).unwrap_or_default();
    let bytes = match ending.to_ascii_lowercase().as_str() {
        "pdf" => sheet.to_pdf(),
        "svg" => sheet.to_svg().into_bytes(),
        "png" => sheet.to_png(f64::from(args.dpi)).map_err(Failure::failed)?,
        _ => {
            let name = args.out.display();
            return Err(Failure::usage(format!(
                "{name}: give a name that ends in .pdf, .svg or .png"
            )));
        }
    };
    let description = args.out.with_extension("json");
    // The description of an earlier print is replaced together with it.
    let is_kept = match description.exists().then(|| read_target(&description)) {
        None => false,
        Some(there) => {
            there.is_err() || (there.is_ok_and(|there| there != target) && !args.out.exists())
        }
    };
    if is_kept {
        return Err(Failure::failed(format!(
            "{}: the target would be written here, but another file is there: give --out another name",
            description.display()
        )));
    }
    write_file(&args.out, &bytes)?;
    if !same_file(&description, &args.target) {
        let json = target_to_json(&target).map_err(Failure::failed)?;
        write_file(&description, json.as_bytes())?;
    }
    output::print_line(&format!(
        "{}: a {target}; print it at 100 %, and measure the ruler",
        args.out.display()
    ))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn paper_has_a_name_or_a_size() {
        assert_eq!("A4".parse(), Ok(Paper { mm: [210.0, 297.0] }));
        assert_eq!("594x841mm".parse(), Ok(Paper { mm: [594.0, 841.0] }));
        for wrong in ["a9", "594x841", "0x1mm", "x", ""] {
            assert!(wrong.parse::<Paper>().is_err(), "{wrong}");
        }
    }
}
