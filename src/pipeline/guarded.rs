//! Catches panics: a bug that shows in one frame or one solve must not end a daemon that runs for
//! weeks.

use std::panic::{AssertUnwindSafe, catch_unwind};

/// A panic that was caught.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("a fault in plumb itself ({message}); please report it")]
pub(super) struct CaughtPanic {
    /// The panic's message; empty where it has none.
    message: String,
}

/// Runs `work`; a panic becomes an error. The caller must then discard what `work` changed.
pub(super) fn guarded<T>(work: impl FnOnce() -> T) -> Result<T, CaughtPanic> {
    #[cfg(test)]
    let work = || {
        faults::strike();
        work()
    };
    catch_unwind(AssertUnwindSafe(work)).map_err(|panic| {
        let text = panic.downcast_ref::<&str>().map(|text| (*text).to_owned());
        let message = text.or_else(|| panic.downcast_ref::<String>().cloned()).unwrap_or_default();
        CaughtPanic { message }
    })
}

/// Faults that a test requests: guarded work on a thread of this name panics.
#[cfg(test)]
pub(super) mod faults {
    use std::sync::Mutex;

    use crate::locks::lock;

    static THREADS: Mutex<Vec<String>> = Mutex::new(Vec::new());

    /// While it lives, guarded work of the thread panics.
    pub(in crate::pipeline) struct InducedFault(String);

    impl InducedFault {
        pub(in crate::pipeline) fn on(thread: &str) -> Self {
            threads(|threads| threads.push(thread.to_owned()));
            Self(thread.to_owned())
        }
    }

    impl Drop for InducedFault {
        fn drop(&mut self) {
            threads(|threads| threads.retain(|thread| *thread != self.0));
        }
    }

    pub(super) fn strike() {
        let current = std::thread::current();
        let name = current.name().unwrap_or_default();
        let is_struck = threads(|threads| threads.iter().any(|thread| thread == name));
        assert!(!is_struck, "a test's fault on {name}");
    }

    fn threads<T>(of: impl FnOnce(&mut Vec<String>) -> T) -> T {
        of(&mut lock(&THREADS))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_panic_is_an_error_in_words() {
        assert_eq!(guarded(|| 7), Ok(7));
        let error = guarded(|| panic!("{} corners", 3)).map(|()| 0).unwrap_err();
        assert_eq!(error.to_string(), "a fault in plumb itself (3 corners); please report it");
    }
}
