//! A camera's `source = { kind = "…", … }`: each kind with the keys it takes.
//!
//! | kind | keys |
//! | --- | --- |
//! | `v4l2` | `device`; `width` and `height`, `format`, `fps`, `controls` (default: as the device stands); `lock` (default false): hold focus and exposure during a session |
//! | `uvc` | `index` or `name`; `width` and `height`, `format`, `fps` |
//! | `realsense` | `serial` (default: the only one there is); `width` and `height`, `fps`, `preset`, `emitter` (default: as the device stands); or `path` of a .bag file |
//! | `ros2` | `topic` of images, raw or compressed; `depth`, the topic of their depth (default: none); `domain_id` (default: `ROS_DOMAIN_ID`, or 0) |
//! | `recording` | `path`; `topic` and `depth`, the camera's in a file of several (default: the only one there is); `pace` (`"recorded"`, the default, or `"fastest"`), `repeat` (default false), `fps` (of a folder without times, default 10) |
//! | `simulator` | `seed` (default 1), `seat` (which camera of a simulated rig, from 0; none unless given), `width` and `height` (default 640 × 480), `fps` (default 30), `operator` (`"follows"` what a session asks for, `"wanders"`, `"bars"`, or `"walk"`, the default), `pace` (`"recorded"`, the default, or `"fastest"`) |

use std::collections::BTreeMap;
use std::ops::Range;
use std::path::PathBuf;

use serde::Deserialize;
use toml::Spanned;

use crate::capture::mode::ModeRequest;
use crate::capture::realsense::{Preset, Settings};
use crate::config::error::ConfigError;
use crate::config::place::Place;
use crate::geometry::pixel::ImageSize;
use crate::simulation::OperatorKind;

/// Where a camera's frames come from.
#[derive(Debug, Clone, PartialEq)]
pub enum SourceConfig {
    /// A Linux video device.
    V4l2 {
        /// Its path; one under `/dev/v4l/by-id` stays with the device.
        device: PathBuf,
        /// What to ask it for.
        mode: ModeRequest,
        /// Its controls by name, set when it is opened.
        controls: BTreeMap<String, i64>,
        /// Whether focus, exposure, gain and white balance are held still while a session collects.
        lock: bool,
    },
    /// A USB camera through the system's own interface.
    Uvc {
        /// Which one.
        camera: UvcSelector,
        /// What to ask it for.
        mode: ModeRequest,
    },
    /// A RealSense camera.
    Realsense {
        /// Its serial number; `None` takes the only one there is.
        serial: Option<String>,
        /// What to ask each of its streams for.
        mode: ModeRequest,
        /// Extra device settings.
        settings: Settings,
    },
    /// A recording of a RealSense camera, in its own format.
    RealsenseBag {
        /// The .bag file.
        path: PathBuf,
    },
    /// A camera that a ROS 2 driver owns.
    Ros2 {
        /// The topic of its images, raw or compressed.
        topic: String,
        /// The topic of their depth.
        depth: Option<String>,
        /// The DDS domain; `None` takes the environment's.
        domain_id: Option<u16>,
    },
    /// Frames on disk.
    Recording {
        /// An MCAP file, a ROS bag or a folder of images.
        path: PathBuf,
        /// The topics of the camera, where there are several.
        topics: Vec<String>,
        /// Whether frames come as they were taken, or as fast as they are processed, without
        /// skipping any.
        fastest: bool,
        /// Begin again at the end.
        repeat: bool,
        /// Frames a second of a folder without times.
        fps: f64,
    },
    /// A rendered camera and a moving board.
    Simulator {
        /// Which world.
        seed: u64,
        /// The size of its images.
        size: ImageSize,
        /// Frames a second.
        fps: f64,
        /// Which camera of a rig: `None` for one that stands alone.
        seat: Option<u32>,
        /// Who carries the board; `None` for its walk.
        operator: Option<OperatorKind>,
        /// Whether frames come as fast as they are processed, without skipping any.
        fastest: bool,
    },
}

impl SourceConfig {
    /// Whether its silence means that the device is lost; frames on disk and rendered ones come
    /// when they come.
    pub fn may_stall(&self) -> bool {
        matches!(
            self,
            Self::V4l2 { .. } | Self::Uvc { .. } | Self::Realsense { .. } | Self::Ros2 { .. }
        )
    }

    /// The name of its kind.
    pub fn kind(&self) -> &'static str {
        match self {
            Self::V4l2 { .. } => "v4l2",
            Self::Uvc { .. } => "uvc",
            Self::Realsense { .. } | Self::RealsenseBag { .. } => "realsense",
            Self::Ros2 { .. } => "ros2",
            Self::Recording { .. } => "recording",
            Self::Simulator { .. } => "simulator",
        }
    }
}

/// Which USB camera.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum UvcSelector {
    /// The n-th, from 0.
    Index(u32),
    /// The one with this name.
    Name(String),
}

/// The table as written: every key that some kind takes.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct WrittenSource {
    kind: Spanned<String>,
    device: Option<Spanned<PathBuf>>,
    index: Option<Spanned<u32>>,
    name: Option<Spanned<String>>,
    serial: Option<Spanned<String>>,
    path: Option<Spanned<PathBuf>>,
    topic: Option<Spanned<String>>,
    depth: Option<Spanned<String>>,
    domain_id: Option<Spanned<u16>>,
    pace: Option<Spanned<String>>,
    repeat: Option<Spanned<bool>>,
    seed: Option<Spanned<u64>>,
    seat: Option<Spanned<u32>>,
    width: Option<Spanned<u32>>,
    height: Option<Spanned<u32>>,
    format: Option<Spanned<String>>,
    fps: Option<Spanned<f64>>,
    controls: Option<Spanned<BTreeMap<String, i64>>>,
    lock: Option<Spanned<bool>>,
    operator: Option<Spanned<String>>,
    preset: Option<Spanned<String>>,
    emitter: Option<Spanned<bool>>,
}

const KINDS: &str = "write one of v4l2, uvc, realsense, ros2, recording, simulator";
/// No camera sees more; a larger size is a slip of the keyboard.
const LARGEST_SIDE: u32 = 16_384;
/// An image every 17 minutes: seldomer ones make a session hopeless, and times between them
/// impossible to count.
const LOWEST_FPS: f64 = 0.001;
const HIGHEST_FPS: f64 = 1000.0;
const FOLDER_FPS: f64 = 10.0;
/// RTPS has no ports for more domains (OMG DDSI-RTPS 2.5, 9.6.2.3).
const LAST_DOMAIN: u16 = 232;
/// The last camera of a simulated rig.
const LAST_SEAT: u32 = 7;
const SIMULATOR_FPS: f64 = 30.0;
const SIMULATOR_SIZE: ImageSize = ImageSize::new(640, 480);

impl WrittenSource {
    /// What it means; `span` is where the table stands.
    pub(super) fn check(
        &self,
        span: &Range<usize>,
        place: &Place,
    ) -> Result<SourceConfig, ConfigError> {
        match self.kind.get_ref().as_str() {
            "v4l2" => {
                self.takes_only(
                    &["device", "width", "height", "format", "fps", "controls", "lock"],
                    place,
                )?;
                let device = self.needed("device", self.device.as_ref(), span, place)?;
                let controls =
                    self.controls.as_ref().map(|c| c.get_ref().clone()).unwrap_or_default();
                let lock = self.lock.as_ref().is_some_and(|lock| *lock.get_ref());
                Ok(SourceConfig::V4l2 { device, mode: self.mode(place)?, controls, lock })
            }
            "uvc" => {
                self.takes_only(&["index", "name", "width", "height", "format", "fps"], place)?;
                Ok(SourceConfig::Uvc {
                    camera: self.uvc_selector(span, place)?,
                    mode: self.mode(place)?,
                })
            }
            "realsense" => self.realsense(place),
            "ros2" => self.ros2(span, place),
            "recording" => self.recording(span, place),
            "simulator" => {
                let keys = ["seed", "seat", "width", "height", "fps", "operator", "pace"];
                self.takes_only(&keys, place)?;
                let mode = self.mode(place)?;
                let seed = self.seed.as_ref().map_or(1, |seed| *seed.get_ref());
                let (size, fps) =
                    (mode.size.unwrap_or(SIMULATOR_SIZE), mode.fps.unwrap_or(SIMULATOR_FPS));
                let seat = self.seat.as_ref().map(|seat| (*seat.get_ref(), seat.span()));
                if let Some((seat, span)) = seat.clone().filter(|(seat, _)| *seat > LAST_SEAT) {
                    let problem = format!("{seat} is no seat; write 0 to {LAST_SEAT}");
                    return Err(place.refuse(&span, "camera.source.seat", problem));
                }
                let (operator, fastest) = (self.operator(place)?, self.is_fastest(place)?);
                let seat = seat.map(|(seat, _)| seat);
                Ok(SourceConfig::Simulator { seed, size, fps, seat, operator, fastest })
            }
            other => Err(place.refuse(
                &self.kind.span(),
                "camera.source.kind",
                format!("`{other}` is no kind; {KINDS}"),
            )),
        }
    }

    fn ros2(&self, span: &Range<usize>, place: &Place) -> Result<SourceConfig, ConfigError> {
        self.takes_only(&["topic", "depth", "domain_id"], place)?;
        self.needed("topic", self.topic.as_ref(), span, place)?;
        for (key, topic) in [("topic", &self.topic), ("depth", &self.depth)] {
            if let Some(topic) = topic.as_ref().filter(|topic| !is_topic(topic.get_ref())) {
                let problem = format!(
                    "`{}` is no topic; write it as `ros2 topic list` does, as in /front/image_raw",
                    topic.get_ref()
                );
                return Err(place.refuse(&topic.span(), &format!("camera.source.{key}"), problem));
            }
        }
        check_domain("camera.source.domain_id", self.domain_id.as_ref(), place)?;
        let text = |topic: &Option<Spanned<String>>| topic.as_ref().map(|t| t.get_ref().clone());
        Ok(SourceConfig::Ros2 {
            topic: text(&self.topic).unwrap_or_default(),
            depth: text(&self.depth),
            domain_id: self.domain_id.as_ref().map(|id| *id.get_ref()),
        })
    }

    fn recording(&self, span: &Range<usize>, place: &Place) -> Result<SourceConfig, ConfigError> {
        self.takes_only(&["path", "topic", "depth", "pace", "repeat", "fps"], place)?;
        let path = self.existing_path(span, place)?;
        let fastest = self.is_fastest(place)?;
        let repeat = self.repeat.as_ref().is_some_and(|repeat| *repeat.get_ref());
        let topics = [&self.topic, &self.depth].into_iter().flatten();
        Ok(SourceConfig::Recording {
            path,
            topics: topics.map(|topic| topic.get_ref().clone()).collect(),
            fastest,
            repeat,
            fps: self.fps(place)?.unwrap_or(FOLDER_FPS),
        })
    }

    fn is_fastest(&self, place: &Place) -> Result<bool, ConfigError> {
        match self.pace.as_ref().map(|pace| (pace.get_ref().as_str(), pace.span())) {
            None | Some(("recorded", _)) => Ok(false),
            Some(("fastest", _)) => Ok(true),
            Some((other, span)) => {
                let problem = format!("`{other}` is no pace; write \"recorded\" or \"fastest\"");
                Err(place.refuse(&span, "camera.source.pace", problem))
            }
        }
    }

    fn operator(&self, place: &Place) -> Result<Option<OperatorKind>, ConfigError> {
        let Some(operator) = &self.operator else { return Ok(None) };
        let name = operator.get_ref().as_str();
        let known = OperatorKind::from_name(name);
        if known.is_some() || name == "walk" {
            return Ok(known);
        }
        let problem = format!("`{name}` is no operator; write follows, wanders, bars or walk");
        Err(place.refuse(&operator.span(), "camera.source.operator", problem))
    }

    fn realsense(&self, place: &Place) -> Result<SourceConfig, ConfigError> {
        match self.path {
            None => {
                self.takes_only(&["serial", "width", "height", "fps", "preset", "emitter"], place)?;
            }
            Some(_) => self.takes_only(&["serial", "path"], place)?,
        }
        match (&self.serial, &self.path) {
            (Some(serial), Some(_)) => {
                let problem = "a serial number and a file exclude each other; leave one out";
                Err(place.refuse(&serial.span(), "camera.source.serial", problem))
            }
            (None, Some(path)) => {
                Ok(SourceConfig::RealsenseBag { path: self.existing_path(&path.span(), place)? })
            }
            (serial, None) => {
                let serial = serial.as_ref().map(|serial| serial.get_ref().clone());
                Ok(SourceConfig::Realsense {
                    serial,
                    mode: self.mode(place)?,
                    settings: self.settings(place)?,
                })
            }
        }
    }

    fn settings(&self, place: &Place) -> Result<Settings, ConfigError> {
        let unknown = |preset: &Spanned<String>| {
            let names = Preset::ALL.map(Preset::name).join(", ");
            let problem = format!("`{}` is no preset; write one of {names}", preset.get_ref());
            place.refuse(&preset.span(), "camera.source.preset", problem)
        };
        let preset = self
            .preset
            .as_ref()
            .map(|preset| Preset::from_name(preset.get_ref()).ok_or_else(|| unknown(preset)));
        Ok(Settings {
            preset: preset.transpose()?,
            emitter: self.emitter.as_ref().map(|emitter| *emitter.get_ref()),
        })
    }

    fn existing_path(&self, span: &Range<usize>, place: &Place) -> Result<PathBuf, ConfigError> {
        let path = self.needed("path", self.path.as_ref(), span, place)?;
        let span = self.path.as_ref().map_or_else(|| span.clone(), Spanned::span);
        match std::fs::metadata(&path) {
            Ok(_) => Ok(path),
            Err(error) => {
                let problem = format!(
                    "`{}` cannot be opened: {error}; give an existing file or folder",
                    path.display()
                );
                Err(place.refuse(&span, "camera.source.path", problem))
            }
        }
    }

    fn needed<T: Clone>(
        &self,
        key: &str,
        value: Option<&Spanned<T>>,
        span: &Range<usize>,
        place: &Place,
    ) -> Result<T, ConfigError> {
        value.map(|value| value.get_ref().clone()).ok_or_else(|| {
            let problem = format!("missing: a source of kind \"{}\" needs it", self.kind.get_ref());
            place.refuse(span, &format!("camera.source.{key}"), problem)
        })
    }

    fn uvc_selector(&self, span: &Range<usize>, place: &Place) -> Result<UvcSelector, ConfigError> {
        match (&self.index, &self.name) {
            (Some(index), None) => Ok(UvcSelector::Index(*index.get_ref())),
            (None, Some(name)) => Ok(UvcSelector::Name(name.get_ref().clone())),
            _ => Err(place.refuse(
                span,
                "camera.source.index",
                "give the camera's index or its name, and not both",
            )),
        }
    }

    fn mode(&self, place: &Place) -> Result<ModeRequest, ConfigError> {
        let size = match (&self.width, &self.height) {
            (None, None) => None,
            (Some(width), Some(height)) => {
                for (key, side) in [("width", width), ("height", height)] {
                    if !(1..=LARGEST_SIDE).contains(side.get_ref()) {
                        let problem = format!(
                            "{} px is impossible; write 1 to {LARGEST_SIDE}",
                            side.get_ref()
                        );
                        return Err(place.refuse(
                            &side.span(),
                            &format!("camera.source.{key}"),
                            problem,
                        ));
                    }
                }
                Some(ImageSize::new(*width.get_ref(), *height.get_ref()))
            }
            (Some(side), None) => {
                return Err(place.refuse(
                    &side.span(),
                    "camera.source.height",
                    "missing: width is given",
                ));
            }
            (None, Some(side)) => {
                return Err(place.refuse(
                    &side.span(),
                    "camera.source.width",
                    "missing: height is given",
                ));
            }
        };
        Ok(ModeRequest {
            size,
            format: self.format.as_ref().map(|f| f.get_ref().clone()),
            fps: self.fps(place)?,
        })
    }

    fn fps(&self, place: &Place) -> Result<Option<f64>, ConfigError> {
        let Some(fps) = &self.fps else { return Ok(None) };
        let value = *fps.get_ref();
        if (LOWEST_FPS..=HIGHEST_FPS).contains(&value) {
            return Ok(Some(value));
        }
        let problem = format!("impossible; write {LOWEST_FPS} to {HIGHEST_FPS} frames a second");
        Err(place.refuse(&fps.span(), "camera.source.fps", problem))
    }

    /// Refuses a key that another kind takes.
    fn takes_only(&self, allowed: &[&str], place: &Place) -> Result<(), ConfigError> {
        let given = [
            ("device", self.device.as_ref().map(Spanned::span)),
            ("index", self.index.as_ref().map(Spanned::span)),
            ("name", self.name.as_ref().map(Spanned::span)),
            ("serial", self.serial.as_ref().map(Spanned::span)),
            ("path", self.path.as_ref().map(Spanned::span)),
            ("topic", self.topic.as_ref().map(Spanned::span)),
            ("depth", self.depth.as_ref().map(Spanned::span)),
            ("domain_id", self.domain_id.as_ref().map(Spanned::span)),
            ("pace", self.pace.as_ref().map(Spanned::span)),
            ("repeat", self.repeat.as_ref().map(Spanned::span)),
            ("seed", self.seed.as_ref().map(Spanned::span)),
            ("seat", self.seat.as_ref().map(Spanned::span)),
            ("width", self.width.as_ref().map(Spanned::span)),
            ("height", self.height.as_ref().map(Spanned::span)),
            ("format", self.format.as_ref().map(Spanned::span)),
            ("fps", self.fps.as_ref().map(Spanned::span)),
            ("controls", self.controls.as_ref().map(Spanned::span)),
            ("lock", self.lock.as_ref().map(Spanned::span)),
            ("operator", self.operator.as_ref().map(Spanned::span)),
            ("preset", self.preset.as_ref().map(Spanned::span)),
            ("emitter", self.emitter.as_ref().map(Spanned::span)),
        ];
        for (key, span) in given {
            if let (Some(span), false) = (span, allowed.contains(&key)) {
                let kind = self.kind.get_ref();
                let problem =
                    format!("unknown for kind \"{kind}\", which takes {}", allowed.join(", "));
                return Err(place.refuse(&span, &format!("camera.source.{key}"), problem));
            }
        }
        Ok(())
    }
}

/// Whether `name` can be a topic's: absolute, of letters, digits and `_`, without empty parts.
fn is_topic(name: &str) -> bool {
    let is_part = |part: &str| {
        part.chars().all(|c| c.is_ascii_alphanumeric() || c == '_')
            && part.chars().next().is_some_and(|c| !c.is_ascii_digit())
    };
    name.strip_prefix('/').is_some_and(|rest| rest.split('/').all(is_part))
}

/// Refuses a domain that DDS has no ports for.
pub(super) fn check_domain(
    key: &str,
    id: Option<&Spanned<u16>>,
    place: &Place,
) -> Result<(), ConfigError> {
    match id {
        Some(id) if *id.get_ref() > LAST_DOMAIN => {
            let problem = format!("{} is no domain; write 0 to {LAST_DOMAIN}", id.get_ref());
            Err(place.refuse(&id.span(), key, problem))
        }
        _ => Ok(()),
    }
}

#[cfg(test)]
mod tests {
    use std::path::Path;

    use super::*;
    use crate::config::{Overrides, Written};

    fn source(text: &str) -> Result<SourceConfig, String> {
        let text = format!("[[camera]]\nname = \"front\"\nsource = {text}\n");
        let config = Written::parse(&text, Path::new("plumb.toml"))
            .and_then(|written| written.check(&Overrides::default()))
            .map_err(|error| error.to_string())?;
        Ok(config.cameras[0].source.clone())
    }

    #[test]
    fn each_kind_with_its_defaults() {
        let simulator = SourceConfig::Simulator {
            seed: 1,
            size: ImageSize::new(640, 480),
            fps: 30.0,
            seat: None,
            operator: None,
            fastest: false,
        };
        let operated = SourceConfig::Simulator {
            seed: 1,
            size: ImageSize::new(640, 480),
            fps: 30.0,
            seat: None,
            operator: Some(OperatorKind::Follows),
            fastest: true,
        };
        let written = "{ kind = \"simulator\", operator = \"follows\", pace = \"fastest\" }";
        assert_eq!(source(written), Ok(operated));
        assert_eq!(source("{ kind = \"simulator\" }"), Ok(simulator));
        let recording = |topics: &[&str]| SourceConfig::Recording {
            path: "/".into(),
            topics: topics.iter().map(|topic| (*topic).to_owned()).collect(),
            fastest: false,
            repeat: false,
            fps: 10.0,
        };
        assert_eq!(source("{ kind = \"recording\", path = \"/\" }"), Ok(recording(&[])));
        let of_bag = "{ kind = \"recording\", path = \"/\", topic = \"/a\", depth = \"/b\" }";
        assert_eq!(source(of_bag), Ok(recording(&["/a", "/b"])));
        let ros2 = SourceConfig::Ros2 {
            topic: "/front/image_raw".to_owned(),
            depth: Some("/front/depth/image_rect_raw".to_owned()),
            domain_id: Some(7),
        };
        let of_driver = "{ kind = \"ros2\", topic = \"/front/image_raw\", depth = \"/front/depth/image_rect_raw\", domain_id = 7 }";
        assert_eq!(source(of_driver), Ok(ros2));
        let realsense =
            |mode, settings| Ok(SourceConfig::Realsense { serial: None, mode, settings });
        assert_eq!(
            source("{ kind = \"realsense\" }"),
            realsense(ModeRequest::default(), Settings::default())
        );
        let set = "{ kind = \"realsense\", width = 848, height = 480, fps = 30, preset = \"high_accuracy\", emitter = false }";
        let mode =
            ModeRequest { size: Some(ImageSize::new(848, 480)), format: None, fps: Some(30.0) };
        let settings = Settings { preset: Some(Preset::HighAccuracy), emitter: Some(false) };
        assert_eq!(source(set), realsense(mode, settings));
        let uvc = SourceConfig::Uvc { camera: UvcSelector::Index(0), mode: ModeRequest::default() };
        assert_eq!(source("{ kind = \"uvc\", index = 0 }"), Ok(uvc));
    }

    #[test]
    fn the_contracts_v4l2_camera_reads_as_written() {
        let text = "{ kind = \"v4l2\", device = \"/dev/v4l/by-id/x\", width = 1280, height = 720, format = \"MJPG\", \
                    fps = 30, controls = { focus_auto = 0 } }";
        let mode = ModeRequest {
            size: Some(ImageSize::new(1280, 720)),
            format: Some("MJPG".to_owned()),
            fps: Some(30.0),
        };
        let controls = BTreeMap::from([("focus_auto".to_owned(), 0)]);
        assert_eq!(
            source(text),
            Ok(SourceConfig::V4l2 {
                device: "/dev/v4l/by-id/x".into(),
                mode,
                controls,
                lock: false
            })
        );
    }

    #[test]
    fn what_cannot_be_is_refused_at_its_key() {
        let cases = [
            ("{ kind = \"webcam\" }", "camera.source.kind: `webcam` is no kind"),
            ("{ kind = \"recording\" }", "camera.source.path: missing"),
            (
                "{ kind = \"recording\", path = \"/not/there.mcap\" }",
                "camera.source.path: `/not/there.mcap` cannot be",
            ),
            (
                "{ kind = \"recording\", path = \"/\", pace = \"slow\" }",
                "camera.source.pace: `slow` is no pace",
            ),
            (
                "{ kind = \"recording\", path = \"/\", fps = 0 }",
                "camera.source.fps: impossible; write 0.001 to 1000",
            ),
            (
                "{ kind = \"recording\", path = \"/\", fps = nan }",
                "camera.source.fps: impossible; write 0.001 to 1000",
            ),
            (
                "{ kind = \"simulator\", fps = 1e-300 }",
                "camera.source.fps: impossible; write 0.001 to 1000",
            ),
            (
                "{ kind = \"recording\", path = \"/\", device = \"x\" }",
                "camera.source.device: unknown for kind",
            ),
            (
                "{ kind = \"simulator\", width = 0, height = 480 }",
                "camera.source.width: 0 px is impossible",
            ),
            ("{ kind = \"simulator\", width = 640 }", "camera.source.height: missing"),
            ("{ kind = \"simulator\", tint = 1 }", "tint: unknown field `tint`"),
            (
                "{ kind = \"simulator\", operator = \"sleeps\" }",
                "camera.source.operator: `sleeps` is no operator; write follows",
            ),
            ("{ kind = \"ros2\" }", "camera.source.topic: missing"),
            (
                "{ kind = \"ros2\", topic = \"front\" }",
                "camera.source.topic: `front` is no topic; write it as",
            ),
            (
                "{ kind = \"ros2\", topic = \"/a\", domain_id = 233 }",
                "camera.source.domain_id: 233 is no domain; write 0 to 232",
            ),
            ("{ kind = \"v4l2\" }", "camera.source.device: missing"),
            (
                "{ kind = \"uvc\", index = 0, name = \"x\" }",
                "camera.source.index: give the camera's index or its name",
            ),
            (
                "{ kind = \"realsense\", serial = \"1\", path = \"/\" }",
                "camera.source.serial: a serial number and a",
            ),
            (
                "{ kind = \"realsense\", preset = \"best\" }",
                "camera.source.preset: `best` is no preset; write one of",
            ),
            (
                "{ kind = \"realsense\", path = \"/\", emitter = true }",
                "camera.source.emitter: unknown for kind",
            ),
            ("\"simulator\"", "source: invalid type: string"),
        ];
        for (text, expected) in cases {
            let message = source(text).unwrap_err();
            assert!(
                message.starts_with(&format!("plumb.toml:3: {expected}")),
                "{message}\nis not\n{expected}"
            );
        }
    }
}
