"""Plumb's lenses are OpenCV's, and OpenCV reads Plumb's export."""

import json

import cv2
import numpy as np
import pytest

import reference


def test_the_golden_projections_are_opencv_s_own():
    golden = json.loads(reference.GOLDEN.read_text())
    assert [entry["lens"]["model"] for entry in golden["lenses"]] == list(reference.LENSES)
    for entry in golden["lenses"]:
        model = entry["lens"]["model"]
        assert entry["lens"] == reference.lens(model)
        np.testing.assert_array_equal(entry["points_m"], reference.points(model))
        np.testing.assert_allclose(entry["pixels"], reference.opencv_pixels(model), atol=1e-9)


@pytest.mark.parametrize("model", reference.LENSES)
def test_file_storage_opens_the_export(exported, model):
    storage = cv2.FileStorage(str(exported(model, "opencv")), cv2.FILE_STORAGE_READ)
    assert [int(storage.getNode(side).real()) for side in ("image_width", "image_height")] == reference.IMAGE_SIZE
    assert (storage.getNode("board_width").real(), storage.getNode("square_size").real()) == (9, 0.025)
    assert bool(storage.getNode("fisheye_model").real()) == (model == "kannala_brandt")
    camera_matrix = storage.getNode("camera_matrix").mat()
    coefficients = storage.getNode("distortion_coefficients").mat()
    pixels = reference.project(model, camera_matrix, coefficients, reference.points(model))
    np.testing.assert_allclose(pixels, reference.opencv_pixels(model), atol=1e-6)


@pytest.mark.parametrize("model", reference.LENSES)
def test_images_of_half_the_size_are_seen_at_half_the_place(plumb, exported, tmp_path, model):
    exported(model, "json")
    out = tmp_path / "half.yaml"
    plumb("export", "--calibration", tmp_path / f"{model}.json", "--format", "opencv", "--width", 320, "--height", 240, "--out", out)
    storage = cv2.FileStorage(str(out), cv2.FILE_STORAGE_READ)
    assert [int(storage.getNode(side).real()) for side in ("image_width", "image_height")] == [320, 240]
    camera_matrix, coefficients = (storage.getNode(name).mat() for name in ("camera_matrix", "distortion_coefficients"))
    pixels = reference.project(model, camera_matrix, coefficients, reference.points(model))
    # Areas are halved, not centers: the whole image spans -0.5 to 639.5, the half one -0.5 to 319.5.
    np.testing.assert_allclose(pixels, (reference.opencv_pixels(model) + 0.5) / 2 - 0.5, atol=1e-6)


def test_images_of_another_shape_are_refused(plumb, exported, tmp_path):
    exported("pinhole", "json")
    asked = ["--calibration", tmp_path / "pinhole.json", "--format", "opencv", "--width", 640, "--height", 360]
    assert "stretch" in plumb("export", *asked, succeeds=False).stderr
