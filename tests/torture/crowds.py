"""Greedy clients, all at once: idle ones, stalled ones, half-open ones, large bodies; and who asks about health beside them."""

import resource
import socket
import tempfile
import time

from plumbd import Plumbd, until

IDLE, STALLED, HALF_OPEN, LARGE = 1000, 300, 300, 50


def connection(plumbd, sent=b""):
    host, port = plumbd.address.removeprefix("http://").split(":")
    stream = socket.create_connection((host, int(port)), timeout=20)
    try:
        stream.sendall(sent)
    except OSError:
        pass
    return stream


def health(plumbd, count):
    """Milliseconds of each of so many questions about health, and how many were not answered."""
    taken, failed = [], 0
    for _ in range(count):
        began = time.monotonic()
        failed += plumbd.ask("/healthz", timeout=5)[0] != 200
        taken.append((time.monotonic() - began) * 1e3)
        time.sleep(0.02)
    return sorted(taken), failed


def rate(plumbd, seconds):
    before, began = plumbd.metric("plumb_frames_total"), time.monotonic()
    time.sleep(seconds)
    return (plumbd.metric("plumb_frames_total") - before) / (time.monotonic() - began)


def torture():
    """A row of the table."""
    resource.setrlimit(resource.RLIMIT_NOFILE, (8192, resource.getrlimit(resource.RLIMIT_NOFILE)[1]))
    with tempfile.TemporaryDirectory() as folder:
        plumbd = Plumbd(folder, pace="recorded").ready()
        until(lambda: plumbd.metric("plumb_frames_total") > 15)
        quiet = rate(plumbd, 4)
        clients = [connection(plumbd) for _ in range(IDLE)]
        preview = b"GET /v1/cameras/front/preview.mjpg HTTP/1.1\r\nHost: localhost\r\n\r\n"
        clients += [connection(plumbd, preview) for _ in range(STALLED)]
        clients += [connection(plumbd, b"GET /v1/cam") for _ in range(HALF_OPEN)]
        head = b"POST /v1/solve HTTP/1.1\r\nHost: localhost\r\nContent-Type: application/json\r\nContent-Length: %d\r\n\r\n"
        body = b" " * ((8 << 20) - 1)
        clients += [connection(plumbd, head % (8 << 20) + body) for _ in range(LARGE)]
        taken, failed = health(plumbd, 200)
        crowded = rate(plumbd, 4)
        resident = plumbd.resident_mb()
        for client in clients:
            client.close()
        plumbd.end()
    text = (f"/healthz: median {taken[100]:.1f} ms, longest {taken[-1]:.0f} ms, {failed} of 200 unanswered; "
            f"{crowded:.1f} frames/s of {quiet:.1f} before; {resident:.0f} MB at most")
    held = not failed and taken[-1] <= 100 and crowded > 0.95 * quiet and resident <= 256
    bad = [] if held else [text]
    moment = f"{IDLE} idle, {STALLED} stalled (previews that are not read), {HALF_OPEN} with half a head, {LARGE} bodies of 8 MB"
    return [("greedy clients", moment, text, "yes" if held else "no", bad)]
