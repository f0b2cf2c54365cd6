"""Chebyshev models against ball arithmetic of 200 bits: no value of an operation lies outside its enclosure."""

from __future__ import annotations

from collections.abc import Callable
from functools import reduce
from types import SimpleNamespace

import casadi as ca
import numpy as np
import pytest
from flint import arb, arb_mat, ctx
from present import present

from servocore.certificate import chebyshev
from servocore.certificate.chebyshev import Arithmetic, Model, arithmetic, model_of
from servocore.certificate.equations import _without_steps, block_signs
from servocore.certificate.walk import Walk
from servocore.numerics.compiled_calls import Array

DEGREES = [(10,), (6, 2), (0,), (3, 2, 1)]
Exact = Callable[..., arb]


def exact_value(ring: Arithmetic, c: Array, point: Array) -> arb:
    ctx.prec = 200
    each = [[arb(x).chebyshev_t(k) for k in range(d + 1)] for x, d in zip(point.tolist(), ring.degrees, strict=True)]
    basis = reduce(lambda a, b: [x * y for x in a for y in b], each)
    return sum((arb(k) * t for k, t in zip(c.tolist(), basis, strict=True)), arb(0))


def random_model(rng: np.random.Generator, ring: Arithmetic, count: int, positive: bool = False) -> Model:
    """Models of any smoothness and size; positive ones vary by less than their middle."""
    terms = len(ring.nodes)
    decay = 10.0 ** rng.uniform(-3.0, -0.2, count)
    size = 10.0 ** rng.uniform(-3.0, 3.0, count)
    c = rng.normal(size=(terms, count)) * decay ** ring.orders.sum(axis=0)[:, None]
    if positive:
        c[0] = np.abs(c[1:]).sum(axis=0) * rng.uniform(1.05, 3.0, count) + rng.uniform(0.1, 1.0, count)
    else:
        size = np.minimum(size, 5.0)  # arguments of exp, and turns of angles, stay moderate
    r = size * rng.choice([0.0, 1e-12, 1e-6], count)
    return model_of((c * size)[:, :, None], r[:, None])


OPERATIONS: dict[str, tuple[bool, Callable[..., ca.SX], Exact]] = {
    "sum": (False, lambda a, b: a + b, lambda a, b: a + b),
    "difference": (False, lambda a, b: a - b, lambda a, b: a - b),
    "product": (False, lambda a, b: a * b, lambda a, b: a * b),
    "inverse": (True, lambda a: 1 / a, lambda a: 1 / a),
    "root": (True, ca.sqrt, arb.sqrt),
    "sine": (False, ca.sin, arb.sin),
    "cosine": (False, ca.cos, arb.cos),
    "exponential": (False, ca.exp, arb.exp),
    "logarithm": (True, ca.log, arb.log),
    "hyperbolic tangent": (False, ca.tanh, arb.tanh),
    "angle": (True, ca.atan2, arb.atan2),
    "asin": (True, lambda a: ca.asin(a / (2 + 2 * a)), lambda a: (a / (2 + 2 * a)).asin()),
    "acos": (True, lambda a: ca.acos(a / (2 + 2 * a)), lambda a: (a / (2 + 2 * a)).acos()),
    "atan": (True, ca.atan, arb.atan),
    "cosh": (False, lambda a: a + ca.cosh(a) + ca.sinh(a) * ca.expm1(a), lambda a: a + a.cosh() + a.sinh() * a.expm1()),
    "acosh": (True, lambda a: ca.acosh(2 + a) + ca.asinh(a), lambda a: (2 + a).acosh() + a.asinh()),
    "atanh": (True, lambda a: ca.atanh(a / (1 + 2 * a)) + ca.log1p(a), lambda a: (a / (1 + 2 * a)).atanh() + a.log1p()),
    "tan": (True, lambda a: ca.tan(a / (1 + a)), lambda a: (a / (1 + a)).tan()),
    "power": (True, lambda a: a**3.5, lambda a: a ** arb(3.5)),
    "whole power": (True, lambda a: a**-3, lambda a: a**-3),
    "number": (False, lambda a: a / 3 + ca.sin(ca.SX(0.1)) * a, lambda a: a / 3 + arb(0.1).sin() * a),
    "absolute value": (False, ca.fabs, abs),
    "larger": (False, lambda a: ca.fmax(a, ca.SX(0.1)), lambda a: max(a, arb(0.1))),
    "choice": (False, lambda a: ca.if_else(a < 0.2, a, 5), lambda a: a if a < 0.2 else arb(5)),
    "either": (False, lambda a: ca.logic_or(a > 0.5, a < 0), lambda a: arb(int(a > 0.5 or a < 0))),
    "condition": (False, lambda a: ca.if_else(ca.logic_and(a, 2), a, ca.SX(5)), lambda a: a if a != 0 else arb(5)),
    "logic": (False, lambda a: ca.logic_not(ca.logic_not(a < 0.2)), lambda a: arb(int(a < 0.2))),
    "length": (False, lambda a, b: ca.sqrt(a**2 + 2 * b**2), lambda a, b: (a * a + 2 * b * b).sqrt()),
    "steps": (False, lambda a: ca.sign(a - 2) + ca.floor(3 * a), lambda a: (a - 2).sgn() + (3 * a).floor()),
}
MANY = 100_000 // (len(OPERATIONS) * len(DEGREES)) + 1


@pytest.mark.parametrize("count", [12, pytest.param(MANY, marks=pytest.mark.nightly)])
@pytest.mark.parametrize("degrees", DEGREES, ids=str)
@pytest.mark.parametrize("name", OPERATIONS)
def test_no_result_lies_outside_its_model(name: str, degrees: tuple[int, ...], count: int) -> None:
    """Functions within their models, at random points: the exact result is within the radius of the polynomial."""
    rng, ring = np.random.default_rng(count), arithmetic(degrees)
    positive, written, exact = OPERATIONS[name]
    symbols = ca.SX.sym("a", 2 if name in {"sum", "difference", "product", "angle", "length"} else 1)
    models = [random_model(rng, ring, count, positive) for _ in range(symbols.numel())]
    arguments = np.stack([each[:, :, 0] for each in models], axis=1)  # as many boxes
    result = Walk(written(*ca.vertsplit(symbols)), symbols)(ring, arguments)[:, 0]
    assert np.isfinite(result[-1]).mean() > 0.9
    for k in range(count):
        point = rng.uniform(-1.0, 1.0, len(degrees)) if k % 4 else rng.choice([-1.0, 1.0], len(degrees))
        shifts = rng.choice([-1.0, 1.0], len(models)).tolist()
        values = [
            exact_value(ring, a[:-1, k, 0], point) + arb(float(a[-1, k, 0])) * arb(s)
            for a, s in zip(models, shifts, strict=True)
        ]
        off = abs(exact(*values) - exact_value(ring, result[:-1, k], point))
        assert not off > arb(float(result[-1, k])), (name, k, off, result[-1, k])


UNDEFINED: dict[str, Callable[[ca.SX], ca.SX]] = {
    "root": ca.sqrt, "logarithm": ca.log, "power": lambda a: a**0.5, "asin": lambda a: ca.asin(a + 1),
    "acos": lambda a: ca.acos(a + 1), "acosh": lambda a: ca.acosh(a + 1), "atanh": lambda a: ca.atanh(a + 1),
    "within a bounded function": lambda a: ca.tanh(ca.sqrt(a)), "behind a sign": lambda a: ca.sign(ca.log(a)),
    "operations without a rule": lambda a: ca.erf(a) + ca.fmod(a, 2),
}  # fmt: skip


@pytest.mark.parametrize("degrees", DEGREES[:2], ids=str)
@pytest.mark.parametrize("case", UNDEFINED)
def test_what_has_no_value_somewhere_has_no_bound(case: str, degrees: tuple[int, ...]) -> None:
    ring, a = arithmetic(degrees), ca.SX.sym("a")
    assert np.isinf(Walk(UNDEFINED[case](a), a)(ring, model_of(ring.tried(ring.nodes[:, :1, None])[:-1]))[-1])


@pytest.mark.parametrize("degrees", DEGREES, ids=str)
def test_halves_of_boxes_hold_the_same_functions(degrees: tuple[int, ...]) -> None:
    rng, ring = np.random.default_rng(5), arithmetic(degrees)
    a = random_model(rng, ring, 20)
    for late, half in enumerate(np.split(ring.halved(a, 0), 2, axis=2)):
        for k, point in enumerate(rng.uniform(-1.0, 1.0, (20, len(degrees)))):
            before = point.copy()
            before[0] = point[0] / 2.0 + late - 0.5
            off = abs(exact_value(ring, a[:-1, k, 0], before) - exact_value(ring, half[:-1, k, 0], point))
            assert not off + arb(float(a[-1, k, 0])) > arb(float(half[-1, k, 0]))


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
    steps = np.array([[int(rng.integers(3)), 4 + k, *rng.integers(0, 4 + k, 2)] for k in range(places - 4)])
    models = np.abs(rng.normal(size=(places, terms + 1, 37)))
    models[1, 1:-1] = models[2, terms // 2 : -1] = 0.0  # a constant and a lower degree
    native, plain = models.copy(), models.copy()
    for run, results in ((present(chebyshev.machine_code().best(1)), native), (None, plain)):
        monkeypatch.setattr(chebyshev, "machine_code", lambda run=run: SimpleNamespace(best=lambda _: run))
        chebyshev.carry_out(steps, arithmetic(degrees), results)
    assert not (plain[4:] == models[4:]).any()
    np.testing.assert_allclose(native, plain, rtol=1e-12, atol=1e-12)


@pytest.mark.parametrize("boxes", [1, 32])
def test_a_product_that_underflows_is_not_zero(boxes: int) -> None:
    small = model_of(np.full((4, 1, boxes), 1e-200))
    assert (arithmetic((3,)).product(small, small)[-1] > 0.0).all()
    assert not arithmetic((3,)).product(small, 0.0 * small).any()


@pytest.mark.parametrize("n", [1, 2, 5, 9])
def test_signs_of_determinants_of_all_matrices_of_a_ball_are_right_or_not_known(n: int) -> None:
    rng, every = np.random.default_rng(n), np.arange(n * n)
    equations = SimpleNamespace(
        blocks=[SimpleNamespace(rows=range(n))], sizes=np.array([n * n]), entries=[every], inside=every, own=every
    )
    C, size = rng.normal(size=(n, n, 200)), 10.0 ** rng.uniform(-18.0, 0.0, 200)
    C[0] = C[1:].sum(axis=0) + size * C[0]  # nearly singular
    R = rng.choice([0.0, 0.1, 10.0], 200) * size * rng.uniform(size=C.shape)
    ctx.prec = 400
    signs = block_signs(equations, np.stack([C, R]).reshape(2, n * n, 200))[0]  # type: ignore[arg-type]  # what it reads
    for sign, matrix in zip(signs, (C + R * rng.choice([-1.0, 1.0], C.shape)).transpose(2, 0, 1), strict=True):
        assert not arb_mat(matrix.tolist()).det() * arb(sign) < 0
    assert 0.1 < np.abs(signs).mean() < 1.0


X = ca.SX.sym("x")


def test_comparisons_are_known_where_both_sides_are_equal() -> None:
    ring = arithmetic((10,))
    low, high = ring.span(Walk(ca.vertcat(X < 0, X <= 0), X)(ring, np.zeros((12, 1, 1))))
    np.testing.assert_allclose([low[:, 0], high[:, 0]], [[0.0, 1.0], [0.0, 1.0]], atol=1e-9)


EXTERNAL = ca.Function("external", [X], [X / 2.0], {"never_inline": True})


@pytest.mark.parametrize("written", [lambda x: 1 / x, ca.log, lambda x: ca.fmod(x, 2.0), EXTERNAL])
def test_nothing_bounds_a_pole_inside_or_an_external_function(written: Callable[[ca.SX], ca.SX]) -> None:
    ring, line = arithmetic((10,)), np.eye(12)[1].reshape(12, 1, 1)
    for expression in (written(X), _without_steps(written(X))[0]):
        assert not np.isfinite(ring.span(Walk(expression, X)(ring, line))).any()


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
