//! How long a source may be silent before it counts as lost.

use std::time::Duration;

/// A source that states no rate is lost when it has been silent for this many times the interval
/// between its last frames. Chosen, not swept.
const FRAMES_MISSED: u32 = 3;

/// A longer interval between frames counts as this one, so that no source is waited for too long.
/// Chosen, not swept.
const LONGEST_INTERVAL: Duration = Duration::from_secs(10);

/// How long a source may be silent, whatever its frame rate.
#[derive(Debug, Clone, Copy)]
pub(super) struct SilenceLimits {
    /// After a frame.
    pub(super) stall: Duration,
    /// Before its first frame since it was opened.
    pub(super) first_frame: Duration,
}

/// How long a source has been silent now, and was before its last frames.
#[derive(Debug, Default)]
pub(super) struct Silence {
    /// Time since the last frame, or since the source was opened.
    now: Duration,
    /// Time since the last frame, even if that came before the source was last opened.
    since_frame: Duration,
    /// Time before each of the last two frames.
    before_frames: [Duration; 2],
    delivered: bool,
}

impl Silence {
    /// The source was opened, for the first time or again.
    pub(super) fn opened(&mut self) {
        (self.now, self.delivered) = (Duration::ZERO, false);
    }

    /// A frame came.
    pub(super) fn ended(&mut self) {
        let [_, last] = self.before_frames;
        *self =
            Self { before_frames: [last, self.since_frame], delivered: true, ..Self::default() };
    }

    /// No frame came for the time `waited`.
    pub(super) fn went_on(&mut self, waited: Duration) {
        self.now += waited;
        self.since_frame += waited;
    }

    /// The time that the source has been silent, if that is longer than `limits` allow and than its
    /// frame rate explains.
    pub(super) fn too_long(&self, limits: SilenceLimits, fps: Option<f64>) -> Option<Duration> {
        let limit = if self.delivered { limits.stall } else { limits.first_frame };
        let five_frames = fps.map(|fps| Duration::from_secs_f64(5.0 / fps.max(1e-3)));
        // The shorter of both, so that a single stall is not taken for the frame interval.
        let pace = self.before_frames[0].min(self.before_frames[1]).min(LONGEST_INTERVAL);
        let limit = limit.max(five_frames.unwrap_or(FRAMES_MISSED * pace));
        (self.now >= limit).then_some(self.now)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const TWO_SECONDS: Duration = Duration::from_secs(2);
    const LIMITS: SilenceLimits =
        SilenceLimits { stall: Duration::from_millis(1500), first_frame: Duration::from_secs(4) };

    fn frame_after(silence: &mut Silence, waited: Duration) {
        silence.went_on(waited);
        silence.ended();
    }

    #[test]
    fn a_slow_topic_is_lost_twice_and_then_waited_for() {
        let mut silence = Silence::default();
        frame_after(&mut silence, Duration::ZERO);
        for _ in 0..2 {
            silence.went_on(TWO_SECONDS);
            assert_eq!(silence.too_long(LIMITS, None), Some(TWO_SECONDS));
            silence.opened();
            silence.ended();
        }
        for _ in 0..5 {
            silence.went_on(TWO_SECONDS);
            assert_eq!(silence.too_long(LIMITS, None), None);
            silence.ended();
        }
        silence.went_on(3 * TWO_SECONDS);
        assert_eq!(silence.too_long(LIMITS, None), Some(3 * TWO_SECONDS));
    }

    #[test]
    fn a_source_that_stalled_once_is_found_to_stall_as_soon_again() {
        let mut silence = Silence::default();
        for waited in [0, 0, 8000, 30, 30] {
            frame_after(&mut silence, Duration::from_millis(waited));
            silence.went_on(TWO_SECONDS);
            assert!(silence.too_long(LIMITS, None).is_some(), "after {waited} ms");
            silence = Silence { now: Duration::ZERO, since_frame: Duration::ZERO, ..silence };
        }
    }

    #[test]
    fn a_stated_rate_is_believed() {
        let mut silence = Silence::default();
        silence.ended();
        silence.went_on(TWO_SECONDS);
        assert_eq!(silence.too_long(LIMITS, Some(30.0)), Some(TWO_SECONDS));
        assert_eq!(silence.too_long(LIMITS, Some(1.0)), None);
    }
}
