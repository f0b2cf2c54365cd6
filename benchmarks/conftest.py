"""The ratios that `make bench` prints below pytest-benchmark's table."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pytest

MEDIANS: dict[str, float] = {}
"""Microseconds a step or an instant, by name; filled by the benchmarks."""

BARE, CLOSED_FORM = "bare CasADi loop", "closed form, vectorized"


@pytest.fixture
def record(benchmark: Any) -> Callable[[str, int], None]:
    """Return the function that notes what a measured run of so many steps took."""

    def note(name: str, steps: int) -> None:
        if benchmark.stats is not None:  # benchmarks may be disabled
            MEDIANS[name] = 1e6 * benchmark.stats.stats.median / steps
            benchmark.extra_info["microseconds_a_step"] = MEDIANS[name]

    return note


def pytest_terminal_summary(terminalreporter: pytest.TerminalReporter) -> None:
    """Print microseconds a step, and ratios to the bare loop and to the closed form."""
    if not MEDIANS:
        return
    terminalreporter.section("rotary crane, a step or an instant")
    terminalreporter.write_line(f"{'':58}{'µs':>9}  {'to bare loop':>13}  {'to closed form':>15}")
    for name, value in sorted(MEDIANS.items(), key=lambda each: each[1]):
        ratios = [f"{value / MEDIANS[other]:.3g}" if other in MEDIANS else "-" for other in (BARE, CLOSED_FORM)]
        terminalreporter.write_line(f"{name:58}{value:9.3g}  {ratios[0]:>13}  {ratios[1]:>15}")
