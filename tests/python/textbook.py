"""The corners that the textbook's exercise works with: OpenCV's, unrefined, of the nine photographs in the order it uses.

`python tests/python/textbook.py FOLDER > tests/golden/textbook_corners.json` with the folder of the photographs.
"""

import json
import sys
from pathlib import Path

import cv2

NUMBERS = [1, 4, 9, 13, 14, 15, 16, 17, 23]


def corners(folder, number):
    """Row by row, 9 a row."""
    image = cv2.imread(str(Path(folder) / f"board-{number:02d}.png"), cv2.IMREAD_GRAYSCALE)
    found, pixels = cv2.findChessboardCorners(image, (9, 7))
    assert found, number
    return pixels.reshape(-1, 2).astype(float).tolist()


if __name__ == "__main__":
    print(json.dumps([corners(sys.argv[1], number) for number in NUMBERS]))
