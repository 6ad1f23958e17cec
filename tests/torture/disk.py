"""A disk that fails: each write and sync of a session, one after the other, with each errno; then it heals."""

import errno
import mmap
import struct
import tempfile
from pathlib import Path

from plumbd import Announced, Plumbd, check, missing, until

FAULTS = {"full": errno.ENOSPC, "read-only": errno.EROFS, "EIO": errno.EIO}


class Control:
    """The file that says to the disk when to fail."""

    def __init__(self, folder):
        self.path = Path(folder) / "control"
        self.path.write_bytes(bytes(16))
        self.file = self.path.open("r+b")
        self.ints = mmap.mmap(self.file.fileno(), 16)

    def fail_after(self, writes, number):
        self.ints[4:8] = struct.pack("i", number)
        self.ints[12:16] = struct.pack("i", 0)
        self.ints[0:4] = struct.pack("i", writes)

    def heal(self):
        self.ints[0:4] = bytes(4)

    def failed(self):
        return struct.unpack("i", self.ints[12:16])[0]


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
