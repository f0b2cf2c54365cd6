"""`Plant`: forward dynamics in steps, as a few functions of plain vectors that run anywhere.

`servocore.stepping.forward_dynamics` compiles them. Like `servocore.stepping.program` this module needs NumPy and
CasADi only, so that an FMU can carry it with the saved functions.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import casadi as ca

from servocore.model.quantity import Quantity
from servocore.numerics.compiled_calls import Array, Call
from servocore.numerics.serialization import from_json, to_json

_FUNCTIONS = ("step", "held_step", "observe", "held_observe")
_FORMAT = "servocore plant 3"  # rises when a field changes: a file of another kind is refused, not misread


@dataclass(frozen=True, eq=False)
class Plant:
    """Compiled forward dynamics of a mechanical system; the state is (q, v) as one flat vector.

    Attributes
    ----------
    name : str
        Of the system, for messages.
    step : casadi.Function
        (state, u, u_dot, d, p, h) -> state after h seconds; u is the input at the start of the step.
    held_step : casadi.Function
        (state, d, p, h) -> state after h seconds with the inputs held.
    observe : casadi.Function
        (state, u, d, p) -> values of the channels.
    held_observe : casadi.Function
        (state, d, p) -> the same with the inputs held.
    channels : tuple of Quantity
        Outputs with first (``_dot``) and second (``_ddot``) derivative, coordinates with first derivative,
        observables, inputs, ``energy``.
    parameters : tuple of str
        Names of the entries of p.
    """

    name: str
    step: ca.Function
    held_step: ca.Function
    observe: ca.Function
    held_observe: ca.Function
    channels: tuple[Quantity, ...]
    parameters: tuple[str, ...]
    _calls: dict[str, Call] = field(init=False, repr=False)

    def __post_init__(self) -> None:
        # A call owns the memory of one set of arguments: made here once, it need not be found again at every step.
        object.__setattr__(self, "_calls", {name: Call(getattr(self, name)) for name in _FUNCTIONS})

    def advance(self, state: Array, u: Array, u_dot: Array, d: Array, p: Array, h: float) -> Array:
        """Return the state after one step; not finite where the equations have no solution.

        Parameters
        ----------
        state : ndarray, shape (2 n,)
            (q, v) before the step.
        u, u_dot : ndarray, shape (m,)
            Inputs at the beginning of the step, in their units, and their slope over it, per s.
        d : ndarray, shape (m,)
            Forces of a disturbance along the servo outputs.
        p : ndarray
            Parameters.
        h : float
            Step in s.

        Returns
        -------
        ndarray, shape (2 n,)
            (q, v) after the step.
        """
        # The inputs run along their slope between the stages of the Runge-Kutta step. Held at u they would act half a
        # step late on average, and a closed loop would be of first order in h.
        return self._calls["step"](state, u, u_dot, d, p, h)[0]

    def advance_held(self, state: Array, d: Array, p: Array, h: float) -> Array:
        """Return the state after one step with the inputs held.

        Parameters
        ----------
        state : ndarray, shape (2 n,)
            (q, v) before the step.
        d : ndarray, shape (m,)
            Forces of a disturbance along the servo outputs.
        p : ndarray
            Parameters.
        h : float
            Step in s.

        Returns
        -------
        ndarray, shape (2 n,)
            (q, v) after the step.
        """
        # Brakes keep B v, the velocities along the inputs, at what they are: d(B v)/dt = 0 replaces known inputs, and u
        # comes out as the multipliers of these rows. A plant that moves when they close keeps moving.
        return self._calls["held_step"](state, d, p, h)[0]

    def values(self, state: Array, u: Array | None, d: Array, p: Array) -> dict[str, float]:
        """Return the values of the channels by name; `u` is None where the inputs are held.

        Parameters
        ----------
        state : ndarray, shape (2 n,)
            (q, v).
        u : ndarray, shape (m,), or None
            Inputs in their units.
        d : ndarray, shape (m,)
            Forces of a disturbance along the servo outputs.
        p : ndarray
            Parameters.

        Returns
        -------
        dict of str to float
            In the units of `channels`.
        """
        # Accelerations and multipliers follow from the state and the inputs of this instant, so nothing of the step
        # before is kept: after an input jumps, its channels jump as well.
        observed = self._calls["held_observe"](state, d, p) if u is None else self._calls["observe"](state, u, d, p)
        return dict(zip((channel.name for channel in self.channels), map(float, observed[0]), strict=True))

    def to_json(self) -> str:
        """Serialize, with the functions in CasADi's own format.

        Returns
        -------
        str
            What `from_json` reads.
        """
        return to_json(self, _FORMAT)

    @classmethod
    def from_json(cls, text: str) -> Plant:
        """Undo `to_json`; raises `ServocoreError` if the text is not a plant.

        Parameters
        ----------
        text : str
            From `to_json`.

        Returns
        -------
        Plant
            The same plant.
        """
        return from_json(cls, text, _FORMAT, {"channels": Quantity})
