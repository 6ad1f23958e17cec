//! rosbag2 in MCAP: schemas `ros2msg` with messages in CDR, or of ROS 1 as converters write them.

use std::collections::BTreeMap;
use std::path::Path;

use crate::recording::RecordingError;
use crate::recording::bag::storage::{
    BagMessage, BagStorage, BagTopic, FoundTopics, MessageEncoding, one_type_name,
};
use crate::recording::records::{Broken, McapRecord, RecordReader};

/// An MCAP file with messages of ROS.
pub(super) struct McapStorage {
    records: RecordReader,
    found: FoundTopics<u16>,
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
        let listed = if has_summary { channels(&mut records) } else { None };
        // A summary need not list the channels. One of other programs' channels alone does: the
        // whole file holds no message of ROS.
        let found = match listed {
            Some(found) => found,
            None => {
                records.rewind().map_err(refused)?;
                channels(&mut records).unwrap_or_default()
            }
        };
        records.rewind().map_err(refused)?;
        Ok(Self { records, found })
    }
}

/// The channels with messages of ROS, as far as the records can be read; `None` where there is no
/// channel at all.
fn channels(records: &mut RecordReader) -> Option<FoundTopics<u16>> {
    let mut found: Option<FoundTopics<u16>> = None;
    let mut schemas: BTreeMap<u16, String> = BTreeMap::new();
    while let Ok(Some(record)) = records.next_record() {
        match record {
            McapRecord::Schema { id, name } => {
                schemas.insert(id, name);
            }
            McapRecord::Channel { id, schema_id, topic, encoding } => {
                let found = found.get_or_insert_default();
                let layout = match encoding.as_str() {
                    "cdr" => MessageEncoding::Cdr,
                    "ros1" => MessageEncoding::Ros1,
                    _ => continue,
                };
                let message_type = schemas.get(&schema_id).map(|name| one_type_name(name));
                let message_type = message_type.unwrap_or_default();
                found.add(id, BagTopic { name: topic, message_type, layout });
            }
            _ => {}
        }
    }
    found
}

impl BagStorage for McapStorage {
    fn topics(&self) -> &[BagTopic] {
        &self.found.topics
    }

    fn next_message(&mut self, wanted: &[bool]) -> Result<Option<BagMessage>, Broken> {
        while let Some(record) = self.records.next_record()? {
            let McapRecord::Message { header, data } = record else { continue };
            let topic = self.found.of_ids.get(&header.channel_id).copied();
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

#[cfg(test)]
mod tests {
    use mcap::MAGIC;
    use mcap::records::op;

    use super::*;

    fn record(opcode: u8, body: &[u8]) -> Vec<u8> {
        [&[opcode][..], &(body.len() as u64).to_le_bytes(), body].concat()
    }

    fn channel(id: u16, topic: &str, encoding: &str) -> Vec<u8> {
        let text = |text: &str| [&(text.len() as u32).to_le_bytes()[..], text.as_bytes()].concat();
        let (no_schema, no_metadata) = ([0; 2], [0; 4]);
        let id = id.to_le_bytes();
        let body = [&id[..], &no_schema, &text(topic), &text(encoding), &no_metadata].concat();
        record(op::CHANNEL, &body)
    }

    /// The topics of a file with these records, and these in its summary.
    fn topics(data: &[Vec<u8>], summary: &[Vec<u8>]) -> Vec<String> {
        let data = [MAGIC, &data.concat()].concat();
        let summary_start = if summary.is_empty() { 0 } else { data.len() as u64 };
        let footer = [&summary_start.to_le_bytes()[..], &[0; 12]].concat();
        let end = record(op::FOOTER, &footer);
        let bytes = [&data[..], &summary.concat(), &end, MAGIC].concat();
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("bag.mcap");
        std::fs::write(&path, bytes).unwrap();
        let storage = McapStorage::open(&path).unwrap();
        storage.topics().iter().map(|topic| topic.name.clone()).collect()
    }

    #[test]
    fn the_file_is_read_for_its_channels_only_where_the_summary_lists_none() {
        let data = [channel(1, "/image", "cdr")];
        assert_eq!(topics(&data, &[]), ["/image"]);
        assert_eq!(topics(&data, &[record(op::METADATA_INDEX, &[])]), ["/image"]);
        assert_eq!(topics(&data, &[channel(2, "/raw", "cdr")]), ["/raw"]);
        let of_another_program = [channel(2, "/front/color", "protobuf")];
        assert_eq!(topics(&data, &of_another_program), [""; 0], "the summary is believed");
    }

    #[test]
    fn a_channel_that_is_repeated_is_one_topic() {
        let data = ["/a", "/b", "/c"].map(|topic| channel(1, topic, "cdr"));
        assert_eq!(topics(&data, &[]), ["/a"]);
        let data = [channel(1, "/a", "cdr"), channel(2, "/a", "cdr"), channel(3, "/b", "ros1")];
        assert_eq!(topics(&data, &[]), ["/a", "/b"]);
    }
}
