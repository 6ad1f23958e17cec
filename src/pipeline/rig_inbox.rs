//! Where the cameras of a rig meet: pictures taken at about the same time are put together, and the
//! rig's thread takes them one moment after the other, between the requests that it gets.
//!
//! A live camera never waits here: one that gives nothing for a while is gone on without. Replays
//! that must not skip wait for each other, so that they come out the same every time.

use std::collections::VecDeque;
use std::sync::{Condvar, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

use tokio::sync::oneshot;

use crate::calibration::result::Calibration;
use crate::calibration::session_record::{SessionRecord, SessionRequest};
use crate::pipeline::live_camera::LiveCamera;
use crate::pipeline::live_frame::Look;
use crate::pipeline::message::CapturedFrame;
use crate::pipeline::session_request::{EndError, StartError};
use std::sync::Arc;

/// What a rig's thread is asked.
#[derive(Debug)]
pub(super) enum RigMessage {
    /// Begin a session with these cameras, in the rig's order.
    Start(SessionRequest, Vec<Arc<LiveCamera>>, oneshot::Sender<Result<SessionRecord, StartError>>),
    /// Go on with the session that an earlier run left.
    Resume(Box<SessionRecord>, Vec<Arc<LiveCamera>>),
    /// Solve what has been gathered; answered once solving has begun.
    Stop(String, oneshot::Sender<Result<SessionRecord, EndError>>),
    /// Give it up.
    Abort(String, oneshot::Sender<Result<SessionRecord, EndError>>),
    /// A session's solve.
    Solved { session: String, solved: Result<Box<Calibration>, String> },
}

/// A frame of one camera that was searched.
#[derive(Debug)]
pub(super) struct Looked {
    pub(super) captured: CapturedFrame,
    pub(super) look: Look,
}

/// What the rig's thread does next.
#[derive(Debug)]
pub(super) enum Next {
    /// Someone asks.
    Message(RigMessage),
    /// What each camera gave at one moment, in the rig's order.
    Moment(Vec<Option<Looked>>),
    /// No camera gives any more, for this reason.
    Ended(String),
    /// The daemon goes down.
    Closed,
}

/// Frames of one camera that may lie here; with more, the others are not waited for.
const LIMIT: usize = 16;
/// Pictures further apart in time are not of one moment, in nanoseconds.
const TOGETHER_NS: i64 = 40_000_000;
/// How long a replay waits for another camera.
const PATIENCE: Duration = Duration::from_secs(5);

#[derive(Debug, Default)]
pub(super) struct RigInbox {
    state: Mutex<State>,
    changed: Condvar,
}

#[derive(Debug, Default)]
struct State {
    messages: VecDeque<RigMessage>,
    /// The session that frames are for.
    session: Option<String>,
    queues: Vec<Queue>,
    closed: bool,
}

#[derive(Debug, Default)]
struct Queue {
    frames: VecDeque<Looked>,
    /// Why there will be no more.
    ended: Option<String>,
}

impl RigInbox {
    /// Takes frames of `cameras` cameras for a session from now on; `None` takes no more.
    pub(super) fn collect_for(&self, session: Option<(&str, usize)>) {
        let mut state = self.lock();
        state.session = session.map(|(id, _)| id.to_owned());
        state.queues.clear();
        state.queues.resize_with(session.map_or(0, |(_, cameras)| cameras), Queue::default);
        self.changed.notify_all();
    }

    /// Asks the rig's thread; whether it is still there.
    pub(super) fn ask(&self, message: RigMessage) -> bool {
        let mut state = self.lock();
        if state.closed {
            return false;
        }
        state.messages.push_back(message);
        self.changed.notify_all();
        true
    }

    /// Hands over what the camera at place `member` gave. A frame whose source waits for it waits
    /// for room.
    pub(super) fn put(&self, session: &str, member: usize, looked: Looked) {
        let mut state = self.lock();
        if looked.captured.waits {
            let full = |state: &mut State| {
                state.queue(session, member).is_some_and(|queue| queue.frames.len() >= LIMIT)
            };
            (state, _) = self
                .changed
                .wait_timeout_while(state, PATIENCE, full)
                .unwrap_or_else(PoisonError::into_inner);
        }
        if let Some(queue) = state.queue(session, member) {
            queue.frames.push_back(looked);
            self.changed.notify_all();
        }
    }

    /// The camera at place `member` has given its last frame.
    pub(super) fn end(&self, session: &str, member: usize, reason: &str) {
        if let Some(queue) = self.lock().queue(session, member) {
            queue.ended = Some(reason.to_owned());
            self.changed.notify_all();
        }
    }

    /// What to do next; waits for it.
    pub(super) fn next(&self) -> Next {
        let mut state = self.lock();
        loop {
            if state.closed {
                return Next::Closed;
            }
            if let Some(message) = state.messages.pop_front() {
                return Next::Message(message);
            }
            if let Some(moment) = state.take_moment() {
                self.changed.notify_all();
                return Next::Moment(moment);
            }
            if let Some(reason) = state.take_end() {
                return Next::Ended(reason);
            }
            state = self.changed.wait(state).unwrap_or_else(PoisonError::into_inner);
        }
    }

    /// Lets everyone go who waits.
    pub(super) fn close(&self) {
        self.lock().closed = true;
        self.changed.notify_all();
    }

    fn lock(&self) -> MutexGuard<'_, State> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl State {
    fn queue(&mut self, session: &str, member: usize) -> Option<&mut Queue> {
        let wanted = !self.closed && self.session.as_deref() == Some(session);
        self.queues.get_mut(member).filter(|_| wanted)
    }

    /// The oldest frame of all, and of each other camera the frame that was taken with it.
    fn take_moment(&mut self) -> Option<Vec<Option<Looked>>> {
        let complete =
            self.queues.iter().all(|queue| !queue.frames.is_empty() || queue.ended.is_some());
        if !complete && self.queues.iter().all(|queue| queue.frames.len() <= LIMIT) {
            return None;
        }
        let first_ns = |queue: &Queue| queue.frames.front().map(time_ns);
        let (oldest, start_ns) = self
            .queues
            .iter()
            .enumerate()
            .filter_map(|(k, q)| Some((k, first_ns(q)?)))
            .min_by_key(|(_, ns)| *ns)?;
        let following_ns = self.queues[oldest].frames.get(1).map(time_ns);
        let belongs = |ns: i64| {
            let nearer =
                following_ns.is_none_or(|following_ns| ns - start_ns <= (following_ns - ns).abs());
            ns - start_ns <= TOGETHER_NS && nearer
        };
        let take = |queue: &mut Queue| match first_ns(queue) {
            Some(ns) if belongs(ns) => queue.frames.pop_front(),
            _ => None,
        };
        Some(self.queues.iter_mut().map(take).collect())
    }

    /// Why all cameras have ended, once.
    fn take_end(&mut self) -> Option<String> {
        if self.queues.is_empty()
            || self.queues.iter().any(|queue| queue.ended.is_none() || !queue.frames.is_empty())
        {
            return None;
        }
        let reason = self.queues.first_mut().and_then(|queue| queue.ended.take());
        self.queues.clear();
        reason
    }
}

fn time_ns(looked: &Looked) -> i64 {
    looked.captured.frame_set.host_time.utc_ns
}

/// A camera's place at a rig's session.
#[derive(Debug, Clone)]
pub(super) struct RigSeat {
    pub(super) inbox: Arc<RigInbox>,
    /// Its place in the rig.
    pub(super) member: usize,
}

impl PartialEq for RigSeat {
    fn eq(&self, other: &Self) -> bool {
        Arc::ptr_eq(&self.inbox, &other.inbox) && self.member == other.member
    }
}

impl Eq for RigSeat {}

#[cfg(test)]
mod tests {
    use std::time::Instant;

    use super::*;
    use crate::imaging::frame::FrameSet;
    use crate::imaging::timestamp::HostTime;
    use crate::pipeline::live_frame::LookError;

    fn looked(ms: i64, waits: bool) -> Looked {
        let host_time = HostTime { utc_ns: ms * 1_000_000 };
        let frame_set =
            FrameSet { sequence: 0, host_time, device_time: None, name: None, frames: Vec::new() };
        let look = Look::of(Err(LookError::Unreadable { detail: String::new() }), 0.0);
        let captured = CapturedFrame {
            frame_set: frame_set.into(),
            search: None,
            arrived: Instant::now(),
            waits,
        };
        Looked { captured, look }
    }

    /// The times of the moments that can be taken now, in milliseconds.
    fn moments(inbox: &RigInbox) -> Vec<Vec<Option<i64>>> {
        let mut state = inbox.lock();
        let times = |moment: Vec<Option<Looked>>| {
            moment
                .iter()
                .map(|looked| looked.as_ref().map(|looked| time_ns(looked) / 1_000_000))
                .collect()
        };
        std::iter::from_fn(|| state.take_moment()).map(times).collect()
    }

    fn inbox(cameras: usize, frames: &[(usize, i64)]) -> RigInbox {
        let inbox = RigInbox::default();
        inbox.collect_for(Some(("s", cameras)));
        frames.iter().for_each(|(member, ms)| inbox.put("s", *member, looked(*ms, false)));
        inbox
    }

    #[test]
    fn the_nearest_in_time_are_one_moment() {
        let inbox = inbox(2, &[(0, 0), (0, 33), (0, 66), (1, 20), (1, 53), (1, 86)]);
        // 20 is nearer to 33 than to 0.
        assert_eq!(
            moments(&inbox),
            [
                vec![Some(0), None],
                vec![Some(20), Some(33)].into_iter().rev().collect(),
                vec![Some(66), Some(53)]
            ]
        );
    }

    #[test]
    fn a_camera_that_gives_nothing_holds_nobody_up() {
        let frames: Vec<(usize, i64)> = (0..=LIMIT as i64).map(|k| (0, 33 * k)).collect();
        let inbox = inbox(2, &frames);
        assert_eq!(moments(&inbox).len(), 1, "one is over the limit");
        inbox.end("s", 1, "gone");
        assert_eq!(moments(&inbox).len(), LIMIT);
    }

    #[test]
    fn what_is_of_another_session_is_dropped_and_the_end_is_told_once() {
        let inbox = inbox(1, &[]);
        inbox.put("other", 0, looked(0, true));
        assert!(moments(&inbox).is_empty());
        inbox.end("s", 0, "over");
        assert_eq!(inbox.lock().take_end().as_deref(), Some("over"));
        assert_eq!(inbox.lock().take_end(), None);
    }

    #[test]
    fn replays_wait_for_each_other() {
        let inbox = Arc::new(inbox(2, &[]));
        let filler = Arc::clone(&inbox);
        let filling = std::thread::spawn(move || {
            (0..40).for_each(|k| filler.put("s", 0, looked(33 * k, true)));
        });
        for k in 0..40 {
            inbox.put("s", 1, looked(33 * k, true));
            let Next::Moment(moment) = inbox.next() else { panic!("no moment") };
            assert!(moment.iter().all(Option::is_some), "moment {k}");
        }
        filling.join().unwrap();
    }
}
