"""Row 14: energy and momentum over ten thousand steps of mechanisms that nothing disturbs."""

from __future__ import annotations

import conserved
import numpy as np
from matplotlib.figure import Figure

import servocore as sc
from benchmarks.atlas.conserving import Drift, Mechanism
from benchmarks.atlas.record import FAILS, REFUSED, SURVIVES, Findings, Row, about, at_least, at_most
from benchmarks.atlas.runs import slope
from benchmarks.atlas.style import label, legend_below, panels, steps_in_ms
from benchmarks.route_styles import line_style

NAME = "conserved-quantities"
STEPS = 10_000
RUNS = {
    conserved.free_body: (0.1, 0.01),
    conserved.heavy_top: (0.01,),
    conserved.crane: (0.1, 0.01),
    conserved.braked_crane: (0.1, 0.01),
    conserved.four_bar: (0.1, 0.03),
    conserved.floating_loop: (0.1, 0.01),
}
"""Mechanisms, and steps in s."""
SHOWN = conserved.crane, 0.1
TOO_FAR = 0.2
"""Step in s of which the four-bar linkage turns too far."""
HALVINGS = 4
CONSERVED, GAP, LOST = 1e-10, 1e-12, 1e-9
ENERGY, MOMENTUM = "energy", "angular momentum"


def measure(quick: bool) -> Findings:
    """Let every mechanism move by itself, by the scheme that conserves and by those that do not."""
    found, steps = Findings(NAME), 300 if quick else STEPS
    for make, sizes in RUNS.items():
        mechanism = Mechanism(make())
        for h in sizes[: 1 if quick else None]:
            _conserving(found, mechanism, h, steps, shown=(make, h) == SHOWN)
            _others(found, mechanism, h, steps, shown=(make, h) == SHOWN)
        if not quick:
            drift = mechanism.simulated(steps * sizes[-1], 201).energy[-1]
            found.add(mechanism.system.name, "sc.simulate (stabilized, error control)", _change(ENERGY),
                      f"{steps * sizes[-1]:g} s", at_least(LOST), drift, FAILS)  # fmt: skip
            found.facts["controlled"] = max(found.facts.get("controlled", 0.0), drift)
    _steps_in_turn(found, Mechanism(SHOWN[0]()), 2.0 if quick else 20.0)
    _too_far(found)
    found.facts["steps"] = steps
    return found


def _change(what: str) -> str:
    return f"largest change of {what}, relative"


def _conserving(found: Findings, mechanism: Mechanism, h: float, steps: int, *, shown: bool) -> None:
    """Record what the energy-momentum scheme keeps."""
    drift, name, route, where = mechanism.march(mechanism.energy_momentum, h, steps), *_place(mechanism, h)
    found.add(name, route, _change(ENERGY), where, at_most(CONSERVED), drift.energy[-1], SURVIVES)
    if mechanism.motion.axes:
        found.add(name, route, _change(MOMENTUM), where, at_most(CONSERVED), drift.momentum[-1], SURVIVES)
    found.add(name, route, "largest constraint violation", where, at_most(GAP), drift.gap, SURVIVES)
    worst = found.facts
    for key, value in (("energy", drift.energy[-1]), ("momentum", drift.momentum[-1]), ("gap", drift.gap)):
        worst[key] = max(worst.get(key, 0.0), value)
    if shown:
        found.curves["energy-momentum"] = drift


def _place(mechanism: Mechanism, h: float) -> tuple[str, str, str]:
    return mechanism.system.name, "energy-momentum", f"h = {h:g} s"


def _others(found: Findings, mechanism: Mechanism, h: float, steps: int, *, shown: bool) -> None:
    """Record how far other methods go at the same step, or where they stop."""
    routes = {
        "midpoint": mechanism.midpoint,
        "trapezoidal, index 3": mechanism.method(sc.Trapezoidal()),
        "generalized-alpha-0.8, index 3": mechanism.method(sc.GeneralizedAlpha(0.8)),
        "RK4, stabilized": mechanism.runge_kutta,
    }
    stored = bool(getattr(mechanism.system.potential, "stored", ()))
    for route, method in routes.items():
        drift, where = mechanism.march(method, h, steps), f"h = {h:g} s"
        same = route == "midpoint" and not stored  # forces that do not change over a step, or change linearly
        _record(found, mechanism.system.name, route, where, drift, steps, same=same)
        if shown:
            found.curves[route] = drift


def _record(found: Findings, name: str, route: str, where: str, drift: Drift, steps: int, *, same: bool) -> None:
    if drift.stopped is not None:
        found.add(name, route, "steps until it stops", where, at_most(steps), drift.stopped, FAILS)
    elif same:
        found.add(name, route, _change(ENERGY), where, at_most(CONSERVED), drift.energy[-1], SURVIVES)
    else:
        found.add(name, route, _change(ENERGY), where, at_least(LOST), drift.energy[-1], FAILS)


def _steps_in_turn(found: Findings, mechanism: Mechanism, duration: float) -> None:
    """Halve the step: drifts of the others fall with their orders, that of the scheme is round-off at every step."""
    h = SHOWN[1] / 2.0 ** np.arange(HALVINGS)
    routes = {
        "energy-momentum": (mechanism.energy_momentum, None),
        "midpoint": (mechanism.midpoint, 2.0),
        "generalized-alpha-0.8, index 3": (mechanism.method(sc.GeneralizedAlpha(0.8)), None),
        "RK4, stabilized": (mechanism.runge_kutta, 4.5),  # it errs by h^4, and damps by h^5
    }
    for route, (method, order) in routes.items():
        drifts = np.array([mechanism.march(method, each, round(duration / each)).energy[-1] for each in h])
        found.curves["steps", route] = (h, drifts)
        if order is not None:
            found.add(mechanism.system.name, route, "exponent of the change of energy in h", f"h <= {h[1]:g} s",
                      about(order, 0.6), slope(h[1:], drifts[1:]), FAILS)  # fmt: skip


def _too_far(found: Findings) -> None:
    """Let the four-bar linkage turn too far in a step: an error, not a wrong answer."""
    try:
        conserved.four_bar().run(TOO_FAR, 1000, every=100)
        seen = "nothing"
    except sc.IntegrationFailed as error:
        seen = type(error).__name__
        found.facts["said"] = str(error)
    found.add("four-bar", "sc.simulate, EnergyMomentum()", "what is said", f"h = {TOO_FAR:g} s", "IntegrationFailed",
              seen, REFUSED)  # fmt: skip


def draw(found: Findings) -> Figure:
    """Energy and momentum over steps, and the drift of the energy over the step."""
    figure, (left, middle, right) = panels(3, height=2.9, width=7.6)
    drifts = {route: drift for route, drift in found.curves.items() if isinstance(drift, Drift)}
    for route, drift in drifts.items():
        for axes, values in ((left, drift.energy), (middle, drift.momentum)):
            k = np.unique(np.geomspace(1, len(values) - 1, 200).astype(int))
            axes.loglog(k, np.clip(values[k], 1e-17, 1e4), label=route, markevery=[-1], **line_style(route))
    for axes, what in ((left, "energy"), (middle, "momentum")):
        label(axes, "step", f"change of {what}, relative", f"crane, 9 coordinates, $h$ = {SHOWN[1]:g} s")
    steps = {key[1]: value for key, value in found.curves.items() if isinstance(key, tuple)}
    for route, values in steps.items():
        right.loglog(*values, label=route, **line_style(route))
    steps_in_ms(right, steps["midpoint"][0])
    label(right, "step $h$ (ms)", "change of energy, relative", "the same, over equal times")
    legend_below(figure, left, middle, right)
    return figure


ROW = Row(
    name=NAME,
    title="Energy and momentum that drift",
    avoid="implicit methods without a discrete energy balance on index 3 (trapezoidal, generalized-alpha), and index"
    " reduction, for undamped mechanisms that move for long",
    do="`simulate(..., method=sc.EnergyMomentum(), step=h)`; a smaller step where it refuses a rotation per step",
    theory="Forces at the ends or in the middle of a step do other work than the change of their potential, and"
    " constraint forces along G at the end of a step do work. The loss per step is a power of h. Gonzalez's scheme"
    " takes difference quotients of the energy as forces and G in the middle of the step: the balance is exact at"
    " any step.",
    survivor="Over {steps:d} steps energy changes by {energy:.0e} of the first kinetic energy at most, angular"
    " momentum by {momentum:.0e} of its size; constraints hold to {gap:.0e}. With weight as the only force the"
    " midpoint rule conserves as well.",
    limit="Accuracy is of second order in h. Too large a rotation in a step is an error: “{said}”. `simulate` without"
    " a method drifts by more than round-off.",
    caption="Left and middle: largest change so far of energy (relative to the first kinetic energy) and angular"
    " momentum; a mark is the end of a run, before {steps:d} steps if the method stopped. Right: over equal times,"
    " for different steps.",
    measure=measure,
    draw=draw,
)
