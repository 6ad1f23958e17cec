//! One participant a domain, whoever uses it.

use std::net::Ipv4Addr;
use std::sync::atomic::AtomicI32;
use std::sync::{Arc, Mutex, Weak};

use rustdds::policy::{Durability as DdsDurability, History, Ownership, Reliability};
use rustdds::{
    DomainParticipant, DomainParticipantBuilder, Publisher, QosPolicies, QosPolicyBuilder,
    Subscriber, Topic, TopicKind,
};

use crate::dds::DdsError;
use crate::dds::domain::Domain;
use crate::dds::names::{dds_topic, dds_type, ros_topic, ros_type};
use crate::dds::reader::TopicReader;
use crate::dds::writer::{Durability, TopicWriter};
use crate::locks::lock;

/// What somebody publishes.
#[derive(Debug, Clone, PartialEq)]
pub struct PublishedTopic {
    /// Its ROS name.
    pub name: String,
    /// Its type, as in `sensor_msgs/msg/Image`.
    pub type_name: String,
    /// The publisher's identity.
    pub writer: [u8; 16],
    reliability: Reliability,
    ownership: Ownership,
}

impl PublishedTopic {
    /// Whether the publisher sends again what got lost.
    pub fn is_reliable(&self) -> bool {
        matches!(self.reliability, Reliability::Reliable { .. })
    }
}

/// A member of a domain.
pub struct Participant {
    domain: Domain,
    participant: DomainParticipant,
    publisher: Publisher,
    subscriber: Subscriber,
}

impl std::fmt::Debug for Participant {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Participant").field("domain", &self.domain).finish_non_exhaustive()
    }
}

/// The domains that this program is in.
static JOINED: Mutex<Vec<(Domain, Weak<Participant>)>> = Mutex::new(Vec::new());

impl Participant {
    /// Joins the domain; all who join the same one share a participant, which leaves with the
    /// last of them.
    ///
    /// # Errors
    /// [`DdsError::Join`].
    pub fn join(domain: Domain) -> Result<Arc<Self>, DdsError> {
        let mut joined = lock(&JOINED);
        joined.retain(|(_, participant)| participant.strong_count() > 0);
        let known = joined.iter().find(|(other, _)| *other == domain);
        if let Some(participant) = known.and_then(|(_, participant)| participant.upgrade()) {
            return Ok(participant);
        }
        let participant = Arc::new(Self::new(domain)?);
        joined.push((domain, Arc::downgrade(&participant)));
        Ok(participant)
    }

    fn new(domain: Domain) -> Result<Self, DdsError> {
        let failed = |error: rustdds::dds::CreateError| DdsError::Join {
            domain_id: domain.id,
            detail: error.to_string(),
        };
        let builder = DomainParticipantBuilder::new(domain.id);
        let builder = match domain.is_local {
            true => builder.with_only_networks([Ipv4Addr::LOCALHOST]),
            false => builder,
        };
        let participant = builder.build().map_err(failed)?;
        let qos = QosPolicyBuilder::new().build();
        let publisher = participant.create_publisher(&qos).map_err(failed)?;
        let subscriber = participant.create_subscriber(&qos).map_err(failed)?;
        Ok(Self { domain, participant, publisher, subscriber })
    }

    /// Which domain it is in.
    pub fn domain(&self) -> Domain {
        self.domain
    }

    /// What others publish on the topic `name`: one entry a publisher.
    pub fn publishers_of(&self, name: &str) -> Vec<PublishedTopic> {
        self.published().into_iter().filter(|topic| topic.name == name).collect()
    }

    /// What others publish on ROS topics: one entry a publisher.
    pub fn published(&self) -> Vec<PublishedTopic> {
        let writers = self.participant.discovered_writers().into_iter();
        let ros = writers.filter_map(|writer| {
            let data = writer.publication_topic_data;
            Some(PublishedTopic {
                name: ros_topic(&data.topic_name)?,
                type_name: ros_type(&data.type_name),
                writer: data.key.to_bytes(),
                // DDS's own defaults of a writer.
                reliability: data.reliability.unwrap_or(Reliability::BestEffort),
                ownership: data.ownership.unwrap_or(Ownership::Shared),
            })
        });
        ros.collect()
    }

    /// The vendor of who answers the service `name`; `None` while nobody does.
    pub(super) fn server_of(&self, name: &str) -> Option<[u8; 2]> {
        let reader = format!("rq{name}Request");
        let readers = self.participant.discovered_readers().into_iter();
        let data = readers.map(|reader| reader.subscription_topic_data);
        let server = data.into_iter().find(|data| *data.topic_name() == reader)?;
        let guid = server.key().to_bytes();
        Some([guid[0], guid[1]])
    }

    /// Reads what `offered` publishes, with its reliability and ownership; the last `depth` samples
    /// wait to be taken.
    ///
    /// # Errors
    /// [`DdsError::Topic`].
    pub fn subscribe(&self, offered: &PublishedTopic, depth: i32) -> Result<TopicReader, DdsError> {
        let qos = QosPolicyBuilder::new()
            .reliability(offered.reliability)
            .durability(DdsDurability::Volatile)
            .ownership(offered.ownership)
            .history(History::KeepLast { depth })
            .build();
        let names = (dds_topic(&offered.name), dds_type(&offered.type_name));
        self.reader(&offered.name, names, &qos)
    }

    /// Publishes on the topic `name`; with [`Durability::Latched`] who comes late gets the last
    /// message too.
    ///
    /// # Errors
    /// [`DdsError::Topic`].
    pub fn advertise(
        &self,
        name: &str,
        type_name: &str,
        durability: Durability,
    ) -> Result<TopicWriter, DdsError> {
        let qos = durability.qos();
        self.writer(name, (dds_topic(name), dds_type(type_name)), &qos)
    }

    pub(super) fn reader(
        &self,
        name: &str,
        dds_names: (String, String),
        qos: &QosPolicies,
    ) -> Result<TopicReader, DdsError> {
        let topic = self.topic(name, dds_names, qos)?;
        let reader = self.subscriber.create_simple_datareader_no_key(&topic, Some(qos.clone()));
        let reader = reader.map_err(|error| refused(name, &error))?;
        Ok(TopicReader { reader })
    }

    pub(super) fn writer(
        &self,
        name: &str,
        dds_names: (String, String),
        qos: &QosPolicies,
    ) -> Result<TopicWriter, DdsError> {
        let topic = self.topic(name, dds_names, qos)?;
        let writer = self.publisher.create_datawriter_no_key(&topic, Some(qos.clone()));
        let writer = writer.map_err(|error| refused(name, &error))?;
        Ok(TopicWriter {
            name: name.to_owned(),
            writer,
            readers: AtomicI32::new(0),
            reached: Mutex::default(),
        })
    }

    fn topic(
        &self,
        name: &str,
        (dds_name, dds_type): (String, String),
        qos: &QosPolicies,
    ) -> Result<Topic, DdsError> {
        let topic = self.participant.create_topic(dds_name, dds_type, qos, TopicKind::NoKey);
        topic.map_err(|error| refused(name, &error))
    }
}

fn refused(topic: &str, error: &rustdds::dds::CreateError) -> DdsError {
    DdsError::Topic { topic: topic.to_owned(), detail: error.to_string() }
}
