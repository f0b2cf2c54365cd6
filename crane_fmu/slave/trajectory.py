"""The slave of LoadTrajectory.fmu: a load path from rest to rest or from a table, with its derivatives up to snap."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from crane_fmu.slave.base import TableSlave, required
from crane_fmu.slave.interface import DIMENSION, FROM_FILE, ORDERS, PATH_FILE, components
from crane_fmu.slave.saved_state import PlainState
from crane_fmu.slave.straight_lines import require_no_ramp, straight_line
from servocore import InvalidReference, InvalidSetting, Reference, from_csv


@dataclass(frozen=True, eq=False)
class Instant(PlainState):
    """The state of a trajectory is the time."""

    time: float


class Slave(TableSlave):
    """A load path with its derivatives."""

    description = "Path of a crane's load with its derivatives up to snap: a straight line from rest to rest, or a file"
    state_type = Instant

    def __init__(self, **kwargs: Any) -> None:
        super().__init__(**kwargs)
        self._path: Reference | None = None
        self._numbers = self._references(*components("start", "end"), "duration", "start_time", "ramp")

    def _prepare(self) -> None:
        profile = self._setting("profile")
        *points, duration, start_time, ramp = self._checked(self._numbers)
        self._path = None
        if profile == FROM_FILE:
            require_no_ramp(profile, ramp)
            self._path = self._from_file()
        else:
            start, end = points[:DIMENSION], points[DIMENSION:]
            self._path = straight_line(start, end, duration, profile, ramp if ramp > 0.0 else None, start_time)

    def _from_file(self) -> Reference:
        file = self._resources / PATH_FILE
        if not file.is_file():
            raise InvalidSetting(f"the profile {FROM_FILE} needs a table resources/{PATH_FILE} in the FMU")
        try:
            path = from_csv(file)
        except ImportError as error:
            raise InvalidReference(
                f"{PATH_FILE} has fewer than five groups of columns, and to fit a path through it this Python lacks a"
                f" package: {error}; give positions, velocities, accelerations, jerks and snaps"
            ) from error
        if path.dimension != DIMENSION:
            raise InvalidReference(f"{PATH_FILE} has {path.dimension} components, a load has {DIMENSION}")
        return path

    def _begin(self, time: float) -> Instant:
        return Instant(time)

    def _advance(self, now: Instant, h: float) -> Instant:
        return Instant(now.time + h)

    def _output_values(self, state: Instant) -> Sequence[float]:
        jet = required(self._path).jet(np.array([state.time]), len(ORDERS) - 1)
        values: list[float] = jet.ravel().tolist()
        return values
