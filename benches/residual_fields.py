"""Residual fields of a set of photographs: over the board, over the image and from view to view, with the board as stated and as measured.

    PLUMB=target/release/plumb target/venv/bin/python benches/residual_fields.py --board 9x6 --square 30mm --out fields.png PHOTO…

Left: `--board-shape flat --shutter global`; right: `auto` of both. Above: mean residual of each corner over all views, over the board. Middle: mean residual in each
part of the image. Below: mean residual of each view along x (red) and y (blue), in the order of the photographs. A model that holds leaves
arrows and bars without a pattern, as long as noise makes them. Residuals are measured − projected, projected from the document.
"""

import argparse
import json
import os
import subprocess

import cv2
import numpy as np

WIDTH, MARGIN, TEXT = 560, 18, 26
PARTS = (16, 12)
LEAST_OF_A_PART = 3
RED, BLUE, BLACK, GRAY = (40, 40, 200), (190, 90, 30), (30, 30, 30), (210, 210, 210)


def plumb(*arguments):
    command = [os.environ.get("PLUMB", "target/release/plumb"), *arguments]
    return subprocess.run(command, check=True, capture_output=True, text=True).stdout


def residuals(calibration, detections):
    """Per used view: board points in the plane, pixels, residuals."""
    sensor = next(iter(calibration["sensors"].values()))
    lens, target = sensor["lens"], calibration["target"]
    matrix = np.array([[lens["fx"], 0, lens["cx"]], [0, lens["fy"], lens["cy"]], [0, 0, 1]])
    shape = sensor.get("board_shape")
    cols = target["cols"]
    for view in sensor["views"]:
        detection = detections.get(view["name"])
        if not view["used"] or not detection:
            continue
        index = np.array(detection["indices"]) if "indices" in detection else None
        pixels = np.array(detection["corners"], float)[:, :2]
        if index is None:
            index = np.array([(k % cols, k // cols) for k in range(len(pixels))])
        q = view["camera_from_board"]["rotation"]
        rotation = cv2.Rodrigues(matrix_of(q["w"], q["x"], q["y"], q["z"]))[0]
        translation = np.array(view["camera_from_board"]["translation"])

        def moved(seen, motion=view.get("motion")):
            """Where the corners were when their rows were read."""
            if not motion:
                return seen
            center = cv2.Rodrigues(rotation)[0] @ motion["center_m"] + translation
            times = (pixels[:, 1] + 0.5) / sensor["image_size"][1] - 0.5
            rotations = [cv2.Rodrigues(time * np.array(motion["rotation_rad"]))[0] for time in times]
            return np.array([rotated @ (point - center) + center + time * np.array(motion["translation_m"])
                             for rotated, point, time in zip(rotations, seen, times)])

        def of(index):
            stated = np.c_[index * target["square_m"], np.zeros(len(index))].astype(float)
            points = stated
            if shape:
                offsets = {tuple(np.round(point, 6)): offset for point, offset in zip(shape["points"], shape["offsets_m"])}
                points = stated + [offsets[tuple(np.round(point, 6))] for point in stated]
            seen = moved(points @ cv2.Rodrigues(rotation)[0].T + translation)
            if lens["model"] == "kannala_brandt":
                radius = np.hypot(seen[:, 0], seen[:, 1])
                angle = np.arctan2(radius, seen[:, 2])
                bent = angle * sum((lens[f"k{n}"] if n else 1) * angle ** (2 * n) for n in range(5))
                projected = seen[:, :2] * (bent / radius)[:, None] * [lens["fx"], lens["fy"]] + [lens["cx"], lens["cy"]]
            else:
                k = np.array([lens.get(name, 0.0) for name in ("k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6")])
                projected = cv2.projectPoints(seen, np.zeros(3), np.zeros(3), matrix, k)[0]
            return stated[:, :2], pixels, pixels - projected.reshape(-1, 2)

        found = [of(index)]
        if (cols + target["rows"]) % 2 == 0:
            # An image does not show which way round such a board is; the calibration chose one.
            found.append(of([cols - 1, target["rows"] - 1] - index))
        yield min(found, key=lambda one: np.abs(one[2]).sum())


def matrix_of(w, x, y, z):
    return np.array([
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
    ])


def canvas(height, words):
    image = np.full((TEXT + height + MARGIN, WIDTH, 3), 255, np.uint8)
    cv2.putText(image, words, (MARGIN, 18), cv2.FONT_HERSHEY_SIMPLEX, 0.45, BLACK, 1, cv2.LINE_AA)
    return image


def arrow(image, at, vector, px_per_px):
    ends = [tuple(int(round(v * 16)) for v in p) for p in (at, at + px_per_px * vector)]
    cv2.arrowedLine(image, *ends, RED, 1, cv2.LINE_AA, 4, 0.25)


def over_board(views, px_per_px):
    sums = {}
    for points, _, rest in views:
        for point, one in zip(points, rest):
            sums.setdefault(tuple(np.round(point, 6)), []).append(one)
    places = np.array(list(sums))
    span = np.ptp(places, axis=0)
    scale = (WIDTH - 4 * MARGIN) / span[0]
    image = canvas(int(scale * span[1]) + 2 * MARGIN, f"over the board: mean of each corner, {px_per_px / 10:.0f} px here for 0.1 px")
    for place, rest in sums.items():
        at = 2 * MARGIN + scale * (np.array(place) - places.min(axis=0)) + (0, TEXT - MARGIN)
        cv2.circle(image, tuple(int(round(v)) for v in at), 2, GRAY, -1, cv2.LINE_AA)
        arrow(image, at, np.mean(rest, axis=0), px_per_px)
    return image


def over_image(views, size, px_per_px):
    sums = {}
    for _, pixels, rest in views:
        for pixel, one in zip(pixels, rest):
            sums.setdefault(tuple((pixel / size * PARTS).astype(int)), []).append(one)
    scale = (WIDTH - 2 * MARGIN) / size[0]
    image = canvas(int(scale * size[1]), "over the image: mean of each part, same scale")
    corner = np.array([MARGIN, TEXT])
    cv2.rectangle(image, tuple(corner), tuple((corner + scale * size).astype(int)), GRAY, 1)
    for part, rest in sums.items():
        if len(rest) >= LEAST_OF_A_PART:
            at = corner + scale * (np.array(part) + 0.5) / PARTS * size
            arrow(image, at, np.mean(rest, axis=0), px_per_px)
    return image


def over_views(views, px_per_px):
    height = 90
    image = canvas(height, "from view to view: mean of x red, of y blue; rms gray")
    middle = TEXT + height // 2
    cv2.line(image, (MARGIN, middle), (WIDTH - MARGIN, middle), GRAY, 1)
    step = (WIDTH - 2 * MARGIN) / len(views)
    for k, (_, _, rest) in enumerate(views):
        x = int(MARGIN + (k + 0.5) * step)
        bar = int(step / 5) + 1
        rms = px_per_px * np.sqrt((rest**2).sum(axis=1).mean())
        cv2.rectangle(image, (x - bar, int(middle - rms)), (x + bar, int(middle + rms)), (235, 235, 235), -1)
        for at, value, color in ((x - bar, rest[:, 0].mean(), RED), (x, rest[:, 1].mean(), BLUE)):
            cv2.rectangle(image, (at, middle), (at + bar, int(middle - px_per_px * value)), color, -1)
    return image


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--board", required=True)
    parser.add_argument("--square", required=True)
    parser.add_argument("--lens", default="auto")
    parser.add_argument("--out", required=True)
    parser.add_argument("photos", nargs="+")
    asked = parser.parse_args()
    lines = plumb("detect", "--board", asked.board, "--allow-partial", "--json", *asked.photos).splitlines()
    detections = {one["path"]: one for one in map(json.loads, lines) if one["found"]}
    columns, px_per_px = [], None
    for shape, shutter in (("flat", "global"), ("auto", "auto")):
        options = ["--board", asked.board, "--square", asked.square, "--lens", asked.lens, "--board-shape", shape, "--shutter", shutter]
        calibration = json.loads(plumb("calibrate", *options, "--json", *asked.photos))
        sensor = next(iter(calibration["sensors"].values()))
        views = list(residuals(calibration, detections))
        rms = np.sqrt(np.mean([np.sum(rest**2, axis=1).mean() for *_, rest in views]))
        # The first column's arrows are 18 pixels long in the mean.
        px_per_px = px_per_px or 18 / rms
        size = np.array(sensor["image_size"])
        title = canvas(0, f"board {'as stated' if shape == 'flat' else 'as measured'}, {sensor['lens']['model']}: rms {rms:.3f} px")
        columns.append(np.vstack([title, over_board(views, px_per_px), over_image(views, size, px_per_px), over_views(views, px_per_px)]))
        print(f"{shape}: rms {rms:.4f} px where the document says {sensor['rms_px']:.4f}; {calibration['verdict']['grade']}")
    cv2.imwrite(asked.out, np.hstack(columns))


if __name__ == "__main__":
    main()
