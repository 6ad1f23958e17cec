//! What goes out on a topic.

use std::sync::Mutex;
use std::sync::atomic::{AtomicI32, Ordering};

use rustdds::no_key::DataWriter;
use rustdds::policy::{Durability as DdsDurability, History, Reliability};
use rustdds::{
    DataWriterStatus, Duration, QosPolicies, QosPolicyBuilder, SampleIdentity, StatusEvented,
    WriteOptions,
};

use crate::dds::DdsError;
use crate::dds::raw::{AsItIs, RawMessage};
use crate::locks::lock;

/// Who gets a message.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Durability {
    /// Who is there when it is sent.
    Volatile,
    /// Who comes later too: the last message only (DDS's transient local).
    Latched,
    /// As latched, with the last so many messages.
    LatchedMany(i32),
}

/// How long a send may wait for a reader that is slow, in milliseconds.
const LONGEST_SEND_MS: i64 = 100;

impl Durability {
    pub(super) fn qos(self) -> QosPolicies {
        let (durability, depth) = match self {
            Self::Volatile => (DdsDurability::Volatile, 10),
            Self::Latched => (DdsDurability::TransientLocal, 1),
            Self::LatchedMany(depth) => (DdsDurability::TransientLocal, depth),
        };
        QosPolicyBuilder::new()
            .reliability(Reliability::Reliable {
                max_blocking_time: Duration::from_millis(LONGEST_SEND_MS),
            })
            .durability(durability)
            .history(History::KeepLast { depth })
            .build()
    }
}

/// What the identities of one participant's readers and writers begin with, in bytes (OMG
/// DDSI-RTPS 2.5, 8.2.4.1).
pub(super) const PREFIX: usize = 12;

/// A publisher of a topic.
pub struct TopicWriter {
    pub(super) name: String,
    pub(super) writer: DataWriter<RawMessage, AsItIs>,
    pub(super) readers: AtomicI32,
    /// The participants of the readers it has found, one entry for each reader.
    pub(super) reached: Mutex<Vec<[u8; PREFIX]>>,
}

impl std::fmt::Debug for TopicWriter {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("TopicWriter").field("name", &self.name).finish_non_exhaustive()
    }
}

impl TopicWriter {
    /// Sends `message`, in little-endian CDR with the four bytes that state it in front.
    ///
    /// # Errors
    /// [`DdsError::Send`].
    pub fn send(&self, message: Vec<u8>) -> Result<(), DdsError> {
        self.send_with(message, WriteOptions::default()).map(|_| ())
    }

    /// How many readers it has found.
    pub fn readers(&self) -> i32 {
        while let Some(status) = self.writer.try_recv_status() {
            if let DataWriterStatus::PublicationMatched { current, reader, .. } = status {
                self.readers.store(current.count(), Ordering::Relaxed);
                let Some(prefix) = reader.to_bytes().first_chunk().copied() else { continue };
                let mut reached = lock(&self.reached);
                if current.count_change() > 0 {
                    reached.push(prefix);
                } else if let Some(gone) = reached.iter().position(|known| *known == prefix) {
                    reached.swap_remove(gone);
                }
            }
        }
        self.readers.load(Ordering::Relaxed)
    }

    /// Whether it has found a reader of this participant.
    pub(super) fn has_reader_of(&self, participant: [u8; PREFIX]) -> bool {
        self.readers();
        lock(&self.reached).contains(&participant)
    }

    pub(super) fn send_with(
        &self,
        message: Vec<u8>,
        options: WriteOptions,
    ) -> Result<SampleIdentity, DdsError> {
        let sent = self.writer.write_with_options(RawMessage(message), options);
        sent.map_err(|error| DdsError::Send { topic: self.name.clone(), detail: error.to_string() })
    }
}
