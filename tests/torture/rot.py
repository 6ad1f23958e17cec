"""Bytes that change at rest: one at a time, anywhere in the store."""

import random
import shutil
import tempfile
from pathlib import Path

from plumbd import Plumbd, check, until
from kills import Store, solved


def contents(plumbd):
    """Every session, view, image and calibration that is served."""
    found = {}
    for session in plumbd.ask("/v1/sessions")[1]["sessions"]:
        found["session", session["id"]] = session
        status, document = plumbd.ask(f"/v1/sessions/{session['id']}/views")
        for view in document["views"] if status == 200 else []:
            found["view", session["id"], view["n"]] = view
            status, image = plumbd.ask(view["picture"])
            if status == 200:
                found["image", session["id"], view["n"]] = image
    for calibration in plumbd.ask("/v1/cameras/front/calibrations")[1]["calibrations"]:
        found["calibration", calibration["id"]] = calibration
    return found


def differs(now, before):
    """Whether another thing is served; what comes from a calibration that is gone may be missing."""
    if not isinstance(now, dict):
        return now != before
    return any(value != before.get(name) and value is not None for name, value in now.items())


def one(folder, data, at, bit, whole):
    """What is wrong with a store whose byte at `at` has changed."""
    with tempfile.TemporaryDirectory() as other:
        store = Path(other) / "store"
        shutil.copytree(folder, store)
        damaged = bytearray(data)
        damaged[at] ^= bit
        (store / "plumb.sqlite").write_bytes(damaged)
        status, said = check(other)
        try:
            plumbd = Plumbd(other).ready()
        except AssertionError as error:
            # A number of the schema's version that is larger is taken for a newer program's.
            return "refused" if "newer" in str(error) else f"it does not start: {error}"
        now = contents(plumbd)
        named = status or plumbd.metric("plumb_store_unreadable_rows") or any("repair" in line for line in plumbd.log)
        plumbd.end()
        changed = [key for key in now if key in whole and differs(now[key], whole[key])]
        gone = [key for key in whole if key not in now]
        if [key for key in now if key not in whole]:
            return "rows that were never there"
        if changed:
            return f"served and changed: {changed[0]}"
        if gone and not named:
            return f"gone and not named: {gone[0]}"
        return "named" if named else "harmless"


def torture(flips, seed):
    """One row of the table."""
    generator = random.Random(seed)
    with tempfile.TemporaryDirectory() as folder:
        store = Store(Path(folder), seed)
        plumbd = store.start()
        for _ in range(2):
            solved(plumbd, views=12)
        until(lambda: plumbd.metric("plumb_sessions_paused") == 0)
        whole = contents(plumbd)
        plumbd.end()
        # In good order, so that all is in the one file.
        data = (Path(folder) / "store/plumb.sqlite").read_bytes()
        found, bad = {}, []
        for _ in range(flips):
            at, bit = generator.randrange(len(data)), 1 << generator.randrange(8)
            what = one(Path(folder) / "store", data, at, bit, whole)
            found[what] = found.get(what, 0) + 1
            if what not in ("named", "harmless", "refused"):
                bad.append((at, bit, what))
    text = f"{found.get('named', 0)} named and the rest served, {found.get('harmless', 0)} in no row's content, {found.get('refused', 0)} taken for a newer version and refused; {len(data)} bytes"
    return [("a byte of the database changes", f"at rest, {flips} positions", text, f"{flips - len(bad)} of {flips}", bad)]
