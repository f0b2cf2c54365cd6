"""The command ``servocore sweep``: peaks and margins of many cases, into a store that a later run can complete."""

from __future__ import annotations

import re
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from servocore.cli.command import option
from servocore.cli.console import PatientProgress
from servocore.cli.kinds import COUNT, FOLDER, SEED, text
from servocore.cli.options import MOST_ROWS, GivenLimits, GivenPath, Subject, output
from servocore.errors import InvalidSetting, extra
from servocore.files import require_writable, write_together
from servocore.planning.sweep import sweep
from servocore.planning.sweep_settings import drawn

EXAMPLES = (
    "rotary_crane --vary load_mass=50..150:100 --vary duration=10..30:50 --limit F=60 --output study",
    "rotary_crane --vary load_mass=50..150 --vary bridge_inertia=400..600 --sample 100000 --seed 1 --output drawn"
    " --resume",
)

_RANGE = re.compile(r"([^=]+)=(.+?)\.\.([^:]+?)(?::([^:]+))?")
_STORE, _TABLES, _PAGE, _FIGURE = "sweep.zarr", "sweep.parquet", "index.html", "sweep.png"


@dataclass(frozen=True)
class Cases:
    """What varies, and what is computed of it."""

    title = "Sweep"

    output: Path = output("DIR", f"Where {_STORE} and the page go.", FOLDER, ...)
    vary: tuple[str, ...] = option(
        "--vary", kind=text("load_mass=50..150:100"), metavar="NAME=LOW..HIGH:COUNT", default=(),
        help="Vary a parameter, or the duration, from LOW to HIGH; of several, all combinations. With --sample without"
        " :COUNT.",
    )  # fmt: skip
    sample: int | None = option(
        "--sample", kind=COUNT, metavar="COUNT", help="Draw so many cases from the ranges instead."
    )
    seed: int | None = option(
        "--seed", kind=SEED, metavar="N", help="Of --sample; the same seed draws the same cases. Default: 0."
    )
    instants: int = option(
        "--instants", kind=COUNT, metavar="N", default=201, help="Evaluate each case at so many. Default: 201."
    )
    inputs: bool = option("--inputs", help="Store the inputs over time, too.")
    scheduler: str | None = option(
        "--scheduler", kind=text("tcp://localhost:8786"), metavar="ADDRESS",
        help="Compute on the workers of this Dask scheduler.",
    )  # fmt: skip
    resume: bool = option("--resume", help="Complete a store that an earlier run left.")
    parquet: bool = option("--parquet", help=f"Write a folder of tables, {_TABLES}, instead.")

    def varied(self) -> Any:
        """Return rows of values by name, or the drawn table; raises `InvalidSetting` where nothing varies."""
        if not self.vary:
            raise InvalidSetting("nothing varies: use --vary NAME=LOW..HIGH:COUNT, as in load_mass=50..150:100")
        ranges = dict(_range(text, self.sample is None) for text in self.vary)
        if len(ranges) < len(self.vary):
            raise InvalidSetting("--vary names something twice")
        if self.seed is not None and self.sample is None:
            raise InvalidSetting("--seed belongs to --sample")
        if max(self.instants, self.sample or 1, *(count for _, _, count in ranges.values())) > MOST_ROWS:
            raise InvalidSetting(f"more than {MOST_ROWS:g} values or instants fill the memory: take fewer")
        if self.sample is not None:
            return drawn({name: (low, high) for name, (low, high, _) in ranges.items()}, self.sample, self.seed or 0)
        return {name: np.linspace(low, high, count) for name, (low, high, count) in ranges.items()}


def sweep_scene(subject: Subject, path: GivenPath, limits: GivenLimits, cases: Cases) -> None:
    """Compute peaks, margins and swing of many cases of a scene.

    The results stream into DIR/sweep.zarr, which xarray opens. A run that was interrupted goes on with --resume
    where it stopped; other settings are refused. A case that fails is a row with its sentence. DIR/index.html
    shows the peak of the first input over what varies.
    """
    extra("xarray")  # what may be missing is told before the work
    from servocore.cli.sweep_figure import sweep_page  # noqa: PLC0415 - slow

    moved = path.along(subject.chosen(), subject.model)
    bounds, varied = limits.bounds(), cases.varied()
    require_writable(cases.output, cases.output)
    store = cases.output / (_TABLES if cases.parquet else _STORE)
    with _client(cases.scheduler) as client, PatientProgress("sweeping") as progress:
        try:
            found = sweep(
                moved, varied, limits=bounds, store=store, resume=cases.resume, instants=cases.instants,
                inputs=cases.inputs, model=subject.model, distributed=client, progress=progress,
            )  # fmt: skip
        except KeyboardInterrupt:
            raise KeyboardInterrupt(f"stopped; --resume goes on after what is in {store}") from None
    page, figure = sweep_page(found, moved.name, store.name)
    write_together({cases.output / _PAGE: page, cases.output / _FIGURE: figure})
    failed = int((found.failure.to_numpy() != "").sum())
    print(f"{store}: {found.failure.size} cases, {failed} of them not solved; see {cases.output / _PAGE}")


def _range(text: str, counted: bool) -> tuple[str, tuple[float, float, int]]:
    found = _RANGE.fullmatch(text)
    wanted = "NAME=LOW..HIGH:COUNT" if counted else "NAME=LOW..HIGH"
    try:
        if found is None or (found[4] is None) is counted:
            raise ValueError
        low, high, count = float(found[2]), float(found[3]), int(found[4] or 1)
    except ValueError:
        beside = "" if counted else " beside --sample, which says how many"
        example = f"as in load_mass=50..150{':100' * counted}"
        raise InvalidSetting(f"--vary {text} is not {wanted}{beside}, {example}") from None
    if not (-np.inf < low <= high < np.inf and count >= 1):
        raise InvalidSetting(f"--vary {text}: the range must be finite, from LOW to HIGH, and its count at least 1")
    return found[1].strip(), (low, high, count)


@contextmanager
def _client(address: str | None) -> Iterator[Any]:
    """Offer a client of a Dask scheduler, or None without an address."""
    if address is None:
        yield None
        return
    distributed = extra("distributed")
    try:
        client = distributed.Client(address, timeout="10s")
    except (OSError, ValueError) as error:
        raise InvalidSetting(f"no Dask scheduler answers at {address}: {error}") from error
    with client:
        yield client
