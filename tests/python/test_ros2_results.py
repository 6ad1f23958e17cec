"""What Plumb says on the graph of ROS 2, as Eclipse Cyclone DDS reads it."""

import signal
import urllib.request

import numpy as np
import pytest
import yaml

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
alpha = 0.25
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


def exported(plumb, identity, query=""):
    """The same as a YAML file of ROS, which `test_rectify` and `test_yaml_exports` hold to OpenCV."""
    with urllib.request.urlopen(f"{plumb.address}/v1/calibrations/{identity}?format=ros{query}") as answer:
        return yaml.safe_load(answer.read())


def assert_states(info, sensor, frame_id, file):
    """Whether the message says what the document and the exported file say of the sensor, to the last bit."""
    lens = sensor["lens"]
    name, parameters = ROS_NAMES[lens["model"]]
    fx, fy, cx, cy = (lens[name] for name in ("fx", "fy", "cx", "cy"))
    assert [info.width, info.height] == sensor["image_size"]
    assert (info.header.frame_id, info.distortion_model) == (frame_id, name)
    assert list(info.d) == [lens[parameter] for parameter in parameters]
    assert list(info.k) == [fx, 0, cx, 0, fy, cy, 0, 0, 1]
    assert list(info.r) == [1, 0, 0, 0, 1, 0, 0, 0, 1]
    assert list(info.p) == file["projection_matrix"]["data"]
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
        assert started.success and started.message.endswith("started"), started
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
        file = exported(plumb, identity, "&alpha=0.25")
        request = asked.take()
        assert_states(request.camera_info, sensor, "front_optical_frame", file)
        answers.wait_for_reader()
        answers.send(ros.SetCameraInfoResponse(request.client, request.count, True, ""))
        # Who comes late hears of it too.
        info = ros.Subscriber(participant, "/plumb/front/camera_info", ros.CameraInfo, latched=True).take()
        assert_states(info, sensor, "front_optical_frame", file)

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
            translation, rotation = transform.transform.translation, transform.transform.rotation
            assert [translation.x, translation.y, translation.z] == extrinsics["translation"]
            assert [rotation.w, rotation.x, rotation.y, rotation.z] == [extrinsics["rotation"][name] for name in "wxyz"]
        color = ros.Subscriber(participant, "/plumb/arm/camera_info", ros.CameraInfo, latched=True).take()
        identity = finished["calibration"]
        assert_states(color, document["sensors"]["color"], "arm_optical_frame", exported(plumb, identity))
        infrared = ros.Subscriber(participant, "/plumb/arm/infra1/camera_info", ros.CameraInfo, latched=True).take()
        file = exported(plumb, identity, "&sensor=infrared")
        assert_states(infrared, document["sensors"]["infrared"], "arm_infrared_optical_frame", file)


RIG = """
[calibration]
auto_approve = false
[ros2]
publish = true
domain_id = {domain}
camera_info_with_images = true
session = {{ target = {{ kind = "chessboard", cols = 8, rows = 6, square_m = 0.03 }}, lens = "brown" }}
[[camera]]
name = "left"
source = {{ kind = "recording", path = "{folder}/rig-left.mcap", pace = "fastest" }}
[[camera]]
name = "right"
source = {{ kind = "recording", path = "{folder}/rig-right.mcap", pace = "fastest" }}
"""
HEAD = """
[[rig]]
name = "head"
cameras = ["left", "right"]
"""


def test_a_rig_that_a_hangup_adds_is_calibrated_by_services_and_rectified(participant, plumb_binary, tmp_path):  # noqa: F811
    config = RIG.format(domain=ros.DOMAIN, folder=RECORDINGS)
    with Daemon(plumb_binary, config, tmp_path, ROS_LOCALHOST_ONLY="1") as plumb:
        alone = ros.Subscriber(participant, "/plumb/left/state", ros.String, latched=True)
        assert alone.take().data == "idle"
        file = tmp_path / "plumb.toml"
        file.write_text(file.read_text() + HEAD)
        plumb.process.send_signal(signal.SIGHUP)
        state = ros.Subscriber(participant, "/plumb/head/state", ros.String, latched=True)
        assert state.take().data == "idle"
        events = plumb.events("head")
        started = ros.Client(participant, "/plumb/head/start", ros.TriggerRequest, ros.TriggerResponse).call(ros.TriggerRequest())
        assert started.success, started
        state.take_until(lambda message: message.data == "collecting")
        next(data for kind, data in events if kind == "session" and "has ended" in (data["reason"] or ""))
        stopped = ros.Client(participant, "/plumb/head/stop", ros.TriggerRequest, ros.TriggerResponse).call(ros.TriggerRequest())
        assert stopped.success, stopped
        identity = stopped.message.removeprefix("calibration ")
        plumb.ask(f"/v1/calibrations/{identity}/approve", {})
        infos = {}
        for name in ("left", "right"):
            infos[name] = ros.Subscriber(participant, f"/plumb/head/{name}/camera_info", ros.CameraInfo, latched=True).take()
        with urllib.request.urlopen(f"{plumb.address}/v1/calibrations/{identity}?format=ros_stereo") as answer:
            files = {one["camera_name"]: one for one in yaml.safe_load_all(answer.read())}
        for name, info in infos.items():
            assert (info.header.frame_id, info.distortion_model) == (f"{name}_optical_frame", "plumb_bob")
            for stated, field in ((info.r, "rectification_matrix"), (info.p, "projection_matrix"), (info.k, "camera_matrix"), (info.d, "distortion_coefficients")):
                assert list(stated) == files[name][field]["data"]
        baseline_m = np.linalg.norm(plumb.ask(f"/v1/calibrations/{identity}")["extrinsics"][0]["translation"])
        np.testing.assert_allclose(infos["right"].p[3], -infos["right"].p[0] * baseline_m, rtol=1e-9)
        placed = ros.Subscriber(participant, "/tf_static", ros.TFMessage, latched=True).take().transforms
        assert [(one.header.frame_id, one.child_frame_id) for one in placed] == [("left_optical_frame", "right_optical_frame")]
        diagnostics = ros.Subscriber(participant, "/diagnostics", ros.DiagnosticArray)
        said = diagnostics.take_until(lambda array: any(one.name == "plumb: head" for one in array.status))
        values = {pair.key: pair.value for one in said.status if one.name == "plumb: head" for pair in one.values}
        assert (values["cameras"], values["calibration"]) == ("left, right", identity)
