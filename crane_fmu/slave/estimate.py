"""Derivatives of the load path that are not connected: calls the function that `crane_fmu.build.estimates` has made."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import casadi as ca

from crane_fmu.slave.carried_functions import Call, called
from crane_fmu.slave.interface import ORDERS

SAMPLES = len(ORDERS) + 2
"""Samples that it takes to know the derivatives above a position; one less for each derivative that is connected."""

_SLIGHT = 1e-9  # of the size of a position: smaller changes are rounding


@dataclass(frozen=True)
class Estimation:
    """What estimates derivatives.

    Attributes
    ----------
    begin : callable
        (path as it is told for the start, highest connected derivative) -> [memory].
    follow : callable
        (memory, path as it is told, step, 1 if it is told for its end, highest connected derivative) -> [memory, path
        with what is estimated, error of its snap in m/s4, 0 while there are too few samples].
    worth : callable
        (error of the snap, path, outputs, p, peak of M_b so far) -> [(peak, what the error is worth in N.m of M_b,
        from where on that is told)].
    size : int
        Length of the memory.
    """

    begin: Call
    follow: Call
    worth: Call
    size: int


def estimation(functions: Mapping[str, ca.Function]) -> Estimation:
    """Return what an FMU carries."""
    begin, follow, worth = (functions[name] for name in ("first_samples", "estimate", "worth"))
    return Estimation(called(begin), called(follow), called(worth), follow.numel_in(0))


def in_motion(order: int) -> str:
    """Say that a load starts in motion; `order` is the highest derivative that is connected."""
    return (
        f"the load starts in motion: {_above(order)} are known after {SAMPLES - order} samples; until then M_b, F and"
        " M_w are not those of the path"
    )


def too_rough(order: int) -> str:
    """Say that samples are too rough, as a format of the snap's error, what it is worth, and the peak of M_b."""
    return (
        f"{_above(order)} are estimated to %.2g m/s4 of snap only, worth %.2g N.m of M_b, whose peak so far is %.2g"
        " N.m: the samples are too rough, or too far apart; connect further derivatives, or lay a smooth path through"
        " the samples first"
    )


def _above(order: int) -> str:
    return f"derivatives above the load's {ORDERS[order]}"


def contradiction(before: Sequence[float], now: Sequence[float], order: int) -> str:
    """Say which derivative changes while all connected ones above it stay exactly zero; empty if none does.

    Parameters
    ----------
    before, now : sequence of 15 floats
        What was told for two instants.
    order : int
        Highest derivative that is connected.
    """
    top = slice(3 * order, 3 * order + 3)
    if any(now[top]) or any(before[top]):  # as nearly always in motion: nothing below can be a contradiction
        return ""
    size = max(1.0, *map(abs, now[:3]))
    for k in range(order):
        changed = max(abs(now[j] - before[j]) for j in range(3 * k, 3 * k + 3)) > _SLIGHT * size
        above = range(3 * k + 3, 3 * order + 3)
        if changed and not any(before[j] or now[j] for j in above):
            stay = "stay" if order - k > 1 else "stays"
            return (
                f"the load's {ORDERS[k]} changes, but its {' and '.join(ORDERS[k + 1 : order + 1])} {stay} zero:"
                f" connect what is missing, or set connected = {ORDERS[k]} to have it estimated"
            )
    return ""
