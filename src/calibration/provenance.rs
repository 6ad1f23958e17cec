//! Which images a calibration was made from: it does not hold for another device, mode or size.

use std::collections::BTreeMap;

use crate::calibration::result::{CalibratedSensor, Calibration, SensorResult};
use crate::calibration::session_record::{SessionRecord, is_another_device};
use crate::geometry::pixel::ImageSize;
use crate::imaging::frame::SensorKind;

/// What identifies the camera and its images, as far as it is known.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct Provenance {
    /// The source in the configuration, in words: a device or a recording, and its mode.
    pub source: Option<String>,
    /// The device's model and serial number, in words.
    pub device: Option<String>,
    /// The size of each sensor's images.
    pub image_sizes: BTreeMap<SensorKind, ImageSize>,
}

impl Provenance {
    /// The provenance of `calibration`, its own or a rig's, for the images of `camera`; `record` is
    /// that of the session, if it is still stored.
    pub fn of(calibration: &Calibration, camera: &str, record: Option<&SessionRecord>) -> Self {
        let size = |sensor: &CalibratedSensor| match &sensor.result {
            SensorResult::Image(image) => (sensor.id.kind, image.image_size),
            SensorResult::Depth(depth) => (sensor.id.kind, depth.camera.image_size),
        };
        let own =
            |sensor: &&CalibratedSensor| sensor.id.camera.as_ref().is_none_or(|of| *of == *camera);
        Self {
            source: record.and_then(|record| record.sources.get(camera).cloned()),
            device: record.and_then(|record| record.devices.get(camera).cloned()),
            image_sizes: calibration.sensors.iter().filter(own).map(size).collect(),
        }
    }

    /// Why `calibration` (its name in messages), made from these images, may not be valid for those
    /// of `now`, and what to do; `None` if no difference is known.
    pub fn change(&self, now: &Self, calibration: &str) -> Option<String> {
        let both = self.device.as_ref().zip(now.device.as_ref());
        if let Some((was, is)) = both.filter(|(was, is)| is_another_device(was, is)) {
            return Some(format!(
                "the device changed from {was} to {is} since {calibration} was made: calibrate again, or approve a calibration of this device"
            ));
        }
        let resized = self.image_sizes.iter().find_map(|(kind, was)| {
            let is = now.image_sizes.get(kind).filter(|is| *is != was)?;
            Some((kind.name(), was, is))
        });
        if let Some((kind, was, is)) = resized {
            return Some(format!(
                "{kind} images are now {is}, but {calibration} is for {was}: calibrate again, or approve one for this size"
            ));
        }
        let both = self.source.as_ref().zip(now.source.as_ref());
        both.filter(|(was, is)| was != is).map(|(was, is)| {
            format!(
                "the source changed from {was} to {is} since {calibration} was made: calibrate again, or check it with `plumb verify`"
            )
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn provenance(source: &str, device: Option<&str>, width: u32) -> Provenance {
        Provenance {
            source: Some(source.to_owned()),
            device: device.map(str::to_owned),
            image_sizes: [(SensorKind::Color, ImageSize::new(width, 480))].into(),
        }
    }

    #[test]
    fn what_differs_is_said_and_what_is_not_known_does_not() {
        let was = provenance("v4l2 /dev/video0", Some("C920, serial A"), 640);
        assert_eq!(was.change(&was, "it"), None);
        assert_eq!(was.change(&Provenance::default(), "it"), None);
        assert_eq!(Provenance::default().change(&was, "it"), None);
        for device in [None, Some("C920")] {
            let now = provenance("v4l2 /dev/video0", device, 640);
            assert_eq!([was.change(&now, "it"), now.change(&was, "it")], [None, None]);
        }
        for (now, said) in [
            (
                provenance("v4l2 /dev/video0", Some("C920, serial B"), 640),
                "the device changed from C920, serial A to C920, serial B since it was made: ",
            ),
            (
                provenance("v4l2 /dev/video0", Some("C920, serial A"), 800),
                "color images are now 800x480, but it is for 640x480: ",
            ),
            (
                provenance("v4l2 /dev/video2", None, 640),
                "the source changed from v4l2 /dev/video0 to v4l2 /dev/video2 since it was made: ",
            ),
        ] {
            let reason = was.change(&now, "it").unwrap();
            assert!(reason.starts_with(said), "{reason}");
        }
    }
}
