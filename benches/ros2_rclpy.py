"""ROS 2 itself, with Fast DDS, as the other side: rclpy publishes the bundled walk, starts and stops a session by its services, keeps
the calibration by `set_camera_info`, and reads `camera_info` and the session's state.

    python3 -m venv /tmp/ros && /tmp/ros/bin/pip install ros-rclpy ros-sensor-msgs ros-std-srvs ros-rmw-fastrtps-cpp opencv-python-headless mcap mcap-protobuf-support foxglove-schemas-protobuf
    /tmp/ros/bin/python benches/ros2_rclpy.py target/debug/plumb [best_effort]

79 packages and 300 MB, so it is no part of `make test`. Prints one line of JSON.
"""

import json
import os
import sys
import tempfile
import threading
import time
from pathlib import Path

DOMAIN = 1 + os.getpid() % 200
os.environ.update(ROS_DOMAIN_ID=str(DOMAIN), ROS_AUTOMATIC_DISCOVERY_RANGE="LOCALHOST")
sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests" / "python"))

import cv2  # noqa: E402
import numpy as np  # noqa: E402
import rclpy  # noqa: E402
from mcap.reader import make_reader  # noqa: E402
from mcap_protobuf.decoder import DecoderFactory  # noqa: E402
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy  # noqa: E402
from sensor_msgs.msg import CameraInfo, Image  # noqa: E402
from sensor_msgs.srv import SetCameraInfo  # noqa: E402
from std_msgs.msg import String  # noqa: E402
from std_srvs.srv import Trigger  # noqa: E402

from served import Daemon  # noqa: E402

WALK = Path(__file__).resolve().parents[1] / "recordings" / "walk.mcap"
PATIENCE_S = 60
CONFIG = f"""
[calibration]
auto_approve = false
[ros2]
publish = true
domain_id = {DOMAIN}
session = {{ target = {{ kind = "chessboard", cols = 9, rows = 6, square_m = 0.025 }}, lens = "brown" }}
[[camera]]
name = "front"
source = {{ kind = "ros2", topic = "/front/image_raw", domain_id = {DOMAIN} }}
"""


def walk():
    with WALK.open("rb") as file:
        reader = make_reader(file, decoder_factories=[DecoderFactory()])
        for _, _, _, message in reader.iter_decoded_messages():
            yield cv2.imdecode(np.frombuffer(message.data, np.uint8), cv2.IMREAD_GRAYSCALE)


def until(condition, what):
    end = time.monotonic() + PATIENCE_S
    while not condition():
        assert time.monotonic() < end, f"{PATIENCE_S} s without {what}"
        time.sleep(0.01)


def image(pixels, number):
    message = Image(height=pixels.shape[0], width=pixels.shape[1], encoding="mono8", step=pixels.shape[1], data=pixels.tobytes())
    message.header.stamp.sec, message.header.frame_id = 1_700_000_000 + number, "front_optical_frame"
    return message


def call(client):
    assert client.wait_for_service(PATIENCE_S), client.srv_name
    answer = client.call_async(Trigger.Request())
    until(answer.done, f"an answer of {client.srv_name}")
    return answer.result()


def main(binary, reliability):
    rclpy.init()
    node = rclpy.create_node("driver")
    kept, infos, states = [], [], []

    def keep(request, response):
        kept.append(request.camera_info)
        response.success = True
        return response

    latched = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL, reliability=ReliabilityPolicy.RELIABLE)
    node.create_service(SetCameraInfo, "/front/set_camera_info", keep)
    node.create_subscription(CameraInfo, "/plumb/front/camera_info", infos.append, latched)
    node.create_subscription(String, "/plumb/front/state", lambda message: states.append(message.data), latched)
    images = node.create_publisher(Image, "/front/image_raw", QoSProfile(depth=10, reliability=reliability))
    start, stop = (node.create_client(Trigger, f"/plumb/front/{name}") for name in ("start", "stop"))
    executor = rclpy.executors.MultiThreadedExecutor()
    executor.add_node(node)
    threading.Thread(target=executor.spin, daemon=True).start()
    with tempfile.TemporaryDirectory() as folder, Daemon(binary, CONFIG, Path(folder), ROS_AUTOMATIC_DISCOVERY_RANGE="LOCALHOST") as plumb:
        events = plumb.events("front")
        begun = time.monotonic()
        until(lambda: images.get_subscription_count() > 0, "a subscriber of /front/image_raw")
        discovered_s = time.monotonic() - begun
        started = call(start)
        assert started.success, started.message
        sent = 0
        for number, pixels in enumerate(list(walk())[::3]):
            images.publish(image(pixels, number))
            next(event for kind, event in events if kind == "detection")
            sent += 1
        status = plumb.ask("/v1/cameras/front")
        stopped = call(stop)
        assert stopped.success, stopped.message
        identity = stopped.message.removeprefix("calibration ")
        plumb.ask(f"/v1/calibrations/{identity}/approve", {})
        until(lambda: kept and infos, "camera_info")
        lens = plumb.ask(f"/v1/calibrations/{identity}")["sensors"]["color"]["lens"]
        k = [lens["fx"], 0, lens["cx"], 0, lens["fy"], lens["cy"], 0, 0, 1]
        same = [list(info.k) == k and list(info.d) == [lens[name] for name in ("k1", "k2", "p1", "p2", "k3")] for info in kept + infos]
        print(json.dumps({
            "rmw": rclpy.utilities.get_rmw_implementation_identifier(), "discovered_s": round(discovered_s, 2), "images": sent,
            "dropped_frames": status["dropped_frames"], "state": status["state"], "camera_info_is_the_calibration": same, "states": states,
        }))


if __name__ == "__main__":
    best_effort = "best_effort" in sys.argv[2:]
    main(sys.argv[1], ReliabilityPolicy.BEST_EFFORT if best_effort else ReliabilityPolicy.RELIABLE)
    os._exit(0)
