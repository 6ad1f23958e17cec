//! What one camera of a session counts, whatever its target is: time, and what keeps frames from
//! becoming views.

use crate::calibration::admission::Rejection;

/// Consecutive frames with the same obstacle before the operator is informed.
const OBSTACLE_FRAMES: u32 = 4;
/// Frames further from each other than this are no plausible step of time, in seconds: a camera was
/// away, or its clock was set.
const LONGEST_STEP_S: f64 = 60.0;

/// Frame time that was spent collecting.
#[derive(Debug, Clone, Default)]
pub(super) struct FrameTime {
    last_ns: Option<i64>,
    elapsed_s: f64,
}

impl FrameTime {
    /// Goes on counting as long as time rises in plausible steps.
    pub(super) fn count(&mut self, time_ns: i64) {
        let last_ns = self.last_ns.replace(time_ns);
        let step_s = last_ns.map_or(0.0, |last_ns| time_ns.saturating_sub(last_ns) as f64 * 1e-9);
        if (0.0..LONGEST_STEP_S).contains(&step_s) {
            self.elapsed_s += step_s;
        }
    }

    /// The camera gives no frames: what comes next is not counted from what came before.
    pub(super) fn lost(&mut self) {
        self.last_ns = None;
    }

    /// The sum, in seconds.
    pub(super) fn elapsed_s(&self) -> f64 {
        self.elapsed_s
    }
}

/// What the newest frames in a row were rejected for.
#[derive(Debug, Clone, Default)]
pub(super) struct Obstacle(Option<(Rejection, u32)>);

impl Obstacle {
    /// Takes what became of a frame.
    pub(super) fn note(&mut self, admission: &Result<u32, Rejection>) {
        self.0 = admission.as_ref().err().map(|rejection| match &self.0 {
            Some((before, frames)) if before.kind() == rejection.kind() => {
                (rejection.clone(), frames + 1)
            }
            _ => (rejection.clone(), 1),
        });
    }

    /// One that lasts and is not a flicker.
    pub(super) fn lasting(&self) -> Option<&Rejection> {
        self.0.as_ref().filter(|(_, frames)| *frames >= OBSTACLE_FRAMES).map(|(what, _)| what)
    }
}
