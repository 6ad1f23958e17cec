//! Pixel format, size and rate: what a device offers, what is chosen, and what was got.

use std::fmt;
use std::io;

use v4l::frameinterval::FrameIntervalEnum;
use v4l::framesize::FrameSizeEnum;
use v4l::video::Capture;
use v4l::video::capture::Parameters;
use v4l::{Device, Format, FourCC, Fraction};

use crate::capture::device_list::{ListedFormat, ListedSize, SizeRange};
use crate::capture::mode::ModeRequest;
use crate::geometry::pixel::ImageSize;
use crate::imaging::frame::PixelFormat;

/// The rate that a format must reach to be preferred where none was asked for.
const DEFAULT_FPS: f64 = 30.0;

/// A format that Plumb reads: how its samples lie in memory, and what becomes of them.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct PixelLayout {
    /// The four-character code.
    pub code: [u8; 4],
    /// How the frame is passed on.
    pub format: PixelFormat,
    /// How far samples are moved up to fill 16 bits.
    pub up_bits: u32,
}

const fn layout(code: &[u8; 4], format: PixelFormat, up_bits: u32) -> PixelLayout {
    PixelLayout { code: *code, format, up_bits }
}

/// Every format that is read, the one that is cheapest to decode first.
const LAYOUTS: [PixelLayout; 11] = [
    layout(b"GREY", PixelFormat::Mono8, 0),
    layout(b"NV12", PixelFormat::Nv12, 0),
    layout(b"YUYV", PixelFormat::Yuyv, 0),
    layout(b"UYVY", PixelFormat::Uyvy, 0),
    layout(b"Y16 ", PixelFormat::Mono16, 0),
    layout(b"Y12 ", PixelFormat::Mono16, 4),
    layout(b"Y10 ", PixelFormat::Mono16, 6),
    layout(b"RGB3", PixelFormat::Rgb8, 0),
    layout(b"BGR3", PixelFormat::Bgr8, 0),
    layout(b"MJPG", PixelFormat::Jpeg, 0),
    layout(b"JPEG", PixelFormat::Jpeg, 0),
];

impl PixelLayout {
    /// The layout with this code, if it is read.
    fn of(code: [u8; 4]) -> Option<Self> {
        LAYOUTS.into_iter().find(|layout| layout.code == code)
    }
}

/// What a device was set to.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Mode {
    pub layout: PixelLayout,
    pub size: ImageSize,
    pub stride: usize,
    pub fps: Option<f64>,
    /// What was asked for and not got, in words.
    differs: Option<String>,
}

impl fmt::Display for Mode {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{} {}", self.size, name_of(self.layout.code))?;
        if let Some(fps) = self.fps {
            write!(f, " at {} frames a second", short(fps))?;
        }
        self.differs.as_ref().map_or(Ok(()), |differs| write!(f, " ({differs})"))
    }
}

/// Why a device cannot be set as asked.
#[derive(Debug, thiserror::Error)]
pub(super) enum ModeError {
    /// It does not have the format that was asked for, or none that is read.
    #[error("{0}")]
    Unfit(String),
    /// It has no image to describe: a loopback device that no program feeds.
    #[error("no video at present (loopback device); start the program that feeds it")]
    Idle,
    /// The device refused.
    #[error("{0}")]
    Device(#[from] io::Error),
}

/// Sets the device to what `request` asks for, or to the nearest that it has.
pub(super) fn set_mode(device: &Device, request: &ModeRequest) -> Result<Mode, ModeError> {
    let present = device.format().map_err(|error| match error.kind() {
        io::ErrorKind::InvalidInput => ModeError::Idle,
        _ => ModeError::Device(error),
    })?;
    let size = request.size.unwrap_or(ImageSize::new(present.width, present.height));
    let code = choose(device, &present, size, request)?;
    let got = device.set_format(&Format::new(size.width, size.height, FourCC::new(&code)))?;
    let layout = PixelLayout::of(got.fourcc.repr).ok_or_else(|| unread(got.fourcc.repr))?;
    if request.format.is_some() && got.fourcc.repr != code {
        let (asked, given) = (name_of(code), name_of(got.fourcc.repr));
        return Err(ModeError::Unfit(format!(
            "asked for {asked}, it gives {given}; write format = \"{given}\""
        )));
    }
    let fps = set_rate(device, request.fps);
    let got_size = ImageSize::new(got.width, got.height);
    let row = layout.format.bytes_per_pixel().unwrap_or(0) * got.width as usize;
    let stride = if row == 0 { 0 } else { row.max(got.stride as usize) };
    let mut differs = Vec::new();
    if got_size != size {
        differs.push(format!("asked for {size}"));
    }
    if let (Some(asked), Some(given)) = (request.fps, fps)
        && (asked - given).abs() > 0.02 * asked
    {
        differs.push(format!("asked for {} frames a second", short(asked)));
    }
    let differs = (!differs.is_empty()).then(|| differs.join(", "));
    Ok(Mode { layout, size: got_size, stride, fps, differs })
}

/// The format to ask for.
fn choose(
    device: &Device,
    present: &Format,
    size: ImageSize,
    request: &ModeRequest,
) -> Result<[u8; 4], ModeError> {
    let offered: Vec<[u8; 4]> =
        device.enum_formats()?.iter().map(|format| format.fourcc.repr).collect();
    let readable = || LAYOUTS.iter().filter(|layout| offered.contains(&layout.code));
    let names = || readable().map(|layout| name_of(layout.code)).collect::<Vec<_>>().join(", ");
    if let Some(wanted) = &request.format {
        let named = |code: &[u8; 4]| name_of(*code).eq_ignore_ascii_case(wanted.trim());
        return LAYOUTS
            .iter()
            .map(|layout| layout.code)
            .find(|code| named(code) && offered.contains(code))
            .ok_or_else(|| {
                ModeError::Unfit(format!(
                    "no format {}; supported by the device and Plumb: {}",
                    wanted.trim(),
                    names()
                ))
            });
    }
    let wanted_fps = request.fps.unwrap_or(DEFAULT_FPS);
    let reaches = |layout: &&PixelLayout| {
        best_rate(device, layout.code, size).is_some_and(|fps| fps >= wanted_fps * 0.99)
    };
    let untouched = request.size.is_none() && request.fps.is_none();
    if untouched && readable().any(|layout| layout.code == present.fourcc.repr) {
        return Ok(present.fourcc.repr);
    }
    let best = readable().find(reaches).or_else(|| {
        let rate = |layout: &&PixelLayout| best_rate(device, layout.code, size).unwrap_or(0.0);
        readable().rev().max_by(|a, b| rate(a).total_cmp(&rate(b)))
    });
    best.map(|layout| layout.code).ok_or_else(|| {
        let all: Vec<String> = offered.iter().map(|code| name_of(*code)).collect();
        ModeError::Unfit(format!(
            "offers only formats that Plumb does not read ({})",
            all.join(", ")
        ))
    })
}

fn unread(code: [u8; 4]) -> ModeError {
    ModeError::Unfit(format!(
        "gives {}, which Plumb does not read; ask for another format",
        name_of(code)
    ))
}

/// The highest rate of a format at exactly this size; `None` if it does not have the size.
fn best_rate(device: &Device, code: [u8; 4], size: ImageSize) -> Option<f64> {
    let rates = rates(device, code, size);
    let has_size = !rates.is_empty() || sizes(device, code).contains(&ListedSize::new(size));
    has_size.then(|| rates.into_iter().fold(0.0, f64::max))
}

/// Asks for a rate and says which one it is now; `None` where the device has no say in it.
fn set_rate(device: &Device, fps: Option<f64>) -> Option<f64> {
    if let Some(fps) = fps {
        // Whole rates as 1/n, which drivers compare literally.
        let interval = if fps.fract() == 0.0 {
            Fraction::new(1, fps as u32)
        } else {
            Fraction::new(1000, (fps * 1000.0).round().max(1.0) as u32)
        };
        // A device without a rate of its own refuses; the rate that is read back decides.
        let _ = device.set_params(&Parameters::new(interval));
    }
    device.params().ok().and_then(|parameters| rate_of(parameters.interval))
}

fn rate_of(interval: Fraction) -> Option<f64> {
    let known = interval.numerator > 0 && interval.denominator > 0;
    known.then(|| f64::from(interval.denominator) / f64::from(interval.numerator))
}

/// Every format with its sizes and their rates.
pub(super) fn offered(device: &Device) -> Vec<ListedFormat> {
    let formats = device.enum_formats().unwrap_or_default();
    let listed = formats.into_iter().map(|format| {
        let mut sizes = sizes(device, format.fourcc.repr);
        for size in &mut sizes {
            size.fps = rates(device, format.fourcc.repr, size.size);
        }
        let read = PixelLayout::of(format.fourcc.repr).is_some();
        ListedFormat {
            name: name_of(format.fourcc.repr),
            description: format.description,
            read,
            sizes,
        }
    });
    listed.collect()
}

fn sizes(device: &Device, code: [u8; 4]) -> Vec<ListedSize> {
    let sizes = device.enum_framesizes(FourCC::new(&code)).unwrap_or_default();
    let listed = sizes.into_iter().map(|found| match found.size {
        FrameSizeEnum::Discrete(size) => ListedSize::new(ImageSize::new(size.width, size.height)),
        FrameSizeEnum::Stepwise(range) => ListedSize {
            size: ImageSize::new(range.max_width, range.max_height),
            range: Some(SizeRange {
                smallest: ImageSize::new(range.min_width, range.min_height),
                step: ImageSize::new(range.step_width, range.step_height),
            }),
            fps: Vec::new(),
        },
    });
    listed.collect()
}

/// The rates at a size, highest first; of a continuous range its two ends.
fn rates(device: &Device, code: [u8; 4], size: ImageSize) -> Vec<f64> {
    let found =
        device.enum_frameintervals(FourCC::new(&code), size.width, size.height).unwrap_or_default();
    let rates = found.into_iter().flat_map(|found| match found.interval {
        FrameIntervalEnum::Discrete(interval) => vec![rate_of(interval)],
        FrameIntervalEnum::Stepwise(range) => vec![rate_of(range.min), rate_of(range.max)],
    });
    let mut rates: Vec<f64> = rates.flatten().collect();
    rates.sort_by(|a, b| b.total_cmp(a));
    rates
}

/// A code as people write it: `MJPG`, `Y16`.
fn name_of(code: [u8; 4]) -> String {
    let printable =
        code.iter().map(|byte| if byte.is_ascii_graphic() { char::from(*byte) } else { ' ' });
    printable.collect::<String>().trim_end().to_owned()
}

/// A rate without needless digits.
fn short(fps: f64) -> String {
    let text = format!("{fps:.2}");
    text.trim_end_matches('0').trim_end_matches('.').to_owned()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_mode_says_what_differs_from_the_request() {
        let mut mode = Mode {
            layout: LAYOUTS[9],
            size: ImageSize::new(1280, 720),
            stride: 0,
            fps: Some(29.97),
            differs: None,
        };
        assert_eq!(mode.to_string(), "1280x720 MJPG at 29.97 frames a second");
        mode.differs = Some("asked for 1920x1080".to_owned());
        mode.fps = Some(30.0);
        assert_eq!(mode.to_string(), "1280x720 MJPG at 30 frames a second (asked for 1920x1080)");
    }

    #[test]
    fn codes_read_as_people_write_them() {
        assert_eq!(name_of(*b"Y16 "), "Y16");
        assert_eq!(name_of([b'Y', b'1', b'6', b' ' | 0x80]), "Y16");
    }
}
