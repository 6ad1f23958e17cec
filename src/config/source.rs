//! A camera's `source = { kind = "…", … }`: each kind with the keys it takes.
//!
//! | kind | keys |
//! | --- | --- |
//! | `v4l2` | `device`; `width` and `height`, `format`, `fps`, `controls` (default: as the device stands); `lock` (default false): hold focus and exposure during a session |
//! | `uvc` | `index` or `name`; `width` and `height`, `format`, `fps`; `backend` (`"native"`, the default on Linux, or `"nokhwa"`, the default elsewhere) |
//! | `realsense` | `serial` (default: the only one there is); `width` and `height`, `fps`, `preset`, `emitter` (default: as the device stands); or `path` of a .bag file |
//! | `ros2` | `topic` of images, raw or compressed; `depth`, the topic of their depth (default: none); `domain_id` (default: `ROS_DOMAIN_ID`, or 0) |
//! | `recording` | `path`; `topic` and `depth`, the camera's in a file of several (default: the only one there is); `pace` (`"recorded"`, the default, or `"fastest"`), `repeat` (default false), `fps` (of a folder without times, default 10) |
//! | `simulator` | `seed` (default 1), `seat` (which camera of a simulated rig, from 0; none unless given), `width` and `height` (default 640 × 480), `fps` (default 30), `operator` (`"follows"` what a session asks for, `"wanders"`, `"bars"`, or `"walk"`, the default), `pace` (`"recorded"`, the default, or `"fastest"`) |

use std::collections::BTreeMap;
use std::path::PathBuf;

use crate::capture::mode::ModeRequest;
use crate::capture::realsense::Settings;
use crate::capture::uvc::Backend;
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
        /// What reads it.
        backend: Backend,
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

    /// What decides the geometry of its images, in words: the device or the recording, its mode (a
    /// driver may crop or bin by size, format and rate), focus and zoom. Images of two sources that
    /// agree in it are of one lens; it says nothing of pace, exposure or who carries the board.
    pub fn image_source(&self) -> String {
        let mut words = vec![self.kind().to_owned()];
        match self {
            Self::V4l2 { device, mode, controls, lock: _ } => {
                words.push(device.display().to_string());
                words.extend(mode_words(mode));
                let is_optical = |name: &str| OPTICAL.iter().any(|kind| name.starts_with(kind));
                let optical = controls.iter().filter(|(name, _)| is_optical(name));
                words.extend(optical.map(|(name, value)| format!("{name}={value}")));
            }
            Self::Uvc { camera, mode, backend } => {
                words.push(match camera {
                    UvcSelector::Index(index) => index.to_string(),
                    UvcSelector::Name(name) => format!("{name:?}"),
                });
                words.extend(mode_words(mode));
                words.push(backend.name().to_owned());
            }
            Self::Realsense { serial, mode, settings } => {
                words.extend(serial.clone());
                words.extend(mode_words(mode));
                words.extend(settings.preset.map(|preset| preset.name().to_owned()));
            }
            Self::RealsenseBag { path } => words.push(path.display().to_string()),
            Self::Ros2 { topic, depth, domain_id } => {
                words.push(topic.clone());
                words.extend(depth.clone());
                words.extend(domain_id.map(|id| format!("domain {id}")));
            }
            Self::Recording { path, topics, fastest: _, repeat: _, fps: _ } => {
                words.push(path.display().to_string());
                words.extend(topics.iter().cloned());
            }
            Self::Simulator { seed, size, seat, fps: _, operator: _, fastest: _ } => {
                words.push(format!("seed {seed} {}x{}", size.width, size.height));
                words.extend(seat.map(|seat| format!("seat {seat}")));
            }
        }
        words.join(" ")
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

/// How the names of controls begin that move the lens, or what of the sensor is read.
const OPTICAL: [&str; 4] = ["focus", "zoom", "pan", "tilt"];

/// What is asked for of a mode.
fn mode_words(mode: &ModeRequest) -> Vec<String> {
    let size = mode.size.map(|size| format!("{}x{}", size.width, size.height));
    let fps = mode.fps.map(|fps| format!("{fps} fps"));
    [size, mode.format.clone(), fps].into_iter().flatten().collect()
}

/// Which USB camera.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum UvcSelector {
    /// The n-th, from 0.
    Index(u32),
    /// The one with this name.
    Name(String),
}
