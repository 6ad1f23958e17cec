//! The images of a ROS 2 driver as frames.

use std::collections::BTreeMap;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::task::{Wake, Waker};
use std::thread::{self, Thread};
use std::time::{Duration, Instant};

use crate::capture::host_clock::now;
use crate::capture::ros2::options::Ros2Options;
use crate::capture::{CaptureError, FrameSource, Losses, SourceDescription};
use crate::dds::{PublishedTopic, ReaderChange, Received, TopicReader};
use crate::geometry::pixel::ImageSize;
use crate::imaging::factory::FactoryCalibration;
use crate::imaging::frame::{Frame, FrameSet, SensorKind};
use crate::recording::CameraMessages;

/// How long opening waits for the driver's camera_info, which comes with each image.
const CAMERA_INFO_TIMEOUT: Duration = Duration::from_millis(500);
/// How often a waiting source asks whether its publishers are still there.
const POLL_INTERVAL: Duration = Duration::from_millis(200);

/// What is read of a driver.
#[derive(Debug)]
pub(super) struct Subscriptions {
    pub images: Vec<TopicReader>,
    /// One entry for each of the images.
    pub infos: Vec<Option<TopicReader>>,
    pub transforms: Option<TopicReader>,
}

/// Who sends on a topic.
#[derive(Debug, Default)]
struct Sender {
    /// Who sent the newest image, and its number.
    last: Option<([u8; 16], i64)>,
    /// Who sent before that one took over.
    before: Option<[u8; 16]>,
}

/// A driver's images, as they come.
#[derive(Debug)]
pub(super) struct Ros2Source {
    options: Ros2Options,
    offered: Vec<PublishedTopic>,
    read: Subscriptions,
    messages: CameraMessages,
    senders: Vec<Sender>,
    sizes: SensorSizes,
    has_given: bool,
    factory: FactoryCalibration,
    losses: Losses,
    next_sequence: Arc<AtomicU64>,
}

/// The size of each sensor's images, as they came last.
#[derive(Debug, Default)]
struct SensorSizes(BTreeMap<SensorKind, ImageSize>);

/// Wakes a thread that is parked.
struct Unpark(Thread);

impl Wake for Unpark {
    fn wake(self: Arc<Self>) {
        self.0.unpark();
    }
}

impl Ros2Source {
    pub fn new(
        options: Ros2Options,
        offered: Vec<PublishedTopic>,
        read: Subscriptions,
        messages: CameraMessages,
        next_sequence: &Arc<AtomicU64>,
    ) -> Self {
        let senders = offered.iter().map(|_| Sender::default()).collect();
        Self {
            options,
            offered,
            read,
            messages,
            senders,
            sizes: SensorSizes::default(),
            has_given: false,
            factory: FactoryCalibration::default(),
            losses: Losses::default(),
            next_sequence: Arc::clone(next_sequence),
        }
    }

    /// Waits for what the driver states of its lens, where it says that it states anything.
    pub fn with_stated_calibration(mut self) -> Self {
        let deadline = Instant::now() + CAMERA_INFO_TIMEOUT;
        let states = self.read.infos.iter().all(Option::is_some);
        while states && !self.messages.has_stated() && Instant::now() < deadline {
            // A fault is found again by who asks for the first frame.
            let _ = self.advance(deadline);
        }
        self.factory = self.messages.factory();
        self
    }

    /// Takes in what has come; waits for it until `deadline` where nothing has.
    fn advance(&mut self, deadline: Instant) -> Result<(), CaptureError> {
        let waker = Waker::from(Arc::new(Unpark(thread::current())));
        self.readers().for_each(|reader| reader.wake(&waker));
        self.check_publishers()?;
        if !self.take_all()? {
            let left = deadline.saturating_duration_since(Instant::now());
            thread::park_timeout(left.min(POLL_INTERVAL));
        }
        Ok(())
    }

    fn readers(&self) -> impl Iterator<Item = &TopicReader> {
        let Subscriptions { images, infos, transforms } = &self.read;
        images.iter().chain(infos.iter().flatten()).chain(transforms)
    }

    /// Whether anything had come.
    fn take_all(&mut self) -> Result<bool, CaptureError> {
        let mut any = false;
        while let Some(sample) = self.read.transforms.as_ref().and_then(TopicReader::take) {
            self.messages.take_transforms(&sample.bytes);
        }
        for index in 0..self.read.images.len() {
            while let Some(sample) = self.read.infos[index].as_ref().and_then(TopicReader::take) {
                any = true;
                self.messages.take_info(index, &sample.bytes);
            }
            if let Some(sample) = self.read.images[index].take() {
                any = true;
                self.take_image(index, &sample)?;
            }
        }
        Ok(any)
    }

    fn take_image(&mut self, index: usize, sample: &Received) -> Result<(), CaptureError> {
        self.losses.missed +=
            self.senders[index].count(sample.writer, sample.sequence).map_err(|problem| {
                let name = &self.offered[index].name;
                self.lost(format!("{problem} {name}, and a camera has one: stop one of them"))
            })?;
        match self.messages.take_image(index, &sample.bytes, now().utc_ns) {
            Ok(()) => {}
            Err(error) if !self.has_given => return Err(self.lost(error.to_string())),
            Err(_) => self.losses.damaged += 1,
        }
        Ok(())
    }

    /// Whether the publishers still are what was subscribed to.
    fn check_publishers(&self) -> Result<(), CaptureError> {
        for (reader, offered) in self.read.images.iter().zip(&self.offered) {
            for change in reader.changes() {
                match change {
                    ReaderChange::Publishers(0) => {
                        let reason = format!("the publisher of {} is gone", offered.name);
                        return Err(self.lost(reason));
                    }
                    ReaderChange::Incompatible(policy) => {
                        return Err(self.lost(format!(
                            "a publisher of {} changed its QoS: {policy}",
                            offered.name
                        )));
                    }
                    ReaderChange::Publishers(_) => {}
                }
            }
        }
        Ok(())
    }

    fn lost(&self, reason: String) -> CaptureError {
        CaptureError::Lost { device: self.options.topic.clone(), reason }
    }
}

/// A driver that was set to another size.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
#[error("its {} images changed from {before} to {size}", sensor.name())]
struct SizeChange {
    sensor: SensorKind,
    before: ImageSize,
    size: ImageSize,
}

impl SensorSizes {
    /// A driver that was set to another size is another camera to who calibrates it. A sensor may
    /// be missing from a frame set; a frame that could not be read has no size.
    fn check(&mut self, frames: &[Frame]) -> Result<(), SizeChange> {
        let readable = |frame: &&Frame| frame.size.width > 0 && frame.size.height > 0;
        for Frame { sensor, size, .. } in frames.iter().filter(readable) {
            match self.0.insert(*sensor, *size) {
                Some(before) if before != *size => {
                    return Err(SizeChange { sensor: *sensor, before, size: *size });
                }
                _ => {}
            }
        }
        Ok(())
    }
}

impl Sender {
    /// How many images before this one got lost.
    fn count(&mut self, writer: [u8; 16], sequence: i64) -> Result<u64, &'static str> {
        let missed = match self.last {
            Some((last, number)) if last == writer => sequence - number - 1,
            Some((other, _)) => {
                if self.before.replace(other) == Some(writer) {
                    return Err("two publishers send on");
                }
                0
            }
            None => 0,
        };
        self.last = Some((writer, sequence));
        Ok(missed.max(0).unsigned_abs())
    }
}

impl FrameSource for Ros2Source {
    fn next_frame(&mut self, timeout: Duration) -> Result<FrameSet, CaptureError> {
        let deadline = Instant::now() + timeout;
        loop {
            if let Some(mut set) = self.messages.next_frame_set() {
                self.sizes.check(&set.frames).map_err(|change| self.lost(change.to_string()))?;
                self.has_given = true;
                set.sequence = self.next_sequence.fetch_add(1, Ordering::Relaxed);
                return Ok(set);
            }
            if Instant::now() >= deadline {
                return Err(CaptureError::TimedOut { waited: timeout });
            }
            self.advance(deadline)?;
        }
    }

    fn description(&self) -> SourceDescription {
        let reliable = self.offered.iter().all(PublishedTopic::is_reliable);
        let how = if reliable { "reliable" } else { "best effort" };
        let types: Vec<String> = self
            .offered
            .iter()
            .map(|offered| format!("{} ({})", offered.name, offered.type_name))
            .collect();
        SourceDescription {
            kind: "ros2",
            identity: self.options.topic.clone(),
            bus: Some(format!("domain {}", self.options.domain.id)),
            factory: self.factory.clone(),
            mode: Some(format!("{}, {how}", types.join(", "))),
            ..SourceDescription::default()
        }
    }

    fn losses(&self) -> Losses {
        self.losses
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::imaging::frame::PixelFormat;

    fn frame(sensor: SensorKind, width: u32, height: u32) -> Frame {
        let format = PixelFormat::Mono8;
        let bytes = vec![0; (width * height) as usize].into();
        Frame { sensor, size: ImageSize::new(width, height), format, stride: width as usize, bytes }
    }

    #[test]
    fn a_size_is_compared_with_that_of_the_same_sensor() {
        let mut sizes = SensorSizes::default();
        let color = || frame(SensorKind::Color, 8, 6);
        let depth = || frame(SensorKind::Depth, 4, 3);
        assert_eq!(sizes.check(&[color(), depth()]), Ok(()));
        assert_eq!(sizes.check(&[depth()]), Ok(()), "without a color image");
        assert_eq!(sizes.check(&[color(), frame(SensorKind::Depth, 0, 0)]), Ok(()), "unreadable");
        assert_eq!(sizes.check(&[color(), depth()]), Ok(()));
        let changed = sizes.check(&[color(), frame(SensorKind::Depth, 8, 6)]);
        assert_eq!(changed.unwrap_err().to_string(), "its depth images changed from 4x3 to 8x6");
    }

    #[test]
    fn a_gap_is_counted_and_two_that_alternate_are_refused() {
        let mut sender = Sender::default();
        let mut count = |writer: u8, sequence| sender.count([writer; 16], sequence);
        assert_eq!((count(1, 5), count(1, 6), count(1, 9)), (Ok(0), Ok(0), Ok(2)));
        // Restarted: another writer, which begins anew.
        assert_eq!((count(2, 1), count(2, 3)), (Ok(0), Ok(1)));
        assert_eq!((count(3, 1), count(2, 4)), (Ok(0), Err("two publishers send on")));
    }
}
