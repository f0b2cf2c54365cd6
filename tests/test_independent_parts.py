"""Independent parts of a system stay apart: together they cost what they cost one by one, and give the same answers."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from typing import Any

import casadi as ca
import numpy as np
import pytest
from present import present

import servocore as sc
from benchmarks.copies import cranes
from servocore.numerics.compiled_calls import Array
from servocore.numerics.components import (
    condition_number,
    condition_numbers,
    filled,
    gram_solver,
    parts_of,
    singular_values,
)
from servocore.numerics.constraint_ranks import ConstraintRank, constraint_rank, unit_rows
from servocore.numerics.square_systems import SquareSystem, compile_solver
from servocore.problem import Problem
from servocore.solvers import runs
from servocore.structure.inversion import diagonal_blocks, inversion

BLOCKS = np.array([[0, 2, 0, 1.0], [3, 0, 0, 0], [0, 5, 0, 4], [1, 0, 7, 0]])  # rows 0 and 2, rows 1 and 3


@cache
def together(count: int) -> tuple[sc.Scene, list[sc.Scene]]:
    return cranes(count)


def exact_inputs(alone: list[sc.Scene], t: np.ndarray) -> np.ndarray:
    """Closed forms of cranes one by one."""
    names = [each.name for each in alone[0].model().inputs]
    return np.column_stack([each.exact(t)[name] for each in alone for name in names])


def sizes_of_svd(monkeypatch: pytest.MonkeyPatch) -> list[int]:
    """Record the sizes of matrices whose singular values are looked for."""
    found, svd = [], np.linalg.svd

    def recording(matrix: Array, *arguments: Any, **named: Any) -> Any:
        found.append(max(matrix.shape[-2:]))
        return svd(matrix, *arguments, **named)

    monkeypatch.setattr(np.linalg, "svd", recording)
    return found


# What parts are --------------------------------------------------------------------------------------------------


def test_parts_of_a_matrix_have_no_entries_in_common() -> None:
    sparse = ca.sparsify(ca.DM(BLOCKS))
    parts = parts_of(sparse.sparsity())
    assert sorted((part.rows.tolist(), part.columns.tolist()) for part in parts) == [([0, 2], [1, 3]), ([1, 3], [0, 2])]
    entries = np.array(sparse.nonzeros())[:, None]
    for part in parts:
        np.testing.assert_array_equal(part.dense(entries)[0], BLOCKS[np.ix_(part.rows, part.columns)])


@pytest.mark.parametrize("matrix", [BLOCKS, BLOCKS[:3], BLOCKS[:, :2], np.zeros((2, 3)), np.diag([1.0, 0.0, 2.0])])
def test_singular_values_are_those_of_the_parts(matrix: Array) -> None:
    np.testing.assert_allclose(singular_values(matrix), np.linalg.svd(matrix, compute_uv=False), atol=1e-15)


def test_conditions_of_parts_are_the_condition_of_the_whole() -> None:
    sparse = ca.sparsify(ca.DM(BLOCKS))
    entries = np.array(sparse.nonzeros())[:, None] * [1.0, np.nan]
    found = condition_numbers(parts_of(sparse.sparsity()), entries)
    np.testing.assert_allclose(found, [condition_number(BLOCKS), np.inf])
    np.testing.assert_array_equal(filled(sparse), BLOCKS)


# Parts that are alike --------------------------------------------------------------------------------------------


def equations(numbers: tuple[float, ...]) -> SquareSystem:
    """As many parts of four equations with a root near two, in one parameter that is common and one that is not."""
    count = len(numbers)
    x, p = ca.SX.sym("x", 4 * count), ca.SX.sym("p", 1 + count)
    rows = [
        row
        for k, number in enumerate(numbers)
        for a, b, c, d in [ca.vertsplit(x[4 * k : 4 * k + 4])]
        for row in (a**2 - b * p[0], b * c - d - p[1 + k] * number, c - d + ca.sin(a) - 1, d**2 + a * b - 8)
    ]
    return SquareSystem(
        x, p, ca.vertcat(*rows), 2 * ca.SX.ones(4 * count), ca.SX.ones(4 * count), ca.SX.ones(4 * count)
    )


def groups(system: SquareSystem) -> list[int]:
    return sorted(map(len, system.alike))


def test_a_solve_of_many_cranes_takes_determinants_of_one_of_them_at_most() -> None:
    sizes = [max(len(each.rows) for each in diagonal_blocks(Problem.of(together(k)[0]).array)) for k in (1, 4)]
    assert sizes[0] == sizes[1] > 0


def test_parts_with_the_same_expressions_are_alike_whatever_their_symbols_are_called() -> None:
    assert groups(equations((1.0, 1.0, 1.0))) == [3]


def test_parts_with_other_numbers_written_into_them_are_not_alike() -> None:
    assert groups(equations((1.0, 2.0, 1.0, 2.0, 3.0))) == [2, 2]


def test_parts_that_are_alike_are_solved_as_if_each_stood_alone() -> None:
    system, values = equations((1.0, 1.0, 2.0)), [1.1, 0.9, 1.2, 0.8]
    x, counts, residual = compile_solver("together", system, [system.unknowns])(values)
    assert float(residual) < 1e-14
    total = 0.0
    for k, number in enumerate((1.0, 1.0, 2.0)):
        single = equations((number,))
        own, own_counts, _ = compile_solver("alone", single, [single.unknowns])([values[0], values[1 + k]])
        np.testing.assert_array_equal(np.asarray(x)[4 * k : 4 * k + 4], np.asarray(own))
        assert float(counts[0]) >= float(own_counts[0])
        total += float(own_counts[1])
    assert float(counts[1]) == total


def test_a_part_that_fails_spoils_no_other() -> None:
    system = equations((1.0, 1.0))
    x, _, residual = compile_solver("together", system, [system.unknowns])([1.1, 0.9, np.nan])
    assert np.isfinite(np.asarray(x)[:4]).all()
    assert not np.isfinite(np.asarray(x)[4:]).any()
    assert np.isnan(float(residual))


# Cranes side by side ---------------------------------------------------------------------------------------------


@pytest.mark.parametrize("count", [1, 4, 16])
def test_inputs_of_many_cranes_are_exact(count: int) -> None:
    scene, alone = together(count)
    t = np.linspace(0.0, scene.reference.end_time, 33)
    exact = exact_inputs(alone, t)
    np.testing.assert_allclose(sc.ExactInversion(scene)(t), exact, rtol=0.0, atol=1e-11 * np.abs(exact).max())
    solution = sc.solve(scene, step=scene.reference.duration / 32)
    np.testing.assert_allclose(solution.values[:, : exact.shape[1]], exact, rtol=0.0, atol=1e-11 * np.abs(exact).max())


def test_operations_of_an_exact_inversion_grow_as_the_number_of_cranes_does() -> None:
    lengths = {}
    for count in (1, 4, 16, 96):
        expression = inversion(Problem.of(together(count)[0]).array).expression
        assert expression is not None, count
        lengths[count] = expression.n_instructions()
    one = (lengths[4] - lengths[1]) / 3
    for count in (16, 96):
        assert lengths[count] == pytest.approx(lengths[1] + (count - 1) * one, rel=0.02)


@pytest.mark.parametrize("count", [4, 16])
def test_what_is_analysed_of_many_cranes_is_what_is_analysed_of_one(
    count: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    one, scene = sc.analyse(together(1)[0]), together(count)[0]
    Problem.of(scene)  # once, the constraints at home are looked at as a whole
    sizes = sizes_of_svd(monkeypatch)
    many = sc.analyse(scene)
    assert (many.classification, many.index, many.internal_degrees_of_freedom) == ("flat", one.index, 0)
    assert many.condition == pytest.approx(one.condition, rel=0.1)  # each on a path of its own
    assert max(sizes) <= 10  # rows or columns of one crane


@pytest.mark.parametrize("count", [4, 16])
def test_projected_steps_of_many_cranes_are_those_of_each(count: int) -> None:
    scene, alone = together(count)
    step = scene.reference.duration / 40
    many = sc.solve(scene, sc.Projected(), sc.BackwardEuler(), step=step, checks=False)
    single = [sc.solve(each, sc.Projected(), sc.BackwardEuler(), step=step, checks=False) for each in alone]
    inputs = np.column_stack([each.values[:, :3] for each in single])
    np.testing.assert_allclose(many.values[:, : inputs.shape[1]], inputs, atol=1e-9 * np.abs(inputs).max())
    assert many.statistics.factorizations == sum(each.statistics.factorizations for each in single)


# What a run costs besides ----------------------------------------------------------------------------------------


def test_an_exact_inversion_is_observed_by_the_function_that_solves_it(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(runs, "along_path", lambda *_, **__: pytest.fail("observed once more"))
    scene = sc.scenes.gantry_crane()
    solution = sc.solve(scene, step=scene.reference.duration / 50)
    np.testing.assert_allclose(solution["F_x"], scene.exact(solution.t)["F_x"], rtol=1e-9)
    assert solution.statistics.newton_iterations == solution.statistics.steps + 1


def test_where_the_guess_is_not_exact_an_instant_is_searched_for_and_the_others_are_not() -> None:
    crane = sc.scenes.gantry_crane()
    model = crane.model()
    late = ca.if_else(model.gamma[0, 0] > crane.reference.jet(3.0, 0)[0, 0], 0.01, 0.0)
    aside = replace(model, guess=model.guess + late)
    scene = sc.Scene("aside", {"points": lambda: aside}, crane.reference)
    solution = sc.solve(scene, step=crane.reference.duration / 50)
    np.testing.assert_allclose(solution["F_x"], crane.exact(solution.t)["F_x"], rtol=1e-9)
    instants = solution.statistics.steps + 1
    assert instants < solution.statistics.newton_iterations < instants * 4


# What `analyse` does once ---------------------------------------------------------------------------------------------


def test_constraints_at_home_are_assembled_once(monkeypatch: pytest.MonkeyPatch) -> None:
    asked = []

    def counted(*given: Any) -> ConstraintRank:
        asked.append(given)
        return constraint_rank(*given)

    monkeypatch.setattr("servocore.model.system.constraint_rank", counted)
    sc.analyse(cranes(2)[0])
    assert len(asked) == 1


@pytest.mark.parametrize("singular", [False, True])
def test_sparse_factors_of_large_parts_tell_what_dense_decompositions_do(singular: bool) -> None:
    size, random = 150, np.random.default_rng(7)
    near = abs(np.subtract.outer(range(size), range(size))) < 3
    matrices = random.uniform(0.5, 2.0, (2, size, size)) * near * 10.0 ** random.integers(-4, 5, (size, 1))
    matrices[:, 40, :] *= 1.0 - singular
    pattern = ca.Sparsity.triplet(size, size, *(each.tolist() for each in np.nonzero(near)))
    entries = np.array([matrix.T[near.T] for matrix in matrices]).T
    found, dense = condition_numbers(parts_of(pattern), entries), [condition_number(matrix) for matrix in matrices]
    limit = 1e14  # beyond it is round-off
    np.testing.assert_allclose(np.minimum(found, limit), np.minimum(dense, limit), rtol=1e-4)
    rows = unit_rows(matrices[0])
    solve = gram_solver(rows, 0.1)
    np.testing.assert_allclose(
        present(solve)(rows[:, 3]), np.linalg.solve(rows @ rows.T + 0.1 * np.eye(size), rows[:, 3])
    )
    assert (gram_solver(rows) is None) == singular
