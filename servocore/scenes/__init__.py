"""Scenes: one file each, with sketch, equations, parameters, closed form; one line each in the registry."""

from collections.abc import Callable

from servocore.model.limits import Limit
from servocore.model.scene import Scene
from servocore.scenes.boom_crane import boom_crane
from servocore.scenes.cars import cars
from servocore.scenes.elastic_bar import elastic_bar
from servocore.scenes.gantry_crane import gantry_crane
from servocore.scenes.mass_on_car import mass_on_car
from servocore.scenes.overhead_crane import overhead_crane
from servocore.scenes.passive_joint_arm import passive_joint_arm
from servocore.scenes.quadrotor_with_load import quadrotor_with_load
from servocore.scenes.rotary_crane import rotary_crane

REGISTRY: dict[str, Callable[[], Scene]] = {
    "rotary_crane": rotary_crane,
    "overhead_crane": overhead_crane,
    "gantry_crane": gantry_crane,
    "boom_crane": boom_crane,
    "cars": cars,
    "mass_on_car": mass_on_car,
    "passive_joint_arm": passive_joint_arm,
    "elastic_bar": elastic_bar,
    "quadrotor_with_load": quadrotor_with_load,
}
"""All scenes by name; what is listed here inherits the whole test suite."""

__all__ = [
    "REGISTRY",
    "Limit",
    "Scene",
    "boom_crane",
    "cars",
    "elastic_bar",
    "gantry_crane",
    "mass_on_car",
    "overhead_crane",
    "passive_joint_arm",
    "quadrotor_with_load",
    "rotary_crane",
]
