//! The present search in a camera's frames, and the session that has the camera.

use std::sync::{Arc, Mutex, MutexGuard};

use crate::locks::lock;
use crate::pipeline::assembly::Assembly;

/// One session's search on one camera: its results go to the assembly.
#[derive(Debug)]
pub(super) struct CameraSearch {
    pub(super) assembly: Arc<Assembly>,
    /// The camera's place in the instrument.
    pub(super) place: usize,
}

impl PartialEq for CameraSearch {
    /// Two searches are equal only if they are of the same session and camera.
    fn eq(&self, other: &Self) -> bool {
        Arc::ptr_eq(&self.assembly, &other.assembly) && self.place == other.place
    }
}

/// Another session has the camera.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("session {owner} has the camera")]
pub(super) struct CameraTaken {
    /// The id of that session.
    pub(super) owner: String,
}

/// The present search of a camera, read with every frame.
#[derive(Debug, Default)]
pub(super) struct CurrentSearch {
    state: Mutex<SearchState>,
}

#[derive(Debug, Default)]
struct SearchState {
    /// The session that has the camera.
    owner: Option<String>,
    search: Option<Arc<CameraSearch>>,
}

impl CurrentSearch {
    /// Gives the camera to a session.
    ///
    /// # Errors
    /// [`CameraTaken`].
    pub(super) fn acquire(&self, session: &str) -> Result<(), CameraTaken> {
        let mut state = self.lock();
        match &state.owner {
            Some(owner) => Err(CameraTaken { owner: owner.clone() }),
            None => {
                state.owner = Some(session.to_owned());
                Ok(())
            }
        }
    }

    /// Searches from now on, or no longer for `None`. Has no effect unless `session` has the
    /// camera.
    pub(super) fn set(&self, session: &str, search: Option<Arc<CameraSearch>>) {
        let mut state = self.lock();
        if state.owner.as_deref() == Some(session) {
            state.search = search;
        }
    }

    /// Takes the camera back from a session. Returns whether the session had it.
    pub(super) fn release(&self, session: &str) -> bool {
        let mut state = self.lock();
        let had = state.owner.as_deref() == Some(session);
        if had {
            *state = SearchState::default();
        }
        had
    }

    pub(super) fn get(&self) -> Option<Arc<CameraSearch>> {
        self.lock().search.clone()
    }

    fn lock(&self) -> MutexGuard<'_, SearchState> {
        lock(&self.state)
    }
}
