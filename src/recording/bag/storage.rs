//! What a bag is to its reader: topics, and messages in the order of their times.

use std::collections::BTreeMap;
use std::collections::btree_map::Entry;

use crate::recording::fields::{Fields, TooShort};
use crate::recording::records::Broken;

/// How a message's fields are laid out.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum MessageEncoding {
    /// ROS 2: CDR.
    Cdr,
    /// ROS 1: packed, with a sequence number in each header.
    Ros1,
}

impl MessageEncoding {
    pub(super) fn fields(self, message: &[u8]) -> Result<Fields<'_>, TooShort> {
        match self {
            Self::Cdr => Fields::cdr(message),
            Self::Ros1 => Ok(Fields::packed(message)),
        }
    }
}

/// `std_msgs/Header`.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct RosHeader {
    pub(super) stamp_ns: i64,
    pub(super) frame_id: String,
}

impl RosHeader {
    pub(super) fn read(layout: MessageEncoding, fields: &mut Fields<'_>) -> Result<Self, TooShort> {
        if layout == MessageEncoding::Ros1 {
            fields.u32()?;
        }
        let (seconds, nanoseconds) = (fields.u32()?, fields.u32()?);
        let stamp_ns = i64::from(seconds) * 1_000_000_000 + i64::from(nanoseconds);
        Ok(Self { stamp_ns, frame_id: fields.text()? })
    }
}

/// A topic of a bag.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct BagTopic {
    pub(super) name: String,
    /// As ROS 1 writes it: `sensor_msgs/Image`.
    pub(super) message_type: String,
    pub(super) layout: MessageEncoding,
}

/// The topics that are found as a bag's channels or connections are read. An id is of one topic,
/// the first that it is given: there are never more topics than ids.
#[derive(Debug, Default)]
pub(super) struct FoundTopics<Id> {
    pub(super) topics: Vec<BagTopic>,
    /// The topic of each channel or connection.
    pub(super) of_ids: BTreeMap<Id, usize>,
    by_name: BTreeMap<String, usize>,
}

impl<Id: Ord> FoundTopics<Id> {
    pub(super) fn add(&mut self, id: Id, topic: BagTopic) {
        let Entry::Vacant(place) = self.of_ids.entry(id) else { return };
        let next = self.topics.len();
        let index = *self.by_name.entry(topic.name.clone()).or_insert(next);
        place.insert(index);
        if index == next {
            self.topics.push(topic);
        }
    }
}

/// A message, on the topic with this index in [`BagStorage::topics`].
pub(super) struct BagMessage {
    pub(super) topic: usize,
    pub(super) log_time_ns: i64,
    pub(super) bytes: Vec<u8>,
}

/// What yields a bag's messages in the order of their times.
pub(super) trait BagStorage: Send {
    /// Its topics; they never change.
    fn topics(&self) -> &[BagTopic];

    /// The next message on a topic that is `wanted`; `None` after the last.
    fn next_message(&mut self, wanted: &[bool]) -> Result<Option<BagMessage>, Broken>;

    /// Starts again at the first message.
    fn rewind(&mut self) -> Result<(), Broken>;
}

/// `sensor_msgs/Image` for `sensor_msgs/msg/Image` too.
pub(super) fn one_type_name(name: &str) -> String {
    name.replacen("/msg/", "/", 1)
}
