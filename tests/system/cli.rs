//! The command line's own rules: help, one JSON document on stdout, exit codes, closed pipes.

use crate::program::plumb;

const COMMANDS: &[&str] =
    &["serve", "detect", "calibrate", "solve", "devices", "export", "simulate", "record", "verify"];

#[test]
fn every_command_has_help() {
    let listed = plumb(["--help"]);
    assert_eq!((listed.code, listed.stderr.as_str()), (Some(0), ""));
    for command in COMMANDS {
        assert!(listed.stdout.contains(command), "{command} is not listed: {}", listed.stdout);
        let help = plumb([command, "--help"]);
        assert_eq!((help.code, help.stderr.as_str()), (Some(0), ""), "{command}");
        assert!(help.stdout.contains("Usage: plumb ") && help.stdout.contains("--help"), "{}", help.stdout);
    }
}

#[test]
fn the_version_is_the_package_s() {
    assert_eq!(plumb(["--version"]).stdout, concat!("plumb ", env!("CARGO_PKG_VERSION"), "\n"));
}
