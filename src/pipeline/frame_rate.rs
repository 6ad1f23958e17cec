//! Frames a second, measured over about the last second.

use std::collections::VecDeque;
use std::time::{Duration, Instant};

const AVERAGED_OVER: Duration = Duration::from_secs(1);

/// The arrival times of the newest frames.
#[derive(Debug, Default)]
pub(super) struct FrameRate {
    arrivals: VecDeque<Instant>,
}

impl FrameRate {
    /// Counts a frame that arrived at `now`. Returns the rate, once there are two frames.
    pub(super) fn count(&mut self, now: Instant) -> Option<f64> {
        self.arrivals.push_back(now);
        // Two are kept even if they are old: a slow camera has a rate too.
        while self.arrivals.len() > 2 && now.duration_since(self.arrivals[0]) > AVERAGED_OVER {
            self.arrivals.pop_front();
        }
        let span_s = now.duration_since(self.arrivals[0]).as_secs_f64();
        (span_s > 0.0).then(|| (self.arrivals.len() - 1) as f64 / span_s)
    }

    pub(super) fn forget(&mut self) {
        self.arrivals.clear();
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn fast_and_slow_cameras_have_a_rate() {
        for fps in [0.2, 30.0, 1000.0] {
            let mut rate = FrameRate::default();
            let start = Instant::now();
            let at = |k: u32| start + Duration::from_secs_f64(f64::from(k) / fps);
            assert_eq!(rate.count(at(0)), None);
            let measured = (1..3000).map(|k| rate.count(at(k)).unwrap()).last().unwrap();
            assert!((measured / fps - 1.0).abs() < 1e-6, "{measured} of {fps}");
            assert!(rate.arrivals.len() <= fps as usize + 3);
        }
    }
}
