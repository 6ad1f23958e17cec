//! Writes a finished calibration to stdout and to a file, in the same way for every command.

use std::path::{Path, PathBuf};

use crate::calibration::depth_calibration::DepthCalibration;
use crate::calibration::result::{Calibration, Extrinsics, ImageCalibration};
use crate::calibration::rounded::value_with_std;
use crate::cli::files::{check_no_image, write_file};
use crate::cli::{Failure, output};
use crate::document::calibration::CalibrationDocument;
use crate::document::time;
use crate::estimation::undetermined_coefficients::undetermined_coefficients;
use crate::export::{ExportOptions, Format, export};
use crate::geometry::lens::Lens;

/// Where a calibration goes.
#[derive(Debug, clap::Args)]
pub struct OutputArgs {
    /// Print the calibration as one JSON document.
    #[arg(long)]
    json: bool,
    /// Write the calibration to FILE.
    #[arg(long, value_name = "FILE")]
    out: Option<PathBuf>,
    /// The output format, of FILE or (without --out) of standard output.
    #[arg(long)]
    format: Option<Format>,
}

impl OutputArgs {
    /// Refuses impossible combinations before any computation.
    ///
    /// # Errors
    /// When two documents would have to go to stdout, or the file into a folder that is not there.
    pub fn check(&self) -> Result<(), Failure> {
        let other_format = self.format.is_some_and(|format| format != Format::Json);
        if self.json && other_format && self.out.is_none() {
            return Err(Failure::usage(
                "--json and --format both print: give --out FILE for the format, or leave one out",
            ));
        }
        if let Some(out) = &self.out {
            check_no_image("--out", out)?;
        }
        let folder = self.out.as_deref().and_then(Path::parent);
        match folder.filter(|folder| !folder.as_os_str().is_empty() && !folder.is_dir()) {
            Some(folder) => Err(Failure::usage(format!(
                "--out: there is no folder {}: make it first",
                folder.display()
            ))),
            None => Ok(()),
        }
    }

    /// Whether stdout gets one JSON document.
    pub fn is_json(&self) -> bool {
        self.json
    }

    /// Writes and prints `calibration`; `elapsed_ms` is the duration of the solve, for the commands
    /// that report it.
    ///
    /// # Errors
    /// When the format cannot represent it, or it cannot be written.
    pub fn give(&self, calibration: &Calibration, elapsed_ms: Option<f64>) -> Result<(), Failure> {
        let (format, options) = (self.format, ExportOptions::default());
        if let Some(path) = &self.out {
            let exported = export(calibration, format.unwrap_or(Format::Json), &options)
                .map_err(Failure::failed)?;
            if let Some(note) = &exported.note {
                tracing::warn!("{}: {note}", path.display());
            }
            write_file(path, &exported.bytes)?;
        }
        if self.json {
            let document =
                CalibrationDocument { elapsed_ms, ..CalibrationDocument::from(calibration) };
            return output::print_json(&document);
        }
        match (format, &self.out) {
            (Some(format), None) => {
                let exported = export(calibration, format, &options).map_err(Failure::failed)?;
                if let Some(note) = &exported.note {
                    tracing::warn!("{note}");
                }
                output::print_bytes(&exported.bytes)
            }
            _ => output::print_text(&summary(calibration)),
        }
    }
}

/// The calibration with a new id and the present time.
pub fn named(calibration: Calibration) -> Calibration {
    Calibration {
        id: ulid::Ulid::generate().to_string(),
        created_at_ns: time::utc_ns(jiff::Timestamp::now()),
        ..calibration
    }
}

/// The most important results, in readable form.
fn summary(calibration: &Calibration) -> String {
    let mut lines = Vec::new();
    for (id, sensor) in calibration.image_sensors() {
        lines.extend(sensor_lines(&calibration.name_of(id), sensor));
    }
    for sensor in &calibration.sensors {
        if let Some(depth) = sensor.as_depth() {
            lines.extend(depth_lines(&calibration.name_of(&sensor.id), depth));
        }
    }
    lines.extend(calibration.extrinsics.iter().map(|known| place_line(calibration, known)));
    let verdict = &calibration.verdict;
    lines.push(format!("verdict: {}", verdict.grade.name()));
    lines.extend(verdict.reasons.iter().map(|reason| format!("  {reason}")));
    lines.join("\n") + "\n"
}

/// The pose of one sensor relative to another, as a line.
fn place_line(calibration: &Calibration, known: &Extrinsics) -> String {
    let [target, source] = [&known.target, &known.source].map(|id| calibration.name_of(id));
    let pose = &known.target_from_source;
    let translation: Vec<String> = pose
        .translation()
        .iter()
        .zip(known.translation_std_m)
        .map(|(value, std)| value_with_std(1e3 * value, 1e3 * std))
        .collect();
    let rotation = pose.rotation().scaled_axis();
    let rotation: Vec<String> = rotation
        .iter()
        .zip(known.rotation_std)
        .map(|(value, std)| value_with_std(value.to_degrees(), std.to_degrees()))
        .collect();
    format!(
        "{target} from {source}: translation {} mm, rotation {} degrees about x, y, z",
        translation.join(", "),
        rotation.join(", ")
    )
}

fn depth_lines(name: &str, depth: &DepthCalibration) -> Vec<String> {
    let (camera, model) = (&depth.camera, depth.camera.lens.model());
    let mut lines = vec![format!("{name}: {model} lens for {} images", camera.image_size)];
    let parameters = camera.lens.parameters();
    for ((name, value), std) in
        Lens::parameter_names(model).iter().zip(parameters).zip(&depth.lens_std)
    {
        if *std > 0.0 || value != 0.0 {
            lines.push(format!("  {name:4} {value:>14.6} ± {std:.6}"));
        }
    }
    if let (Some(first), Some(last)) = (depth.bias.first(), depth.bias.last()) {
        lines.push(format!(
            "  depth error on the board (measured − true), from {:.2} to {:.2} m:",
            first.from_m, last.to_m
        ));
    }
    for range in &depth.bias {
        let [before, after, rms] =
            [range.before_m, range.after_m, range.rms_after_m].map(|meters| 1e3 * meters);
        let std = rms / f64::from(range.patches.max(1)).sqrt();
        lines.push(format!(
            "  {:.2} to {:.2} m: {before:.1} mm uncorrected, {after:.2} ± {std:.2} mm corrected ({rms:.1} mm rms over {} patches)",
            range.from_m, range.to_m, range.patches
        ));
    }
    lines
}

fn sensor_lines(name: &str, sensor: &ImageCalibration) -> Vec<String> {
    let model = sensor.lens.model();
    let used = sensor.views.iter().filter(|view| view.used).count();
    let mut lines = vec![
        format!("{name}: {} lens for {} images", model, sensor.image_size),
        format!("  views: {used} of {} used, rms {:.4} px", sensor.views.len(), sensor.rms_px),
        format!(
            "  projection uncertainty (1 sigma): {:.3} px at the center, {:.3} px median, {:.3} px worst",
            sensor.uncertainty_px.center, sensor.uncertainty_px.median, sensor.uncertainty_px.worst
        ),
    ];
    let names = Lens::parameter_names(model);
    let together = undetermined_coefficients(&sensor.lens, &sensor.lens_std, sensor.image_size);
    for ((name, value), std) in names.iter().zip(sensor.lens.parameters()).zip(&sensor.lens_std) {
        if *std > 0.0 || value != 0.0 {
            let note = if together.contains(name) { ", not determined individually" } else { "" };
            lines.push(format!("  {name:4} {value:>14.6} ± {std:.6}{note}"));
        }
    }
    if let Some(shape) = &sensor.board_shape {
        let [rms, std, x, y] =
            [shape.unevenness_m, shape.unevenness_std_m, shape.bow_m[0], shape.bow_m[1]]
                .map(|m| m * 1000.0);
        let rms = value_with_std(rms, std);
        lines.push(format!(
            "  the board is uneven by {rms} mm (rms), bowed by {x:.3} mm along its rows and {y:.3} mm along its columns: estimated and corrected for"
        ));
    }
    if let Some(shutter) = &sensor.rolling_shutter {
        let agreed = match shutter.agreement {
            agreement if agreement < 1.0 => {
                format!("possible; the views disagree: weighted by {:.0} %", 100.0 * agreement)
            }
            _ => String::from("estimated and corrected for"),
        };
        lines.push(format!(
            "  rolling shutter: the board moved by {:.3} mm and {:.3} degrees (rms) during readout: {agreed}",
            shutter.translation_m * 1000.0,
            shutter.rotation_rad.to_degrees()
        ));
    }
    for compared in &sensor.compared {
        lines.push(format!(
            "  compared: {}, {:.4} px rms on held-out views",
            compared.model, compared.held_out_rms_px
        ));
    }
    for view in sensor.views.iter().filter(|view| !view.used) {
        lines.push(format!(
            "  not used: {}: {}",
            view.name,
            view.reason.as_deref().unwrap_or("no reason given")
        ));
    }
    lines
}
