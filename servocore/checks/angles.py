"""Angles that an equation knows up to full turns only: which they are, and which way they went between instants."""

from __future__ import annotations

from dataclasses import dataclass

import casadi as ca
import numpy as np
import numpy.typing as npt

from servocore.errors import IntegrationFailed
from servocore.numerics.angle_wrapping import wrapped_angle
from servocore.numerics.compiled_calls import Array, Call
from servocore.numerics.memoization import made_once
from servocore.numerics.vectorized import Vectorized
from servocore.problem import Problem, ResolvedSystem
from servocore.stepping.program import Program

_QUARTER_TURN = np.pi / 2
_MOST_BISECTIONS = 40


def ambiguous_angles(problem: Problem, program: Program) -> tuple[int, ...]:
    """Return the channels that are coordinates which some equation knows up to full turns only.

    A step of half a turn cannot be distinguished from one the other way round. On a form of index
    one or less the velocities are unknowns too, and decide.
    """
    if program.index <= 1:
        return ()
    names = [channel.name for channel in program.channels]
    return tuple(names.index(statement) for statement in _periodic_coordinates(problem.resolved))


@made_once
def _periodic_coordinates(resolved: ResolvedSystem) -> tuple[str, ...]:
    """Return the angles among the coordinates, reported as they are, of which an equation is a periodic function.

    Decided by numbers, at a point without symmetry. An angle that enters linearly, of a wheel say, may turn as far as
    it likes.
    """
    system = resolved.system
    terms = (system.constraints, system.output, system.potential, system.mass, system.input_matrix, system.force)
    arguments = [system.q, system.v, system.p, system.time]
    evaluate = Call(ca.Function("sc_terms", arguments, [ca.densify(ca.vertcat(*map(ca.vec, terms)))]))
    point, p = np.sin(1.0 + np.arange(len(system.coordinates))), system.parameters.values()
    time = np.full(system.time.numel(), 0.7)
    observed = {quantity.name: expression for quantity, expression in system.observables.items()}
    periodic = []
    for k, quantity in enumerate(system.coordinates.quantities):
        if quantity.unit != "rad" or not ca.is_equal(observed.get(quantity.name, system.q[k]), system.q[k]):
            continue
        aside = np.arange(len(point)) == k
        here, there, round_again = (evaluate(point + turn * aside, point, p, time)[0] for turn in (0.0, 1.0, 2 * np.pi))
        scale = 1e-9 * np.maximum(np.abs(here), np.abs(there))
        if ((np.abs(round_again - here) <= scale) & (np.abs(there - here) > 1e3 * scale)).any():
            periodic.append(quantity.name)
    return tuple(periodic)


def follow_angles(
    problem: Problem, program: Program, t: Array, states: Array, values: Array, native: bool | None = False
) -> None:
    """Make the angles of an exact inversion continuous, in place, between instants however far apart.

    An inversion determines angles up to full turns, at each instant independently. Where an angle turns by more than a
    quarter turn from one to the next, or would at the rates there, instants in between are solved.

    Raises
    ------
    IntegrationFailed
        If the angle cannot be followed: the path comes too close to a configuration at which it is undefined.
    """
    channels = program.channels
    wrapping = tuple(k for k, channel in enumerate(channels) if channel.wraps)
    if program.index > 0 or problem.follow_branch or not wrapping:
        return
    angular = _angles_and_rates(problem.resolved, tuple(channels[k].name for k in wrapping), native)
    if angular is None:
        return
    if len(t) > 1 and _turns_little(t, values[:, wrapping], angular.fastest(states, problem.p)):
        return
    angles, rates = angular(states, problem.p)
    for row, k in enumerate(wrapping):
        turns, unclear = _turns(np.diff(t), angles[row], rates[row])
        for i in np.flatnonzero(unclear):
            turns[i] = _bisected(problem, program, angular, row, t[i : i + 2], states[:, i : i + 2].T)
        followed = angles[row, 0] + np.concatenate([[0.0], np.cumsum(turns)])
        values[:, k] += 2 * np.pi * np.round((followed - values[:, k]) / (2 * np.pi))


@dataclass(frozen=True, eq=False)
class _Angular:
    """Angles and their rates as functions of the entries `used` of a state, and of p."""

    function: Vectorized
    rates: Vectorized
    used: tuple[int, ...]

    def __call__(self, states: Array, p: Array) -> tuple[Array, Array]:
        """Return angles and rates, shape (angles, N) each, of states (size, N)."""
        angles, rates = self.function(states[self.used, :], p)
        return angles, rates

    def fastest(self, states: Array, p: Array) -> float:
        """Return the largest rate of any angle, NaN if one is none."""
        (rates,) = self.rates(states[self.used, :], p)
        return float(np.maximum(rates.max(), -rates.min()))


def _turns_little(t: Array, values: Array, fastest: float) -> bool:
    """Whether angles (N, angles) as they are reported make no turn that may be another: then they are continuous."""
    longest = float(np.diff(t).max())
    return longest * fastest < _QUARTER_TURN and bool((np.abs(np.diff(values, axis=0)) < _QUARTER_TURN).all())


def _turns(steps: Array, angle: Array, rate: Array) -> tuple[Array, npt.NDArray[np.bool_]]:
    """Return the shortest turns between instants `steps` apart, and where they may be another: too large, too fast."""
    shortest = wrapped_angle(np.diff(angle))
    predicted = steps * np.maximum(np.abs(rate[1:]), np.abs(rate[:-1]))
    return shortest, ~(np.maximum(np.abs(shortest), predicted) < _QUARTER_TURN)


def _bisected(problem: Problem, program: Program, angular: _Angular, row: int, t: Array, states: Array) -> float:
    """Return by how much an angle turns between two instants, from exact inversions in between."""

    def at(time: float, state: Array) -> tuple[float, float, float, Array]:
        angle, rate = angular(state[:, None], problem.p)
        return time, float(angle[row, 0]), float(rate[row, 0]), state

    done, left, waiting = 0.0, at(t[0], states[0]), [at(t[1], states[1])]
    while waiting:
        pair = np.array([left[:3], waiting[-1][:3]])
        (turn,), (unclear,) = _turns(np.diff(pair[:, 0]), pair[:, 1], pair[:, 2])
        if not unclear:
            done, left = done + float(turn), waiting.pop()
            continue
        middle = float(pair[:, 0].mean())
        state, report = program.advance(left[3], problem.reference.jet(middle, program.order)[None], 0.0, problem.p)
        if len(waiting) > _MOST_BISECTIONS or not report.converged:
            name = [channel.name for channel in program.channels if channel.wraps][row]
            raise IntegrationFailed(
                f"{program.name}: {name} cannot be followed from t = {t[0]:.6g} s to {t[1]:.6g} s, near"
                f" t = {middle:.9g} s it turns by more than a quarter turn within {pair[1, 0] - pair[0, 0]:.2g} s"
            )
        waiting.append(at(middle, state))
    return done


@made_once
def _angles_and_rates(resolved: ResolvedSystem, names: tuple[str, ...], native: bool | None) -> _Angular | None:
    """Return angles and rates as functions of the state of an exact inversion, or None if they are none of q."""
    system, array = resolved.system, resolved.array
    known = {quantity.name: system.q[k] for k, quantity in enumerate(system.coordinates.quantities)}
    known |= {quantity.name: expression for quantity, expression in system.observables.items()}
    angles = ca.vertcat(*[known[name] for name in names if name in known])
    wanted = [(k, order) for order in (0, 1) for k in range(len(system.coordinates))]
    foreign = ca.vertcat(system.v, system.lam, system.u, ca.vec(system.gamma))
    if angles.numel() < len(names) or ca.depends_on(angles, foreign) or not set(wanted) <= set(array.unknowns):
        return None
    state = ca.SX.sym("state", len(array.unknowns))
    rates = ca.jtimes(angles, system.q, system.v)
    substituted = ca.substitute([angles, rates], [ca.vertcat(system.q, system.v)], [state[array.places(wanted)]])
    used = sorted(set(ca.jacobian_sparsity(ca.vertcat(*substituted), state).get_col()))
    # A state holds all derivatives of all unknowns, an angle needs a few of them.
    results = [ca.densify(each) for each in substituted]
    both = ca.Function("sc_angles", [state[used], system.p], results)
    alone = ca.Function("sc_angle_rates", [state[used], system.p], results[1:])
    return _Angular(
        Vectorized(both, (True, False), native and None, system.name),  # seldom needed: not to be waited for
        Vectorized(alone, (True, False), native, system.name),
        tuple(used),
    )


def require_less_than_half_a_turn(program: Program, channel: int, t: Array, angle: Array) -> None:
    """Raise `IntegrationFailed` if an angle turns by half a turn or more from one instant to the next."""
    turns = np.abs(np.diff(angle))
    if not (turns < np.pi).all():
        k = int((~(turns < np.pi)).argmax())
        cure = (
            "a smaller step is needed"
            if program.smaller_steps_help or program.index == 0
            else "another form is needed, such as Reduced()"
        )
        raise IntegrationFailed(
            f"{program.name}: {program.channels[channel].name} turns by {turns[k]:.4g} rad in the step from"
            f" t = {t[k]:.6g} s to {t[k + 1]:.6g} s, a step resolves turns of less than pi only;"
            f" {cure}"
        )
