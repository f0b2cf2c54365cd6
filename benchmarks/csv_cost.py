"""What tables of a million rows cost: processor time and peak memory of reading a path and of writing inputs.

``python -m benchmarks.csv_cost`` prints a table; ``python -m benchmarks.csv_cost 10000`` does it with so many rows.
"""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np

import servocore as sc
from servocore.files import csv_pieces, write_together

MOST_SECONDS, MOST_MEGABYTES = 20.0, 1000.0
COMMANDS = (("crane_fmu", "feedforward"), ("servocore", "feedforward", "rotary_crane"))
LINE = ("--from", "5", "0", "-5", "--to", "-2", "2", "-2", "--duration", "20")


def measured(arguments: list[str], folder: Path) -> tuple[float, float]:
    """Return seconds of the processor and peak memory in MB of a command, run in a process of its own."""
    with subprocess.Popen(
        [sys.executable, "-m", *arguments], cwd=folder, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE
    ) as running:
        message = running.stderr.read().decode() if running.stderr else ""
        _, status, used = os.wait4(running.pid, 0)
        running.returncode = os.waitstatus_to_exitcode(status)
    if running.returncode:
        raise SystemExit(message)
    return used.ru_utime + used.ru_stime, used.ru_maxrss / 1e3


def main(rows: int = 1_000_000) -> None:
    """Print the figures of every run, and what it may take."""
    with tempfile.TemporaryDirectory() as scratch:
        folder = Path(scratch)
        path = sc.scenes.rotary_crane().reference
        t = np.linspace(path.start_time, path.end_time, rows + 1)
        write_together({folder / "path.csv": csv_pieces(["time", "x", "y", "z"], [t, path.jet(t, 0)[:, 0]])})
        runs = {"rows in": ["--reference", "path.csv"], "rows out": [*LINE, "--step", repr(20.0 / rows)]}
        print(f"{rows} rows; at most {MOST_SECONDS:g} s of the processor and {MOST_MEGABYTES:g} MB each")
        for command in COMMANDS:
            for name, options in runs.items():
                seconds, memory = measured([*command, *options, "-o", "inputs.csv"], folder)
                print(f"{' '.join(command):36} {name:9} {seconds:6.1f} s {memory:6.0f} MB", flush=True)


if __name__ == "__main__":
    main(*map(int, sys.argv[1:]))
