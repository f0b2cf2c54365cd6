"""`Call`: compiled functions on arrays, without copies where none are needed and without trust in sizes."""

from __future__ import annotations

from collections.abc import Callable

import casadi as ca
import numpy as np
import pytest

from servocore.numerics.compiled_calls import Array, Call


@pytest.fixture
def weighted() -> Call:
    """(x (3,), A (2, 3), c) -> (A x + c, A^T, sum x)."""
    x, A, c = ca.SX.sym("x", 3), ca.SX.sym("A", 2, 3), ca.SX.sym("c")
    return Call(ca.Function("weighted", [x, A, c], [ca.mtimes(A, x) + c, A.T, ca.sum1(x)]))


X, A = np.array([1.0, -2.0, 3.0]), np.arange(6.0).reshape(2, 3)


def test_it_computes_what_the_function_computes(weighted: Call) -> None:
    vector, matrix, scalar = weighted(X, A, 10.0)
    np.testing.assert_array_equal(vector, A @ X + 10.0)
    np.testing.assert_array_equal(matrix, A.T)
    np.testing.assert_array_equal(scalar, [2.0])
    assert vector.shape == (2,)
    assert matrix.shape == (3, 2)


@pytest.mark.parametrize(
    "layout",
    [
        np.asfortranarray,
        np.ascontiguousarray,
        lambda each: np.repeat(each, 2, axis=-1)[..., ::2],
        lambda each: each.tolist(),
        lambda each: each.astype(np.float32),
    ],
    ids=["columns", "rows", "strided", "list", "single precision"],
)
def test_how_an_argument_lies_in_memory_makes_no_difference(weighted: Call, layout: Callable[[Array], Array]) -> None:
    vector, matrix, _ = weighted(layout(X), layout(A), 1)
    np.testing.assert_array_equal(vector, A @ X + 1.0)
    np.testing.assert_array_equal(matrix, A.T)


def test_arguments_are_left_as_they_are_and_may_be_read_only(weighted: Call) -> None:
    x, a = X.copy(), A.copy()
    x.setflags(write=False)
    a.setflags(write=False)
    weighted(x, a, 0.0)
    np.testing.assert_array_equal(x, X)
    np.testing.assert_array_equal(a, A)


def test_results_of_earlier_calls_are_not_overwritten(weighted: Call) -> None:
    first, *_ = weighted(X, A, 0.0)
    kept = first.copy()
    weighted(10 * X, A, 5.0)
    np.testing.assert_array_equal(first, kept)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ((X[:2], A, 0.0), "argument 0 of weighted has 2 entries, expected 3"),
        ((X, A[:1], 0.0), "argument 1 of weighted has 3 entries, expected 6"),
        ((X, A, [1.0, 2.0]), "argument 2 of weighted has 2 entries, expected 1"),
    ],
)
def test_arguments_of_another_size_are_refused(
    weighted: Call, arguments: tuple[Array, Array, float | list[float]], message: str
) -> None:
    with pytest.raises(ValueError, match=message):
        weighted(*arguments)


def test_empty_arguments_and_results_are_allowed() -> None:
    x = ca.SX.sym("x", 2)
    call = Call(ca.Function("partly", [x, ca.SX(0, 1)], [2 * x, ca.SX(0, 1)]))
    doubled, nothing = call([1.0, 2.0], [])
    np.testing.assert_array_equal(doubled, [2.0, 4.0])
    assert nothing.size == 0


def test_sparse_results_are_refused_when_compiled() -> None:
    x = ca.SX.sym("x")
    with pytest.raises(ValueError, match="result 1 of sparse is sparse"):
        Call(ca.Function("sparse", [x], [x, ca.vertcat(x, ca.SX(1, 1))]))


def test_where_casadi_gives_up_every_result_is_nan_and_the_next_call_is_good() -> None:
    """A linear system that is singular to the last bit ends the evaluation: results would hold what memory held."""
    given = ca.MX.sym("a")
    matrix = ca.vertcat(ca.horzcat(given, given), ca.horzcat(given, 2 * given))
    root = ca.solve(matrix, ca.MX([1.0, 2.0]), "qr")
    call = Call(ca.Function("root", [given], [root, given + 1, ca.sum1(root)]))
    good = call(1.0)
    assert all(np.isfinite(each).all() for each in good)
    for _ in range(3):
        assert all(np.isnan(each).all() for each in call(0.0))
        for found, expected in zip(call(1.0), good, strict=True):
            np.testing.assert_array_equal(found, expected)
