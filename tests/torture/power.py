"""Power that fails: the disk as it may be left, with what was written since each file's last sync there or not.

The writes of a session go through `faults.c`, which takes them down. At seeded random points of that log the disk is put
together anew: of each file what was written before its last sync, and of the later writes none, a random part, or all but
the bytes after a random sector. Names (creation, renaming, removal) are taken as they were: the model of a file system that
journals its names in order, as ext4 does.
"""

import random
import tempfile
from pathlib import Path

from plumbd import Announced, Plumbd, check, missing, until

SECTOR = 512


class Entry:
    def __init__(self, what, path, offset, data, end):
        self.what, self.path, self.offset, self.data, self.end = what, path, offset, data, end


def entries(log):
    """What the log says, each with the log's length after it."""
    data, at, found = Path(log).read_bytes(), 0, []
    while at < len(data):
        line = data.index(b"\n", at)
        what, path, offset, length = data[at:line].decode().split("\t")
        at = line + 1
        held = b""
        if what in "wr":
            held = data[at : at + int(length)]
            at += int(length)
        found.append(Entry(what, path, int(offset), held, at))
    return found


def apply(files, entry):
    held = files.setdefault(entry.path, bytearray())
    if entry.what == "w":
        if len(held) < entry.offset:
            held.extend(bytes(entry.offset - len(held)))
        held[entry.offset : entry.offset + len(entry.data)] = entry.data
    elif entry.what == "t":
        del held[entry.offset :]
        held.extend(bytes(entry.offset - len(held)))
    elif entry.what == "u":
        files.pop(entry.path, None)
    elif entry.what == "r":
        files[entry.data.decode()] = files.pop(entry.path)


def after_cut(log, cut, how, generator):
    """The files after the power fails at this entry: `how` is what becomes of writes that were not synced."""
    synced = {}
    for index, entry in enumerate(log[:cut]):
        if entry.what == "s":
            synced[entry.path] = index
    files = {}
    for index, entry in enumerate(log[:cut]):
        if entry.what == "w" and index > synced.get(entry.path, -1):
            if how == "none" or (how == "some" and generator.random() < 0.5):
                continue
            if how == "torn":
                whole = generator.randrange(0, len(entry.data) + 1, SECTOR)
                entry = Entry("w", entry.path, entry.offset, entry.data[:whole], entry.end)
        if entry.what != "s":
            apply(files, entry)
    return files


def logged(shim, folder):
    """A session with views, its solve, an approval: the log, and what was announced at which length of it."""
    log = Path(folder) / "log"
    log.touch()
    announced = Announced()
    environment = {"LD_PRELOAD": shim, "PLUMB_FAULT_DIR": f"{folder}/store", "PLUMB_FAULT_LOG": str(log)}
    plumbd = Plumbd(folder, announced=announced, position=lambda: log.stat().st_size, **environment).ready().listen()
    answered = []
    for _ in range(2):
        session = plumbd.begin()
        answered.append((log.stat().st_size, "session", session))
        until(lambda: announced.views.get(session, 0) >= 12, 60)
        status, document = plumbd.ask(f"/v1/sessions/{session}/stop", {})
        assert status == 200, document
        answered.append((log.stat().st_size, "finished", session))
        answered.append((log.stat().st_size, "calibration", document["calibration"]))
    plumbd.kill()
    return entries(log), announced.heard, answered


def torture(shim, cuts, seed):
    """A row of the table for each fate of what was not synced."""
    rows, generator = [], random.Random(seed)
    with tempfile.TemporaryDirectory() as folder:
        log, heard, answered = logged(shim, folder)
        first = next(index for index, entry in enumerate(log) if entry.what == "s") + 1
        for how, words in [("none", "none of what was not synced is there"), ("some", "half of the writes that were not synced are there, by chance"),
                           ("torn", "of each write that was not synced some sectors are there")]:
            bad, views = [], 0
            for _ in range(cuts):
                cut = generator.randrange(first, len(log) + 1)
                problems, announced = after(log, cut, how, generator, (heard, answered), folder)
                views += announced
                bad += [(cut, problem) for problem in problems]
            rows.append(("the power fails", f"any write of two sessions, solved; {words}", f"{views} announced views, {len(bad)} losses", f"{cuts - len({cut for cut, _ in bad})} of {cuts}", bad))
    return rows


def after(log, cut, how, generator, said, was_in):
    """What is wrong after this cut, and how many views had been announced by then."""
    heard, answered = said
    length = log[cut - 1].end
    with tempfile.TemporaryDirectory() as folder:
        for path, held in after_cut(log, cut, how, generator).items():
            place = Path(path.replace(was_in, folder))
            place.parent.mkdir(parents=True, exist_ok=True)
            place.write_bytes(held)
        announced = Announced()
        for position, session, views in heard:
            if position <= length:
                announced.views[session] = max(views, announced.views.get(session, 0))
        before = [(kind, what) for position, kind, what in answered if position <= length]
        announced.calibrations = {what for kind, what in before if kind == "calibration"}
        try:
            plumbd = Plumbd(folder, config="", announced=Announced()).ready()
        except AssertionError as error:
            return [str(error)], sum(announced.views.values())
        problems = missing(plumbd, announced)
        for kind, session in before:
            state = (plumbd.ask(f"/v1/sessions/{session}")[1] or {}) if kind == "finished" else {"state": "finished"}
            if not isinstance(state, dict) or state.get("state") != "finished":
                problems.append(f"session {session} was finished, and is not")
        plumbd.end()
        status, text = check(folder)
        return problems + ([text] if status else []), sum(announced.views.values())
