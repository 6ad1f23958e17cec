//! What every camera of a session counts, whatever the target: time, and why frames become no
//! views.

use crate::calibration::admission::Rejection;

/// Consecutive frames with the same obstacle before the operator is informed.
const OBSTACLE_FRAMES: u32 = 4;
/// A longer step between two frames is not counted as time, in seconds: the camera was away, or its
/// clock was set.
const LONGEST_STEP_S: f64 = 60.0;

/// Frame time that was spent collecting.
#[derive(Debug, Clone, Default)]
pub(super) struct FrameTime {
    last_ns: Option<i64>,
    elapsed_s: f64,
}

impl FrameTime {
    /// Adds the step since the last frame, if it is plausible.
    pub(super) fn count(&mut self, time_ns: i64) {
        let last_ns = self.last_ns.replace(time_ns);
        let step_s = last_ns.map_or(0.0, |last_ns| time_ns.saturating_sub(last_ns) as f64 * 1e-9);
        if (0.0..LONGEST_STEP_S).contains(&step_s) {
            self.elapsed_s += step_s;
        }
    }

    /// The camera stopped giving frames: the time until the next frame is not counted.
    pub(super) fn lost(&mut self) {
        self.last_ns = None;
    }

    /// The sum, in seconds.
    pub(super) fn elapsed_s(&self) -> f64 {
        self.elapsed_s
    }
}

/// Why the newest consecutive frames were rejected.
#[derive(Debug, Clone, Default)]
pub(super) struct Obstacle(Option<Lasting>);

#[derive(Debug, Clone)]
struct Lasting {
    what: Rejection,
    frames: u32,
    /// Frames since that show no board at all.
    quiet: u32,
}

impl Obstacle {
    /// Takes what became of a frame. A board other than the one asked for is not recognized in
    /// every frame: a few frames without any board in between do not end the obstacle.
    pub(super) fn note(&mut self, admission: &Result<u32, Rejection>) {
        let Err(rejection) = admission else {
            self.0 = None;
            return;
        };
        if let (Some(before), Rejection::NoBoard(now)) = (&mut self.0, rejection)
            && matches!(&before.what, Rejection::NoBoard(named) if named.names_another())
            && !now.names_another()
            && before.quiet + 1 < OBSTACLE_FRAMES
        {
            before.quiet += 1;
            return;
        }
        let of_kind = self.0.as_ref().filter(|before| before.what.kind() == rejection.kind());
        let frames = of_kind.map_or(0, |before| before.frames) + 1;
        self.0 = Some(Lasting { what: rejection.clone(), frames, quiet: 0 });
    }

    /// The obstacle, once it lasts long enough to report.
    pub(super) fn lasting(&self) -> Option<&Rejection> {
        self.0.as_ref().filter(|it| it.frames >= OBSTACLE_FRAMES).map(|it| &it.what)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::detection::board_detection::NoBoard;
    use crate::detection::coded::no_target::NoTarget;

    #[test]
    fn another_board_is_named_though_some_frames_show_none() {
        let other = || {
            let (seen, target) = ("6x6 AprilGrid".to_owned(), "6x5 ChArUco board".to_owned());
            Err(Rejection::NoBoard(NoBoard::Target(NoTarget::Recognized { seen, target })))
        };
        let none = || Err(Rejection::NoBoard(NoBoard::NoCorners));
        let mut obstacle = Obstacle::default();
        let named = |obstacle: &Obstacle| obstacle.lasting().map(Rejection::kind);
        for frame in 0..6 {
            obstacle.note(&if frame % 3 == 2 { none() } else { other() });
        }
        assert_eq!(named(&obstacle), Some("other_board"));
        (0..3).for_each(|_| obstacle.note(&none()));
        assert_eq!(named(&obstacle), None, "it is not in view any more");
        obstacle.note(&Ok(3));
        assert_eq!(named(&obstacle), None);
    }
}
