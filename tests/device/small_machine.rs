//! The host's side: makes the small machine, and runs this same program in it.

use std::path::Path;
use std::process::{Command, ExitCode};

use crate::not_tested::not_tested;

/// How long a run may take; the small machine computes in software.
const LIMIT_SECONDS: &str = "600";
/// The package's unit.
const UNIT: &str = "packaging/plumb.service";

/// Runs the scenarios in the machine, and those that want systemd in one that has it.
pub fn run_this_program(names: &[String], plain: bool, under_systemd: bool) -> ExitCode {
    let script = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/device/small_machine.sh");
    let prepared = Command::new(&script).arg("prepare").status();
    if !prepared.is_ok_and(|status| status.success()) {
        not_tested("real devices: the small machine could not be made, see the line above");
        // A machine without the packages, or not root: a developer may go on, but nothing may be
        // released untested.
        let released = std::env::var_os("CI").is_some();
        return if released { ExitCode::FAILURE } else { ExitCode::SUCCESS };
    }
    let failed = plain && !runs(&script, names, None);
    if failed || !under_systemd {
        return if failed { ExitCode::FAILURE } else { ExitCode::SUCCESS };
    }
    if runs(&script, names, Some(UNIT)) { ExitCode::SUCCESS } else { ExitCode::FAILURE }
}

fn runs(script: &Path, names: &[String], unit: Option<&str>) -> bool {
    let program = std::env::current_exe().unwrap();
    let out = tempfile::tempdir().unwrap();
    let mut command = Command::new(script);
    command.env("SMALL_MACHINE_OUT", out.path());
    command
        .args(["run", "-t", LIMIT_SECONDS])
        .args(["-m", "vivid n_devs=2 node_types=0x1,0x1 num_inputs=1,1 input_types=0x0,0x0"])
        .args([
            "-m",
            "v4l2loopback devices=2 video_nr=20,21 card_label=Walk,Street exclusive_caps=0,0",
        ])
        .args(["-m", "vhci_hcd", "-m", "uvcvideo"]);
    // The service sees neither /tmp nor /home, where the program may lie; and it stays as it is when
    // another build puts its own in the program's place.
    let copy = out.path().join("plumb");
    let mut strip = Command::new("strip");
    strip.arg("-o").arg(copy).arg(env!("CARGO_BIN_EXE_plumb"));
    assert!(strip.status().unwrap().success());
    if let Some(unit) = unit {
        command.args(["-u", unit]);
    }
    command.arg("--").arg(program).args(names).status().unwrap().success()
}
