"""Row 15: a crane on a flexible rope, while it hoists fast and while it swings."""

from __future__ import annotations

from dataclasses import replace

import conserved
import numpy as np
from matplotlib.figure import Figure

import servocore as sc
from benchmarks.atlas.conserving import Drift, Mechanism
from benchmarks.atlas.record import FAILS, SURVIVES, Findings, Row, about, at_least, at_most
from benchmarks.atlas.runs import Array, slope
from benchmarks.atlas.style import GOOD, label, legend_below, panels
from benchmarks.route_styles import line_style
from servocore.scenes.rotary_crane_rope import at_rest

NAME = "flexible-rope"
DURATION, REPORT = 3.0, 0.02
ELEMENTS = (1, 2, 4, 8, 16)
STEPS = (0.01, 0.005, 0.002)
ROPE = {"rope_mass": 5.0, "rope_stiffness": 5e6}
STEP = 0.01
"""In s, of the swing that nothing drives."""
WINCH = 1e5
"""Stiffness in N/m of the spring that holds the winch there."""
CONSERVED, LOST = 1e-10, 1e-9


def crane(elements: int) -> sc.Scene:
    """Return the crane whose load is hoisted by three metres in three seconds, on a rope of 5 kg/m."""
    path = sc.rest_to_rest((5.0, 0.0, -5.0), (-2.0, 2.0, -2.0), DURATION, sc.DEGREE9)
    return sc.scenes.rotary_crane(rope_elements=elements).with_reference(path).with_parameters(**ROPE)


def measure(quick: bool) -> Findings:
    """Hoist under the exact inputs of the crane on a stiff rope without mass; then let it swing by itself."""
    found = Findings(NAME)
    counts = ELEMENTS[: 3 if quick else None]
    path = crane(1).reference
    inputs = sc.solve(sc.scenes.rotary_crane().with_reference(path), step=0.002)
    _hoisted(found, inputs, counts, STEPS[0 if quick else -1])
    if not quick:
        _with_error_control(found, inputs, counts[-2])
    _swinging(found, 2 if quick else 8, 200 if quick else 5000)
    return found


def _hoisted(found: Findings, inputs: sc.Solution, counts: tuple[int, ...], finest: float) -> None:
    """Record the balance of energy, and how motions converge with the number of elements."""
    runs: dict[int, Array] = {}
    for count in counts:
        runs[count] = _balanced(found, inputs, count, finest)
    for step in STEPS if finest < STEPS[0] else ():
        _balanced(found, inputs, counts[-2], step)
    last = runs[counts[-1]]
    errors = np.array([np.abs(runs[count] - last).max() for count in counts[:-1]])
    found.curves["elements"] = (np.array(counts[:-1]), errors)
    # The finest run stands for infinitely many elements: what it lacks itself is added.
    errors = errors / (1 - (np.array(counts[:-1]) / counts[-1]) ** 2)
    rate = slope(1.0 / np.array(counts[1:-1]), errors[1:]) if len(counts) > 3 else 2.0
    if len(counts) > 3:
        found.add("rotary_crane on a rope", "energy-momentum", "exponent of the load's error in 1/N",
                  f"N = {counts[1]} ... {counts[-2]}", about(2.0, 0.4), rate, SURVIVES)  # fmt: skip
    found.facts.update(last=counts[-1], error=float(errors[-1]), coarse=float(errors[0]))


def _balanced(found: Findings, inputs: sc.Solution, count: int, step: float) -> Array:
    """Record the balance of a run; return where the load goes."""
    scene = crane(count)
    t = REPORT * np.arange(round(DURATION / REPORT) + 1, dtype=np.float64)
    moved = sc.simulate(scene, inputs, t=t, start=at_rest(scene), method=sc.EnergyMomentum(), step=step)
    off = moved["energy"] - moved["energy"][0] - moved["work"]
    worst = float(np.abs(off).max() / np.abs(moved["energy"]).max())
    found.add("rotary_crane on a rope", "energy-momentum", "energy less work of the inputs, relative",
              f"{count} elements, h = {1e3 * step:g} ms", at_most(CONSERVED), worst, SURVIVES)  # fmt: skip
    found.facts["balance"] = max(found.facts.get("balance", 0.0), worst)
    found.curves["hoisted", count] = (t, moved["energy"] - moved["energy"][0], np.abs(off))
    return np.array([moved[axis] for axis in "xyz"])


def _with_error_control(found: Findings, inputs: sc.Solution, count: int) -> None:
    """Record how many steps error control takes, which explicit stability dictates."""
    scene, end = crane(count), 0.2
    free = sc.simulate(scene, inputs, t=np.linspace(0.0, end, 11), start=at_rest(scene))
    rate = free.statistics.steps / end
    found.add("rotary_crane on a rope", "sc.simulate (error control)", "steps a second", f"{count} elements",
              at_least(10 / STEP), rate, FAILS)  # fmt: skip
    found.facts["rate"] = rate


def swinging(elements: int) -> conserved.Motion:
    """Return the crane with free bridge and trolley, its winch on a spring and its load pushed aside."""
    scene = crane(elements)
    system, start = scene.model(), at_rest(scene)
    values = scene.parameter_values()
    p = sc.Parameters(*(replace(each, default=values[each.name]) for each in system.parameters.declared))
    assert isinstance(system.potential, sc.Potential)
    stored = system.potential.stored
    pull = values["gravity"] * (values["load_mass"] + values["rope_mass"] * values["rope_piece"])
    spring = WINCH / 2 * (system.coordinates["l"] - start["l"] + pull / WINCH) ** 2
    energy = sc.Potential(system.potential.quadratic + spring, [(each.energy, each.invariant) for each in stored])
    heights = {name: start[name] for name in start if name == "z" or name.endswith(".z")}
    for name, height in heights.items():
        start[f"{name[:-1]}y_dot"] = -2.0 * height / 5.0
    return conserved.Motion(replace(system, potential=energy, home_parameters=tuple(p.values())), start, "z")


def _swinging(found: Findings, elements: int, steps: int) -> None:
    """Record what methods keep of energy and momentum where nothing drives."""
    mechanism = Mechanism(swinging(elements))
    routes = {
        "energy-momentum": mechanism.energy_momentum,
        "midpoint": mechanism.midpoint,
        "trapezoidal, index 3": mechanism.method(sc.Trapezoidal()),
        "generalized-alpha-0.8, index 3": mechanism.method(sc.GeneralizedAlpha(0.8)),
        "RK4, stabilized": mechanism.runge_kutta,
    }
    where = f"{elements} elements, h = {1e3 * STEP:g} ms"
    for route, method in routes.items():
        drift = mechanism.march(method, STEP, steps)
        found.curves[route] = drift
        if route == "energy-momentum":
            for what, value in (("energy", drift.energy[-1]), ("angular momentum", drift.momentum[-1])):
                found.add("rope, swinging", route, f"largest change of {what}, relative", where, at_most(CONSERVED),
                          value, SURVIVES)  # fmt: skip
                found.facts["kept"] = max(found.facts.get("kept", 0.0), value)
        elif drift.stopped is not None:
            found.add("rope, swinging", route, "steps until it stops", where, at_most(steps), drift.stopped, FAILS)
        else:
            found.add("rope, swinging", route, "largest change of energy, relative", where, at_least(LOST),
                      drift.energy[-1], FAILS)  # fmt: skip
    found.facts["steps"] = steps


def draw(found: Findings) -> Figure:
    """Energy while hoisting, convergence with the number of elements, and drift while swinging."""
    figure, (left, middle, right) = panels(3, height=2.9, width=7.6)
    hoisted = [values for key, values in found.curves.items() if key[0] == "hoisted"]
    t, change, off = hoisted[-1]
    left.semilogy(
        t, np.maximum(np.abs(change), 1e-12), color="black", lw=2.6, alpha=0.35, label="hoisting: change of energy"
    )
    left.semilogy(
        t, np.maximum(off, 1e-12), color=GOOD, ls="--", label="hoisting: the same less the work of the inputs"
    )
    label(left, "time (s)", "energy (J)", "Fast hoisting, energy-momentum")
    counts, errors = found.curves["elements"]
    middle.loglog(counts, 1e3 * errors, color=GOOD, marker="s", label="hoisting: position of the load")
    middle.loglog(counts, 1e3 * errors[0] * counts[0] ** 2.0 / counts**2.0, color="0.6", ls=":", label="slope $N^{-2}$")
    middle.set_xticks(counts, [str(each) for each in counts], minor=False)
    middle.minorticks_off()
    label(
        middle, "rope elements $N$", f"distance from {found.facts['last']} elements (mm)", "Fast hoisting, convergence"
    )
    drifts = {route: drift for route, drift in found.curves.items() if isinstance(drift, Drift)}
    for route, drift in drifts.items():
        k = np.unique(np.geomspace(1, max(len(drift.energy) - 1, 1), 200).astype(int))
        k = k[k < len(drift.energy)]
        shown = np.clip(drift.energy[k], 1e-17, 1e5)
        right.loglog(k, shown, label=f"free swing: {route}", markevery=[-1] if len(k) else None, **line_style(route))
    label(right, "step", "change of energy / kinetic energy", f"Free swing, $h$ = {1e3 * STEP:g} ms")
    legend_below(figure, left, middle, right, fontsize=6.3)
    return figure


ROW = Row(
    name=NAME,
    title="Flexible ropes: stiff axial modes",
    avoid="explicit methods, or error control, on ropes and beams with stiff axial modes, which determine the step",
    do="`simulate(..., method=sc.EnergyMomentum(), step=h)` with steps for the motion of interest",
    theory="Axial waves in a rope of N elements have frequencies up to sqrt(12 EA/ρ) N/L, 2·10⁴ rad/s with eight:"
    " explicit methods are stable below 3 divided by that. The trapezoidal rule without an energy balance lets the"
    " waves grow; damped methods take energy from the motion as well.",
    survivor="Under the exact inputs of a crane on a stiff massless rope, energy changes by the work of the inputs to"
    " {balance:.0e} at all numbers of elements and steps. The load's motion converges with the square of the number"
    " of elements ({coarse:.1g} m with one, {error:.1g} m with half as many as the finest). In free swing {kept:.0e}"
    " of energy and momentum is lost over {steps:d} steps.",
    limit="Modes that the steps do not resolve are not damped either: a rope that starts out of balance keeps"
    " vibrating. The rope can push; a slack one is not modelled.",
    caption="Left: energy less the work of the inputs while hoisting. Middle: distance of the load from that on the"
    " finest rope. Right: largest change so far in a free swing; a mark is the end of a run.",
    measure=measure,
    draw=draw,
)
