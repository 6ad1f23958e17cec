"""The API against its own description: requests made from /openapi.json, valid ones and others, each
answered as it says."""

import os
import re
import subprocess
import sys
import threading
from pathlib import Path

from conftest import ROOT
from test_client import CONFIG

# Endless answers: a request that waits for their end would wait for ever.
ENDLESS = r"preview\.mjpg|/v1/events"


def test_each_answer_is_the_one_that_the_api_describes(plumb_binary, tmp_path):
    config = tmp_path / "plumb.toml"
    config.write_text(CONFIG.format(store=tmp_path / "store", recording=ROOT / "recordings/walk.mcap"))
    command = [plumb_binary, "serve", "--config", config, "--listen", "127.0.0.1:0"]
    daemon = subprocess.Popen(command, stderr=subprocess.PIPE, text=True, env={**os.environ, "RUST_LOG": "info"})
    try:
        address = next(found[0] for line in daemon.stderr if (found := re.search(r"http://[\d.:]+", line)))
        threading.Thread(target=daemon.stderr.read, daemon=True).start()
        schemathesis = Path(sys.executable).parent / "schemathesis"
        asked = subprocess.run(
            [
                schemathesis,
                *("--config-file", Path(__file__).with_name("schemathesis.toml")),
                *("run", f"{address}/openapi.json", "--checks", "all"),
                *("--phases", "examples,coverage,fuzzing", "--max-examples", "10"),
                *("--exclude-path-regex", ENDLESS, "--request-timeout", "30"),
                *("--seed", "1", "--generation-deterministic"),
                *("--continue-on-failure", "--warnings", "off", "--no-color"),
            ],
            capture_output=True,
            text=True,
            timeout=240,
            cwd=tmp_path,
        )
        assert asked.returncode == 0, asked.stdout[-8000:] + asked.stderr[-2000:]
        cases = re.search(r"([\d,]+) generated", asked.stdout)
        assert cases and int(cases[1].replace(",", "")) > 1000, asked.stdout[-2000:]
        assert daemon.poll() is None
    finally:
        daemon.terminate()
        daemon.wait(timeout=30)
