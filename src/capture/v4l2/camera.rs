//! A configured Linux camera: opened, and after a loss found again by what it is, not by where it
//! was.

use std::collections::BTreeMap;
use std::io;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::AtomicU64;

use v4l::Device;

use crate::capture::mode::ModeRequest;
use crate::capture::v4l2::controls::Controls;
use crate::capture::v4l2::device_node::{DeviceNode, kernel_has_video, video_nodes};
use crate::capture::v4l2::failure::{failed, lost};
use crate::capture::v4l2::identity::{DeviceIdentity, find_by_request, is_stable};
use crate::capture::v4l2::kernel;
use crate::capture::v4l2::mode::{ModeError, set_mode};
use crate::capture::v4l2::source::{OpenedDevice, V4l2Source};
use crate::capture::{CaptureError, FrameSource, SourceOpener};

/// Which device, and how it is to be set.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct V4l2Options {
    /// A path, a serial number, or a device's name or place as `plumb devices` lists them.
    pub device: PathBuf,
    /// Size, format and rate; default: as the device has them.
    pub mode: ModeRequest,
    /// Controls by name, set when it is opened and given back when it is closed; default: none.
    pub controls: BTreeMap<String, i64>,
    /// Hold focus, exposure, gain and white balance still while a session collects; default: not.
    pub lock: bool,
}

/// A Linux camera that may come and go.
#[derive(Debug)]
pub struct V4l2Camera {
    options: V4l2Options,
    identity: Option<DeviceIdentity>,
    /// The number of the next frame set: it goes on rising when the device is opened again.
    next_sequence: Arc<AtomicU64>,
}

impl V4l2Camera {
    /// A camera that is not opened yet.
    pub fn new(options: V4l2Options) -> Self {
        Self { options, identity: None, next_sequence: Arc::default() }
    }

    fn open_source(&mut self) -> Result<V4l2Source, CaptureError> {
        let node = self.node()?;
        let device = open_device(&node.path)?;
        let failed = |problem: &str| failed(&node.path, problem);
        let lost = |error: &io::Error| lost(&node.path, error);
        let capability = kernel::capability(&device).map_err(|error| lost(&error))?;
        if !capability.streams_video() {
            return Err(self.gives_no_video(&node, capability.is_multiplanar()));
        }
        let mode = set_mode(&device, &self.options.mode).map_err(|error| match error {
            ModeError::Unfit(problem) => failed(&problem),
            ModeError::Idle => idle(&node),
            ModeError::Device(error) => lost(&error),
        })?;
        let mut controls = Controls::read(&device);
        if let Err(error) = controls.set(&device, &self.options.controls) {
            controls.restore(&device);
            return Err(failed(&error.to_string()));
        }
        let identity = self.identity.insert(DeviceIdentity::of(&node)).words();
        let (lock, next_sequence) = (self.options.lock, Arc::clone(&self.next_sequence));
        let opened = OpenedDevice {
            device,
            mode,
            controls,
            node,
            identity,
            driver: capability.driver,
            lock,
            next_sequence,
        };
        V4l2Source::start(opened)
    }

    /// The node that the device has now.
    fn node(&self) -> Result<DeviceNode, CaptureError> {
        let nodes = video_nodes();
        let request = &self.options.device;
        let known = self.identity.as_ref().filter(|_| !is_stable(request));
        let found = match known {
            Some(identity) => identity.find(&nodes),
            None => find_by_request(request, &nodes),
        };
        let absent = || {
            let device = known.map_or_else(|| request.display().to_string(), DeviceIdentity::words);
            CaptureError::Lost { device, reason: absence(&nodes) }
        };
        found.cloned().ok_or_else(absent)
    }

    fn gives_no_video(&self, node: &DeviceNode, multiplanar: bool) -> CaptureError {
        if multiplanar {
            return failed(
                &node.path,
                "delivers multi-planar images, which Plumb does not support",
            );
        }
        if node.index > 0 {
            return failed(&node.path, "is a metadata node; use the device's first node");
        }
        idle(node)
    }
}

impl SourceOpener for V4l2Camera {
    fn open(&mut self) -> Result<Box<dyn FrameSource>, CaptureError> {
        Ok(Box::new(self.open_source()?))
    }
}

/// A loopback device is a camera only while a program feeds it.
fn idle(node: &DeviceNode) -> CaptureError {
    CaptureError::Lost {
        device: node.path.display().to_string(),
        reason: ModeError::Idle.to_string(),
    }
}

/// Opens a node, and says what to do where that is refused.
pub(super) fn open_device(node: &Path) -> Result<Device, CaptureError> {
    Device::with_path(node).map_err(|error| lost(node, &error))
}

/// Why a device is not among `nodes`.
fn absence(nodes: &[DeviceNode]) -> String {
    if !kernel_has_video() {
        return "the kernel has no video devices at all; plug the camera in, or load its driver"
            .to_owned();
    }
    let names: Vec<String> =
        nodes.iter().map(|node| format!("{} ({})", node.path.display(), node.name)).collect();
    match names.is_empty() {
        true => "no camera is plugged in".to_owned(),
        false => format!("it is not plugged in; connected: {}", names.join(", ")),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_device_that_is_not_there_may_still_come() {
        let options = V4l2Options { device: "/dev/video-none".into(), ..V4l2Options::default() };
        let error = V4l2Camera::new(options).open_source().map(|_| ()).unwrap_err();
        assert!(matches!(error, CaptureError::Lost { .. }), "{error}");
    }
}
