//! What a camera's operator should do next: the most informative view, the one next movement
//! towards it, and what prevents reaching the goal.

use crate::calibration::admission::Rejection;
use crate::calibration::guidance::{Guidance, obstacle};
use crate::calibration::information::camera_information::CameraInformation;
use crate::calibration::information::movement::{description, next_movement};
use crate::calibration::information::next_view::SuggestedView;
use crate::geometry::pose::Pose;

/// A requested movement stands for at least this time before another one replaces it, in
/// nanoseconds: the time it takes to hear it and to begin.
const LEAST_ADVICE_NS: i64 = 800_000_000;
/// With fewer views than this, no note says that the goal is out of reach.
const VIEWS_BEFORE_DOUBT: usize = 8;

/// The suggested view, and the last message.
#[derive(Debug, Clone, Default)]
pub(super) struct Advice {
    /// The view to ask for; renewed with each view.
    pub(super) suggested: Option<SuggestedView>,
    said: Option<(String, i64)>,
}

/// What the advice depends on besides the views.
#[derive(Debug, Clone, Copy)]
pub(super) struct Now<'a> {
    pub(super) time_ns: i64,
    /// The board's pose in the newest frame, if it shows the board.
    pub(super) camera_from_board: Option<&'a Pose>,
    /// Why the newest frames were rejected, once that lasts for some frames.
    pub(super) obstacle: Option<&'a Rejection>,
    /// How many views may still be kept.
    pub(super) room: u32,
    pub(super) goal_px: Option<f64>,
    /// The goal is reached, but halves of the views give different results.
    pub(super) halves_disagree: bool,
}

impl Advice {
    /// Asks for another view from now on.
    pub(super) fn renew(&mut self, suggested: Option<SuggestedView>) {
        *self = Self { suggested, said: None };
    }

    /// What to do now.
    pub(super) fn guidance(&mut self, information: &CameraInformation, now: &Now<'_>) -> Guidance {
        let Some(suggested) = self.suggested.clone() else { return Guidance::default() };
        let mut message = self.movement(information, &suggested, now);
        if let Some(note) = note(&suggested, information.views().len(), now) {
            message = format!("{message}; {note}");
        }
        Guidance {
            message: now.obstacle.and_then(obstacle).unwrap_or(message),
            outline_px: suggested.outline_px.to_vec(),
            camera_from_board: Some(suggested.camera_from_board),
            expected_uncertainty_px: suggested.expected_uncertainty_px,
            views_to_go: suggested.views_to_go,
        }
    }

    fn movement(
        &mut self,
        information: &CameraInformation,
        suggested: &SuggestedView,
        now: &Now<'_>,
    ) -> String {
        let since_ns = |at_ns: i64| now.time_ns.saturating_sub(at_ns);
        match &self.said {
            // Without a board in view the last message stands.
            Some((said, at_ns))
                if now.camera_from_board.is_none() || since_ns(*at_ns) < LEAST_ADVICE_NS =>
            {
                return said.clone();
            }
            _ => {}
        }
        let noise = information.corner_noise();
        let (space, there) = (information.space(&noise, &[]), &suggested.camera_from_board);
        let words = match now.camera_from_board {
            Some(here) => next_movement(&space, here, there)
                .unwrap_or_else(|| "hold the board still there".to_owned()),
            None => description(&space, there).unwrap_or_else(|| "show the board".to_owned()),
        };
        if self.said.as_ref().is_none_or(|(said, _)| *said != words) {
            self.said = Some((words.clone(), now.time_ns));
        }
        words
    }
}

/// What else the operator has to know.
fn note(suggested: &SuggestedView, views: usize, now: &Now<'_>) -> Option<String> {
    if now.halves_disagree {
        return Some(
            "the goal is reached, but two halves of the views give different results: check that the board is flat and held still, and that focus and zoom are fixed"
                .to_owned(),
        );
    }
    let ([few, _], goal_px) = (suggested.views_to_go?, now.goal_px?);
    (views >= VIEWS_BEFORE_DOUBT && few > now.room).then(|| {
        // Depth is usually limited by its readings, not by the corners: the advice differs.
        let (what, remedy) = if suggested.is_for_depth {
            (" for depth projected into color", "use a larger board, or set a larger goal (in px)")
        } else {
            ("", "use a larger board, sharper images or more light")
        };
        format!(
            "the goal of {goal_px} px{what} is out of reach (it would take at least {few} more views): {remedy}"
        )
    })
}
