//! rosbag2 in MCAP: schemas `ros2msg` with messages in CDR, or of ROS 1 as converters write them.

use std::collections::BTreeMap;
use std::path::Path;

use crate::recording::RecordingError;
use crate::recording::bag::storage::{
    BagMessage, BagStorage, BagTopic, MessageEncoding, one_type_name,
};
use crate::recording::records::{Broken, McapRecord, RecordReader};

/// An MCAP file with messages of ROS.
pub(super) struct McapStorage {
    records: RecordReader,
    topics: Vec<BagTopic>,
    /// The topic of each channel.
    channels: BTreeMap<u16, usize>,
}

impl McapStorage {
    /// Opens the file at `path`.
    ///
    /// # Errors
    /// [`RecordingError::NotARecording`], and what the system refuses.
    pub(super) fn open(path: &Path) -> Result<Self, RecordingError> {
        let refused = |source| RecordingError::Io { path: path.to_owned(), source };
        let not_one = || RecordingError::NotARecording { path: path.to_owned() };
        let mut records = RecordReader::open(path).map_err(refused)?.ok_or_else(not_one)?;
        let has_summary = records.seek_to_summary().map_err(refused)?;
        let mut found = (Vec::new(), BTreeMap::new());
        if has_summary {
            found = channels(&mut records);
        }
        if found.0.is_empty() {
            records.rewind().map_err(refused)?;
            found = channels(&mut records);
        }
        let (topics, channels) = found;
        records.rewind().map_err(refused)?;
        Ok(Self { records, topics, channels })
    }
}

/// The channels with messages of ROS, as far as the records can be read.
fn channels(records: &mut RecordReader) -> (Vec<BagTopic>, BTreeMap<u16, usize>) {
    let (mut topics, mut channels) = (Vec::new(), BTreeMap::new());
    let mut schemas: BTreeMap<u16, String> = BTreeMap::new();
    while let Ok(Some(record)) = records.next_record() {
        match record {
            McapRecord::Schema { id, name } => {
                schemas.insert(id, name);
            }
            McapRecord::Channel { id, schema_id, topic, encoding } => {
                let layout = match encoding.as_str() {
                    "cdr" => MessageEncoding::Cdr,
                    "ros1" => MessageEncoding::Ros1,
                    _ => continue,
                };
                let message_type = schemas.get(&schema_id).map(|name| one_type_name(name));
                let message_type = message_type.unwrap_or_default();
                let known = topics.iter().position(|known: &BagTopic| known.name == topic);
                let index = known.unwrap_or_else(|| {
                    topics.push(BagTopic { name: topic, message_type, layout });
                    topics.len() - 1
                });
                channels.insert(id, index);
            }
            _ => {}
        }
    }
    (topics, channels)
}

impl BagStorage for McapStorage {
    fn topics(&self) -> &[BagTopic] {
        &self.topics
    }

    fn next_message(&mut self, wanted: &[bool]) -> Result<Option<BagMessage>, Broken> {
        while let Some(record) = self.records.next_record()? {
            let McapRecord::Message { header, data } = record else { continue };
            let topic = self.channels.get(&header.channel_id).copied();
            if let Some(topic) = topic.filter(|topic| wanted.get(*topic) == Some(&true)) {
                let log_time_ns = i64::try_from(header.log_time).unwrap_or(i64::MAX);
                return Ok(Some(BagMessage { topic, log_time_ns, bytes: data }));
            }
        }
        Ok(None)
    }

    fn rewind(&mut self) -> Result<(), Broken> {
        self.records.rewind().map_err(Broken::Io)
    }
}
