"""The recordings are MCAP files that the field's own readers open, with the Foxglove schemas and their truth inside."""

import json
from pathlib import Path

import cv2
import numpy as np
import pytest
from mcap.reader import make_reader
from mcap_protobuf.decoder import DecoderFactory

RECORDINGS = Path(__file__).resolve().parents[2] / "recordings"


def frames(path):
    """(topic, schema, message, log time) of every message, and the metadata records by name."""
    with path.open("rb") as file:
        reader = make_reader(file, decoder_factories=[DecoderFactory()])
        messages = [(c.topic, s.name, d, m.log_time) for s, c, m, d in reader.iter_decoded_messages()]
        return messages, {record.name: record.metadata for record in reader.iter_metadata()}


@pytest.mark.parametrize("name, count", [("walk", 150), ("hard", 90)])
def test_images_times_and_truth(name, count):
    messages, metadata = frames(RECORDINGS / f"{name}.mcap")
    assert {(topic, schema) for topic, schema, *_ in messages} == {("/front/color", "foxglove.CompressedImage")}
    assert len(messages) == count
    times = [time for *_, time in messages]
    assert all(abs(b - a - 1e9 / 15) < 2 for a, b in zip(times, times[1:]))
    _, _, message, time = messages[7]
    assert (message.format, message.frame_id) == ("jpeg", "front_color")
    assert message.timestamp.seconds * 10**9 + message.timestamp.nanos == time
    assert cv2.imdecode(np.frombuffer(message.data, np.uint8), cv2.IMREAD_UNCHANGED).shape == (480, 640)
    truth = {key: json.loads(value) for key, value in metadata["plumb.truth"].items()}
    assert truth == json.loads((RECORDINGS / f"{name}.truth.json").read_text())
    assert len(truth["frames"]) == count and truth["target"]["cols"] == 9


def test_the_truth_is_where_opencv_sees_the_corners():
    messages, metadata = frames(RECORDINGS / "walk.mcap")
    truth = {key: json.loads(value) for key, value in metadata["plumb.truth"].items()}
    lens = truth["sensors"]["color"]["lens"]
    camera_matrix = np.array([[lens["fx"], 0, lens["cx"]], [0, lens["fy"], lens["cy"]], [0, 0, 1]])
    distortion = np.array([lens[key] for key in ("k1", "k2", "p1", "p2", "k3")])
    grid = np.mgrid[0:9, 0:6].T.reshape(-1, 2) * truth["target"]["square_m"]
    board = np.column_stack([grid, np.zeros(len(grid))])
    compared = 0
    for index in (2, 17, 32, 47, 62, 92):
        pose = truth["frames"][index]["camera_from_board"]
        rotation = pose["rotation"]
        axis = np.array([rotation[key] for key in "xyz"])
        angle = 2 * np.arctan2(np.linalg.norm(axis), rotation["w"])
        rotation_vector = axis / max(np.linalg.norm(axis), 1e-300) * angle
        expected = cv2.projectPoints(board, rotation_vector, np.array(pose["translation"]), camera_matrix, distortion)[0][:, 0]
        image = cv2.imdecode(np.frombuffer(messages[index][2].data, np.uint8), cv2.IMREAD_GRAYSCALE)
        found, corners = cv2.findChessboardCornersSB(image, (9, 6))
        if found:
            stop = (cv2.TERM_CRITERIA_EPS | cv2.TERM_CRITERIA_MAX_ITER, 50, 1e-3)
            corners = cv2.cornerSubPix(image, corners, (4, 4), (-1, -1), stop)
            # OpenCV may count from the other end.
            corners = min((corners[:, 0], corners[::-1, 0]), key=lambda seen: np.abs(seen - expected).max())
            assert np.sqrt(np.mean((corners - expected) ** 2)) < 0.1
            compared += 1
    assert compared >= 4


def test_color_infrared_and_depth_come_together():
    messages, metadata = frames(RECORDINGS / "rgbd.mcap")
    by_topic = {}
    for topic, _, message, time in messages:
        by_topic.setdefault(topic, []).append((message, time))
    assert set(by_topic) == {"/front/color", "/front/infrared", "/front/depth"}
    assert len({tuple(time for _, time in frames) for frames in by_topic.values()}) == 1
    message, _ = by_topic["/front/depth"][10]
    depth = cv2.imdecode(np.frombuffer(message.data, np.uint8), cv2.IMREAD_UNCHANGED)
    assert message.format == "png" and depth.dtype == np.uint16 and depth.shape == (480, 640)
    truth = {key: json.loads(value) for key, value in metadata["plumb.truth"].items()}
    assert truth["depth"]["unit_m"] == 0.001
    assert {entry["name"] for entry in truth["extrinsics"]} == {"color_from_depth", "color_from_infrared"}
