"""Rectification, against OpenCV's `stereoRectify` and `getOptimalNewCameraMatrix` and their `fisheye` versions, and on the corners of real and rendered stereo."""

import json
import urllib.error
import urllib.request
from pathlib import Path

import cv2
import numpy as np
import pytest
import yaml

import reference
from served import Daemon
from test_recordings import RECORDINGS

SHARED = next((up / "shared" / "data" for up in Path(__file__).resolve().parents if (up / "shared" / "data").is_dir()), None)
# OpenCV undistorts the corners that it frames by in five steps: enough for `mild`, and a third of a pixel off for `brown`.
MILD = [532.8, 532.9, 342.5, 233.9, -0.05, 0.01, 0.0005, -0.0003, 0.0]
# Wholly within 78 degrees of the rectified axis: beyond, OpenCV frames up to 90 degrees, where a flat image is all edge, and Plumb does not.
FISHEYE = [380.0, 381.0, 319.0, 241.0, -0.012, 0.004, -0.002, 0.0003]
OWN = {"mild": ("brown", MILD), "fisheye": ("kannala_brandt", FISHEYE)}
TOLERANCES = {"pinhole": 1e-6, "mild": 1e-6, "fisheye": 1e-6, "brown": 4e-3}
BOARD = {"kind": "chessboard", "cols": 8, "rows": 6, "square_m": 0.03}
RIG = """
[calibration]
auto_approve = false
[[camera]]
name = "left"
source = {{ kind = "recording", path = "{folder}/rig-left.mcap", pace = "fastest" }}
[[camera]]
name = "right"
source = {{ kind = "recording", path = "{folder}/rig-right.mcap", pace = "fastest" }}
[[rig]]
name = "head"
cameras = ["left", "right"]
"""


def lens_of(model):
    return OWN[model][1] if model in OWN else reference.LENSES[model]


def sensor_of(model):
    kind = OWN[model][0] if model in OWN else model
    sensor = reference.calibration(kind)["sensors"]["color"]
    sensor["lens"].update(zip(["fx", "fy", "cx", "cy", *reference.NAMES[kind]], lens_of(model)))
    return sensor


def document(models, left_from_right):
    """A calibration of a rig of two cameras with the lenses of `models`."""
    sensors = {name: sensor_of(model) for name, model in zip(("left", "right"), models)}
    rotation, translation = left_from_right
    angle = np.linalg.norm(rotation)
    axis = rotation / angle * np.sin(angle / 2)
    pose = {
        "name": "left_from_right", "rotation": {"w": np.cos(angle / 2), **dict(zip("xyz", axis))}, "translation": list(translation),
        "rotation_std": [0.0] * 3, "translation_std": [0.0] * 3,
    }
    cameras = [{"name": name, "sensors": {"color": sensor}} for name, sensor in sensors.items()]
    return {**reference.calibration("pinhole"), "camera": "head", "sensors": {}, "cameras": cameras, "extrinsics": [pose]}


def opencv(models, left_from_right, alpha):
    """OpenCV's K, D, R, T and R1, R2, P1, P2, Q for the same rig."""
    rotation, translation = cv2.Rodrigues(left_from_right[0])[0], np.array(left_from_right[1])
    R, T = rotation.T, (-rotation.T @ translation).reshape(3, 1)
    lenses = []
    for model in models:
        fx, fy, cx, cy, *coefficients = lens_of(model)
        lenses += [np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1.0]]), np.array(coefficients or [0.0] * 5)]
    size = tuple(reference.IMAGE_SIZE)
    if models[0] == "fisheye":
        return R, T, cv2.fisheye.stereoRectify(*lenses, size, R, T, cv2.CALIB_ZERO_DISPARITY, balance=alpha)
    return R, T, cv2.stereoRectify(*lenses, size, R, T, flags=cv2.CALIB_ZERO_DISPARITY, alpha=alpha)[:5]


RIGS = {
    "ordinary": (np.array([0.02, -0.05, 0.01]), [0.12, 0.004, -0.007]),
    "toed in": (np.array([-0.01, 0.22, 0.03]), [0.30, -0.02, 0.03]),
    "vertical": (np.array([0.04, 0.01, -0.02]), [0.003, 0.10, 0.002]),
}
CASES = [
    (rig, model, alpha)
    for rig in RIGS
    for model in TOLERANCES
    for alpha in (0.0, 0.3, 1.0)
    # OpenCV's fisheye version takes every rig for a horizontal one.
    if not (rig == "vertical" and model == "fisheye")
]


@pytest.mark.parametrize("rig, model, alpha", CASES)
def test_the_matrices_are_opencv_s(rig, model, alpha, plumb, tmp_path):
    models = [model, model]
    file, out = tmp_path / "rig.json", tmp_path / "stereo.yaml"
    file.write_text(json.dumps(document(models, RIGS[rig])))
    plumb("export", "--calibration", file, "--format", "opencv_stereo", "--alpha", alpha, "--out", out)
    storage = cv2.FileStorage(str(out), cv2.FILE_STORAGE_READ)
    R, T, (R1, R2, P1, P2, Q) = opencv(models, RIGS[rig], alpha)
    stated = {name: storage.getNode(name).mat() for name in ("R", "T", "R1", "R2", "P1", "P2", "Q", "M1", "D2")}
    for name, expected in (("R", R), ("T", T), ("R1", R1), ("R2", R2)):
        np.testing.assert_allclose(stated[name], expected, atol=1e-9, err_msg=name)
    for name, expected in (("P1", P1), ("P2", P2), ("Q", Q)):
        np.testing.assert_allclose(stated[name], expected, rtol=TOLERANCES[model], atol=TOLERANCES[model], err_msg=name)


def opencv_alone(model, alpha, scale=1.0):
    """OpenCV's new camera matrix of a camera by itself, as ROS's own calibrator asks for it, for images of `scale` times the size."""
    fx, fy, cx, cy, *coefficients = lens_of(model)
    if scale != 1.0:
        # Pixel centers are whole numbers.
        fx, fy, cx, cy = fx * scale, fy * scale, (cx + 0.5) * scale - 0.5, (cy + 0.5) * scale - 0.5
    camera_matrix, coefficients = np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1.0]]), np.array(coefficients or [0.0] * 5)
    size = tuple(int(length * scale) for length in reference.IMAGE_SIZE)
    if model == "fisheye":
        return cv2.fisheye.estimateNewCameraMatrixForUndistortRectify(camera_matrix, coefficients, size, np.eye(3), balance=alpha)
    return cv2.getOptimalNewCameraMatrix(camera_matrix, coefficients, size, alpha)[0]


def alone(folder, model):
    file = folder / "single.json"
    file.write_text(json.dumps({**reference.calibration("pinhole"), "sensors": {"color": sensor_of(model)}}))
    return file


@pytest.mark.parametrize("alpha", [None, 0.0, 0.3, 1.0])
@pytest.mark.parametrize("model", [*TOLERANCES, "rational"])
def test_a_camera_by_itself_has_opencv_s_new_camera_matrix(model, alpha, plumb, tmp_path):
    asked = [] if alpha is None else ["--alpha", alpha]
    for scale, size in ((1.0, []), (0.5, ["--width", 320, "--height", 240])):
        answer = plumb("export", "--calibration", alone(tmp_path, model), "--format", "ros", *asked, *size)
        stated = yaml.safe_load(answer.stdout)
        assert stated["rectification_matrix"]["data"] == np.eye(3).ravel().tolist()
        projection = np.reshape(stated["projection_matrix"]["data"], (3, 4))
        expected = np.c_[opencv_alone(model, alpha or 0.0, scale), np.zeros(3)]
        tolerance = TOLERANCES.get(model, TOLERANCES["brown"])
        np.testing.assert_allclose(projection, expected, rtol=tolerance, atol=tolerance)


def test_alpha_of_a_camera_by_itself_is_from_0_to_1(plumb, tmp_path):
    refused = plumb("export", "--calibration", alone(tmp_path, "brown"), "--format", "ros", "--alpha", "1.5", succeeds=False)
    assert refused.stderr.endswith("--alpha 1.5: give a number from 0 to 1\n") and refused.returncode == 2


def test_the_pair_of_ros_files(plumb, tmp_path):
    file = tmp_path / "rig.json"
    file.write_text(json.dumps(document(["brown", "brown"], RIGS["ordinary"])))
    plumb("export", "--calibration", file, "--format", "ros_stereo", "--out", tmp_path / "stereo")
    left, right = (yaml.safe_load((tmp_path / "stereo" / f"{name}.yaml").read_text()) for name in ("left", "right"))
    both = yaml.safe_load_all(plumb("export", "--calibration", file, "--format", "ros_stereo").stdout)
    assert list(both) == [left, right]
    _, T, (R1, R2, *_) = opencv(["brown", "brown"], RIGS["ordinary"], 0.0)
    for stated, name, rotation, along in ((left, "left", R1, 0.0), (right, "right", R2, -np.linalg.norm(T))):
        assert (stated["camera_name"], stated["distortion_model"]) == (name, "plumb_bob")
        np.testing.assert_allclose(np.reshape(stated["rectification_matrix"]["data"], (3, 3)), rotation, atol=1e-9)
        projection = np.reshape(stated["projection_matrix"]["data"], (3, 4))
        np.testing.assert_allclose(projection[0, 3], projection[0, 0] * along, rtol=1e-9)
        assert projection[0, 0] == projection[1, 1] and not projection[1:, 3].any()
    shared = [np.reshape(stated["projection_matrix"]["data"], (3, 4))[:, :3] for stated in (left, right)]
    np.testing.assert_array_equal(*shared)


def test_what_is_no_stereo_pair_is_one_line(plumb, tmp_path):
    single, vertical = tmp_path / "single.json", tmp_path / "vertical.json"
    single.write_text(json.dumps(reference.calibration("brown")))
    mixed = tmp_path / "mixed.json"
    mixed.write_text(json.dumps(document(["brown", "kannala_brandt"], RIGS["ordinary"])))
    swapped = tmp_path / "swapped.json"
    swapped.write_text(json.dumps(document(["brown", "brown"], (RIGS["ordinary"][0], [-0.12, 0.0, 0.0]))))
    vertical.write_text(json.dumps(document(["brown", "brown"], RIGS["vertical"])))
    for arguments, words in (
        (("export", "--calibration", single, "--format", "opencv_stereo"), "needs two cameras, and this calibration has color"),
        (("export", "--calibration", mixed, "--format", "opencv_stereo"), "the same lens model for both cameras"),
        (("export", "--calibration", vertical, "--format", "ros_stereo", "--sensor", "left,rear"), "no image sensor `rear`"),
        (("export", "--calibration", vertical, "--format", "ros_stereo", "--sensor", "left"), "not two names"),
        (("rectify", "--rig", swapped, "a.png", "b.png"), "`left` is right of `right`: give --cameras right,left"),
        (("rectify", "--rig", vertical, "--alpha", "2", "a.png", "b.png"), "--alpha 2: give a number from 0 to 1"),
    ):
        line = plumb(*arguments, succeeds=False).stderr
        assert words in line and line.count("\n") == 1, line


def truth(name):
    return json.loads((RECORDINGS / f"rig-{name}.truth.json").read_text())


def matrix(pose):
    rotation = pose["rotation"]
    axis, w = np.array([rotation[name] for name in "xyz"]), rotation["w"]
    rotation = cv2.Rodrigues(axis / np.linalg.norm(axis) * 2 * np.arctan2(np.linalg.norm(axis), w))[0]
    return np.vstack([np.c_[rotation, pose["translation"]], [0, 0, 0, 1]])


def opencv_rows(left, right):
    """Differences of the rows of the corners that OpenCV finds in two images of the 8x6 board; none where it finds none."""
    found = [cv2.findChessboardCornersSB(image, (8, 6), flags=cv2.CALIB_CB_ACCURACY) for image in (left, right)]
    if not all(is_found for is_found, _ in found):
        return []
    left, right = (corners[:, 0, 1] for _, corners in found)
    # The board is the same after half a turn.
    return min(right - left, right[::-1] - left, key=lambda differences: np.abs(differences).max())


@pytest.mark.parametrize("alpha", [0.0, 1.0])
def test_rows_of_a_rendered_rig_agree(alpha, plumb, tmp_path):
    calibration = document(["brown", "brown"], RIGS["ordinary"])
    left_from_board, right_from_board = (matrix(truth(name)["frames"][0]["camera_from_board"]) for name in ("left", "right"))
    left_from_right = left_from_board @ np.linalg.inv(right_from_board)
    rotation = cv2.Rodrigues(left_from_right[:3, :3])[0].ravel()
    calibration = document(["brown", "brown"], (rotation, left_from_right[:3, 3]))
    for camera in calibration["cameras"]:
        camera["sensors"]["color"]["lens"] = truth(camera["name"])["sensors"]["color"]["lens"]
    calibration["target"] = BOARD
    file = tmp_path / "rig.json"
    file.write_text(json.dumps(calibration))
    recordings = [RECORDINGS / f"rig-{name}.mcap" for name in ("left", "right")]
    answer = plumb("rectify", "--rig", file, "--alpha", alpha, "--out", tmp_path / "out", "--json", *recordings)
    report = json.loads(answer.stdout)
    assert (report["axis"], len(report["pairs"])) == ("horizontal", 30)
    np.testing.assert_allclose(report["baseline_m"], np.linalg.norm(left_from_right[:3, 3]), rtol=1e-9)
    measured = [pair["rows"] for pair in report["pairs"] if pair["rows"]]
    assert len(measured) >= 15 and report["rows"]["rms_px"] < 0.1, report["rows"]
    # The same by another's detector, in the files.
    pairs = [[cv2.imread(path, cv2.IMREAD_GRAYSCALE) for path in pair["out"]] for pair in report["pairs"] if pair["rows"]]
    rows = np.concatenate([opencv_rows(*pair) for pair in pairs])
    assert len(rows) > 300 and np.sqrt(np.mean(rows**2)) < 0.1


def test_rows_of_a_real_pair_agree(plumb, tmp_path):
    """Bouguet's stereo set: calibrated with seven pairs, measured on the other six."""
    if SHARED is None:
        pytest.skip("SKIPPED: no shared/data beside the project")
    numbers = ["01", "02", "03", "04", "05", "06", "07", "08", "09", "11", "12", "13", "14"]
    for use, chosen in (("seen", numbers[::2]), ("held", numbers[1::2])):
        for name in ("left", "right"):
            (tmp_path / use / name).mkdir(parents=True)
            for number in chosen:
                (tmp_path / use / name / f"{number}.jpg").symlink_to(SHARED / "opencv-samples" / f"{name}{number}.jpg")
    rig = [f"--rig={name}={tmp_path / 'seen' / name}" for name in ("left", "right")]
    file = tmp_path / "rig.json"
    plumb("calibrate", *rig, "--board", "9x6", "--square", "30mm", "--lens", "brown", "--out", file)
    held = [tmp_path / "held" / name for name in ("left", "right")]
    report = json.loads(plumb("rectify", "--rig", file, "--alpha", 1, "--out", tmp_path / "out", "--json", *held).stdout)
    assert sum(pair["rows"] is not None for pair in report["pairs"]) == 6
    assert report["rows"]["rms_px"] < 0.2 and report["rows"]["worst_px"] < 0.6


def test_live_images_of_a_calibrated_rig_are_rectified(plumb_binary, tmp_path):
    def frame(plumb, camera):
        with urllib.request.urlopen(f"{plumb.address}/v1/cameras/{camera}/frame.jpg?rectified=true") as answer:
            return cv2.imdecode(np.frombuffer(answer.read(), np.uint8), cv2.IMREAD_GRAYSCALE)

    def preview(plumb, camera, query):
        """The first image of the stream."""
        with urllib.request.urlopen(f"{plumb.address}/v1/cameras/{camera}/preview.mjpg?{query}", timeout=30) as stream:
            stated = next(line for line in stream if line.lower().startswith(b"content-length"))
            assert not stream.readline().strip()
            return cv2.imdecode(np.frombuffer(stream.read(int(stated.split(b":")[1])), np.uint8), cv2.IMREAD_GRAYSCALE)

    with Daemon(plumb_binary, RIG.format(folder=RECORDINGS), tmp_path) as plumb:
        events = plumb.events("head")
        session = plumb.ask("/v1/rigs/head/sessions", {"target": BOARD, "lens": "brown"})
        next(data for kind, data in events if kind == "session" and "has ended" in (data["reason"] or ""))
        with pytest.raises(urllib.error.HTTPError) as early:
            frame(plumb, "left")
        assert early.value.code == 409 and "no calibration of two cameras with it is approved" in early.value.read().decode()
        finished = plumb.ask(f"/v1/sessions/{session['id']}/stop", {})
        assert finished["state"] == "finished", finished["reason"]
        plumb.ask(f"/v1/calibrations/{finished['calibration']}/approve", {})
        left, right = frame(plumb, "left"), frame(plumb, "right")
        rows = opencv_rows(left, right)
        assert len(rows) == 48 and np.abs(rows).max() < 0.5
        whole = [preview(plumb, camera, "rectified=true&alpha=1&overlay=false") for camera in ("left", "right")]
        assert all((image[:2] < 8).sum() > 100 and not (tight[:2] < 8).any() for image, tight in zip(whole, (left, right)))
        rows = opencv_rows(*whole)
        assert len(rows) == 48 and np.abs(rows).max() < 0.5
        with urllib.request.urlopen(f"{plumb.address}/v1/rigs/head/calibration?format=ros_stereo") as answer:
            stated = list(yaml.safe_load_all(answer.read()))
        assert [one["camera_name"] for one in stated] == ["left", "right"]
        assert stated[1]["projection_matrix"]["data"][3] < 0
