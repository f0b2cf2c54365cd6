"""`Plant`: forward dynamics compiled to plain functions, to run in steps anywhere: what moves when inputs push.

    M v_dot + bias + G^T lam + B^T u = C^T d        d: a disturbing force on the servo output
    g'' + 2 a g' + a^2 g = 0                        a = `STABILISATION_RATE`

One step is the classical Runge-Kutta method of order four with inputs that change linearly over it. *Held*, the
inputs are not given but are what keeps B v as it is: brakes. Like `servocore.stepping.program` this module needs NumPy and
CasADi only, so that an FMU can carry it with the saved functions; the system comes in as an argument.
"""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any

import casadi as ca
import numpy as np
import numpy.typing as npt

from servocore.numerics.calls import Call
from servocore.errors import ServocoreError
from servocore.stepping.program import Channel

if TYPE_CHECKING:
    from collections.abc import Sequence

    from servocore.model.system import MechanicalSystem

Array = npt.NDArray[np.float64]

STABILISATION_RATE = 10.0
"""Rate in 1/s at which violations of the holonomic constraints decay."""

_FUNCTIONS = ("step", "held_step", "observe", "held_observe", "linearise")
_FORMAT = "servocore plant 1"


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
    linearise : casadi.Function
        (state, u, p) -> Jacobians of the rate of the state by state, inputs and disturbance, at d = 0, and of the
        servo output by state.
    channels : tuple of Channel
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
    linearise: ca.Function
    channels: tuple[Channel, ...]
    parameters: tuple[str, ...]

    @cached_property
    def _calls(self) -> dict[str, Call]:
        return {name: Call(getattr(self, name)) for name in _FUNCTIONS}

    def advance(self, state: Array, u: Array, u_dot: Array, d: Array, p: Array, h: float) -> Array:
        """Return the state after one step; not finite where the equations have no solution."""
        return self._calls["step"](state, u, u_dot, d, p, h)[0]

    def advance_held(self, state: Array, d: Array, p: Array, h: float) -> Array:
        """Return the state after one step with the inputs held."""
        return self._calls["held_step"](state, d, p, h)[0]

    def values(self, state: Array, u: Array | None, d: Array, p: Array) -> dict[str, float]:
        """Return the values of the channels by name; `u` is None where the inputs are held."""
        found = self._calls["held_observe"](state, d, p) if u is None else self._calls["observe"](state, u, d, p)
        return dict(zip((each.name for each in self.channels), map(float, found[0]), strict=True))

    def linearised(self, state: Array, u: Array, p: Array) -> tuple[Array, Array, Array, Array]:
        """Return the Jacobians of the rate by state, inputs and disturbance, and of the servo output by state."""
        n = len(state)
        by_state, by_input, by_disturbance, output = self._calls["linearise"](state, u, p)
        return by_state.reshape(n, n), by_input.reshape(n, -1), by_disturbance.reshape(n, -1), output.reshape(-1, n)

    def to_json(self) -> str:
        """Serialise, with the functions in CasADi's own format."""
        document: dict[str, Any] = {"format": _FORMAT, "casadi": ca.__version__}
        for attribute in self.__dataclass_fields__:
            value = getattr(self, attribute)
            if attribute in _FUNCTIONS:
                document[attribute] = value.serialize()
            else:
                document[attribute] = [asdict(each) for each in value] if attribute == "channels" else value
        return json.dumps(document)

    @classmethod
    def from_json(cls, text: str) -> Plant:
        """Undo `to_json`; raises `ServocoreError` if the text is not a plant."""
        try:
            document = json.loads(text)
            if document.pop("format") != _FORMAT:
                raise ServocoreError("the saved plant has another format")
            del document["casadi"]
            for attribute in _FUNCTIONS:
                document[attribute] = ca.Function.deserialize(document[attribute])
            document["channels"] = tuple(Channel(**each) for each in document["channels"])
            document["parameters"] = tuple(document["parameters"])
            return cls(**document)
        except (KeyError, TypeError, ValueError, RuntimeError, AttributeError) as error:
            raise ServocoreError(f"the saved plant cannot be read: {error}") from error


def compile_plant(system: MechanicalSystem) -> Plant:
    """Compile the forward dynamics of a system.

    Parameters
    ----------
    system : MechanicalSystem
        Any; its constraints are differentiated twice and stabilised.

    Raises
    ------
    InvalidModel
        If some holonomic constraints are redundant: nothing would determine their forces.
    """
    system.require_independent_constraints()
    rate, held_rate = _rate(system, held=False), _rate(system, held=True)
    n, m, n_p = len(system.coordinates), len(system.inputs), system.p.numel()
    state, u, slope, d, p = (ca.MX.sym(*each) for each in zip("xuwdp", (2 * n, m, m, m, n_p), strict=True))
    h = ca.MX.sym("h")
    free = _runge_kutta(lambda x, time: rate(x, u + time * slope, d, p)[0], state, h)
    held = _runge_kutta(lambda x, _: held_rate(x, d, p)[0], state, h)
    channels, observed = _observed(system)
    x_dot, lam, _ = rate(state, u, d, p)
    held_dot, held_lam, held_u = held_rate(state, d, p)
    output = ca.Function("sc_plant_output", [ca.vertcat(system.q, system.v), system.p], [system.output])
    jacobians = [ca.densify(ca.jacobian(x_dot, each)) for each in (state, u, d)]
    by_state = ca.densify(ca.jacobian(output(state, p), state))
    linear = ca.Function("sc_plant_jacobians", [state, u, d, p], [*jacobians, by_state])
    return Plant(
        name=system.name,
        step=ca.Function("sc_plant_step", [state, u, slope, d, p, h], [free]),
        held_step=ca.Function("sc_plant_held_step", [state, d, p, h], [held]),
        observe=ca.Function("sc_plant_observe", [state, u, d, p], [observed(state, x_dot[n:], lam, u, p)]),
        held_observe=ca.Function(
            "sc_plant_held_observe", [state, d, p], [observed(state, held_dot[n:], held_lam, held_u, p)]
        ),
        linearise=ca.Function("sc_plant_linearise", [state, u, p], list(linear(state, u, ca.DM.zeros(m), p))),
        channels=channels,
        parameters=system.parameters.names,
    )


def _rate(system: MechanicalSystem, *, held: bool) -> ca.Function:
    """Return (state, u, d, p) -> (state_dot, lam, u), or without u where the inputs are held."""
    q, v, G, B = system.q, system.v, system.G, system.input_matrix
    a = STABILISATION_RATE
    g_dot = ca.mtimes(G, v)
    stabilised = ca.jtimes(g_dot, q, v) + 2 * a * g_dot + a**2 * system.constraints
    d = ca.SX.sym("d", len(system.outputs))
    momentum = system.bias - ca.mtimes(system.C.T, d)
    m_h, m = system.lam.numel(), len(system.inputs)
    if held:
        bordered = ca.vertcat(G, B)
        right = ca.vertcat(momentum, stabilised, ca.jtimes(ca.mtimes(B, v), q, v))
    else:
        bordered = G
        right = ca.vertcat(momentum + ca.mtimes(B.T, system.u), stabilised)
    corner = ca.SX(bordered.size1(), bordered.size1())
    matrix = ca.blockcat([[system.mass, bordered.T], [bordered, corner]])
    state, given = ca.vertcat(q, v), [] if held else [system.u]
    terms = ca.Function("sc_plant_terms", [state, *given, d, system.p], [matrix, -right], {"cse": True})
    arguments = [ca.MX.sym(f"a{k}", terms.size1_in(k)) for k in range(terms.n_in())]
    found = ca.solve(*terms(*arguments), "qr")
    n = len(system.coordinates)
    forces = found[n + m_h : n + m_h + m] if held else arguments[1]
    results = [ca.vertcat(arguments[0][n:], found[:n]), found[n : n + m_h], forces]
    return ca.Function("sc_plant_rate", arguments, results)


def _runge_kutta(rate: Any, state: ca.MX, h: ca.MX) -> ca.MX:
    """Return the state after one step of the classical method, where ``rate(state, time)`` is its derivative."""
    first = rate(state, 0)
    second = rate(state + h / 2 * first, h / 2)
    third = rate(state + h / 2 * second, h / 2)
    fourth = rate(state + h * third, h)
    return state + h / 6 * (first + 2 * second + 2 * third + fourth)


def _observed(system: MechanicalSystem) -> tuple[tuple[Channel, ...], ca.Function]:
    """Return the channels and (state, v_dot, lam, u, p) -> their values."""
    q, v = system.q, system.v
    v_dot = ca.SX.sym("v_dot", v.numel())
    output_rate = ca.mtimes(system.C, v)
    rows: list[tuple[Channel, ca.SX]] = []

    def add(quantities: Sequence[Any], values: ca.SX, suffix: str = "", unit: str = "") -> None:
        rows.extend(
            (Channel(f"{each.name}{suffix}", each.unit + unit, each.description, not suffix and each.wraps), values[k])
            for k, each in enumerate(quantities)
        )

    add(system.outputs, system.output)
    add(system.outputs, output_rate, "_dot", "/s")
    add(system.outputs, ca.mtimes(system.C, v_dot) + ca.jtimes(output_rate, q, v), "_ddot", "/s2")
    add(system.coordinates.quantities, q)
    add(system.coordinates.quantities, v, "_dot", "/s")
    for quantity, expression in system.observables.items():
        if not ca.depends_on(ca.SX(expression), system.gamma):
            add((quantity,), ca.SX(expression))
    add(system.inputs, system.u)
    energy = ca.dot(v, ca.mtimes(system.mass, v)) / 2 + system.potential
    rows.append((Channel("energy", "J", "kinetic and potential energy"), energy))
    unique: dict[str, tuple[Channel, ca.SX]] = {}
    for channel, expression in rows:
        unique.setdefault(channel.name, (channel, expression))
    values = ca.vertcat(*[expression for _, expression in unique.values()])
    arguments = [ca.vertcat(q, v), v_dot, system.lam, system.u, system.p]
    function = ca.Function("sc_plant_values", arguments, [ca.densify(values)], {"cse": True})
    return tuple(channel for channel, _ in unique.values()), function
