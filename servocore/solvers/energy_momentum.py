"""`EnergyMomentum`: forward dynamics that conserve energy, momentum and constraints at any step size."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from servocore.errors import IntegrationFailed, InvalidSetting, require_kind, require_positive
from servocore.model.quantity import Quantity
from servocore.numerics.compiled_calls import Array, Places, chained, mapped, repeated
from servocore.numerics.just_in_time import in_machine_code
from servocore.numerics.memoization import made_once
from servocore.problem import Problem
from servocore.solvers.runs import CHUNK
from servocore.stepping.energy_momentum import (
    ConservingStep,
    compile_conserving_step,
    require_invariant_constraints,
)
from servocore.stepping.rotation_update import RotationUpdate

BALANCE = (
    Quantity("energy", "J", "kinetic and potential energy"),
    Quantity("work", "J", "work of inputs and forces since the start"),
    *(Quantity(f"angular_momentum_{axis}", "N.m.s", "angular momentum about the origin") for axis in "xyz"),
)

SampledInputs = Callable[[Array], Array]
"""Times (N,) in s -> inputs, shape (N, m)."""

_ON_GRID = 1e-6  # of a step
_MOST_STEPS = 10**7


@dataclass(frozen=True)
class EnergyMomentum:
    """The energy-momentum scheme of Gonzalez (1996) for `simulate`: second order, no numerical damping.

    It conserves to round-off at every step size: energy (changed by the work of inputs and forces
    only), angular momentum about every axis of symmetry, holonomic constraints. That says nothing of its accuracy:
    velocities keep the constraints' rate at zero in the mean of a step only, and how far they are from it at the
    instants, `statistics.constraint_rate_violation`, is the measure of the error.

    For systems with a constant mass matrix and constraints that are at most quadratic, as in the rotationless
    formulation; a potential that is more than quadratic is given as a `Potential`.

    Parameters
    ----------
    update : RotationUpdate, optional
        The update with six unknowns a body and no multipliers in the equations of a step; the step has positions and
        multipliers as unknowns when not given.
    native : bool, optional
        Whether a C compiler shall turn a step into machine code, which takes some seconds; with None it does so in the
        background, for long motions and for systems that are simulated again. No digit depends on it.
    """

    update: RotationUpdate | None = None
    native: bool | None = None
    name: str = field(default="energy-momentum", init=False)

    def __post_init__(self) -> None:
        if self.update is not None:
            require_kind(self.update, RotationUpdate, "the update", "RotationUpdate() or None", InvalidSetting)


def conserved_motion(
    problem: Problem, method: EnergyMomentum, start: Array, inputs: SampledInputs, t: Array, step: float
) -> tuple[tuple[Array, Array, Array], tuple[int, int, int, float]]:
    """Integrate by the energy-momentum scheme.

    Parameters
    ----------
    problem : Problem
        With the system and its parameters.
    method : EnergyMomentum
        Its unknowns, and whether as machine code.
    start : ndarray, shape (2 n,)
        (q, v) at t[0], which satisfy the constraints and their rates.
    inputs : callable
        Inputs as a function of times, evaluated at the middle of every step.
    t : ndarray, shape (N,)
        Instants in rising order, whole numbers of steps after the first.
    step : float
        In s.

    Returns
    -------
    tuple of ndarray
        At the instants: (q, v), shape (2 n, N); the mean of the multipliers of the steps before and after, (m_h, N);
        and the balance (N, 5): energy in J, work of inputs and forces since the start in J, angular momentum about the
        origin in N m s.
    tuple of (int, int, int, float)
        Steps, Newton iterations in all, factorizations as many, and the largest scaled residual.

    Raises
    ------
    InvalidModel
        If the system has no energy that the scheme conserves.
    InvalidSetting
        If an instant is not on the grid of steps, or there is no C compiler for `native`.
    IntegrationFailed
        If Newton's method fails, with the time: bodies turn too far in a step.
    """
    system, at = problem.system, _places(t, step)
    n, count = len(system.coordinates), int(at[-1])
    scheme, places = scheme_of(problem, method, count), np.union1d(at, np.minimum(at + 1, count))
    require_invariant_constraints(system, start[:n], problem.p)
    now = np.concatenate([start, np.zeros(system.lam.numel() + 1)])  # the work since the start comes last
    columns, iterations, worst, done = [now[:, None]], 0.0, 0.0, 0
    while done < count:
        length = min(CHUNK, count - done)
        middles = np.minimum(t[0] + step * (done + 0.5 + np.arange(length)), t[-1])
        arguments = (inputs(middles).T, np.full((1, length), step), repeated(problem.p, length))
        states, counts, residual, work = chained(scheme.step, length)(now[:-1], *arguments)
        table = np.vstack([states.reshape(len(now) - 1, -1, order="F"), now[-1] + np.cumsum(work.ravel())])
        bad = ~np.isfinite(table[:-1]).all(axis=0)
        if bad.any():
            time = t[0] + step * (done + int(bad.argmax()))
            raise IntegrationFailed(
                f"{system.name}: the energy-momentum step from t = {time:.6g} s to {time + step:.6g} s was not solved:"
                f" something turns or swings too far in a step of {step:g} s; a smaller step is needed"
            )
        columns.append(table[:, places[(places > done) & (places <= done + length)] - done - 1])
        iterations += float(counts.reshape(2, -1, order="F")[0].sum())
        worst, now, done = max(worst, float(residual.max())), table[:, -1], done + length
    found = np.hstack(columns)
    here, after = (np.searchsorted(places, instants) for instants in (at, np.minimum(at + 1, count)))
    # The multipliers of a state are those of the step before it: the first has none, the last no step after it.
    scaled = found[2 * n : -1] / step**2
    scaled[:, 0] = scaled[:, min(1, len(places) - 1)]
    states, forces = found[: 2 * n, here], (scaled[:, here] + scaled[:, after]) / 2
    energy, turning = mapped(scheme.energy, len(at))(states[:n], states[n:], repeated(problem.p, len(at)))
    balance = np.column_stack([energy.ravel(), found[-1, here], turning.reshape(3, -1, order="F").T])
    return (states, forces, balance), (count, int(iterations), int(iterations), worst)


def scheme_of(problem: Problem, method: EnergyMomentum, steps: int = 0) -> ConservingStep:
    """Return the compiled scheme of a problem for as many steps; raises `InvalidModel` if it conserves nothing."""
    scheme = _scheme(problem.system, method.update)
    return _in_machine_code(scheme, ("step",), problem.system.name, method.native).best(steps) or scheme


_scheme, _in_machine_code = made_once(compile_conserving_step), made_once(in_machine_code)


def _places(t: Array, step: float) -> Places:
    """Return which step ends at each instant; raise `InvalidSetting` for an instant between two."""
    require_positive(step, "the step", "a time in s")
    exact = (t - t[0]) / step
    places: Places = np.round(exact).astype(np.intp)
    off = np.abs(exact - places)
    if off.max() > _ON_GRID:
        k = int(off.argmax())
        raise InvalidSetting(
            f"energy-momentum reports whole steps, but t = {t[k]:.9g} s is {exact[k]:.6g} steps of {step:g} s after the"
            " start"
        )
    if places[-1] > _MOST_STEPS:
        raise InvalidSetting(f"steps of {step:g} s are {places[-1]:.2g} in all, more than {_MOST_STEPS:.0e}")
    return places
