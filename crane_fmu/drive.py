"""Drive any plant, as an FMU of the user's own, by our inputs, and see how far its load leaves the path."""

from __future__ import annotations

import tomllib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import fmpy
import numpy as np

import servocore as sc
from crane_fmu.catalogue import components
from crane_fmu.run import Array, simulated
from servocore.files import csv_text
from servocore.planning.durations import shortest_duration_told

GIVEN, SEEN = ("M_b", "F", "M_w"), ("x", "y", "z")
"""What the plant is given, and what has to be seen of it: the load's position."""

STEP = 0.01
"""Longest communication step in s, where none is asked for."""

_OWN = dict(zip(SEEN, components("load.position"), strict=True))  # names in CranePlant.fmu


@dataclass(frozen=True)
class Driven:
    """Where the load should have been, and where it was.

    Attributes
    ----------
    t : ndarray, shape (n,)
        Times in s.
    wanted, found : ndarray, shape (n, 3)
        Positions of the load in m.
    """

    t: Array
    wanted: Array
    found: Array

    @property
    def distances(self) -> Array:
        """Of the load from its path in m, shape (n,)."""
        distances: Array = np.linalg.norm(self.found - self.wanted, axis=1)
        return distances

    def sentences(self) -> tuple[str, ...]:
        """Say how far the load left its path.

        Returns
        -------
        tuple of str
            One sentence; a second one where the load starts beside the path.
        """
        off, worst = self.distances, int(self.distances.argmax())
        messages: tuple[str, ...] = (
            f"The load leaves its path by {1e3 * off[worst]:.3g} mm at most, at t = {self.t[worst]:.6g} s;"
            f" at the end it is {1e3 * off[-1]:.3g} mm away.",
        )
        if off[0] > 1e-3:
            place = ", ".join(f"{coordinate:.6g}" for coordinate in self.wanted[0])
            messages += (
                f"It starts {off[0]:.3g} m off its path: set the plant's start so that the load is at ({place}) m.",
            )
        return messages

    def table(self) -> str:
        """Return positions, found and wanted, and distances as the text of a CSV file.

        Returns
        -------
        str
            A header and a row for each instant, in s and m.
        """
        names = ["time", *(column for name in SEEN for column in (name, f"{name}_wanted")), "distance"]
        both = np.stack([self.found, self.wanted], axis=2).reshape(len(self.t), -1)
        return csv_text(names, [self.t, both, self.distances])


def signals(pairs: Sequence[str]) -> dict[str, str]:
    """Return names of the plant's variables by ours.

    Parameters
    ----------
    pairs : sequence of str
        ``OURS=THEIRS``, or files in TOML that say the same.

    Returns
    -------
    dict of str to str
        Later pairs replace earlier ones of the same name.

    Raises
    ------
    InvalidSetting
        If a pair or a file does not say that, or a name is none of ours.
    """
    found: dict[str, str] = {}
    for pair in pairs:
        if pair.endswith(".toml") and "=" not in pair:
            found |= _from_file(Path(pair))
            continue
        ours, equals, theirs = pair.partition("=")
        if not (equals and ours and theirs):
            raise sc.InvalidSetting(
                f"--map {pair}: it must be OURS=THEIRS or a file that ends in .toml: write it as in --map"
                " F=trolley.force"
            )
        found[ours.strip()] = theirs.strip()
    for name in found:
        if name not in (*GIVEN, *SEEN):
            raise sc.InvalidSetting(f"there is no signal {name!r} to map; there are {', '.join((*GIVEN, *SEEN))}")
    return found


def _from_file(file: Path) -> dict[str, str]:
    try:
        pairs = tomllib.loads(file.read_text(encoding="utf-8-sig"))
    except (OSError, ValueError) as error:
        raise sc.InvalidSetting(f"cannot read {file}: {_reason(error)}") from error
    wrong = [name for name, value in pairs.items() if not isinstance(value, str)]
    if wrong:
        raise sc.InvalidSetting(f"{file}: {wrong[0]} must be the name of a variable, in quotes")
    return pairs


def settings(pairs: Sequence[str]) -> dict[str, float]:
    """Return start values of the plant by name.

    Parameters
    ----------
    pairs : sequence of str
        ``NAME=NUMBER``, in the units of the plant.

    Returns
    -------
    dict of str to float
        Values by name of the variable.

    Raises
    ------
    InvalidSetting
        If a text is no such pair.
    """
    found = {}
    for pair in pairs:
        name, _, value = (part.strip() for part in pair.rpartition("="))
        try:
            found[name] = float(value)
        except ValueError:
            name = ""
        if not (name and np.isfinite(found[name])):
            raise sc.InvalidSetting(f"--set {pair}: it must be NAME=NUMBER: write it as in --set start.swing=0.1")
    return found


def drive(
    plant: Path,
    crane: sc.Scene,
    names: Mapping[str, str],
    starts: Mapping[str, float],
    step: float | None = None,
) -> Driven:
    """Drive a plant along a path by the inputs of the exact inversion.

    Parameters
    ----------
    plant : Path
        An FMU that takes M_b, F, M_w and tells the load's position.
    crane : Scene
        With its path, parameters and limits.
    names : mapping of str to str
        The plant's variables by our names; what is not mapped has our name, or that in CranePlant.fmu.
    starts : mapping of str to float
        The plant's start values.
    step : float, optional
        Communication step in s; must divide the duration.

    Returns
    -------
    Driven
        Where the load should have been and where it was.

    Raises
    ------
    InvalidSetting
        If the FMU cannot be read or lacks a variable.
    IntegrationFailed
        If it does not reach the end of the path.
    """
    known = _variables(plant)
    theirs = {name: _found(plant, known, name, names) for name in (*GIVEN, *SEEN)}
    for name in starts:
        if name not in known:
            raise sc.InvalidSetting(f"{plant.name} has no variable {name!r} to set")
    reference = crane.reference
    step = reference.duration / np.ceil(reference.duration / STEP) if step is None else step
    with shortest_duration_told(crane):
        inputs = sc.solve(crane, step=step)
    rows = np.rec.fromarrays(
        [inputs.t, *(inputs[name] for name in GIVEN)],
        dtype=[("time", float), *((theirs[name], float) for name in GIVEN)],
    )
    outputs = [theirs[name] for name in SEEN]
    found = simulated(plant, rows, step, starts, outputs)
    wanted = reference.jet(np.clip(found["time"], reference.start_time, reference.end_time), 0)[:, 0]
    return Driven(found["time"], wanted, np.stack([found[name] for name in outputs], axis=1))


def _reason(error: Exception) -> object:
    """Return what an error says, without the number that the machine has for it."""
    return getattr(error, "strerror", None) or error


def _variables(plant: Path) -> dict[str, str]:
    """Return the causality of an FMU's variables by name."""
    try:
        described = fmpy.read_model_description(str(plant), validate=False)
    except Exception as error:  # FMPy raises what its parts raise
        raise sc.InvalidSetting(f"cannot read {plant} as an FMU: {_reason(error)}") from error
    return {variable.name: variable.causality for variable in described.modelVariables}


def _found(plant: Path, known: Mapping[str, str], name: str, names: Mapping[str, str]) -> str:
    """Return what a signal is called in the plant."""
    wanted = ("input",) if name in GIVEN else ("output", "local")
    candidates = [names[name]] if name in names else [name, _OWN.get(name, name)]
    for candidate in candidates:
        if known.get(candidate) in wanted:
            return candidate
    there = ", ".join(each for each, causality in known.items() if causality == wanted[0]) or "none"
    what = f"no {wanted[0]} {candidates[0]!r}" + ("" if name in names else f"; map one with --map {name}=NAME")
    raise sc.InvalidSetting(f"{plant.name} has {what}; its {wanted[0]}s are {there}")
