#!/usr/bin/env python3
"""What a live 1280x720 MJPG camera at 30 frames a second costs: Plumb's daemon with a session, beside the loop that
people write with OpenCV, on the same frames.

    cargo build --release && target/venv/bin/python benches/live_rate.py --seconds 60
    target/venv/bin/python benches/live_rate.py --viewers 0,1,10 --seconds 20
    target/venv/bin/python benches/live_rate.py --memory 10000
    target/venv/bin/python benches/live_rate.py --scenes

The second has so many watch the preview, drawn over with what was found, beside the session.
The third searches so many frames as fast as it can, in one session, and prints resident memory on the way.
The fourth gives sessions without a board 120 new frames of 640x480 of each of three worlds, as fast as they can, and prints frames
a second and the milliseconds of processor time that a frame takes: finding features and matching them to key frames, beside which
solves run on a thread of their own.

Prints a line of JSON for each: processor time per second of stream (1 = one core), the 99th percentile from a frame's
arrival to what was seen in it, resident memory at the middle and the end, frames searched and lost.
"""

import argparse
import contextlib
import json
import os
import re
import subprocess
import sys
import tempfile
import threading
import time
import urllib.request
from pathlib import Path

FPS = 30
ADDRESS = "127.0.0.1:8690"
SCENE = "seed = 11\nframes = 300\nfps = 30\n[camera]\nwidth = 1280\nheight = 720\n"
CAMERA = '[[camera]]\nname = "front"\nsource = {{ kind = "recording", path = "{path}", pace = "{pace}", repeat = true }}\n'
TARGET = {"target": {"kind": "chessboard", "cols": 9, "rows": 6, "square_m": 0.025}, "lens": "brown"}
WORLDS = {"room": "orbit", "facade": "sideways", "garden": "orbit"}
WORLD = "seed = {seed}\nframes = {frames}\nfps = 30\n[scene]\nworld = \"{world}\"\npath = \"{path}\"\nimages = {frames}\n"


def processor_seconds(pid):
    fields = Path(f"/proc/{pid}/stat").read_text().rsplit(") ", 1)[1].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def resident_mb(pid, which="VmRSS"):
    return int(re.search(which + r":\s+(\d+)", Path(f"/proc/{pid}/status").read_text())[1]) / 1024


def request(path, body=None):
    data = None if body is None else json.dumps(body).encode()
    headers = {"content-type": "application/json"}
    with urllib.request.urlopen(urllib.request.Request(f"http://{ADDRESS}{path}", data, headers)) as answer:
        return answer.read().decode()


def metric(text, name):
    return sum(float(value) for value in re.findall(rf"^{name}(?:{{.*}})? (\S+)$", text, re.M))


def percentile_99(before, after):
    """The smallest bucket that holds 99 % of what came between two readings, in milliseconds."""
    def buckets(text):
        return {float(le): float(n) for le, n in re.findall(r'plumb_frame_latency_seconds_bucket{.*le="([^"]+)"} (\S+)', text)}
    first, last = buckets(before), buckets(after)
    counts = {le: last[le] - first.get(le, 0) for le in last}
    return next((le * 1000 for le in sorted(counts) if counts[le] >= 0.99 * max(counts.values())), None)


def thread_seconds(pid, name):
    """Processor time of the threads of a process that are called so."""
    used = 0
    for task in Path(f"/proc/{pid}/task").iterdir():
        thread, fields = (task / "stat").read_text().split("(", 1)[1].rsplit(") ", 1)
        if thread == name:
            used += sum(map(int, fields.split()[11:13]))
    return used / os.sysconf("SC_CLK_TCK")


@contextlib.contextmanager
def session(plumb, recording, pace, target=TARGET):
    """A daemon with a session on the recording, which is shown over and over."""
    with tempfile.TemporaryDirectory() as folder:
        config = Path(folder, "plumb.toml")
        camera = CAMERA.format(path=recording, pace=pace)
        config.write_text(f'[server]\nlisten = "{ADDRESS}"\n[store]\npath = "{folder}/store"\n' + camera)
        daemon = subprocess.Popen([plumb, "serve", "--config", config], stderr=subprocess.DEVNULL)
        try:
            deadline = time.monotonic() + 30
            while True:
                try:
                    request("/readyz")
                    break
                except OSError:
                    if time.monotonic() > deadline:
                        raise
                    time.sleep(0.1)
            request("/v1/cameras/front/sessions", target)
            yield daemon
        finally:
            daemon.terminate()
            daemon.wait()


def measure_memory(plumb, recording, frames):
    """Resident memory at every tenth of the way, from the first tenth on."""
    with session(plumb, recording, "fastest") as daemon:
        began, resident, searched = time.monotonic(), [], 0
        while searched < frames:
            time.sleep(0.2)
            searched = metric(request("/metrics"), "plumb_frames_searched_total")
            if searched * 10 >= frames * (len(resident) + 1):
                resident.append(round(resident_mb(daemon.pid), 1))
        return {
            "what": "plumb, as fast as it can",
            "frames": int(searched),
            "frames_per_s": round(searched / (time.monotonic() - began), 1),
            "resident_mb": resident,
            "highest_mb": round(resident_mb(daemon.pid, "VmHWM"), 1),
        }


def measure_scene(plumb, recording, frames):
    with session(plumb, recording, "fastest", {"target": {"kind": "scene"}}) as daemon:
        began, searched = time.monotonic(), 0
        while searched < frames:
            time.sleep(0.05)
            searched = metric(request("/metrics"), "plumb_frames_searched_total")
        elapsed, used = time.monotonic() - began, thread_seconds(daemon.pid, "detect-front")
        return {
            "what": f"plumb, {recording.stem} without a board",
            "frames": int(searched),
            "frames_per_s": round(searched / elapsed, 1),
            "ms_each": round(1000 * used / searched, 1),
        }


def watch(stop, counts, index):
    """Reads the preview and counts its frames."""
    with urllib.request.urlopen(f"http://{ADDRESS}/v1/cameras/front/preview.mjpg") as stream:
        while not stop.is_set():
            counts[index] += stream.read1(1 << 16).count(b"--plumb-frame")


def measure_plumb(plumb, recording, seconds, viewers=0):
    stop, shown = threading.Event(), [0] * viewers
    with session(plumb, recording, "recorded") as daemon:
        threads = [threading.Thread(target=watch, args=(stop, shown, index), daemon=True) for index in range(viewers)]
        for thread in threads:
            thread.start()
        time.sleep(5)
        shown_before = sum(shown)
        before, used, began = request("/metrics"), processor_seconds(daemon.pid), time.monotonic()
        time.sleep(seconds / 2)
        middle = resident_mb(daemon.pid)
        time.sleep(seconds / 2)
        after, elapsed = request("/metrics"), time.monotonic() - began
        difference = lambda name: metric(after, name) - metric(before, name)
        watched = {} if not viewers else {
            "shown_per_s_each": round((sum(shown) - shown_before) / elapsed / viewers, 1),
            "drawn_per_s": round(difference("plumb_previews_drawn_total") / elapsed, 1),
        }
        stop.set()
        return {
            "what": "plumb",
            "viewers": viewers,
            **watched,
            "cores": round((processor_seconds(daemon.pid) - used) / elapsed, 3),
            "p99_ms": percentile_99(before, after),
            "resident_mb": [round(middle, 1), round(resident_mb(daemon.pid), 1)],
            "searched_at_per_s": round(difference("plumb_frames_searched_total") / elapsed, 1),
            "lost": difference("plumb_frames_dropped_total"),
        }


def measure_opencv(recording, seconds):
    """imdecode to gray, findChessboardCorners with its fast check, cornerSubPix: the loop of the tutorials."""
    import cv2
    import numpy
    from mcap_protobuf.decoder import DecoderFactory
    from mcap.reader import make_reader

    with open(recording, "rb") as file:
        messages = make_reader(file, decoder_factories=[DecoderFactory()]).iter_decoded_messages()
        frames = [numpy.frombuffer(message.data, numpy.uint8) for *_, message in messages]
    flags = cv2.CALIB_CB_ADAPTIVE_THRESH | cv2.CALIB_CB_NORMALIZE_IMAGE | cv2.CALIB_CB_FAST_CHECK
    criteria = (cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_MAX_ITER, 30, 0.001)
    pid, latencies, searched, began, due = os.getpid(), [], 0, time.monotonic(), 0
    used, found = processor_seconds(pid), 0
    while (now := time.monotonic() - began) < seconds:
        # The newest frame that is due; those before it are lost.
        due = max(due + 1, int(now * FPS))
        time.sleep(max(0.0, due / FPS - (time.monotonic() - began)))
        gray = cv2.imdecode(frames[due % len(frames)], cv2.IMREAD_GRAYSCALE)
        seen, corners = cv2.findChessboardCorners(gray, (9, 6), flags=flags)
        if seen:
            cv2.cornerSubPix(gray, corners, (11, 11), (-1, -1), criteria)
        found += seen
        searched += 1
        latencies.append(time.monotonic() - began - due / FPS)
    elapsed = time.monotonic() - began
    return {
        "what": f"opencv {cv2.__version__}",
        "cores": round((processor_seconds(pid) - used) / elapsed, 3),
        "p99_ms": round(sorted(latencies)[int(0.99 * len(latencies))] * 1000, 1),
        "resident_mb": [round(resident_mb(pid), 1)],
        "searched_at_per_s": round(searched / elapsed, 1),
        "lost": due - searched,
        "boards": found,
    }


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--plumb", default="target/release/plumb")
    parser.add_argument("--seconds", type=float, default=60)
    parser.add_argument("--viewers", metavar="N,N", help="measures beside so many who watch the preview, instead of OpenCV")
    parser.add_argument("--memory", type=int, metavar="FRAMES")
    parser.add_argument("--scenes", action="store_true")
    parser.add_argument("--seed", type=int, default=91, help="of the worlds of --scenes")
    arguments = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        if arguments.scenes:
            for world, path in WORLDS.items():
                scene, recording = Path(folder, f"{world}.toml"), Path(folder, f"{world}.mcap")
                scene.write_text(WORLD.format(seed=arguments.seed, world=world, path=path, frames=120))
                subprocess.run([arguments.plumb, "simulate", "--config", scene, "--out", recording], check=True, stdout=sys.stderr)
                print(json.dumps(measure_scene(arguments.plumb, recording, 120)), flush=True)
            return
        scene, recording = Path(folder, "scene.toml"), Path(folder, "street.mcap")
        scene.write_text(SCENE)
        subprocess.run([arguments.plumb, "simulate", "--config", scene, "--out", recording], check=True, stdout=sys.stderr)
        if arguments.memory:
            print(json.dumps(measure_memory(arguments.plumb, recording, arguments.memory)), flush=True)
            return
        if arguments.viewers:
            for viewers in map(int, arguments.viewers.split(",")):
                print(json.dumps(measure_plumb(arguments.plumb, recording, arguments.seconds, viewers)), flush=True)
            return
        print(json.dumps(measure_plumb(arguments.plumb, recording, arguments.seconds)), flush=True)
        print(json.dumps(measure_opencv(recording, arguments.seconds)), flush=True)


if __name__ == "__main__":
    main()
