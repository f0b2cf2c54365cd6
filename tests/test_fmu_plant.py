"""CranePlant.fmu's brakes and start; what all three FMUs have in common: states, pages."""

from __future__ import annotations

import json
import math
import re
from pathlib import Path

import numpy as np
import pytest
from fmu_host import UNKNOWN, Host, described, fmu_file, in_a_process, members

import servocore as sc
from crane_fmu.build.page import TEMPLATES, documentation_page
from crane_fmu.catalogue import KINDS
from servocore.numerics.compiled_calls import Array

CRANE = sc.scenes.rotary_crane()
LOAD = tuple(f"load.position[{k}]" for k in (1, 2, 3))


def plant(**settings: float | str) -> Host:
    return Host(fmu_file("CranePlant")).set(**settings)


def load(host: Host) -> Array:
    return np.array([host[name] for name in LOAD])


def test_with_nothing_connected_the_brakes_hold_and_the_load_hangs() -> None:
    with plant(hold="zero_order") as host:
        host.start()
        for k in range(10):
            assert host.step(k * 0.1, 0.1)
        np.testing.assert_allclose(load(host), (5.0, 0.0, -5.0), atol=1e-9)
        assert host["tension"] == pytest.approx(981.0)
        host.set(M_w=-98.1)
        assert host.step(1.0, 0.1)
        host.set(M_w=0.0)  # once released they stay so
        assert host.step(1.1, 0.1)
        assert load(host)[2] < -5.001


@pytest.mark.parametrize("pushed", [{"wind[1]": 20.0}, {"gust[2]": 20.0}, {"start.swing[1]": 0.1}], ids=str)
def test_brakes_hold_bridge_trolley_and_winch_of_a_load_that_is_pushed_or_swings(pushed: dict[str, float]) -> None:
    with plant(**{"gust_duration": 1.0, **pushed}) as host:
        host.start()
        before = load(host)
        for k in range(10):
            assert host.step(k * 0.1, 0.1)
        assert (host["phi"], host["s"], host["l"]) == pytest.approx((0.0, 5.0, 5.0), abs=1e-9)
        assert np.linalg.norm(load(host) - before) > 0.05


def test_a_crane_that_starts_with_a_velocity_has_open_brakes() -> None:
    with plant(**{"start.velocity[1]": 0.5}) as host:
        host.start()
        assert host.step(0.0, 0.1)
        assert load(host)[2] < -5.01


def test_without_brakes_a_load_that_nobody_holds_falls_and_drives_the_winch() -> None:
    with plant(brakes="none", hold="zero_order") as host:
        host.start()
        assert host.step(0.0, 0.1)
        fall = 0.5 * 9.81 * 100.0 / 110.0 * 0.01
        assert load(host)[2] == pytest.approx(-5.0 - fall, rel=1e-6)


def test_it_may_start_in_motion_and_swinging() -> None:
    start = {"start.position[1]": 3.0, "start.position[2]": 4.0, "start.velocity[1]": 0.5, "start.swing[1]": 0.1}
    with plant(**start) as host:
        host.start()
        assert (host["s"], host["s_dot"]) == pytest.approx((5.0, 0.3))
        assert host["phi"] == pytest.approx(math.atan2(4.0, 3.0))
        assert host["phi_dot"] == pytest.approx(-4.0 * 0.5 / 25.0)
        assert load(host)[2] == pytest.approx(-5.0 * math.cos(0.1))


CONTINUE = """
import sys, json
from pathlib import Path
from fmu_host import Host
with Host(Path(sys.argv[1])) as host:
    host.fmu.setFMUState(host.fmu.deSerializeFMUstate(bytes(json.loads(Path(sys.argv[2]).read_text()))))
    assert host.step(0.5, 0.1), host.messages
    print(json.dumps([host[name] for name in json.loads(sys.argv[3])]))
"""


@pytest.mark.parametrize("name", KINDS)
def test_a_state_goes_on_bit_by_bit_in_another_process(name: str, tmp_path: Path) -> None:
    outputs = [each.name for each in described(name, "output")]
    with Host(fmu_file(name)) as host:
        if name == "CranePlant":
            host.set(M_b=50.0, F=1.0, M_w=-97.0)
        host.start()
        for k in range(5):
            assert host.step(k * 0.1, 0.1)
        state = bytes(host.fmu.serializeFMUstate(host.fmu.getFMUState()))
        assert host.step(0.5, 0.1)
        wanted = [host[each] for each in outputs]
    (tmp_path / "state").write_text(json.dumps(list(state)))
    done = in_a_process(CONTINUE, fmu_file(name), tmp_path / "state", json.dumps(outputs))
    assert json.loads(done.stdout) == wanted, done.stderr


@pytest.mark.parametrize("name", KINDS)
def test_a_state_of_an_initialization_that_will_fail_is_restored_all_the_same(name: str) -> None:
    setting = next(each.name for each in described(name, "parameter") if each.type == "Enumeration")
    output = described(name, "output")[0].name
    with Host(fmu_file(name)) as host, Host(fmu_file(name)) as other:
        for each in (host, other):
            each.fmu.setupExperiment()
            each.fmu.enterInitializationMode()
            assert math.isfinite(each[output])
        host.set(**{setting: "none such"})
        other.fmu.setFMUState(host.fmu.getFMUState())
        assert other.messages == []
        assert other.fmu.getInteger([other.references[setting]]) == [UNKNOWN]
        assert math.isnan(other[output])
        assert " = 99 is unknown" in other.messages[0]


@pytest.mark.parametrize("name", KINDS)
def test_the_page_in_the_documentation_is_the_one_in_the_fmu(name: str) -> None:
    from test_fmu_build import ROOT

    kind = KINDS[name]
    written = (ROOT / "docs" / kind.page).read_text(encoding="utf-8")
    html = members(fmu_file(name))["documentation/index.html"].decode()
    wrong = f"run: python build_fmu.py --fmu {name} --page docs/{kind.page}"
    assert html == documentation_page(kind, written), wrong
    template = (TEMPLATES / f"{kind.page}.j2").read_text(encoding="utf-8")
    assert re.findall(r"\]\(.*?\)", written) == re.findall(r"\]\(.*?\)", template), wrong
    assert html.startswith("<!DOCTYPE html>")
    for each in described(name):
        assert f"<code>{each.name}</code>" in html
    for heading in ("purpose", "Steps", "refuse", "Licence"):
        assert heading.lower() in html.lower(), heading
    assert "<pre>" in html  # the sketch
    assert 'href="' not in html  # inside the FMU there are no other pages
