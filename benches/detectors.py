#!/usr/bin/env python3
"""Plumb's detector beside OpenCV's, on the same rendered pictures with exact truth, one thread each.

    cargo bench --bench hard_pictures -- target/hard_pictures
    pip install opencv-python-headless && python benches/detectors.py target/hard_pictures

Of each picture: how many of the corners to be seen were found, their 2-D rms error in pixels, and the fastest of several
times in milliseconds, decoding not counted; beside OpenCV's time its ratio to Plumb's. A corner counts if it is within 2 px
of a true one, no two for one; OpenCV's classic detector is refined by cornerSubPix, 11x11.
"""

import json
import os
import subprocess
import sys
import time
from pathlib import Path

import cv2
import numpy as np

REPEATS = 5
PLUMB = os.environ.get("PLUMB", "target/release/plumb")


def plumb(path, cols, rows):
    command = [PLUMB, "detect", "--json", "--allow-partial", "--threads", "1", "--repeat", str(REPEATS)]
    run = subprocess.run(command + ["--board", f"{cols}x{rows}", str(path)], capture_output=True, text=True)
    answer = json.loads(run.stdout)
    return np.array(answer["corners"]).reshape(-1, 2), answer["elapsed_ms"]


def timed(look):
    times, corners = [], None
    for _ in range(REPEATS):
        start = time.perf_counter()
        corners = look()
        times.append(time.perf_counter() - start)
    return corners, 1e3 * min(times)


def classic(path, cols, rows):
    grey = cv2.imread(str(path), cv2.IMREAD_GRAYSCALE)

    def look():
        found, corners = cv2.findChessboardCorners(grey, (cols, rows), flags=cv2.CALIB_CB_ADAPTIVE_THRESH)
        if not found:
            return np.empty((0, 2))
        stop = (cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_MAX_ITER, 40, 1e-3)
        return cv2.cornerSubPix(grey, corners, (5, 5), (-1, -1), stop).reshape(-1, 2)

    return timed(look)


def sectors(path, cols, rows):
    grey = cv2.imread(str(path), cv2.IMREAD_GRAYSCALE)
    flags = cv2.CALIB_CB_EXHAUSTIVE | cv2.CALIB_CB_ACCURACY

    def look():
        found, corners = cv2.findChessboardCornersSB(grey, (cols, rows), flags=flags)
        return corners.reshape(-1, 2) if found else np.empty((0, 2))

    return timed(look)


def score(corners, truth):
    """Corners that are right, and their squared errors."""
    if not len(corners):
        return []
    apart = np.linalg.norm(corners[:, None] - truth[None], axis=2)
    nearest = apart.argmin(1)
    squares = {}
    for corner, place in enumerate(nearest):
        if apart[corner, place] < 2.0:
            squares.setdefault(place, apart[corner, place] ** 2)
    return list(squares.values())


def main():
    cv2.setNumThreads(1)
    folder = Path(sys.argv[1] if len(sys.argv) > 1 else "target/hard_pictures")
    document = json.loads((folder / "truth.json").read_text())
    cols, rows = document["cols"], document["rows"]
    peers = {"Plumb": plumb, "OpenCV classic": classic, "OpenCV SB exhaustive": sectors}
    print("| picture | corners seen | " + " | ".join(peers) + " |\n| --- | --- |" + " --- |" * len(peers))
    for picture in document["pictures"]:
        truth = np.array([[np.nan if v is None else v for v in corner] for corner in picture["corners"]])
        cells, own = [], None
        for peer in peers.values():
            corners, ms = peer(folder / picture["file"], cols, rows)
            own = own or ms
            squares = score(corners, truth)
            rms = f"{np.sqrt(np.mean(squares)):.4f} px" if squares else "–"
            cells.append(f"{len(squares)}, {rms}, {ms:.1f} ms (×{ms / own:.1f})")
        name = picture["file"].removesuffix(".png")
        print(f"| {name} | {sum(picture['seen'])} | " + " | ".join(cells) + " |")


if __name__ == "__main__":
    main()
