"""Cost against size: cranes side by side, a closed chain, an elastic bar, and a cold start; `scale.csv` and its page.

Gantry cranes of 6 coordinates each stand in one system, independent of one another: ideally the cost is proportional to
their number (exponent one). SUNDIALS' idas solves the same reduced form with all derivatives as unknowns, by CasADi;
the closed form is evaluated in NumPy, crane by crane. A closed chain of bars, each a body of three coordinates, has no
independent parts. Times are processor times, the smallest of several, on the machine of [speed and
accuracy](index.md); solves are interpreted.

Expressions of more than 30,000 operations are not compiled (160 cranes, long closed chains), since compilation takes
minutes. Ranks and conditions of parts of 128 rows or more are those of sparse factors.
"""

from __future__ import annotations

import csv
import os
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import casadi as ca
import numpy as np

import servocore as sc
from benchmarks.chains import closed_chain
from benchmarks.chart import calls
from benchmarks.chart.c_cost import in_c
from benchmarks.chart.requirements import NO_REASON
from benchmarks.chart.tables import markdown
from benchmarks.chart.timing import processor_time
from benchmarks.copies import cranes
from benchmarks.peers.base import Lean
from benchmarks.step_cost import loop_arguments
from servocore.numerics.compiled_calls import Call
from servocore.numerics.machine_code import BACKGROUND
from servocore.scenes.bar_marching import march_bar
from servocore.structure.inversion import inversion

FILE, PAGE = "scale.csv", "scale.md"
COLUMNS = ("what", "size", "quantity", "value", "unit")
CRANES, BARS, CHAINS = (1, 4, 16, 40, 160), (10, 30, 100, 300, 1000), (4, 8, 16, 32, 64, 128)
CRANE, BAR, COLD, MANY = "gantry cranes in one system", "elastic bar, space marching", "cold start", "10,000 instants"
CHAIN, STEPPED = "bodies in a closed chain", "projected backward Euler, 2,000 steps"
IN_C, WITHOUT_CHECKS, CHECKED = "its step in C", "solve without checks, machine code", "solve, machine code"
MOST_OF_PEER = 16  # cranes: beyond, idas takes minutes
MOST_SOLVED = 32  # bars: beyond, the rest of the study would wait for the first solve
STEPS, INSTANTS, LARGE = 200, 1000, 10_000
REPEATS = 5
STAGES = {"import": 0.3, "analyse": 0.5, "first solve": 0.04}
"""Of a cold start of the rotary crane, with the seconds that are wanted at most."""
WITHOUT, BENEATH = ", no compiler", "import, of which NumPy and CasADi"
LINEAR = 1.1
"""Largest exponent of what is to grow as the number of cranes does."""
STEPS_OF_C = 2.0
"""How many times the steps of a run may take what they take in C, with all that stands around them."""
_FROM = 4  # cranes: below, what is fixed shows

_START = """
import time
begin = time.process_time()
import numpy, casadi
beneath = time.process_time()
import servocore as sc
imported = time.process_time()
crane = sc.scenes.rotary_crane()
sc.analyse(crane)
analysed = time.process_time()
sc.solve(crane)
print(imported - begin, analysed - imported, time.process_time() - analysed, beneath - begin)
"""


@dataclass(frozen=True)
class Point:
    """One line of the file."""

    what: str
    size: int
    quantity: str
    value: float
    unit: str


def measure_scale(smoke: bool = False) -> list[Point]:
    """Measure everything."""
    for scene in (sc.scenes.gantry_crane(), cranes(CRANES[-2])[0]):  # what is imported when first needed
        sc.analyse(scene)
    if smoke:
        bars = [point for pieces in BARS[:2] for point in _bar(pieces)]
        return [*_cranes(CRANES[0]), *_chain(CHAINS[0]), *bars, *_calls(smoke)]
    found = [point for count in CRANES for point in _cranes(count)]
    found += [point for bodies in CHAINS for point in _chain(bodies)]
    found += [point for pieces in BARS for point in _bar(pieces)]
    return [*found, *_many_instants(), *_calls(), *_beside_c(), *_cold_start(10)]


def _seconds(run: Callable[[], object], repeats: int = REPEATS) -> float:
    times = []
    for _ in range(repeats):
        begin = processor_time()
        run()
        times.append(processor_time() - begin)
    return min(times)


def _cranes(count: int) -> Iterator[Point]:
    scene, alone = cranes(count)
    scene.model()
    path = scene.reference
    t = np.linspace(path.start_time, path.end_time, INSTANTS)
    step = path.duration / STEPS
    yield Point(CRANE, count, "analyse", _seconds(lambda: sc.analyse(scene), 1), "s")
    for words, native in (("interpreted", False), ("machine code", None)):
        inputs = sc.ExactInversion(scene, native=native)
        for _ in range(2):
            inputs(t)
            BACKGROUND.wait()
        value = _seconds(partial(inputs, t)) / INSTANTS * 1e6
        yield Point(CRANE, count, f"ExactInversion, {words}", value, "us an instant")
    yield Point(CRANE, count, "closed form in NumPy",
                _seconds(lambda: [each.exact(t) for each in alone]) / INSTANTS * 1e6, "us an instant")  # fmt: skip
    for name, run in (
        ("solve", partial(sc.solve, scene, step=step, native=False)),
        (
            "projected backward Euler",
            partial(sc.solve, scene, sc.Projected(), sc.BackwardEuler(), step=step, native=False),
        ),
    ):
        yield Point(CRANE, count, f"{name}, the first", _seconds(run, 1), "s")
        yield Point(CRANE, count, f"{name}, {STEPS} steps", 1e3 * _seconds(run), "ms")
    if count <= MOST_OF_PEER:
        yield Point(CRANE, count, f"idas, 1e-6, {STEPS} intervals", 1e3 * _seconds(_idas(scene), 2), "ms")


def _idas(scene: sc.Scene) -> Callable[[], object]:
    """Return a run of idas on the equations of exact inversion: a clock, and everything else algebraic."""
    problem = sc.Problem.of(scene)
    dae, order, formula = problem.dae(sc.Reduced()), problem.array.reference_order, scene.reference.formula
    assert formula is not None
    clock, time = ca.SX.sym("clock"), ca.SX.sym("t")
    gamma = ca.horzcat(*formula.jet(time, [ca.SX(each) for each in formula.numbers(order)], order))
    symbols = ca.vertcat(ca.vec(dae.gamma[:, : order + 1]), dae.p)
    alg = ca.substitute(dae.h, symbols, ca.vertcat(ca.vec(gamma), problem.p))
    t = np.linspace(scene.reference.start_time, scene.reference.end_time, STEPS + 1)
    equations = {"x": clock, "z": dae.z, "t": time, "ode": ca.SX(1), "alg": alg}
    options = {"reltol": 1e-6, "abstol": 1e-6, "max_num_steps": 20_000}
    integrate = Lean(ca.integrator("sc_peer", "idas", equations, t[0], list(t[1:]), options))
    jet = scene.reference.jet(t[:1], order)[0].T
    z0 = np.asarray(inversion(problem.array).function(jet, problem.p)[0]).ravel()
    return lambda: integrate(np.zeros(1), z0)


def _chain(bodies: int) -> Iterator[Point]:
    """Measure bars hinged one to the next, both ends to the ground: what they cost hangs together, all of it."""
    scene = closed_chain(bodies)
    path = scene.reference
    t, step = np.linspace(path.start_time, path.end_time, INSTANTS), path.duration / STEPS
    yield Point(CHAIN, bodies, "analyse", _seconds(lambda: sc.analyse(scene), 1), "s")
    if bodies > MOST_SOLVED:
        return
    inputs = sc.ExactInversion(scene, native=False)
    inputs(t)
    value = _seconds(lambda: inputs(t)) / INSTANTS * 1e6
    yield Point(CHAIN, bodies, "ExactInversion, interpreted", value, "us an instant")
    default = partial(sc.solve, scene, step=step, native=False)
    stepped = partial(sc.solve, scene, sc.Projected(), sc.BackwardEuler(), step=step, native=False)
    for name, run in (("solve", default), ("projected backward Euler", stepped)):
        run()
        yield Point(CHAIN, bodies, f"{name}, {STEPS} steps", 1e3 * _seconds(run), "ms")


def _bar(pieces: int) -> Iterator[Point]:
    path = sc.rest_to_rest((0.0,), (0.1,), 0.02)
    data = {"length": 1.0, "axial_stiffness": 2e5, "line_mass": 0.1, "end_mass": 0.1}
    value = _seconds(lambda: march_bar(path, **data, pieces=pieces))
    yield Point(BAR, pieces, "march_bar", 1e3 * value, "ms")


def _many_instants() -> Iterator[Point]:
    """Measure the crane at 10,000 instants; the share of the checks is that of `checks=False`."""
    crane = sc.scenes.rotary_crane()
    path = crane.reference
    t, step = np.linspace(path.start_time, path.end_time, LARGE), path.duration / (LARGE - 1)
    for words, native in (("interpreted", False), ("machine code", True)):
        prepared = sc.ExactInversion(crane, native=native)
        runs: dict[str, Callable[[], object]] = {
            "ExactInversion": partial(prepared, t),
            "solve": partial(sc.solve, crane, step=step, native=native),
            "solve without checks": partial(sc.solve, crane, step=step, native=native, checks=False),
        }
        for name, run in runs.items():
            run()
            yield Point(MANY, 1, f"{name}, {words}", _seconds(run, 3 * REPEATS) / LARGE * 1e6, "us an instant")
    masses = np.linspace(50.0, 150.0, 500)
    batch = sc.Batch(crane, native=True)
    few = np.linspace(path.start_time, path.end_time, 201)
    value = _seconds(lambda: batch(few, {"load_mass": masses})) / (len(few) * len(masses)) * 1e6
    yield Point(MANY, len(masses), "Batch of 201 instants each, machine code", value, "us an instant")
    some, step = masses[::10], path.duration / STEPS
    value = _seconds(lambda: [sc.solve(crane.with_parameters(load_mass=mass), step=step) for mass in some]) / len(some)
    yield Point(MANY, len(some), f"solve of {STEPS} steps each, one by one", value * 1e3, "ms a case")
    value = _seconds(lambda: batch.solve({"load_mass": some}, steps=STEPS)) / len(some)
    yield Point(MANY, len(some), f"Batch.solve of {STEPS} steps each", value * 1e3, "ms a case")


def _calls(smoke: bool = False) -> Iterator[Point]:
    """Measure what a call of `DynamicInversion` costs, and how much of it beside the steps."""
    return (Point(*each) for each in calls.measure_calls(smoke))


def _beside_c(count: int = 2000) -> Iterator[Point]:
    """Measure backward Euler of the projected crane beside its compiled step, generated as C and called in a row."""
    crane = sc.scenes.rotary_crane()
    step = crane.reference.duration / count
    stepper = sc.Stepper(crane, sc.Projected(), sc.BackwardEuler(), step)
    checked = partial(sc.solve, crane, sc.Projected(), sc.BackwardEuler(), step=step, native=True)
    runs: dict[str, Callable[[], object]] = {WITHOUT_CHECKS: partial(checked, checks=False), CHECKED: checked}
    with tempfile.TemporaryDirectory() as folder:
        in_a_row = in_c(stepper.program.step.mapaccum("sc_steps", count), Path(folder))
        if in_a_row is None:
            return  # no compiler, no row
        runs = {IN_C: partial(Call(in_a_row), *loop_arguments(stepper, count)), **runs}
        for name, run in runs.items():
            run()
            yield Point(STEPPED, 1, name, _seconds(run, 3 * REPEATS) / count * 1e6, "us a step")


def _cold_start(repeats: int) -> Iterator[Point]:
    """Measure the rotary crane in processes of their own, with and without a compiler: the smallest of several.

    The first process writes the bytecode that an installation has, and is not counted.
    """
    with tempfile.TemporaryDirectory() as folder:
        kept = {name: value for name, value in os.environ.items() if name != "PYTHONDONTWRITEBYTECODE"}
        env = {**kept, "PYTHONPYCACHEPREFIX": folder}
        machines = {"": env, WITHOUT: {**env, "CC": "", "PATH": ""}}
        runs: dict[str, list[list[float]]] = {words: [] for words in machines}
        for _ in range(1 + repeats):
            for words, environment in machines.items():
                done = subprocess.run([sys.executable, "-c", _START], capture_output=True, text=True, check=True,
                                      env=environment)  # fmt: skip
                runs[words].append([float(each) for each in done.stdout.split()])
    for words, found in runs.items():
        for name, values in zip((*STAGES, BENEATH), zip(*found[1:], strict=True), strict=True):
            yield Point(COLD, 1, name + words, min(values), "s")


def write_points(folder: Path, points: Sequence[Point]) -> None:
    """Write the file."""
    with (folder / FILE).open("w", newline="") as stream:
        writer = csv.writer(stream, lineterminator="\n")
        writer.writerow(COLUMNS)
        for each in points:
            writer.writerow((each.what, each.size, each.quantity, f"{each.value:.4g}", each.unit))


def read_points(folder: Path) -> list[Point]:
    """Undo `write_points`."""
    with (folder / FILE).open(newline="") as stream:
        return [
            Point(line["what"], int(line["size"]), line["quantity"], float(line["value"]), line["unit"])
            for line in csv.DictReader(stream)
        ]


def exponent(points: Sequence[Point]) -> float | None:
    """Return the slope of values over sizes in logarithms, from four cranes on; None for fewer than two."""
    kept = [each for each in points if each.size >= _FROM]
    if len(kept) < 2:
        return None
    return float(np.polyfit(np.log([each.size for each in kept]), np.log([each.value for each in kept]), 1)[0])


def _value(points: Sequence[Point], what: str, size: int, quantity: str) -> float | None:
    return next(
        (each.value for each in points if (each.what, each.size, each.quantity) == (what, size, quantity)), None
    )


def wanted(points: Sequence[Point]) -> list[tuple[str, str, str, str]]:
    """Judge what must hold of sizes: (what, wanted, measured, met)."""
    limits: list[tuple[str, str, float | None, float]] = [
        (f"{CRANE}, {size}: {quantity}", unit, _value(points, CRANE, size, quantity), most)
        for size in CRANES
        for quantity, unit, most in (("ExactInversion, interpreted", "us an instant", 1.5 * size),)
    ]
    limits += [(f"{CRANE}, {size}: analyse", "s", _value(points, CRANE, size, "analyse"), most)
               for size, most in ((40, 1.0), (160, 5.0))]  # fmt: skip
    limits.append((f"{MANY}: ExactInversion, machine code", "us an instant",
                   _value(points, MANY, 1, "ExactInversion, machine code"), 0.15))  # fmt: skip
    limits.append(
        (f"{MANY}: solve, machine code", "us an instant", _value(points, MANY, 1, "solve, machine code"), 0.6)
    )
    limits += [(f"{COLD}: {name}{words}", "s", _value(points, COLD, 1, name + words), most)
               for words in ("", WITHOUT) for name, most in STAGES.items()]  # fmt: skip
    for name in ("solve", "projected backward Euler"):
        slope = exponent(_row(points, CRANE, f"{name}, {STEPS} steps"))
        limits.append((f"{CRANE}: {name}, {STEPS} steps", "as exponent", slope, LINEAR))
    for what, quantity in calls.judged():
        value = max((each.value for each in _row(points, what, quantity)), default=None)
        limits.append((f"{what}: {quantity}", "us, whatever the steps", value, calls.MOST))
    in_c = _value(points, STEPPED, 1, IN_C)
    for name in (WITHOUT_CHECKS, CHECKED):
        value = _value(points, STEPPED, 1, name)
        if value is not None and in_c is not None:
            limits.append((f"{STEPPED}: {name}, beside {IN_C}", "times", value / in_c, STEPS_OF_C))
    verdicts = {True: "yes", False: "**no**"}
    return [
        (what, f"at most {most:g} {unit}", f"{value:.3g}", verdicts[value <= most])
        for what, unit, value, most in limits
        if value is not None
    ]


def _row(points: Sequence[Point], what: str, quantity: str) -> list[Point]:
    return [each for each in points if (each.what, each.quantity) == (what, quantity)]


_TOGETHER = "some checks between instants treat all cranes together"
REASONS = {
    f"{CRANE}, 1: ExactInversion": "the overhead of a call is a tenth of a millisecond",
    f"{CRANE}: solve": _TOGETHER,
    f"{CRANE}: projected": _TOGETHER,
    f"{MANY}: solve": "inputs, motion and violations take a third, what belongs to the result (angles, noise, one"
    " branch) a third, and the checks that `checks=False` omits (limits, ranks, peaks between instants) a third",
    f"{STEPPED}: {WITHOUT_CHECKS}": "evaluating the path, the outputs of each state (inputs, coordinates, violations),"
    " noise and angles takes longer than the steps themselves",
    f"{STEPPED}: {CHECKED}": "the checks compare all inputs with the exact inversion, at the instants and between them,"
    " examine limits, poles and lost ranks: more than the steps themselves",
    f"{COLD}: import": "NumPy and CasADi take the time that scale.csv has, some hundred modules the rest",
}
"""Why a row may miss what is wanted, by how it begins; the page lists those of rows that do."""


def missed(points: Sequence[Point]) -> list[tuple[str, str]]:
    """Return the rows that miss what is wanted, each with its reason."""
    names = [what for what, _, _, met in wanted(points) if met != "yes"]
    return [
        (name, next((why for start, why in REASONS.items() if name.startswith(start)), NO_REASON)) for name in names
    ]


def scale_page(points: Sequence[Point]) -> str:
    """Write the page of sizes: the requirements that are missed, and tables of cranes and chains."""
    parts = ["# Cost against size", (__doc__ or "").partition("\n\n")[2].strip()]
    parts.append(
        "[scale.csv](scale.csv) has all measurements: cranes, chains, `march_bar`, 10,000 instants at once, calls of"
        " `DynamicInversion`, backward Euler beside its step in C, and a cold start with and without a compiler."
    )
    verdicts = [met for *_, met in wanted(points)]
    head = f"{verdicts.count('yes')} of {len(verdicts)} requirements are met."
    parts.append(f"{head} Missed:" if missed(points) else head)
    if missed(points):
        parts.append("\n".join(f"* {name}: {reason}." for name, reason in missed(points)))
    parts += [_table(points, what) for what in (CRANE, CHAIN)]
    return "\n\n".join(each.rstrip("\n") for each in parts) + "\n"


def _table(points: Sequence[Point], what: str) -> str:
    """Show what grows with size, with exponents; columns are sizes."""
    own = [each for each in points if each.what == what]
    sizes = list(dict.fromkeys(each.size for each in own))
    lines = []
    for quantity in dict.fromkeys(each.quantity for each in own):
        row = [each for each in own if each.quantity == quantity]
        known = {each.size: f"{each.value:.3g}" for each in row}
        slope = exponent(row)
        lines.append((f"{quantity}, {row[0].unit}", *(known.get(size, "-") for size in sizes),
                      "-" if slope is None else f"{slope:.2f}"))  # fmt: skip
    return markdown((what, *map(str, sizes), "exponent"), lines, 9)
