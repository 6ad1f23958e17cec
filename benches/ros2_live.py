"""A driver over DDS beside the daemon: `target/venv/bin/python benches/ros2_live.py PLUMB [SECONDS] [RESTARTS]`.

1280×720 mono8 at 30 a second from Eclipse Cyclone DDS, in a process of its own, on loopback: images lost, CPU time and
memory of the daemon; then the driver is killed and started again, and what the daemon says of it.
"""

import os
import statistics
import subprocess
import sys
import tempfile
import threading
import time
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT / "tests/python"))

FPS = int(os.environ.get("BENCH_FPS", 30))
TICKS = os.sysconf("SC_CLK_TCK")


def drive(count):
    """Publishes `count` images, or endlessly."""
    import numpy as np
    from cyclonedds.idl._machinery import PlainCdrV2SequenceOfPrimitiveMachine as Sequence

    import ros2_graph as ros

    def write_whole(self, buffer, value, *_):
        buffer.align(4)
        buffer.write("I", 4, len(value))
        buffer.write_bytes(value)

    # Byte by byte, as the package has it, this machine does not reach 30 images a second.
    Sequence.serialize = write_whole

    participant = ros.DomainParticipant(int(os.environ["BENCH_DOMAIN"]))
    driver = ros.Publisher(participant, "/front/image_raw", ros.Image)
    driver.wait_for_reader()
    pixels = np.random.default_rng(1).integers(0, 256, (720, 1280), np.uint8)
    message = ros.image(pixels, 1)
    start, sent = time.monotonic(), 0
    while not count or sent < count:
        message.header.stamp = ros.Time(int(time.time()), sent % 10**9)
        driver.send(message)
        sent += 1
        time.sleep(max(0.0, start + sent / FPS - time.monotonic()))
    print(f"sent {sent} in {time.monotonic() - start:.1f} s", flush=True)
    sys.stdin.read()


def usage(pid):
    """CPU seconds and resident megabytes."""
    fields = Path(f"/proc/{pid}/stat").read_text().rsplit(") ", 1)[1].split()
    resident = int(Path(f"/proc/{pid}/statm").read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE") / 1e6
    return (int(fields[11]) + int(fields[12])) / TICKS, resident


def main(binary, seconds, restarts):
    import ros2_graph as ros
    from served import Daemon

    environment = {**os.environ, "BENCH_DOMAIN": str(ros.DOMAIN)}

    def driver(count):
        return subprocess.Popen([sys.executable, __file__, "drive", str(count)], env=environment,
                                stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)

    source = f'{{ kind = "ros2", topic = "/front/image_raw", domain_id = {ros.DOMAIN} }}'
    config = f'[[camera]]\nname = "front"\nsource = {source}\n'
    with tempfile.TemporaryDirectory() as folder, Daemon(binary, config, Path(folder), ROS_LOCALHOST_ONLY="1") as plumb:
        events = plumb.events("front")
        process = driver(FPS * seconds)
        plumb.wait_for_state(events, "front", lambda status: status["state"] == "streaming")
        (cpu, memory), began, memories = usage(plumb.process.pid), time.monotonic(), []
        said = threading.Thread(target=lambda: print(process.stdout.readline().strip()))
        said.start()
        while said.is_alive():
            said.join(10)
            memories.append(f"{usage(plumb.process.pid)[1]:.0f}")
        cpu_s, took_s = usage(plumb.process.pid)[0] - cpu, time.monotonic() - began
        status = plumb.ask("/v1/cameras/front")
        print(f"received {status['frames']}, dropped {status['dropped_frames']}; "
              f"{cpu_s / took_s * 100:.1f} % of a core, {cpu_s / status['frames'] * 1000:.2f} ms an image; "
              f"{memory:.0f} MB at the start, then every 10 s {' '.join(memories)}")
        process.kill()
        process.wait()
        lost, back = [], []
        for _ in range(restarts):
            plumb.wait_for_state(events, "front", lambda status: status["state"] == "lost")
            process = driver(0)
            began = time.monotonic()
            plumb.wait_for_state(events, "front", lambda status: status["state"] == "streaming")
            back.append(time.monotonic() - began)
            process.kill()
            process.wait()
            began = time.monotonic()
            plumb.wait_for_state(events, "front", lambda status: status["state"] == "lost")
            lost.append(time.monotonic() - began)
        print(f"{restarts} times killed: lost was said after {statistics.median(lost):.1f} s (worst {max(lost):.1f}), "
              f"streaming after {statistics.median(back):.1f} s (worst {max(back):.1f}) of the driver's start")


if __name__ == "__main__":
    if sys.argv[1] == "drive":
        drive(int(sys.argv[2]))
    else:
        main(sys.argv[1], *(int(argument) for argument in (sys.argv[2:] + ["60", "20"][len(sys.argv) - 2:])))
