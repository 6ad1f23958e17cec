"""F, E, relative pose and triangulation on given matches, beside OpenCV: 200 simulated pairs of images with wrong matches among the right ones."""

import json
import os
import subprocess

import cv2
import numpy as np
import pytest

from conftest import ROOT

SIZE = (1280, 960)
CAMERA = np.array([[1100.0, 0.0, 639.5], [0.0, 1100.0, 479.5], [0.0, 0.0, 1.0]])
PAIRS = 200
# As SIFT leaves them; residuals of inliers end at four of these for OpenCV, too.
NOISE_PX = 0.7


def simulated(seed):
    """Matches (x, y, x', y'), and the truth: which are right, R, unit t, points."""
    random = np.random.default_rng(seed)
    count = int(random.integers(60, 400))
    wrong = int(random.uniform(0.05, 0.5) * count)
    rotation = cv2.Rodrigues(random.normal(0, [0.1, 0.2, 0.2]))[0]
    direction = random.normal(size=3) * [1.0, 1.0, 0.6]
    depth = random.uniform(4.0, 9.0)
    translation = direction / np.linalg.norm(direction) * depth * random.uniform(0.05, 0.3)
    middle = np.array([0.0, 0.0, depth])
    matches, points = [], []
    while len(points) < count:
        at = random.uniform([0, 0], SIZE)
        far = depth * random.uniform(0.7, 1.6)
        point = np.linalg.solve(CAMERA, [*at, 1.0]) * far
        other = CAMERA @ (rotation @ (point - middle) + middle + translation)
        seen = other[:2] / other[2]
        if other[2] > 0 and np.all(seen >= 0) and np.all(seen < SIZE):
            matches.append([*at, *seen])
            points.append(point)
    matches = np.array(matches) + random.normal(0, NOISE_PX, (count, 4))
    matches[:wrong, 2:] = random.uniform([0, 0], SIZE, (wrong, 2))
    moved = middle + translation - rotation @ middle
    right = np.arange(count) >= wrong
    return matches, right, rotation, moved / np.linalg.norm(moved), np.array(points) / np.linalg.norm(moved)


def angles_deg(found, truth):
    """Of rotation and of translation, between (R, t) and the truth."""
    (rotation, translation), (true_rotation, true_translation) = found, truth
    between = np.clip((np.trace(rotation.T @ true_rotation) - 1) / 2, -1, 1)
    along = np.clip(np.dot(np.ravel(translation), true_translation) / np.linalg.norm(translation), -1, 1)
    return np.degrees([np.arccos(between), np.arccos(along)])


def pose_of(essential, matches):
    _, rotation, translation, _ = cv2.recoverPose(essential, matches[:, :2], matches[:, 2:], CAMERA)
    return rotation, translation


@pytest.fixture(scope="module")
def answers(tmp_path_factory):
    """What Plumb's own functions say of every pair, through the example that calls them."""
    binary = ROOT / os.environ.get("PLUMB_EXAMPLES", "target/debug/examples") / "relative_pose"
    assert binary.is_file(), f"{binary} is missing: `cargo build --examples` makes it"
    pairs = [simulated(seed)[0] for seed in range(PAIRS)]
    given = tmp_path_factory.mktemp("two_view") / "matches.jsonl"
    camera = [CAMERA[0, 0], CAMERA[1, 1], CAMERA[0, 2], CAMERA[1, 2]]
    lines = (json.dumps({"image_size": SIZE, "camera": camera, "matches": pair.tolist()}) for pair in pairs)
    given.write_text("\n".join(lines))
    done = subprocess.run([binary, given], capture_output=True, text=True, timeout=200, check=True)
    said = [json.loads(line) for line in done.stdout.splitlines()]
    assert len(said) == PAIRS
    return said


def report(name, ours, theirs):
    ours, theirs = np.array(ours), np.array(theirs)
    print(f"{name}: median {np.median(ours, axis=0)} beside {np.median(theirs, axis=0)}, 90 % {np.quantile(ours, 0.9, axis=0)} beside {np.quantile(theirs, 0.9, axis=0)}")
    return np.median(ours, axis=0), np.median(theirs, axis=0)


# Each of OpenCV's: its own USAC with every option that the documentation recommends for accuracy.
USAC = {"default": cv2.USAC_DEFAULT, "accurate": cv2.USAC_ACCURATE, "magsac": cv2.USAC_MAGSAC}


@pytest.mark.parametrize("method", USAC)
def test_f_and_its_pose_are_no_worse_than_opencv(answers, method):
    ours, theirs = [], []
    for seed, said in enumerate(answers):
        matches, _, *truth, _ = simulated(seed)
        fundamental, mask = cv2.findFundamentalMat(matches[:, :2], matches[:, 2:], USAC[method], 1.5, 0.999, 10000)
        agree = matches[np.ravel(mask) > 0]
        theirs.append(angles_deg(pose_of(CAMERA.T @ fundamental @ CAMERA, agree), truth))
        agree = matches[said["fundamental"]["inliers"]]
        own = np.array(said["fundamental"]["matrix"])
        ours.append(angles_deg(pose_of(CAMERA.T @ own @ CAMERA, agree), truth))
    ours, theirs = report(f"F, {method}", ours, theirs)
    assert np.all(ours <= theirs)


@pytest.mark.parametrize("method", USAC)
def test_e_and_its_pose_are_no_worse_than_opencv(answers, method):
    ours, theirs = [], []
    for seed, said in enumerate(answers):
        matches, _, *truth, _ = simulated(seed)
        essential, mask = cv2.findEssentialMat(matches[:, :2], matches[:, 2:], CAMERA, USAC[method], 0.999, 1.5, 10000)
        agree = matches[np.ravel(mask) > 0]
        theirs.append(angles_deg(pose_of(essential, agree), truth))
        ours.append(angles_deg((np.array(said["rotation"]), np.array(said["translation"])), truth))
    ours, theirs = report(f"E, {method}", ours, theirs)
    assert np.all(ours <= theirs)


def test_triangulated_points_are_nearer_to_their_pixels_than_opencv(answers):
    ours, theirs = [], []
    for seed, said in enumerate(answers):
        matches, right, _, _, points = simulated(seed)
        chosen = [(k, point) for k, point in zip(said["inliers"], said["points"]) if right[k] and point]
        index = [k for k, _ in chosen]
        cameras = [CAMERA @ np.eye(3, 4), CAMERA @ np.column_stack([said["rotation"], said["translation"]])]
        linear = cv2.triangulatePoints(*cameras, matches[index, :2].T, matches[index, 2:].T)
        for errors, found in ((ours, np.array([point for _, point in chosen])), (theirs, (linear[:3] / linear[3]).T)):
            projected = [camera @ np.column_stack([found, np.ones(len(found))]).T for camera in cameras]
            off = np.concatenate([(p[:2] / p[2]).T for p in projected], axis=1) - matches[index]
            distance = np.linalg.norm(found - points[index], axis=1) / points[index, 2]
            errors.append([np.sqrt(np.mean(off**2)), np.median(distance)])
    assert np.all(np.array(ours)[:, 0] <= np.array(theirs)[:, 0] * (1 + 1e-9))
    ours, theirs = report("points: rms of their pixels, part of their depth", ours, theirs)
    # Most of a point's error is the pose's, which both have.
    assert ours[1] <= 1.01 * theirs[1]
