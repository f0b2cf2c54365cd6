"""Findings of the checks, and the one place that turns them into refusals, warnings and statements."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Iterable
from dataclasses import dataclass

import numpy as np

from servocore.errors import ServocoreError, ServocoreWarning
from servocore.numerics.compiled_calls import Array

ROUND_OFF = 1e-9
"""Of a quantity: the relative error of some hundred operations in double precision."""

FEWEST = 100
"""Intervals of a motion: longer ones hide what happens in between."""

BISECTIONS = 40
"""Halvings after which an interval is as short as round-off of its ends."""


def least_between(evaluate: Callable[[Array], Array], t: Array, k: int) -> float:
    """Return the time at which a smooth function of times is least, between the instants beside the k-th of `t`."""
    from scipy.optimize import minimize_scalar  # noqa: PLC0415 - kept out of the run time of an FMU

    def value(time: float) -> float:
        return float(np.nan_to_num(evaluate(np.array([time])), nan=np.inf).item())

    ends = t[max(k - 1, 0)], t[min(k + 1, len(t) - 1)]
    found = minimize_scalar(value, bounds=ends, method="bounded", options={"xatol": ROUND_OFF * (ends[1] - ends[0])})
    return min(float(t[k]), float(found.x), key=value)


@dataclass(frozen=True)
class Finding:
    """What a check found about a motion.

    Attributes
    ----------
    what : str
        What is the case and when, with the amount, the cause and an advice where these are known.
    error : type of ServocoreError, optional
        Of a finding that refuses the motion.
    warns : bool
        Whether it is warned of, besides being stated.
    """

    what: str
    error: type[ServocoreError] | None = None
    warns: bool = False


def bisected(
    holds: Callable[[float], bool], good: float, bad: float, halvings: int = BISECTIONS
) -> tuple[float, float]:
    """Return numbers close together of which the first is good and the second bad, between such numbers."""
    for _ in range(halvings):
        middle = (good + bad) / 2.0
        good, bad = (middle, bad) if holds(middle) else (good, middle)
    return good, bad


def told(name: str, route: str, findings: Iterable[Finding]) -> str:
    """Raise the error of the first finding that refuses a motion, warn of others, and return the statements.

    Parameters
    ----------
    name, route : str
        Of the system, for refusals, and of the run, for warnings.
    findings : iterable of Finding
        In the order of their weight.

    Raises
    ------
    ServocoreError
        Of the kind that the finding names.

    Warns
    -----
    ServocoreWarning
        For the findings that warn.
    """
    statements = ""
    for finding in findings:
        if finding.error is not None:
            raise finding.error(f"{name}: {finding.what}")
        if finding.warns:
            warnings.warn(f"{route}: {finding.what}", ServocoreWarning, stacklevel=4)
        else:
            statements += f"; {finding.what}"
    return statements
