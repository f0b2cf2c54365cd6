"""Questions to the measured rows: the fastest at an accuracy, the front that no other setting beats."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass

from benchmarks.chart.own import CLOSED_FORM, COMPILED, LONG_STEPS, NAME, SOLVED
from benchmarks.chart.rows import Row

ACCURACIES = (1e-3, 1e-6, 1e-9)
"""Errors of all inputs, relative to their peaks, at which solvers are compared."""
DEFAULT_METHOD = "radau3"
"""Of `solve` where there are stable internal dynamics."""


def is_own(row: Row) -> bool:
    """Whether the row is the library's."""
    return row.solver == NAME


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
    """The fastest routes of one form, evaluated alike, at one accuracy.

    Attributes
    ----------
    form : str
        Formulation that both solve.
    compiled : bool
        Whether machine code evaluates both, or CasADi's interpreter.
    accuracy : float
        Largest error of any input that both keep.
    own, peer : Row or None
        The library's fastest route, prepared once as peers are, and the fastest peer; None where none is so accurate.
    """

    form: str
    compiled: bool
    accuracy: float
    own: Row | None
    peer: Row | None

    @property
    def ratio(self) -> float | None:
        """Time of the peer divided by that of the library; None where one of them is missing."""
        return None if self.own is None or self.peer is None else self.peer.point[0] / self.own.point[0]


TIE = 1.3
"""Times whose ratio is less do not differ by more than measurements do."""

ALIKE = (("reduced", False), ("projected", False), ("reduced", True), ("projected", True))
"""Forms on which solvers are compared, and whether machine code evaluates both sides."""


def compare(rows: Sequence[Row], scene: str, form: str, compiled: bool = False) -> list[Comparison]:
    """Compare the library with its peers on one scene and form, at all `ACCURACIES`, all of them prepared once."""
    here = [row for row in rows if (row.scene, row.formulation, is_compiled(row)) == (scene, form, compiled)]
    return [
        Comparison(form, compiled, each, fastest(here, each, is_own), fastest(here, each, is_peer))
        for each in ACCURACIES
    ]


def checked(rows: Sequence[Row], scene: str, accuracy: float) -> Row | None:
    """Return the fastest `solve` on the projected form, with its checks and a step for every instant."""
    here = [row for row in rows if row.scene == scene and is_own(row) and row.formulation == "projected"]
    return fastest(here, accuracy, lambda row: LONG_STEPS not in row.method)


def default_route(rows: Sequence[Row], scene: str) -> Row | None:
    """Return the row of `solve(scene)`: first model, reduced form, an output step of a 200th of the duration."""
    names = (SOLVED, DEFAULT_METHOD)
    here = [row for row in rows if row.scene == scene and is_own(row) and row.formulation == "reduced"]
    found = [row for row in here if row.setting == "200 steps" and row.method in names and row.model == here[0].model]
    return next((row for row in found if row.method == SOLVED), found[0] if found else None)


def gain(rows: Sequence[Row], scene: str, accuracy: float) -> Comparison:
    """Compare the default route, on the reduced form, with the fastest peer on the projected form of the paper."""
    default, here = default_route(rows, scene), [row for row in rows if row.scene == scene and not is_compiled(row)]
    own = None if default is None else fastest([default], accuracy)
    peer = fastest(here, accuracy, lambda row: is_peer(row) and row.formulation == "projected")
    return Comparison("default", False, accuracy, own, peer)
