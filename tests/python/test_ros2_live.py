"""A camera whose driver publishes over DDS: Eclipse Cyclone DDS is the driver."""

import itertools
import json
import os
import socket
import subprocess

import cv2
import numpy as np
import pytest

import ros2_graph as ros
from served import Daemon
from test_recordings import RECORDINGS, frames

CAMERA = '[[camera]]\nname = "front"\nsource = {{ kind = "ros2", topic = "{topic}", domain_id = {domain} }}\n'
TARGET = {"kind": "chessboard", "cols": 9, "rows": 6, "square_m": 0.025}
START_NS = 1_700_000_000_000_000_000


@pytest.fixture(scope="module")
def walk():
    """The gray images of the bundled walk."""
    messages, _ = frames(RECORDINGS / "walk.mcap")
    return [cv2.imdecode(np.frombuffer(m.data, np.uint8), cv2.IMREAD_GRAYSCALE) for _, _, m, _ in messages]


@pytest.fixture
def participant():
    return ros.DomainParticipant(ros.DOMAIN)


@pytest.fixture
def daemon(plumb_binary, tmp_path):
    """A daemon with the camera `front` on a topic; further configuration goes before it."""

    def start(topic="/front/image_raw", more=""):
        camera = CAMERA.format(topic=topic, domain=ros.DOMAIN)
        return Daemon(plumb_binary, more + camera, tmp_path, ROS_LOCALHOST_ONLY="1")

    return start


def publish_walk(walk, driver, events, every=1, message=ros.image):
    """Shows the walk frame by frame: the next one when Plumb has searched the one before."""
    until_searched(driver, events, lambda stamp_ns: message(np.full_like(walk[0], 128), stamp_ns))
    for index, pixels in enumerate(walk[::every]):
        driver.send(message(pixels, START_NS + index * 10**9 // 15))
        next(event for kind, event in events if kind == "detection")


def until_searched(driver, events, blank):
    """Shows nothing until a session that has begun searches what comes, and has searched all of it."""
    sent, sequences, searched = [], {}, set()

    def blanks():
        for nanoseconds in itertools.count():
            sent.append(nanoseconds)
            yield blank(START_NS - 10**9 + nanoseconds)

    def take(kind, event):
        if kind == "frame":
            _, _, fraction = event["received_at"].rstrip("Z").partition(".")
            sequences[int(fraction.ljust(9, "0"))] = event["sequence"]
        elif kind == "detection":
            searched.add(event["sequence"])

    with driver.going_on(blanks()):
        while not searched:
            take(*next(events))
    while sequences.get(sent[-1]) not in searched:
        take(*next(events))


def jpeg(pixels, stamp_ns):
    data = cv2.imencode(".jpg", pixels, [cv2.IMWRITE_JPEG_QUALITY, 95])[1].tobytes()
    return ros.CompressedImage(ros.image(pixels, stamp_ns).header, "mono8; jpeg compressed mono8", data)


@pytest.mark.parametrize("kind", ["raw", "best effort", "compressed"])
def test_a_walk_over_dds_is_calibrated_over_http(kind, walk, participant, daemon):
    topic = "/front/image_raw" + ("/compressed" if kind == "compressed" else "")
    with daemon(topic) as plumb:
        events = plumb.events("front")
        absent = plumb.wait_for_state(events, "front", lambda status: status["state"] == "lost")
        assert absent["reason"] == f"{topic} was lost: no publisher in domain {ros.DOMAIN}, and no topic at all; start the driver"
        how = {"reliability": ros.BEST_EFFORT} if kind == "best effort" else {}
        driver = ros.Publisher(participant, topic, ros.CompressedImage if kind == "compressed" else ros.Image, **how)
        driver.wait_for_reader()
        session = plumb.ask("/v1/cameras/front/sessions", {"target": TARGET, "lens": "brown"})
        publish_walk(walk, driver, events, every=2, message=jpeg if kind == "compressed" else ros.image)
        finished = plumb.ask(f"/v1/sessions/{session['id']}/stop", {})
        assert finished["state"] == "finished", finished["reason"]
        calibration = plumb.ask(f"/v1/calibrations/{finished['calibration']}")["sensors"]["color"]
        truth = json.loads((RECORDINGS / "walk.truth.json").read_text())["sensors"]["color"]["lens"]
        for name in ("fx", "fy", "cx", "cy"):
            off = abs(calibration["lens"][name] - truth[name])
            assert off < 4 * calibration["lens_std"][name], (name, off, calibration["lens_std"][name])
        status = plumb.ask("/v1/cameras/front")
        assert (status["state"], status["backend"], status["dropped_frames"]) == ("streaming", "ros2", 0), status


def test_what_the_driver_states_is_the_stated_calibration(walk, participant, daemon):
    driver = ros.Publisher(participant, "/front/image_raw", ros.Image)
    info = ros.Publisher(participant, "/front/camera_info", ros.CameraInfo)
    stated = ros.CameraInfo(height=480, width=640, distortion_model="plumb_bob", d=[-0.1, 0.02, 0.001, -0.002, 0.0],
                            k=[600.0, 0, 320.0, 0, 601.0, 240.0, 0, 0, 1])
    with daemon() as plumb:
        events = plumb.events("front")
        driver.wait_for_reader()
        info.wait_for_reader()
        info.send(stated)
        driver.send(ros.image(walk[0], START_NS))
        status = plumb.wait_for_state(events, "front", lambda status: status["state"] == "streaming")
        assert "plumb_bob" in json.dumps(status), status


def test_a_publisher_that_ends_and_comes_back(walk, participant, daemon):
    with daemon() as plumb:
        events = plumb.events("front")
        for _ in range(3):
            driver = ros.Publisher(participant, "/front/image_raw", ros.Image)
            # Again and again: the reader that is found first may be the one that was lost.
            with driver.going_on(itertools.repeat(ros.image(walk[0], START_NS))):
                plumb.wait_for_state(events, "front", lambda status: status["state"] == "streaming")
            del driver
            gone = plumb.wait_for_state(events, "front", lambda status: status["state"] == "lost")
            assert "the publisher of /front/image_raw is gone" in gone["reason"], gone


def test_images_from_before_a_silence_are_none_of_now(walk, participant, daemon):
    with daemon() as plumb:
        events = plumb.events("front")
        driver = ros.Publisher(participant, "/front/image_raw", ros.Image)
        driver.wait_for_reader()
        for index in range(3):
            driver.send(ros.image(walk[index], START_NS + index * 10**9))
        status = plumb.wait_for_state(events, "front", lambda status: (status["reason"] or "").startswith("no frame for 1."))
        # Opened again, it gives nothing.
        again = plumb.wait_for_state(events, "front", lambda status: (status["reason"] or "").startswith("no frame for 4."))
        assert (again["state"], again["frames"]) == ("lost", status["frames"]), again


WRONG = {
    "another type": (ros.String, lambda walk: [ros.String("hello")], "/front/image_raw has the type std_msgs/msg/String"),
    "too little data": (
        ros.Image,
        lambda walk: [ros.Image(ros.Header(), 480, 640, "mono8", 0, 640, bytes(1000))],
        "/front/image_raw has 640x480 images with rows every 640 bytes and 1000 bytes of data",
    ),
    "an unknown encoding": (
        ros.Image,
        lambda walk: [ros.Image(ros.Header(), 480, 640, "h264", 0, 640, bytes(640 * 480))],
        '/front/image_raw has images encoded as "h264"',
    ),
    "another size": (
        ros.Image,
        lambda walk: [ros.image(walk[0], START_NS), ros.image(walk[0][:240], START_NS + 10**9)],
        "its color images changed from 640x480 to 640x240",
    ),
}


@pytest.mark.parametrize("fault", WRONG)
def test_what_is_wrong_is_one_line(fault, walk, participant, daemon):
    type_, messages, expected = WRONG[fault]
    with daemon() as plumb:
        events = plumb.events("front")
        driver = ros.Publisher(participant, "/front/image_raw", type_)
        if type_ is ros.Image:
            driver.wait_for_reader()
        # Again and again: a message sent before the reader has found the writer too is lost.
        with driver.going_on(itertools.cycle(messages(walk))):
            said = plumb.wait_for_state(events, "front", lambda status: expected in (status["reason"] or "").replace("×", "x"))
        assert said["state"] == "lost" and "\n" not in said["reason"]


def test_two_publishers_on_one_topic(walk, participant, daemon):
    with daemon() as plumb:
        events = plumb.events("front")
        drivers = [ros.Publisher(participant, "/front/image_raw", ros.Image) for _ in range(2)]
        for driver in drivers:
            driver.wait_for_reader()
        for number in range(4):
            drivers[number % 2].send(ros.image(walk[0], START_NS + number * 10**9))
        expected = "two publishers send on /front/image_raw, and a camera has one: stop one of them"
        said = plumb.wait_for_state(events, "front", lambda status: expected in (status["reason"] or ""))
        assert said["state"] == "lost"


def test_a_publisher_that_offers_less_than_before_is_named(walk, participant, daemon):
    with daemon() as plumb:
        events = plumb.events("front")
        driver = ros.Publisher(participant, "/front/image_raw", ros.Image)
        driver.wait_for_reader()
        driver.send(ros.image(walk[0], START_NS))
        plumb.wait_for_state(events, "front", lambda status: status["state"] == "streaming")
        other = ros.Publisher(participant, "/front/image_raw", ros.Image, reliability=ros.BEST_EFFORT)
        expected = "a publisher of /front/image_raw changed its QoS: Reliability"
        said = plumb.wait_for_state(events, "front", lambda status: expected in (status["reason"] or ""))
        assert said["state"] == "lost" and "\n" not in said["reason"], said
        del other


def test_a_domain_without_a_free_place_is_one_line(plumb_binary, tmp_path):
    """DDS has two ports for each of up to 120 participants in a domain: all are taken."""
    domain, taken = 1 + (ros.DOMAIN + 30) % 200, []
    for port in (7400 + 250 * domain + 10 + place for place in range(242)):
        socket_ = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        socket_.bind(("", port))
        taken.append(socket_)
    config = CAMERA.format(topic="/front/image_raw", domain=domain)
    with Daemon(plumb_binary, config, tmp_path, ROS_LOCALHOST_ONLY="1") as plumb:
        events = plumb.events("front")
        said = plumb.wait_for_state(events, "front", lambda status: status["state"] == "failed")
        assert said["reason"].startswith(f"the DDS domain {domain} cannot be joined: "), said
        assert said["reason"].endswith("end other participants in it, or choose another domain_id") and "\n" not in said["reason"]
    for socket_ in taken:
        socket_.close()


def test_depth_comes_with_color(walk, participant, daemon):
    with daemon(topic='/front/image_raw", depth = "/front/depth/image_rect_raw') as plumb:
        events = plumb.events("front")
        color = ros.Publisher(participant, "/front/image_raw", ros.Image)
        depth = ros.Publisher(participant, "/front/depth/image_rect_raw", ros.Image)
        for publisher in (color, depth):
            publisher.wait_for_reader()
        color.send(ros.image(walk[0], START_NS))
        depth.send(ros.image(np.full((240, 320), 1234, np.uint16), START_NS, encoding="16UC1"))
        status = plumb.wait_for_state(events, "front", lambda status: status["state"] == "streaming")
        sensors = {name: sensor["image_size"] for name, sensor in status["sensors"].items()}
        assert sensors == {"color": [640, 480], "depth": [320, 240]}, status


def test_topics_of_images_are_listed(walk, participant, plumb_binary):
    driver = ros.Publisher(participant, "/front/image_raw", ros.Image)
    ros.Publisher(participant, "/front/name", ros.String)
    environment = {**os.environ, "ROS_LOCALHOST_ONLY": "1", "ROS_DOMAIN_ID": str(ros.DOMAIN)}
    listed = subprocess.run([plumb_binary, "devices", "--json"], capture_output=True, text=True, timeout=60, env=environment, check=True)
    backend = next(backend for backend in json.loads(listed.stdout)["backends"] if backend["backend"] == "ros2")
    assert [(device["device"], device["name"]) for device in backend["devices"]] == [(driver.name, "sensor_msgs/msg/Image")]


def test_camera_info_comes_with_each_image(walk, participant, plumb_binary, tmp_path):
    config = (f'[ros2]\npublish = true\ndomain_id = {ros.DOMAIN}\ncamera_info_with_images = true\n'
              + CAMERA.format(topic="/front/image_raw", domain=ros.DOMAIN))
    with Daemon(plumb_binary, config, tmp_path, ROS_LOCALHOST_ONLY="1") as plumb:
        events = plumb.events("front")
        driver = ros.Publisher(participant, "/front/image_raw", ros.Image)
        driver.wait_for_reader()
        session = plumb.ask("/v1/cameras/front/sessions", {"target": TARGET, "lens": "brown"})
        publish_walk(walk, driver, events, every=3)
        finished = plumb.ask(f"/v1/sessions/{session['id']}/stop", {})
        plumb.ask(f"/v1/calibrations/{finished['calibration']}/approve", {})
        infos = ros.Subscriber(participant, "/plumb/front/camera_info", ros.CameraInfo, latched=True)
        latched = infos.take()
        for stamp_ns in (START_NS + 60 * 10**9 + 7, START_NS + 61 * 10**9):
            driver.send(ros.image(walk[0], stamp_ns))
            info = infos.take_until(lambda info: info.header.stamp == ros.Time(stamp_ns // 10**9, stamp_ns % 10**9))
            assert (list(info.k), list(info.d)) == (list(latched.k), list(latched.d))
