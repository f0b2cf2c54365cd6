"""What peers share: compiled functions of a form, called without copies, and answers from their trajectories."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Protocol, TypeVar

import casadi as ca
import numpy as np

from benchmarks.chart.candidate import OUTPUT_INTERVALS, Answer, Array, Candidate, Problem, on_output_grid
from benchmarks.chart.forms import DERIVATIVE_ARRAY, INPUTS_AS_DERIVATIVES, Form, make_form

Setting = TypeVar("Setting")

FORMS = (("projected", ""), ("reduced", DERIVATIVE_ARRAY), ("reduced", INPUTS_AS_DERIVATIVES))
"""Formulation and variant of all forms that a peer may get."""


class Peer(Protocol):
    """A module of this package."""

    NAME: str
    DISTRIBUTION: str

    def candidates(self, problem: Problem, effort: Effort) -> list[Candidate]:
        """List what is to be measured; raises ImportError if the peer is not installed."""


class Effort(Protocol):
    """How much is measured."""

    smoke: bool


class Lean:
    """A compiled function whose arguments and results stay in place: what a call costs is the evaluation.

    CasADi evaluates it by its virtual machine, as it does for `servocore`: a few microseconds, less than NumPy code
    by hand would take. CasADi's own conversions of arrays would cost ten times as much.
    """

    def __init__(self, function: ca.Function) -> None:
        buffer, self._evaluate = function.buffer()
        self.arguments: list[Array] = [np.zeros(function.numel_in(k)) for k in range(function.n_in())]
        self.results: list[Array] = [np.zeros(function.size_out(k), order="F") for k in range(function.n_out())]
        for k, each in enumerate(self.arguments):
            if each.size:
                buffer.set_arg(k, each.data)
        for k, each in enumerate(self.results):
            if each.size:
                buffer.set_res(k, each.reshape(-1, order="F").data)
        self._buffer = buffer

    def __call__(self, *arguments: Array | float) -> list[Array]:
        """Evaluate with the first arguments, columns one after the other; the next call overwrites the results."""
        for place, value in zip(self.arguments, arguments, strict=False):
            place[:] = value
        self._evaluate()
        return self.results


def residual_function(form: Form) -> Lean:
    """Compile (t, y, y') -> F, as a column."""
    return Lean(ca.Function("residual", [form.t, form.y, form.yp], [ca.densify(form.residual)], {"cse": True}))


def jacobian_functions(form: Form) -> tuple[Lean, Lean]:
    """Compile (t, y, y') -> dF/dy, dF/dy' and (t, y, y', c) -> dF/dy + c dF/dy', dense."""
    by_y, by_yp = form.jacobians
    c = ca.SX.sym("c")
    arguments = [form.t, form.y, form.yp]
    both = ca.Function("both", arguments, [ca.densify(by_y), ca.densify(by_yp)], {"cse": True})
    sum_ = ca.Function("sum", [*arguments, c], [ca.densify(by_y + c * by_yp)], {"cse": True})
    return Lean(both), Lean(sum_)


def reader(
    form: Form, intervals: int = OUTPUT_INTERVALS
) -> tuple[Callable[[Array, Array, Array], Array], Callable[[Array, Array, Array], Answer]]:
    """Return the function from (t (N,), y (n, N), y' (n, N)) to inputs (m, 201), and the one to an `Answer`.

    The first is part of a solve: the user wants inputs. The second adds the constraint violation. With fewer intervals
    a spline brings the inputs to the output grid.
    """
    arguments = [form.t, form.y, form.yp]
    count = intervals + 1
    outputs = Lean(ca.Function("outputs", arguments, [ca.densify(form.outputs)], {"cse": True}).map(count))
    violation = Lean(ca.Function("violation", arguments, [ca.densify(form.violation)], {"cse": True}).map(count))

    def inputs(t: Array, y: Array, yp: Array) -> Array:
        return on_output_grid(outputs(t, y.ravel(order="F"), yp.ravel(order="F"))[0])

    def answer(t: Array, y: Array, yp: Array) -> Answer:
        found = dict(zip(form.problem.inputs, inputs(t, y, yp).copy(), strict=True))
        return Answer(found, float(np.max(violation(t, y.ravel(order="F"), yp.ravel(order="F"))[0])))

    return inputs, answer


def peer_models(problem: Problem) -> list[str]:
    """Return the models that peers get: of the rotary crane the two of few unknowns, elsewhere the smallest."""
    models = [name for name in problem.scene.models if name != "bodies"]
    return models if problem.scene.name == "rotary_crane" else models[:1]


def available_forms(problem: Problem, model: str, *, plain_path: bool = False) -> list[Form]:
    """Return every form of a model that exists."""
    found = []
    for formulation, variant in FORMS:
        try:
            found.append(make_form(problem, model, formulation, variant, plain_path))
        except ValueError:
            continue
    return found


def named(method: str, form: Form) -> str:
    """Name a method together with the variant of the form it works on."""
    return f"{method}, {form.variant}" if form.variant else method


def inside(values: Sequence[Setting], smoke: bool) -> Sequence[Setting]:
    """Return all settings, or the first two of them for a smoke test."""
    return values[:2] if smoke else values
