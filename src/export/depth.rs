//! A depth sensor's readings made meters, as a text file that thirty lines of any language read
//! (`docs/depth-correction` has it in Python and C++).

use crate::calibration::depth_calibration::DepthCalibration;
use crate::calibration::result::Calibration;
use crate::export::facts::{FileName, FormatFacts, Formatted, camera_name};
use crate::export::number::decimal;
use crate::export::sensors::depth_sensor;
use crate::export::{ExportError, ExportOptions};
use crate::geometry::depth_camera::DepthReading;

pub(super) const FACTS: FormatFacts = FormatFacts {
    name: "depth",
    description: "Depth correction as text (readers in docs/depth-correction)",
    media_type: "text/plain; charset=utf-8",
    file_name: FileName::WithSuffix("-depth.txt"),
    holds_all: false,
    write,
};

/// What the file says of itself.
const HEADER: &str = "\
# Meaning and correction of a depth image's readings, from Plumb. Lines are a key and its values; # begins a comment.
#   reading depth U        1/z = 1 / (U * reading)           reading disparity O S        1/z = O + S * reading
#   invalid R              the reading R, and 0 for depth, means none
# With x = 1/z (quantity inverse_depth) or x = z (quantity depth), and x held to the range between the two depths `seen`:
#   x' = x + sum over k of g_k(u, v) * x_held^k              nothing is left where x' is not above 0
# g_k is line k of `nodes`: a uniform cubic B-spline surface of C x R cells over the image of W x H pixels, (C + 3) x (R + 3)
# nodes row by row. Along u: a = (u + 0.5) / W * C, i = min(floor(a), C - 1), t = a - i, and nodes i .. i + 3 weigh
# (1-t)^3, 3t^3-6t^2+4, -3t^3+3t^2+3t+1, t^3, each over 6; along v likewise. Cells 0 0: one number for the whole image.
";

fn write(calibration: &Calibration, options: &ExportOptions) -> Result<Formatted, ExportError> {
    let (sensor, depth) = depth_sensor(calibration, options.sensor.as_deref())?;
    let camera = sensor.id.camera.as_deref().unwrap_or(camera_name(calibration));
    Ok(Formatted::one_file(camera, correction_file(camera, depth), None))
}

/// The file.
fn correction_file(camera: &str, depth: &DepthCalibration) -> String {
    let size = depth.camera.image_size;
    let reading = match depth.camera.reading {
        DepthReading::Metric { unit_m } => format!("depth {}", decimal(unit_m)),
        DepthReading::Disparity { offset, slope } => {
            format!("disparity {} {}", decimal(offset), decimal(slope))
        }
    };
    let mut text = format!(
        "plumb_depth_correction 1\n{HEADER}camera {camera}\nsize {} {}\n",
        size.width, size.height
    );
    text += &format!("reading {reading}\n");
    if let Some(invalid) = depth.invalid {
        text += &format!("invalid {invalid}\n");
    }
    if let Some(correction) = &depth.camera.correction {
        let [near, far] = correction.seen_m.map(decimal);
        text += &format!("quantity {}\nseen {near} {far}\n", correction.quantity.name());
        text += &format!("cells {} {}\n", correction.grid.cols, correction.grid.rows);
        for nodes in correction.coefficients.chunks(correction.grid.node_count()) {
            let nodes: Vec<String> = nodes.iter().map(|node| decimal(*node)).collect();
            text += &format!("nodes {}\n", nodes.join(" "));
        }
    }
    text
}
