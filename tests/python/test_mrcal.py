"""mrcal, from Debian's package and so by Debian's own Python, reads Plumb's export and sees what Plumb sees."""

import json
import subprocess

import numpy as np
import pytest

import reference

PROJECT = """
import json, sys
import mrcal, numpy
model = mrcal.cameramodel(sys.argv[1])
points = numpy.array(json.load(sys.stdin))
pixels = mrcal.project(points, *model.intrinsics())
camera_from_reference = model.extrinsics_rt_fromref()
print(json.dumps({"pixels": pixels.tolist(), "size": [int(n) for n in model.imagersize()], "rt": camera_from_reference.tolist()}))
"""


@pytest.mark.parametrize("model", [model for model in reference.LENSES if model != "kannala_brandt"])
def test_mrcal_projects_alike(exported, model):
    points = json.dumps(reference.points(model).tolist())
    asked = ["/usr/bin/python3", "-c", PROJECT, str(exported(model, "mrcal"))]
    done = subprocess.run(asked, input=points, capture_output=True, text=True, timeout=120)
    assert done.returncode == 0, done.stderr
    answer = json.loads(done.stdout)
    assert (answer["size"], answer["rt"]) == (reference.IMAGE_SIZE, [0.0] * 6)
    np.testing.assert_allclose(answer["pixels"], reference.opencv_pixels(model), atol=1e-6)


def test_mrcal_has_no_fisheye_of_this_kind(exported):
    assert "mrcal format has no kannala_brandt lens" in exported("kannala_brandt", "mrcal", succeeds=False)
