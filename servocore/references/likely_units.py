"""Times and positions of a file that look like milliseconds and millimetres where its header declares no unit."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from servocore.errors import InvalidReference

if TYPE_CHECKING:
    from servocore.references.base import FloatArray, Reference

_SLOW, _FAST = 1e-3, 20.0  # m/s: mean speeds beyond which the units are doubtful
_LONG, _FAR = 1000.0, 300.0  # s and m
_SPACING = 0.999  # s: rows at least that far apart may be some milliseconds apart
_LONGER, _FARTHER = 100.0, 300.0  # than the path that the scene has
_GRAVITY = 9.81  # m/s^2
_INSTANTS = 101  # at which a path is compared with the scene


class UndeclaredUnits(NamedTuple):
    """Units that the header of a file leaves open, to be judged by the scene that takes the path.

    Attributes
    ----------
    file : str
        Its name.
    column : str
        The first position column without a unit; empty if all have one.
    positions : tuple of int
        Components of the path whose unit is not declared.
    spacing : float
        Shortest time between rows (s); 0 where the header declares the unit of time.
    """

    file: str
    column: str
    positions: tuple[int, ...]
    spacing: float

    def require_likely(self, t: FloatArray, positions: FloatArray, slow: bool, far: bool, why: str) -> None:
        """Raise `InvalidReference` if times look like milliseconds (`slow`) or positions like millimetres (`far`).

        Parameters
        ----------
        t : ndarray, shape (n,)
            Times in s.
        positions : ndarray, shape (n, columns)
            In m, of the components in question.
        slow, far : bool
            The doubts.
        why : str
            Beside which length or duration they are implausible; empty for the mean speed alone.
        """
        looks = ["its times look like milliseconds"] * slow + ["its positions look like millimetres"] * far
        if not looks:
            return
        speed = f"a mean speed of {mean_speed(t, positions):.3g} m/s"
        values = [f"{t[-1] - t[0]:g} s"] * slow + [f"up to {np.abs(positions).max():g} m"] * far
        small = ["time [ms]"] * slow + [f"{self.column} [mm] and so on"] * far
        plain = ["time [s]"] * slow + [f"{self.column} [m]"] * far
        raise InvalidReference(
            f"{self.file}: {' and '.join(looks)}, for {' and '.join(values)} would make {speed}{why}: write"
            f" {' and '.join(small)} into the header, or {' and '.join(plain)} if they are right"
        )


def mean_speed(t: FloatArray, positions: FloatArray) -> float:
    """Return the mean speed between rows in m/s."""
    way = float(np.linalg.norm(np.diff(positions, axis=0), axis=1).sum())
    return way / float(t[-1] - t[0]) if t[-1] > t[0] else 0.0


def doubtful_units(t: FloatArray, positions: FloatArray) -> tuple[bool, bool]:
    """Return whether times look like milliseconds, and positions like millimetres, judged without a scene.

    The mean speed shows that one unit is wrong. It does not show that both are, since their ratio is that of m and s: a
    path that is both long and far is doubtful too.

    Parameters
    ----------
    t : ndarray, shape (n,)
        Times in s.
    positions : ndarray, shape (n, columns)
        In m.
    """
    speed = mean_speed(t, positions)
    if not speed > 0.0:
        return False, False
    long = bool(t[-1] - t[0] >= _LONG and np.diff(t).min() >= _SPACING)
    far = bool(np.abs(positions).max() >= _FAR)
    return long and (speed < _SLOW or far), far and (speed > _FAST or long)


def require_likely_units(path: Reference, own: Reference, home: Sequence[float], units: Sequence[str]) -> None:
    """Raise `InvalidReference` if a path from a file is implausibly long or far for a scene, and declares no units.

    Times are compared with the duration of the path that the scene has and with the period of a pendulum as long as the
    scene reaches; positions with that reach. A declared unit is never doubted.

    Parameters
    ----------
    path, own : Reference
        The new path, and that of the scene.
    home : sequence of float
        Outputs of the scene's model at home.
    units : sequence of str
        Units of the outputs.
    """
    undeclared = path.undeclared
    lengths = [k for k, unit in enumerate(units) if unit == "m"]
    if undeclared is None or not lengths:
        return
    t, usual = (np.linspace(each.start_time, each.end_time, _INSTANTS) for each in (path, own))
    positions = path.jet(t, 0)[:, 0, lengths]
    reach = max(np.abs(own.jet(usual, 0)[:, 0, lengths]).max(), np.abs(np.array(home)[lengths]).max())
    period = 2.0 * math.pi * math.sqrt(reach / _GRAVITY)
    slow = undeclared.spacing >= _SPACING and path.duration >= _LONGER * max(own.duration, period)
    open_lengths = [place in undeclared.positions for place in lengths]
    far = bool(np.abs(positions[:, open_lengths]).max(initial=0.0) >= _FARTHER * reach)
    why = f", while the scene has a path of {own.duration:.3g} s and reaches {reach:.3g} m"
    undeclared.require_likely(t, positions, slow, far, why)
