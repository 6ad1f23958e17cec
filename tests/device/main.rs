//! Real devices: this machine boots a small one with a real V4L2 stack, which runs the scenarios
//! below and reports what it measured. `cargo test --test device [NAME…]`; with names, only the
//! scenarios whose names contain one of them.

#![allow(
    missing_docs,
    clippy::unwrap_used,
    clippy::print_stdout,
    clippy::exit,
    reason = "a test program"
)]

mod daemon;
mod enumeration;
mod faults;
mod formats;
mod guest;
mod loopback;
#[path = "../system/not_tested.rs"]
mod not_tested;
#[cfg(feature = "nokhwa")]
mod portable;
mod replug;
mod rig;
mod small_machine;
mod supervision;
mod unit;
mod usb;
mod usb_camera;
mod walk;

use std::panic::catch_unwind;
use std::path::Path;
use std::process::ExitCode;
use std::time::Instant;

type Scenario = fn() -> String;

/// Each returns what it measured, in a line, and panics when something is not as it must be.
const SCENARIOS: &[(&str, Scenario)] = &[
    ("enumeration", enumeration::every_camera_is_listed_with_its_names_and_formats),
    ("formats", formats::every_format_gives_the_same_image),
    ("mode", formats::what_cannot_be_had_is_reported),
    ("controls", formats::controls_are_set_held_and_given_back),
    ("busy", faults::a_camera_in_use_is_reported_with_its_holder),
    ("injected_faults", faults::each_injected_fault_is_reported_and_survived),
    ("stall", faults::a_stalled_device_never_blocks),
    ("supervision", supervision::every_fault_is_a_state_with_a_reason_and_the_session_goes_on),
    ("usb", usb::a_usb_camera_streams_holds_still_and_comes_back),
    #[cfg(feature = "nokhwa")]
    ("portable_frames", portable::frames_are_those_that_were_shown),
    #[cfg(feature = "nokhwa")]
    ("portable_stall", portable::a_stalled_camera_holds_one_thread),
    #[cfg(feature = "nokhwa")]
    ("portable_pair", portable::two_cameras_and_one_in_use),
    ("rig", rig::a_rig_goes_on_without_the_camera_that_is_unplugged),
    ("walk", walk::a_walk_is_calibrated_over_http),
    ("replug", replug::two_hundred_rounds_leave_nothing_behind),
];

/// As [`SCENARIOS`], in a machine whose first process is systemd.
const UNDER_SYSTEMD: &[(&str, Scenario)] =
    &[("unit", unit::the_confined_service_reads_cameras_and_keeps_views)];

fn main() -> ExitCode {
    let arguments: Vec<String> = std::env::args().collect();
    if let [_, feed, device, format, recording, fps] = &arguments[..]
        && feed == loopback::FEED
    {
        loopback::feed(device, format, Path::new(recording), fps.parse().unwrap());
        return ExitCode::SUCCESS;
    }
    let names: Vec<String> =
        std::env::args().skip(1).filter(|argument| !argument.starts_with('-')).collect();
    if std::env::args().any(|argument| argument == "--list") {
        return ExitCode::SUCCESS;
    }
    if std::env::var_os("SMALL_MACHINE_GUEST").is_none() {
        let wanted = |scenarios: &[(&str, Scenario)]| {
            let named = |name: &str| names.is_empty() || names.iter().any(|n| name.contains(n));
            scenarios.iter().any(|(name, _)| named(name))
        };
        return small_machine::run_this_program(&names, wanted(SCENARIOS), wanted(UNDER_SYSTEMD));
    }
    let mut failed = 0;
    let systemd = Path::new("/run/systemd/system").exists();
    for (name, scenario) in if systemd { UNDER_SYSTEMD } else { SCENARIOS }
        .iter()
        .filter(|(name, _)| names.is_empty() || names.iter().any(|n| name.contains(n)))
    {
        let began = Instant::now();
        let outcome = catch_unwind(scenario);
        let seconds = began.elapsed().as_secs_f64();
        if let Ok(measured) = outcome {
            println!("device {name} ... ok ({seconds:.1} s) {measured}");
        } else {
            println!("device {name} ... FAILED ({seconds:.1} s)");
            failed += 1;
        }
    }
    ExitCode::from(failed)
}
