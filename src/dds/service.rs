//! Services: a request topic and a reply topic.
//!
//! ROS 2's middlewares name the request that a reply belongs to in two ways. Cyclone's puts 16
//! bytes before the content, the client's identity and its count, which come back as they are; Fast
//! DDS's names the request's sample in the reply's inline QoS (OMG DDS-RPC, "enhanced"). Which one
//! the other side speaks is in the first two bytes of its identity: DDS's number of the vendor.

use std::collections::VecDeque;
use std::sync::Mutex;
use std::task::Waker;
use std::time::{Duration, Instant};

use rustdds::{RTPSEntity, SampleIdentity, WriteOptionsBuilder};

use crate::dds::DdsError;
use crate::dds::participant::Participant;
use crate::dds::raw::HEAD;
use crate::dds::reader::{ReaderChange, Received, TopicReader};
use crate::dds::writer::{Durability, PREFIX, TopicWriter};
use crate::locks::lock;

/// Eclipse Cyclone DDS, in the DDS foundation's list of vendors.
const CYCLONE: [u8; 2] = [0x01, 0x10];
/// What Cyclone's middleware puts before the content.
const CYCLONE_HEADER: usize = 16;
/// How long a request waits for its client to be found by the topic of replies. DDS finds the two
/// topics one after the other, and a reply that is sent before is lost: ROS 2's own middlewares
/// wait too.
const DISCOVERY: Duration = Duration::from_secs(1);
/// How many requests may wait so; later ones stay in the reader, which keeps the newest.
const MOST_HELD: usize = 64;

/// A request that came in.
#[derive(Debug, Clone, PartialEq)]
pub struct Request {
    /// Its content, the four bytes that state the encoding in front.
    pub bytes: Vec<u8>,
    /// What a reply to a Cyclone client begins with.
    header: Option<[u8; CYCLONE_HEADER]>,
    identity: SampleIdentity,
}

/// An answer that came in.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Reply {
    /// Its content, the four bytes that state the encoding in front.
    pub bytes: Vec<u8>,
}

/// Answers the requests to a service.
#[derive(Debug)]
pub struct ServiceServer {
    requests: TopicReader,
    replies: TopicWriter,
    held: Mutex<VecDeque<HeldRequest>>,
}

/// A request whose client may not be reached yet.
#[derive(Debug)]
struct HeldRequest {
    request: Request,
    /// The participant that the client is of.
    client: [u8; PREFIX],
    since: Instant,
}

impl ServiceServer {
    /// Offers the service `name` of the type `type_name`, as in `std_srvs/srv/Trigger`.
    ///
    /// # Errors
    /// [`DdsError::Topic`].
    pub fn offer(participant: &Participant, name: &str, type_name: &str) -> Result<Self, DdsError> {
        let qos = Durability::Volatile.qos();
        let [request, reply] = names(name, type_name);
        let requests = participant.reader(name, request, &qos)?;
        let replies = participant.writer(name, reply, &qos)?;
        Ok(Self { requests, replies, held: Mutex::default() })
    }

    /// Wakes `waker` once when a request comes; one that is held is not reported again.
    pub fn wake(&self, waker: &Waker) {
        self.requests.wake(waker);
    }

    /// The next request that has come and whose client can be reached, or after a second whose
    /// client cannot. `now` is the time of the call.
    pub fn take(&self, now: Instant) -> Option<Request> {
        let mut held = lock(&self.held);
        while held.len() < MOST_HELD
            && let Some(sample) = self.requests.take()
        {
            let Some(client) = sample.writer.first_chunk().copied() else { continue };
            held.extend(request_of(sample).map(|request| HeldRequest {
                request,
                client,
                since: now,
            }));
        }
        let may_go = |held: &HeldRequest| {
            self.replies.has_reader_of(held.client) || now.duration_since(held.since) > DISCOVERY
        };
        let next = held.iter().position(may_go)?;
        held.remove(next).map(|held| held.request)
    }

    /// Answers `request` with a message.
    ///
    /// # Errors
    /// [`DdsError::Send`].
    pub fn reply(&self, request: &Request, message: Vec<u8>) -> Result<(), DdsError> {
        let options = WriteOptionsBuilder::new().related_sample_identity(request.identity).build();
        let message = match request.header {
            Some(header) => with_header(&message, header),
            None => message,
        };
        self.replies.send_with(message, options).map(|_| ())
    }
}

/// Asks a service.
#[derive(Debug)]
pub struct ServiceClient {
    name: String,
    requests: TopicWriter,
    replies: TopicReader,
    sent: Option<Sent>,
    count: i64,
    /// How many answer, as the topic of replies has found them.
    servers: i32,
}

/// The request that is to be answered.
#[derive(Debug)]
enum Sent {
    Cyclone([u8; CYCLONE_HEADER]),
    Enhanced(SampleIdentity),
}

impl ServiceClient {
    /// A client of the service `name` of the type `type_name`; nobody need be there yet.
    ///
    /// # Errors
    /// [`DdsError::Topic`].
    pub fn new(participant: &Participant, name: &str, type_name: &str) -> Result<Self, DdsError> {
        let qos = Durability::Volatile.qos();
        let [request, reply] = names(name, type_name);
        let replies = participant.reader(name, reply, &qos)?;
        let requests = participant.writer(name, request, &qos)?;
        Ok(Self { name: name.to_owned(), requests, replies, sent: None, count: 0, servers: 0 })
    }

    /// Wakes `waker` once when a reply comes.
    pub fn wake(&self, waker: &Waker) {
        self.replies.wake(waker);
    }

    /// Whether somebody is known to answer, and has been found by both topics.
    pub fn is_answered(&mut self, participant: &Participant) -> bool {
        for change in self.replies.changes() {
            if let ReaderChange::Publishers(count) = change {
                self.servers = count;
            }
        }
        participant.server_of(&self.name).is_some()
            && self.requests.readers() > 0
            && self.servers > 0
    }

    /// Sends a request; the reply to an earlier one is no longer waited for.
    ///
    /// # Errors
    /// [`DdsError::Send`].
    pub fn send(&mut self, participant: &Participant, message: Vec<u8>) -> Result<(), DdsError> {
        self.count += 1;
        let is_cyclone = participant.server_of(&self.name) == Some(CYCLONE);
        let options = WriteOptionsBuilder::new().build();
        self.sent = Some(if is_cyclone {
            let guid = self.requests.writer.guid().to_bytes();
            let mut header = [0; CYCLONE_HEADER];
            header[..8].copy_from_slice(&guid[8..]);
            header[8..].copy_from_slice(&self.count.to_le_bytes());
            self.requests.send_with(with_header(&message, header), options)?;
            Sent::Cyclone(header)
        } else {
            Sent::Enhanced(self.requests.send_with(message, options)?)
        });
        Ok(())
    }

    /// The reply to the last request, if it has come.
    pub fn take(&mut self) -> Option<Reply> {
        while let Some(sample) = self.replies.take() {
            match &self.sent {
                Some(Sent::Cyclone(sent)) => {
                    let Some((header, bytes)) = without_header(sample.bytes) else { continue };
                    if header == Some(*sent) {
                        self.sent = None;
                        return Some(Reply { bytes });
                    }
                }
                Some(Sent::Enhanced(sent)) if sample.replies_to == Some(*sent) => {
                    self.sent = None;
                    return Some(Reply { bytes: sample.bytes });
                }
                _ => {}
            }
        }
        None
    }
}

/// What a sample asks; `None` for one that is too short.
fn request_of(sample: Received) -> Option<Request> {
    let identity = sample.replies_to.unwrap_or(sample.identity);
    // Fast DDS names its own reader and leaves the number out.
    let identity = match i64::from(identity.sequence_number) > 0 {
        true => identity,
        false => SampleIdentity { sequence_number: sample.identity.sequence_number, ..identity },
    };
    let is_cyclone = sample.writer[..2] == CYCLONE;
    let (header, bytes) =
        if is_cyclone { without_header(sample.bytes)? } else { (None, sample.bytes) };
    Some(Request { bytes, header, identity })
}

/// DDS's names of the two topics and their types.
fn names(name: &str, type_name: &str) -> [(String, String); 2] {
    let (package, service) = type_name.rsplit_once('/').unwrap_or(("", type_name));
    let package = package.replace('/', "::");
    let of = |kind: &str| format!("{package}::dds_::{service}_{kind}_");
    [(format!("rq{name}Request"), of("Request")), (format!("rr{name}Reply"), of("Response"))]
}

/// The header that Cyclone's middleware puts before the content, and the message without it.
fn without_header(message: Vec<u8>) -> Option<(Option<[u8; CYCLONE_HEADER]>, Vec<u8>)> {
    let header: [u8; CYCLONE_HEADER] = message.get(HEAD..HEAD + CYCLONE_HEADER)?.try_into().ok()?;
    let mut bytes = message;
    bytes.drain(HEAD..HEAD + CYCLONE_HEADER);
    Some((Some(header), bytes))
}

fn with_header(message: &[u8], header: [u8; CYCLONE_HEADER]) -> Vec<u8> {
    let (head, content) = message.split_at(HEAD.min(message.len()));
    [head, &header, content].concat()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_service_has_two_topics() {
        let [request, reply] = names("/front/set_camera_info", "sensor_msgs/srv/SetCameraInfo");
        assert_eq!(request.0, "rq/front/set_camera_infoRequest");
        assert_eq!(request.1, "sensor_msgs::srv::dds_::SetCameraInfo_Request_");
        assert_eq!(reply.0, "rr/front/set_camera_infoReply");
        assert_eq!(reply.1, "sensor_msgs::srv::dds_::SetCameraInfo_Response_");
    }

    #[test]
    fn cyclone_s_header_goes_in_and_comes_out() {
        let header = std::array::from_fn(|k| k as u8);
        let message = with_header(&[0, 1, 0, 0, 9, 9], header);
        assert_eq!(without_header(message), Some((Some(header), vec![0, 1, 0, 0, 9, 9])));
        assert_eq!(without_header(vec![0; 19]), None);
    }
}
