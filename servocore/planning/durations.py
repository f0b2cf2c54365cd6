"""The shortest duration in which a given law keeps all limits, by uniform time scaling."""

from __future__ import annotations

import math
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from functools import partial

import numpy as np

from servocore.errors import InvalidModel, LimitBroken, PlanningFailed, ServocoreError
from servocore.model.scene import Scene, require_scene
from servocore.numerics.compiled_calls import Array
from servocore.planning.limit_rows import Rows, limit_rows, require_at_rest
from servocore.planning.time_laws import shortest_kept
from servocore.problem import Problem
from servocore.references.base import survey
from servocore.references.timed_path import TimeScaled
from servocore.solvers.exact_inversion import ExactInversion

_DIGITS = 4
_MOST_BUMPS = 20


def shortest_duration(scene: Scene, model: str | None = None) -> float:
    """Return the shortest duration at which the law of a scene's path keeps all limits, rounded up to four digits.

    The law is slowed down or sped up evenly. A longer duration may break a limit again: the speed of a trolley above a
    swinging load is a sum of powers of the duration with both signs.

    Parameters
    ----------
    scene : Scene
        Without internal dynamics, with limits.
    model : str, optional
        Model of the scene; its smallest when not given.

    Returns
    -------
    float
        In s.

    Raises
    ------
    InvalidReference
        If a limit is broken at rest somewhere on the path: then no duration helps.
    InvalidModel
        If a limit is on the rate of something that is differentiated already, or the equations depend on time.
    PlanningFailed
        If no duration was found.
    """
    require_scene(scene, "shortest_duration")
    problem, path = Problem.of(scene, model), scene.reference
    if problem.system.time.numel():
        raise InvalidModel(f"{scene.name}: its equations depend on time, and no duration can be found")
    t = survey(path)
    places = path.jet(t, 0)[:, 0]
    rows = limit_rows(problem, places[0])
    require_at_rest(rows, problem, places)
    jets = path.jet(t, rows.order)
    duration = shortest_kept(partial(_kept, rows, problem, t, jets))
    for _ in range(_MOST_BUMPS):
        if not math.isfinite(duration):
            break
        step = 10.0 ** (math.floor(math.log10(duration)) + 1 - _DIGITS)
        rounded = round(math.ceil(duration / step) * step, 12)
        with suppress(LimitBroken):  # between two instants of the grid
            ExactInversion(scene.with_reference(TimeScaled.to(path, rounded)), model)
            return rounded
        duration = rounded + 0.5 * step
    raise PlanningFailed(f"{scene.name}: no duration was found at which the law keeps all limits")


@contextmanager
def shortest_duration_told(scene: Scene, model: str | None = None) -> Iterator[None]:
    """Add to a refusal for a broken limit the shortest duration at which the law keeps all limits."""
    try:
        yield
    except LimitBroken as error:
        try:
            shortest = shortest_duration(scene, model)
            advice = f"the shortest duration at which the same law keeps all limits is {shortest:.10g} s"
        except LimitBroken:
            advice = "no duration helps, for a limit is broken even at rest somewhere on that path"
        except ServocoreError:
            advice = "no duration is known at which it is kept"
        raise LimitBroken(f"{error}; {advice}") from None


def _kept(rows: Rows, problem: Problem, t: Array, jets: Array, duration: float) -> bool:
    slower = duration / problem.reference.duration
    values, integrands, _ = rows.at(jets / slower ** np.arange(jets.shape[1])[:, None], problem.p)
    of_run = np.trapezoid(integrands, slower * t) <= rows.most
    return bool(of_run.all() and ((values <= 1.0) & (values >= rows.lower[:, None])).all())
