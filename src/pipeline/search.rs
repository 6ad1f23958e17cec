//! What a camera's frames are searched for at the moment: the only thing that a session tells the
//! threads before it.

use std::sync::{Arc, Mutex, PoisonError};

use crate::geometry::target::Target;
use crate::pipeline::rig_inbox::RigSeat;

/// One session's wish: look for this board, and say so in its name.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Search {
    /// The session that looks; each begins a search of its own.
    pub(super) session: String,
    /// What it looks for.
    pub(super) target: Target,
    /// For a rig's session: where what is seen is handed over.
    pub(super) rig: Option<RigSeat>,
}

/// The search of the moment, read with every frame.
#[derive(Debug, Clone, Default)]
pub(super) struct CurrentSearch {
    search: Arc<Mutex<Option<Arc<Search>>>>,
}

impl CurrentSearch {
    pub(super) fn set(&self, search: Option<Search>) {
        *self.search.lock().unwrap_or_else(PoisonError::into_inner) = search.map(Arc::new);
    }

    pub(super) fn get(&self) -> Option<Arc<Search>> {
        self.search.lock().unwrap_or_else(PoisonError::into_inner).clone()
    }
}
