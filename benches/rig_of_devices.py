"""Two simulated devices with color, infrared and depth as one rig: each of the 30 numbers of its
extrinsics against the truth, in the standard deviations that Plumb predicts for it.

    python3 benches/rig_of_devices.py target/release/plumb --first 400 --seeds 20 --by cli http

Prints a line per seed, then how many numbers lie beyond 3 predicted standard deviations (a Gaussian
leaves 0.27 % there), and the rms of them all, which is 1 where the predictions are true.
"""

import argparse
import json
import math
import pathlib
import subprocess
import tempfile
import time
import urllib.request

SCENE = """frames = 60
fps = 5
[camera]
jpeg_quality = 87
[board]
square_m = 0.04
[walk]
still_s = 0.3
travel_s = 0.3
width = [0.3, 0.6]
[depth]
noise_per_m = 0.0015
step_per_m = 0.004
"""
CAMERAS = ("left", "right")
GAUSSIAN_BEYOND_3 = 0.0027


def product(a, b):
    """Of two quaternions, w first."""
    (aw, ax, ay, az), (bw, bx, by, bz) = a, b
    return (
        aw * bw - ax * bx - ay * by - az * bz,
        aw * bx + ax * bw + ay * bz - az * by,
        aw * by - ax * bz + ay * bw + az * bx,
        aw * bz + ax * by - ay * bx + az * bw,
    )


def conjugate(q):
    return (q[0], -q[1], -q[2], -q[3])


def rotated(q, v):
    return product(product(q, (0.0, *v)), conjugate(q))[1:]


class Pose:
    def __init__(self, rotation, translation):
        self.rotation, self.translation = rotation, translation

    @classmethod
    def of(cls, document):
        return cls(tuple(document["rotation"][k] for k in "wxyz"), tuple(document["translation"]))

    def __mul__(self, other):
        translation = rotated(self.rotation, other.translation)
        translation = tuple(a + b for a, b in zip(translation, self.translation))
        return Pose(product(self.rotation, other.rotation), translation)

    def inverse(self):
        back = conjugate(self.rotation)
        return Pose(back, tuple(-x for x in rotated(back, self.translation)))


def errors_in_std(found, truth):
    """The rotation's and the translation's three errors over their predicted deviations."""
    pose = Pose.of(found)
    w, *axis = product(pose.rotation, conjugate(truth.rotation))
    rotation = [2.0 * math.copysign(1.0, w) * x for x in axis]
    translation = [a - b for a, b in zip(pose.translation, truth.translation)]
    predicted = found["rotation_std"] + found["translation_std"]
    return [error / std for error, std in zip(rotation + translation, predicted)]


def simulate(plumb, folder, seed):
    """Both devices' recordings of one moving board, with the true poses of all sensors."""
    truths = {}
    for seat, camera in enumerate(CAMERAS):
        recording = folder / f"{seed}_{camera}.mcap"
        truth = recording.with_suffix(".truth.json")
        if not truth.exists():
            scene = folder / f"{seed}_{camera}.toml"
            scene.write_text(f"seed = {seed}\nseat = {seat}\n{SCENE}")
            command = [plumb, "simulate", "--config", scene, "--out", recording]
            subprocess.run(command, check=True, capture_output=True)
        truths[camera] = json.loads(truth.read_text())
    poses = {}
    of_board = {c: Pose.of(truths[c]["frames"][0]["camera_from_board"]) for c in CAMERAS}
    for camera in CAMERAS:
        left_from = of_board["left"] * of_board[camera].inverse()
        if camera != "left":
            poses[f"left.color_from_{camera}.color"] = left_from
        for extrinsics in truths[camera]["extrinsics"]:
            sensor = extrinsics["name"].removeprefix("color_from_")
            poses[f"left.color_from_{camera}.{sensor}"] = left_from * Pose.of(extrinsics)
    return truths["left"]["target"], poses


def by_command_line(plumb, folder, seed, target):
    file = folder / "target.json"
    file.write_text(json.dumps(target))
    command = [plumb, "calibrate", "--json", "--target", file, "--lens", "brown"]
    for camera in CAMERAS:
        command += ["--rig", f"{camera}={folder / f'{seed}_{camera}.mcap'}"]
    return json.loads(subprocess.run(command, check=True, capture_output=True).stdout)


def request(method, url, body=None):
    data = None if body is None else json.dumps(body).encode()
    headers = {"Content-Type": "application/json"}
    asked = urllib.request.Request(url, data=data, method=method, headers=headers)
    with urllib.request.urlopen(asked, timeout=120) as answer:
        return json.load(answer)


def by_http(plumb, folder, seed, target):
    """A session of the daemon over the same recordings."""
    with tempfile.TemporaryDirectory() as store:
        config = pathlib.Path(store) / "plumb.toml"
        text = f'[server]\nlisten = "127.0.0.1:0"\n[store]\npath = "{store}/data"\n'
        for camera in CAMERAS:
            path = folder / f"{seed}_{camera}.mcap"
            text += f'[[camera]]\nname = "{camera}"\nsource = {{ kind = "recording", path = "{path}", pace = "fastest" }}\n'
        config.write_text(text + '[[rig]]\nname = "head"\ncameras = ["left", "right"]\n')
        with open(pathlib.Path(store) / "log", "w+") as log:
            daemon = subprocess.Popen([plumb, "serve", "--config", config], stderr=log, stdout=log)
            try:
                return session(address(pathlib.Path(store) / "log", daemon), target)
            finally:
                daemon.terminate()
                daemon.wait(timeout=30)


def address(log, daemon):
    while daemon.poll() is None:
        for word in log.read_text().split():
            if word.strip('"').startswith("http://127.0.0.1:"):
                return word.strip('"').rstrip("/")
        time.sleep(0.05)
    raise SystemExit(f"the daemon ended: {log.read_text()}")


def session(base, target):
    asked = {"target": target, "lens": "brown"}
    started = request("POST", f"{base}/v1/rigs/head/sessions", asked)
    identifier = started["id"]
    while "has ended" not in (request("GET", f"{base}/v1/sessions/{identifier}")["reason"] or ""):
        time.sleep(0.2)
    ended = request("POST", f"{base}/v1/sessions/{identifier}/stop")
    return request("GET", f"{base}/v1/calibrations/{ended['calibration']}")


def main():
    arguments = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    arguments.add_argument("plumb", type=pathlib.Path, help="the binary")
    arguments.add_argument("--first", type=int, default=400, help="the first seed")
    arguments.add_argument("--seeds", type=int, default=20)
    arguments.add_argument("--by", nargs="+", choices=["cli", "http"], default=["cli", "http"])
    arguments.add_argument("--recordings", type=pathlib.Path, help="where they are kept")
    given = arguments.parse_args()
    ways = {"cli": by_command_line, "http": by_http}
    plumb = given.plumb.resolve()
    with tempfile.TemporaryDirectory() as temporary:
        folder = given.recordings or pathlib.Path(temporary)
        folder.mkdir(parents=True, exist_ok=True)
        pooled = {(way, kind): [] for way in given.by for kind in ("rotation", "translation")}
        by_name = {}
        for seed in range(given.first, given.first + given.seeds):
            target, truth = simulate(plumb, folder, seed)
            for way in given.by:
                calibration = ways[way](plumb, folder, seed, target)
                found = {one["name"]: one for one in calibration["extrinsics"]}
                missing = sorted(truth.keys() - found.keys())
                if missing:
                    print(f"{seed} {way}: without {missing}: {calibration['verdict']}")
                    continue
                errors = {name: errors_in_std(found[name], truth[name]) for name in truth}
                for name, numbers in errors.items():
                    pooled[way, "rotation"] += numbers[:3]
                    pooled[way, "translation"] += numbers[3:]
                    by_name.setdefault((way, name), []).extend(numbers)
                name, worst = max(
                    ((name, max(numbers, key=abs)) for name, numbers in errors.items()),
                    key=lambda one: abs(one[1]),
                )
                beyond = sum(abs(x) > 3 for numbers in errors.values() for x in numbers)
                print(f"{seed} {way}: {beyond} of 30 beyond 3, worst {worst:+.2f} ({name})", flush=True)
    report(given.by, pooled, by_name)


def rms(numbers):
    return math.sqrt(sum(x * x for x in numbers) / max(len(numbers), 1))


def report(ways, pooled, by_name):
    for (way, name), numbers in by_name.items():
        print(f"{way} {name}: rms {rms(numbers):.2f}")
    for way in ways:
        rotations, translations = pooled[way, "rotation"], pooled[way, "translation"]
        numbers = rotations + translations
        beyond = sum(abs(x) > 3 for x in numbers)
        print(
            f"{way}: {beyond} of {len(numbers)} beyond 3 standard deviations"
            f" (a Gaussian: {GAUSSIAN_BEYOND_3 * len(numbers):.1f}),"
            f" worst {max(map(abs, numbers), default=0.0):.2f};"
            f" rms {rms(numbers):.2f}, rotations {rms(rotations):.2f}, translations {rms(translations):.2f}"
        )


if __name__ == "__main__":
    main()
