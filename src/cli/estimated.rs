//! What a solve estimates beyond the lens model, and what it takes as given: the same for every
//! command that solves.

use crate::estimation::camera::CameraOptions;

/// What is estimated, and what is known.
#[derive(Debug, clap::Args)]
pub struct EstimatedArgs {
    /// Estimate skew too; else it is 0.
    #[arg(long)]
    skew: bool,
    /// Let fx be fy.
    #[arg(long)]
    square_pixels: bool,
    /// A lens parameter that is known, as fx=600; may be given several times.
    #[arg(long, value_name = "NAME=VALUE", value_parser = parameter)]
    given: Vec<(String, f64)>,
    /// Estimate how far the board is bowed at its middle along its rows and columns, too; else it
    /// is flat.
    #[arg(long)]
    warp: bool,
}

impl EstimatedArgs {
    /// Asks for it on top of what `options` ask for.
    pub fn add_to(&self, options: &mut CameraOptions) {
        options.square_pixels |= self.square_pixels;
        options.skew |= self.skew;
        options.warp |= self.warp;
        options.given.extend(self.given.iter().cloned());
    }
}

/// Reads `NAME=VALUE`.
pub(crate) fn parameter(text: &str) -> Result<(String, f64), String> {
    let (name, value) = text.split_once('=').ok_or("write NAME=VALUE, as fx=600")?;
    let value = value
        .parse()
        .map_err(|_| format!("`{value}` is not a number; write NAME=VALUE, as fx=600"))?;
    Ok((name.to_owned(), value))
}
