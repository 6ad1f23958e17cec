"""What the checks share: the binary under test, and calibrations written to files."""

import json
import os
import subprocess
from pathlib import Path

import pytest

import reference

ROOT = Path(__file__).resolve().parents[2]


@pytest.fixture(scope="session")
def plumb_binary():
    """The binary under test."""
    binary = ROOT / os.environ.get("PLUMB", "target/debug/plumb")
    assert binary.is_file(), f"{binary} is missing: `cargo build` makes it"
    return binary


@pytest.fixture(scope="session")
def plumb(plumb_binary):
    """Runs Plumb with arguments; the finished process, with its output as text."""

    def run(*arguments, succeeds=True):
        done = subprocess.run([plumb_binary, *map(str, arguments)], capture_output=True, text=True, timeout=120)
        assert (done.returncode == 0) == succeeds, f"{arguments}: {done.returncode}\n{done.stdout}{done.stderr}"
        return done

    return run


@pytest.fixture
def exported(plumb, tmp_path):
    """The path of the calibration with the lens `model`, exported in `format`."""

    def export(model, format, succeeds=True):
        document, out = tmp_path / f"{model}.json", tmp_path / f"{model}.{format}"
        document.write_text(json.dumps(reference.calibration(model)))
        done = plumb("export", "--calibration", document, "--format", format, "--out", out, succeeds=succeeds)
        return out if succeeds else done.stderr

    return export
