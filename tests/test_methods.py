from __future__ import annotations

import pytest
from problems import METHODS
from suite import MethodSuite


@pytest.mark.parametrize("by", METHODS, ids=lambda by: by.method.name)
class TestEveryMethod(MethodSuite):
    pass
