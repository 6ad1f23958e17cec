//! `plumb focus`: the depth of field of a lens, and the board to use with it.

use crate::cli::length::Length;
use crate::cli::{Failure, output};
use crate::document::focus::FocusDocument;
use crate::geometry::board::BoardSize;
use crate::geometry::thin_lens::ThinLens;

/// Compute a lens's depth of field, and which board to use at which distance
#[derive(Debug, clap::Args)]
pub struct Args {
    /// The focal length, as in 8mm
    #[arg(long, value_name = "LENGTH")]
    focal: Length,
    /// The aperture: focal length over diameter, as in 2.8
    #[arg(long, value_name = "N")]
    f_number: f64,
    /// The width of one pixel, as in 3.45um
    #[arg(long, value_name = "LENGTH")]
    pixel: Length,
    /// The distance in focus, as in 1m, or inf
    #[arg(long, value_name = "LENGTH", value_parser = distance_m)]
    focus: f64,
    /// The width of the image in pixels
    #[arg(long, value_name = "PIXELS", default_value_t = 1280)]
    width: u32,
    /// Inner corners of the board, COLSxROWS
    #[arg(long, default_value = "9x6")]
    board: BoardSize,
    /// Largest acceptable circle of confusion, in pixels
    #[arg(long, value_name = "PIXELS", default_value_t = 1.0)]
    blur: f64,
    /// Print the answer as one JSON document
    #[arg(long)]
    json: bool,
}

/// Runs the command.
///
/// # Errors
/// A usage failure for impossible lens parameters.
pub fn run(args: &Args) -> Result<(), Failure> {
    let lens = ThinLens {
        focal_m: args.focal.meters,
        f_number: args.f_number,
        pixel_m: args.pixel.meters,
        focus_m: args.focus,
    };
    let lens = lens.check().map_err(Failure::usage)?;
    if !(args.blur > 0.0 && args.blur.is_finite()) || args.width == 0 {
        return Err(Failure::usage("--blur and --width must be above 0"));
    }
    let focus = FocusDocument::new(&lens, args.blur, Some((args.board.cols, args.width)));
    if args.json {
        return output::print_json(&focus);
    }
    let depth = &focus.depth_of_field;
    let far = depth.far_m.map_or_else(|| "infinity".to_owned(), |far_m| format!("{far_m:.3} m"));
    output::print_line(&format!(
        "sharp to {} px from {:.3} m to {far}; hyperfocal distance {:.3} m",
        args.blur, depth.near_m, focus.hyperfocal_m
    ))?;
    output::print_line(&format!(
        "expected focal length of the calibration: about {:.1} px",
        focus.focal_px
    ))?;
    focus.board.map_or(Ok(()), |board| {
        output::print_line(&format!(
            "use a board of {} inner corners with squares of {:.1} mm, at about {:.2} m",
            args.board,
            1000.0 * board.square_m,
            board.distance_m
        ))
    })
}

fn distance_m(text: &str) -> Result<f64, String> {
    if matches!(text, "inf" | "infinity") {
        return Ok(f64::INFINITY);
    }
    text.parse::<Length>().map(|length| length.meters).map_err(|error| error.to_string())
}
