"""Row 11: steps that change, on index 3 and on the reduced form."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from matplotlib.figure import Figure

import servocore as sc
from benchmarks.atlas.record import FAILS, SURVIVES, Findings, Row, about, at_least, at_most
from benchmarks.atlas.runs import Array, begin, slope
from benchmarks.atlas.style import label, legend_below, panels
from benchmarks.route_styles import line_style

NAME = "variable-steps"
CHANGE = 1.2


def alternating(count: int) -> Array:
    """Return steps whose sizes alternate 1 : 2, as shares of the run."""
    steps = np.tile([1.0, 2.0], count // 2)
    shares: Array = steps / steps.sum()
    return shares


def changed_once(count: int) -> Array:
    """Return equal steps that become 1.2 times as long in the middle of the acceleration."""
    steps = np.where(np.arange(count) < count // 3, 1.0, CHANGE)
    shares: Array = steps / steps.sum()
    return shares


def constant(count: int) -> Array:
    """Return equal steps."""
    return np.full(count, 1.0 / count)


def inputs_along(scene: sc.Scene, form: sc.Formulation, method: sc.Method, shares: Array) -> tuple[Array, Array]:
    """Drive a program through steps of any sizes; returns times and inputs after each."""
    duration = scene.reference.duration
    stepper = sc.Stepper(scene, form, method, duration * float(shares[0]))
    program, p = stepper.program, stepper.parameters
    t = scene.reference.start_time + duration * np.concatenate([[0.0], np.cumsum(shares)])
    h = np.diff(t)
    state, found = begin(stepper), []
    spacing = h[0]
    for k, step in enumerate(h):
        if program.dae.x.numel() and isinstance(method, sc.BackwardEuler):  # the straight line through its history
            old, older = np.split(state, 2)
            state = np.concatenate([old, old - step / spacing * (old - older)])
        spacing = step
        jets = scene.reference.jet(t[k] + step * np.array(program.nodes), program.order)
        state, report = program.advance(state, jets, float(step), p)
        if not report.converged:
            raise sc.IntegrationFailed(f"{program.name}: a step at t = {t[k]:g} s was not solved")
        found.append(program.values(state, scene.reference.jet(t[k + 1], program.start_order), p)[0])
    return t[1:], np.array(found)


def measure(quick: bool) -> Findings:
    """Run two cars and the mass on a car with three sequences of steps."""
    found = Findings(NAME)
    counts = (96, 384) if quick else (96, 384, 1536, 6144)
    cars = sc.scenes.cars()
    path = cars.reference
    t = np.linspace(path.start_time, path.end_time, 4001)
    values = cars.parameter_values()
    inertial = cars.exact(t)["u"] - values["mass_1"] * path.jet(t, 2)[:, 2, 0]  # m_2 x_2'', which is differenced
    peak = float(np.abs(cars.exact(t)["u"]).max())
    euler, reduced = (sc.Projected(), sc.BackwardEuler()), (sc.Reduced(), sc.BackwardEuler())
    radau = (sc.Projected(), sc.RadauIIA(3))
    half = 0.5 * float(np.abs(inertial).max()) / peak
    _scan(found, cars, *euler, alternating, counts, about(half, 0.1 * half))
    at = path.duration * float(changed_once(counts[-1])[: counts[-1] // 3].sum())
    once = 0.5 * (1.0 - 1.0 / CHANGE) * abs(float(np.interp(at, t, inertial))) / peak
    _scan(found, cars, *euler, changed_once, counts, about(once, 0.15 * once))
    _scan(found, cars, *euler, constant, counts, None)
    _scan(found, cars, *radau, alternating, counts, None)
    _scan(found, cars, *reduced, alternating, counts, at_most(1e-12))
    _scan(found, sc.scenes.mass_on_car(), sc.Reduced(), sc.RadauIIA(3), alternating, counts[:3], None)
    alternated = found.curves["cars", "projected, backward-euler, alternating"][1][-1]
    exact = found.curves["cars", "reduced, alternating"][1].max()
    found.facts.update(half=half, once=once, alternating=alternated, reduced=exact)
    return found


def _scan(
    found: Findings, scene: sc.Scene, form: sc.Formulation, method: sc.Method,
    pattern: Callable[[int], Array], counts: tuple[int, ...], expected: str | None,
) -> None:  # fmt: skip
    """Measure errors; without `expected` they must fall with the step, otherwise they must be what it says."""
    errors = []
    for count in counts:
        t, u = inputs_along(scene, form, method, pattern(count))
        exact = scene.exact(t)["u"]
        errors.append(float(np.abs(u - exact).max() / np.abs(exact).max()))
    h = scene.reference.duration / np.array(counts)
    name = pattern.__name__.replace("_", " ")
    route = (
        form.name if form == sc.Reduced() and scene.name == "cars" else f"{form.name}, {method.name}"
    ) + f", {name}"
    finest = f"mean h = {h[-1]:.2g} s"
    stuck = expected is not None and "+-" in expected
    found.curves[scene.name, route] = (h, np.array(errors))
    found.facts["_".join((scene.name, method.name.replace("-", "_"), pattern.__name__))] = errors[-1]
    if expected is not None:
        found.add(scene.name, route, "relative input error", finest, expected, errors[-1], FAILS if stuck else SURVIVES)
    if stuck:
        found.add(scene.name, route, "exponent of the input error in h", finest, about(0.0, 0.15),
                  slope(h[-2:], np.array(errors[-2:])), FAILS)  # fmt: skip
    elif expected is None:
        rate = slope(h[:2], np.array(errors[:2]))
        found.add(scene.name, route, "exponent of the input error in h", f"mean h >= {h[1]:.2g} s", at_least(0.9), rate,
                  SURVIVES)  # fmt: skip


_VARIANTS: dict[str, dict[str, Any]] = {
    "alternating": {},
    "changed once": {"ls": ":", "markerfacecolor": "white"},
    "constant": {"ls": "-", "marker": "."},
}


def draw(found: Findings) -> Figure:
    """Input error over the mean step."""
    figure, ax = panels(1, width=5.6, height=3.2)
    for (scene, route), (h, errors) in found.curves.items():
        line = line_style(route, **_VARIANTS[route.rpartition(", ")[2]])
        if scene == "mass_on_car":
            line |= {"ls": "--", "markerfacecolor": "white"}
        ax.loglog(h, np.maximum(errors, 1e-17), label=f"{scene.replace('_', ' ')}: {route}", **line)
    label(ax, "mean step $h$ (s)", "largest input error / peak", "steps that change")
    legend_below(figure, ax, columns=2)
    return figure


ROW = Row(
    name=NAME,
    title="Variable steps on index 3",
    avoid="changing the step of a projected form with backward Euler or BDF (`solve` does not offer it)",
    do="constant steps; or error control (`Adaptive`), which varies steps on the reduced form only",
    theory="Backward Euler forms an acceleration from mean velocities of two steps h₀ and h₁: (1 + h₀/h₁)/2 times the"
    " true one. With steps alternating 1 : 2 inertia forces are half too large in every second step; one change by"
    " 1.2 makes them a twelfth too small once. Neither depends on h.",
    survivor="The reduced form is independent of the step: {reduced:.0e}; with internal dynamics (mass on car) its"
    " error falls with the step, to {mass_on_car_radau3_alternating:.0e}. Radau IIA, which has no history, converges"
    " on the projected form too.",
    limit="Alternating steps: {alternating:.1%} of the peak ({half:.1%} predicted). One change by 1.2:"
    " {cars_backward_euler_changed_once:.1%} ({once:.1%} predicted), once.",
    caption="Largest input error over the mean step for steps that alternate 1 : 2, change once by 1.2, or stay.",
    measure=measure,
    draw=draw,
)
