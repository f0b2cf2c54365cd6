"""Rigid bodies by directors, and their joints: another name of `servocore.model.rotationless`."""

from servocore.model.rotationless import *  # noqa: F403
from servocore.model.rotationless import __all__  # noqa: F401
