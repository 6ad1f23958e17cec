#!/usr/bin/python3
"""The demo: starts the daemon, calibrates over HTTP from the bundled recording and then with an operator who follows
the guidance, prints both results, and serves until Ctrl-C."""

import json
import subprocess
import sys
import time
import urllib.error
import urllib.request

ADDRESS = "http://127.0.0.1:8600"
REQUEST = {
    "target": {"kind": "chessboard", "cols": 9, "rows": 6, "square_m": 0.025},
    "lens": "brown",
    "finish": {"uncertainty_px": 0.05, "min_views": 15, "max_seconds": 60},
}
GUIDED = {**REQUEST, "finish": {"uncertainty_px": 0.02, "min_views": 20, "max_seconds": 60}}


def ask(url, body=None):
    """The JSON that `url` answers; POSTs `body` where there is one."""
    data = None if body is None else json.dumps(body).encode()
    request = urllib.request.Request(url, data, {"Content-Type": "application/json"})
    with urllib.request.urlopen(request, timeout=60) as answer:
        return json.load(answer)


def wait_until_ready(daemon):
    """Returns when a camera delivers."""
    for _ in range(300):
        if daemon.poll() is not None:
            sys.exit(daemon.returncode)
        try:
            urllib.request.urlopen(f"{ADDRESS}/readyz", timeout=5).close()
            return
        except (urllib.error.URLError, ConnectionError):
            time.sleep(0.1)
    sys.exit(f"the daemon did not become ready; see {ADDRESS}/readyz")


def collect(name, request, says_guidance):
    """Runs a session of the camera `name` to its end, reporting what it sees; the finished session."""
    camera = f"{ADDRESS}/v1/cameras/{name}"
    left = ask(camera)["session"]
    if left:
        print("stopping a session left by an earlier demo", flush=True)
        ask(f"{ADDRESS}/v1/sessions/{left}/stop", {})
    session = ask(f"{camera}/sessions", request)
    reported = None
    while session["state"] in ("collecting", "solving"):
        seen = (session["state"], session["views_kept"])
        if seen != reported:
            reported = seen
            advice = session["guidance"]["message"] if says_guidance else ""
            print(f"  {seen[0]}: {seen[1]} views kept, {session['coverage']['fraction']:.0%} of the image covered{advice and '; '}{advice}", flush=True)
        time.sleep(0.2)
        session = ask(f"{ADDRESS}/v1/sessions/{session['id']}")
    return session


def report(session):
    """Prints the calibration that the session ended with."""
    if session["state"] != "finished":
        sys.exit(f"the session is {session['state']}: {session['reason']}")
    calibration = ask(f"{ADDRESS}/v1/calibrations/{session['calibration']}")
    sensor = calibration["sensors"]["color"]
    lens, std = sensor["lens"], sensor["lens_std"]
    used = sum(view["used"] for view in sensor["views"])
    print(f"\ncalibrated from {used} views, rms {sensor['rms_px']:.3f} px; projection uncertainty "
          f"{sensor['uncertainty_px']['median']:.3f} px median, {sensor['uncertainty_px']['worst']:.3f} px worst")
    for name in (name for name in lens if name != "model" and (lens[name] or std.get(name))):
        print(f"  {name:>4} {lens[name]:12.5f} ± {std[name]:.5f}")
    print(f"verdict: {calibration['verdict']['grade']}", *calibration["verdict"]["reasons"], sep="\n  ")
    print(f"\npage:     {ADDRESS}/")
    print(f"for ROS:  curl '{ADDRESS}/v1/calibrations/{calibration['id']}?format=ros'", flush=True)


def refuse_company():
    """Ends the demo where another daemon has its address: that one's answers would be taken for the demo's."""
    try:
        urllib.request.urlopen(f"{ADDRESS}/healthz", timeout=5).close()
    except (urllib.error.URLError, ConnectionError):
        return
    sys.exit(f"something serves at {ADDRESS} already; stop it and try again")


def main():
    refuse_company()
    daemon = subprocess.Popen([sys.argv[1], "serve", "--config", "config/demo.toml"])
    try:
        wait_until_ready(daemon)
        print(f"plumb runs at {ADDRESS}; a session collects views from recordings/walk.mcap", flush=True)
        report(collect("front", REQUEST, says_guidance=False))
        print("\na simulated operator now follows the guidance of the session; the page shows both cameras", flush=True)
        report(collect("followed", GUIDED, says_guidance=True))
        print("Ctrl-C ends it.", flush=True)
        daemon.wait()
    except KeyboardInterrupt:
        pass
    finally:
        daemon.terminate()
        daemon.wait()


if __name__ == "__main__":
    main()
