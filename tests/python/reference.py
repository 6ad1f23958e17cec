"""The lenses of the checks, the points they see, and where OpenCV itself sees them.

`python tests/python/reference.py > tests/golden/opencv_projections.json` writes the numbers that the Rust tests hold
Plumb's lenses to; `test_opencv.py` computes them again and compares.
"""

import json
from pathlib import Path

import cv2
import numpy as np

GOLDEN = Path(__file__).resolve().parents[1] / "golden" / "opencv_projections.json"
IMAGE_SIZE = [640, 480]
NAMES = {
    "pinhole": [],
    "radial": ["k1"],
    "brown": ["k1", "k2", "p1", "p2", "k3"],
    "rational": ["k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6"],
    "kannala_brandt": ["k1", "k2", "k3", "k4"],
}
LENSES = {
    "pinhole": [530.25, 535.5, 318.125, 242.75],
    "radial": [530.25, 535.5, 318.125, 242.75, -0.21],
    "brown": [532.8, 532.9, 342.5, 233.9, -0.281, 0.08, 0.0012, -0.0014, -0.013],
    "rational": [520.0, 522.0, 321.0, 238.0, 8.1, 4.3, 0.0003, -0.0002, 0.2, 8.4, 6.9, 1.1],
    "kannala_brandt": [205.0, 206.0, 319.0, 241.0, -0.012, 0.004, -0.002, 0.0003],
}


def lens(model):
    """The contract's `lens` of `model`."""
    names = ["fx", "fy", "cx", "cy", *NAMES[model]]
    return {"model": model, "skew": 0.0, **dict(zip(names, LENSES[model]))}


def points(model):
    """Points of the camera frame, in meters, that fill the image of `model`."""
    reach = 2.0 if model == "kannala_brandt" else 0.6
    steps = np.linspace(-reach, reach, 13)
    return np.array([[x * z, 0.75 * y * z, z] for y in steps for x in steps for z in [0.4 + abs(x) + 2 * abs(y)]])


def project(model, camera_matrix, coefficients, points_in_camera):
    """OpenCV's pixels."""
    nothing = np.zeros(3)
    points_in_camera = np.ascontiguousarray(points_in_camera, dtype=np.float64).reshape(-1, 1, 3)
    if model == "kannala_brandt":
        pixels, _ = cv2.fisheye.projectPoints(points_in_camera, nothing, nothing, camera_matrix, coefficients)
    else:
        pixels, _ = cv2.projectPoints(points_in_camera, nothing, nothing, camera_matrix, coefficients)
    return pixels.reshape(-1, 2)


def opencv_pixels(model):
    """Where OpenCV sees `points(model)` through `lens(model)`."""
    fx, fy, cx, cy, *coefficients = LENSES[model]
    if len(coefficients) < 4:
        coefficients += [0.0] * (5 - len(coefficients))
    camera_matrix = np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1]], dtype=np.float64)
    return project(model, camera_matrix, np.array(coefficients), points(model))


def calibration(model):
    """A calibration document that holds `lens(model)`."""
    of_lens = {name: 0.0 for name in lens(model) if name != "model"}
    return {
        "id": "01KAJ0000000000000000000000", "camera": "front", "session": None, "created_at": "2026-01-02T03:04:05Z",
        "target": {"kind": "chessboard", "cols": 9, "rows": 6, "square_m": 0.025},
        "sensors": {"color": {
            "image_size": IMAGE_SIZE, "lens": lens(model), "lens_std": of_lens, "rms_px": 0.1,
            "uncertainty_px": {"center": 0.01, "median": 0.02, "worst": 0.1}, "views": [],
        }},
        "extrinsics": [],
        "checks": {"split_half_ratio": None, "held_out_rms_px": None, "outlier_fraction": 0.0, "coverage": 0.5},
        "verdict": {"grade": "good", "reasons": []},
    }


if __name__ == "__main__":
    lenses = [
        {"lens": lens(model), "points_m": points(model).tolist(), "pixels": opencv_pixels(model).tolist()} for model in LENSES
    ]
    print(json.dumps({"made_by": f"tests/python/reference.py with OpenCV {cv2.__version__}", "lenses": lenses}))
