"""COLMAP's `cameras.txt`, by the formulas of COLMAP's `src/colmap/sensor/models.h`."""

import numpy as np
import pytest

import reference

# COLMAP's parameter lists after fx, fy, cx, cy, and OpenCV's order of the same coefficients.
COUNTS = {"PINHOLE": 0, "OPENCV": 4, "OPENCV_FISHEYE": 4, "FULL_OPENCV": 8}


@pytest.mark.parametrize("model", reference.LENSES)
def test_colmap(exported, model):
    lines = [line for line in exported(model, "colmap").read_text().splitlines() if not line.startswith("#")]
    (camera,) = lines
    number, name, width, height, *parameters = camera.split()
    assert (number, [int(width), int(height)]) == ("1", reference.IMAGE_SIZE)
    fx, fy, cx, cy, *coefficients = map(float, parameters)
    assert len(coefficients) == COUNTS[name]
    assert (name == "OPENCV_FISHEYE") == (model == "kannala_brandt")
    camera_matrix = np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1]])
    pixels = reference.project(model, camera_matrix, np.array(coefficients or [0.0] * 4), reference.points(model))
    # COLMAP counts from the corner of the first pixel, everyone else here from its center.
    np.testing.assert_allclose(pixels - 0.5, reference.opencv_pixels(model), atol=1e-6)
