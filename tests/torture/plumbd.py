"""A daemon that is tortured: how it is started, asked, listened to and killed, and what it announced."""

import atexit
import json
import os
import re
import signal
import subprocess
import threading
import time
import urllib.error
import urllib.request
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
BINARY = os.environ.get("PLUMB", str(ROOT / "target/debug/plumb"))
TARGET = {"kind": "chessboard", "cols": 9, "rows": 6, "square_m": 0.025}
CAMERA = f"""
[[camera]]
name = "front"
source = {{ kind = "recording", path = "{ROOT / 'recordings/walk.mcap'}", pace = "%s", repeat = true }}
"""


class Announced:
    """What answers and events said: the most views of each session, and each calibration."""

    def __init__(self):
        self.views, self.calibrations = {}, set()
        self.heard = []
        self.lock = threading.Lock()

    def hear(self, kind, event, position):
        with self.lock:
            if kind == "session":
                before = self.views.get(event["id"], 0)
                self.views[event["id"]] = max(before, event["views_kept"])
                self.heard.append((position, event["id"], event["views_kept"]))
            elif kind == "calibration" and event.get("id"):
                self.calibrations.add(event["id"])


class Plumbd:
    def __init__(self, folder, pace="fastest", config="", announced=None, position=lambda: 0, **environment):
        self.folder, self.announced, self.position = Path(folder), announced or Announced(), position
        file = self.folder / "plumb.toml"
        file.write_text(f'[store]\npath = "{self.folder / "store"}"\nmin_free_mb = 0\n{config}\n{CAMERA % pace}')
        self.process = subprocess.Popen(
            [BINARY, "serve", "--config", file, "--listen", "127.0.0.1:0"], stderr=subprocess.PIPE, text=True,
            env={**os.environ, "RUST_LOG": "info", **environment})
        self.log, self.address = [], None
        # Also where a check of ours fails.
        atexit.register(self.process.kill)

    def ready(self):
        """Waits until it listens."""
        for line in self.process.stderr:
            self.log.append(line)
            if found := re.search(r"listening on (http://[\d.:]+)", line):
                self.address = found[1]
                threading.Thread(target=lambda: self.log.extend(self.process.stderr), daemon=True).start()
                return self
        raise AssertionError("it ended: " + "".join(self.log[-5:]))

    def ask(self, path, body=None, method=None, timeout=60):
        """Status and document; (0, None) where it is dead."""
        sent = None if body is None else json.dumps(body).encode()
        request = urllib.request.Request(self.address + path, sent, {"content-type": "application/json"}, method=method)
        try:
            with urllib.request.urlopen(request, timeout=timeout) as answer:
                read = answer.read()
                return answer.status, json.loads(read) if "json" in (answer.headers["content-type"] or "") else read
        except urllib.error.HTTPError as error:
            return error.code, error.read().decode()
        except (OSError, ValueError):
            return 0, None

    def begin(self):
        status, session = self.ask("/v1/cameras/front/sessions", {"target": TARGET})
        return session["id"] if status == 201 else None

    def listen(self):
        """Takes down what events announce, until it dies."""
        def follow():
            try:
                stream = urllib.request.urlopen(self.address + "/v1/events?camera=front", timeout=60)
                kind = None
                for line in stream:
                    name, _, value = line.decode().rstrip("\n").partition(": ")
                    if name == "event":
                        kind = value
                    elif name == "data":
                        self.announced.hear(kind, json.loads(value), self.position())
            except (OSError, ValueError):
                pass
        threading.Thread(target=follow, daemon=True).start()
        return self

    def metric(self, name):
        text = self.ask("/metrics")[1].decode()
        return sum(float(line.rsplit(" ", 1)[1]) for line in text.splitlines() if line.startswith(name))

    def resident_mb(self):
        status = Path(f"/proc/{self.process.pid}/status").read_text()
        return int(re.search(r"VmHWM:\s+(\d+)", status)[1]) / 1000

    def kill(self):
        self.process.send_signal(signal.SIGKILL)
        self.process.wait()

    def end(self):
        self.process.terminate()
        try:
            self.process.wait(timeout=20)
        except subprocess.TimeoutExpired:
            self.kill()
            raise AssertionError("it did not end when asked to") from None


def check(folder):
    """What `plumb store check` says of the store that lies there."""
    run = subprocess.run([BINARY, "store", "check", "--json", "--store", Path(folder) / "store"], capture_output=True, text=True)
    return run.returncode, run.stdout + run.stderr


def missing(plumbd, announced):
    """What was announced and is not there."""
    lost = []
    for session, views in announced.views.items():
        status, document = plumbd.ask(f"/v1/sessions/{session}/views")
        found = len(document["views"]) if status == 200 else 0
        if status != 200 or found < views:
            lost.append(f"session {session}: {found} of {views} views (status {status})")
        for number in range(views):
            if plumbd.ask(f"/v1/sessions/{session}/views/{number}.jpg")[0] != 200:
                lost.append(f"session {session}: no image {number}")
    for calibration in announced.calibrations:
        if plumbd.ask(f"/v1/calibrations/{calibration}")[0] != 200:
            lost.append(f"calibration {calibration}")
    return lost


def until(true, seconds=30):
    """Seconds until something holds; `None` if it does not in time."""
    began = time.monotonic()
    while time.monotonic() - began < seconds:
        if true():
            return time.monotonic() - began
        time.sleep(0.01)
    return None
