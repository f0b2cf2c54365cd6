"""Row 3: initial values that do not satisfy the hidden constraints."""

from __future__ import annotations

import numpy as np
from matplotlib.figure import Figure

import servocore as sc
from benchmarks.atlas.record import FAILS, SURVIVES, Findings, Row, about, at_most
from benchmarks.atlas.row02_undamped_methods import input_disturbance
from benchmarks.atlas.runs import disturbed, march, slope
from benchmarks.atlas.style import label, legend_below, panels, steps_in_ms
from benchmarks.route_styles import line_style
from servocore.methods.bdf import coefficients
from servocore.methods.collocation import tableau

NAME = "inconsistent-start"
DELTA = 1e-6
METHODS = (sc.BackwardEuler(), sc.BDF(2), sc.BDF(3), sc.RadauIIA(2), sc.RadauIIA(3))
STEPS = (500, 1000, 2000)


def measure(quick: bool) -> Findings:
    """Shift x_2 of the first state by a micrometre; watch the input at three step sizes."""
    found = Findings(NAME)
    cars = sc.scenes.cars()
    mass = cars.parameter_values()["mass_2"]
    for method in METHODS:
        size, duration = prediction(method)
        _spike(found, cars, method, size * mass, duration)
    _never(found, cars)
    _index_five(found, cars)
    _consistent(found, cars, quick)
    return found


def prediction(method: sc.Method) -> tuple[float, int]:
    """Return the spike in m delta/h^2 and the steps it lasts, for the newest position off by delta.

    Multistep: positions at later instants are right, velocities 1 ... k are off by alpha_j delta/h, and the input
    holds m times the same formula applied to velocities: the coefficients of A(z) (A(z) - alpha_0), where
    A = sum alpha_i z^i.
    Radau: stages are right, so velocities are off by W 1 delta/h in the first step, W = A^-1, and the input at its end
    by the last entry of W W 1; the second step starts from a velocity that is off, and feels (W 1)_s^2.
    """
    if isinstance(method, sc.RadauIIA):
        rates = np.linalg.inv(tableau("radau", method.stages).A)
        once = rates.sum(axis=1)
        return float(max(abs((rates @ once)[-1]), once[-1] ** 2)), 2
    order = method.order if isinstance(method, sc.BDF) else 1
    alpha = np.array([float(each) for each in coefficients(order)])
    return float(np.abs(np.convolve(alpha, [0.0, *alpha[1:]])).max()), 2 * order


def _curve(found: Findings, cars: sc.Scene, form: sc.Formulation, method: sc.Method, steps: int, count: int) -> None:
    h = cars.reference.duration / steps
    change = disturbed(sc.Stepper(cars, form, method, h), form, "q.x_2", 0, DELTA)
    found.curves[form.name, method.name, steps] = np.abs(input_disturbance(cars, form, method, h, count, change))


def _spike(found: Findings, cars: sc.Scene, method: sc.Method, expected: float, duration: int) -> None:
    peaks = []
    for steps in STEPS:
        _curve(found, cars, sc.Projected(), method, steps, 12)
        size = found.curves["projected", method.name, steps]
        peaks.append(size.max() * (cars.reference.duration / steps) ** 2 / DELTA)
    h = cars.reference.duration / np.array(STEPS)
    route, where = f"projected, {method.name}", f"h = {h[-1]:g} s"
    found.add("cars", route, "spike in delta/h^2 (kg)", where, about(expected, 0.03 * expected), peaks[-1], FAILS)
    found.add("cars", route, "exponent of the spike in h", f"h = {h[-1]:g} ... {h[0]:g} s", about(-2.0, 0.02),
              slope(h, np.array(peaks) / h**2), FAILS)  # fmt: skip
    lasting = int(np.flatnonzero(size > 1e-9 * size.max())[-1])
    found.add("cars", route, "steps until it is forgotten", where, about(duration, 0.5), lasting, SURVIVES)
    found.facts[method.name.replace("-", "_")] = peaks[-1]


def _never(found: Findings, cars: sc.Scene) -> None:
    for method in (sc.Trapezoidal(), sc.GeneralizedAlpha(0.8)):
        _curve(found, cars, sc.Projected(), method, STEPS[-1], 200)
        size = found.curves["projected", method.name, STEPS[-1]]
        left = size[-1] / size.max()
        route = f"projected, {method.name}"
        if isinstance(method, sc.Trapezoidal):
            found.add("cars", route, "left of the largest spike", "after 200 steps", about(1.0, 0.01), left, FAILS)
        else:
            found.add("cars", route, "left of the largest spike", "after 200 steps", at_most(1e-9), left, SURVIVES)


def _index_five(found: Findings, cars: sc.Scene) -> None:
    """Shift the prescribed position itself: on the original form the input feels it through four differences."""
    peaks, form, method = [], sc.Original(), sc.BackwardEuler()
    h = cars.reference.duration / np.array(STEPS)
    for step in h:
        change = disturbed(sc.Stepper(cars, form, method, step), form, "q.x_1", 0, DELTA)
        peaks.append(np.abs(input_disturbance(cars, form, method, step, 12, change)).max())
    values = cars.parameter_values()
    expected = 3.0 * values["mass_1"] * values["mass_2"] / values["stiffness_1"]
    found.add("cars", "original, backward-euler", "exponent of the spike in h, x_1 off",
              f"h = {h[-1]:g} ... {h[0]:g} s",
              about(-4.0, 0.05), slope(h, np.array(peaks)), FAILS)  # fmt: skip
    found.add("cars", "original, backward-euler", "spike in delta/h^4 (kg s2), x_1 off", f"h = {h[-1]:g} s",
              about(expected, 0.1 * expected), peaks[-1] * h[-1] ** 4 / DELTA, FAILS)  # fmt: skip
    exact = np.abs(cars.exact(np.linspace(0.0, 4.0, 401))["u"]).max()
    found.facts["original_peaks"] = peaks[-1] / exact


def _consistent(found: Findings, cars: sc.Scene, quick: bool) -> None:
    """Start as the library does, with all constraints satisfied: no spike. The reduced form cannot have one."""
    for steps in STEPS[:1] if quick else STEPS:
        h = cars.reference.duration / steps
        exact = cars.exact(h * np.arange(13, dtype=np.float64))["u"]
        peak = float(np.abs(cars.exact(np.linspace(0.0, 4.0, 401))["u"]).max())
        own = march(sc.Stepper(cars, sc.Projected(), sc.BackwardEuler(), h), 12)["u"]
        error = float(np.abs(own - exact).max()) / peak
        found.add("cars", "projected, backward-euler, consistent start", "input error / peak, first 12 steps",
                  f"h = {h:g} s", at_most(20.0 * h / 4.0), error, SURVIVES)  # fmt: skip
        found.facts["own"] = error
    stepper = sc.Stepper(cars, sc.Reduced(), sc.BackwardEuler(), h)
    off = march(stepper, 3, lambda state: state + DELTA)["u"] - march(stepper, 3)["u"]
    found.add("cars", "reduced", "left of a disturbed state after one step (N)", f"delta = {DELTA:g} m", at_most(1e-9),
              float(np.abs(off[1:]).max()), SURVIVES)  # fmt: skip
    found.facts["reduced"] = float(np.abs(off[1:]).max())


def draw(found: Findings) -> Figure:
    """Left: the spikes step by step. Right: their size over the step."""
    figure, (left, right) = panels(2, height=3.1)
    for name in ("backward-euler", "bdf3", "radau3", "generalized-alpha-0.8", "trapezoidal"):
        size = found.curves["projected", name, STEPS[-1]][1:41]
        line = line_style(name, markersize=3)
        left.semilogy(np.arange(1, len(size) + 1), np.maximum(size, 1e-12), label=f"projected, {name}", **line)
    left.set(ylim=(1e-6, 1e2), xlim=(0, 40))
    label(left, "step number", "change of the input (N)", f"first $x_2$ off by 1 µm, h = {4 / STEPS[-1] * 1e3:g} ms")
    h = 4.0 / np.array(STEPS)
    for name in ("backward-euler", "bdf2", "bdf3", "radau2", "radau3"):
        line = line_style(name, **({"markerfacecolor": "white"} if name.endswith("2") else {}))
        sizes = [found.curves["projected", name, steps].max() for steps in STEPS]
        right.loglog(h, sizes, label=f"projected, {name}", **line)
    right.loglog(h, 0.6e-6 / h**2, "k:", lw=0.8, label="$h^{-2}$")
    steps_in_ms(right, h)
    label(right, "step $h$ (ms)", "largest change of the input (N)", "size of the spike")
    legend_below(figure, left, right)
    return figure


ROW = Row(
    name=NAME,
    title="Inconsistent initial values",
    avoid="initial values put together by hand, or from measurements",
    do="the start that `solve` and `Stepper.start` compute from the path",
    theory="A position that is off by δ at the start makes a velocity wrong by δ/h and an input by a multiple of m"
    " δ/h², on the original form of δ/h⁴. Methods that use the last k instants lose the error after a fixed number of"
    " steps, generalized-alpha with ρ < 1 like n ρⁿ, the trapezoidal rule never.",
    survivor="The library starts from the exact inversion: no spike, an input error of {own:.1e} of the peak in the"
    " first 12 steps. The reduced form has no history: {reduced:.0e} N after one step.",
    limit="With an error δ: {backward_euler:.0f} kg·δ/h² for two steps of backward Euler, {bdf2:.1f} with BDF2,"
    " {radau3:.0f} with Radau IIA(3). On the original form one micrometre in x₁ at h = 2 ms costs"
    " {original_peaks:.0f} times the input's peak.",
    caption="Left: change of the input by one micrometre in the first state, step by step. Right: the largest change"
    " over the step.",
    measure=measure,
    draw=draw,
)
