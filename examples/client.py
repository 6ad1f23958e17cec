#!/usr/bin/python3
"""A client of the daemon: calibrates a camera over HTTP and saves the result for ROS.

    plumb serve --config config/demo.toml
    python3 examples/client.py http://127.0.0.1:8600 front front.yaml

Every route and field is described at /docs, and as an OpenAPI document at /openapi.json.
"""

import json
import sys
import time
import urllib.request

SESSION = {
    "target": {"kind": "chessboard", "cols": 9, "rows": 6, "square_m": 0.025},
    "lens": "brown",
    "finish": {"min_views": 12, "max_seconds": 60},
}


def request(url, body=None):
    """The bytes that `url` answers with; a POST where there is a body."""
    data = None if body is None else json.dumps(body).encode()
    headers = {"Content-Type": "application/json"}
    with urllib.request.urlopen(urllib.request.Request(url, data, headers), timeout=60) as answer:
        return answer.read()


def calibrate(address, camera):
    """Runs one session to its end; the calibration's document."""
    session = json.loads(request(f"{address}/v1/cameras/{camera}/sessions", SESSION))
    while session["state"] in ("collecting", "solving"):
        time.sleep(0.2)
        session = json.loads(request(f"{address}/v1/sessions/{session['id']}"))
    if session["state"] != "finished":
        sys.exit(f"the session is {session['state']}: {session['reason']}")
    return json.loads(request(f"{address}/v1/calibrations/{session['calibration']}"))


def main():
    address, camera, path = sys.argv[1:]
    calibration = calibrate(address, camera)
    color = calibration["sensors"]["color"]
    print(f"fx {color['lens']['fx']:.3f} ± {color['lens_std']['fx']:.3f} px, rms {color['rms_px']:.3f} px")
    print("verdict:", calibration["verdict"]["grade"])
    with open(path, "wb") as file:
        file.write(request(f"{address}/v1/calibrations/{calibration['id']}?format=ros"))


if __name__ == "__main__":
    main()
