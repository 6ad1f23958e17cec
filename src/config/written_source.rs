//! A camera's source as the file has it: each kind's own keys, and what is refused.

use std::collections::BTreeMap;
use std::ops::Range;
use std::path::PathBuf;

use serde::Deserialize;
use toml::Spanned;

use crate::capture::realsense::{Preset, Settings};
use crate::capture::uvc::Backend;
use crate::config::error::ConfigError;
use crate::config::place::Place;
use crate::config::source::{SourceConfig, UvcSelector};
use crate::geometry::pixel::ImageSize;
use crate::simulation::OperatorKind;

/// The table as written: every key that some kind takes.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields, expecting = "a table")]
pub(crate) struct WrittenSource {
    pub(super) kind: Spanned<String>,
    pub(super) device: Option<Spanned<PathBuf>>,
    pub(super) index: Option<Spanned<u32>>,
    pub(super) name: Option<Spanned<String>>,
    pub(super) serial: Option<Spanned<String>>,
    pub(super) path: Option<Spanned<PathBuf>>,
    pub(super) topic: Option<Spanned<String>>,
    pub(super) depth: Option<Spanned<String>>,
    pub(super) domain_id: Option<Spanned<u16>>,
    pub(super) pace: Option<Spanned<String>>,
    pub(super) repeat: Option<Spanned<bool>>,
    pub(super) seed: Option<Spanned<u64>>,
    pub(super) seat: Option<Spanned<u32>>,
    pub(super) width: Option<Spanned<u32>>,
    pub(super) height: Option<Spanned<u32>>,
    pub(super) format: Option<Spanned<String>>,
    pub(super) fps: Option<Spanned<f64>>,
    pub(super) controls: Option<Spanned<BTreeMap<String, i64>>>,
    pub(super) lock: Option<Spanned<bool>>,
    pub(super) backend: Option<Spanned<String>>,
    pub(super) operator: Option<Spanned<String>>,
    pub(super) preset: Option<Spanned<String>>,
    pub(super) emitter: Option<Spanned<bool>>,
}

const KINDS: &str = "write one of v4l2, uvc, realsense, ros2, recording, simulator";
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
                let keys = ["index", "name", "width", "height", "format", "fps", "backend"];
                self.takes_only(&keys, place)?;
                Ok(SourceConfig::Uvc {
                    camera: self.uvc_selector(span, place)?,
                    mode: self.mode(place)?,
                    backend: self.uvc_backend(place)?,
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
                    let problem = format!("{seat} is not a valid seat; write 0 to {LAST_SEAT}");
                    return Err(place.refuse(&span, "camera.source.seat", problem));
                }
                let (operator, fastest) = (self.operator(place)?, self.is_fastest(place)?);
                let seat = seat.map(|(seat, _)| seat);
                Ok(SourceConfig::Simulator { seed, size, fps, seat, operator, fastest })
            }
            other => Err(place.refuse(
                &self.kind.span(),
                "camera.source.kind",
                format!("`{other}` is not a valid kind; {KINDS}"),
            )),
        }
    }

    fn ros2(&self, span: &Range<usize>, place: &Place) -> Result<SourceConfig, ConfigError> {
        self.takes_only(&["topic", "depth", "domain_id"], place)?;
        self.needed("topic", self.topic.as_ref(), span, place)?;
        for (key, topic) in [("topic", &self.topic), ("depth", &self.depth)] {
            if let Some(topic) = topic.as_ref().filter(|topic| !is_topic(topic.get_ref())) {
                let problem = format!(
                    "`{}` is not a topic name; write it as `ros2 topic list` does, as in /front/image_raw",
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
                let problem =
                    format!("`{other}` is not a valid pace; write \"recorded\" or \"fastest\"");
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
        let problem =
            format!("`{name}` is not a valid operator; write follows, wanders, bars or walk");
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
            let problem =
                format!("`{}` is not a valid preset; write one of {names}", preset.get_ref());
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

    /// The backend asked for, which this build has.
    fn uvc_backend(&self, place: &Place) -> Result<Backend, ConfigError> {
        let Some(written) = &self.backend else { return Ok(Backend::DEFAULT) };
        let refuse =
            |problem: String| place.refuse(&written.span(), "camera.source.backend", problem);
        let name = written.get_ref();
        let unknown =
            || refuse(format!("`{name}` is not a valid backend; write \"native\" or \"nokhwa\""));
        let backend = Backend::from_name(name).ok_or_else(unknown)?;
        backend.missing().map_or(Ok(backend), |missing| Err(refuse(missing.to_owned())))
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
            let problem =
                format!("{} is not a valid domain; write 0 to {LAST_DOMAIN}", id.get_ref());
            Err(place.refuse(&id.span(), key, problem))
        }
        _ => Ok(()),
    }
}

#[cfg(test)]
#[path = "source_tests.rs"]
mod tests;
