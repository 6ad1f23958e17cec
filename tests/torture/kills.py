"""`kill -9` at seeded random moments: of a session, a solve, an upgrade, a recording, an approval, a deletion."""

import random
import shutil
import sqlite3
import subprocess
import tempfile
import threading
import time
from pathlib import Path

from plumbd import BINARY, Announced, Plumbd, check, missing, until

FINISH = {"min_views": 8}


def later(plumbd, seconds):
    """Kills it after so long."""
    timer = threading.Timer(seconds, plumbd.kill)
    timer.start()
    return timer


def solved(plumbd, views=10):
    """A session that was stopped and solved."""
    session = plumbd.begin()
    until(lambda: plumbd.announced.views.get(session, 0) >= views, 60)
    status, document = plumbd.ask(f"/v1/sessions/{session}/stop", {})
    assert status == 200, document
    return document


class Store:
    """A folder whose store is killed again and again, and everything that was ever announced of it."""

    def __init__(self, folder, seed):
        self.folder, self.random, self.announced = folder, random.Random(seed), Announced()
        self.problems, self.kills = [], 0

    def start(self, **how):
        return Plumbd(self.folder, announced=self.announced, **how).ready().listen()

    def after_kill(self, what, more=lambda plumbd: []):
        """Starts again and compares; ends that one in good order."""
        self.kills += 1
        plumbd = self.start()
        self.problems += [f"{what}: {lost}" for lost in missing(plumbd, self.announced) + more(plumbd)]
        for session in plumbd.ask("/v1/sessions")[1]["sessions"]:
            if session["state"] == "collecting":
                plumbd.ask(f"/v1/sessions/{session['id']}", method="DELETE")
        plumbd.end()
        status, said = check(self.folder)
        if status:
            self.problems.append(f"{what}: {said}")


def session(store):
    plumbd = store.start()
    timer = later(plumbd, store.random.uniform(0.02, 0.8))
    plumbd.begin()
    timer.join()
    plumbd.process.wait()
    store.after_kill("session")


def solve(store):
    """Killed after it was asked to stop: it is solved when the daemon is back."""
    plumbd = store.start()
    session = plumbd.begin()
    until(lambda: store.announced.views.get(session, 0) >= 10, 60)
    timer = later(plumbd, store.random.uniform(0.0, 0.12))
    asked, _ = plumbd.ask(f"/v1/sessions/{session}/stop?wait=false", {})
    timer.join()
    plumbd.process.wait()

    def ends(plumbd):
        if asked != 202:
            return []
        state = lambda: plumbd.ask(f"/v1/sessions/{session}")[1]["state"]
        over = until(lambda: state() == "finished", 30)
        return [] if over is not None else [f"session {session} was to be solved, and is {state()}"]
    store.after_kill("solve", ends)


def recording(store):
    """At most a second of what was recorded is lost."""
    plumbd = store.start(pace="recorded")
    status, begun = plumbd.ask("/v1/cameras/front/recordings", {})
    assert status == 201, begun
    timer = later(plumbd, store.random.uniform(0.3, 2.5))
    frames = 0
    while timer.is_alive():
        status, now = plumbd.ask(f"/v1/recordings/{begun['id']}")
        frames = max(frames, now["frame_sets"]) if status == 200 else frames
        time.sleep(0.01)
    plumbd.process.wait()

    def kept(plumbd):
        listed = {one["id"]: one for one in plumbd.ask("/v1/recordings")[1]["recordings"]}
        if begun["id"] not in listed:
            return [f"recording {begun['id']} with {frames} frames is not listed"]
        file = next((store.folder / "store").rglob(f"*{begun['id']}*.mcap"))
        copy = store.folder / "copy.mcap"
        shutil.copy(file, copy)
        run = subprocess.run([BINARY, "record", "--repair", copy], capture_output=True, text=True)
        said = run.stdout + run.stderr
        # One without a whole chunk is refused: it has 0.
        found = [int(word) for word in said.replace(",", " ").split() if word.isdigit()]
        # The recording has 15 frames a second.
        if not found or max(found) < frames - 15:
            return [f"recording {begun['id']}: {said.strip()} of {frames} announced frames"]
        return []
    store.after_kill("recording", kept)


def approve(store):
    """The one whose approval was answered is the current one, or the one that was asked for next."""
    plumbd = store.start()
    known = plumbd.ask("/v1/cameras/front/calibrations")[1]["calibrations"]
    known = [calibration["id"] for calibration in known]
    while len(known) < 2:
        known.append(solved(plumbd)["calibration"])
    timer = later(plumbd, store.random.uniform(0.01, 0.4))
    answered, asked, k = None, None, 0
    while timer.is_alive() and plumbd.process.poll() is None:
        asked = known[k % 2]
        if plumbd.ask(f"/v1/calibrations/{asked}/approve", {})[0] == 200:
            answered, k = asked, k + 1
    timer.join()
    plumbd.process.wait()

    def current(plumbd):
        status, now = plumbd.ask("/v1/cameras/front/calibration")
        held = now["id"] if status == 200 else None
        return [] if answered is None or held in (answered, asked) else [f"{answered} was approved, {held} is current"]
    store.after_kill("approve", current)


def prune(store):
    """What was deleted stays so, what was not is whole."""
    plumbd = store.start()
    sessions = []
    for _ in range(6):
        session = plumbd.begin()
        until(lambda: store.announced.views.get(session, 0) >= 2, 30)
        plumbd.ask(f"/v1/sessions/{session}", method="DELETE")
        sessions.append(session)
    timer = later(plumbd, store.random.uniform(0.005, 0.08))
    deleted, asked = [], []
    for session in sessions:
        asked.append(session)
        if plumbd.ask(f"/v1/sessions/{session}?purge=true", method="DELETE")[0] in (200, 204):
            deleted.append(session)
    timer.join()
    plumbd.process.wait()
    # What was not answered may be there or not; if it is, it is whole.
    views = {session: store.announced.views.pop(session, 0) for session in asked}

    def gone(plumbd):
        problems = []
        for session in asked:
            status, document = plumbd.ask(f"/v1/sessions/{session}/views")
            if session in deleted and status != 404:
                problems.append(f"session {session} was deleted, and is back")
            elif status == 200 and len(document["views"]) < views[session]:
                problems.append(f"session {session} is half deleted")
        return problems
    store.after_kill("prune", gone)


def older(folder):
    """A store of the first schema with rows in it, as far as the newest one's columns go."""
    upgrades = Path(__file__).resolve().parents[2] / "src/store/upgrades/001.sql"
    path = folder / "store/plumb.sqlite"
    newest = sqlite3.connect(path)
    rows = {}
    for table, columns in [("sessions", "id, camera, state, started_at_ns, collecting_s, document"),
                           ("calibrations", "id, camera, session, created_at_ns, document")]:
        rows[table] = (columns, newest.execute(f"SELECT {columns} FROM {table}").fetchall())
    application = newest.execute("PRAGMA application_id").fetchone()[0]
    newest.close()
    for end in ("", "-wal", "-shm"):
        Path(f"{path}{end}").unlink(missing_ok=True)
    first = sqlite3.connect(path)
    first.executescript(upgrades.read_text())
    for table, (columns, held) in rows.items():
        marks = ", ".join("?" * (columns.count(",") + 1))
        first.executemany(f"INSERT INTO {table} ({columns}) VALUES ({marks})", held)
    first.execute(f"PRAGMA application_id = {application}")
    first.execute("PRAGMA user_version = 1")
    first.commit()
    first.close()
    return {table: len(held) for table, (_, held) in rows.items()}


def upgrade(store):
    """All of the upgrade or none: the rows are all there in any case."""
    with tempfile.TemporaryDirectory() as folder:
        shutil.copytree(store.folder / "store", Path(folder) / "store")
        counts = older(Path(folder))
        plumbd = Plumbd(folder)
        time.sleep(store.random.uniform(0.0, 0.06))
        plumbd.kill()
        store.kills += 1
        again = Plumbd(folder).ready()
        again.end()
        status, said = check(folder)
        found = sqlite3.connect(Path(folder) / "store/plumb.sqlite")
        for table, count in counts.items():
            held = found.execute(f"SELECT count(*) FROM {table}").fetchone()[0]
            if held != count:
                store.problems.append(f"upgrade: {held} of {count} rows of {table}")
        if status:
            store.problems.append(f"upgrade: {said}")
        found.close()


MOMENTS = {"a session collects": session, "a session solves": solve, "the schema is upgraded": upgrade,
           "a recording": recording, "an approval": approve, "a deletion": prune}


def torture(kills, seed):
    """A row of the table for each moment."""
    rows = []
    with tempfile.TemporaryDirectory() as folder:
        store = Store(Path(folder), seed)
        first = store.start()
        solved(first)
        first.end()
        each = dict.fromkeys(MOMENTS, kills // len(MOMENTS))
        each["a session collects"] += kills % len(MOMENTS)
        for moment, kill in MOMENTS.items():
            before, sessions = len(store.problems), len(store.announced.views)
            for _ in range(each[moment]):
                kill(store)
            bad = store.problems[before:]
            text = f"{len(bad)} of what was announced lost; {sum(store.announced.views.values())} announced views, {len(store.announced.calibrations)} calibrations so far"
            rows.append(("kill -9", moment, text, f"{each[moment] - len(bad)} of {each[moment]}", bad))
    return rows
