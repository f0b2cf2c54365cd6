"""`compile_solver`: known roots, known Newton sequences, blocks, scaling, and failures that show."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import casadi as ca
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from hypothesis.strategies import DataObject

import servocore as sc
from servocore.numerics.compiled_calls import Array
from servocore.numerics.elimination import symbolic_solution
from servocore.numerics.newton import MAX_ITERATIONS, NEWTON_TOLERANCE
from servocore.numerics.square_systems import SquareSystem, compile_solver, compile_unrolled_solver


def solve(
    unknowns: ca.SX,
    residual: ca.SX,
    givens: ca.SX | None = None,
    values: Sequence[float] | Array = (),
    guess: Sequence[float] | Array | None = None,
    unknown_scale: Array | None = None,
    residual_scale: Sequence[float] | Array | None = None,
    outputs: list[ca.SX] | None = None,
) -> tuple[Array, Array, float]:
    """Compile and solve; returns (solution, (most iterations, factorizations), residual)."""
    size = unknowns.numel()
    system = SquareSystem(
        unknowns=unknowns,
        givens=ca.SX(0, 1) if givens is None else givens,
        residual=residual,
        guess=ca.SX.zeros(size) if guess is None else ca.SX(guess),
        unknown_scale=ca.SX.ones(size) if unknown_scale is None else ca.SX(unknown_scale),
        residual_scale=ca.SX.ones(size) if residual_scale is None else ca.SX(residual_scale),
    )
    function = compile_solver("sc_test", system, [unknowns] if outputs is None else outputs)
    *found, counts, worst = function(np.asarray(values, dtype=float))
    return np.concatenate([np.asarray(each).ravel() for each in found]), np.asarray(counts).ravel(), float(worst)


def newton_iterations(function: Callable[[Any], Any], slope: Callable[[Any], Any], x: float, scale: float = 1.0) -> int:
    """Count steps of Newton's method by hand until the correction is below the tolerance."""
    for k in range(1, MAX_ITERATIONS + 1):
        correction = function(x) / slope(x)
        x -= correction
        if abs(correction) / scale < NEWTON_TOLERANCE:
            return k
    raise AssertionError("no convergence")


@pytest.mark.parametrize("number", [2.0, 3.0, 100.0, 0.01])
def test_the_clock_counts_the_iterations_of_a_square_root(number: float) -> None:
    """Heron's sequence from 1: x <- (x + number/x)/2."""
    x = ca.SX.sym("x")
    root, (most, total), worst = solve(x, x**2 - number, guess=[1.0])
    assert root[0] == pytest.approx(np.sqrt(number), rel=1e-15)
    expected = newton_iterations(lambda y: y**2 - number, lambda y: 2 * y, 1.0)
    assert [most, total] == pytest.approx([expected, expected], rel=1e-12)
    assert worst < 1e-13


def test_the_slowest_block_counts_as_iterations_and_all_blocks_as_factorizations() -> None:
    x = ca.SX.sym("x", 3)
    _, (most, total), _ = solve(x, ca.vertcat(x[0] ** 2 - 2, x[1] ** 3 - 30 * x[0], x[2] - x[1]), guess=[1, 1, 0])
    root = np.sqrt(2.0)
    first = newton_iterations(lambda y: y**2 - 2, lambda y: 2 * y, 1.0)
    second = newton_iterations(lambda y: y**3 - 30 * root, lambda y: 3 * y**2, 1.0)
    assert second > first
    assert most == pytest.approx(second, rel=1e-12)
    assert total == pytest.approx(first + second + 1, rel=1e-12)  # and one for the explicit x[2]


def test_polynomial_systems_have_their_known_roots() -> None:
    """Circle and hyperbola: x^2 + y^2 = 5, x y = 2 with root (2, 1)."""
    x = ca.SX.sym("x", 2)
    root, _, _ = solve(x, ca.vertcat(ca.sumsqr(x) - 5, x[0] * x[1] - 2), guess=[2.5, 0.6])
    np.testing.assert_allclose(root, [2.0, 1.0], rtol=1e-14)


@pytest.mark.parametrize("size", range(1, 9))
@settings(max_examples=10)
@given(data=st.data())
def test_linear_systems_are_solved_exactly_without_iterations(size: int, data: DataObject) -> None:
    matrix = data.draw(arrays(float, (size, size), elements=st.floats(-1.0, 1.0)))
    matrix = np.round(matrix, 3) + 2.0 * size * np.eye(size) + 0.1  # dense and regular: one block
    right = data.draw(arrays(float, size, elements=st.floats(-5.0, 5.0)))
    x, b = ca.SX.sym("x", size), ca.SX.sym("b", size)
    found, (most, total), worst = solve(x, ca.mtimes(ca.SX(matrix), x) - b, b, right)
    np.testing.assert_allclose(found, np.linalg.solve(matrix, right), rtol=1e-12, atol=1e-13)
    assert most == 0
    assert total == 1
    assert worst < 1e-12


def test_written_out_linear_blocks_are_as_accurate_with_rows_of_any_units() -> None:
    """Values of a polynomial at five points, two of them in units that are 1e8 and 1e4 times smaller."""
    size, nodes = 5, np.linspace(-1.0, 1.0, 5)
    matrix = np.vander(nodes, size) * np.array([1.0, 1e8, 1.0, 1e4, 1.0])[:, None]
    x, right = ca.SX.sym("x", size), ca.SX.sym("right", size)
    ones = ca.SX.ones(size)
    system = SquareSystem(x, right, ca.mtimes(ca.SX(matrix), x) - right, ca.SX.zeros(size), ones, ones)
    unrolled = compile_unrolled_solver("sc_flat", system, [x], [right])
    assert unrolled is not None
    expected = np.array([0.3, -1.1, 0.7, 2.0, -0.4])
    np.testing.assert_allclose(np.asarray(unrolled(matrix @ expected)[0]).ravel(), expected, rtol=0, atol=1e-13)


@pytest.mark.parametrize("size", [4, 5, 6])
def test_sparse_blocks_are_written_out_with_fewer_operations_than_a_factorization(size: int) -> None:
    """An arrow: as the forces of a rope, each on its own coordinate, and the rope's length on all of them."""
    rng = np.random.default_rng(size)
    numbers = np.diag(rng.normal(size=size))
    numbers[:, -1], numbers[-1, :] = rng.normal(size=(2, size))
    matrix, right = ca.SX.sym("A", ca.sparsify(ca.DM(numbers)).sparsity()), ca.SX.sym("b", size)
    solved, factorized = (
        ca.Function("sc_solved", [matrix, right], [each], {"cse": True})
        for each in (symbolic_solution(matrix, right), ca.solve(matrix, right))
    )
    assert solved.n_instructions() < factorized.n_instructions()
    side = rng.normal(size=size)
    expected = np.linalg.solve(numbers, side)
    np.testing.assert_allclose(np.asarray(solved(numbers, side)).ravel(), expected, rtol=1e-12, atol=1e-12)


def test_blocks_are_solved_in_the_order_in_which_they_depend_on_each_other() -> None:
    """A chain given backwards: every unknown needs the next one, the last stands alone."""
    x = ca.SX.sym("x", 6)
    rows = [x[k] - x[k + 1] ** 2 - 1 for k in range(5)] + [x[5] ** 3 - 8]
    root, (_, total), _ = solve(x, ca.vertcat(*rows), guess=[1.0] * 6)
    expected = [2.0]
    for _ in range(5):
        expected.append(expected[-1] ** 2 + 1)
    np.testing.assert_allclose(root, expected[::-1], rtol=1e-13)
    alone = newton_iterations(lambda y: y**3 - 8, lambda y: 3 * y**2, 1.0)
    assert total == pytest.approx(alone + 5, rel=1e-12)


@settings(max_examples=15)
@given(order=st.permutations(range(5)), columns=st.permutations(range(5)))
def test_the_order_of_equations_and_unknowns_makes_no_difference(
    order: tuple[int, ...], columns: tuple[int, ...]
) -> None:
    x = ca.SX.sym("x", 5)
    rows = [x[0] ** 2 - 9, x[1] * x[0] - 6, x[2] + x[3] - x[1], x[2] - x[3] - 2 * x[0], x[4] ** 3 + x[4] - x[2]]
    guess = np.array([2.0, 1.0, 0.0, 0.0, 1.0])
    root, _, _ = solve(x[list(columns)], ca.vertcat(*[rows[i] for i in order]), guess=guess[list(columns)])
    fifth = np.real_if_close([r for r in np.roots([1, 0, 1, -4]) if abs(r.imag) < 1e-12])[0]
    np.testing.assert_allclose(root, np.array([3.0, 2.0, 4.0, -2.0, fifth])[list(columns)], rtol=1e-12)


def test_torn_unknowns_of_a_nonlinear_block_satisfy_their_equations() -> None:
    """A loop of explicit rows closed by one nonlinear row, as the velocities of an implicit step are."""
    x, h = ca.SX.sym("x", 4), ca.SX.sym("h")
    rows = ca.vertcat(x[1] - 2 * x[0] - h, x[2] + 3 * x[1], x[3] - x[2] * h, ca.exp(x[3]) + x[0] + x[1] - 2)
    root, _, worst = solve(x, rows, h, [0.1])
    assert worst < 1e-14
    a, b, c, d = root
    np.testing.assert_allclose([b - 2 * a - 0.1, c + 3 * b, d - 0.1 * c, np.exp(d) + a + b - 2], 0.0, atol=1e-14)


@settings(max_examples=20)
@given(
    exponents=st.lists(st.integers(-12, 12), min_size=6, max_size=6),
    values=st.lists(st.floats(0.5, 2.0), min_size=3, max_size=3),
)
def test_units_of_unknowns_and_equations_make_no_difference(
    exponents: tuple[float, ...], values: Sequence[float] | Array
) -> None:
    """Multiplying unknowns by a and rows by b changes neither iterations nor digits, if the scales say so."""
    a, b = 10.0 ** np.array(exponents[:3]), 10.0 ** np.array(exponents[3:])
    x, right = ca.SX.sym("x", 3), ca.SX.sym("g", 3)

    def rows(y: ca.SX) -> ca.SX:
        return y**3 + 2 * y + ca.vertcat(y[1], y[2], y[0]) / 10 - right

    plain, counts, _ = solve(x, rows(x), right, values, guess=[1, 1, 1])
    scaled, scaled_counts, _ = solve(
        x, rows(x / ca.SX(a)) * ca.SX(b), right, values, guess=a, unknown_scale=a, residual_scale=b
    )
    np.testing.assert_allclose(scaled / a, plain, rtol=1e-9, atol=1e-9)
    assert abs(scaled_counts - counts).max() < 1.5


def test_the_residual_is_the_largest_of_all_rows_each_by_its_scale() -> None:
    """Where Newton stops after one exact step of a linear row, nothing is left; a wrong scale would show."""
    x = ca.SX.sym("x", 2)
    _, _, worst = solve(x, ca.vertcat(x[0] - 1, x[1] - 2), outputs=[x, ca.SX(0)])
    assert worst == 0.0
    # the double next to the root of two has a square that misses 2 by 4.4e-16
    _, _, worst = solve(x[0], x[0] ** 2 - 2, guess=[1.2], residual_scale=[1e-20])
    assert worst == pytest.approx(4.44e4, rel=0.01)


def test_outputs_are_expressions_of_unknowns_and_givens() -> None:
    x, g = ca.SX.sym("x", 2), ca.SX.sym("g", 2)
    found, _, _ = solve(
        x, ca.vertcat(x[0] - g[0], x[1] ** 3 - g[1]), g, [4.0, 27.0], guess=[1, 1], outputs=[x[0] + x[1] + g[0], 2 * x]
    )
    np.testing.assert_allclose(found, [11.0, 8.0, 6.0], rtol=1e-14)


def test_without_unknowns_there_is_nothing_to_do() -> None:
    found, counts, worst = solve(ca.SX(0, 1), ca.SX(0, 1), outputs=[ca.SX(3)])
    np.testing.assert_array_equal(found, [3.0])
    np.testing.assert_array_equal(counts, [0.0, 0.0])
    assert worst == 0.0


# Failure ------------------------------------------------------------------------------------------------------------


def test_a_system_without_a_root_gives_nan_not_the_last_iterate() -> None:
    x = ca.SX.sym("x")
    root, _, _ = solve(x, x**2 + 1, guess=[0.7])
    assert np.isnan(root).all()


def test_a_singular_jacobian_at_the_guess_gives_nan_or_infinity() -> None:
    x = ca.SX.sym("x", 2)
    root, _, worst = solve(x, ca.vertcat(x[0] * x[1] - 1, x[0] ** 2 + x[1] ** 2 - 4), guess=[0.0, 0.0])
    assert not np.isfinite(root).all()
    assert not np.isfinite(worst)


def test_a_numerically_singular_linear_block_shows() -> None:
    x, g = ca.SX.sym("x", 3), ca.SX.sym("g")
    matrix = ca.SX([[1.0, 2.0, 3.0], [4.0, 5.0, 6.0], [7.0, 8.0, 9.0]])
    matrix[2, 2] = g  # 9 makes it singular; the pattern is dense, so the structure cannot tell
    assert np.isfinite(solve(x, ca.mtimes(matrix, x) - 1, g, [10.0])[2])
    root, _, worst = solve(x, ca.mtimes(matrix, x) - ca.SX([1.0, 0.0, 0.0]), g, [9.0])
    assert not np.isfinite(root).all() or worst > 1e-3


def test_failure_of_one_block_spreads_to_those_that_need_it_and_to_the_residual_only() -> None:
    x = ca.SX.sym("x", 3)
    root, _, worst = solve(x, ca.vertcat(x[0] ** 2 + 1, x[1] - x[0], x[2] ** 2 - 4), guess=[0.7, 0.0, 1.0])
    assert np.isnan(root[:2]).all()
    assert root[2] == pytest.approx(2.0)
    assert np.isnan(worst)


def test_nan_among_the_givens_is_not_taken_for_convergence() -> None:
    x, g = ca.SX.sym("x"), ca.SX.sym("g")
    root, _, worst = solve(x, x**3 + x - g, g, [np.nan], guess=[1.0])
    assert np.isnan(root).all()
    assert np.isnan(worst)


@pytest.mark.parametrize(
    "rows",
    [
        lambda x: ca.vertcat(x[0], x[0] ** 2, x[2]),  # nothing for x[1]
        lambda x: ca.vertcat(x[0] + x[1], x[2], x[2] ** 2 + x[2]),  # two rows for x[2], one for two
        lambda x: ca.vertcat(x[0], x[1], 0),
    ],
)
def test_structurally_singular_equations_are_refused(rows: Callable[[ca.SX], ca.SX]) -> None:
    x = ca.SX.sym("x", 3)
    with pytest.raises(sc.InvalidModel, match="structurally singular"):
        solve(x, ca.SX(rows(x)))


@pytest.mark.parametrize("attribute", ["residual", "guess", "unknown_scale", "residual_scale"])
def test_sizes_that_do_not_fit_are_refused(attribute: str) -> None:
    x = ca.SX.sym("x", 2)
    settings = {"unknowns": x, "givens": ca.SX(0, 1), "residual": x, "guess": ca.SX.zeros(2)}
    settings |= {"unknown_scale": ca.SX.ones(2), "residual_scale": ca.SX.ones(2), attribute: ca.SX.ones(3)}
    with pytest.raises(sc.InvalidModel, match=f"2 unknowns, but {attribute} has 3 rows"):
        SquareSystem(**settings)  # type: ignore[arg-type]  # wrong on purpose
