//! Tests of the assembly: which frames form a frame set, which camera is waited for, and that no
//! queue grows without limit.

use std::time::Instant;

use super::testing::{alone, in_any_order, thread};
use super::*;
use crate::geometry::target::chessboard;
use crate::imaging::frame::FrameSet;
use crate::imaging::timestamp::HostTime;
use crate::pipeline::live_frame::{FrameDetection, NoDetection};

fn seen(ms: i64, waits: bool) -> SeenFrame {
    let host_time = HostTime { utc_ns: ms * 1_000_000 };
    let frame_set =
        FrameSet { sequence: 0, host_time, device_time: None, name: None, frames: Vec::new() };
    let outcome = Err(NoDetection::Unreadable { detail: String::new() });
    SeenFrame {
        frame_set: frame_set.into(),
        arrived: Instant::now(),
        waits,
        detection: FrameDetection { outcome, elapsed_ms: 0.0, tracked: false },
        sensors: Vec::new(),
    }
}

struct Meeting {
    assembly: Assembly,
    messages: mpsc::Receiver<Message>,
}

/// An assembly whose session takes up to 1000 messages.
fn meeting(cameras: usize) -> Meeting {
    let (sender, messages) = mpsc::channel(1000);
    let plan = AssemblyPlan {
        session: "s".to_owned(),
        target: chessboard(9, 6, 0.025).unwrap().into(),
        instrument: "head".to_owned(),
        factories: vec![Arc::default(); cameras],
        admission: AdmissionOptions::default(),
    };
    let metrics = Arc::new(Metrics::new().unwrap());
    Meeting { assembly: Assembly::new(plan, sender, metrics), messages }
}

impl Meeting {
    fn of(cameras: usize, frames: &[(usize, i64)]) -> Self {
        let meeting = meeting(cameras);
        for (place, ms) in frames {
            assert!(meeting.assembly.put(*place, seen(*ms, false)));
        }
        meeting
    }

    /// The times of the frame sets that were passed on, in milliseconds.
    fn times(&mut self) -> Vec<Vec<Option<i64>>> {
        let mut all = Vec::new();
        while let Ok(message) = self.messages.try_recv() {
            if let Message::Seen(frame_set, _) = message {
                let ms = |seen: &SeenFrame| seen.host_time_ns() / 1_000_000;
                all.push(frame_set.frames.iter().map(|seen| seen.as_ref().map(ms)).collect());
            }
        }
        all
    }

    fn waiting(&self) -> Vec<usize> {
        self.assembly.lock().cameras.iter().map(|queue| queue.frames.len()).collect()
    }

    fn counted(&self, complete: &str) -> u64 {
        self.assembly.metrics.frame_sets.with_label_values(&["head", complete]).get()
    }
}

#[test]
fn one_camera_passes_through() {
    alone(|| {
        let mut meeting = Meeting::of(1, &[(0, 0), (0, 33), (0, 66)]);
        assert_eq!(meeting.times(), [[Some(0)], [Some(33)], [Some(66)]]);
        assert_eq!(meeting.waiting(), [0]);
    });
}

#[test]
fn the_nearest_in_time_are_one_frame_set() {
    alone(|| {
        let mut meeting = Meeting::of(2, &[(0, 0), (1, 20), (0, 33), (1, 53), (0, 66), (1, 86)]);
        // 20 is nearer to 33 than to 0; where 66 and 86 belong is open until the next frame
        // arrives.
        assert_eq!(
            meeting.times(),
            [vec![Some(0), None], vec![Some(33), Some(20)], vec![Some(66), Some(53)]]
        );
        assert_eq!(meeting.waiting(), [0, 1]);
        // In whatever order the threads deliver them.
        let mut other = Meeting::of(2, &[(1, 20), (0, 0), (1, 53), (0, 33), (0, 66), (1, 86)]);
        assert_eq!(other.times().len(), 3);
    });
}

#[test]
fn equal_times_wait_for_nobody() {
    alone(|| {
        let mut meeting = Meeting::of(3, &[(0, 0), (1, 0), (2, 0)]);
        assert_eq!(meeting.times(), [[Some(0), Some(0), Some(0)]]);
        assert_eq!(meeting.counted("true"), 1);
    });
}

#[test]
fn a_stalled_camera_holds_nobody_up_and_nothing_piles_up() {
    alone(|| {
        let mut meeting = meeting(2);
        for k in 0..500 {
            assert!(meeting.assembly.put(0, seen(33 * k, false)));
            assert!(meeting.waiting()[0] <= MOST_WAITING_FRAMES, "frame {k}");
        }
        assert_eq!(meeting.times().len(), 500 - MOST_WAITING_FRAMES);
        assert_eq!(meeting.counted("false"), 500 - MOST_WAITING_FRAMES as u64);
        // A camera known to be lost is not waited for.
        meeting.assembly.lost(1, "unplugged");
        assert_eq!((meeting.times().len(), meeting.waiting()[0]), (MOST_WAITING_FRAMES, 0));
        meeting.assembly.put(0, seen(33 * 500, false));
        assert_eq!(meeting.times(), [[Some(33 * 500), None]]);
        meeting.assembly.back(1);
        meeting.assembly.put(0, seen(33 * 501, false));
        assert!(meeting.times().is_empty(), "it is waited for again");
        meeting.assembly.put(1, seen(33 * 501, false));
        assert_eq!(meeting.times(), [[Some(33 * 501), Some(33 * 501)]]);
    });
}

#[test]
fn a_camera_at_a_third_of_the_rate_shares_every_third_frame() {
    alone(|| {
        let mut meeting = meeting(2);
        for k in 0..300 {
            meeting.assembly.put(0, seen(33 * k, false));
            if k % 3 == 0 {
                meeting.assembly.put(1, seen(33 * k, false));
            }
            assert!(meeting.waiting()[0] <= 3, "frame {k}");
        }
        let shared = |times: &Vec<Option<i64>>| times.iter().all(Option::is_some);
        let times = meeting.times();
        assert_eq!(times.iter().filter(|times| shared(times)).count(), 100);
        assert_eq!((meeting.counted("true"), meeting.counted("false")), (100, 198));
        assert!(times.iter().map(|times| times[0]).is_sorted());
    });
}

#[test]
fn a_loss_is_reported_and_the_end_once() {
    alone(|| {
        let mut meeting = Meeting::of(2, &[(0, 0)]);
        meeting.assembly.lost(0, "unplugged");
        meeting.assembly.lost(1, "silent");
        meeting.assembly.waited(1, 1.0);
        meeting.assembly.waited(0, 2.0);
        meeting.assembly.back(0);
        meeting.assembly.back(1);
        meeting.assembly.ended(0, "over");
        meeting.assembly.ended(1, "over too");
        meeting.assembly.ended(1, "again");
        let mut said = Vec::new();
        while let Ok(message) = meeting.messages.try_recv() {
            said.push(match message {
                Message::Seen(..) => "seen".to_owned(),
                Message::CameraLost { place, reason } => format!("{place} {reason}"),
                Message::Waited(seconds) => format!("waited {seconds}"),
                Message::CamerasBack => "back".to_owned(),
                Message::Ended { reason, .. } => reason,
                other => panic!("{other:?}"),
            });
        }
        let expected = ["0 unplugged", "seen", "1 silent", "waited 2", "1 silent", "back", "over"];
        assert_eq!(said, expected);
    });
}

#[test]
fn while_it_is_held_live_frames_are_refused_and_replays_wait() {
    in_any_order(|| {
        let mut meeting = meeting(1);
        meeting.assembly.hold(true);
        assert!(!meeting.assembly.put(0, seen(0, false)));
        thread::scope(|scope| {
            let replay = scope.spawn(|| meeting.assembly.put(0, seen(33, true)));
            meeting.assembly.hold(false);
            assert!(replay.join().unwrap());
        });
        assert_eq!(meeting.times(), [[Some(33)]]);
        meeting.assembly.close();
        meeting.assembly.put(0, seen(66, true));
        assert!(meeting.times().is_empty());
    });
}

#[test]
fn replays_wait_for_each_other() {
    in_any_order(|| {
        let mut meeting = meeting(2);
        thread::scope(|scope| {
            for place in 0..2 {
                let assembly = &meeting.assembly;
                scope.spawn(move || {
                    (0..40).for_each(|k| assert!(assembly.put(place, seen(33 * k, true))));
                });
            }
        });
        let times = meeting.times();
        assert_eq!(times.len(), 40);
        assert!(times.iter().all(|times| times[0].is_some() && times[0] == times[1]));
    });
}

#[test]
fn the_end_comes_once_and_after_every_frame() {
    in_any_order(|| {
        let mut meeting = meeting(2);
        thread::scope(|scope| {
            for place in 0..2 {
                let assembly = &meeting.assembly;
                scope.spawn(move || {
                    (0..3).for_each(|k| assert!(assembly.put(place, seen(33 * k, true))));
                    assembly.ended(place, "over");
                });
            }
        });
        let mut received = Vec::new();
        while let Ok(message) = meeting.messages.try_recv() {
            received.push(matches!(message, Message::Ended { .. }));
        }
        assert_eq!(received, [false, false, false, true]);
    });
}

#[test]
fn closing_lets_a_replay_go_that_waits_for_a_camera() {
    in_any_order(|| {
        let meeting = meeting(2);
        thread::scope(|scope| {
            // Camera 1 delivers nothing: without a time limit, only closing ends the wait.
            let replay = scope.spawn(|| {
                (0..MOST_WAITING_FRAMES as i64 + 2).for_each(|k| {
                    meeting.assembly.put(0, seen(33 * k, true));
                });
            });
            meeting.assembly.close();
            replay.join().unwrap();
        });
        assert_eq!(meeting.waiting(), [0, 0]);
    });
}

#[test]
fn a_lost_camera_that_comes_back_holds_up_no_frame_for_good() {
    in_any_order(|| {
        let mut meeting = meeting(2);
        thread::scope(|scope| {
            let assembly = &meeting.assembly;
            scope.spawn(move || {
                (0..4).for_each(|k| assert!(assembly.put(0, seen(33 * k, false))));
                assembly.ended(0, "over");
            });
            scope.spawn(move || {
                assembly.lost(1, "unplugged");
                assembly.back(1);
                assert!(assembly.put(1, seen(66, false)));
                assembly.ended(1, "over");
            });
        });
        let times = meeting.times();
        let of = |place: usize| times.iter().filter_map(|times| times[place]).collect::<Vec<_>>();
        assert_eq!((of(0), of(1)), (vec![0, 33, 66, 99], vec![66]));
        assert_eq!(meeting.waiting(), [0, 0]);
    });
}
