"""The YAML exports, by the rules of their readers: ROS's `camera_calibration_parsers` and Kalibr's `CameraChainParameters`."""

import numpy as np
import pytest
import yaml

import reference

ROS_MODELS = {"plumb_bob": 5, "rational_polynomial": 8, "equidistant": 4}


def ros_matrix(document, field, rows, cols):
    matrix = document[field]
    assert set(matrix) == {"rows", "cols", "data"}
    assert (matrix["rows"], matrix["cols"]) == (rows, cols)
    assert all(isinstance(number, float) for number in matrix["data"])
    return np.array(matrix["data"]).reshape(rows, cols)


@pytest.mark.parametrize("model", reference.LENSES)
def test_ros(exported, model):
    document = yaml.safe_load(exported(model, "ros").read_text())
    assert [document["image_width"], document["image_height"]] == reference.IMAGE_SIZE
    assert document["camera_name"] == "front"
    camera_matrix = ros_matrix(document, "camera_matrix", 3, 3)
    assert (ros_matrix(document, "rectification_matrix", 3, 3) == np.eye(3)).all()
    # Held to OpenCV in `test_rectify`.
    projection = ros_matrix(document, "projection_matrix", 3, 4)
    assert (projection[:, 3] == 0).all() and (projection[2, :3] == [0, 0, 1]).all()
    assert (model == "pinhole") == (projection[:, :3] == camera_matrix).all()
    coefficients = ros_matrix(document, "distortion_coefficients", 1, ROS_MODELS[document["distortion_model"]])
    assert (document["distortion_model"] == "equidistant") == (model == "kannala_brandt")
    pixels = reference.project(model, camera_matrix, coefficients, reference.points(model))
    np.testing.assert_allclose(pixels, reference.opencv_pixels(model), atol=1e-6)


@pytest.mark.parametrize("model, distortion", [("pinhole", "none"), ("radial", "radtan"), ("kannala_brandt", "equidistant")])
def test_kalibr(exported, model, distortion):
    camera = yaml.safe_load(exported(model, "kalibr").read_text())["cam0"]
    assert (camera["camera_model"], camera["distortion_model"]) == ("pinhole", distortion)
    assert (camera["resolution"], camera["cam_overlaps"]) == (reference.IMAGE_SIZE, [])
    assert camera["rostopic"] == "/front/color"
    fx, fy, cx, cy = camera["intrinsics"]
    coefficients = np.array(camera["distortion_coeffs"] or np.zeros(4))
    pixels = reference.project(model, np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1]]), coefficients, reference.points(model))
    np.testing.assert_allclose(pixels, reference.opencv_pixels(model), atol=1e-6)


def test_kalibr_says_how_far_a_refit_is_off_or_refuses(exported):
    assert "off by up to" in exported("brown", "kalibr", succeeds=False)
    assert "off by up to" in exported("rational", "kalibr", succeeds=False)
