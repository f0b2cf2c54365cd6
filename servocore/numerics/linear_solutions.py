"""Solutions of small linear systems as expressions: Cramer's rule, determinants by Laplace's expansion, or QR."""

from __future__ import annotations

import casadi as ca

_FORMULA = 3  # rows up to which Cramer's rule is written as products of vectors
_LARGEST = 6  # rows to develop determinants of: each one more doubles the minors
_DEAREST = 1.5  # times the cube of the rows, about what QR takes: so many products, when most entries are there

_Columns = frozenset[int]


def symbolic_solution(matrix: ca.SX, right: ca.SX) -> ca.SX:
    """Return matrix^-1 right as an expression.

    Parameters
    ----------
    matrix : casadi.SX
        Square and sparse.
    right : casadi.SX
        Column vector.

    Returns
    -------
    casadi.SX
        Column vector.
    """
    if matrix.size1() <= _FORMULA:
        return small_inverse_times(matrix, right)
    if matrix.size1() <= _LARGEST:
        rows = _with_right_side(matrix, right)
        products, order = _cheapest_order([frozenset(row) for row in rows])
        if products <= _DEAREST * matrix.size1() ** 3:
            return _by_determinants([rows[i] for i in order])
    # QR is Gram and Schmidt's here: its error grows with the square of the condition, which is large where equations of
    # forces stand beside such of lengths. Rows of length one do better, and remain differentiable.
    length = ca.sqrt(ca.sum2(matrix**2))
    return ca.solve(ca.mtimes(ca.diag(1 / length), matrix), right / length)


def small_inverse_times(matrix: ca.SX, right: ca.SX) -> ca.SX:
    """Return matrix^-1 right for up to three rows, by Cramer's rule."""
    if matrix.size1() == 1:
        return right / matrix
    if matrix.size1() == 2:
        (a, b), (c, d) = ((matrix[i, 0], matrix[i, 1]) for i in range(2))
        return ca.vertcat(d * right[0] - b * right[1], a * right[1] - c * right[0]) / (a * d - b * c)
    rows = [matrix[i, :].T for i in range(3)]
    # The columns of the adjugate are the cross products of the rows.
    adjugate = ca.horzcat(*[ca.cross(rows[(i + 1) % 3], rows[(i + 2) % 3]) for i in range(3)])
    return ca.mtimes(adjugate, right) / ca.dot(rows[0], adjugate[:, 0])


def _with_right_side(matrix: ca.SX, right: ca.SX) -> list[dict[int, ca.SX]]:
    """Return the entries of rows by column, with the right side as one column more."""
    size = matrix.size1()
    rows = [{size: right[i]} for i in range(size)]
    for i, j in zip(*matrix.sparsity().get_triplet(), strict=True):
        rows[i][j] = matrix[i, j]
    return rows


def _by_determinants(rows: list[dict[int, ca.SX]]) -> ca.SX:
    """Develop determinants row after row by Laplace, with every minor computed once: all unknowns share most of them.

    How rows and columns are scaled does not matter to round-off, nothing but the determinant is divided by, and the
    chain of operations is short where a factorization has a division and a root in every row.
    """
    size, minors = len(rows), {_Columns(): ca.SX(1)}
    for row in rows:
        minors = _with_row(minors, row)
    every = _Columns(range(size))
    # In the place of column j stands the right side: moved there from the end past all columns between.
    signs = [(-1) ** (size - 1 - j) for j in range(size)]
    numerators: ca.SX = ca.vertcat(*[sign * minors.get(every - {j} | {size}, ca.SX(0)) for j, sign in enumerate(signs)])
    return numerators / minors[every]


def _with_row(minors: dict[_Columns, ca.SX], row: dict[int, ca.SX]) -> dict[_Columns, ca.SX]:
    """Return the minors with a row more, above those that they have, developed by that row."""
    larger: dict[_Columns, ca.SX] = {}
    for columns, minor in minors.items():
        for j in sorted(row.keys() - columns):
            term = row[j] * minor
            odd = sum(k < j for k in columns) % 2
            more_columns = columns | {j}
            if more_columns in larger:
                larger[more_columns] = larger[more_columns] - term if odd else larger[more_columns] + term
            else:
                larger[more_columns] = -term if odd else term
    return larger


def _cheapest_order(rows: list[_Columns]) -> tuple[int, list[int]]:
    """Return the fewest products that developing takes, and the order of rows for it, the lowest first.

    Which minors there are depends on the rows that they are of, not on their order: so the best order of some rows ends
    with the best one of all but its last.
    """
    best: dict[_Columns, tuple[int, list[int], set[_Columns]]] = {_Columns(): (0, [], {_Columns()})}
    for size in range(len(rows)):
        for taken in [rows_taken for rows_taken in best if len(rows_taken) == size]:
            products, order, minors = best[taken]
            for i in set(range(len(rows))) - taken:
                total = products + sum(len(rows[i] - columns) for columns in minors)
                if taken | {i} not in best or total < best[taken | {i}][0]:
                    grown = {columns | {j} for columns in minors for j in rows[i] - columns}
                    best[taken | {i}] = total, [*order, i], grown
    return best[_Columns(range(len(rows)))][:2]
