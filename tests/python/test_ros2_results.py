"""What Plumb says on the graph of ROS 2, as Eclipse Cyclone DDS reads it."""

import pytest

import ros2_graph as ros
from served import Daemon
from test_recordings import RECORDINGS
from test_ros2_live import participant, publish_walk, walk  # noqa: F401

DRIVEN = """
[calibration]
auto_approve = false
[ros2]
publish = true
domain_id = {domain}
session = {{ target = {{ kind = "chessboard", cols = 9, rows = 6, square_m = 0.025 }}, lens = "{lens}" }}
[[camera]]
name = "front"
source = {{ kind = "ros2", topic = "/front/image_raw", domain_id = {domain} }}
"""
RGBD = """
[calibration]
auto_approve = false
[ros2]
publish = true
domain_id = {domain}
[[camera]]
name = "arm"
source = {{ kind = "recording", path = "{path}", pace = "fastest" }}
"""
ROS_NAMES = {
    "brown": ("plumb_bob", ["k1", "k2", "p1", "p2", "k3"]),
    "rational": ("rational_polynomial", ["k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6"]),
    "kannala_brandt": ("equidistant", ["k1", "k2", "k3", "k4"]),
}


def assert_states(info, sensor, frame_id):
    """Whether the message says what the document says of the sensor, to the last bit."""
    lens = sensor["lens"]
    name, parameters = ROS_NAMES[lens["model"]]
    fx, fy, cx, cy = (lens[name] for name in ("fx", "fy", "cx", "cy"))
    assert [info.width, info.height] == sensor["image_size"]
    assert (info.header.frame_id, info.distortion_model) == (frame_id, name)
    assert list(info.d) == [lens[parameter] for parameter in parameters]
    assert list(info.k) == [fx, 0, cx, 0, fy, cy, 0, 0, 1]
    assert list(info.r) == [1, 0, 0, 0, 1, 0, 0, 0, 1]
    assert list(info.p) == [fx, 0, cx, 0, 0, fy, cy, 0, 0, 0, 1, 0]
    assert (info.binning_x, info.binning_y, info.roi) == (0, 0, ros.RegionOfInterest())


def trigger(participant, name):
    return ros.Client(participant, f"/plumb/front/{name}", ros.TriggerRequest, ros.TriggerResponse)


@pytest.mark.parametrize("lens", ROS_NAMES)
def test_a_session_by_services_ends_in_a_calibration_that_the_driver_keeps(lens, walk, participant, plumb_binary, tmp_path):  # noqa: F811
    images = ros.Publisher(participant, "/front/image_raw", ros.Image)
    asked = ros.Subscriber(participant, "/front/set_camera_infoRequest", ros.SetCameraInfoRequest, prefix="rq")
    answers = ros.Publisher(participant, "/front/set_camera_infoReply", ros.SetCameraInfoResponse, prefix="rr")
    state = ros.Subscriber(participant, "/plumb/front/state", ros.String, latched=True)
    diagnostics = ros.Subscriber(participant, "/diagnostics", ros.DiagnosticArray)
    config = DRIVEN.format(domain=ros.DOMAIN, lens=lens)
    with Daemon(plumb_binary, config, tmp_path, ROS_LOCALHOST_ONLY="1") as plumb:
        events = plumb.events("front")
        assert state.take().data == "idle"
        images.wait_for_reader()
        stop = trigger(participant, "stop")
        early = stop.call(ros.TriggerRequest())
        assert (early.success, early.message) == (False, "no session runs; start one first")
        started = trigger(participant, "start").call(ros.TriggerRequest())
        assert started.success and started.message.endswith("collects"), started
        assert state.take().data == "collecting"
        publish_walk(walk, images, events, every=3)
        stopped = stop.call(ros.TriggerRequest())
        assert stopped.success, stopped
        identity = stopped.message.removeprefix("calibration ")
        state.take_until(lambda message: message.data == "finished")
        uncalibrated = diagnostics.take_until(lambda array: "no approved calibration" in array.status[0].message)
        assert uncalibrated.status[0].level == 1

        plumb.ask(f"/v1/calibrations/{identity}/approve", {})
        sensor = plumb.ask(f"/v1/calibrations/{identity}")["sensors"]["color"]
        request = asked.take()
        assert_states(request.camera_info, sensor, "front_optical_frame")
        answers.wait_for_reader()
        answers.send(ros.SetCameraInfoResponse(request.client, request.count, True, ""))
        # Who comes late hears of it too.
        info = ros.Subscriber(participant, "/plumb/front/camera_info", ros.CameraInfo, latched=True).take()
        assert_states(info, sensor, "front_optical_frame")

        def is_kept(array):
            return ("set_camera_info", "kept") in [(pair.key, pair.value) for pair in array.status[0].values]

        said = diagnostics.take_until(is_kept).status[0]
        values = {pair.key: pair.value for pair in said.values}
        assert said.name == "plumb: front" and values["calibration"] == identity and values["drift"] == "none"
        assert float(values["age_days"]) < 0.01 and values["verdict"] in ("good", "usable", "poor")


def test_sensors_of_a_camera_are_placed_by_tf_static(participant, plumb_binary, tmp_path):  # noqa: F811
    config = RGBD.format(domain=ros.DOMAIN, path=RECORDINGS / "rgbd.mcap")
    with Daemon(plumb_binary, config, tmp_path, ROS_LOCALHOST_ONLY="1") as plumb:
        board = {"kind": "chessboard", "cols": 9, "rows": 6, "square_m": 0.04}
        events = plumb.events("arm")
        session = plumb.ask("/v1/cameras/arm/sessions", {"target": board, "lens": "brown"})
        seen = 0
        for kind, _ in events:
            seen += kind == "detection"
            if seen == 42:
                break
        finished = plumb.ask(f"/v1/sessions/{session['id']}/stop", {})
        assert finished["state"] == "finished", finished["reason"]
        plumb.ask(f"/v1/calibrations/{finished['calibration']}/approve", {})
        document = plumb.ask(f"/v1/calibrations/{finished['calibration']}")
        said = ros.Subscriber(participant, "/tf_static", ros.TFMessage, latched=True).take()
        placed = {transform.child_frame_id: transform for transform in said.transforms}
        assert len(placed) == 2 and document["extrinsics"], said
        for extrinsics in document["extrinsics"]:
            target, _, source = extrinsics["name"].partition("_from_")
            if target != "color":
                continue
            transform = placed[f"arm_{source}_optical_frame"]
            assert transform.header.frame_id == "arm_optical_frame"
            moved, turned = transform.transform.translation, transform.transform.rotation
            assert [moved.x, moved.y, moved.z] == extrinsics["translation"]
            assert [turned.w, turned.x, turned.y, turned.z] == [extrinsics["rotation"][name] for name in "wxyz"]
        color = ros.Subscriber(participant, "/plumb/arm/camera_info", ros.CameraInfo, latched=True).take()
        assert_states(color, document["sensors"]["color"], "arm_optical_frame")
        infrared = ros.Subscriber(participant, "/plumb/arm/infra1/camera_info", ros.CameraInfo, latched=True).take()
        assert_states(infrared, document["sensors"]["infrared"], "arm_infrared_optical_frame")
