"""CranePlant.fmu and LoadTrajectory.fmu: right numbers, refusals with sentences, states that go back and forth."""

from __future__ import annotations

import json
import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from fmpy.validation import validate_fmu
from fmu_host import UNKNOWN, Host, described, fmu_file, in_a_process, promised

import servocore as sc
from crane_fmu.build.page import user_page
from crane_fmu.catalogue import KINDS
from servocore.numerics.compiled_calls import Array

CRANE = sc.scenes.rotary_crane()
OTHERS = ("LoadTrajectory", "CranePlant")
LOAD = tuple(f"load.position[{k}]" for k in (1, 2, 3))


def plant(**settings: float | str) -> Host:
    return Host(fmu_file("CranePlant")).set(**settings)


def trajectory(**settings: float | str) -> Host:
    return Host(fmu_file("LoadTrajectory")).set(**settings)


def load(host: Host) -> Array:
    return np.array([host[name] for name in LOAD])


@pytest.mark.parametrize("name", OTHERS)
def test_fmpy_finds_no_problems(name: str) -> None:
    assert validate_fmu(str(fmu_file(name))) == []


# The plant ---------------------------------------------------------------------------------------------------------


def follow(host: Host, step: float, inputs: Callable[[float], Any], until: float = 2.0, at: str = "start") -> Array:
    """Drive the plant with sampled inputs."""
    host.set(input_time=at)
    u = inputs(0.0)
    host.set(M_b=u[0], F=u[1], M_w=u[2]).start()
    for k in range(round(until / step)):
        u = inputs((k + (at == "end")) * step)
        host.set(M_b=u[0], F=u[1], M_w=u[2])
        assert host.step(k * step, step), host.messages
    return load(host)


def push(time: float) -> tuple[Array, Array, Array]:
    return 300.0 * np.sin(time), 20.0 * np.sin(2 * time), -98.1 + 5.0 * np.sin(time)


def exact() -> Array:
    path = sc.rest_to_rest((5.0, 0.0, -5.0), (5.0 + 1e-9, 0.0, -5.0), 2.0)
    found = sc.simulate(CRANE.with_reference(path), lambda t: np.array(push(t)), t=np.array([0.0, 2.0]))
    return np.array([found[name][-1] for name in "xyz"])


@pytest.mark.parametrize(("settings", "order"), [({}, 2.0), ({"hold": "zero_order"}, 1.0), ({"at": "end"}, 2.0)])
def test_continuing_the_inputs_linearly_makes_the_error_of_second_order(settings: dict[str, str], order: float) -> None:
    at, errors = settings.pop("at", "start"), []
    for step in (0.02, 0.01):
        with plant(**settings) as host:
            errors.append(np.linalg.norm(follow(host, step, push, at=at) - exact()))
    assert np.log2(errors[0] / errors[1]) == pytest.approx(order, abs=0.25)


def test_at_10_ms_the_hold_costs_less_than_a_tenth_of_holding_the_inputs() -> None:
    errors = []
    for hold in ("first_order", "zero_order"):
        with plant(hold=hold) as host:
            errors.append(np.linalg.norm(follow(host, 0.01, push) - exact()))
    assert errors[0] < 0.1 * errors[1]


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


def test_wind_pushes_the_load_away() -> None:
    with plant(**{"wind[2]": 20.0}) as host:
        host.set(M_w=-98.1).start()
        for k in range(20):
            assert host.step(k * 0.01, 0.01)
        assert load(host)[1] == pytest.approx(0.5 * 0.2 * 0.2**2, rel=0.05)


def test_a_gust_begins_and_ends_between_communication_points() -> None:
    ends = []
    for step in (0.1, 0.01):
        with plant(**{"gust[1]": 200.0, "gust_start": 0.123, "gust_duration": 0.2}) as host:
            host.set(M_w=-98.1).start()
            for k in range(round(1.0 / step)):
                assert host.step(k * step, step)
            ends.append(load(host))
    np.testing.assert_allclose(ends[0], ends[1], atol=1e-8)


def test_a_mass_error_makes_the_load_heavier() -> None:
    with plant(mass_error=0.05) as host:
        host.set(M_w=-98.1).start()
        assert host["tension"] == pytest.approx(981.0 * 1.05 - 105.0 * host_acceleration(), rel=1e-9)


def host_acceleration() -> float:
    """Of a load of 105 kg on a winch that holds 100 kg."""
    return (105.0 - 100.0) * 9.81 / (105.0 + 10.0)


def test_it_may_start_in_motion_and_swinging() -> None:
    start = {"start.position[1]": 3.0, "start.position[2]": 4.0, "start.velocity[1]": 0.5, "start.swing[1]": 0.1}
    with plant(**start) as host:
        host.start()
        assert (host["s"], host["s_dot"]) == pytest.approx((5.0, 0.3))
        assert host["phi"] == pytest.approx(math.atan2(4.0, 3.0))
        assert host["phi_dot"] == pytest.approx(-4.0 * 0.5 / 25.0)
        assert load(host)[2] == pytest.approx(-5.0 * math.cos(0.1))


def mistakes() -> dict[str, tuple[Callable[[Host], object], ...]]:
    """What a host does wrong, in the order of the pages' sentences."""
    return {
        "CranePlant": (
            lambda host: host.start().set(F=math.nan).step(0.0, 0.1),
            lambda host: host.set(brakes="none").start().set(M_w=100.0).step(0.0, 0.1),
            lambda host: host.start().set(M_b=1e300, M_w=-98.1).step(0.0, 0.1),
            lambda host: host.set(**{"start.position[3]": 1.0}).start().step(0.0, 0.1),
            lambda host: host.start().step(0.0, -0.1),
            lambda host: host.start().set(mass_error=-2.0).step(0.0, 0.1),
        ),
        "LoadTrajectory": (
            lambda host: host.set(ramp=3.0).start().step(0.0, 0.1),
            lambda host: host.set(profile="three-phase", ramp=11.0).start().step(0.0, 0.1),
            lambda host: host.set(profile="file").start().step(0.0, 0.1),
            lambda host: host.set(duration=math.nan).start().step(0.0, 0.1),
            lambda host: host.start().step(0.0, 0.1) and host.step(0.0, 0.1),
        ),
    }


@pytest.mark.parametrize("name", OTHERS)
def test_every_refusal_is_the_sentence_that_the_page_promises(name: str) -> None:
    for mistake, sentence in zip(mistakes()[name], promised(name), strict=True):
        with Host(fmu_file(name)) as host:
            assert not mistake(host)
            assert host.messages[-1].endswith(sentence)


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
def test_a_state_goes_on_bit_by_bit_here_and_in_another_process(name: str, tmp_path: Path) -> None:
    outputs = [each.name for each in described(name, "output")]
    with Host(fmu_file(name)) as host:
        if name == "CranePlant":
            host.set(M_b=50.0, F=1.0, M_w=-97.0)
        host.start()
        for k in range(5):
            assert host.step(k * 0.1, 0.1)
        kept = host.fmu.getFMUState()
        assert host.step(0.5, 0.1)
        wanted = [host[each] for each in outputs]
        assert host.step(0.6, 0.1)
        host.fmu.setFMUState(kept)
        state = bytes(host.fmu.serializeFMUstate(kept))
        assert host.step(0.5, 0.1)
        assert [host[each] for each in outputs] == wanted
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


# The trajectory ----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("profile", ["degree9", "degree13", "three-phase"])
def test_a_trajectory_has_all_derivatives_of_its_line(profile: str) -> None:
    law = {"degree9": sc.DEGREE9, "degree13": sc.DEGREE13, "three-phase": sc.three_phase(4.0)}[profile]
    path = sc.rest_to_rest((1.0, 2.0, -3.0), (5.0, 0.0, -4.0), 12.0, law, start_time=1.0)
    points = {f"start[{k + 1}]": v for k, v in enumerate((1.0, 2.0, -3.0))}
    points |= {f"end[{k + 1}]": v for k, v in enumerate((5.0, 0.0, -4.0))}
    more = {"ramp": 4.0} if profile == "three-phase" else {}
    names = [each.name for each in described("LoadTrajectory", "output")]
    with trajectory(**points, **more, duration=12.0, start_time=1.0, profile=profile) as host:
        host.start()
        for k in range(28):
            assert host.step(0.5 * k, 0.5)
            found = np.array([host[name] for name in names]).reshape(5, 3)
            np.testing.assert_allclose(found, path.jet(0.5 * (k + 1), 4), atol=1e-12)


def test_it_starts_where_the_crane_and_the_plant_do() -> None:
    with trajectory() as host, plant() as other:
        np.testing.assert_array_equal(load(host.start()), load(other.start()))


@pytest.mark.parametrize("name", KINDS)
def test_the_page_in_the_documentation_is_the_one_in_the_fmu(name: str) -> None:
    from test_fmu_build import ROOT, members

    kind = KINDS[name]
    written = (ROOT / "docs" / kind.page).read_text(encoding="utf-8")
    wanted = user_page(kind, fmu_file(name).read_bytes())
    assert written == wanted, f"run: python build_fmu.py --fmu {name} --page docs/{kind.page}"
    html = members(fmu_file(name))["documentation/index.html"].decode()
    assert html.startswith("<!DOCTYPE html>")
    for each in described(name):
        assert f"<code>{each.name}</code>" in html
    for heading in ("purpose", "Steps", "refuse", "Licence"):
        assert heading.lower() in html.lower(), heading
    assert "<pre>" in html  # the sketch
    assert 'href="' not in html  # inside the FMU there are no other pages
