//! Results on the graph of ROS 2, beside HTTP.

use std::sync::Arc;

use tokio::runtime::Runtime;
use tokio::sync::watch;

use crate::config::{CameraConfig, Config, SourceConfig};
use crate::dds::Domain;
use crate::graph::{CameraOnGraph, GraphPlan, InstrumentsOnGraph, publish};
use crate::pipeline::fleet::Fleet;
use crate::store::Store;

/// Publishes from now on, where the configuration says so: what is running, as it changes.
pub(super) fn begin(
    runtime: &Runtime,
    fleet: &Arc<Fleet>,
    store: &Arc<Store>,
    config: &Config,
    running: watch::Receiver<Config>,
) {
    if !config.ros2.publish {
        return;
    }
    let (changed, instruments) = watch::channel(instruments(config));
    let plan = GraphPlan {
        domain: Domain::of_environment(config.ros2.domain_id),
        session: config.ros2.session.clone(),
        info_with_images: config.ros2.camera_info_with_images,
        alpha: config.ros2.alpha,
        instruments,
    };
    let (fleet, store) = (Arc::clone(fleet), Arc::clone(store));
    runtime.spawn(forward(running, changed));
    runtime.spawn(publish(fleet, store, plan));
}

/// Has the graph know what is running after each change.
async fn forward(mut running: watch::Receiver<Config>, changed: watch::Sender<InstrumentsOnGraph>) {
    while running.changed().await.is_ok() {
        let now = instruments(&running.borrow_and_update());
        changed.send_if_modified(|known| {
            let is_new = *known != now;
            *known = now;
            is_new
        });
    }
}

fn instruments(config: &Config) -> InstrumentsOnGraph {
    InstrumentsOnGraph {
        cameras: config.cameras.iter().map(on_graph).collect(),
        rigs: config.rigs.iter().map(|rig| rig.name.clone()).collect(),
    }
}

/// A driver keeps the calibration of the images that it publishes: its service is in their
/// namespace, as camera_info_manager offers it.
fn on_graph(camera: &CameraConfig) -> CameraOnGraph {
    let set_camera_info = match &camera.source {
        SourceConfig::Ros2 { topic, .. } => {
            let image = topic.strip_suffix("/compressed").unwrap_or(topic);
            let namespace = image.rsplit_once('/').map_or("", |(namespace, _)| namespace);
            Some(format!("{namespace}/set_camera_info"))
        }
        _ => None,
    };
    CameraOnGraph { name: camera.name.clone(), set_camera_info }
}
