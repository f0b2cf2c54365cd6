"""The command ``servocore sweep``: peaks and margins of many cases, into a store that a later run can complete."""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import nullcontext
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from servocore.cli.command import option
from servocore.cli.console import PatientProgress
from servocore.cli.kinds import COUNT, COUNTED_RANGE, FOLDER, SEED, once, text
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

_STORE, _TABLES, _PAGE, _FIGURE = "sweep.zarr", "sweep.parquet", "index.html", "sweep.png"


@dataclass(frozen=True)
class Cases:
    """Varied parameters, and the results of each case."""

    title = "Sweep"

    output: Path = output("DIR", f"Folder for {_STORE} and the page.", FOLDER, ...)
    vary: tuple[Mapping[str, tuple[float, float, int | None]], ...] = option(
        "--vary", kind=COUNTED_RANGE, metavar="NAME=LOW..HIGH:COUNT", default=(),
        help="Vary a parameter, or the duration, from LOW to HIGH; all combinations of several. With --sample, omit"
        " :COUNT.",
    )  # fmt: skip
    sample: int | None = option(
        "--sample", kind=COUNT, metavar="COUNT", help="Draw this number of cases from the ranges instead."
    )
    seed: int | None = option(
        "--seed", kind=SEED, metavar="N", help="With --sample: the same seed draws the same cases. Default: 0."
    )
    instants: int = option(
        "--instants", kind=COUNT, metavar="N", default=201, help="Number of instants of each case. Default: 201."
    )
    inputs: bool = option("--inputs", help="Store the inputs over time, too.")
    scheduler: str | None = option(
        "--scheduler", kind=text("tcp://localhost:8786"), metavar="ADDRESS",
        help="Compute on the workers of this Dask scheduler.",
    )  # fmt: skip
    resume: bool = option("--resume", help="Complete the store of an earlier run.")
    parquet: bool = option("--parquet", help=f"Write a folder of tables, {_TABLES}, instead.")

    def varied(self) -> Any:
        """Return values by name, or the drawn table; raises `InvalidSetting` where nothing varies."""
        if not self.vary:
            raise InvalidSetting("nothing varies: use --vary NAME=LOW..HIGH:COUNT, as in load_mass=50..150:100")
        ranges = once("--vary", self.vary)
        for name, (_, _, count) in ranges.items():
            if (count is None) is (self.sample is None):
                raise InvalidSetting(f"--vary {name} is written {name}=LOW..HIGH:COUNT, with --sample {name}=LOW..HIGH")
        if self.seed is not None and self.sample is None:
            raise InvalidSetting("--seed belongs to --sample")
        if max(self.instants, self.sample or 1, *(count or 1 for _, _, count in ranges.values())) > MOST_ROWS:
            raise InvalidSetting(f"more than {MOST_ROWS:g} values or instants fill the memory: take fewer")
        if self.sample is not None:
            return drawn({name: (low, high) for name, (low, high, _) in ranges.items()}, self.sample, self.seed or 0)
        return {name: np.linspace(low, high, count or 1) for name, (low, high, count) in ranges.items()}


def sweep_scene(subject: Subject, path: GivenPath, limits: GivenLimits, cases: Cases) -> None:
    """Compute peaks, margins and swing of many cases of a scene.

    The results stream into DIR/sweep.zarr, which xarray opens. An interrupted run continues with --resume; other
    settings are refused. A case that fails is stored with its error. DIR/index.html shows the peak of the first
    input over the varied parameters.
    """
    extra("xarray")  # a missing package is refused before the work
    from servocore.cli.pictures import sweep_page  # noqa: PLC0415 - slow

    moved = path.along(subject.chosen(), subject.model)
    bounds, varied = limits.bounds(), cases.varied()
    require_writable(cases.output, cases.output)
    store = cases.output / (_TABLES if cases.parquet else _STORE)
    connection = nullcontext() if cases.scheduler is None else _client(cases.scheduler)
    with connection as client, PatientProgress("sweeping") as progress:
        try:
            found = sweep(
                moved, varied, limits=bounds, store=store, resume=cases.resume, instants=cases.instants,
                inputs=cases.inputs, model=subject.model, distributed=client, progress=progress,
            )  # fmt: skip
        except KeyboardInterrupt:
            raise KeyboardInterrupt(f"stopped; --resume completes {store}") from None
    page, figure = sweep_page(found, moved.name, store.name)
    write_together({cases.output / _PAGE: page, cases.output / _FIGURE: figure})
    failed = int((found.failure.to_numpy() != "").sum())
    print(f"{store}: {found.failure.size} cases, {failed} of them not solved; see {cases.output / _PAGE}")


def _client(address: str) -> Any:
    """Return a client of a Dask scheduler."""
    distributed = extra("distributed")
    try:
        return distributed.Client(address, timeout="10s")
    except (OSError, ValueError) as error:
        raise InvalidSetting(f"no Dask scheduler answers at {address}: {error}") from error
