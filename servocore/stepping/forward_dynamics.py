"""Forward dynamics of a system as compiled functions.

    M v_dot + bias + G^T lam + B^T u = C^T d        d: a disturbing force on the servo output
    g'' + 2 a g' + a^2 g = 0                        a = `STABILIZATION_RATE`, the time included

The holonomic constraints are differentiated twice and stabilized. *Held* inputs are not given: they keep B v constant,
as brakes do. One step of a `Plant` is the classical Runge-Kutta method of order four with inputs that change
linearly over it.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import casadi as ca

from servocore.errors import InvalidModel, require_kind
from servocore.model.quantity import Quantity
from servocore.model.system import MechanicalSystem
from servocore.numerics.compiled_calls import Array, call_of

STABILIZATION_RATE = 10.0
"""Rate in 1/s at which violations of the holonomic constraints decay."""


@dataclass(frozen=True, eq=False)
class Plant:
    """Compiled forward dynamics of a mechanical system; the state is (q, v) as one flat vector.

    Attributes
    ----------
    name : str
        Name of the system in messages.
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
        return call_of(self.step)(state, u, u_dot, d, p, h)[0]

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
        # Accelerations and multipliers follow from state and inputs of this instant alone: where an input jumps, its
        # channels jump as well.
        observed = call_of(self.held_observe)(state, d, p) if u is None else call_of(self.observe)(state, u, d, p)
        return dict(zip((channel.name for channel in self.channels), map(float, observed[0]), strict=True))


def compile_plant(system: MechanicalSystem) -> Plant:
    """Compile the forward dynamics of a system.

    Parameters
    ----------
    system : MechanicalSystem
        The system; its constraints are differentiated twice and stabilized.

    Returns
    -------
    Plant
        Its state is (q, v).

    Raises
    ------
    InvalidModel
        If some holonomic constraints are redundant, since their forces are not determined, or the equations depend on
        the time, which is not part of the state (q, v).
    """
    require_kind(system, MechanicalSystem, "the system to be compiled", "a MechanicalSystem", InvalidModel)
    system.require_independent_constraints()
    if system.time.numel():
        raise InvalidModel(
            f"{system.name}: its equations depend on the time, which is not part of a plant's state; use simulate"
        )
    rate, held_rate = forward_rate(system, held=False), forward_rate(system, held=True)
    n, m, n_p = len(system.coordinates), len(system.inputs), system.p.numel()
    state, u, slope, d, p = (ca.MX.sym(*argument) for argument in zip("xuwdp", (2 * n, m, m, m, n_p), strict=True))
    h = ca.MX.sym("h")
    # Four stages with the input linear over the step: explicit, so that a plant in an FMU costs the same each step.
    free = runge_kutta(lambda x, time: rate(x, u + time * slope, d, p)[0], state, h)
    # Brakes keep B v, the velocities along the inputs: d(B v)/dt = 0 replaces known inputs, and u comes out as the
    # multipliers of these rows. A plant that moves when they close keeps moving.
    held = runge_kutta(lambda x, _: held_rate(x, d, p)[0], state, h)
    channels, observed = _observed(system)
    x_dot, lam, _ = rate(state, u, d, p)
    held_dot, held_lam, held_u = held_rate(state, d, p)
    return Plant(
        name=system.name,
        step=ca.Function("sc_plant_step", [state, u, slope, d, p, h], [free]),
        held_step=ca.Function("sc_plant_held_step", [state, d, p, h], [held]),
        observe=ca.Function("sc_plant_observe", [state, u, d, p], [observed(state, x_dot[n:], lam, u, d, p)]),
        held_observe=ca.Function(
            "sc_plant_held_observe", [state, d, p], [observed(state, held_dot[n:], held_lam, held_u, d, p)]
        ),
        channels=channels,
        parameters=system.parameters.names,
    )


def forward_rate(system: MechanicalSystem, *, held: bool) -> ca.Function:
    """Compile (state, u, d, p) -> (state_dot, lam, u), or without u among the arguments where the inputs are held.

    If the equations depend on the time, it is the last argument.
    """
    q, v, G, B = system.q, system.v, system.G, system.input_matrix
    a = STABILIZATION_RATE
    # The only component of gamma in constraints is the time, whose rate is one.
    g_dot = ca.substitute(system.constraint_rate, system.gamma[:, 1], ca.SX.ones(system.gamma.size1()))
    g_ddot = ca.jtimes(g_dot, q, v) + ca.jtimes(g_dot, system.time, ca.SX.ones(system.time.shape))
    # Baumgarte: g'' + 2 a g' + a^2 g = 0 lets violations die out like (1 + a t) exp(-a t); g'' = 0 alone drifts.
    stabilized = g_ddot + 2 * a * g_dot + a**2 * system.constraints
    d = ca.SX.sym("d", len(system.outputs))
    # A disturbance d works along the servo outputs, so that its generalized force is C^T d.
    momentum = system.bias - ca.mtimes(system.C.T, d)
    m_h, m = system.lam.numel(), len(system.inputs)
    if held:
        bordered = ca.vertcat(G, B)
        right = ca.vertcat(momentum, stabilized, ca.jtimes(ca.mtimes(B, v), q, v))
    else:
        bordered = G
        right = ca.vertcat(momentum + ca.mtimes(B.T, system.u), stabilized)
    corner = ca.SX(bordered.size1(), bordered.size1())
    # [M A^T; A 0] is regular for a singular M too, if M is definite on ker A; M^-1 does not exist then.
    matrix = ca.blockcat([[system.mass, bordered.T], [bordered, corner]])
    state, inputs, clock = ca.vertcat(q, v), [] if held else [system.u], [system.time] if system.time.numel() else []
    terms = ca.Function("sc_plant_terms", [state, *inputs, d, system.p, *clock], [matrix, -right], {"cse": True})
    arguments = [ca.MX.sym(f"a{k}", terms.size1_in(k)) for k in range(terms.n_in())]
    bordered_mass, forces_on_it = terms(*arguments)
    # In SX the solution would be expanded entry by entry; MX calls a sparse QR factorization.
    solution = ca.solve(bordered_mass, forces_on_it, "qr")
    n = len(system.coordinates)
    forces = solution[n + m_h : n + m_h + m] if held else arguments[1]
    results = [ca.vertcat(arguments[0][n:], solution[:n]), solution[n : n + m_h], forces]
    return ca.Function("sc_plant_rate", arguments, results)


def runge_kutta(rate: Callable[[ca.MX, ca.MX | float], ca.MX], state: ca.MX, h: ca.MX) -> ca.MX:
    """Return the state after one step of the classical method, where ``rate(state, time)`` is its derivative."""
    first = rate(state, 0)
    second = rate(state + h / 2 * first, h / 2)
    third = rate(state + h / 2 * second, h / 2)
    fourth = rate(state + h * third, h)
    return state + h / 6 * (first + 2 * second + 2 * third + fourth)


def _observed(system: MechanicalSystem) -> tuple[tuple[Quantity, ...], ca.Function]:
    """Return the channels and (state, v_dot, lam, u, d, p) -> their values."""
    q, v = system.q, system.v
    v_dot = ca.SX.sym("v_dot", v.numel())
    output_rate = ca.mtimes(system.C, v)
    rows: list[tuple[Quantity, ca.SX]] = []

    def add(quantities: Sequence[Quantity], values: ca.SX, suffix: str = "", unit: str = "") -> None:
        rows.extend(
            (
                Quantity(
                    f"{quantity.name}{suffix}",
                    quantity.unit + unit,
                    quantity.description,
                    wraps=not suffix and quantity.wraps,
                ),
                values[k],
            )
            for k, quantity in enumerate(quantities)
        )

    add(system.outputs, system.output)
    add(system.outputs, output_rate, "_dot", "/s")
    add(system.outputs, ca.mtimes(system.C, v_dot) + ca.jtimes(output_rate, q, v), "_ddot", "/s2")
    add(system.coordinates.quantities, q)
    add(system.coordinates.quantities, v, "_dot", "/s")
    for quantity, expression in system.observables.items():
        # A plant follows no path: observables that depend on one are left out.
        if not ca.depends_on(ca.SX(expression), system.gamma):
            add((quantity,), ca.SX(expression))
    add(system.inputs, system.u)
    energy = ca.dot(v, ca.mtimes(system.mass, v)) / 2 + system.potential
    rows.append((Quantity("energy", "J", "kinetic and potential energy"), energy))
    unique: dict[str, tuple[Quantity, ca.SX]] = {}
    for channel, expression in rows:
        # The first of a name is kept: an output that is a coordinate as well is listed once.
        unique.setdefault(channel.name, (channel, expression))
    values = ca.vertcat(*[expression for _, expression in unique.values()])
    arguments = [ca.vertcat(q, v), v_dot, system.lam, system.u, system.p]
    function = ca.Function("sc_plant_values", arguments, [ca.densify(values)], {"cse": True})
    # In independent coordinates the force of a rope follows from the motion and all other forces.
    reactions = {channel: force for channel, force in system.reactions.items() if channel.name not in unique}
    state, rate, lam, u, p = (ca.MX.sym(f"a{k}", function.size1_in(k)) for k in range(5))
    d, n = ca.MX.sym("d", len(system.outputs)), q.numel()
    more = [force(state[:n], state[n:], rate, u, d, p) for force in reactions.values()]
    everything = ca.vertcat(function(state, rate, lam, u, p), *more)
    known = [channel for channel, _ in unique.values()]
    allowed = [replace(channel, positive=False, tension=False) for channel in reactions]
    return (*known, *allowed), ca.Function("sc_plant_channels", [state, rate, lam, u, d, p], [everything])
