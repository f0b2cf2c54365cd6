"""The report of `effects`: one row for each effect, and the smallest model that keeps a tolerance."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

from servocore.errors import InvalidModel
from servocore.model.scene import Scene
from servocore.problem import Problem

ESTIMATED, SIMULATED, REFUSED = "estimated", "simulated", "refused"

HEADINGS = (
    "effect", "index", "internal states", "derivatives of the path", "change of the inputs", "load off its path",
    "residual swing", "unknowns", "µs an instant", "needed",
)  # fmt: skip
"""Headings of the columns that `cells` fills."""


@dataclass(frozen=True)
class EffectRow:
    """One effect: properties of the model with it, and the error without it.

    Attributes
    ----------
    name : str
        Of the effect.
    index, internal_states, derivatives, unknowns : int or None
        Of the inverse problem of the model that has it: structural index, number of states of the internal dynamics,
        highest derivative of the path that the inputs hold, unknowns of an instant. None where it cannot be analysed.
    microseconds : float or None
        Processor time an instant of the exact inversion, or of `solve` where there are internal dynamics.
    input_change : float or None
        Largest difference of an input between the models, as a fraction of that input's largest value.
    error : float
        Largest distance of the load from its path, while that lasts, if the inputs of the model without the effect
        drive the plant with it, in the unit of the path; infinite where the plant does not survive them.
    swing : float or None
        Largest swing of the load after the path's end, in the same unit; None where the path does not end at rest.
    how : str
        "estimated", "simulated" or "refused".
    law : str
        Name of the time law on which all of this holds.
    needed : bool
        Whether the effect belongs to the smallest model.
    left_out : bool
        Whether the scene has the effect, so that the scene without it was compared.
    reason : str
        Why the row is refused, or why it is simulated.
    estimate : float or None
        The estimate of the error, also where a simulation replaced it; None where there is none.
    """

    name: str
    index: int | None = None
    internal_states: int | None = None
    derivatives: int | None = None
    unknowns: int | None = None
    microseconds: float | None = None
    input_change: float | None = None
    error: float = math.inf
    swing: float | None = None
    how: str = ESTIMATED
    law: str = ""
    needed: bool = False
    left_out: bool = False
    reason: str = ""
    estimate: float | None = None


@dataclass(frozen=True, eq=False)
class EffectsReport:
    """Which effects a scene needs; printing it gives the table and the verdict.

    Attributes
    ----------
    scene : Scene
        The scene of the study.
    rows : tuple of EffectRow
        Worst first.
    tolerance : float
        How far the load may be off its path, in the unit of the path.
    loops : str
        Inputs and loops of the plant, in words.
    """

    scene: Scene
    rows: tuple[EffectRow, ...]
    tolerance: float
    loops: str

    @property
    def unit(self) -> str:
        """Unit of errors and swings."""
        return self.scene.model().outputs[0].unit

    def __getitem__(self, name: str) -> EffectRow:
        for row in self.rows:
            if row.name == name:
                return row
        raise KeyError(f"{name}; there are {', '.join(line.name for line in self.rows)}")

    @property
    def needed(self) -> tuple[str, ...]:
        """Names of the effects of the smallest model, worst first."""
        return tuple(row.name for row in self.rows if row.needed)

    @property
    def arguments(self) -> tuple[tuple[str, ...], tuple[str, ...]]:
        """Arguments of `Scene.with_effects` for the smallest model: effects to add, and effects to leave out."""
        declared = {effect.name: effect for effect in self.scene.effects.declared}
        added = [row.name for row in self.rows if row.needed and not row.left_out and row.name in declared]
        covered = {included for name in added for included in declared[name].includes}
        without = [row.name for row in self._spared if row.left_out]
        return tuple(effect for effect in added if effect not in covered), tuple(without)

    @property
    def _spared(self) -> list[EffectRow]:
        return [row for row in self.rows if not row.needed and row.how != REFUSED]

    def smallest(self) -> Scene:
        """Return the scene with the smallest model that keeps the tolerance.

        Returns
        -------
        Scene
            The scene of the study with fewer effects, or as it is.
        """
        added, without = self.arguments
        return self.scene.with_effects(*added, without=without) if added or without else self.scene

    @property
    def verdict(self) -> str:
        """The smallest model in a sentence or more."""
        added, without = self.arguments
        total = sum(row.error for row in self._spared)
        refused = [row.name for row in self.rows if row.how == REFUSED]
        declared = {effect.name for effect in self.scene.effects.declared}
        undeclared = [name for name in self.needed if name not in declared]
        changes = [f"{', '.join(names)} {what}" for names, what in ((added, "added"), (without, "left out")) if names]
        how = " and ".join(changes) if changes else "the scene as it is"
        apart = f", apart from {', '.join(refused)}, which cannot be judged" if refused else ""
        addition = f", with {', '.join(undeclared)} of your own" if undeclared else ""
        return (
            f"{self.loops}{apart}, the load keeps {self._length(self.tolerance)} with {how}{addition}: all that is left"
            f" out moves it by {self._length(total)} at most, errors added up.{self._smoother_path}"
        )

    @cached_property  # the smallest model is analysed for it
    def _smoother_path(self) -> str:
        """A sentence where the path is too rough for the inputs of the smallest model."""
        array, reference = Problem.of(self.smallest()).resolved.outcome, self.scene.reference
        if isinstance(array, InvalidModel) or reference.smoothness >= array.reference_order:
            return ""
        order = array.reference_order
        return (
            f" Its inputs need {order} continuous derivatives of the path, which has {reference.smoothness}: a path"
            f" of degree {2 * order + 1} from rest to rest has them."
        )

    def cells(self) -> list[tuple[str, ...]]:
        """Return the rows as texts, in the order of `HEADINGS`.

        Returns
        -------
        list of tuple of str
            One tuple a row.
        """
        return [
            (
                f"{row.name} (left out)" if row.left_out else row.name,
                *(_shown(number, "{}") for number in (row.index, row.internal_states, row.derivatives)),
                _shown(row.input_change and 100 * row.input_change, "{:.2g} %"),
                REFUSED if row.how == REFUSED else f"{self._length(row.error)}, {row.how}",
                "-" if row.swing is None else self._length(row.swing),
                _shown(row.unknowns, "{}"),
                _shown(row.microseconds, "{:.2g}"),
                "-" if row.how == REFUSED else "yes" if row.needed else "no",
            )
            for row in self.rows
        ]

    def _length(self, value: float) -> str:
        """Return an error for people: lengths in mm up to ten metres."""
        if not math.isfinite(value):
            return "not survived"
        if self.unit != "m":
            return f"{value:.2g} {self.unit}"
        if value >= 10:
            return f"{value:.2g} m"
        return f"{1e3 * value:.2g} mm" if value < 0.0995 else f"{1e3 * value:.0f} mm"

    @property
    def remarks(self) -> list[str]:
        """Sentences below the table: laws, reasons, verdict."""
        laws: dict[str, list[str]] = {}
        for row in self.rows:
            laws.setdefault(row.law, []).append(row.name)
        by_law = [f"{law}: {', '.join(names)}." for law, names in laws.items() if law]
        reasons = [f"{line.name}: {line.reason}." for line in self.rows if line.reason]
        return ["Path and duration are the scene's; the time law is as smooth as a row needs.", *by_law, *reasons,
                self.verdict]  # fmt: skip

    def __str__(self) -> str:
        return "\n".join([self.scene.name, aligned([HEADINGS, *self.cells()]), *self.remarks])

    def markdown(self) -> str:
        """Return the table and the remarks below the name of the scene as a piece of Markdown.

        Returns
        -------
        str
            Markdown.
        """
        lines = ["| " + " | ".join(row) + " |" for row in (HEADINGS, ("---",) * len(HEADINGS), *self.cells())]
        remarks = (f"* {remark}" for remark in self.remarks)
        return "\n".join([f"## {self.scene.name}", "", *lines, "", *remarks, ""])


def _shown(value: float | None, form: str) -> str:
    return "-" if value is None else form.format(value)


def aligned(rows: Sequence[Sequence[str]]) -> str:
    """Return rows of texts as lines with columns of even width."""
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    return "\n".join("  ".join(map(str.ljust, row, widths)).rstrip() for row in rows)
