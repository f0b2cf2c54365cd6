"""Row 12: a million steps along a figure of eight."""

from __future__ import annotations

import resource
import time

import numpy as np
from matplotlib.figure import Figure

import servocore as sc
from benchmarks.atlas.record import FAILS, SURVIVES, Findings, Row, about, at_least, at_most
from benchmarks.atlas.runs import Array, long_march, slope
from benchmarks.atlas.style import label, legend_below, panels
from benchmarks.route_styles import line_style
from servocore import figure_of_eight

NAME = "long-runs"
STEPS_A_ROUND = 1000
STEP = 1.0 / 64.0
"""A power of two: instants are exact, whatever the number of rounds."""
PERIOD = STEP * STEPS_A_ROUND
ROUTES = (
    (sc.Reduced(), sc.BackwardEuler()),
    (sc.Projected(), sc.BackwardEuler()),
    (sc.Projected(), sc.BDF(3)),
    (sc.Projected(), sc.RadauIIA(3)),
    (sc.Projected(), sc.Gauss(1)),
)


def scene(rounds: int) -> sc.Scene:
    """Return the rotary crane whose load runs through a figure of eight of 3 m by 1.2 m, tilted by 0.6 m."""
    path = figure_of_eight((4.0, 0.0, -4.0), (0.0, 1.5, 0.0), (0.6, 0.0, 0.3), PERIOD, rounds)
    return sc.scenes.rotary_crane().with_reference(path)


def measure(quick: bool) -> Findings:
    """Run round after round, each a compiled chunk, and judge every one by the closed form."""
    found = Findings(NAME)
    rounds = 20 if quick else 1000
    subject = scene(rounds)
    for form, method in ROUTES[1::3] if quick else ROUTES:
        _run(found, subject, form, method, rounds)
    found.facts["steps"] = rounds * STEPS_A_ROUND
    return found


def _run(found: Findings, subject: sc.Scene, form: sc.Formulation, method: sc.Method, rounds: int) -> None:
    names = [each.name for each in subject.model().inputs]
    stepper = sc.Stepper(subject, form, method, STEP)
    channels = [each.name for each in stepper.program.channels]
    places = [channels.index(name) for name in names]
    exact: Array | None = None
    errors, violations, memory = [], [], []
    begun = time.perf_counter()
    for chunk in long_march(stepper, rounds * STEPS_A_ROUND, STEPS_A_ROUND):
        if exact is None:
            answer = subject.exact(chunk.t)
            exact = np.array([answer[name] for name in names])
            peaks = np.abs(exact).max(axis=1, keepdims=True)
        errors.append(float((np.abs(chunk.values[places] - exact) / peaks).max()))
        violations.append(float(chunk.violations[[0, 2]].max()))
        memory.append(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024.0)
    seconds = time.perf_counter() - begun
    route = form.name if form == sc.Reduced() else f"{form.name}, {method.name}"
    found.curves[route] = (np.array(errors), np.array(violations), np.array(memory))
    _judge(found, route, np.array(errors), np.array(violations), memory[-1] - memory[1], rounds)
    found.facts["us"] = max(found.facts.get("us", 0.0), seconds / (rounds * STEPS_A_ROUND) * 1e6)


def _judge(found: Findings, route: str, errors: Array, violations: Array, growth: float, rounds: int) -> None:
    # The first round has the start in it: the second is what later ones are compared with.
    where, ratio = f"{rounds * STEPS_A_ROUND:.0e} steps", errors[-1] / errors[1]
    key = route.replace(", ", "_").replace("-", "_")
    found.facts.update({f"{key}_second": errors[1], f"{key}_last": errors[-1]})
    if "gauss" in route:
        found.add("rotary_crane", route, "last round's input error / second round's", where,
                  at_least(rounds / 10.0), ratio, FAILS)  # fmt: skip
        late = np.arange(len(errors) // 2, len(errors))
        found.add("rotary_crane", route, "power of time with which the error grows", where, about(2.0, 0.5),
                  slope(late + 1.0, errors[late]), FAILS)  # fmt: skip
        return
    # The reduced form's error is round-off, which differs a little from round to round.
    expected = at_most(1e-12) if route == "reduced" else about(1.0, 0.02)
    observed = errors[-1] if route == "reduced" else ratio
    what = "last round's input error / peak" if route == "reduced" else "last round's input error / second round's"
    found.add("rotary_crane", route, what, where, expected, observed, SURVIVES)
    found.add("rotary_crane", route, "constraint violation in the last round [m, m2]", where, at_most(1e-12),
              violations[-1], SURVIVES)  # fmt: skip
    found.add(
        "rotary_crane", route, "growth of memory after the second round (MB)", where, at_most(8.0), growth, SURVIVES
    )
    found.facts["memory"] = max(found.facts.get("memory", 0.0), growth)
    found.facts["violation"] = max(found.facts.get("violation", 0.0), float(violations.max()))


def draw(found: Findings) -> Figure:
    """Error and violation round by round."""
    figure, (left, right) = panels(2, height=3.0)
    for route, (errors, violations, _) in found.curves.items():
        rounds = np.arange(1, len(errors) + 1)
        left.loglog(rounds, np.maximum(errors, 1e-17), label=route, markevery=0.12, **line_style(route))
        right.loglog(rounds, np.maximum(violations, 1e-17), label=route, markevery=0.12, **line_style(route))
    right.set_ylim(1e-16, 1e-12)
    label(left, "round of 1000 steps", "largest input error / peak", "rotary crane, figure of eight")
    label(right, "round of 1000 steps", "largest $|c|$, $|g|$ (m, m²)", "constraint violation")
    legend_below(figure, left, right)
    return figure


ROW = Row(
    name=NAME,
    title="Long runs",
    avoid="undamped methods for long runs",
    do="`Reduced()`, or damped methods on `Projected()`: the millionth step is as accurate as the first",
    theory="An undamped method carries every error along; with the midpoint rule (Gauss with one stage) the error"
    " grows with the square of the number of steps. With a damped method it is that of one round. Time is reduced to"
    " one period before sines are evaluated.",
    survivor="After {steps:.0e} steps backward Euler errs by {projected_backward_euler_last:.4e} of the peak, as in"
    " the second round ({projected_backward_euler_second:.4e}); the reduced form by {reduced_last:.0e}. Constraints"
    " hold to {violation:.0e}; memory grows by {memory:.1f} MB at most.",
    limit="The midpoint rule goes from {projected_gauss1_second:.0e} to {projected_gauss1_last:.0e}. A step takes up"
    " to {us:.0f} µs, closed form and checks included. `solve` keeps every step of a run in memory; `Stepper` keeps"
    " one.",
    caption="Left: largest input error in every round. Right: largest constraint violation.",
    measure=measure,
    draw=draw,
)
