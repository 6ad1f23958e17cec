//! Which of the modes that `nokhwa` lists a camera is set to.

use nokhwa::utils::{CameraFormat, FrameFormat};

use crate::capture::mode::ModeRequest;
use crate::geometry::pixel::ImageSize;
use crate::imaging::frame::PixelFormat;

/// Where nothing is asked for: what every USB camera has.
const DEFAULT_SIZE: ImageSize = ImageSize::new(640, 480);
const DEFAULT_FPS: f64 = 30.0;
/// Formats that are read, the one that is cheapest to decode first.
const FORMATS: [(FrameFormat, &str, PixelFormat); 6] = [
    (FrameFormat::GRAY, "GREY", PixelFormat::Mono8),
    (FrameFormat::NV12, "NV12", PixelFormat::Nv12),
    (FrameFormat::YUYV, "YUYV", PixelFormat::Yuyv),
    (FrameFormat::RAWRGB, "RGB3", PixelFormat::Rgb8),
    (FrameFormat::RAWBGR, "BGR3", PixelFormat::Bgr8),
    (FrameFormat::MJPEG, "MJPG", PixelFormat::Jpeg),
];
/// Every format, for a camera that is opened to see what it has.
pub(super) const ALL: [FrameFormat; 6] = {
    let mut all = [FrameFormat::GRAY; 6];
    let mut k = 0;
    while k < FORMATS.len() {
        all[k] = FORMATS[k].0;
        k += 1;
    }
    all
};

/// Those that nokhwa 0.10 can set on Linux. Gray images it knows there by a code that no driver
/// has; they are set beside it.
#[cfg(target_os = "linux")]
pub(super) const KNOWN_ON_LINUX: [&str; 5] = ["NV12", "YUYV", "RGB3", "BGR3", "MJPG"];

/// How frames of this format are passed on.
pub(super) fn pixel_format(format: FrameFormat) -> Option<PixelFormat> {
    FORMATS.iter().find(|(known, ..)| *known == format).map(|(.., pixels)| *pixels)
}

/// The mode as the V4L2 source writes it, with what was asked for where it differs.
pub(super) fn in_words(mode: CameraFormat, request: &ModeRequest) -> String {
    let name = FORMATS.iter().find(|(known, ..)| *known == mode.format()).map_or("?", |f| f.1);
    let size = size_of(mode);
    let mut words = format!("{size} {name} at {} frames a second", mode.frame_rate());
    let asked_size = request.size.filter(|asked| *asked != size).map(|asked| asked.to_string());
    let rate = f64::from(mode.frame_rate());
    let asked_fps = request.fps.filter(|asked| (asked - rate).abs() > 0.02 * asked);
    let asked_fps = asked_fps.map(|asked| format!("{asked} frames a second"));
    let asked: Vec<String> = asked_size.into_iter().chain(asked_fps).collect();
    if !asked.is_empty() {
        words += &format!(" (asked for {})", asked.join(", "));
    }
    words
}

/// Why a camera has no mode to set.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub(super) enum NoFormat {
    /// It does not have the format that was asked for.
    #[error("no format {wanted}; through nokhwa it offers {}", offered.join(", "))]
    NotOffered { wanted: String, offered: Vec<String> },
    /// It has none that is read.
    #[error("through nokhwa it offers no format that Plumb reads{NATIVE}")]
    NoneRead,
}

/// The mode to set: of the format asked for, else of any; the nearest size; fast enough, as near to
/// the rate as can be; cheap to decode.
///
/// # Errors
/// [`NoFormat`].
pub(super) fn choose(
    offered: &[CameraFormat],
    request: &ModeRequest,
) -> Result<CameraFormat, NoFormat> {
    let wanted = request.format.as_deref().map(str::trim);
    let names: Vec<&str> = FORMATS
        .iter()
        .filter(|(format, ..)| offered.iter().any(|mode| mode.format() == *format))
        .map(|(_, name, _)| *name)
        .collect();
    let is_wanted = |mode: &&CameraFormat| {
        let known = FORMATS.iter().find(|(format, ..)| *format == mode.format());
        known.is_some_and(|(_, name, _)| {
            wanted.is_none_or(|wanted| wanted.eq_ignore_ascii_case(name))
        })
    };
    let size = request.size.unwrap_or(DEFAULT_SIZE);
    let fps = request.fps.unwrap_or(DEFAULT_FPS);
    let cost = |mode: &CameraFormat| {
        let found = size_of(*mode);
        let away = u64::from(found.width.abs_diff(size.width)).pow(2)
            + u64::from(found.height.abs_diff(size.height)).pow(2);
        let rate = f64::from(mode.frame_rate());
        let slowness = (0.99 * fps - rate).max(0.0);
        let place = FORMATS.iter().position(|(format, ..)| *format == mode.format());
        (away, slowness, place, (rate - fps).abs())
    };
    let nearest = offered.iter().filter(is_wanted).min_by(|a, b| {
        let ((a, a_slow, a_place, a_off), (b, b_slow, b_place, b_off)) = (cost(a), cost(b));
        let order = a.cmp(&b).then(a_slow.total_cmp(&b_slow));
        order.then(a_place.cmp(&b_place)).then(a_off.total_cmp(&b_off))
    });
    nearest.copied().ok_or_else(|| match (wanted, names.is_empty()) {
        (Some(wanted), false) => NoFormat::NotOffered {
            wanted: wanted.to_owned(),
            offered: names.iter().map(|name| (*name).to_owned()).collect(),
        },
        _ => NoFormat::NoneRead,
    })
}

/// What to do where nokhwa lacks a format.
pub(super) const NATIVE: &str =
    if cfg!(target_os = "linux") { "; write backend = \"native\"" } else { "" };

/// The image size of a mode.
pub(super) fn size_of(mode: CameraFormat) -> ImageSize {
    ImageSize::new(mode.width(), mode.height())
}

#[cfg(test)]
mod tests {
    use nokhwa::utils::Resolution;

    use super::*;

    fn mode(width: u32, height: u32, format: FrameFormat, fps: u32) -> CameraFormat {
        CameraFormat::new(Resolution::new(width, height), format, fps)
    }

    fn webcam() -> Vec<CameraFormat> {
        vec![
            mode(1280, 720, FrameFormat::MJPEG, 30),
            mode(1280, 720, FrameFormat::YUYV, 10),
            mode(640, 480, FrameFormat::YUYV, 15),
            mode(640, 480, FrameFormat::YUYV, 30),
            mode(640, 480, FrameFormat::MJPEG, 30),
        ]
    }

    fn asked(size: Option<(u32, u32)>, format: Option<&str>, fps: Option<f64>) -> ModeRequest {
        let size = size.map(|(width, height)| ImageSize::new(width, height));
        ModeRequest { size, format: format.map(str::to_owned), fps }
    }

    #[test]
    fn the_cheapest_format_that_is_fast_enough_is_chosen() {
        let chosen = |request: &ModeRequest| choose(&webcam(), request).unwrap();
        assert_eq!(chosen(&ModeRequest::default()), mode(640, 480, FrameFormat::YUYV, 30));
        let large = asked(Some((1280, 720)), None, None);
        assert_eq!(chosen(&large), mode(1280, 720, FrameFormat::MJPEG, 30));
        let slow = asked(Some((1280, 720)), None, Some(10.0));
        assert_eq!(chosen(&slow), mode(1280, 720, FrameFormat::YUYV, 10));
        let named = asked(None, Some("mjpg"), None);
        assert_eq!(chosen(&named), mode(640, 480, FrameFormat::MJPEG, 30));
    }

    #[test]
    fn the_choice_does_not_depend_on_the_order_of_the_list() {
        let request = asked(Some((1000, 700)), None, Some(25.0));
        let mut modes = webcam();
        let first = choose(&modes, &request).unwrap();
        for _ in 0..modes.len() {
            modes.rotate_left(1);
            assert_eq!(choose(&modes, &request), Ok(first));
        }
        let words = in_words(first, &request);
        assert_eq!(
            words,
            "1280x720 MJPG at 30 frames a second (asked for 1000x700, 25 frames a second)"
        );
    }

    #[test]
    fn what_it_does_not_have_is_refused() {
        let refused = choose(&webcam(), &asked(None, Some("GREY"), None)).unwrap_err();
        assert_eq!(refused.to_string(), "no format GREY; through nokhwa it offers YUYV, MJPG");
        assert_eq!(choose(&[], &ModeRequest::default()), Err(NoFormat::NoneRead));
    }
}
