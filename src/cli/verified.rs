//! The result of `plumb verify`.

use serde::Serialize;

use crate::calibration::result::ImageCalibration;
use crate::cli::verify_depth::VerifiedDepth;
use crate::cli::{Failure, output};
use crate::geometry::pixel::ImageSize;

/// A difference of more than this many of the calibration's own standard deviations counts as a
/// change.
pub(super) const LIMIT_SIGMAS: f64 = 3.0;
/// The smallest limit of a change, in pixels: less is not distinguishable from the errors of the
/// images.
pub(super) const LEAST_LIMIT_PX: f64 = 0.1;
/// If a change of the lens is detectable only from more than this on, in pixels, the images count
/// as not showing it. Chosen, as overlays and depth registration are visibly off from a pixel on.
pub(super) const CERTAIN_PX: f64 = 1.0;

/// The result.
#[derive(Debug, Serialize)]
pub(super) struct Verified {
    pub holds: bool,
    /// The projection error where corners are seen, beyond their noise, in pixels. If these views
    /// determine a lens that differs significantly from the calibrated one: the median over the
    /// image of the difference between the projections of the two, where that is larger.
    pub moved_px: f64,
    /// The largest deviation that the calibration's own uncertainty allows, including the
    /// uncertainty of the scene's lens if that was compared.
    pub limit_px: f64,
    /// The smallest change of the lens, as the median over the image, that is detectable with these
    /// images and this calibration; null if they do not determine it.
    pub visible_px: Option<f64>,
    /// The reprojection error of these images with the calibrated lens; null for a scene.
    pub rms_px: Option<f64>,
    /// The same with the lens that fits them best; null where they do not determine one.
    pub best_rms_px: Option<f64>,
    pub views: usize,
    /// Depth compared with the board; left out if the calibration or the images have no depth.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub depth: Option<VerifiedDepth>,
    pub reasons: Vec<String>,
}

impl Verified {
    /// Whether a change of the lens in half of the image would be detected.
    fn saw_lens(&self) -> bool {
        self.visible_px.is_some_and(|visible_px| visible_px <= CERTAIN_PX)
    }

    fn answer(&self) -> &'static str {
        match self.depth.as_ref().is_none_or(VerifiedDepth::saw_all) && self.saw_lens() {
            _ if !self.holds => "does not hold",
            true => "holds",
            false => "holds, as far as these images can show",
        }
    }

    /// The result including that of depth.
    pub fn with_depth(mut self, depth: Option<VerifiedDepth>) -> Self {
        if let Some(depth) = &depth {
            self.holds &= depth.holds;
            self.reasons.extend(depth.reasons.iter().cloned());
        }
        Self { depth, ..self }
    }
}

/// Refuses images whose size is not the one that the calibration in `file` is for.
pub(super) fn same_size(
    size: ImageSize,
    file: &str,
    sensor: &ImageCalibration,
) -> Result<(), Failure> {
    if size == sensor.image_size {
        return Ok(());
    }
    Err(Failure::failed(format!(
        "the images are {size}, but {file} is for {}: give images of that size, or convert the calibration to theirs (plumb export --width --height)",
        sensor.image_size
    )))
}

/// Prints the result for the calibration in `file`.
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
    let seen = if verified.saw_lens() { "" } else { " as far as these images can show" };
    output::print_line(&format!(
        "{file} {answer}: {views} views, {rms}projection error {moved_px:.3} px{seen}, limit {limit_px:.3} px"
    ))?;
    let of_depth = depth.as_ref().map(VerifiedDepth::lines).unwrap_or_default();
    of_depth.iter().chain(reasons).try_for_each(|line| output::print_line(&format!("  {line}")))
}
