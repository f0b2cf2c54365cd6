"""Formulations and methods that users choose by name."""

from __future__ import annotations

from collections.abc import Mapping

from servocore.formulations.base import Formulation
from servocore.formulations.original import Original
from servocore.formulations.projected import Projected
from servocore.formulations.reduced import Reduced
from servocore.methods.backward_euler import BackwardEuler
from servocore.methods.base import Method
from servocore.methods.bdf import BDF
from servocore.methods.collocation import Gauss, RadauIIA
from servocore.methods.generalized_alpha import GeneralizedAlpha
from servocore.methods.trapezoidal import Trapezoidal

FORMULATIONS: Mapping[str, Formulation] = {"reduced": Reduced(), "projected": Projected(), "original": Original()}
"""Formulations; the first is the default."""

METHODS: Mapping[str, Method] = {
    "backward-euler": BackwardEuler(),
    **{f"bdf{order}": BDF(order) for order in range(1, 7)},
    **{f"radau{stages}": RadauIIA(stages) for stages in range(1, 6)},
    "trapezoidal": Trapezoidal(),
    **{f"gauss{stages}": Gauss(stages) for stages in range(1, 6)},
    "generalized-alpha": GeneralizedAlpha(),
}
"""Methods, BDF by order, Radau and Gauss by stages; the first is the default."""
