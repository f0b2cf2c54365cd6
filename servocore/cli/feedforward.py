"""The command ``feedforward``: the feedforward inputs of a scene for a prescribed path, as a table."""

from __future__ import annotations

import sys
import time

import numpy as np

from servocore.checks.better_solutions import LARGEST_UNWARNED
from servocore.cli.console import PatientProgress, ResultOfNoUse, deliver
from servocore.cli.options import Certified, Computation, GivenLimits, GivenPath, Subject, Table
from servocore.cli.run_summary import chosen_columns, details, summary, table_pieces
from servocore.formulations.reduced import Reduced
from servocore.model.scene import Scene
from servocore.numerics.units import behind
from servocore.planning.durations import shortest_duration_told
from servocore.problem import Problem
from servocore.solution import Solution
from servocore.solvers.solve import solve

EXAMPLES = (
    "overhead_crane --from 0 -4 --to 5 -4 --duration 6 -o inputs.csv",
    "rotary_crane --waypoints cycle.csv --limit F=60 --columns M_b,F,swing",
)

FAR_OFF = 0.5
"""Error of an input relative to its peak from which on the inputs are of no use."""

_PROVED_ROWS = 2000  # a table of more is compared with the proved inputs nowhere
_UNNOTICED = 1e-3  # of the largest input: a smaller one may be all round-off


def feed_forward(
    subject: Subject, path: GivenPath, limits: GivenLimits, how: Computation, table: Table, certified: Certified
) -> None:
    """Compute the feedforward inputs for a prescribed path (inverse dynamics), as a table.

    The path is a file of samples (--reference) or of waypoints (--waypoints), a line from rest to rest (--from, --to,
    --duration), or else that of the scene. The table has one row a step: time, inputs, observables, outputs. Peaks,
    rest at the ends, the estimated error of the inputs and the verdict of the certificate, a proof for all times, are
    printed on the error stream. Where an input is off by 50 % of its peak or more, which can happen with a
    --formulation, the exit code is 1.
    """
    accuracy, scene = how.accuracy(), subject.chosen()
    names = chosen_columns(table.columns, scene, subject.model)
    with PatientProgress("computing the inputs") as progress, np.errstate(all="ignore"):  # not finite is refused
        moved = path.along(scene.with_limits(**limits.bounds()), subject.model)
        how.require(moved.reference.duration)
        began = time.process_time(), time.perf_counter()
        with shortest_duration_told(moved, subject.model):
            solution = solve(
                moved, how.formulation, how.method, step=accuracy, output_step=how.output_step, model=subject.model,
                progress=progress,
            )  # fmt: skip
        seconds = time.process_time() - began[0], time.perf_counter() - began[1]
        useless = None if isinstance(how.formulation, Reduced | None) else _far_off(moved, solution, subject.model)
        lines = [] if useless else [*summary(solution), *_certificate(certified, how, moved, subject.model, solution)]
        lines += details(solution, seconds) if table.verbose and not useless else []
        contents = table.picture(lambda _: solution.plot(names))
    deliver(table_pieces(solution, names), table.output, contents)
    if useless:
        raise ResultOfNoUse(useless)
    print(*lines, sep="\n", file=sys.stderr)


def _certificate(
    certified: Certified, how: Computation, scene: Scene, model: str | None, solution: Solution
) -> list[str]:
    """Return the line of the certificate: of the motion alone where a proof of every row would be slow.

    Inputs by time steps that were asked for are not refused for their errors.
    """
    if len(solution.t) > _PROVED_ROWS:
        return certified.line(scene, model, strict=True)
    reduced = isinstance(how.formulation, Reduced | None)
    exact = reduced and Problem.of(scene, model).flat
    return certified.line(solution, tolerance=1e-8 if exact else LARGEST_UNWARNED, strict=reduced)


def _far_off(scene: Scene, solution: Solution, model: str | None) -> str | None:
    """Return a sentence if an input is off from the closed form by `FAR_OFF` of its peak or more, else None."""
    if scene.closed_form is None or scene.independent_solution is not None:
        return None  # no exact formula
    exact = scene.exact(solution.t)
    inputs = [quantity.name for quantity in scene.model(model).inputs]
    peaks = {name: float(np.abs(exact[name]).max()) for name in inputs}
    off = {name: np.nan_to_num(np.abs(solution[name] - exact[name]), nan=np.inf) for name in inputs}
    least = _UNNOTICED * max(peaks.values())
    shares = {name: float(off[name].max()) / (max(peaks[name], least) or 1.0) for name in inputs}
    worst = max(inputs, key=lambda name: shares[name])
    if shares[worst] < FAR_OFF:
        return None
    unit, k = behind(solution.unit(worst)), int(off[worst].argmax())
    return (
        f"{solution.route}: these inputs are of no use: {worst} is off by {100.0 * shares[worst]:.3g} % of its peak; at"
        f" t = {solution.t[k]:.6g} s it is {solution[worst][k]:.4g}{unit} instead of {exact[worst][k]:.4g}{unit};"
        " --formulation reduced is exact"
    )
