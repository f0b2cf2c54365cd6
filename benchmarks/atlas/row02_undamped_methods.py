"""Row 2: methods that damp nothing, on the projected form of index 3."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from matplotlib.figure import Figure

import servocore as sc
from benchmarks.atlas.record import FAILS, SURVIVES, Findings, Row, about, at_least, at_most
from benchmarks.atlas.runs import Array, disturbed, error_at, march, slope
from benchmarks.atlas.style import label, legend_below, panels
from benchmarks.route_styles import line_style

NAME = "undamped-methods"
UNDAMPED = (sc.Trapezoidal(), sc.GeneralizedAlpha(1.0), sc.Gauss(1), sc.Gauss(2))
DAMPED = (sc.GeneralizedAlpha(0.8), sc.BackwardEuler(), sc.BDF(2), sc.RadauIIA(3))
GROWTHS = (
    (sc.Projected(), sc.Trapezoidal(), 1.0),
    (sc.Projected(), sc.GeneralizedAlpha(1.0), 1.0),
    (sc.Projected(), sc.Gauss(1), 2.0),
    (sc.Projected(), sc.Gauss(2), 2.0),
    (sc.Original(), sc.Trapezoidal(), 2.0),
)
"""Form, method and the power of the number of steps with which an error of x_2 in the first state grows."""
RHOS = (0.9, 0.8, 0.5)
DELTA = 1e-6
STEP = 2e-3


def measure(quick: bool) -> Findings:
    """Scan the step on two cars, then disturb the first state by a micrometre and watch the input."""
    found = Findings(NAME)
    cars = sc.scenes.cars()
    steps = (100, 400, 1600) if quick else (100, 400, 1600, 6400, 25_600)
    _scan(found, cars, steps)
    _disturb(found, cars, 200 if quick else 1000)
    _decay(found, cars)
    return found


def _scan(found: Findings, cars: sc.Scene, steps: tuple[int, ...]) -> None:
    h = cars.reference.duration / np.array(steps)
    found.curves["h"] = h
    for method in (*UNDAMPED, *DAMPED):
        errors = np.array([error_at(cars, sc.Projected(), method, count) for count in steps])
        found.curves[method.name] = errors
        finest = f"h = {h[-1]:.2g} s"
        if method in UNDAMPED:
            found.add("cars", f"projected, {method.name}", "relative input error", finest, at_least(0.1), errors[-1],
                      FAILS)  # fmt: skip
            rate = -2.0 if method == sc.Gauss(2) else 0.0
            few = slice(0, 3)  # later round-off adds its own growth
            found.add("cars", f"projected, {method.name}", "exponent of the input error in h", finest,
                      about(rate, 0.15), slope(h[few], errors[few]), FAILS)  # fmt: skip
        else:
            found.add("cars", f"projected, {method.name}", "relative input error", finest, at_most(5e-3), errors[-1],
                      SURVIVES)  # fmt: skip
        found.facts[method.name.replace("-", "_").replace(".", "_")] = errors[-1]
    errors = np.array([error_at(cars, sc.Reduced(), sc.BackwardEuler(), count) for count in steps])
    found.curves["reduced"] = errors
    found.add("cars", "reduced", "relative input error", "every h", at_most(1e-12), errors.max(), SURVIVES)
    found.facts["reduced"] = errors.max()


def input_disturbance(
    cars: sc.Scene, form: sc.Formulation, method: sc.Method, h: float, steps: int, change: Callable[[Array], Array]
) -> Array:
    """Return what a change of the first state adds to the input, step by step."""
    stepper = sc.Stepper(cars, form, method, h)
    found: Array = march(stepper, steps, change)["u"] - march(stepper, steps)["u"]
    return found


def _disturb(found: Findings, cars: sc.Scene, steps: int) -> None:
    late = np.arange(steps // 10, steps + 1)
    for form, method, power in GROWTHS:
        change = disturbed(sc.Stepper(cars, form, method, STEP), form, "q.x_2", 0, DELTA)
        size = np.abs(input_disturbance(cars, form, method, STEP, steps, change))
        growth = slope(late, size[late])
        route = f"{form.name}, {method.name}"
        found.add("cars", route, "power of n with which a start error of x_2 grows", f"h = {STEP:g} s",
                  about(power, 0.1), growth, FAILS)  # fmt: skip
        found.curves["start", route] = size


def _decay(found: Findings, cars: sc.Scene) -> None:
    for rho in RHOS:
        method = sc.GeneralizedAlpha(rho)
        change = disturbed(sc.Stepper(cars, sc.Projected(), method, STEP), sc.Projected(), "q.x_2", 0, DELTA)
        size = np.abs(input_disturbance(cars, sc.Projected(), method, STEP, 160, change))
        # n rho^n at first (a double root), so the ratio is taken between late steps, above round-off.
        seen = np.flatnonzero(size > 1e-9 * size.max())[-1]
        first = seen // 2
        ratio = (size[seen] / size[first] * first / seen) ** (1.0 / (seen - first))
        found.add("cars", f"projected, {method.name}", "ratio of a start error from step to step (less the factor n)",
                  f"rho = {rho:g}", about(rho, 0.03), ratio, SURVIVES)  # fmt: skip
        found.curves["start", f"projected, {method.name}"] = size
    forgotten = int(np.flatnonzero(found.curves["start", "projected, generalized-alpha-0.8"] > 1e-6)[-1])
    found.facts["forgotten"] = forgotten


def draw(found: Findings) -> Figure:
    """Left: error over step. Right: what a start error does to the input."""
    figure, (left, right) = panels(2, height=3.1)
    for name in ("trapezoidal", "gauss1", "gauss2", "generalized-alpha-0.8", "backward-euler", "reduced"):
        words = name if name == "reduced" else f"projected, {name}"
        left.loglog(found.curves["h"], found.curves[name], label=words, **line_style(words, **_of_two(name)))
    label(left, "step $h$ (s)", "largest input error / peak", "two cars, path of degree 9")
    shown = ("original, trapezoidal", "projected, gauss2", "projected, trapezoidal", "projected, generalized-alpha-0.9",
             "projected, generalized-alpha-0.5")  # fmt: skip
    for name in shown:
        size = found.curves["start", name]
        n = np.arange(1, len(size))
        line = line_style(name, **_of_two(name))
        right.loglog(n, np.maximum(size[1:], 1e-12), label=name, markevery=0.12, **line)
    right.set_ylim(bottom=1e-7)
    label(right, "steps since the start", "change of the input (N)", "first $x_2$ off by 1 µm, h = 2 ms")
    legend_below(figure, left, right)
    return figure


def _of_two(name: str) -> dict[str, str]:
    """Tell members of one family apart by an open mark."""
    return {"markerfacecolor": "white"} if name.endswith(("gauss2", "-0.5")) else {}


ROW = Row(
    name=NAME,
    title="Methods without damping",
    avoid="`Trapezoidal()`, `Gauss(s)` and `GeneralizedAlpha(1.0)` on projected or original forms",
    do="`BackwardEuler()`, `BDF(k)`, `RadauIIA(s)`, `GeneralizedAlpha(0.8)`; or `Reduced()`",
    theory="On index 3 the trapezoidal rule turns a velocity error into an undamped error of alternating sign, and"
    " the inputs are its difference quotient. The jump of the fifth derivative at the start of a path of degree 9"
    " excites it. An error of the first positions grows linearly with the number of steps (trapezoidal rule, index"
    " 3), quadratically with Gauss methods and on index 5.",
    survivor="Generalized-alpha with ρ = 0.8 damps such an error below 1e-6 N within {forgotten:d} steps; multistep and"
    " Radau methods lose it (row 3).",
    limit="Generalized-alpha with ρ = 0.8 is of first order over the whole run, because of the kink at the start:"
    " {generalized_alpha_0_8:.1e} at the finest step.",
    caption="Left: errors that do not fall with the step, or rise. Right: growth of the input error after a start"
    " that is off by one micrometre.",
    measure=measure,
    draw=draw,
)
