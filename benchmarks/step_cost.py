"""What one step costs: `make bench`, or `python benchmarks/step_cost.py [steps]`.

For every model of the rotary crane, projected and reduced equations, backward Euler:

* `blocks`: sizes of the diagonal blocks of the step's Jacobian, so many times;
* `Newton`: unknowns that are left to Newton's method, block by block, after tearing;
* `undivided`: the same equations as one block of `fast_newton`, without block triangular form and tearing (the
  reduced equations have no step: nothing to compare with);
* `step`: the library's step function in a bare `mapaccum`;
* `solve`: everything, reference, limits, step and observation, with the compiled functions in the cache;
* `error`: largest error of the inputs against the closed form, of the largest value.

Times are the smallest of several interleaved runs, in microseconds a step. Trust the ratios: machines are busy.
"""

from __future__ import annotations

import sys
import time
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import casadi as ca
import numpy as np
from rich.console import Console
from rich.table import Table

import servocore as sc
from servocore import Discretization
from servocore.numerics.newton import MAX_ITERATIONS, NEWTON_TOLERANCE

REPEATS = 15
SCENE = sc.scenes.rotary_crane()
FORMULATIONS: tuple[sc.Formulation, ...] = (sc.Projected(), sc.Reduced())
METHOD = sc.BackwardEuler()


@dataclass(frozen=True)
class Row:
    """Sizes, microseconds a step, and error, for one model and formulation."""

    model: str
    formulation: str
    unknowns: int
    blocks: str
    newton: str
    microseconds: dict[str, float]
    error: float


def measure(model: str, formulation: sc.Formulation, count: int) -> Row:
    """Sizes and times of one problem; its runs are taken in turn, so that disturbances meet them alike."""
    step = SCENE.reference.duration / count
    stepper = sc.Stepper(SCENE, formulation, METHOD, step, model)
    dae = formulation.dae(SCENE.model(model))
    arguments = loop_arguments(stepper, count)
    loops = {"step": stepper.program.step.mapaccum(count)}
    residual, unknowns = dae.h, dae.z
    if dae.x.numel():
        discretization = METHOD.discretize(dae)
        residual, unknowns = discretization.equations.residual, discretization.equations.unknowns
        loops["undivided"] = undivided_step(discretization).mapaccum(count)
        require_agreement(*[np.asarray(loop(*arguments)[0]) for loop in loops.values()])
    runs: dict[str, Callable[[], object]] = {name: partial(loop, *arguments) for name, loop in loops.items()}
    runs["solve"] = partial(sc.solve, SCENE, formulation, METHOD, step=step, model=model)
    return Row(
        model,
        formulation.name,
        unknowns.numel(),
        block_sizes(residual, unknowns),
        newton_sizes(stepper.program.step),
        {name: 1e6 * seconds / count for name, seconds in fastest(runs).items()},
        input_error(sc.solve(SCENE, formulation, METHOD, step=step, model=model)),
    )


def require_agreement(states: np.ndarray, others: np.ndarray) -> None:
    """Stop if two ways to solve the same steps give different states."""
    worst = np.max(np.abs(states - others) / np.maximum(1.0, np.abs(states)))
    if not worst < 1e-6:
        raise SystemExit(f"the undivided step differs by {worst:.1e}")


def input_error(solution: sc.Solution) -> float:
    """Largest error of any input, as a fraction of that input's largest value."""
    exact = SCENE.exact(solution.t)
    inputs = [each.name for each in SCENE.model().inputs]
    return float(max(np.abs(solution[k] - exact[k]).max() / np.abs(exact[k]).max() for k in inputs))


def fastest(runs: dict[str, Callable[[], object]]) -> dict[str, float]:
    """Smallest time of each run in s, after one to warm up."""
    best = dict.fromkeys(runs, float("inf"))
    for repeat in range(REPEATS + 1):
        for name, run in runs.items():
            begin = time.perf_counter()
            run()
            if repeat:
                best[name] = min(best[name], time.perf_counter() - begin)
    return best


def loop_arguments(stepper: sc.Stepper, count: int) -> tuple[np.ndarray, ...]:
    """State, reference columns, steps and parameters of a run over the whole reference."""
    reference, program = SCENE.reference, stepper.program
    t = np.linspace(reference.start_time, reference.end_time, count + 1)
    state, _ = stepper.start(reference.jet(t[0], stepper.start_order))
    gamma = reference.jet(t[1:], program.order).transpose(2, 0, 1).reshape(reference.dimension, -1)
    return state, gamma, np.full((1, count), stepper.step), np.tile(stepper.parameters[:, None], count)


def undivided_step(step: Discretization) -> ca.Function:
    """Return the step as one Newton iteration over all its unknowns, scaled alike."""
    equations = step.equations
    scaled = ca.SX.sym("scaled", equations.unknowns.numel())
    residual = ca.substitute(equations.residual, equations.unknowns, scaled * equations.unknown_scale)
    root = ca.rootfinder(
        "undivided_newton",
        "fast_newton",
        {"x": scaled, "p": equations.givens, "g": residual / equations.residual_scale},
        {"abstol": 0.0, "abstolStep": NEWTON_TOLERANCE, "max_iter": MAX_ITERATIONS, "error_on_fail": False},
    )
    prepare = ca.Function(
        "prepare", [equations.givens], [equations.guess / equations.unknown_scale, equations.unknown_scale]
    )
    finish = ca.Function("finish", [equations.unknowns, equations.givens], [step.next_state])
    state, h = ca.MX.sym("state", step.state.numel()), ca.MX.sym("h")
    gamma = ca.MX.sym("gamma", *step.reference.shape)
    p = ca.MX.sym("p", equations.givens.numel() - state.numel() - gamma.numel() - 1)
    givens = ca.vertcat(state, ca.vec(gamma), h, p)
    guess, scale = prepare(givens)
    new = finish(root(guess, givens) * scale, givens)
    return ca.Function("undivided_step", [state, gamma, h, p], [new, ca.MX(0)])


def block_sizes(residual: ca.SX, unknowns: ca.SX) -> str:
    """Sizes of the blocks of the Jacobian's block triangular form, such as ``20x1 3x3``."""
    _, _, _, rows, *_ = ca.jacobian_sparsity(residual, unknowns).btf()
    return counted(np.diff(rows).tolist())


def newton_sizes(step: ca.Function) -> str:
    """Unknowns of each Newton iteration within a step function; the clock that counts is not one."""
    inner = [each for each in step.find_functions() if each.class_name() == "FastNewton"]
    return counted([each.size1_out(0) - 1 for each in inner]) or "none"


def counted(sizes: list[int]) -> str:
    """Write ``20x1 3x3`` for twenty ones and three threes."""
    return " ".join(f"{number}x{size}" for size, number in sorted(Counter(sizes).items()))


def main(count: int) -> None:
    """Measure all problems and print one table."""
    rows = [measure(model, each, count) for each in FORMULATIONS for model in SCENE.models]
    first = rows[0].microseconds["step"]
    table = Table(title=f"rotary crane, backward Euler, {count} steps; microseconds a step")
    for heading in ("model", "formulation", "unknowns", "blocks", "Newton"):
        table.add_column(heading)
    for heading in ("undivided", "step", "solve", "solve/step", "step/first", "error"):
        table.add_column(heading, justify="right")
    for row in rows:
        took = row.microseconds
        table.add_row(
            row.model, row.formulation, str(row.unknowns), row.blocks, row.newton,
            *(f"{took[name]:.1f}" if name in took else "-" for name in ("undivided", "step", "solve")),
            f"{took['solve'] / took['step']:.2f}", f"{took['step'] / first:.1f}", f"{row.error:.1e}",
        )  # fmt: skip
    Console(width=150).print(table)


if __name__ == "__main__":
    main(int(sys.argv[1]) if len(sys.argv) > 1 else 2000)
