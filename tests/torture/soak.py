"""Four cameras and sessions in a loop, for so many minutes: does memory, do descriptors, threads or the store grow?

    PLUMB=target/release/plumb target/venv/bin/python tests/torture/soak.py --minutes 120

Two recordings and two simulators; each session collects for 20 s, is stopped and solved, and its calibration is asked for. Nothing is
approved, and all but the newest 20 sessions are deleted, with their calibrations: what is approved is kept for ever. Previews and events
are read beside. Each minute it takes down what the process holds. The slopes are of the last half, when caches and the store are full.
"""

import argparse
import json
import re
import sys
import tempfile
import threading
import time
import urllib.request
from pathlib import Path

import plumbd
from plumbd import ROOT, TARGET, Plumbd

SECONDS_OF_A_SESSION = 20
KEPT = 20
CONFIG = "[calibration]\nauto_approve = false"
CAMERAS = f"""
[[camera]]
name = "front"
source = {{ kind = "recording", path = "{ROOT / 'recordings/walk.mcap'}", pace = "recorded", repeat = true }}
[[camera]]
name = "back"
source = {{ kind = "recording", path = "{ROOT / 'recordings/hard.mcap'}", pace = "recorded", repeat = true }}
[[camera]]
name = "left"
source = {{ kind = "simulator", seed = 3, fps = 10, operator = "follows" }}
[[camera]]
name = "right"
source = {{ kind = "simulator", seed = 4, fps = 10, operator = "wanders" }}
"""
NAMES = ["front", "back", "left", "right"]


class Counts:
    def __init__(self):
        self.lock = threading.Lock()
        self.sessions, self.solved, self.refused, self.bad = 0, 0, 0, []
        self.kept = []


def rounds(daemon, camera, until, counts):
    """Sessions of one camera, one after the other."""
    while time.monotonic() < until:
        status, session = daemon.ask(f"/v1/cameras/{camera}/sessions", {"target": TARGET})
        if status != 201:
            counts.bad.append(f"{camera}: a session was answered with {status}: {session}")
            return
        path = f"/v1/sessions/{session['id']}"
        ends = time.monotonic() + SECONDS_OF_A_SESSION
        while time.monotonic() < ends and daemon.ask(path)[1]["state"] == "collecting":
            time.sleep(0.5)
        daemon.ask(f"{path}/stop", {})
        over = time.monotonic() + 60
        while (document := daemon.ask(path)[1])["state"] in ("collecting", "solving"):
            if time.monotonic() > over:
                counts.bad.append(f"{camera}: {session['id']} is still {document['state']}")
                return
            time.sleep(0.2)
        with counts.lock:
            counts.sessions += 1
            if document["state"] == "finished":
                counts.solved += 1
                if daemon.ask(f"/v1/calibrations/{document['calibration']}")[0] != 200:
                    counts.bad.append(f"{camera}: no calibration {document['calibration']}")
            else:
                counts.refused += 1
            counts.kept.append((path, document["calibration"]))
            old, counts.kept = counts.kept[:-KEPT], counts.kept[-KEPT:]
        for path, calibration in old:
            gone = [f"{path}?purge=true", *([f"/v1/calibrations/{calibration}"] if calibration else [])]
            counts.bad += [f"DELETE {one}: {status}" for one in gone if (status := daemon.ask(one, method="DELETE")[0]) >= 300]


def watch(daemon, path, until):
    """Reads a stream that does not end."""
    while time.monotonic() < until:
        try:
            with urllib.request.urlopen(daemon.address + path, timeout=30) as stream:
                begun = time.monotonic()
                while time.monotonic() < min(until, begun + 60) and stream.read1(65536):
                    pass
        except OSError:
            time.sleep(1)


def held(daemon):
    """Resident kB, descriptors, threads, kB of the store."""
    process = Path(f"/proc/{daemon.process.pid}")
    resident = int(re.search(r"VmRSS:\s+(\d+)", (process / "status").read_text())[1])
    entries = [len(list((process / folder).iterdir())) for folder in ("fd", "task")]
    store = sum(file.stat().st_size for file in (daemon.folder / "store").rglob("*") if file.is_file())
    return [resident, *entries, store // 1024]


def slope(rows, column):
    """Of a line through the last half, an hour."""
    rows = rows[len(rows) // 2:]
    hours = [row[0] / 3600 for row in rows]
    values = [row[1 + column] for row in rows]
    mean_t, mean_v = sum(hours) / len(hours), sum(values) / len(values)
    spread = sum((t - mean_t) ** 2 for t in hours)
    return sum((t - mean_t) * (v - mean_v) for t, v in zip(hours, values)) / max(spread, 1e-12), mean_v


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--minutes", type=float, default=120)
    parser.add_argument("--out", type=Path, help="a line of JSON a minute")
    asked = parser.parse_args()
    plumbd.CAMERA = CAMERAS.replace("%", "%%") + "# %s"
    counts, rows, began = Counts(), [], time.monotonic()
    until = began + asked.minutes * 60
    with tempfile.TemporaryDirectory() as folder:
        daemon = Plumbd(folder, config=CONFIG).ready()
        threads = [threading.Thread(target=rounds, args=(daemon, name, until, counts)) for name in NAMES]
        streams = ["/v1/cameras/left/preview.mjpg", "/v1/cameras/front/preview.mjpg", "/v1/events"]
        threads += [threading.Thread(target=watch, args=(daemon, path, until)) for path in streams]
        for thread in threads:
            thread.start()
        while time.monotonic() < until:
            time.sleep(min(60, max(0, until - time.monotonic())))
            rows.append([time.monotonic() - began, *held(daemon)])
            if asked.out:
                with asked.out.open("a") as file:
                    file.write(json.dumps(rows[-1] + [counts.sessions, counts.bad]) + "\n")
        for thread in threads:
            thread.join()
        daemon.end()
    print(f"{(time.monotonic() - began) / 60:.0f} minutes, {counts.sessions} sessions: {counts.solved} calibrated, {counts.refused} refused")
    for column, name in enumerate(["resident kB", "descriptors", "threads", "kB of the store"]):
        an_hour, mean = slope(rows, column)
        last = [row[1 + column] for row in rows]
        print(f"{name}: {last[0]} after a minute, {last[-1]} at the end, at most {max(last)}; {an_hour:+.1f} an hour, {an_hour * 24:+.0f} a day")
    for problem in counts.bad:
        print(f"does not hold: {problem}", file=sys.stderr)
    return bool(counts.bad)


if __name__ == "__main__":
    sys.exit(main())
