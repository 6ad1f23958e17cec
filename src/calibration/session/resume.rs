//! Sessions that resume from what was stored.

use crate::calibration::admission::AdmissionOptions;
use crate::calibration::scene::correspondence::SceneImage;
use crate::calibration::session::{Action, DepthFrame, KeptView, Session};
use crate::calibration::session_record::{SessionRecord, SessionState};
use crate::calibration::view::{FrameFacts, View};

impl Session {
    /// A stored session with its views in order. Views of a camera that is no longer in the rig are
    /// left out. One that was collecting goes on collecting, one that was solving solves again.
    pub fn resume(
        record: SessionRecord,
        cameras: &[String],
        views: &[(KeptView, View)],
        options: &AdmissionOptions,
    ) -> (Self, Vec<Action>) {
        Self::resume_with_depth(record, cameras, views, |_| None, options)
    }

    /// As [`Session::resume`], with the depth image of each view that has one.
    pub fn resume_with_depth(
        record: SessionRecord,
        cameras: &[String],
        views: &[(KeptView, View)],
        depth: impl Fn(&KeptView) -> Option<DepthFrame>,
        options: &AdmissionOptions,
    ) -> (Self, Vec<Action>) {
        let mut session = Self::begin(record, cameras, options);
        session.record.reason = None;
        for (kept, view) in views {
            session.next_number = session.next_number.max(kept.number + 1);
            let Some(camera) = session.cameras.get_mut(kept.camera) else { continue };
            if let Some(own) = camera.restore(view, depth(kept).as_ref()) {
                session.frame_sets = session.frame_sets.max(kept.frame_set + 1);
                session.kept.retain(|old| (old.camera, old.view) != (kept.camera, own));
                session.kept.push(KeptView { view: own, ..*kept });
            }
        }
        let actions = session.resumed();
        (session, actions)
    }

    /// As [`Session::resume`], of a session without a board: its key frames in order, each with the
    /// number of its view.
    pub fn resume_scene(
        record: SessionRecord,
        key_frames: &[(KeptView, FrameFacts, SceneImage)],
        options: &AdmissionOptions,
    ) -> (Self, Vec<Action>) {
        let mut session = Self::begin(record, &[], options);
        session.record.reason = None;
        for (kept, frame, image) in key_frames {
            session.next_number = session.next_number.max(kept.number + 1);
            session.frame_sets = session.frame_sets.max(kept.frame_set + 1);
            let camera = session.cameras.first_mut();
            if let Some(view) = camera.and_then(|part| part.restore_key_frame(frame, image)) {
                session.kept.push(KeptView { camera: 0, view, ..*kept });
            }
        }
        let actions = session.resumed();
        (session, actions)
    }

    /// A stored session, given up for `reason`: the record stays as it was, except for its end.
    /// `now_ns` is UTC since the Unix epoch.
    pub fn give_up(record: SessionRecord, reason: &str, now_ns: i64) -> (Self, Vec<Action>) {
        let mut session = Self::begin(record.clone(), &[], &AdmissionOptions::default());
        session.record = record;
        let actions = session.record.give_up(reason, now_ns);
        (session, actions)
    }

    /// The first actions, after its views were restored.
    fn resumed(&mut self) -> Vec<Action> {
        self.pair_up();
        self.renew(self.is_rig());
        let mut actions = vec![Action::Announce];
        match self.record.state {
            SessionState::Solving => actions.push(Action::Solve),
            SessionState::Collecting => actions.extend(self.request_estimates(|_| true)),
            _ => {}
        }
        actions
    }
}
