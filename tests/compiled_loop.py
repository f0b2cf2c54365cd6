"""The loop that `loops` closes through FMUs, as machine code: the same law, plant and masters, ten times faster."""

from __future__ import annotations

import subprocess
import tempfile
from functools import cache
from pathlib import Path

import casadi as ca
import numpy as np
from loops import CRANE, STEPS, Case, jets_at

import servocore as sc
from crane_fmu.build.feedback_law import SIZES, feedback_functions
from crane_fmu.build.flatness import continued, flat_motion

_SYSTEM = CRANE.model("generalized")
_PLANT_STEP = 0.005  # of the Runge-Kutta method, in s
_MEMORY, _STATE, _INPUTS, _JET = sum(SIZES.values()), 10, 3, 15
_BLOCK = 100  # of steps in one call: a call for each length of manoeuvres would take longer to make than to run
_PARAMETERS = {"p": 6, "mass_error": 1, "share": 1, "h": 1}


def compiled_deviation(case: Case, h: float, at: str = "start", share: float = 1.0) -> float:
    """Largest distance in mm of the load from its path, also a second after it; infinite where the rope goes slack.

    A gust begins and ends at communication points.
    """
    return compiled_deviation_over(case, np.full(round((case.reference.duration + 1.0) / h), h), h, at, share)


def compiled_deviation_over(
    case: Case, steps: np.ndarray, longest: float, at: str = "start", share: float = 1.0
) -> float:
    """`compiled_deviation` where steps vary; the longest of `STEPS` that they may have decides on the plant's."""
    count, even = len(steps), bool((steps == longest).all())
    t = longest * np.arange(count + 1) if even else np.concatenate([[0.0], np.cumsum(steps)])
    jets = jets_at(case.reference, case.reference.start_time + t).reshape(-1, _JET)
    values = CRANE.parameter_values() | case.crane
    p = np.array([values[name] for name in CRANE.model().parameters.names])
    functions = _compiled(at)
    inputs = np.array(functions["flat"](jets[0], p)[1]).ravel()
    x, y, z = jets[0, :3]
    state = np.array([np.arctan2(y, x), np.hypot(x, y), -z, *[0.0] * 7])
    memory = np.array(functions[f"begin_{at}"](jets[0], _seen()(state, p), p, steps[0])).ravel()
    loop = np.concatenate([memory, state, inputs, inputs, steps[:1]])
    fixed = [*p, case.disturbance.get("mass_error", 0.0), share]
    more = -count % _BLOCK  # at rest, for the last block
    rows_told = jets[:-1], jets[1:], _forces(case, t[:-1]).T, np.column_stack([np.tile(fixed, (count, 1)), steps])
    told = [np.pad(each, [(0, more), (0, 0)], mode="edge").T for each in rows_told]
    run, rows = _block(at, _parts(longest)), []
    for k in range(0, count + more, _BLOCK):
        after, poses = run(loop, *(each[:, k : k + _BLOCK] for each in told))
        loop = np.array(after[:, -1]).ravel()
        rows.append(np.array(poses))
    found = np.hstack(rows)[:, :count]
    if not (np.isfinite(found).all() and found[3].min() > 0.0):
        return float("inf")
    return 1e3 * float(np.linalg.norm(found[:3].T - jets[1:, :3], axis=1).max())


def _forces(case: Case, instants: np.ndarray) -> np.ndarray:
    told, t = case.disturbance, instants + 1e-9
    begin = told.get("gust_start", 0.0)
    blows = (begin <= t) & (t < begin + told.get("gust_duration", 0.0))
    return np.stack([told.get(f"wind[{k}]", 0.0) + blows * told.get(f"gust[{k}]", 0.0) for k in (1, 2, 3)])


@cache
def _plant() -> sc.Plant:
    return sc.compile_plant(_SYSTEM)


def _ahead() -> ca.Function:
    """Return (jet, h) -> the jet of its Taylor polynomial h later."""
    jet, h = ca.SX.sym("jet", _JET), ca.SX.sym("h")
    return ca.Function("ahead", [jet, h], [continued(jet, ca.SX.zeros(3), h)])


@cache
def _seen() -> ca.Function:
    """Return (state, p) -> what is measured."""
    x, p = ca.MX.sym("x", _STATE), ca.MX.sym("p", len(CRANE.model().parameters))
    plant = _plant()
    names = [each.name for each in plant.channels]
    values = plant.observe(x, ca.MX.zeros(_INPUTS), ca.MX.zeros(3), p)
    load = [values[names.index(f"{axis}{dot}")] for dot in ("", "_dot") for axis in "xyz"]
    return ca.Function("seen", [x, p], [ca.vertcat(x[:3], x[5:8], *load)])


def _parts(h: float) -> int:
    """Into how many steps the plant divides a communication step."""
    return max(2, round(h / _PLANT_STEP))


@cache
def _compiled(at: str) -> dict[str, ca.Function]:
    """Return one step of the whole loop and what begins it, as machine code."""
    law = feedback_functions(CRANE.model("points"))
    cycles = (_cycle(law[f"feedback_{at}"], at, parts) for parts in sorted({_parts(h) for h in STEPS}))
    functions = [*cycles, law[f"begin_{at}"], flat_motion()]
    generator = ca.CodeGenerator("loop.c")
    for each in functions:
        generator.add(each)
    folder = Path(tempfile.mkdtemp(prefix="loop "))
    source, library = folder / "loop.c", folder / "loop.so"
    source.write_text(generator.dump())
    options = ["-O2", "-fPIC", "-shared", "-ffp-contract=off"]
    subprocess.run([*sc.c_compiler(), *options, str(source), "-o", str(library), "-lm"], check=True)
    return {each.name(): ca.external(each.name(), str(library)) for each in functions}


@cache
def _block(at: str, parts: int) -> ca.Function:
    return _compiled(at)[f"cycle_{parts}"].mapaccum(_BLOCK)


def _cycle(law: ca.Function, at: str, parts: int) -> ca.Function:
    """Return (loop, jet, next jet, force, fixed) -> (loop a step later, the load's place and the rope's tension)."""
    loop = ca.MX.sym("loop", _MEMORY + _STATE + 2 * _INPUTS + 1)
    jet, following, force = ca.MX.sym("jet", _JET), ca.MX.sym("next", _JET), ca.MX.sym("d", 3)
    fixed = ca.MX.sym("fixed", sum(_PARAMETERS.values()))
    p, error, share, h = ca.vertsplit(fixed, np.cumsum([0, *_PARAMETERS.values()]).tolist())
    ends = np.cumsum([0, _MEMORY, _STATE, _INPUTS, _INPUTS, 1]).tolist()
    memory, x, u, before, last = ca.vertsplit(loop, ends)
    flat, plant = flat_motion(), _plant()
    true_p = ca.vertcat(p[:2], p[2] * (1.0 + error), p[3:])
    told, forward = (following, following) if at == "end" else (jet, _ahead()(jet, h))
    given = _seen()(x, true_p)
    limits = ca.DM([1e9] * _INPUTS)
    memory, new = law(memory, told, jet, given, u, flat(forward, p)[1], p, h, share, limits)
    slope = (new - u) / h if at == "end" else (u - before) / last
    for k in range(parts):
        x = plant.step(x, u + slope * (k * h / parts), slope, force, true_p, h / parts)
    names = [each.name for each in plant.channels]
    values = plant.observe(x, u + slope * h, force, true_p)
    place, acceleration = (ca.vertcat(*(values[names.index(axis + dots)] for axis in "xyz")) for dots in ("", "_ddot"))
    trolley = ca.vertcat(x[1] * ca.cos(x[0]), x[1] * ca.sin(x[0]), 0)
    pull = true_p[2] * (acceleration + ca.vertcat(0, 0, true_p[5])) - force
    tension = ca.dot(pull, trolley - place) / x[2]
    after = ca.densify(ca.vertcat(memory, x, new, u, h))
    return ca.Function(f"cycle_{parts}", [loop, jet, following, force, fixed], [after, ca.vertcat(place, tension)])
