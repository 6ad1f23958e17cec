"""Every fault at every moment, measured: the table of docs/reliability.md. Loopback only; `make torture` bounds it to 30 minutes."""

import argparse
import re
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import crowds
import disk
import kills
import power
import rot
from plumbd import BINARY, ROOT


def shim(folder):
    """`faults.c`, built."""
    library = Path(folder) / "faults.so"
    source = Path(__file__).parent / "faults.c"
    subprocess.run(["cc", "-O1", "-shared", "-fPIC", "-o", library, source, "-ldl", "-lpthread"], check=True)
    return str(library)


def bombs():
    """The small files that unpack to gigabytes, as `make test` has them, under a limit of 1 GB."""
    tests = ROOT / "tests/python/test_small_bombs.py"
    run = subprocess.run([sys.executable, "-m", "pytest", "-q", tests], capture_output=True, text=True, env={"PLUMB": BINARY, "PATH": "/usr/bin:/bin"})
    passed, failed = (int((re.search(rf"(\d+) {word}", run.stdout) or [0, 0])[1]) for word in ("passed", "failed"))
    bad = [run.stdout[-2000:]] if run.returncode else []
    return [("a small file that asks for gigabytes", "under `prlimit --as=1G`", "refused in one line, within 256 MB and 10 s", f"{passed} of {passed + failed}", bad)]


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    for name, default in [("kills", 100), ("rounds", 40), ("cuts", 100), ("flips", 1000), ("seed", 1)]:
        parser.add_argument(f"--{name}", type=int, default=default)
    asked = parser.parse_args()
    began, rows = time.monotonic(), []
    with tempfile.TemporaryDirectory() as folder:
        library = shim(folder)
        tortures = [lambda: kills.torture(asked.kills, asked.seed), lambda: disk.torture(library, asked.rounds), lambda: disk.torture_reads(library, asked.rounds),
                    lambda: power.torture(library, asked.cuts, asked.seed), lambda: rot.torture(asked.flips, asked.seed), crowds.torture, bombs]
        for torture in tortures:
            for row in torture():
                rows.append(row)
                print("| " + " | ".join(row[:4]) + " |", flush=True)
                for problem in row[4]:
                    print(f"  does not hold: {problem}", file=sys.stderr, flush=True)
    print(f"{time.monotonic() - began:.0f} s", file=sys.stderr)
    return any(row[4] for row in rows)


if __name__ == "__main__":
    sys.exit(main())
