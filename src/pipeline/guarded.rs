//! A fault of the program in one frame or one solve must not end a daemon that runs for weeks.

use std::panic::{AssertUnwindSafe, catch_unwind};

/// Runs `work`; a panic becomes an error in words. What `work` changed must be thrown away then.
pub(super) fn guarded<T>(work: impl FnOnce() -> T) -> Result<T, String> {
    catch_unwind(AssertUnwindSafe(work)).map_err(|panic| {
        let text = panic.downcast_ref::<&str>().map(|text| (*text).to_owned());
        let text = text.or_else(|| panic.downcast_ref::<String>().cloned()).unwrap_or_default();
        format!("a fault in plumb itself ({text}); please report it")
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_panic_is_an_error_in_words() {
        assert_eq!(guarded(|| 7), Ok(7));
        let error = guarded(|| panic!("{} corners", 3)).map(|()| 0).unwrap_err();
        assert_eq!(error, "a fault in plumb itself (3 corners); please report it");
    }
}
