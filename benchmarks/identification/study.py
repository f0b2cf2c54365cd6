"""One log after the other: errors, standard errors, bounds, stray; kept in a file, so that a study can be continued."""

from __future__ import annotations

import json
import time
import warnings
from collections.abc import Iterator
from dataclasses import asdict, dataclass, field
from pathlib import Path

import numpy as np
import numpy.typing as npt

import servocore as sc
from benchmarks.identification.cranes import KINDS, WRONG, changed, crane, multisine, sensors, without_friction
from servocore.effects.closed_loop import run_loop
from servocore.effects.model_inversion import inverted
from servocore.errors import ServocoreError
from servocore.identification.fit import Weights

_MIDDLE = 4.0  # s at which a log of family C begins


@dataclass(frozen=True)
class Case:
    """A log: kind of crane, family of sensors, seed, and the effect that the model lacks."""

    kind: str
    family: str
    seed: int
    wrong: str = ""


@dataclass
class Row:
    """Results of a case; errors, standard errors and their Cramer-Rao bounds are relative to the true values."""

    case: Case
    errors: list[float] = field(default_factory=list)
    standard_errors: list[float] = field(default_factory=list)
    bounds: list[float] = field(default_factory=list)
    seconds: float = np.nan
    doubts: list[str] = field(default_factory=list)
    settled: bool = True
    stray: float = np.nan
    predicted: float = np.nan
    believed: float = np.nan
    refused: str = ""

    @property
    def z(self) -> npt.NDArray[np.float64]:
        """Errors by standard errors."""
        return np.divide(self.errors, self.standard_errors)


def cases(cranes: int, special: int, first: int) -> Iterator[Case]:
    """Yield cases, the kinds and families in turn: of A and B as many cranes of each kind, and fewer special ones."""
    for k in range(cranes):
        for kind in KINDS:
            yield from (Case(kind, family, first + k) for family in "AB")
            if k < special:
                yield from (Case(kind, family, first + k) for family in "CD")
                yield from (Case(kind, "A", first + k, wrong) for wrong in WRONG)


def continued(file: Path, wanted: Iterator[Case]) -> Iterator[list[Row]]:
    """Run the cases that a file of results lacks, append each, and yield all results after each."""
    lines = file.read_text(encoding="utf-8").splitlines(keepends=True) if file.exists() else []
    lines = [line for line in lines if line.endswith("}\n")]  # the last one may have been cut off
    file.write_text("".join(lines), encoding="utf-8")
    rows = [Row(**{**each, "case": Case(**each["case"])}) for each in map(json.loads, lines)]
    yield rows
    done = {row.case for row in rows}
    for case in wanted:
        if case in done:
            continue
        rows = [*rows, attempted(case)]
        with file.open("a", encoding="utf-8") as stream:
            stream.write(json.dumps(asdict(rows[-1])) + "\n")
        yield rows


def attempted(case: Case) -> Row:
    """Return the results of a case, or the sentence of a refusal."""
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            return identified(case)
    except ServocoreError as error:
        return Row(case, refused=str(error))


def identified(case: Case) -> Row:
    """Identify a random crane."""
    random = np.random.default_rng(case.seed)
    plant, believed = crane(case.kind, random)
    path, loops = multisine(believed, random), sc.PositionLoops(random.uniform(5.0, 8.0))
    moved, real = believed.with_reference(path), changed(plant, case.wrong)
    sensed = sensors("A" if case.family in "AC" else "B", random)
    log = sc.measured(moved, plant=real, loops=loops, seed=case.seed, **sensed)
    logs = [log]
    if case.family == "C":
        logs = [{name: column[log["time"] > _MIDDLE] for name, column in log.items()}]
    if case.family == "D":
        again = believed.with_reference(multisine(believed, random))
        logs.append(sc.measured(again, plant=real, loops=loops, seed=case.seed + 1, **sensed))
    names = KINDS[case.kind]
    if case.wrong == "friction":
        moved, names = without_friction(case.kind, believed)
    began = time.process_time()
    found = sc.identify(moved, logs, names, loops=loops)
    seconds, true = time.process_time() - began, plant.parameter_values()
    row = Row(case, seconds=seconds, doubts=list(found.doubts), settled=found.estimate.settled)
    row.errors = [found.values[name] / true[name] - 1.0 for name in names]
    row.standard_errors = [found.standard_errors[name] / true[name] for name in names]
    bounds = cramer_rao(found, true)
    row.bounds = [bounds[name] for name in names]
    home = believed.model().home
    job = sc.rest_to_rest(home, [each + 1.5 for each in home], random.uniform(8.0, 15.0))
    predicted = found.stray(job)
    row.predicted = predicted.total if case.wrong else predicted.by_parameters
    row.stray, row.believed = (strayed(real, scene, job, loops) for scene in (found.scene(), believed))
    return row


def cramer_rao(found: sc.Identified, true: dict[str, float]) -> dict[str, float]:
    """Return the least standard errors that an unbiased estimate can have, at the true values.

    The noise is that of the samples, all of which count; the motion is free, and so are biases and delays.
    """
    fit, values, state = found.fit, np.array([true[name] for name in found.names]), found.estimate.state
    state = state._replace(x=np.concatenate([values / fit.scales, state.x[len(values) :]]))
    weights = [Weights(np.ones(data.noise.shape[1]), 1.0 / data.noise) for data in fit.stretches]
    information = fit.step(state, weights, 0.0)[1]
    bounds = np.sqrt(np.diag(np.linalg.inv(information)))[: len(values)] * fit.scales / np.abs(values)
    return dict(zip(found.names, bounds.tolist(), strict=True))


def strayed(plant: sc.Scene, scene: sc.Scene, job: sc.Reference, loops: sc.PositionLoops) -> float:
    """Return how far a plant without sensors strays under the feedforward of a scene, in mm."""
    model, real = (sc.Problem.of(each.with_reference(job)) for each in (scene, plant))
    drives = scene.effects.measured or tuple(quantity.name for quantity in scene.model().outputs)
    motion, own = (inverted(each, drives, 600) for each in (model, real))
    return 1e3 * run_loop(own, motion, motion.gains(loops)).error
