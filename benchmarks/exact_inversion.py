"""What exact inversion costs: `python benchmarks/exact_inversion.py [--smoke] [--instants N]`.

Exact inversion solves the derivative array at every instant (`Reduced` on a scene without internal dynamics). Four
questions, each with the bound that the project sets itself:

* against one projected backward Euler step of the same model: at most 3 times the cost;
* against the closed form, evaluated by vectorized NumPy, an instant: at most 100 times;
* with the size of the problem: n cars in a row, n = 2 to 8, no faster than n^2;
* the array solved block by block (`newton.compile_solver`) against one sparse Newton block of CasADi's
  ``fast_newton`` over all its unknowns, from the same first guess.

All are given the reference and its derivatives beforehand. Times are medians and quartiles of runs taken in turn, in
microseconds of the processor an instant. Trust the ratios: machines are busy. With `--smoke` everything runs once and
briefly; its figures mean nothing.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable
from dataclasses import dataclass, replace

import casadi as ca
import numpy as np
from rich.console import Console
from rich.table import Table

import servocore as sc
from benchmarks.levels.costs import Spread
from benchmarks.levels.measurement import ROUTES, compiled_run, timed_in_turn
from benchmarks.levels.tables import machine
from servocore.numerics.compiled_calls import Call, side_by_side
from servocore.numerics.newton import MAX_ITERATIONS, NEWTON_TOLERANCE
from servocore.structure.derivative_array import DerivativeArray, derivative_array, nominal
from servocore.structure.inversion import inversion

CRANE = sc.scenes.rotary_crane()
CARS = range(2, 9)
MOST_PROJECTED_STEPS, MOST_CLOSED_FORMS, MOST_GROWTH = 3.0, 100.0, 2.0

Run = Callable[[], object]


@dataclass(frozen=True)
class Effort:
    """How much is measured."""

    instants: int
    repeats: int

    def microseconds(self, runs: dict[str, Run]) -> dict[str, Spread]:
        """Time runs of so many instants in turn."""
        seconds = timed_in_turn(runs, self.repeats)
        return {key: Spread.of([1e6 * each / self.instants for each in values]) for key, values in seconds.items()}


def against_step_and_closed_form(effort: Effort) -> Table:
    """Exact inversion of the smallest crane, its projected step, and its closed form."""
    jets = CRANE.reference.jet(instants_of(CRANE, effort.instants), CRANE.closed_form_order)
    values, closed_form = CRANE.parameter_values(), CRANE.closed_form
    assert closed_form is not None
    model = CRANE.default_model
    names = ("exact inversion", "projected step", "closed form in NumPy")
    runs: dict[str, Run] = {
        name: compiled_run(CRANE, *ROUTES[route], model, effort.instants)
        for name, route in zip(names, ("exact", "projected"), strict=False)
    }
    runs[names[2]] = lambda: closed_form(jets, values)
    spreads = effort.microseconds(runs)
    table = Table(title=f"rotary crane, {model}")
    add_columns(table, "what", "µs an instant", "quartiles", "inversion costs", "at most")
    bounds = {names[1]: MOST_PROJECTED_STEPS, names[2]: MOST_CLOSED_FORMS}
    for name, spread in spreads.items():
        ratio = spreads[names[0]].median / spread.median
        verdict = (f"{ratio:.1f} times", judged(ratio, bounds[name])) if name in bounds else ("", "")
        table.add_row(name, f"{spread.median:.3g}", quartiles(spread), *verdict)
    return table


def growth(effort: Effort) -> Table:
    """Exact inversion of n cars, and the exponent of its cost."""
    scenes = {n: sc.scenes.cars(n) for n in CARS}
    runs: dict[str, Run] = {
        str(n): compiled_run(scene, *ROUTES["exact"], scene.default_model, effort.instants)
        for n, scene in scenes.items()
    }
    spreads = effort.microseconds(runs)
    exponent = float(np.polyfit(np.log(list(CARS)), np.log([each.median for each in spreads.values()]), 1)[0])
    table = Table(title=f"n cars: cost grows like n^{exponent:.2f}, {judged(exponent, MOST_GROWTH)}")
    add_columns(table, "n", "index", "unknowns", "µs an instant", "quartiles")
    for n, scene in scenes.items():
        spread = spreads[str(n)]
        unknowns = len(derivative_array(scene.model()).unknowns)
        table.add_row(str(n), str(2 * n + 1), str(unknowns), f"{spread.median:.3g}", quartiles(spread))
    return table


def blocks_against_one(effort: Effort) -> Table:
    """Measure the derivative array in blocks and as one block of Newton's method."""
    problems = [(CRANE, model) for model in CRANE.models] + [(sc.scenes.cars(max(CARS)), "points")]
    table = Table(title="the array in blocks and undivided")
    add_columns(
        table, "scene, model", "unknowns", "in blocks, µs", "undivided, µs", "undivided/blocks", "they differ by"
    )
    for scene, model in problems:
        array = derivative_array(scene.model(model))
        p = scene.model(model).parameters.values(scene.parameters)
        jets = scene.reference.jet(instants_of(scene, effort.instants), array.reference_order)
        arguments = side_by_side(jets), np.tile(p[:, None], effort.instants)
        blocks = Call(inversion(array).function.map(effort.instants))
        undivided = Call(undivided_inversion(array).map(effort.instants))
        difference = worst_difference(array, blocks(*arguments)[0], undivided(*arguments)[0])
        spreads = effort.microseconds(
            {"blocks": lambda: blocks(*arguments), "undivided": lambda: undivided(*arguments)}  # noqa: B023
        )
        a, b = spreads["blocks"].median, spreads["undivided"].median
        table.add_row(
            f"{scene.model(model).name}", str(len(array.unknowns)), f"{a:.3g}", f"{b:.3g}", f"{b / a:.1f}",
            f"{difference:.0e}" if np.isfinite(difference) else "it fails",
        )  # fmt: skip
    return table


def undivided_inversion(array: DerivativeArray) -> ca.Function:
    """Return (gamma, p) -> unknowns, by Newton's method over all of them at once from the same first guess."""
    system, reference = array.system, array.system.gamma[:, : array.reference_order + 1]
    scale = np.array([nominal(system, j) for j, _ in array.unknowns])
    scaled = ca.SX.sym("scaled", len(scale))
    find_root = ca.rootfinder(
        "undivided",
        "fast_newton",
        {
            "x": scaled,
            "p": ca.vertcat(ca.vec(reference), system.p),
            "g": ca.substitute(array.residual, array.column(array.unknowns), scaled * scale),
        },
        {"abstol": 0.0, "abstolStep": NEWTON_TOLERANCE, "max_iter": MAX_ITERATIONS, "error_on_fail": False,
         "common_options": {"cse": True}},
    )  # fmt: skip
    gamma, p = ca.MX.sym("gamma", *reference.shape), ca.MX.sym("p", system.p.numel())
    guess = inversion(array).guess(gamma, p) / scale
    return ca.Function("undivided", [gamma, p], [ca.densify(find_root(guess, ca.vertcat(ca.vec(gamma), p)) * scale)])


def worst_difference(array: DerivativeArray, some: np.ndarray, others: np.ndarray) -> float:
    """Largest difference of any input, as a fraction of its largest value."""
    places = [array.position(f"u.{each.name}", 0) for each in array.system.inputs]
    peaks = np.abs(some[places]).max(axis=1, keepdims=True)
    return float((np.abs(some[places] - others[places]) / peaks).max())


def instants_of(scene: sc.Scene, count: int) -> np.ndarray:
    """Equally spaced instants from the start of the path to its end."""
    return np.linspace(scene.reference.start_time, scene.reference.end_time, count)


def judged(value: float, bound: float) -> str:
    """Say a bound and whether it is kept."""
    return f"at most {bound:g}: {'kept' if value <= bound else 'NOT kept'}"


def quartiles(spread: Spread) -> str:
    """Write the quartiles."""
    return f"{spread.lower:.3g} to {spread.upper:.3g}"


def add_columns(table: Table, first: str, *headings: str) -> None:
    """Add a column to the left and others to the right."""
    table.add_column(first)
    for heading in headings:
        table.add_column(heading, justify="right")


def main() -> None:
    """Measure everything and print the tables."""
    parser = argparse.ArgumentParser(description="What exact inversion costs.")
    parser.add_argument("--smoke", action="store_true", help="run everything once and briefly")
    parser.add_argument("--instants", type=int, default=2000, help="instants of a run")
    options = parser.parse_args()
    effort = Effort(20, 1) if options.smoke else Effort(options.instants, 15)
    console = Console(width=120)
    console.print(f"{machine()}; {effort.instants} instants, {effort.repeats} runs each")
    console.print(against_step_and_closed_form(effort), growth(effort))
    # The undivided arrays take their time: a quarter of the instants is enough.
    console.print(blocks_against_one(replace(effort, instants=-(-effort.instants // 4))))


if __name__ == "__main__":
    main()
