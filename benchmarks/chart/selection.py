"""Questions to the measured rows: the fastest at an accuracy, the front that no other setting beats."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass

from benchmarks.chart.own import CLOSED_FORM, COMPILED, NAME
from benchmarks.chart.rows import Row

ACCURACIES = (1e-3, 1e-6, 1e-9)
"""Errors of all inputs, relative to their peaks, at which solvers are compared."""


def is_own(row: Row) -> bool:
    """Whether the row is the library's."""
    return row.solver == NAME


def is_interpreted(row: Row) -> bool:
    """Whether the row is the library's, evaluated by the interpreter that the peers' functions are evaluated by."""
    return is_own(row) and not is_compiled(row)


def is_compiled(row: Row) -> bool:
    """Whether machine code evaluates the row, the library's or a peer's."""
    return COMPILED in row.method


def is_peer(row: Row) -> bool:
    """Whether the row is a peer's."""
    return row.solver not in (NAME, CLOSED_FORM)


def fastest(rows: Iterable[Row], accuracy: float, where: Callable[[Row], bool] = lambda _: True) -> Row | None:
    """Return the fastest row with at most this error, or None."""
    good = [row for row in rows if row.solved and row.point[1] <= accuracy and where(row)]
    return min(good, key=lambda row: row.point[0], default=None)


def front(rows: Iterable[Row]) -> list[Row]:
    """Return the rows that no other beats in both time and error, slowest last."""
    found: list[Row] = []
    for row in sorted((row for row in rows if row.solved), key=lambda row: row.point):
        if not found or row.point[1] < found[-1].point[1]:
            found.append(row)
    return found


@dataclass(frozen=True)
class Comparison:
    """The fastest at one accuracy.

    Attributes
    ----------
    own : Row or None
        Our fastest route, whatever its form, but for machine code.
    projected, reduced : Row or None
        The fastest peers on the two forms.
    """

    accuracy: float
    own: Row | None
    projected: Row | None
    reduced: Row | None

    def ratio(self, peer: Row | None) -> float | None:
        """How many times our time a peer takes; None if one of the two does not get there."""
        return None if self.own is None or peer is None else peer.point[0] / self.own.point[0]


def compare(rows: Sequence[Row], scene: str) -> list[Comparison]:
    """Compare on one scene, at all `ACCURACIES`."""
    here = [row for row in rows if row.scene == scene]
    return [
        Comparison(
            accuracy,
            fastest(here, accuracy, is_interpreted),
            fastest(
                here, accuracy, lambda row: is_peer(row) and not is_compiled(row) and row.formulation == "projected"
            ),
            fastest(here, accuracy, lambda row: is_peer(row) and not is_compiled(row) and row.formulation == "reduced"),
        )
        for accuracy in ACCURACIES
    ]


def compare_compiled(rows: Sequence[Row], scene: str) -> list[Comparison]:
    """Compare our fastest route with the fastest peers on one scene, machine code or not, at all `ACCURACIES`."""
    here = [row for row in rows if row.scene == scene]
    return [
        Comparison(
            accuracy,
            fastest(here, accuracy, is_own),
            fastest(here, accuracy, lambda row: is_peer(row) and row.formulation == "projected"),
            fastest(here, accuracy, lambda row: is_peer(row) and row.formulation == "reduced"),
        )
        for accuracy in ACCURACIES
    ]
