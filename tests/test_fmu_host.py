"""What a host may do to the FMU: wrong inputs and steps, going back, several instances, faults inside."""

from __future__ import annotations

import re
from collections.abc import Callable

import numpy as np
import pytest
from fmpy import simulate_fmu
from fmu_host import Host, fmu_file, follow, in_a_process, promised
from test_sentences import MISTAKES as SENTENCES

import servocore as sc
from crane_fmu.catalogue import KINDS

CRANE = sc.scenes.rotary_crane()
MISTAKES: dict[str, tuple[Callable[[Host], object], ...]] = {  # those of which `test_sentences` knows nothing
    "RotaryCrane": (
        lambda host: host.step(0.0, 0.1),
        lambda host: host.start().set(internal_step=1e-9).step(0.0, 0.1),
        lambda host: all(
            host.set(**{"load.position[1]": 5.0 + 0.1 * k}).step(0.1 * k, 0.1) for k in range(3 * bool(host.start()))
        ),
        lambda host: (
            host.set(formulation="projected", input_time="end")
            .start()
            .set(**{"load.position[1]": -5.0})
            .step(0.0, 20.0)
        ),
    ),
    "CranePlant": (
        lambda host: host.set(brakes="none").start().set(M_w=100.0).step(0.0, 0.1),
        lambda host: host.start().set(M_b=1e300, M_w=-98.1).step(0.0, 0.1),
    ),
    "LoadTrajectory": (
        lambda host: host.start().step(0.0, 3.0) and host.set(trigger=1.0).step(3.0, 0.1),
        lambda host: host.start().step(0.0, 30.0) and host.set(trigger=1.0, profile="file").step(30.0, 0.1),
        lambda host: host.set(profile="file").start().step(0.0, 0.1),
    ),
}


@pytest.mark.parametrize("name", KINDS)
def test_every_refusal_is_the_sentence_that_the_page_promises(name: str) -> None:
    told = [each for each in promised(name) if each not in {mistake.sentence for mistake in SENTENCES}]
    for mistake, sentence in zip(MISTAKES[name], told, strict=True):
        with Host(fmu_file(name)) as host:
            assert not mistake(host)
            assert host.messages[-1].removeprefix("the initialization failed: ") == sentence


@pytest.mark.parametrize(("h", "reached"), [(20.0, 0.0), (5.0, 10.0)])  # the first step, and one like the step before
def test_a_step_that_lands_on_another_branch_is_refused_and_smaller_ones_go_on(h: float, reached: float) -> None:
    with Host() as host:
        host.set(formulation="projected", input_time="end").start(CRANE.reference.jet(0.0, 4))
        t = 0.0
        while host.tell(CRANE.reference.jet(t + h, 4)).step(t, h):
            t += h
        assert t == reached
        assert re.search(rf"at t = {t + h:g} s s is -2\.\S* m, on another branch of the equations", host.messages[-1])
        before = host.outputs()
        assert before[4] > 0.0
        for k in range(1, 11):
            assert host.tell(CRANE.reference.jet(t + 0.1 * k, 4)).step(t + 0.1 * (k - 1), 0.1), host.messages
        assert host["s"] == pytest.approx(CRANE.exact(np.array([t + 1.0]))["s"][0], abs=1e-3)


def test_fmpy_stops_short_at_a_refused_step_and_says_why() -> None:
    heights = [(0.0, -5.0), (0.65, -5.0), (0.7, 5.0), (1.0, 5.0)]
    table = np.array(heights, dtype=[("time", float), ("load.position[3]", float)])
    messages = []
    result = simulate_fmu(
        str(fmu_file()),
        stop_time=1.0,
        output_interval=0.1,
        input=table,
        debug_logging=True,
        logger=lambda _, __, ___, ____, message: messages.append(message.decode()),
        step_finished=lambda *_: not any("is not below" in each for each in messages),  # it asks for that step for ever
    )
    assert result["time"][-1] < 0.9
    assert "the load is not below the girder" in messages[-1]


def test_a_failed_initialization_is_told_by_every_step_and_outputs_are_nan() -> None:
    with Host() as host:
        host.set(model="ring").start()
        for _ in range(2):
            assert not host.step(0.0, 0.1)
        assert len(host.messages) == 3
        assert all(each.startswith("the initialization failed: model = 99 is unknown") for each in host.messages)
        assert np.isnan(host.outputs()).all()
        host.fmu.reset()
        assert host.start().step(0.0, 0.1)


def test_nothing_is_logged_with_logging_off_and_the_numbers_are_the_same() -> None:
    t = np.arange(51.0) * 0.1
    jets = CRANE.reference.jet(t, 4)
    with Host(logging=False) as quiet, Host(logging=True) as loud:
        found = follow(quiet, jets, t), follow(loud, jets, t)
        assert not quiet.step(0.0, 0.1)
        assert quiet.messages == []
        assert found[0]["M_b"].tolist() == found[1]["M_b"].tolist()


FAULT = """
import gc, sys
from pathlib import Path
import numpy as np
from fmu_host import Host
gc.freeze()  # to look at what was imported again and again takes most of the time
with Host(Path(sys.argv[1])) as host:
    host.start()
    assert host.step(0.0, 0.1)
    (slave,) = [module for name, module in sys.modules.items() if name.endswith("_bundle.kernel")]
    state = host.fmu.getFMUState()
    def fail(*_, **__):
        raise sys.modules["builtins"].__dict__[sys.argv[2]]("on purpose")
    made = [each for each in gc.get_objects() if isinstance(each, slave.ctypes.PyDLL)]
    (library,) = [each for each in made if "fmi2DoStep" in vars(each)]
    for call in ("DoStep", "SetReal", "SetInteger", "GetReal", "GetInteger", "SetFMUstate", "GetFMUstate"):
        kept = getattr(library, f"fmi2{call}")
        setattr(library, f"fmi2{call}", fail)
        assert host.step(0.1, 0.1) == (call != "DoStep")
        host.set(load_mass=100.0, model="points")
        host.fmu.setFMUState(state)
        host.outputs()
        host.fmu.getInteger([host.references["model"]])
        host.fmu.freeFMUState(host.fmu.getFMUState())
        gc.collect()
        setattr(library, f"fmi2{call}", kept)
        host.fmu.setFMUState(state)
    host.fmu.setFMUState(state)
    assert host.step(0.1, 0.1), host.messages
    assert np.isfinite(host.outputs()).all()
    assert any("internal error in do_step" in each and "on purpose" in each for each in host.messages)
gc.collect()
print("alive")
"""


@pytest.mark.parametrize("kind", ["RuntimeError", "MemoryError", "KeyboardInterrupt", "SystemExit"])
def test_an_exception_in_a_callback_neither_ends_nor_harms_the_host(kind: str) -> None:
    done = in_a_process(FAULT, fmu_file(), kind)
    assert done.stdout.strip() == "alive", done.stderr
    assert done.returncode == 0
