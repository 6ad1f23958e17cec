//! The errors of requests for a camera's session.

use crate::calibration::session_record::SessionState;

/// Why no session was started.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum StartError {
    /// No such camera is configured.
    #[error("there is no camera `{camera}`; see GET /v1/cameras for those there are")]
    UnknownCamera {
        /// The name that was asked for.
        camera: String,
    },
    /// No such rig is configured.
    #[error("there is no rig `{rig}`; see GET /v1/rigs for those there are")]
    UnknownRig {
        /// The name that was asked for.
        rig: String,
    },
    /// A camera has one session at a time.
    #[error("`{camera}` is in session {session} already; stop or abort that one first")]
    Busy {
        /// The camera's or the rig's name.
        camera: String,
        /// The session that runs.
        session: String,
    },
    /// The session could not be stored, so it was not started.
    #[error("the session could not be stored: {detail}")]
    Store {
        /// What the store said.
        detail: String,
    },
    /// The daemon is stopping.
    #[error("the daemon is stopping; start the session again when it is back")]
    Stopping,
}

/// Why a session was not stopped or aborted.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum EndError {
    /// No such session.
    #[error("there is no session `{id}`; see GET /v1/sessions for those there are")]
    UnknownSession {
        /// The id that was asked for.
        id: String,
    },
    /// It has ended.
    #[error("session {id} is {} already", state.name())]
    Over {
        /// The session's id.
        id: String,
        /// How it ended.
        state: SessionState,
    },
    /// No request is possible, because its camera or rig is no longer configured.
    #[error(
        "session {id} is of `{name}`, which is not configured any more: configure it again to go on with the session, or DELETE it"
    )]
    NotConfigured {
        /// The session's id.
        id: String,
        /// The camera's or the rig's name.
        name: String,
    },
    /// Its end could not be stored.
    #[error("the session could not be stored: {detail}")]
    Store {
        /// What the store said.
        detail: String,
    },
    /// The daemon is stopping.
    #[error("the daemon is stopping; the session goes on when it is back")]
    Stopping,
}
