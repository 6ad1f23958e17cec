//! A board on a sheet of paper with a ruler and a description, as PDF, SVG or PNG: always at its
//! true size.

use std::fmt::Write as _;
use std::io::Cursor;

use image::{GrayImage, ImageFormat, Luma};

use crate::geometry::printed_board::PrintedBoard;

/// Width of the white margin, and of the foot below the board for the ruler, in millimeters.
const MARGIN_MM: f64 = 6.0;
const FOOT_MM: f64 = 14.0;
/// A PDF point, in millimeters.
const POINT_MM: f64 = 25.4 / 72.0;

/// A sheet to print.
#[derive(Debug, Clone, PartialEq)]
pub struct PaperSheet {
    /// Width and height of the paper, in millimeters.
    paper_mm: [f64; 2],
    /// Black and white rectangles in millimeters, later ones drawn over earlier ones: x, y, width,
    /// height, white.
    rects: Vec<([f64; 4], bool)>,
    /// Lines of text: x, baseline y, height.
    texts: Vec<([f64; 3], String)>,
}

/// A board that does not fit on the paper.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[error(
    "the board is {:.1} x {:.1} mm with its ruler, but the paper holds {:.1} x {:.1} mm within its margins: give larger paper, or a target with fewer or smaller squares or tags", needed[0], needed[1], room[0], room[1]
)]
pub struct PaperTooSmall {
    needed: [f64; 2],
    room: [f64; 2],
}

impl PaperSheet {
    /// `print` in the middle of paper of this size, in portrait or landscape, whichever fits, above
    /// a ruler and a line with the description `what`.
    ///
    /// # Errors
    /// [`PaperTooSmall`]: the board is never scaled.
    pub fn new(
        print: &PrintedBoard,
        paper_mm: [f64; 2],
        what: &str,
    ) -> Result<Self, PaperTooSmall> {
        let (width, height) = (1e3 * print.width_m, 1e3 * print.height_m);
        let room = |paper: [f64; 2]| paper.map(|side| side - 2.0 * MARGIN_MM);
        let needed = [width, height + FOOT_MM];
        let fits = |paper: &[f64; 2]| {
            let room = room(*paper);
            needed[0] <= room[0] && needed[1] <= room[1]
        };
        let lying = [paper_mm[1], paper_mm[0]];
        let paper_mm = [paper_mm, lying]
            .into_iter()
            .find(fits)
            .ok_or(PaperTooSmall { needed, room: room(paper_mm) })?;
        let left = (paper_mm[0] - width) / 2.0;
        let top = (paper_mm[1] - height - FOOT_MM) / 2.0;
        let mut rects: Vec<([f64; 4], bool)> = print
            .rects
            .iter()
            .map(|rect| {
                let [x, y, w, h] =
                    [rect.x, rect.y, rect.width, rect.height].map(|meters| 1e3 * meters);
                ([left + x, top + y, w, h], rect.white)
            })
            .collect();
        let foot = top + height + 6.0;
        let length = (width / 10.0).floor().clamp(1.0, 20.0) as usize * 10;
        rects.push(([left, foot, length as f64, 0.2], false));
        for mm in 0..=length {
            let tick = if mm % 10 == 0 {
                2.5
            } else if mm % 5 == 0 {
                1.8
            } else {
                1.0
            };
            rects.push(([left + mm as f64 - 0.05, foot - tick, 0.1, tick], false));
        }
        let texts = vec![
            ([left, foot + 3.2, 2.6], format!("{length} mm; measured: ________ mm")),
            ([left, foot + 6.8, 2.6], what.to_owned()),
        ];
        Ok(Self { paper_mm, rects, texts })
    }

    /// As SVG.
    pub fn to_svg(&self) -> String {
        let [width, height] = self.paper_mm;
        let mut svg = format!(
            "<svg xmlns=\"http://www.w3.org/2000/svg\" width=\"{width}mm\" height=\"{height}mm\" viewBox=\"0 0 {width} {height}\" shape-rendering=\"crispEdges\">\n<rect width=\"{width}\" height=\"{height}\" fill=\"white\"/>\n"
        );
        for ([x, y, w, h], white) in &self.rects {
            let fill = if *white { "white" } else { "black" };
            // Writing to a string cannot fail.
            let _ = writeln!(
                svg,
                "<rect x=\"{x:.4}\" y=\"{y:.4}\" width=\"{w:.4}\" height=\"{h:.4}\" fill=\"{fill}\"/>"
            );
        }
        for ([x, y, size], text) in &self.texts {
            let text = text.replace('&', "&amp;").replace('<', "&lt;");
            let _ = writeln!(
                svg,
                "<text x=\"{x:.4}\" y=\"{y:.4}\" font-family=\"Helvetica, sans-serif\" font-size=\"{size}\">{text}</text>"
            );
        }
        svg.push_str("</svg>\n");
        svg
    }

    /// As a PDF of one page.
    pub fn to_pdf(&self) -> Vec<u8> {
        let [width, height] = self.paper_mm.map(|mm| mm / POINT_MM);
        let mut page = String::new();
        for ([x, y, w, h], white) in &self.rects {
            let [x, y, w, h] = [*x, self.paper_mm[1] - y - h, *w, *h].map(|mm| mm / POINT_MM);
            let gray = u8::from(*white);
            let _ = writeln!(page, "{gray} g {x:.4} {y:.4} {w:.4} {h:.4} re f");
        }
        for ([x, y, size], text) in &self.texts {
            let [x, y, size] = [*x, self.paper_mm[1] - y, *size].map(|mm| mm / POINT_MM);
            let text: String = text.chars().filter(char::is_ascii).collect();
            let text = text.replace('\\', "\\\\").replace('(', "\\(").replace(')', "\\)");
            let _ = writeln!(page, "0 g BT /F1 {size:.3} Tf {x:.4} {y:.4} Td ({text}) Tj ET");
        }
        let objects = [
            "<< /Type /Catalog /Pages 2 0 R >>".to_owned(),
            "<< /Type /Pages /Kids [3 0 R] /Count 1 >>".to_owned(),
            format!(
                "<< /Type /Page /Parent 2 0 R /MediaBox [0 0 {width:.4} {height:.4}] /Contents 4 0 R /Resources << /Font << /F1 5 0 R >> >> >>"
            ),
            format!("<< /Length {} >>\nstream\n{page}endstream", page.len()),
            "<< /Type /Font /Subtype /Type1 /BaseFont /Helvetica >>".to_owned(),
        ];
        let mut pdf = String::from("%PDF-1.4\n");
        let mut offsets = Vec::new();
        for (k, object) in objects.iter().enumerate() {
            offsets.push(pdf.len());
            let _ = write!(pdf, "{} 0 obj\n{object}\nendobj\n", k + 1);
        }
        let table = pdf.len();
        let _ = write!(pdf, "xref\n0 {}\n0000000000 65535 f \n", objects.len() + 1);
        for offset in offsets {
            let _ = writeln!(pdf, "{offset:010} 00000 n ");
        }
        let _ = write!(
            pdf,
            "trailer\n<< /Size {} /Root 1 0 R >>\nstartxref\n{table}\n%%EOF\n",
            objects.len() + 1
        );
        pdf.into_bytes()
    }

    /// The sheet in pixels; pixels on edges are gray. Text is left out.
    pub fn to_pixels(&self, dpi: f64) -> GrayImage {
        let scale = dpi / 25.4;
        let [width, height] = self.paper_mm.map(|mm| (mm * scale).round().max(1.0) as u32);
        let mut image = GrayImage::from_pixel(width, height, Luma([255]));
        for ([x, y, w, h], white) in &self.rects {
            let ink = if *white { 255.0 } else { 0.0 };
            let [x0, x1, y0, y1] = [*x, x + w, *y, y + h].map(|mm| mm * scale);
            for row in y0.max(0.0) as u32..(y1.ceil() as u32).min(height) {
                let down = (f64::from(row) + 1.0).min(y1) - f64::from(row).max(y0);
                for col in x0.max(0.0) as u32..(x1.ceil() as u32).min(width) {
                    let across = (f64::from(col) + 1.0).min(x1) - f64::from(col).max(x0);
                    let Luma([gray]) = image.get_pixel_mut(col, row);
                    let part = (across * down).clamp(0.0, 1.0);
                    *gray = (f64::from(*gray) * (1.0 - part) + ink * part).round() as u8;
                }
            }
        }
        image
    }

    /// As PNG.
    ///
    /// # Errors
    /// When it cannot be encoded.
    pub fn to_png(&self, dpi: f64) -> Result<Vec<u8>, image::ImageError> {
        let mut bytes = Cursor::new(Vec::new());
        self.to_pixels(dpi).write_to(&mut bytes, ImageFormat::Png)?;
        let mut bytes = bytes.into_inner();
        let resolution = resolution_chunk(dpi);
        bytes.splice(AFTER_HEADER..AFTER_HEADER, resolution);
        Ok(bytes)
    }
}

/// The position of the chunk after the header: after the signature and a header of 13 bytes, where
/// each chunk also has its length, its name and a checksum (PNG specification, section 5).
const AFTER_HEADER: usize = 8 + 12 + 13;

/// The chunk with the size of a PNG's pixels: without it, programs print at a resolution of their
/// own.
fn resolution_chunk(dpi: f64) -> Vec<u8> {
    const INCHES_PER_METER: f64 = 1.0 / 0.0254;
    let per_meter = (dpi * INCHES_PER_METER).round() as u32;
    let per_meter = per_meter.to_be_bytes();
    let named = [b"pHYs".as_slice(), &per_meter, &per_meter, &[1]].concat();
    let checksum = crc32fast::hash(&named).to_be_bytes();
    [9_u32.to_be_bytes().as_slice(), &named, &checksum].concat()
}
