//! What comes in on a topic.

use std::task::Waker;

use rustdds::no_key::SimpleDataReader;
use rustdds::{DataReaderStatus, SampleIdentity, StatusEvented};

use crate::dds::raw::{AsItIs, RawMessage};

/// A message that came in.
#[derive(Debug, Clone, PartialEq)]
pub struct Received {
    /// The message, the four bytes that state its encoding in front.
    pub bytes: Vec<u8>,
    /// Who sent it.
    pub writer: [u8; 16],
    /// The publisher's own count: a gap is what got lost.
    pub sequence: i64,
    /// The sample itself, as replies name it.
    pub(super) identity: SampleIdentity,
    /// The sample that it replies to.
    pub(super) replies_to: Option<SampleIdentity>,
}

/// What happened to a reader's publishers.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum ReaderChange {
    /// So many send to it now.
    Publishers(i32),
    /// One that offers less than was asked for: DDS's name of the policy.
    Incompatible(String),
}

/// A subscription.
pub struct TopicReader {
    pub(super) reader: SimpleDataReader<RawMessage, AsItIs>,
}

impl std::fmt::Debug for TopicReader {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("TopicReader").finish_non_exhaustive()
    }
}

impl TopicReader {
    /// Wakes `waker` once when a sample comes. Take until there is none afterwards: what came
    /// before is not reported.
    pub fn wake(&self, waker: &Waker) {
        self.reader.set_waker(Some(waker.clone()));
        self.reader.drain_read_notifications();
    }

    /// The next sample that has come; `None` if there is none. Samples in an encoding that ROS
    /// does not use are left out.
    pub fn take(&self) -> Option<Received> {
        let taken = self.reader.try_take_one().ok().flatten()?;
        let identity = SampleIdentity {
            writer_guid: taken.writer_guid(),
            sequence_number: taken.sequence_number,
        };
        Some(Received {
            writer: taken.writer_guid().to_bytes(),
            sequence: i64::from(taken.sequence_number),
            identity,
            replies_to: taken.related_sample_identity(),
            bytes: taken.into_value().0,
        })
    }

    /// Passes over all that has come. A participant keeps samples of a topic for readers to come,
    /// also where neither they nor their publisher asked for that.
    pub fn skip(&self) {
        while self.take().is_some() {}
    }

    /// What has happened to its publishers since this was last asked.
    pub fn changes(&self) -> Vec<ReaderChange> {
        let mut changes = Vec::new();
        while let Some(status) = self.reader.try_recv_status() {
            match status {
                DataReaderStatus::SubscriptionMatched { current, .. } => {
                    changes.push(ReaderChange::Publishers(current.count()));
                }
                DataReaderStatus::RequestedIncompatibleQos { last_policy_id, .. } => {
                    changes.push(ReaderChange::Incompatible(format!("{last_policy_id:?}")));
                }
                _ => {}
            }
        }
        changes
    }
}
