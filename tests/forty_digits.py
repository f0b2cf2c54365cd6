"""Numbers of forty digits as objects in NumPy arrays: closed forms written in NumPy are evaluated with them."""

from __future__ import annotations

import operator
from functools import partialmethod
from typing import Any

import numpy as np
from flint import arb, ctx


class Digits:
    """A number of forty digits, with the methods that NumPy calls on objects."""

    def __init__(self, value: Any) -> None:
        ctx.dps = 40
        self.value: Any = value.value if isinstance(value, Digits) else arb(value)

    def __float__(self) -> float:
        return float(self.value)

    def __mod__(self, other: Any) -> Digits:
        """Return a remainder as of floats: NumPy takes off whole turns by it."""
        return Digits(float(self) % float(other))

    def arctan2(self, x: Any) -> Digits:
        return Digits(arb.atan2(self.value, Digits(x).value))

    def hypot(self, y: Any) -> Digits:
        return Digits((self.value**2 + Digits(y).value ** 2).sqrt())

    def _alone(self, operation: str) -> Digits:
        return Digits(getattr(self.value, operation)())

    def _with(self, other: Any, operation: str, kind: type, swapped: bool = False) -> Any:
        if not isinstance(other, Digits | int | float | np.integer):
            return NotImplemented
        pair = (other, self) if swapped else (self, other)
        return kind(getattr(operator, operation)(*(Digits(each).value for each in pair)))


for name in ("sqrt", "sin", "cos", "tanh", "__neg__", "__abs__"):
    setattr(Digits, name, partialmethod(Digits._alone, name))
for name in ("add", "sub", "mul", "truediv", "pow", "lt", "le", "gt", "ge"):
    kind = bool if len(name) == 2 else Digits
    setattr(Digits, f"__{name}__", partialmethod(Digits._with, operation=name, kind=kind))
    setattr(Digits, f"__r{name}__", partialmethod(Digits._with, operation=name, kind=kind, swapped=True))
exactly = np.vectorize(Digits, otypes=[object])
