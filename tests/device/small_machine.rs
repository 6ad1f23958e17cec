//! The host's side: makes the small machine, and runs this same program in it.

use std::path::Path;
use std::process::{Command, ExitCode};

/// How long the whole run may take; the small machine computes in software.
const LIMIT_SECONDS: &str = "600";

pub fn run_this_program(names: &[String]) -> ExitCode {
    let script = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/device/small_machine.sh");
    let prepared = Command::new(&script).arg("prepare").status();
    if !prepared.is_ok_and(|status| status.success()) {
        println!(
            "REAL DEVICES NOT TESTED: the small machine could not be made, see the line above"
        );
        // A machine without the packages, or not root: a developer may go on, but nothing may be
        // released untested.
        return if std::env::var_os("CI").is_some() {
            ExitCode::FAILURE
        } else {
            ExitCode::SUCCESS
        };
    }
    let program = std::env::current_exe().unwrap();
    let status = Command::new(&script)
        .args(["run", "-t", LIMIT_SECONDS])
        .args(["-m", "vivid n_devs=2 node_types=0x1,0x1 num_inputs=1,1 input_types=0x0,0x0"])
        .args([
            "-m",
            "v4l2loopback devices=2 video_nr=20,21 card_label=Walk,Street exclusive_caps=0,0",
        ])
        .args(["-m", "vhci_hcd", "-m", "uvcvideo"])
        .arg("--")
        .arg(program)
        .args(names)
        .status()
        .unwrap();
    if status.success() { ExitCode::SUCCESS } else { ExitCode::FAILURE }
}
