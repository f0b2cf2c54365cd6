"""Settings of the whole test run. Problems come from `problems`, inherited tests from `suite`."""

from __future__ import annotations

import pytest
from hypothesis import HealthCheck, settings

pytest.register_assert_rewrite("problems", "suite")

# The same examples every time, and no stop-watch: compilation makes first examples slow.
settings.register_profile("repeatable", derandomize=True, deadline=None, suppress_health_check=[HealthCheck.too_slow])
settings.load_profile("repeatable")
