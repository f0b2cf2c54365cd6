"""Cranes, durations, and what an independent study found of two of them."""

from __future__ import annotations

from dataclasses import dataclass, field

import servocore as sc
from benchmarks.chart.paths import straight

DURATIONS = (20.0, 10.0, 5.0)
LOOPS = sc.PositionLoops(bandwidth=6.0, damping=1.0)


@dataclass(frozen=True)
class Case:
    """A crane with its path, and values of the effects' parameters."""

    name: str
    scene: sc.Scene
    parameters: dict[str, float] = field(default_factory=dict)

    def over(self, duration: float) -> sc.Scene:
        """Return the scene with its path in a time in s."""
        path = straight(self.scene)
        return self.scene.with_reference(sc.rest_to_rest(path.start, path.end, duration))


BIG = {"bridge_inertia": 4000.0, "trolley_mass": 350.0, "load_mass": 2000.0, "winch_inertia": 5.0, "winch_radius": 0.25}
BIG_EFFECTS = {
    "rope_stiffness": 1.5e7, "bridge_friction": 250.0, "trolley_friction": 230.0, "winch_friction": 590.0,
    "drag_area": 4.0, "hook_mass": 50.0, "body_gyration": 0.6, "exit_side": 0.3, "exit_drop": 1.0,
}  # fmt: skip


def cases() -> tuple[Case, ...]:
    """Return the rotary crane, a big one, the gantry and the overhead crane; all paths start five metres below."""
    overhead = sc.scenes.overhead_crane().with_reference(sc.rest_to_rest((0.0, -5.0), (5.0, -2.0), 10.0))
    return (
        Case("rotary crane", sc.scenes.rotary_crane()),
        Case("big rotary crane", sc.scenes.rotary_crane().with_parameters(**BIG), BIG_EFFECTS),
        Case("gantry crane", sc.scenes.gantry_crane()),
        Case("overhead crane", overhead),
    )


STUDY = {
    "rotary crane": {
        "elastic rope": (0.56, 0.57, 0.62), "friction": (81, 76, 66), "winch inertia": (0.18, 0.73, 4.1),
        "air drag": (3.7, 16, 53), "wind": (420, 490, 400), "sheave offset": (124, 128, 310), "rope mass": (12, 16, 38),
        "hook": (0.18, 3.0, 29), "load inertia": (0.05, 1.3, 21), "flexible bridge": (11, 40, 91),
    },
    "big rotary crane": {
        "elastic rope": (3.8, 3.8, 4.1), "friction": (48, 45, 44), "winch inertia": (0.08, 0.31, 1.7),
        "air drag": (0.61, 3.0, 10), "wind": (73, 90, 76), "sheave offset": (240, 260, 590),
        "rope mass": (0.66, 0.73, 1.1), "hook": (0.07, 1.3, 13), "load inertia": (0.12, 3.7, 58),
        "flexible bridge": (13, 59, 140),
    },
}  # fmt: skip
"""Errors in mm over 20, 10 and 5 s with the same drives, found by forward simulation in another program, degree 9 for
all rows. Its rope mass slides past eight nodes, and its load inertia follows the path with its centre of mass."""
STUDY_OPEN = {
    "rotary crane": {
        "elastic rope": (180, 44, 12), "friction": (6300, 4300, 1900), "winch inertia": (270, 280, 300),
        "air drag": (240, 220, 220), "wind": (43000, 10000, 3300), "sheave offset": (260, 250, 610),
    },
    "big rotary crane": {
        "elastic rope": (1200, 310, 88), "friction": (6800, 4700, 2800), "winch inertia": (120, 120, 130),
        "air drag": (69, 63, 61), "wind": (6700, 3300, 1300), "sheave offset": (910, 920, 910),
    },
}  # fmt: skip
"""The same without drives."""
