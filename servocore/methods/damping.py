"""Which methods damp errors of the inputs, and so whether smaller steps err less."""

from __future__ import annotations

from servocore.methods.base import Method
from servocore.methods.collocation import Gauss
from servocore.methods.generalized_alpha import GeneralizedAlpha
from servocore.methods.trapezoidal import Trapezoidal


def damps(method: Method) -> bool:
    """Whether a method damps errors of the inputs from step to step, as far as its kind is known."""
    undamped = isinstance(method, GeneralizedAlpha) and method.rho >= 1.0
    return not undamped and not isinstance(method, Gauss | Trapezoidal)


def errs_less_with_smaller_steps(method: Method, index: int) -> bool:
    """Whether smaller steps help on forms of an index: above 3, or above 1 undamped, errors grow with them."""
    return index <= 1 or (index <= 3 and damps(method))
