//! The answer of `plumb verify`.

use serde::Serialize;

use crate::calibration::result::ImageCalibration;
use crate::cli::verify_depth::VerifiedDepth;
use crate::cli::{Failure, output};
use crate::geometry::pixel::ImageSize;

/// A change of this many of the calibration's own standard deviations is one.
pub(super) const LIMIT_SIGMAS: f64 = 3.0;
/// Smallest limit of a change, in pixels: less is not distinguishable from the images' own errors.
pub(super) const LEAST_LIMIT_PX: f64 = 0.1;
/// A change of the lens that shows only from more than this on, in pixels, is as good as not seen:
/// chosen, as overlays and depth registration are off by a visible amount from a pixel on.
pub(super) const CERTAIN_PX: f64 = 1.0;

/// The answer.
#[derive(Debug, Serialize)]
pub(super) struct Verified {
    pub holds: bool,
    /// How far projections are off where corners are seen, beyond their noise, in pixels; where
    /// these views determine a lens of their own that is certainly another, how far it projects
    /// from the calibrated one in the median over the image.
    pub moved_px: f64,
    /// The most that the calibration's own uncertainty allows, with that of the scene's lens where
    /// it was compared with a scene.
    pub limit_px: f64,
    /// The least change of the lens, in the median over the image, that these images and the
    /// calibration show; null where they show none.
    pub visible_px: Option<f64>,
    /// The error of these images with the lens as calibrated; null for a scene.
    pub rms_px: Option<f64>,
    /// The same with the lens that fits them best; null where they do not determine one.
    pub best_rms_px: Option<f64>,
    pub views: usize,
    /// Depth against the board; left out where the calibration or the images have none.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub depth: Option<VerifiedDepth>,
    pub reasons: Vec<String>,
}

impl Verified {
    /// Whether a change of the lens in half of the image would be seen.
    fn saw_lens(&self) -> bool {
        self.visible_px.is_some_and(|visible_px| visible_px <= CERTAIN_PX)
    }

    fn answer(&self) -> &'static str {
        match self.depth.as_ref().is_none_or(VerifiedDepth::saw_all) && self.saw_lens() {
            _ if !self.holds => "does not hold",
            true => "holds",
            false => "holds as far as can be seen",
        }
    }

    /// The same with what is said of depth.
    pub fn with_depth(mut self, depth: Option<VerifiedDepth>) -> Self {
        if let Some(depth) = &depth {
            self.holds &= depth.holds;
            self.reasons.extend(depth.reasons.iter().cloned());
        }
        Self { depth, ..self }
    }
}

/// Refuses images of another size than those that the calibration in `file` is for.
pub(super) fn same_size(
    size: ImageSize,
    file: &str,
    sensor: &ImageCalibration,
) -> Result<(), Failure> {
    if size == sensor.image_size {
        return Ok(());
    }
    Err(Failure::failed(format!(
        "the images are {size}, {file} is for {}: give images of that size, or the calibration exported for theirs",
        sensor.image_size
    )))
}

/// Prints the answer, of the calibration in `file`.
///
/// # Errors
/// When nothing can be written.
pub(super) fn print(verified: &Verified, file: &str, json: bool) -> Result<(), Failure> {
    if json {
        return output::print_json(verified);
    }
    let answer = verified.answer();
    let Verified { moved_px, limit_px, views, depth, reasons, .. } = verified;
    let rms = verified.rms_px.map(|rms_px| format!("rms {rms_px:.3} px, ")).unwrap_or_default();
    let seen = if verified.saw_lens() { "" } else { " where these images show it" };
    output::print_line(&format!(
        "{file} {answer}: {views} views, {rms}projections off by {moved_px:.3} px{seen}, {limit_px:.3} px allowed"
    ))?;
    let of_depth = depth.as_ref().map(VerifiedDepth::lines).unwrap_or_default();
    of_depth.iter().chain(reasons).try_for_each(|line| output::print_line(&format!("  {line}")))
}
