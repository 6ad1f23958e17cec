"""The example client against a running daemon."""

import os
import re
import subprocess
import sys
import threading

import yaml

from conftest import ROOT

CONFIG = """
[store]
path = "{store}"
[[camera]]
name = "front"
source = {{ kind = "recording", path = "{recording}", pace = "fastest", repeat = true }}
"""


def test_the_example_client_calibrates_and_saves(tmp_path):
    config, out = tmp_path / "plumb.toml", tmp_path / "front.yaml"
    config.write_text(CONFIG.format(store=tmp_path / "store", recording=ROOT / "recordings/walk.mcap"))
    binary = ROOT / os.environ.get("PLUMB", "target/debug/plumb")
    command = [binary, "serve", "--config", config, "--listen", "127.0.0.1:0"]
    daemon = subprocess.Popen(command, stderr=subprocess.PIPE, text=True, env={**os.environ, "RUST_LOG": "info"})
    try:
        address = next(found[0] for line in daemon.stderr if (found := re.search(r"http://[\d.:]+", line)))
        threading.Thread(target=daemon.stderr.read, daemon=True).start()
        client = [sys.executable, ROOT / "examples/client.py", address, "front", out]
        done = subprocess.run(client, capture_output=True, text=True, timeout=120)
        assert done.returncode == 0, done.stderr
        assert "verdict:" in done.stdout
        assert yaml.safe_load(out.read_text())["distortion_model"] == "plumb_bob"
    finally:
        daemon.terminate()
        daemon.wait(timeout=30)
