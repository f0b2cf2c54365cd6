"""Whether a run can be believed: angles that turn too far in a step, and inputs far from the exact ones.

Near a singular configuration a step may land on a root that satisfies every equation and is wrong all the same: a
bridge that turns the long way round, a winch whose direction cosines cannot follow it. What the equations do not show
is compared with what the path implies.
"""

from __future__ import annotations

import warnings
from dataclasses import dataclass
from functools import lru_cache

import casadi as ca
import numpy as np
import numpy.typing as npt

from servocore.numerics.calls import Call
from servocore.structure.derivative_array import derivative_array
from servocore.errors import IntegrationFailed, ServocoreWarning
from servocore.formulations import Reduced
from servocore.stepping.program import Program
from servocore.stepping.stepper import Stepper
from servocore.model.symbols import Array
from servocore.model.system import MechanicalSystem

LARGEST_DEVIATION = 0.5
"""Of an input's peak: an input further from the exact one is warned of."""

_UNNOTICED = 1e-3  # of the largest input: what is smaller may be all round-off
_QUARTER_TURN = np.pi / 2
_MOST_BISECTIONS = 40
_DIRECTORS = tuple(f"d{k}_{axis}" for k in (1, 2, 3) for axis in "xyz")
_SMALLEST_TURN = 0.01  # rad a step: not worth a word


# Angles ---------------------------------------------------------------------------------------------------------------


def angles_of(stepper: Stepper) -> tuple[int, ...]:
    """Return the channels that are coordinates which some equation knows up to full turns only.

    A step of half a turn cannot be told from one the other way round; see `servocore.solvers.fixed_step.observe`. On a form of index
    one or less the velocities are unknowns of their own, and tell.
    """
    if stepper.index <= 1:
        return ()
    names = [channel.name for channel in stepper.program.channels]
    return tuple(names.index(each) for each in _periodic_coordinates(stepper.system))


@lru_cache(maxsize=64)
def _periodic_coordinates(system: MechanicalSystem) -> tuple[str, ...]:
    """Return the angles among the coordinates, reported as they are, of which an equation is a periodic function.

    Decided by numbers, at a point without symmetry. An angle that enters linearly, of a wheel say, may turn as far as
    it likes.
    """
    terms = (system.constraints, system.output, system.potential, system.mass, system.input_matrix, system.force)
    evaluate = Call(
        ca.Function("sc_terms", [system.q, system.v, system.p], [ca.densify(ca.vertcat(*map(ca.vec, terms)))])
    )
    point, p = np.sin(1.0 + np.arange(len(system.coordinates))), system.parameters.values()
    observed = {each.name: expression for each, expression in system.observables.items()}
    found = []
    for k, each in enumerate(system.coordinates.quantities):
        if each.unit != "rad" or not ca.is_equal(observed.get(each.name, system.q[k]), system.q[k]):
            continue
        aside = np.arange(len(point)) == k
        here, there, round_again = (evaluate(point + turn * aside, point, p)[0] for turn in (0.0, 1.0, 2 * np.pi))
        scale = 1e-9 * np.maximum(np.abs(here), np.abs(there))
        if ((np.abs(round_again - here) <= scale) & (np.abs(there - here) > 1e3 * scale)).any():
            found.append(each.name)
    return tuple(found)


def follow_angles(stepper: Stepper, t: Array, states: Array, values: Array) -> None:
    """Make the angles of an exact inversion continuous, in place, between instants however far apart.

    An inversion knows its angles up to full turns, and every instant stands alone. Where an angle turns by more than a
    quarter turn from one to the next, or would at the rates there, instants in between are solved.

    Raises
    ------
    IntegrationFailed
        If the angle cannot be followed: the path comes too close to a configuration at which it is undefined.
    """
    channels = stepper.program.channels
    wrapping = tuple(k for k, channel in enumerate(channels) if channel.wraps)
    if stepper.index > 0 or stepper.scene.follow_branch or not wrapping:
        return
    angular = _angles_and_rates(stepper.system, tuple(channels[k].name for k in wrapping))
    if angular is None:
        return
    angles, rates = angular(states, stepper.parameters)
    for row, k in enumerate(wrapping):
        turns, unclear = _turns(np.diff(t), angles[row], rates[row])
        for i in np.flatnonzero(unclear):
            turns[i] = _bisected(stepper, angular, row, t[i : i + 2], states[:, i : i + 2].T)
        followed = angles[row, 0] + np.concatenate([[0.0], np.cumsum(turns)])
        values[:, k] += 2 * np.pi * np.round((followed - values[:, k]) / (2 * np.pi))


@dataclass(frozen=True, eq=False)
class _Angular:
    """Angles and their rates as a function of the entries `used` of a state, and of p."""

    function: ca.Function
    used: tuple[int, ...]

    def __call__(self, states: Array, p: Array) -> tuple[Array, Array]:
        """Return angles and rates, shape (angles, N) each, of states (size, N)."""
        count = states.shape[1]
        found = _mapped(self.function, count)(states[self.used, :], np.tile(p[:, None], count))
        angles, rates = (each.reshape(-1, count, order="F") for each in found)
        return angles, rates


def _turns(steps: Array, angle: Array, rate: Array) -> tuple[Array, npt.NDArray[np.bool_]]:
    """Return the shortest turns between instants `steps` apart, and where they may be another: too large, too fast."""
    shortest = (np.diff(angle) + np.pi) % (2 * np.pi) - np.pi
    predicted = steps * np.maximum(np.abs(rate[1:]), np.abs(rate[:-1]))
    return shortest, ~(np.maximum(np.abs(shortest), predicted) < _QUARTER_TURN)


def _bisected(stepper: Stepper, angular: _Angular, row: int, t: Array, states: Array) -> float:
    """Return by how much an angle turns between two instants, from exact inversions in between."""

    def at(time: float, state: Array) -> tuple[float, float, float, Array]:
        angle, rate = angular(state[:, None], stepper.parameters)
        return time, float(angle[row, 0]), float(rate[row, 0]), state

    done, left, waiting = 0.0, at(t[0], states[0]), [at(t[1], states[1])]
    while waiting:
        pair = np.array([left[:3], waiting[-1][:3]])
        (turn,), (unclear,) = _turns(np.diff(pair[:, 0]), pair[:, 1], pair[:, 2])
        if not unclear:
            done, left = done + float(turn), waiting.pop()
            continue
        middle = float(pair[:, 0].mean())
        state, report = stepper.advance(left[3], stepper.scene.reference.jet(middle, stepper.start_order))
        if len(waiting) > _MOST_BISECTIONS or not report.converged:
            name = [channel.name for channel in stepper.program.channels if channel.wraps][row]
            raise IntegrationFailed(
                f"{stepper.program.name}: {name} cannot be followed from t = {t[0]:.6g} s to {t[1]:.6g} s, near"
                f" t = {middle:.9g} s it turns by more than a quarter turn within {pair[1, 0] - pair[0, 0]:.2g} s"
            )
        waiting.append(at(middle, state))
    return done


@lru_cache(maxsize=32)
def _angles_and_rates(system: MechanicalSystem, names: tuple[str, ...]) -> _Angular | None:
    """Return angles and rates as functions of the state of an exact inversion, or None if they are none of q."""
    known = {each.name: system.q[k] for k, each in enumerate(system.coordinates.quantities)}
    known |= {each.name: expression for each, expression in system.observables.items()}
    angles = ca.vertcat(*[known[name] for name in names if name in known])
    places = {(each.variable, each.order): k for k, each in enumerate(Reduced().dae(system).unknowns)}
    wanted = [(f"q.{name}", order) for order in (0, 1) for name in system.coordinates.names]
    foreign = ca.vertcat(system.v, system.lam, system.u, ca.vec(system.gamma))
    if angles.numel() < len(names) or ca.depends_on(angles, foreign) or not all(each in places for each in wanted):
        return None
    state = ca.SX.sym("state", len(places))
    moved = state[[places[each] for each in wanted]]
    rates = ca.jtimes(angles, system.q, system.v)
    found = ca.substitute([angles, rates], [ca.vertcat(system.q, system.v)], [moved])
    used = sorted(set(ca.jacobian_sparsity(ca.vertcat(*found), state).get_col()))
    # A state holds all derivatives of all unknowns, an angle needs a few of them.
    function = ca.Function("sc_angles", [state[used], system.p], [ca.densify(each) for each in found])
    return _Angular(function, tuple(used))


@lru_cache(maxsize=64)
def _mapped(function: ca.Function, count: int) -> Call:
    return Call(function.map(count))


# Inputs ---------------------------------------------------------------------------------------------------------------


def warn_of_wrong_inputs(stepper: Stepper, t: Array, values: Array) -> None:
    """Warn if a run of steps gives an input that is off by more than `LARGEST_DEVIATION` of its peak.

    Forms of index two and more err by the step, and every model and path has a largest step of its own. Without
    internal dynamics the exact inputs at any instant are known: they are compared where each input is largest and where
    it changes most, at six instants of a crane's run.
    """
    scene, program, p = stepper.scene, stepper.program, stepper.parameters
    if stepper.index <= 1 or scene.follow_branch or derivative_array(stepper.system).states:
        return
    inputs = values[:, : len(stepper.system.inputs)]
    largest = np.abs(inputs).argmax(axis=0)
    steepest = np.abs(np.diff(inputs, axis=0)).argmax(axis=0) + 1
    instants = np.unique(np.concatenate([largest, steepest]))
    jets = scene.reference.jet(t[instants], program.start_order)
    exact = np.array([_exact_values(program, jet, p)[: inputs.shape[1]] for jet in jets])
    peaks = np.maximum(np.abs(inputs).max(axis=0), np.nan_to_num(np.abs(exact)).max(axis=0))
    off = np.nan_to_num(np.abs(inputs[instants] - exact))
    share = off / np.maximum(peaks, _UNNOTICED * max(float(peaks.max()), 1e-300))
    at, worst = (int(each) for each in np.unravel_index(share.argmax(), share.shape))
    if share[at, worst] > LARGEST_DEVIATION:
        quantity, k = stepper.system.inputs[worst], int(instants[at])
        # The first values of a run are exact.
        peak = max(float(np.nan_to_num(np.abs(exact[:, worst])).max()), abs(float(inputs[0, worst])))
        cause = _fastest_turn(program, values, k, LARGEST_DEVIATION * peak / off[at, worst])
        warnings.warn(
            f"{program.name}: at t = {t[k]:.6g} s {quantity.name} is {inputs[k, worst]:.4g} {quantity.unit}, the exact"
            f" inversion gives {exact[at, worst]:.4g} {quantity.unit}; {cause}take the form Reduced(), which has no"
            f" step, or a smaller step or another method",
            ServocoreWarning,
            stacklevel=4,
        )


def _exact_values(program: Program, jet: Array, p: Array) -> Array:
    state, report = program.begin(jet, p)
    return program.values(state, jet, p) if report.converged else np.full(len(program.channels), np.nan)


def _fastest_turn(program: Program, values: Array, k: int, factor: float) -> str:
    """Name the body, or else the angle, that turns most within the step to instant `k`, and the turn it may make.

    In direction cosines a turn a step exerts a torque of J turn^3/h^2 too much, so that the error of the inputs is
    proportional to the turn at a given speed; `factor` takes it to what is allowed.
    """
    column = {channel.name: values[:, j] for j, channel in enumerate(program.channels)}
    bodies = [name.removesuffix(".d1_x") for name in column if name.endswith(".d1_x")]
    turns = {}
    for body in bodies:
        before, after = (np.array([column[f"{body}.{each}"][i] for each in _DIRECTORS]) for i in (k - 1, k))
        turns[body] = float(np.arccos(np.clip((before @ after - 1.0) / 2.0, -1.0, 1.0)))
    if not bodies:
        turning = [channel.name for channel in program.channels if channel.unit == "rad"]
        turns = {name: abs(float(column[name][k] - column[name][k - 1])) for name in turning}
    most = max(turns.values(), default=0.0)
    name = next((each for each, turn in turns.items() if turn > 0.99 * most), "")
    if k == 0 or not name or turns[name] < _SMALLEST_TURN:
        return ""
    return (
        f"{name} turns by {turns[name]:.2g} rad within this step, where about {min(factor, 1.0) * turns[name]:.2g} rad"
        f" would be an error of half the peak; "
    )
