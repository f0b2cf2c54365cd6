"""Formulations, methods and models that users choose by name; profiles are in `crane_fmu.slave.straight_lines`."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TypeVar

import servocore as sc

FORMULATIONS: Mapping[str, sc.Formulation] = {
    "reduced": sc.Reduced(),
    "projected": sc.Projected(),
    "original": sc.Original(),
}
"""Formulations; the first is the default."""

METHODS: Mapping[str, sc.Method] = {
    "backward-euler": sc.BackwardEuler(),
    **{f"bdf{order}": sc.BDF(order) for order in range(1, 7)},
    **{f"radau{stages}": sc.RadauIIA(stages) for stages in range(1, 6)},
    "trapezoidal": sc.Trapezoidal(),
    **{f"gauss{stages}": sc.Gauss(stages) for stages in range(1, 6)},
    "generalized-alpha": sc.GeneralizedAlpha(),
}
"""Methods, BDF by order, Radau and Gauss by stages; the first is the default."""

MODELS = tuple(sc.scenes.rotary_crane().models)
"""Models of the crane; the first, and smallest, is the default."""

Choice = TypeVar("Choice")


def chosen(table: Mapping[str, Choice], name: str, kind: str) -> Choice:
    """Look a name up; raises `InvalidSetting` with the names there are.

    Parameters
    ----------
    table : mapping of str to Choice
        What there is to choose from.
    name : str
        The name that a user gave.
    kind : str
        What messages call its kind.

    Returns
    -------
    Choice
        Its entry.
    """
    if name not in table:
        raise sc.InvalidSetting(f"there is no {kind} {name!r}; there are {', '.join(table)}")
    return table[name]
