"""Chebyshev models against ball arithmetic of 200 bits: no value of an operation lies outside its enclosure."""

from __future__ import annotations

from collections.abc import Callable
from functools import reduce
from types import SimpleNamespace

import casadi as ca
import numpy as np
import pytest
from flint import arb, ctx

from servocore.certificate import programs
from servocore.certificate.chebyshev import Arithmetic, Model, arithmetic, model_of
from servocore.certificate.equations import _without_steps
from servocore.certificate.walk import walk_of
from servocore.numerics.compiled_calls import Array
from servocore.numerics.machine_code import built

DEGREES = [(10,), (6, 2), (0,), (3, 2, 1)]
Exact = Callable[..., arb]


@pytest.fixture(autouse=True)
def _precision() -> object:
    kept, ctx.prec = ctx.prec, 200
    yield
    ctx.prec = kept


def exact_value(ring: Arithmetic, c: Array, point: Array) -> arb:
    each = [[arb(x).chebyshev_t(k) for k in range(d + 1)] for x, d in zip(point.tolist(), ring.degrees, strict=True)]
    basis = reduce(lambda a, b: [x * y for x in a for y in b], each)
    return sum((arb(k) * t for k, t in zip(c.tolist(), basis, strict=True)), arb(0))


def random_model(rng: np.random.Generator, ring: Arithmetic, count: int, positive: bool = False) -> Model:
    """Models of any smoothness and size; positive ones vary by less than their middle."""
    terms = len(ring.nodes)
    decay = 10.0 ** rng.uniform(-3.0, -0.2, count)
    orders = np.indices([d + 1 for d in ring.degrees]).reshape(len(ring.degrees), -1).sum(axis=0)
    size = 10.0 ** rng.uniform(-3.0, 3.0, count)
    c = rng.normal(size=(terms, count)) * decay ** orders[:, None]
    if positive:
        c[0] = np.abs(c[1:]).sum(axis=0) * rng.uniform(1.05, 3.0, count) + rng.uniform(0.1, 1.0, count)
    else:
        size = np.minimum(size, 5.0)  # arguments of exp, and turns of angles, stay moderate
    r = size * rng.choice([0.0, 1e-12, 1e-6], count)
    return model_of((c * size)[:, :, None], r[:, None])


OPERATIONS: dict[str, tuple[int, bool, Callable[..., Model], Exact]] = {
    "sum": (2, False, lambda _, a, b: programs.summed(a, b), lambda a, b: a + b),
    "difference": (2, False, lambda _, a, b: programs.summed(a, b, -1.0), lambda a, b: a - b),
    "product": (2, False, lambda ring, a, b: ring.product(a, b), lambda a, b: a * b),
    "inverse": (1, True, lambda ring, a: ring.inverse(a), lambda a: 1 / a),
    "root": (1, True, lambda ring, a: ring.root(a), lambda a: a.sqrt()),
    "sine": (1, False, lambda ring, a: ring.sine_and_cosine(a)[0], lambda a: a.sin()),
    "cosine": (1, False, lambda ring, a: ring.sine_and_cosine(a)[1], lambda a: a.cos()),
    "exponential": (1, False, lambda ring, a: ring.exponential(a), lambda a: a.exp()),
    "logarithm": (1, True, lambda ring, a: ring.logarithm(a), lambda a: a.log()),
    "hyperbolic tangent": (1, False, lambda ring, a: ring.hyperbolic_tangent(a), lambda a: a.tanh()),
    "angle": (2, True, lambda ring, a, b: ring.angle(a, b), arb.atan2),
    "first half": (1, False, lambda ring, a: ring.halved(a, 0)[0], lambda a: a),
}


MANY = 100_000 // (len(OPERATIONS) * len(DEGREES)) + 1


def require_inside(name: str, degrees: tuple[int, ...], count: int, seed: int) -> None:
    """Functions within their models, at random points: the exact result is within the radius of the polynomial."""
    rng, ring = np.random.default_rng(seed), arithmetic(degrees)
    arguments, positive, operation, exact = OPERATIONS[name]
    models = [random_model(rng, ring, count, positive) for _ in range(arguments)]
    result = operation(ring, *models)
    c, r = result[:-1], result[-1]
    assert np.isfinite(r).mean() > 0.9
    for k in range(count):
        point = rng.uniform(-1.0, 1.0, len(degrees)) if k % 4 else rng.choice([-1.0, 1.0], len(degrees))
        before = point.copy()
        if name == "first half":
            before[0] = (point[0] - 1.0) / 2.0
        shifts = rng.choice([-1.0, 1.0], len(models)).tolist()
        values = [
            exact_value(ring, a[:-1, k, 0], before) + arb(float(a[-1, k, 0])) * arb(s)
            for a, s in zip(models, shifts, strict=True)
        ]
        off = abs(exact(*values) - exact_value(ring, c[:, k, 0], point))
        assert not off > arb(float(r[k, 0])), (name, k, off, r[k, 0])


@pytest.mark.parametrize("count", [12, pytest.param(MANY, marks=pytest.mark.nightly)])
@pytest.mark.parametrize("degrees", DEGREES, ids=str)
@pytest.mark.parametrize("name", OPERATIONS)
def test_no_result_lies_outside_its_model(name: str, degrees: tuple[int, ...], count: int) -> None:
    require_inside(name, degrees, count, count)


@pytest.mark.parametrize("degrees", DEGREES, ids=str)
def test_spans_hold_all_values(degrees: tuple[int, ...]) -> None:
    rng, ring = np.random.default_rng(3), arithmetic(degrees)
    a = random_model(rng, ring, 200)
    (low, high), c, r = ring.span(a), a[:-1], a[-1]
    values = np.einsum("nt,tk->nk", ring.rows(rng.uniform(-1.0, 1.0, (500, len(degrees)))), c[:, :, 0])
    assert (values + r[:, 0] <= high[:, 0] + 1e-12).all()
    assert (values - r[:, 0] >= low[:, 0] - 1e-12).all()
    widths = np.ptp(values, axis=0) + 2.0 * r[:, 0]
    assert np.median((high - low)[:, 0] / np.maximum(widths, 1e-300)) < 2.5 if any(degrees) else True


@pytest.mark.parametrize("degrees", DEGREES, ids=str)
def test_machine_code_and_numpy_carry_out_alike(degrees: tuple[int, ...], monkeypatch: pytest.MonkeyPatch) -> None:
    rng, terms, places = np.random.default_rng(4), len(arithmetic(degrees).nodes), 9
    steps = [(int(rng.integers(3)), 4 + k, *rng.integers(0, 4 + k, 2).tolist()) for k in range(places - 4)]
    program = programs.Program(steps, {6, 8})
    models = np.zeros((terms + 1, places, 37))
    models[:, :4] = np.abs(rng.normal(size=(terms + 1, 4, 37)))
    code = programs.machine_code()
    build = code._make()
    assert build is not None
    native, plain = models.copy(), models.copy()
    for run, results in ((code._load(built(build)), native), (None, plain)):
        monkeypatch.setattr(programs, "machine_code", lambda run=run: SimpleNamespace(best=lambda _: run))
        program(arithmetic(degrees), results)
    np.testing.assert_allclose(native[:, [6, 8]], plain[:, [6, 8]], rtol=1e-12, atol=1e-12)
    assert (native[:, [5, 7]] == 0.0).all()


X = ca.SX.sym("x")


def line() -> Model:
    a = np.zeros((12, 1, 1))
    a[1] = 1.0
    return a


EXPRESSIONS: dict[str, tuple[Callable[[ca.SX], ca.SX], Exact]] = {
    "tanh": (ca.tanh, lambda x: x.tanh()),
    "asin": (ca.asin, lambda x: x.asin()),
    "acos": (ca.acos, lambda x: x.acos()),
    "atan": (ca.atan, lambda x: x.atan()),
    "cosh": (ca.cosh, lambda x: x.cosh()),
    "tan": (ca.tan, lambda x: x.tan()),
    "power": (lambda x: (2 + x) ** 3.5, lambda x: (2 + x) ** arb(3.5)),
    "whole power": (lambda x: (2 + x) ** -3, lambda x: (2 + x) ** -3),
    "absolute value": (lambda x: ca.fabs(x - 2), lambda x: abs(x - 2)),
    "larger": (lambda x: ca.fmax(x, 3), lambda x: arb(3) + 0 * x),
    "choice": (lambda x: ca.if_else(x < 2, x, 5), lambda x: x),
    "number": (lambda x: x / 3 + ca.sin(ca.SX(0.1)) * x, lambda x: x / 3 + arb(0.1).sin() * x),
    "sign": (lambda x: ca.sign(x - 2) + ca.floor(x / 10 + 0.5), lambda x: 0 * x - 1),
}


@pytest.mark.parametrize("name", EXPRESSIONS)
def test_expressions_are_enclosed_by_the_operations_they_consist_of(name: str) -> None:
    written, exact = EXPRESSIONS[name]
    ring, x = arithmetic((10,)), ca.SX.sym("x")
    a = np.zeros((12, 1, 1))
    a[:3, 0, 0] = 0.1, 0.4, 0.05
    found = walk_of(written(x), x)(ring, a)[:, 0, 0]
    assert found[-1] < 1e-4
    for point in np.linspace(-1.0, 1.0, 21):
        value = exact(exact_value(ring, a[:-1, 0, 0], np.array([point])))
        assert not abs(value - exact_value(ring, found[:-1], np.array([point]))) > arb(float(found[-1]))


@pytest.mark.parametrize("written", [lambda x: 1 / x, ca.log, lambda x: ca.fmod(x, 2.0)])
def test_nothing_bounds_a_pole_inside(written: Callable[[ca.SX], ca.SX]) -> None:
    assert np.isinf(walk_of(written(X), X)(arithmetic((10,)), line())[-1]).all()


@pytest.mark.parametrize("written", [ca.fabs, ca.sign, lambda x: ca.if_else(x > 0, x + 1, 2), lambda x: ca.fmax(x, 0.1),
                                     lambda x: ca.floor(3 * x), lambda x: ca.logic_or(x > 0.5, x < 0)])  # fmt: skip
def test_jumps_and_kinks_are_enclosed_with_all_values(written: Callable[[ca.SX], ca.SX]) -> None:
    ring, x = arithmetic((10,)), np.linspace(-1.0, 1.0, 101)
    found = walk_of(written(X), X)(ring, line())
    c, r = found[:-1], found[-1]
    values = np.array([float(ca.Function("f", [X], [written(X)])(each)) for each in x])
    assert np.isfinite(r).all()
    assert (np.abs(ring.rows(x[:, None]) @ c[:, 0, 0] - values) <= r[0, 0]).all()


@pytest.mark.parametrize("written", [
    lambda x: ca.gradient(ca.fmax(x, 0.3) ** 2, x), lambda x: x / (2 + ca.sign(x)), lambda x: ca.fmin(x, ca.floor(x)),
    lambda x: (x <= 0) / ((x <= 0) + (x <= 0.5) + 1), lambda x: ca.if_else(x > 0.2, ca.if_else(x < 0.4, x, 1), 2),
])  # fmt: skip
def test_named_steps_are_those_of_the_expression(written: Callable[[ca.SX], ca.SX]) -> None:
    smooth, names, steps = _without_steps(written(X))
    (again,) = ca.substitute([smooth], [names], [steps])
    found = ca.Function("f", [X], [written(X), again])
    assert names.numel() > 0
    for point in np.linspace(-1.0, 1.0, 40).tolist():
        value, same = (float(each) for each in found(point))
        assert same == pytest.approx(value, abs=1e-15)
