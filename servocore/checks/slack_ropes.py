"""Ropes that go slack: when their tension comes to zero or their length to infinity, and the duration that avoids it.

A load that moves aside while it falls as fast as gravity pulls needs a level rope, which never gets there.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from servocore.checks.findings import BISECTIONS
from servocore.checks.motion_limits import compile_watched
from servocore.errors import ServocoreError
from servocore.model.limits import Named, reported_quantities
from servocore.model.quantity import Quantity
from servocore.numerics.compiled_calls import Array
from servocore.problem import Problem
from servocore.references.base import survey
from servocore.references.timed_path import TimeScaled
from servocore.stepping.exact_evaluation import exact_unknowns
from servocore.structure.derivative_array import DerivativeArray

_SLACK = 0.02  # of the median before: tensions below, lengths above as many times
_LONGEST = 64.0  # times the duration


def slack_rope(problem: Problem) -> str:
    """Say when a rope of a problem without internal dynamics goes slack, and what duration would do; else empty."""
    quantities = reported_quantities(problem.system).values()
    signed = [each for each in quantities if each.positive or (each.never_negative and each.unit == "N")]
    if not (signed and problem.flat and isinstance(problem.resolved.outcome, DerivativeArray)):
        return ""
    if problem.reference.max_order < problem.array.reference_order:
        return ""
    said = _first_slack(problem, signed)
    duration = _least_duration(problem, signed) if said else 0.0
    return f"{problem.name}: {said}" * bool(said) + (
        f"; in more than {duration:.4g} s the same law keeps it taut" if duration else ""
    )


def _first_slack(problem: Problem, signed: Sequence[Quantity]) -> str:
    """Return which rope first goes slack and when, of quantities that are positive; empty if none does."""
    watched = compile_watched(problem.resolved, tuple((Named(each.name), False) for each in signed))

    def values(t: Array) -> Array:
        return watched.values(problem, t, exact_unknowns(problem, t)[0])

    path = problem.reference
    t = survey(path)
    found = values(t)
    bad = np.flatnonzero(~(found > 0.0).all(axis=0))
    if not len(bad) or bad[0] == 0:
        return ""
    good, beyond, usual = t[bad[0] - 1], t[bad[0]], np.median(found[:, : bad[0]], axis=1)
    for _ in range(BISECTIONS):
        middle = (good + beyond) / 2.0
        good, beyond = (middle, beyond) if (values(np.array([middle])) > 0.0).all() else (good, middle)
    for each, share in zip(signed, values(np.array([good]))[:, 0] / usual, strict=True):
        if each.unit == "N" and share < _SLACK:
            return f"the rope goes slack at t = {good:.6g} s: {each.name} comes to 0 N, and a rope cannot push"
        if each.unit == "m" and share * _SLACK > 1.0:
            return (
                f"the rope goes slack at t = {good:.6g} s: {each.name} grows beyond all bounds, for the load would fall"
                " as fast as gravity pulls it"
            )
    return ""


def _least_duration(problem: Problem, signed: Sequence[Quantity]) -> float:
    """Return the duration from which on the law keeps all ropes taut, rounded up to four digits; 0 if none is found."""
    path = problem.reference

    def kept(factor: float) -> bool:
        longer = replace(problem, reference=TimeScaled.to(path, factor * path.duration))
        try:
            return not _first_slack(longer, signed)
        except ServocoreError:
            return False

    longest = 1.0
    while not kept(longest):
        longest *= 2.0
        if longest > _LONGEST:
            return 0.0
    shortest = longest / 2.0
    for _ in range(BISECTIONS // 2):
        middle = (shortest + longest) / 2.0
        shortest, longest = (shortest, middle) if kept(middle) else (middle, longest)
    digits = 3 - int(np.floor(np.log10(longest * path.duration)))
    return float(np.ceil(longest * path.duration * 10.0**digits) / 10.0**digits)
