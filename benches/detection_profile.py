#!/usr/bin/env python3
"""Where the time of one detection goes, stage by stage: samples of `perf` (Debian's linux-perf) while a image is searched over and over.

    cargo build --release && cargo bench --bench hard_images -- target/hard_images
    python3 benches/detection_profile.py "target/hard_images/9x6 at 640x480.png" 9x6

Each sample counts for the innermost function of the detector that it was taken in; what the compiler inlined counts for
the function it is in. Reading the image is left out.
"""

import os
import re
import subprocess
import sys
import tempfile
from collections import Counter

PLUMB = os.environ.get("PLUMB", "target/release/plumb")
REPEATS = 3000

# A module of the detector, and what it does.
STAGES = {
    "refine::normal_equations": "refinement: linearizing and solving",
    "refine::samples": "refinement: gathering pixels",
    "refine::fit": "refinement: linearizing and solving",
    "refine::cholesky": "refinement: linearizing and solving",
    "refine::corner_model": "refinement: linearizing and solving",
    "refine::field": "refinement: what the board determines",
    "refine::lattice": "refinement: what the board determines",
    "refine::noise": "refinement: what the board determines",
    "refine::halves": "refinement: standard deviations",
    "refine::scatter": "refinement: standard deviations",
    "refine::misfit": "refinement: standard deviations",
    "refine::straightness": "refinement: standard deviations",
    "refine": "refinement: the rest",
    "cross": "sampling windows",
    "growth": "growth",
    "plane_growth": "growth",
    "board_plane": "growth",
    "perspective": "growth",
    "curved_board": "growth",
    "grid": "growth",
    "seeds": "seeds",
    "candidates": "levels, response and candidates",
    "response": "levels, response and candidates",
    "pyramid": "levels, response and candidates",
    "detector": "levels, response and candidates",
    "verification": "verification",
    "edges": "verification",
    "ends": "ends and placement",
    "placement": "ends and placement",
}


def stage_of(stack):
    """The stage of a stack of function names, innermost first; None outside the detector."""
    for function in stack:
        found = re.search(r"plumb::detection::((?:refine::)?\w+)", function)
        if found:
            module = found[1]
            return STAGES.get(module) or ("refinement: the rest" if module.startswith("refine") else "the rest")
    return None


def main():
    image, board = sys.argv[1:3]
    with tempfile.TemporaryDirectory() as folder:
        recorded = os.path.join(folder, "perf.data")
        search = [PLUMB, "detect", "--json", "--allow-partial", "--threads", "1", "--repeat", str(REPEATS), "--board", board, image]
        record = ["perf", "record", "-q", "-F", "2500", "--call-graph", "dwarf,8192", "-o", recorded]
        subprocess.run(record + search, check=True, stdout=subprocess.DEVNULL)
        script = ["perf", "script", "-i", recorded, "--no-inline", "-F", "ip,sym"]
        samples = subprocess.run(script, check=True, capture_output=True, text=True).stdout.split("\n\n")
    stages = Counter(stage_of(sample.splitlines()) for sample in samples)
    del stages[None]
    total = sum(stages.values())
    print(f"| stage | % of {total} samples |\n| --- | --- |")
    for stage, count in stages.most_common():
        print(f"| {stage} | {100 * count / total:.0f} |")


if __name__ == "__main__":
    main()
