//! The fuzzer: libFuzzer calls the target that `PLUMB_FUZZ` names.
#![no_main]

mod targets;

use std::sync::LazyLock;

static TARGET: LazyLock<&targets::Target> = LazyLock::new(|| {
    let name = std::env::var("PLUMB_FUZZ").unwrap_or_default();
    let named = targets::ALL.iter().find(|target| target.name == name);
    named.unwrap_or_else(|| panic!("PLUMB_FUZZ={name}: no such target"))
});

libfuzzer_sys::fuzz_target!(|input: &[u8]| (TARGET.run)(input));
