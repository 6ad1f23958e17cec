//! Which topics a camera of a ROS 2 driver is.

use crate::dds::Domain;

/// Which topics of which graph.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Ros2Options {
    /// The graph.
    pub domain: Domain,
    /// The topic of images, raw or compressed.
    pub topic: String,
    /// The topic of their depth.
    pub depth: Option<String>,
}
