"""Reads a depth correction exported by Plumb (format `depth`) and converts raw depth images to meters. Needs numpy."""
import numpy as np


def read(path):
    """The file's keys with their values, and the nodes of each power."""
    lines = [line.split() for line in open(path) if line.strip() and not line.startswith("#")]
    keys = {line[0]: line[1:] for line in lines if line[0] != "nodes"}
    assert keys["plumb_depth_correction"] == ["1"], f"{path}: another version"
    return keys, [np.array(line[1:], float) for line in lines if line[0] == "nodes"]


def weights(length, cells):
    """What each node adds to each pixel of a row (or column): length x (cells + 3), or ones without cells."""
    if cells == 0:
        return np.ones((length, 1))
    along = (np.arange(length) + 0.5) / length * cells
    first = np.minimum(along.astype(int), cells - 1)
    t = along - first
    table = np.zeros((length, cells + 3))
    for k, w in enumerate([(1 - t) ** 3, 3 * t**3 - 6 * t**2 + 4, -3 * t**3 + 3 * t**2 + 3 * t + 1, t**3]):
        table[np.arange(length), first + k] = w / 6
    return table


def meters(correction, raw):
    """Depth in meters of a raw image (rows x columns); 0 where nothing was measured."""
    (keys, nodes), raw = correction, np.asarray(raw, float)
    (kind, *numbers), (width, height) = keys["reading"], map(int, keys["size"])
    assert raw.shape == (height, width), f"the correction is for {width} x {height}"
    with np.errstate(all="ignore"):
        inverse = 1 / (float(numbers[0]) * raw) if kind == "depth" else float(numbers[0]) + float(numbers[1]) * raw
        known = np.isfinite(inverse) & (inverse > 0) & (raw != float(keys.get("invalid", ["nan"])[0]))
        if nodes:
            (near, far), (cols, rows) = map(float, keys["seen"]), map(int, keys["cells"])
            held, power = np.clip(inverse, 1 / far, 1 / near), 1 if keys["quantity"] == ["inverse_depth"] else -1
            across, down = weights(width, cols), weights(height, rows)
            surfaces = [down @ n.reshape(down.shape[1], -1) @ across.T for n in nodes]
            inverse = (inverse**power + sum(g * held ** (power * k) for k, g in enumerate(surfaces))) ** power
        return np.where(known & (inverse > 0), 1 / inverse, 0)
