"""The integrator of `simulate`: SciPy's DOP853 step by step, given up where a force jumps without end.

Where friction is steep, stability would keep its steps small for minutes: from there on it is SciPy's Radau.
"""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable, Sequence

import numpy as np

from servocore.errors import IntegrationFailed
from servocore.numerics.compiled_calls import Array

Rate = Callable[[float, Array], Array]
"""(time in s, state (q, v)) -> its derivative."""

_WATCHED = 60  # steps whose progress is judged together
_SLOW = 1e-3  # of the whole time: less progress in so many steps is examined
_NEAR = 10.0  # ranges of a velocity during these steps: where its force is evaluated
_MANY = 50_000  # steps ahead: worth the change to an implicit method, if stability alone keeps steps small
_UNSTABLE = 3.0  # step times rate of decay; accuracy needs less where something oscillates
_POWERS = 4  # of the Jacobian, to find its fastest rate
_RESOLVED = 1e-12  # of a state: a change over less is a jump for any integrator


def integrated(
    name: str, coordinates: Sequence[str], rate: Rate, start: Array, t: Array, r: float, a: float, limit: float | None
) -> tuple[Array, int, int]:
    """Integrate an ordinary differential equation and report it at instants in rising order.

    Parameters
    ----------
    name : str
        Of the system, for messages.
    coordinates : sequence of str, length n
        Names of the entries of q in messages.
    rate : callable
        The equation.
    start : ndarray, shape (2 n,)
        State at the first instant.
    t : ndarray, shape (N,)
        Instants.
    r, a : float
        Relative and absolute tolerance of positions and velocities.
    limit : float or None
        Seconds of this machine that it may take.

    Returns
    -------
    states : ndarray, shape (2 n, N)
        At the instants.
    steps, evaluations : int
        Totals.

    Raises
    ------
    IntegrationFailed
        If the integrator gives up, time runs out, or a force changes sides without end.
    """
    import scipy.integrate  # noqa: PLC0415 - kept out of the run time of an FMU

    states, done, steps, evaluations = np.repeat(start[:, None], len(t), axis=1), int((t == t[0]).sum()), 0, 0
    if done == len(t):
        return states, 0, 0
    solver: scipy.integrate.OdeSolver = scipy.integrate.DOP853(rate, t[0], start, t[-1], rtol=r, atol=a)
    began, stiff, recent = time.monotonic(), False, deque[tuple[float, Array]](maxlen=_WATCHED)
    while done < len(t):
        message = solver.step()  # None unless it fails
        steps += 1
        if message or not np.isfinite(solver.y).all():
            raise IntegrationFailed(
                f"{name}: the forward simulation stopped at t = {solver.t:.6g} s:"
                f" {message or 'its state is no longer finite'}"
            )
        if limit is not None and time.monotonic() - began > limit:
            raise IntegrationFailed(
                f"{name}: the forward simulation had come to t = {solver.t:.6g} s of {t[-1]:.6g} s when its time limit"
                f" of {limit:g} s was over"
            )
        recent.append((solver.t, solver.y))
        if steps % _WATCHED == 0 and solver.t - recent[0][0] < _SLOW * (t[-1] - t[0]):
            _require_no_chatter(name, coordinates, rate, recent)
            stiff = stiff or _is_stiff(rate, recent, t[-1])
        reached = int(np.searchsorted(t, solver.t, side="right"))
        if reached > done:
            states[:, done:reached] = solver.dense_output()(t[done:reached])
            done = reached
        if stiff and isinstance(solver, scipy.integrate.DOP853):
            evaluations += int(solver.nfev)
            solver = scipy.integrate.Radau(rate, solver.t, solver.y, t[-1], rtol=r, atol=a)
    return states, steps, evaluations + int(solver.nfev)


def _is_stiff(rate: Rate, recent: deque[tuple[float, Array]], end: float) -> bool:
    """Whether an explicit method has very many steps ahead that only stability keeps so small."""
    (began, _), (before, last), (at, state) = recent[0], recent[-2], recent[-1]
    if (end - at) * (len(recent) - 1) < _MANY * (at - began):
        return False
    here, aside = rate(at, state), state - last
    size, fastest = float(np.linalg.norm(aside)), 0.0
    for _ in range(_POWERS):
        change = rate(at, state + aside) - here
        fastest = float(np.linalg.norm(change)) / size if size else 0.0
        aside = change / fastest if fastest else aside
    return fastest * (at - before) > _UNSTABLE


def _require_no_chatter(name: str, coordinates: Sequence[str], rate: Rate, recent: deque[tuple[float, Array]]) -> None:
    """Raise `IntegrationFailed` if an acceleration jumps across the states of the last steps.

    A force that is steep, but continuous, changes on the way from side to side; one that jumps, as dry friction with
    the sign of a velocity, at one place. Where it holds a body at rest, the velocity changes its sign at every step.
    """
    (began, _), (at, last) = recent[0], recent[-1]
    states, n = np.array([state for _, state in recent]), len(coordinates)
    ranges = np.ptp(states, axis=0) + 1e-15 * np.abs(states).max(axis=0)
    for k in (*range(n, 2 * n), *range(n)):  # velocities first
        middle = last.copy()
        middle[k] = states[:, k].mean()
        before, after = (_accelerations(rate, at, middle, k, middle[k] + s * _NEAR * ranges[k]) for s in (-1.0, 1.0))
        worst = int(np.abs(after - before).argmax())
        jump = float(abs(after[worst] - before[worst]))
        matters = jump * (at - began) ** (1 if k >= n else 2) > ranges[k]
        if matters and _is_jump(rate, at, middle, k, _NEAR * float(ranges[k]), worst):
            quantity, x = (f"the velocity of {coordinates[k - n]}", "v") if k >= n else (coordinates[k], "x")
            where = "sign" if abs(middle[k]) <= _NEAR * ranges[k] else f"passing of {middle[k]:.3g}"
            raise IntegrationFailed(
                f"{name}: the forward simulation does not get past t = {at:.6g} s: the acceleration of"
                f" {coordinates[worst]} jumps by {jump:.3g} with the {where} of {quantity}, at every step, as where dry"
                f" friction sticks; a smooth form does, such as tanh({x}/{x}_s) for sign({x}), where {x}_s is about a"
                f" thousandth of the usual {x}"
            )


def _is_jump(rate: Rate, at: float, state: Array, entry: int, distance: float, which: int) -> bool:
    """Whether an acceleration changes at one place, within a distance of a state, or on the way from side to side."""
    places = [state[entry] - distance, state[entry] + distance]
    values = [float(_accelerations(rate, at, state, entry, place)[which]) for place in places]
    whole = abs(values[1] - values[0])
    while places[1] - places[0] > _RESOLVED * max(1.0, abs(places[0])):
        middle = sum(places) / 2
        value = float(_accelerations(rate, at, state, entry, middle)[which])
        k = 0 if abs(value - values[0]) < abs(values[1] - value) else 1
        places[k], values[k] = middle, value
    return abs(values[1] - values[0]) > whole / 2.0


def _accelerations(rate: Rate, at: float, state: Array, entry: int, place: float) -> Array:
    """Return the accelerations with another value of an entry of the state."""
    aside = state.copy()
    aside[entry] = place
    return rate(at, aside)[len(state) // 2 :]
