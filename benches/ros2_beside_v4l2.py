"""What an image costs the daemon through DDS and through V4L2: `target/venv/bin/python benches/ros2_beside_v4l2.py PLUMB [SECONDS] [FPS]`.

The same 1280×720 mono8 images, first through a v4l2loopback device, then from Eclipse Cyclone DDS on loopback, in two
rounds: images received and dropped, CPU time and memory of the daemon. Both run in the small machine of the device tests
(its kernel has V4L2), whose CPUs are emulated and many times slower than others: the ratio is what counts. So FPS is 5
unless said.
"""

import fcntl
import os
import struct
import subprocess
import sys
import tempfile
import time
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
DEVICE = "/dev/video20"
WIDTH, HEIGHT = 1280, 720
# From linux/videodev2.h, for 64 bits.
VIDIOC_S_FMT, VIDEO_OUTPUT, FORMAT_BYTES, FIELD_NONE = 0xC0D05605, 2, 208, 1
ROUNDS = 2
WARM_UP_S = 5
LIMIT_S = 600


def feed(fps):
    """Writes images to the device, endlessly."""
    import numpy as np

    pixels = np.random.default_rng(1).integers(0, 256, (HEIGHT, WIDTH), np.uint8).tobytes()
    with open(DEVICE, "wb", buffering=0) as device:
        stated = struct.pack("II8I", VIDEO_OUTPUT, 0, WIDTH, HEIGHT, int.from_bytes(b"GREY", "little"), FIELD_NONE, WIDTH, len(pixels), 0, 0)
        fcntl.ioctl(device, VIDIOC_S_FMT, stated.ljust(FORMAT_BYTES, b"\0"))
        start, sent = time.monotonic(), 0
        while True:
            device.write(pixels)
            sent += 1
            time.sleep(max(0.0, start + sent / fps - time.monotonic()))


def measure(what, source, feeder, binary, seconds):
    import ros2_live
    from served import Daemon

    with tempfile.TemporaryDirectory() as folder:
        process = subprocess.Popen([sys.executable, *feeder], stdin=subprocess.PIPE, stdout=subprocess.DEVNULL)
        config = f'[[camera]]\nname = "front"\nsource = {source}\n'
        try:
            with Daemon(binary, config, Path(folder), ROS_LOCALHOST_ONLY="1") as plumb:
                plumb.wait_for_state(plumb.events("front"), "front", lambda status: status["state"] == "streaming")
                time.sleep(WARM_UP_S)
                status, (cpu, _), began = plumb.ask("/v1/cameras/front"), ros2_live.usage(plumb.process.pid), time.monotonic()
                time.sleep(seconds)
                after, (cpu_after, memory), ended = plumb.ask("/v1/cameras/front"), ros2_live.usage(plumb.process.pid), time.monotonic()
        finally:
            process.kill()
            process.wait()
    images, dropped = (after[field] - status[field] for field in ("frames", "dropped_frames"))
    cpu_s, took_s = cpu_after - cpu, ended - began
    print(f"{what}: {images} images in {took_s:.1f} s, {dropped} dropped; {cpu_s / took_s * 100:.1f} % of a core, "
          f"{cpu_s / images * 1000:.2f} ms an image; {memory:.0f} MB", flush=True)


def in_the_small_machine(binary, seconds, fps):
    sys.path.insert(0, str(ROOT / "tests/python"))
    import ros2_graph as ros

    os.environ.update(BENCH_DOMAIN=str(ros.DOMAIN), BENCH_FPS=fps)
    live = str(ROOT / "benches/ros2_live.py")
    paths = {
        "V4L2": (f'{{ kind = "v4l2", device = "{DEVICE}", width = {WIDTH}, height = {HEIGHT}, format = "GREY" }}', [__file__, "feed", fps]),
        "DDS": (f'{{ kind = "ros2", topic = "/front/image_raw", domain_id = {ros.DOMAIN} }}', [live, "drive", "0"]),
    }
    for _ in range(ROUNDS):
        for what, (source, feeder) in paths.items():
            measure(what, source, feeder, binary, float(seconds))


def main(binary, seconds="30", fps="5"):
    script = ROOT / "tests/device/small_machine.sh"
    subprocess.run([script, "prepare"], check=True)
    program = [sys.executable, __file__, "inside", str(Path(binary).resolve()), seconds, fps]
    module = f"v4l2loopback devices=1 video_nr={DEVICE.removeprefix('/dev/video')} card_label=Beside exclusive_caps=0"
    subprocess.run([script, "run", "-t", str(LIMIT_S), "-m", module, "--", *program], check=True)


if __name__ == "__main__":
    if sys.argv[1] == "feed":
        feed(float(sys.argv[2]))
    elif sys.argv[1] == "inside":
        in_the_small_machine(*sys.argv[2:])
    else:
        main(*sys.argv[1:])
