#!/usr/bin/env python3
"""Plumb's detector beside OpenCV's, chess-corners and calib-targets, on the same rendered images with exact truth, one thread each.

    cargo build --release && cargo bench --bench hard_images -- target/hard_images
    cargo build --release --manifest-path benches/peers/Cargo.toml --target-dir target/peers
    pip install opencv-python-headless && python benches/detectors.py target/hard_images

Of each image: how many of the corners to be seen were found, their 2-D rms error in pixels, and the fastest of several
times in milliseconds, decoding not counted, of others as a multiple of Plumb's. A corner counts if it is within 2 px
of a true one, no two for one. OpenCV's classic detector runs without its fast check and is refined by cornerSubPix, 5x5
(the fastest way to a board) and 11x11; chess-corners and calib-targets refine by their saddle point. chess-corners
answers with corners, not with a board.
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
DEFAULT = cv2.CALIB_CB_ADAPTIVE_THRESH | cv2.CALIB_CB_NORMALIZE_IMAGE
PLUMB = os.environ.get("PLUMB", "target/release/plumb")
PEERS = os.environ.get("PLUMB_PEERS", "target/peers/release/plumb-peers")


def plumb(path, cols, rows):
    command = [PLUMB, "detect", "--json", "--allow-partial", "--threads", "1", "--repeat", str(REPEATS)]
    run = subprocess.run(command + ["--board", f"{cols}x{rows}", str(path)], capture_output=True, text=True)
    answer = json.loads(run.stdout)
    return np.array(answer["corners"]).reshape(-1, 2), answer["elapsed_ms"]


def of_rust(method):
    def find(path, _cols, _rows):
        run = subprocess.run([PEERS, method, str(REPEATS), str(path)], capture_output=True, text=True, check=True)
        answer = json.loads(run.stdout)
        return np.array(answer["corners"]).reshape(-1, 2), answer["elapsed_ms"]

    return find


def timed(find):
    times, corners = [], None
    for _ in range(REPEATS):
        start = time.perf_counter()
        corners = find()
        times.append(time.perf_counter() - start)
    return corners, 1e3 * min(times)


def classic(half_window):
    def of_image(path, cols, rows):
        gray = cv2.imread(str(path), cv2.IMREAD_GRAYSCALE)

        def find():
            found, corners = cv2.findChessboardCorners(gray, (cols, rows), flags=DEFAULT)
            if not found:
                return np.empty((0, 2))
            stop = (cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_MAX_ITER, 40, 1e-3)
            return cv2.cornerSubPix(gray, corners, (half_window, half_window), (-1, -1), stop).reshape(-1, 2)

        return timed(find)

    return of_image


def sectors(path, cols, rows):
    gray = cv2.imread(str(path), cv2.IMREAD_GRAYSCALE)
    flags = cv2.CALIB_CB_EXHAUSTIVE | cv2.CALIB_CB_ACCURACY

    def find():
        found, corners = cv2.findChessboardCornersSB(gray, (cols, rows), flags=flags)
        return corners.reshape(-1, 2) if found else np.empty((0, 2))

    return timed(find)


def score(corners, truth):
    """Corners that are right, and their squared errors."""
    if not len(corners):
        return []
    distances = np.linalg.norm(corners[:, None] - truth[None], axis=2)
    nearest = distances.argmin(1)
    squares = {}
    for corner, place in enumerate(nearest):
        if distances[corner, place] < 2.0:
            squares[place] = min(squares.get(place, np.inf), distances[corner, place] ** 2)
    return list(squares.values())


def main():
    cv2.setNumThreads(1)
    folder = Path(sys.argv[1] if len(sys.argv) > 1 else "target/hard_images")
    document = json.loads((folder / "truth.json").read_text())
    peers = {"Plumb": plumb, "classic 5×5": classic(2), "classic 11×11": classic(5), "SB exhaustive": sectors}
    if Path(PEERS).exists():
        peers |= {name: of_rust(name) for name in ("chess-corners", "calib-targets")}
    else:
        print(f"LEFT OUT: chess-corners and calib-targets, for there is no {PEERS}; build it as above", file=sys.stderr)
    print("| image | corners seen | " + " | ".join(peers) + " |\n| --- | --- |" + " --- |" * len(peers))
    for image in document["images"]:
        truth = np.array([[np.nan if v is None else v for v in corner] for corner in image["corners"]])
        cells, own = [], None
        for peer in peers.values():
            corners, ms = peer(folder / image["file"], image["cols"], image["rows"])
            squares = score(corners, truth)
            rms = f"{np.sqrt(np.mean(squares)):.4f} px" if squares else "–"
            cells.append(f"{len(squares)}, {rms}, " + (f"×{ms / own:.1f}" if own else f"{ms:.2f} ms"))
            own = own or ms
        name = image["file"].removesuffix(".png")
        print(f"| {name} | {sum(image['seen'])} | " + " | ".join(cells) + " |")


if __name__ == "__main__":
    main()
