"""Paths in a page: a straight line with its time laws as JavaScript, any other as a table of its derivatives."""

from __future__ import annotations

from base64 import b64encode
from collections.abc import Mapping
from typing import Any

import casadi as ca
import numpy as np

from servocore.numerics.compiled_calls import Array
from servocore.references.base import Reference
from servocore.references.profiles import TIME_LAWS, Profile
from servocore.references.rest_to_rest import RestToRest
from servocore.references.time_augmented import TimeAugmented
from servocore.view.javascript import written


def packed(values: Array) -> str:
    """Return numbers as a text: their bytes, least first, in base 64."""
    return b64encode(np.ascontiguousarray(values, dtype="<f8").tobytes()).decode()


def path_of(reference: Reference, t: Array, orders: int) -> tuple[dict[str, Any], Mapping[str, str]]:
    """Return the data of a path for a page, and its functions as JavaScript by name.

    Parameters
    ----------
    reference : Reference
        The path.
    t : ndarray, shape (N,)
        Instants of a table.
    orders : int
        How many derivatives, the path itself included.
    """
    path = reference.path if isinstance(reference, TimeAugmented) else reference
    about = {"start_time": path.start_time, "duration": path.duration, "dimension": path.dimension}
    if not isinstance(path, RestToRest):
        return {**about, "kind": "table", "times": packed(t), "jets": packed(path.jet(t, orders - 1))}, {}
    laws = {law.name: law for law in (path.profile, *TIME_LAWS.values())}
    smooth = [law for law in laws.values() if law == path.profile or law.smoothness >= orders - 1]
    functions = {f"law{k}": _law(law, orders - 1) for k, law in enumerate(smooth)}
    described = [{"name": law.name, "shortest": law.shortest_duration} for law in smooth]
    return {**about, "kind": "line", "start": path.start, "end": path.end, "laws": described}, functions


def _law(profile: Profile, order: int) -> str:
    """Return ([elapsed, remaining, duration]) -> s and its derivatives."""
    given = ca.SX.sym("given", 3)
    elapsed, remaining, duration = ca.vertsplit(given)
    whole: Any = duration  # powers of a number are written as those of a symbol
    law = profile.law(elapsed, remaining, profile.numbers(whole, order), order)
    return written("law", [given], [ca.vertcat(ca.SX(0, 1), *law)])
