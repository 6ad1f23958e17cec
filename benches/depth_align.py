#!/usr/bin/env python3
"""What color and depth together cost on one core: the whole solve, and depth corrected and registered to color, beside
librealsense's own align on the same depth images.

    cargo build --release
    pip install numpy opencv-python-headless pyrealsense2 mcap mcap-protobuf-support && python benches/depth_align.py [--views 60]

librealsense's align knows no correction of depth and is given lenses without distortion, which is its fastest case. Prints a
line of JSON for each: milliseconds, the fastest of some runs for each image, in the median over all images.
"""

import argparse
import json
import os
import statistics
import subprocess
import tempfile
import time
from pathlib import Path

import cv2
import numpy as np
import pyrealsense2 as rs

ROOT = Path(__file__).resolve().parent.parent
SCENE = "seed = 9\nframes = {frames}\nfps = 5\n[board]\nsquare_m = 0.04\n[walk]\nstill_s = 0.25\ntravel_s = 0.35\n[depth]\n"


def run(plumb, *arguments):
    return json.loads(subprocess.run([plumb, *map(str, arguments)], check=True, capture_output=True).stdout)


def as_intrinsics(lens, size):
    intrinsics = rs.intrinsics()
    intrinsics.width, intrinsics.height = size
    intrinsics.fx, intrinsics.fy, intrinsics.ppx, intrinsics.ppy = (lens[name] for name in ("fx", "fy", "cx", "cy"))
    intrinsics.model, intrinsics.coeffs = rs.distortion.none, [0.0] * 5
    return intrinsics


def rotation_columns(pose):
    w, x, y, z = (pose["rotation"][name] for name in "wxyz")
    rows = [[1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)]]
    return [rows[row][column] for column in range(3) for row in range(3)]


class Aligner:
    """librealsense's align behind a device of software."""

    def __init__(self, calibration):
        self.device, self.sync = rs.software_device(), rs.syncer()
        sensors, profiles = {}, {}
        for uid, (name, kind, form, bytes_each) in enumerate(
                [("depth", rs.stream.depth, rs.format.z16, 2), ("color", rs.stream.color, rs.format.rgb8, 3)]):
            stated = calibration["sensors"][name]
            stream = rs.video_stream()
            stream.type, stream.index, stream.uid, stream.fps, stream.fmt = kind, 0, uid, 30, form
            stream.width, stream.height = stated["image_size"]
            stream.bpp = bytes_each
            stream.intrinsics = as_intrinsics(stated["lens"], stated["image_size"])
            sensor = self.device.add_sensor(name)
            profiles[name] = rs.video_stream_profile(sensor.add_video_stream(stream))
            if name == "depth":
                sensor.add_read_only_option(rs.option.depth_units, 0.001)
            sensors[name] = sensor
        pose = next(p for p in calibration["extrinsics"] if p["name"] == "color_from_depth")
        between = rs.extrinsics()
        between.rotation, between.translation = rotation_columns(pose), pose["translation"]
        profiles["depth"].register_extrinsics_to(profiles["color"], between)
        self.device.create_matcher(rs.matchers.default)
        for name, sensor in sensors.items():
            sensor.open(profiles[name])
            sensor.start(self.sync)
        self.sensors, self.profiles, self.number = sensors, profiles, 0
        self.color = np.zeros((*reversed(calibration["sensors"]["color"]["image_size"]), 3), np.uint8)

    def frames(self, depth):
        """The pair as one frame set; the first one or two of a device are not given on."""
        while True:
            self.send(depth)
            arrived, frames = self.sync.try_wait_for_frames(200)
            if arrived and frames.size() == 2:
                return frames

    def send(self, depth):
        self.number += 1
        for name, pixels in (("depth", depth), ("color", self.color)):
            frame = rs.software_video_frame()
            frame.pixels, frame.bpp = pixels, pixels.itemsize * (pixels.shape[2] if pixels.ndim == 3 else 1)
            frame.stride = pixels.strides[0]
            frame.timestamp, frame.domain = self.number * 33.0, rs.timestamp_domain.hardware_clock
            frame.frame_number, frame.profile = self.number, self.profiles[name]
            if name == "depth":
                frame.depth_units = 0.001
            self.sensors[name].on_video_frame(frame)


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--plumb", default=ROOT / "target/release/plumb")
    parser.add_argument("--views", type=int, default=60)
    parser.add_argument("--repeat", type=int, default=20)
    options = parser.parse_args()
    os.sched_setaffinity(0, {min(os.sched_getaffinity(0))})
    with tempfile.TemporaryDirectory() as folder:
        folder = Path(folder)
        recording, written = ROOT / "recordings/rgbd.mcap", folder / "calibration.json"
        board = ["--board", "9x6", "--square", "40mm", "--lens", "brown"]
        calibration = run(options.plumb, "calibrate", "--json", "--out", written, *board, recording)
        report = run(options.plumb, "correct", "--json", "--calibration", written, "--register", "color",
                     "--repeat", options.repeat, "--out", folder / "registered", recording)
        plumb_ms = [one["elapsed_ms"] for one in report["written"]]
        alone = run(options.plumb, "correct", "--json", "--calibration", written, "--repeat", options.repeat,
                    "--out", folder / "depth", recording)
        corrected_ms = [one["elapsed_ms"] for one in alone["written"]]
        images = [cv2.imread(str(path), cv2.IMREAD_UNCHANGED) for path in sorted((folder / "depth").glob("*.png"))]
        aligner, align, peer_ms = Aligner(calibration), rs.align(rs.stream.color), []
        for depth in images:
            frames, least = aligner.frames(depth), float("inf")
            for _ in range(options.repeat):
                began = time.perf_counter()
                aligned = align.process(frames)
                least = min(least, (time.perf_counter() - began) * 1e3)
            assert np.count_nonzero(np.asanyarray(aligned.get_depth_frame().get_data())) > 0.5 * np.count_nonzero(depth)
            peer_ms.append(least)
        print(json.dumps({"what": "corrected and registered to color", "images": len(plumb_ms),
                          "plumb_ms": round(statistics.median(plumb_ms), 2),
                          "plumb_corrected_only_ms": round(statistics.median(corrected_ms), 2),
                          "librealsense_align_ms": round(statistics.median(peer_ms), 2)}))
        # A folder, whose every frame set is a view.
        scene, walk = folder / "scene.toml", folder / "walk.mcap"
        scene.write_text(SCENE.format(frames=options.views))
        subprocess.run([options.plumb, "simulate", "--config", scene, "--out", walk], check=True, capture_output=True)
        views = as_folder(options.plumb, walk, folder / "views")
        solved = run(options.plumb, "calibrate", "--json", *board, views)
        used = sum(view["used"] for view in solved["sensors"]["color"]["views"])
        print(json.dumps({"what": "whole solve", "views": used, "plumb_ms": round(solved["elapsed_ms"], 1)}))


def as_folder(plumb, recording, folder):
    from mcap.reader import make_reader
    from mcap_protobuf.decoder import DecoderFactory

    (folder / "sensors.toml").parent.mkdir()
    (folder / "sensors.toml").write_text('[depth]\nkind = "depth"\nunit_m = 0.001\n')
    counts = {}
    with open(recording, "rb") as file:
        for _, channel, _, message in make_reader(file, decoder_factories=[DecoderFactory()]).iter_decoded_messages():
            sensor = channel.topic.split("/")[-1]
            if sensor not in ("color", "infrared", "depth"):
                continue
            counts[sensor] = counts.get(sensor, -1) + 1
            name = folder / sensor / f"{counts[sensor]:03}"
            name.parent.mkdir(exist_ok=True)
            if hasattr(message, "step"):
                dtype = np.uint16 if message.encoding == "16UC1" else np.uint8
                pixels = np.frombuffer(message.data, dtype).reshape(message.height, message.width)
                cv2.imwrite(f"{name}.png", pixels)
            else:
                name.with_suffix(".png" if message.format == "png" else ".jpg").write_bytes(message.data)
    return folder


if __name__ == "__main__":
    main()
