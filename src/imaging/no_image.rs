//! Why nothing can be searched for in a frame set: it has no image.

use std::fmt;

use crate::imaging::frame::{FrameSet, SensorKind};

/// A frame set without an image of light, as of a camera whose color image is missing beside depth.
/// Its text says what is there, which image is missing from where, and what to do.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct NoImage {
    /// The sensors that it has.
    sensors: Vec<SensorKind>,
    /// The name that images which were taken together share in a folder.
    name: Option<String>,
    /// The folder, where it is known.
    folder: Option<String>,
}

impl NoImage {
    /// Of `set`, in which there is none.
    pub fn of(set: &FrameSet) -> Self {
        let sensors = set.frames.iter().map(|frame| frame.sensor).collect();
        Self { sensors, name: set.name.clone(), folder: None }
    }

    /// The same, of a set whose images are in subfolders of this folder.
    #[must_use]
    pub fn in_folder(self, folder: Option<&str>) -> Self {
        Self { folder: folder.map(str::to_owned), ..self }
    }
}

impl fmt::Display for NoImage {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let names: Vec<&str> = self.sensors.iter().map(|sensor| sensor.name()).collect();
        let there = if names.is_empty() {
            "nothing".to_owned()
        } else {
            format!("only {}", names.join(" and "))
        };
        write!(f, "it has {there}, and its color image is missing: ")?;
        let Some(name) = &self.name else {
            return f.write_str(
                "check that color is delivered (in a recording: on its own topic) with the same timestamps",
            );
        };
        let color = SensorKind::Color.name();
        match &self.folder {
            Some(folder) => write!(f, "put it at {}/{color}/{name}", folder.trim_end_matches('/'))?,
            None => write!(f, "put it at {color}/{name} in the recording's folder")?,
        }
        f.write_str(" (.png, .jpg, .pgm …)")?;
        names.iter().try_for_each(|sensor| write!(f, ", or take {sensor}/{name} out"))
    }
}

impl std::error::Error for NoImage {}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::pixel::ImageSize;
    use crate::imaging::frame::{Frame, PixelFormat};
    use crate::imaging::timestamp::HostTime;

    fn set(name: Option<&str>, sensors: &[SensorKind]) -> FrameSet {
        let frame = |sensor: &SensorKind| Frame {
            sensor: *sensor,
            size: ImageSize::new(1, 1),
            format: PixelFormat::Depth16,
            stride: 2,
            bytes: vec![0, 0].into(),
        };
        FrameSet {
            sequence: 7,
            host_time: HostTime { utc_ns: 0 },
            device_time: None,
            name: name.map(str::to_owned),
            frames: sensors.iter().map(frame).collect(),
        }
    }

    #[test]
    fn what_is_missing_is_said_with_its_place_and_what_to_do() {
        let depth = [SensorKind::Depth];
        let named = NoImage::of(&set(Some("03"), &depth));
        assert_eq!(
            named.clone().in_folder(Some("box/")).to_string(),
            "it has only depth, and its color image is missing: put it at box/color/03 (.png, .jpg, .pgm …), or take depth/03 out"
        );
        assert!(named.to_string().contains("put it at color/03 in the recording's folder"));
        let unnamed = NoImage::of(&set(None, &depth)).to_string();
        assert!(unnamed.contains("only depth") && unnamed.contains("same timestamps"), "{unnamed}");
        assert!(NoImage::of(&set(None, &[])).to_string().contains("it has nothing, and"));
    }
}
