//! Results on the graph of ROS 2, beside HTTP.

use std::sync::Arc;

use tokio::runtime::Runtime;

use crate::config::{CameraConfig, Config, SourceConfig};
use crate::dds::Domain;
use crate::graph::{CameraOnGraph, GraphPlan, publish};
use crate::pipeline::fleet::Fleet;
use crate::store::Store;

/// Publishes from now on, where the configuration says so.
pub(super) fn begin(runtime: &Runtime, fleet: &Arc<Fleet>, store: &Arc<Store>, config: &Config) {
    if !config.ros2.publish {
        return;
    }
    let plan = GraphPlan {
        domain: Domain::of_environment(config.ros2.domain_id),
        session: config.ros2.session.clone(),
        cameras: config.cameras.iter().map(on_graph).collect(),
    };
    let (fleet, store) = (Arc::clone(fleet), Arc::clone(store));
    runtime.spawn(async move {
        if let Err(error) = publish(fleet, store, plan).await {
            tracing::error!("nothing is published on the graph: {error}");
        }
    });
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
