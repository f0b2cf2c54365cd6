from __future__ import annotations

import pytest
from problems import FORMULATIONS, MODELS
from suite import FormulationSuite


@pytest.mark.parametrize("of", FORMULATIONS, ids=lambda of: of.formulation.name)
@pytest.mark.parametrize(("scene_name", "model"), MODELS)
class TestEveryFormulation(FormulationSuite):
    pass
