"""A disk that fails: each write and sync of a session, one after the other, with each errno, and each read; then it heals."""

import errno
import mmap
import struct
import tempfile
from pathlib import Path

from plumbd import Announced, Plumbd, check, missing, until

# Where the control file has the ints of each.
WRITES, READS = 0, 16
FAULTS = {"full": errno.ENOSPC, "read-only": errno.EROFS, "EIO": errno.EIO}


class Control:
    """The file that says to the disk when to fail."""

    def __init__(self, folder):
        self.path = Path(folder) / "control"
        self.path.write_bytes(bytes(32))
        self.file = self.path.open("r+b")
        self.ints = mmap.mmap(self.file.fileno(), 32)

    def fail_after(self, count, number, what=WRITES):
        self.ints[what + 4:what + 8] = struct.pack("i", number)
        self.ints[what + 12:what + 16] = struct.pack("i", 0)
        self.ints[what:what + 4] = struct.pack("i", count)

    def heal(self):
        self.ints[0:4] = self.ints[16:20] = bytes(4)

    def failed(self, what=WRITES):
        return struct.unpack("i", self.ints[what + 12:what + 16])[0]


def is_paused(plumbd):
    return plumbd.metric("plumb_sessions_paused") > 0


def one(shim, number, writes):
    """The `writes`-th write of a session fails, and all after it till the disk heals. What was seen."""
    with tempfile.TemporaryDirectory() as folder:
        control, announced = Control(folder), Announced()
        environment = {"LD_PRELOAD": shim, "PLUMB_FAULT_DIR": f"{folder}/store", "PLUMB_FAULT_CONTROL": str(control.path)}
        plumbd = Plumbd(folder, announced=announced, **environment).ready().listen()
        control.fail_after(writes, number)
        session = plumbd.begin()
        reached = until(lambda: control.failed() > 0, 20) is not None
        found = {"reached": reached, "refused": session is None}
        if session:
            found["said"] = until(lambda: is_paused(plumbd), 10) if reached else None
            found["ready"] = plumbd.ask("/readyz")[0]
        control.heal()
        if session:
            found["healed"] = until(lambda: not is_paused(plumbd), 20)
            before = announced.views.get(session, 0)
            found["goes on"] = until(lambda: announced.views.get(session, 0) > before, 20) is not None
        else:
            session = plumbd.begin()
            found["goes on"] = session is not None
            until(lambda: announced.views.get(session, 0) > 0, 20)
        plumbd.kill()
        again = Plumbd(folder, announced=announced).ready()
        found["lost"] = missing(again, announced)
        found["views"] = sum(announced.views.values())
        again.end()
        found["check"] = check(folder)[0]
        return found


def reading(shim, reads):
    """A store with a session in it is read: at a start the `reads`-th read fails and all after it till the disk heals, then the same
    while it is served. What was seen."""
    with tempfile.TemporaryDirectory() as folder:
        control, announced = Control(folder), Announced()
        environment = {"LD_PRELOAD": shim, "PLUMB_FAULT_DIR": f"{folder}/store", "PLUMB_FAULT_CONTROL": str(control.path)}
        plumbd = Plumbd(folder, announced=announced, **environment).ready().listen()
        session = plumbd.begin()
        until(lambda: announced.views.get(session, 0) >= 6, 20)
        plumbd.ask(f"/v1/sessions/{session}/stop", {})
        until(lambda: plumbd.ask(f"/v1/sessions/{session}")[1]["state"] == "finished", 30)
        plumbd.kill()

        control.fail_after(reads, errno.EIO, READS)
        found = {"starts": True, "wrong": []}
        try:
            plumbd = Plumbd(folder, announced=announced, **environment).ready()
        except AssertionError as error:
            found["starts"] = False
            said = [line for line in str(error).splitlines() if line.strip()]
            if not any("store" in line or "I/O" in line for line in said) or "panicked" in str(error):
                found["wrong"].append(f"a start said {said}")
        found["reached at the start"] = control.failed(READS) > 0
        control.heal()
        if not found["starts"]:
            plumbd = Plumbd(folder, announced=announced, **environment).ready()
        control.fail_after(reads, errno.EIO, READS)
        paths = [f"/v1/sessions/{session}/views", "/v1/sessions", "/v1/cameras/front/calibrations"]
        paths += [f"/v1/sessions/{session}/views/{number}.jpg" for number in range(announced.views[session])]
        statuses = [plumbd.ask(path)[0] for path in paths * 3]
        found["failed requests"] = sum(status >= 500 for status in statuses)
        found["reached while serving"] = control.failed(READS) > 0
        if plumbd.process.poll() is not None or any(status not in (200, 500, 503) for status in statuses):
            found["wrong"].append(f"answered {statuses}")
        control.heal()
        found["lost"] = missing(plumbd, announced)
        plumbd.end()
        again = Plumbd(folder, announced=announced).ready()
        found["lost"] += missing(again, announced)
        found["views"] = sum(announced.views.values())
        again.end()
        found["check"] = check(folder)[0]
        return found


def torture_reads(shim, rounds):
    """The row of reads that fail."""
    all_found = [reading(shim, reads) for reads in range(1, rounds + 1)]
    bad = [(k + 1, found) for k, found in enumerate(all_found) if found["lost"] or found["check"] or found["wrong"]]
    count = lambda name: sum(bool(found[name]) for found in all_found)
    text = (f"{sum(found['views'] for found in all_found)} announced views, {sum(len(found['lost']) for found in all_found)} lost; of "
            f"{count('reached at the start')} starts that met it {rounds - count('starts')} refused in a line; of {count('reached while serving')} "
            f"daemons that met it none ended, {sum(found['failed requests'] for found in all_found)} requests answered with 500 or 503")
    moment = f"read 1 to {rounds} of a start, then of a served store, and all after it"
    return [("the disk answers EIO when read", moment, text, f"{rounds - len(bad)} of {rounds}", bad)]


def torture(shim, rounds):
    """A row of the table for each fault."""
    rows = []
    for name, number in FAULTS.items():
        all_found = [one(shim, number, writes) for writes in range(1, rounds + 1)]
        said = [found["said"] for found in all_found if found.get("said") is not None]
        healed = [found["healed"] for found in all_found if found.get("healed") is not None]
        bad = [(k + 1, found) for k, found in enumerate(all_found)
               if found["lost"] or found["check"] or not found["goes on"] or not found["reached"]
               or (not found["refused"] and (found["said"] is None or found["healed"] is None))]
        held = f"{rounds - len(bad)} of {rounds}"
        text = (f"{sum(found['views'] for found in all_found)} announced views, {sum(len(found['lost']) for found in all_found)} lost; "
                f"{sum(found['refused'] for found in all_found)} starts refused; paused and said so within {max(said, default=0):.2f} s, "
                f"went on within {max(healed, default=0):.1f} s of the disk's recovery")
        rows.append((f"the disk is {name}" if name != "EIO" else "the disk answers EIO", f"write or sync 1 to {rounds} of a session, and all after it", text, held, bad))
    return rows
