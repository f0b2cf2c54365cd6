"""Scenes: one file each, with sketch, equations, parameters, closed form; one line each in the list below."""

from collections.abc import Callable
from typing import TYPE_CHECKING

from servocore.model.limits import Limit
from servocore.model.scene import Scene
from servocore.scenes.boom_crane import boom_crane
from servocore.scenes.cars import cars
from servocore.scenes.elastic_bar import elastic_bar
from servocore.scenes.gantry_crane import gantry_crane
from servocore.scenes.heavy_rope import heavy_rope
from servocore.scenes.inteco import inteco
from servocore.scenes.loop_manipulator import loop_manipulator
from servocore.scenes.mass_on_car import mass_on_car
from servocore.scenes.overhead_crane import overhead_crane
from servocore.scenes.passive_joint_arm import passive_joint_arm
from servocore.scenes.quadrotor_with_load import quadrotor_with_load
from servocore.scenes.rotary_crane import rotary_crane

if TYPE_CHECKING:
    from servocore.importers.from_file import from_file as from_file

__all__ = [  # noqa: RUF022 - in the order in which they are listed everywhere
    "rotary_crane",
    "overhead_crane",
    "gantry_crane",
    "boom_crane",
    "inteco",
    "cars",
    "mass_on_car",
    "passive_joint_arm",
    "loop_manipulator",
    "elastic_bar",
    "heavy_rope",
    "quadrotor_with_load",
]

REGISTRY: dict[str, Callable[[], Scene]] = {name: globals()[name] for name in __all__}
"""All scenes by name; each inherits the whole test suite."""

__all__ += ["REGISTRY", "Limit", "Scene", "from_file"]


def __getattr__(name: str) -> object:
    """Import `from_file` at its first use: few programs read robot files."""
    if name != "from_file":
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    from servocore.importers.from_file import from_file  # noqa: PLC0415

    return from_file
