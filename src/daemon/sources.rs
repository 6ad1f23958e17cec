//! From a configured source to what opens it: one arm a kind.

use std::path::Path;
use std::sync::Once;

use crate::capture::realsense::{self, Origin};
#[cfg(feature = "ros2")]
use crate::capture::ros2::{Ros2Camera, Ros2Options};
use crate::capture::uvc;
#[cfg(target_os = "linux")]
use crate::capture::v4l2;
use crate::capture::{
    CaptureError, FrameSource, Pace, Replay, ReplayOptions, Simulated, SimulatedClock, SourceOpener,
};
use crate::config::source::UvcSelector;
use crate::config::{CameraConfig, RigConfig, SourceConfig};
#[cfg(feature = "ros2")]
use crate::dds::Domain;
use crate::document::error::DocumentError;
use crate::document::sensors_file::{FILE_NAME, SensorsFile};
use crate::pipeline::{CameraPlan, RigPlan};
use crate::recording::ReadOptions;
use crate::simulation::WorldOptions;

/// How the camera is set going.
pub fn plan_of(camera: &CameraConfig) -> CameraPlan {
    CameraPlan {
        name: camera.name.clone(),
        kind: camera.source.kind().to_owned(),
        image_source: camera.source.image_source(),
        open: opener_of(&camera.source),
        may_stall: camera.source.may_stall(),
    }
}

/// How the rig is set going.
pub fn rig_of(rig: &RigConfig) -> RigPlan {
    RigPlan { name: rig.name.clone(), cameras: rig.cameras.clone() }
}

/// What opens the source, also again after it was lost.
pub fn opener_of(source: &SourceConfig) -> Box<dyn SourceOpener> {
    match source.clone() {
        SourceConfig::Recording { path, topics, fastest, repeat, fps } => {
            let pace = if fastest { Pace::Fastest } else { Pace::Recorded };
            let reading = ReadOptions { fps, topics };
            let options = ReplayOptions { pace, repeat, reading };
            // It is opened again with each session.
            let first = Once::new();
            Box::new(move || open_recording(&path, &options, &first))
        }
        SourceConfig::Simulator { seed, size, fps, seat, operator, fastest } => {
            let options =
                WorldOptions { fps, ..WorldOptions::on_rig(seed, size, seat.unwrap_or(0)) };
            let clock = if seat.is_some() { SimulatedClock::Shared } else { SimulatedClock::Own };
            let pace = if fastest { Pace::Fastest } else { Pace::Recorded };
            Box::new(move || {
                let simulated = Simulated::new(&options, pace, clock);
                Ok(Box::new(match operator {
                    Some(kind) => simulated.operated(kind),
                    None => simulated,
                }) as Box<dyn FrameSource>)
            })
        }
        #[cfg(target_os = "linux")]
        SourceConfig::V4l2 { device, mode, controls, lock } => {
            let options = v4l2::V4l2Options { device, mode, controls, lock };
            Box::new(v4l2::V4l2Camera::new(options))
        }
        #[cfg(not(target_os = "linux"))]
        SourceConfig::V4l2 { .. } => not_built("v4l2, which only Linux has; use kind = \"uvc\""),
        SourceConfig::Uvc { camera, mode, backend } => {
            let selector = match camera {
                UvcSelector::Index(index) => uvc::Selector::Index(index),
                UvcSelector::Name(name) => uvc::Selector::Name(name),
            };
            uvc::camera(uvc::UvcOptions { selector, mode, backend })
        }
        #[cfg(feature = "ros2")]
        SourceConfig::Ros2 { topic, depth, domain_id } => {
            let domain = Domain::of_environment(domain_id);
            Box::new(Ros2Camera::new(Ros2Options { domain, topic, depth }))
        }
        #[cfg(not(feature = "ros2"))]
        SourceConfig::Ros2 { .. } => not_built("ROS 2; build it with --features ros2"),
        SourceConfig::Realsense { serial, mode, settings } => {
            let origin = serial.map_or(Origin::OnlyDevice, Origin::Serial);
            Box::new(realsense::RealsenseCamera::new(realsense::RealsenseOptions {
                origin,
                mode,
                settings,
            }))
        }
        SourceConfig::RealsenseBag { path } => {
            let options =
                realsense::RealsenseOptions { origin: Origin::Bag(path), ..Default::default() };
            Box::new(realsense::RealsenseCamera::new(options))
        }
    }
}

fn open_recording(
    path: &Path,
    options: &ReplayOptions,
    first: &Once,
) -> Result<Box<dyn FrameSource>, CaptureError> {
    let failed = |reason: String| CaptureError::Failed { reason };
    let replay = Replay::open(path, options).map_err(|error| failed(error.to_string()))?;
    let stated = SensorsFile::of_folder(path).map_err(|error| failed(error.to_string()))?;
    let Some(stated) = stated else { return Ok(Box::new(replay)) };
    first.call_once(|| stated.warn_of_unused(path));
    let factory = stated.factory(|sensor| replay.image_size(sensor));
    let named = |error: DocumentError| error.inside(&path.join(FILE_NAME).display().to_string());
    let factory = factory.map_err(|error| failed(named(error).to_string()))?;
    Ok(Box::new(replay.stating(factory)))
}

#[cfg(not(all(target_os = "linux", feature = "ros2")))]
fn not_built(kind: &'static str) -> Box<dyn SourceOpener> {
    Box::new(move || {
        Err(CaptureError::Failed { reason: format!("this plumb was built without {kind}") })
    })
}
