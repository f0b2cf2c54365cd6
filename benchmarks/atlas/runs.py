"""How rows run the library: errors of inputs, marches with disturbed states, and slopes."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
import numpy.typing as npt

import servocore as sc
from servocore.numerics.compiled_calls import Call, side_by_side
from servocore.stepping.program import Program

Array = npt.NDArray[np.float64]


def quietly(scene: sc.Scene, *arguments: object, **settings: object) -> sc.Solution:
    """Solve without the warnings that the library gives: the atlas does what they warn of on purpose."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", sc.ServocoreWarning)
        return sc.solve(scene, *arguments, **settings)  # type: ignore[arg-type]  # passed on as they are


def relative_error(scene: sc.Scene, solution: sc.Solution, skip: int = 0, model: str | None = None) -> float:
    """Largest error of any input relative to its peak, `skip` instants at the start left out."""
    exact = scene.exact(solution.t)
    names = [each.name for each in scene.model(model).inputs]
    return max(float(np.abs(solution[name] - exact[name])[skip:].max() / np.abs(exact[name]).max()) for name in names)


def error_at(
    scene: sc.Scene, formulation: sc.Formulation, method: sc.Method, steps: int, *, skip: int = 0,
    model: str | None = None, checks: bool = True,
) -> float:  # fmt: skip
    """Largest relative error of the inputs of a run; infinity if it failed."""
    step = scene.reference.duration / steps
    try:
        solution = quietly(scene, formulation, method, step=step, model=model, checks=checks)
    except sc.IntegrationFailed:
        return float("inf")
    return relative_error(scene, solution, skip, model)


def amplified(errors: Array) -> npt.NDArray[np.intp]:
    """Return where errors, in the order of falling steps, have risen well above their least: amplified round-off."""
    best = int(errors.argmin())
    return np.flatnonzero((np.arange(len(errors)) > best) & (errors > 2.5 * errors[best]) & np.isfinite(errors))


def slope(x: npt.ArrayLike, y: npt.ArrayLike) -> float:
    """Exponent of the power law that fits y(x) best in logarithms."""
    return float(np.polyfit(np.log(x), np.log(y), 1)[0])


@dataclass(frozen=True, eq=False)
class March:
    """Values observed along a march, shape (steps + 1, channels), by name."""

    t: Array
    values: Array
    names: tuple[str, ...]

    def __getitem__(self, name: str) -> Array:
        column: Array = self.values[:, self.names.index(name)]
        return column


def begin(stepper: sc.Stepper) -> Array:
    """Return the consistent first state of a stepper."""
    reference = stepper.scene.reference
    instants = reference.start_time + stepper.step * np.array(stepper.start_instants)
    return stepper.start(reference.jet(instants, stepper.start_order))[0]


def march(stepper: sc.Stepper, steps: int, disturb: Callable[[Array], Array] | None = None) -> March:
    """Step from the start of the reference, from a first state that `disturb` may change."""
    state = begin(stepper)
    if disturb is not None:
        state = disturb(state)
    program, h = stepper.program, stepper.step
    t = stepper.scene.reference.start_time + h * np.arange(steps + 1, dtype=np.float64)
    jets = stepper.scene.reference.jet(t, program.start_order)
    rows = [program.values(state, jets[0], stepper.parameters)]
    for k in range(steps):
        nodes = stepper.scene.reference.jet(t[k] + h * np.array(program.nodes), program.order)
        state, _ = program.advance(state, nodes, h, stepper.parameters)
        rows.append(program.values(state, jets[k + 1], stepper.parameters))
    return March(t, np.array(rows), tuple(each.name for each in program.channels))


def disturbed(
    stepper: sc.Stepper, form: sc.Formulation, variable: str, order: int, delta: float
) -> Callable[[Array], Array]:
    """Return what adds `delta` to one unknown, q (order 0) or its velocity (order 1), of a first state."""
    unknowns = [(each.variable, each.order) for each in form.dae(stepper.system).unknowns]
    place = unknowns.index((variable, order))
    if isinstance(stepper.method, sc.GeneralizedAlpha):  # positions, then velocities
        kind = [each for each in unknowns[: 2 * len(stepper.system.coordinates)] if each[1] == order]
        place = kind.index((variable, order)) + order * len(kind)

    def change(state: Array) -> Array:
        changed = state.copy()
        changed[place] += delta
        return changed

    return change


@dataclass(frozen=True, eq=False)
class Chunk:
    """A stretch of a long run: times, observed values (channels, steps) and violations (4, steps)."""

    t: Array
    values: Array
    violations: Array


def long_march(stepper: sc.Stepper, steps: int, chunk: int) -> Iterator[Chunk]:
    """March in compiled chunks and forget them: the memory of a run of any length is that of one chunk."""
    program, h, p = stepper.program, stepper.step, stepper.parameters
    loop, observe = _compiled(program, chunk)
    parameters = np.tile(p[:, None], chunk)
    state, begun = begin(stepper), stepper.scene.reference.start_time
    for done in range(0, steps, chunk):
        t = begun + h * np.arange(done + 1, done + chunk + 1, dtype=np.float64)
        nodes = [stepper.scene.reference.jet(t - (1.0 - c) * h, program.order) for c in program.nodes]
        states, _, worst = loop(state, side_by_side(np.concatenate(nodes, axis=1)), np.full((1, chunk), h), parameters)
        if not (np.isfinite(states).all() and np.isfinite(worst).all()):
            raise sc.IntegrationFailed(f"{program.name}: a step after t = {t[0]:.6g} s was not solved")
        state = states[:, -1].copy()
        jets = stepper.scene.reference.jet(t, program.start_order)
        values, violations = observe(states, side_by_side(jets), parameters)
        yield Chunk(t, values, violations)


@lru_cache(maxsize=32)
def _compiled(program: Program, chunk: int) -> tuple[Call, Call]:
    return Call(program.step.mapaccum("sc_atlas", chunk)), Call(program.observe.map(chunk))
