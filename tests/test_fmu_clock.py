"""The clock is the host's: whatever its round-off, steps go on; steps back and gaps are refused with both numbers."""

from __future__ import annotations

import math

import numpy as np
import pytest
from fmu_host import Host, fmu_file

import servocore as sc
from crane_fmu.catalogue import KINDS

START_TIMES = (0.0, -7.5, 1e6, 1e9)
CRANE = sc.scenes.rotary_crane()


@pytest.mark.parametrize("start", START_TIMES)
@pytest.mark.parametrize("name", KINDS)
def test_every_fmu_takes_the_time_that_the_host_tells(name: str, start: float) -> None:
    h = 1e-3
    with Host(fmu_file(name)) as host:
        host.start(time=start)
        for i in range(500 if name != "LoadTrajectory" else 200_000):
            assert host.step(start + i * h, h), host.messages


def test_outputs_do_not_depend_on_when_the_run_begins() -> None:
    jets = CRANE.reference.jet(8.0 + 0.01 * np.arange(200), 4)
    rows = []
    for start in START_TIMES:
        with Host() as host:
            host.set(connected="position").start(jets[0], start)
            for i, jet in enumerate(jets):
                host.tell(jet)
                assert host.step(start + i * 0.01, 0.01), host.messages
            rows.append(host.outputs())
    for row in rows[1:]:
        np.testing.assert_allclose(row, rows[0], rtol=1e-9, atol=1e-9)


def test_a_step_back_and_a_gap_are_refused_with_all_digits() -> None:
    with Host() as host:
        host.start(time=1e9)
        assert host.step(1e9, 1e-3)
        present = 1e9 + 1e-3
        for asked, where in ((1e9, "behind"), (1e9 + 2e-3, "ahead of")):
            assert not host.step(asked, 1e-3)
            assert f"t = {asked:.16g} s lies {where} the FMU's time {present:.16g} s" in host.messages[-1]
            assert f"{asked:.16g}" != f"{present:.16g}"
    assert math.ulp(1e9) < 1e-3
