"""Long motions of free mechanisms by several methods: how far energy and momentum go, and where a method stops."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import casadi as ca
import conserved
import numpy as np
import numpy.typing as npt

import servocore as sc
from benchmarks.atlas.runs import Array
from servocore.dae import Dae, Equation, Unknown
from servocore.numerics.compiled_calls import Call
from servocore.numerics.square_systems import compile_solver
from servocore.solvers.forward_integration import integrated
from servocore.stepping.energy_momentum import compile_conserving_step, conserving_equations
from servocore.stepping.forward_dynamics import compile_plant, forward_rate

CHUNK = 100

Step = Callable[[float], tuple[ca.Function, Array]]
"""(h) -> a function (state) -> state, and the first state; a state begins with (q, v)."""


@dataclass(frozen=True, eq=False)
class Drift:
    """How far a motion went from what it should keep.

    Attributes
    ----------
    energy, momentum : ndarray, shape (N,)
        Largest change so far at every instant: of the energy, beside the first kinetic energy, and of the angular
        momentum about the axes of symmetry, beside its size.
    gap : float
        Largest violation of the constraints, in m or m2.
    stopped : int or None
        Step that was not solved.
    """

    energy: Array
    momentum: Array
    gap: float
    stopped: int | None


class Mechanism:
    """A mechanism of `tests/conserved.py` with the functions that tell its drift."""

    def __init__(self, motion: conserved.Motion) -> None:
        self.motion, self.system = motion, motion.system
        names, system = self.system.coordinates.names, self.system
        self.n, self.p = len(names), np.array(system.parameters.values())
        self.start = np.array([motion.start[f"{name}{dot}"] for dot in ("", "_dot") for name in names])
        self._told = compile_conserving_step(system).energy
        self._gap = ca.Function("gap", [system.q, system.p], [ca.norm_inf(ca.vertcat(0, system.constraints))])

    def drift(self, states: Array, stopped: int | None = None) -> Drift:
        """Return the drift of states, shape (2 n or more, N)."""
        q, v = states[: self.n], states[self.n : 2 * self.n]
        p = np.tile(self.p[:, None], q.shape[1])
        energy, momentum = (np.asarray(each) for each in self._told(q, v, p))
        kept = [k for k, axis in enumerate("xyz") if axis in self.motion.axes]
        size = float(np.linalg.norm(momentum[:, 0]))
        changes = np.abs(momentum[kept] - momentum[kept, :1]).max(axis=0, initial=0.0) / (size or 1.0)
        largest = np.abs(energy.ravel() - energy[0, 0]) / self.motion.kinetic()
        gap = float(np.asarray(self._gap(q, p)).max())
        return Drift(np.maximum.accumulate(largest), np.maximum.accumulate(changes), gap, stopped)

    def march(self, method: Step, h: float, steps: int) -> Drift:
        """Take steps of a method until one is not solved."""
        step, state = method(h)
        loop, single, parts = Call(step.mapaccum(CHUNK)), Call(step), [self.start[:, None]]
        for done in range(0, steps, CHUNK):
            found = loop(state)[0]
            if not _sound(found).all():  # one by one, to see which
                columns = [state]
                while _sound(columns[-1][:, None]).all():
                    columns.append(single(columns[-1])[0])
                parts.append(np.array(columns[1:-1]).T.reshape(len(state), -1)[: 2 * self.n])
                return self.drift(np.hstack(parts), done + len(columns) - 1)
            parts.append(found[: 2 * self.n])
            state = found[:, -1]
        return self.drift(np.hstack(parts))

    # Methods -----------------------------------------------------------------------------------------------------

    def energy_momentum(self, h: float) -> tuple[ca.Function, Array]:
        """Return a step of the scheme of `EnergyMomentum`."""
        return self._conserving(self.system, h)

    def midpoint(self, h: float) -> tuple[ca.Function, Array]:
        """Return the same with forces of the potential in the middle of a step, not its discrete gradient."""
        return self._conserving(replace(self.system, potential=ca.SX(self.system.potential) + 0), h)  # no summands

    def runge_kutta(self, h: float) -> tuple[ca.Function, Array]:
        """Return a step of the classical method on the constraints differentiated twice and stabilized."""
        u, d = ca.DM.zeros(len(self.system.inputs)), ca.DM.zeros(len(self.system.outputs))
        old = ca.MX.sym("old", 2 * self.n)
        return ca.Function("step", [old], [compile_plant(self.system).step(old, u, u, d, self.p, h)]), self.start

    def method(self, method: sc.Method) -> Step:
        """Return steps of a method of the library on the equations of index 3."""

        def made(h: float) -> tuple[ca.Function, Array]:
            dae = free_motion(self.system)
            rate = forward_rate(self.system, held=False)
            u, d = ca.DM.zeros(len(self.system.inputs)), ca.DM.zeros(len(self.system.outputs))
            rates, lam, _ = (np.asarray(each).ravel() for each in rate(self.start, u, d, self.p))
            found = method.discretize(dae)
            equations, start = found.equations, found.start
            solve = compile_solver("sc_control", equations, [found.next_state])
            first = ca.Function("first", [start.values, start.rates, found.step], [found.first_state])
            values = np.tile(np.r_[self.start, lam][:, None], start.values.size2())
            reference = ca.DM.zeros(found.reference.numel())
            state = np.asarray(first(values, rates, h)).ravel()
            old = ca.MX.sym("old", len(state))
            step = ca.Function("step", [old], [solve(ca.vertcat(old, reference, h, self.p))[0]])
            return step, state

        return made

    def simulated(self, duration: float, count: int) -> Drift:
        """Return the drift of what `simulate` integrates with error control, at `count` instants."""
        rate, still = Call(forward_rate(self.system, held=False)), np.zeros(len(self.system.inputs))
        t, names = np.linspace(0.0, duration, count), list(self.system.coordinates.names)
        turn = lambda _, state: rate(state, still, np.zeros(len(self.system.outputs)), self.p)[0]  # noqa: E731
        return self.drift(integrated(self.system.name, names, turn, self.start, t, 1e-9, 1e-9, None)[0])

    def _conserving(self, system: sc.MechanicalSystem, h: float) -> tuple[ca.Function, Array]:
        equations, _ = conserving_equations(system)
        q1, L1 = equations.unknowns[: self.n], equations.unknowns[self.n :]
        q0, v0 = equations.givens[: self.n], equations.givens[self.n : 2 * self.n]
        after = ca.vertcat(q1, 2 * (q1 - q0) / h - v0, L1)
        solve = compile_solver("sc_conserving", equations, [after])
        old = ca.MX.sym("old", 2 * self.n + system.lam.numel())
        still = ca.DM.zeros(len(system.inputs))
        step = ca.Function("step", [old], [solve(ca.vertcat(old, still, h, self.p))[0]])
        return step, np.r_[self.start, np.zeros(system.lam.numel())]


def _sound(states: Array) -> npt.NDArray[np.bool_]:
    """Whether every state, a column, is a number of a sensible size."""
    return np.asarray((np.abs(states) < 1e12).all(axis=0))


def free_motion(system: sc.MechanicalSystem) -> Dae:
    """Return the equations of motion without inputs: index 3, unknowns (q, v) and the multipliers."""
    n, names = len(system.coordinates), system.coordinates.names
    force = -(system.bias + ca.mtimes(system.G.T, system.lam))
    return Dae(
        name=f"{system.name}, free",
        x=ca.vertcat(system.q, system.v),
        z=system.lam,
        H=ca.diagcat(ca.SX.eye(n), system.mass),
        f=ca.vertcat(system.v, force),
        h=system.constraints,
        gamma=system.gamma,
        p=system.p,
        unknowns=(
            *(Unknown(f"q.{name}") for name in names),
            *(Unknown(f"q.{name}", 1) for name in names),
            *(Unknown(f"lam.{k}") for k in range(system.lam.numel())),
        ),
        equations=(
            *(Equation(f"velocity of {name}", 1) for name in names),
            *(Equation(f"momentum of {name}", 2) for name in names),
            *(Equation(f"constraint {k}", 0) for k in range(system.lam.numel())),
        ),
        physical={},
        index=3,
    )
