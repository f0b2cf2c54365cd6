"""CasADi functions that are called with arrays, and what an FMU has of them: its feedback, its estimation."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache

import casadi as ca
import numpy as np

import servocore as sc
from crane_fmu.build.estimates import estimates_of
from crane_fmu.build.feedback_law import LAW_MODEL, feedback_functions
from servocore.numerics.compiled_calls import Array

Call = Callable[..., list[Array]]


def called(function: ca.Function) -> Call:
    """Return a function of vectors that are one-dimensional."""

    def call(*given: Array | list[float] | float) -> list[Array]:
        return [np.array(each).ravel(order="F") for each in function.call([ca.DM(each) for each in given])]

    return call


@dataclass(frozen=True)
class Sampled:
    """The law for one input time, see `feedback_functions`, or the estimator of `sc.SampledEstimates`."""

    begin: Call
    follow: Call


@cache
def laws() -> dict[str, Sampled]:
    """Return the feedback by input time."""
    found = feedback_functions(sc.scenes.rotary_crane().model(LAW_MODEL))
    return {
        time: Sampled(*(called(found[f"{name}_{time}"]) for name in ("begin", "feedback"))) for time in ("start", "end")
    }


@cache
def estimation() -> Sampled:
    """Return what estimates derivatives that are not connected."""
    found = estimates_of(sc.scenes.rotary_crane()).functions
    return Sampled(called(found["first_samples"]), called(found["estimate"]))
