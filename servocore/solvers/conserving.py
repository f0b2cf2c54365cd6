"""`EnergyMomentum`: forward dynamics that conserve energy, momentum and constraints at any step size."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from servocore.errors import IntegrationFailed, InvalidSetting
from servocore.model.quantity import Quantity
from servocore.numerics.calls import Array, chained, mapped
from servocore.problem import Problem, ResolvedSystem
from servocore.solvers.given_inputs import Inputs
from servocore.solvers.loop import CHUNK
from servocore.stepping.energy_momentum import (
    ConservingStep,
    compile_conserving_step,
    require_invariant_constraints,
)

BALANCE = (
    Quantity("energy", "J", "kinetic and potential energy"),
    Quantity("work", "J", "work of inputs and forces since the start"),
    *(Quantity(f"angular_momentum_{axis}", "N.m.s", "angular momentum about the origin") for axis in "xyz"),
)

_ON_GRID = 1e-6  # of a step
_MOST_STEPS = 10**7


@dataclass(frozen=True)
class EnergyMomentum:
    """The energy-momentum scheme of Gonzalez (1996) for `simulate`: second order, no numerical damping.

    What it conserves it conserves to round-off at every step size: energy (changed by the work of inputs and forces
    only), angular momentum about every axis of symmetry, holonomic constraints. That says nothing of its accuracy:
    velocities keep the constraints' rate at zero in the mean of a step only, and how far they are from it at the
    instants, `statistics.constraint_rate_violation`, is the measure of the error.

    For systems with a constant mass matrix and constraints that are at most quadratic, as in the rotationless
    formulation; a potential that is more than quadratic is given as a `Potential`.
    """

    name: str = "energy-momentum"


@dataclass(frozen=True, eq=False)
class Conserved:
    """A motion by the scheme.

    Attributes
    ----------
    states : ndarray, shape (2 n, N)
        (q, v) at the instants.
    multipliers : ndarray, shape (N, m_h)
        The mean of those of the steps before and after an instant.
    balance : ndarray, shape (N, 5)
        Energy in J, work of inputs and forces since the start in J, angular momentum about the origin in N m s.
    steps, iterations : int
        Steps, and Newton iterations in all.
    worst : float
        Largest scaled residual.
    """

    states: Array
    multipliers: Array
    balance: Array
    steps: int
    iterations: int
    worst: float


def conserved_motion(problem: Problem, start: Array, inputs: Inputs, t: Array, step: float) -> Conserved:
    """Integrate by the energy-momentum scheme.

    Parameters
    ----------
    problem : Problem
        With the system and its parameters.
    start : ndarray, shape (2 n,)
        (q, v) at t[0], which satisfy the constraints and their rates.
    inputs : callable
        Inputs as a function of time; the scheme asks at the middle of every step.
    t : ndarray, shape (N,)
        Instants in rising order, whole numbers of steps after the first.
    step : float
        In s.

    Raises
    ------
    InvalidModel
        If the system has no energy that the scheme conserves.
    InvalidSetting
        If an instant is not on the grid of steps.
    IntegrationFailed
        If Newton's method fails, with the time: bodies turn too far in a step.
    """
    system, at = problem.system, _places(t, step)
    scheme = scheme_of(problem)
    n = len(system.coordinates)
    require_invariant_constraints(system, start[:n], problem.p)
    state = np.concatenate([start, np.zeros(system.lam.numel())])
    grid = t[0] + step * np.arange(at[-1] + 1)
    u = np.array([inputs(min(time + step / 2, float(t[-1]))) for time in grid[:-1]]).reshape(len(grid) - 1, -1)
    states, counts, worst, work = _stepped(problem, scheme, state, u, step, float(t[0]))
    q, v, scaled = states[:n], states[n : 2 * n], states[2 * n :] / step**2
    if scaled.shape[1] > 1:
        scaled[:, 0] = scaled[:, 1]  # the first step's are the only ones known at the start
        scaled[:, 1:-1] = (scaled[:, 1:-1] + scaled[:, 2:]) / 2
    energy, turning = mapped(scheme.energy, len(at))(q[:, at], v[:, at], np.tile(problem.p[:, None], len(at)))
    done = np.concatenate([[0.0], np.cumsum(work)])[at]
    balance = np.column_stack([energy.ravel(), done, turning.reshape(3, -1, order="F").T])
    return Conserved(states[: 2 * n, at], scaled[:, at].T, balance, len(u), int(counts), worst)


def scheme_of(problem: Problem) -> ConservingStep:
    """Return the compiled scheme of a problem; raises `InvalidModel` if it conserves nothing there."""
    return problem.resolved.once(_scheme)


def _scheme(resolved: ResolvedSystem) -> ConservingStep:
    return compile_conserving_step(resolved.system)


def _places(t: Array, step: float) -> npt.NDArray[np.intp]:
    """Return which step ends at each instant; raise `InvalidSetting` for an instant between two."""
    if not 0.0 < step < float("inf"):
        raise InvalidSetting(f"the step must be positive and finite, not {step} s")
    exact = (t - t[0]) / step
    found: npt.NDArray[np.intp] = np.round(exact).astype(np.intp)
    off = np.abs(exact - found)
    if off.max() > _ON_GRID:
        k = int(off.argmax())
        raise InvalidSetting(
            f"energy-momentum reports whole steps, but t = {t[k]:.9g} s is {exact[k]:.6g} steps of {step:g} s after the"
            " start"
        )
    if found[-1] > _MOST_STEPS:
        raise InvalidSetting(f"steps of {step:g} s are {found[-1]:.2g} in all, more than {_MOST_STEPS:.0e}")
    return found


def _stepped(
    problem: Problem, scheme: ConservingStep, state: Array, u: Array, step: float, begin: float
) -> tuple[Array, float, float, Array]:
    """Return the states (size, N + 1), Newton iterations, the worst residual, and the work of each step (N,)."""
    parts, works, counted, worst, done = [state[:, None]], list[Array](), 0.0, 0.0, 0
    while done < len(u):
        length = min(CHUNK, len(u) - done)
        given = u[done : done + length].T
        arguments = (given, np.full((1, length), step), np.tile(problem.p[:, None], length))
        found, counts, residual, work = chained(scheme.step, length)(parts[-1][:, -1], *arguments)
        found = found.reshape(len(state), -1, order="F")
        bad = ~np.isfinite(found).all(axis=0)
        if bad.any():
            at = begin + step * (done + int(bad.argmax()))
            raise IntegrationFailed(
                f"{problem.system.name}: the energy-momentum step from t = {at:.6g} s to {at + step:.6g} s was not"
                " solved: something turns or swings too far in a step of"
                f" {step:g} s; a smaller step is needed"
            )
        parts.append(found)
        works.append(work.ravel())
        counted += float(counts.reshape(2, -1, order="F")[0].sum())
        worst = max(worst, float(residual.max()))
        done += length
    return np.hstack(parts), counted, worst, np.concatenate(works or [np.zeros(0)])
