//! DDS, as ROS 2 uses it: topics, services, who is there. Uses no other layer; messages are bytes.
//!
//! | file | concept |
//! | --- | --- |
//! | `domain` | which graph, as ROS 2's environment says |
//! | `names` | ROS names of topics and types, and DDS's |
//! | `participant` | one participant a domain, and what it has discovered |
//! | `reader`, `writer` | samples of a topic, as they are on the wire |
//! | `service` | requests and replies, in the two ways that ROS 2's middlewares have |
//!
//! RustDDS has its own threads; nothing here waits, except who asks for it with a [`Waker`].
//!
//! [`Waker`]: std::task::Waker

mod domain;
mod error;
mod names;
mod participant;
mod raw;
mod reader;
mod service;
mod writer;

pub use domain::Domain;
pub use error::DdsError;
pub use names::ros_type;
pub use participant::{Participant, PublishedTopic};
pub use reader::{ReaderChange, Received, TopicReader};
pub use service::{Reply, Request, ServiceClient, ServiceServer};
pub use writer::{Durability, TopicWriter};
