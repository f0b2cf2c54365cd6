"""Hostile use of an FMU: any FMI calls in any order with any values, as a state machine of hypothesis.

    python hostile.py FMU SEQUENCES [SEED [SHRINK]]

Whatever happens the process must survive, the statuses must be right, a refused call must change nothing, and what an
instance answers must equal, to the last bit, what a fresh one answers that was only asked what was valid. The calls of
the running sequence are written to standard error before they are made: after a crash they are the last lines.
"""

from __future__ import annotations

import math
import os
import sys
import tempfile
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

import hypothesis.strategies as st
from fmpy import extract
from hostile_fmu import DISCARD, ERROR, OK, Fmu, Instance
from hypothesis import HealthCheck, Phase, seed, settings
from hypothesis.stateful import (
    Bundle,
    MultipleResults,
    RuleBasedStateMachine,
    consumes,
    initialize,
    multiple,
    rule,
    run_state_machine_as_test,
)

import servocore as sc
from servocore.numerics.compiled_calls import Array

HOSTILE = (math.nan, math.inf, -math.inf, 1e300, -1e300, -0.0, 5e-324, 0.0)
VALUES = st.sampled_from((*HOSTILE, 1.0, 5.0, -5.0, 0.1, 100.0))
STEPS = st.sampled_from((0.1, 0.1, 0.05, 0.01, 1e-7, 0.0, -0.0, -0.1, math.nan, math.inf, -math.inf, 1e300, 5e-324))
TIMES = st.sampled_from((0.0, 0.0, 2.5, -3.0, 1e6, math.nan, math.inf, -1e300))
MOST_INSTANCES = 3


def good_inputs(fmu: Fmu) -> list[list[float]]:
    """Inputs that nothing is wrong with: start values, and for a path a few instants of the default manoeuvre."""
    if not fmu.follows_a_path:
        return [fmu.start_inputs, fmu.start_inputs]
    reference = sc.scenes.rotary_crane().reference
    paths = [[float(x) for x in reference.jet(t, 4).ravel()] for t in (3.0, 7.5, 12.0)]
    return [fmu.start_inputs, *(path + fmu.start_inputs[15:] for path in paths)]


CHOSEN = st.integers(0, 3)


@dataclass
class Account:
    """What a fresh instance would have to be asked to be like this one: the valid calls, and where they led."""

    calls: list[tuple[object, ...]] = field(default_factory=list)
    phase: str = "instantiated"
    time: float = 0.0

    def copy(self) -> Account:
        return Account(list(self.calls), self.phase, self.time)


@dataclass(eq=False)
class Live:
    """An instance with its account and the states it gave."""

    instance: Instance
    account: Account
    states: list[tuple[int, Account]] = field(default_factory=list)


class Hostile(RuleBasedStateMachine):
    """Calls in any order; `fmu` is set before a run."""

    fmu: Fmu
    good: list[list[float]]
    lives = Bundle("lives")
    serialized = Bundle("serialized")

    def __init__(self) -> None:
        super().__init__()
        self.alive: list[Live] = []
        tell("--- a new sequence")

    # --- instances ------------------------------------------------------------------------------------------------

    @initialize(target=lives, count=st.integers(1, 2), jet=CHOSEN, well=st.booleans())
    def first(self, count: int, jet: Array, well: bool) -> MultipleResults[Live]:
        lives = [self.made() for _ in range(count)]
        if well:
            self.begin_well(lives[0], jet, 0.0)
            self.step_well(lives[0], jet, 2)
        return multiple(*lives)

    @rule(target=lives)
    def another(self) -> Live | MultipleResults[Live]:
        return self.made() if len(self.alive) < MOST_INSTANCES else multiple()

    def made(self) -> Live:
        live = Live(self.fmu.instance(tell), Account())
        self.alive.append(live)
        return live

    @rule(live=consumes(lives), states_first=st.booleans())
    def free(self, live: Live, states_first: bool) -> None:
        if live in self.alive:
            self.alive.remove(live)
            self.end(live, states_first=states_first)

    def end(self, live: Live, *, states_first: bool = True) -> None:
        if states_first:
            for state, _ in live.states:
                live.instance.free_state(state)
        live.instance.free()

    @rule(live=lives)
    def reset(self, live: Live) -> None:
        if live in self.alive:
            assert live.instance.call("Reset") == OK
            live.account = Account()

    # --- phases ---------------------------------------------------------------------------------------------------

    @rule(live=lives, time=TIMES)
    def setup(self, live: Live, time: float) -> None:
        self.move(live, ("setup", time), "instantiated", "instantiated", time)

    @rule(live=lives)
    def enter(self, live: Live) -> None:
        self.move(live, ("enter",), "instantiated", "initializing")

    @rule(live=lives)
    def leave(self, live: Live) -> None:
        self.move(live, ("leave",), "initializing", "stepping")

    @rule(live=lives)
    def terminate(self, live: Live) -> None:
        self.move(live, ("terminate",), "stepping", "terminated")

    def move(self, live: Live, call: tuple[object, ...], wanted: str, then: str, time: float | None = None) -> None:
        """Make a call that changes the phase; out of its phase it must change nothing."""
        if live not in self.alive:
            return
        account = live.account
        assert live.instance.do(call) == OK
        if wanted == account.phase:
            account.calls.append(call)
            account.phase = then
            account.time = account.time if time is None else time

    @rule(live=lives, jet=CHOSEN, time=st.sampled_from((0.0, 2.5)))
    def begin_well(self, live: Live, jet: Array, time: float) -> None:
        """Bring an instance to where it can step, whatever happened to it."""
        if live not in self.alive:
            return
        self.reset(live)
        self.setup(live, time)
        self.set_jet(live, jet)
        self.enter(live)
        self.leave(live)

    # --- values ---------------------------------------------------------------------------------------------------

    @rule(live=lives, data=st.data(), unknown=st.booleans())
    def set_reals(self, live: Live, data: st.DataObject, unknown: int) -> None:
        if live not in self.alive:
            return
        known = [each.reference for each in self.fmu.reals]
        count = data.draw(st.integers(0, 4))
        references = data.draw(st.lists(st.sampled_from(known), min_size=count, max_size=count))
        values = data.draw(st.lists(VALUES, min_size=count, max_size=count))
        late = live.account.phase in ("stepping", "terminated")
        kept = [pair for pair in zip(references, values, strict=True) if self.fmu.settable(pair[0], late=late)]
        if unknown:
            references, values = [*references, 4_294_967_290, 999], [*values, 1.0, 2.0]
        assert live.instance.set_reals(references, values) == OK
        if kept:
            live.account.calls.append(("set_reals", [r for r, _ in kept], [v for _, v in kept]))

    @rule(live=lives, jet=CHOSEN)
    def set_jet(self, live: Live, jet: Array) -> None:
        if live in self.alive:
            values = self.good[jet % len(self.good)]
            assert live.instance.set_reals(self.fmu.inputs, values) == OK
            live.account.calls.append(("set_reals", self.fmu.inputs, values))

    @rule(live=lives, data=st.data())
    def choose(self, live: Live, data: st.DataObject) -> None:
        if live not in self.alive or not self.fmu.choices:
            return
        variable = data.draw(st.sampled_from(self.fmu.choices))
        items = range(1, self.fmu.items[variable.name] + 1)
        value = data.draw(st.sampled_from((*items, 0, -1, 99, 2**31 - 1)))
        call = "set_integers", "Integer", [variable.reference], [value]
        assert live.instance.do(call) == OK
        if live.account.phase not in ("stepping", "terminated"):
            live.account.calls.append(call)

    @rule(live=lives, reference=st.sampled_from((0, 20, 999)), text=st.sampled_from((b"", b"%n%s", b"x" * 100)))
    def other_types(self, live: Live, reference: int, text: bytes) -> None:
        if live in self.alive:
            assert live.instance.set_integers("Boolean", [reference], [1]) == OK
            assert live.instance.get_integers("Boolean", [reference]) == (OK, [0])
            assert live.instance.set_text(reference, text) == OK
            assert live.instance.get_texts([reference]) == [b""]

    @rule(
        live=lives, text=st.sampled_from((b"\xff\xfe", b"\xc0\xaf", b"\xed\xa0\x80", b"\xf5\x80\x80\x80", b"\xe2\x82"))
    )
    def text_that_is_none(self, live: Live, text: bytes) -> None:
        if live in self.alive and self.fmu.has_shim:
            assert live.instance.set_text(0, text) == ERROR

    @rule(live=lives, unknown=st.booleans())
    def get(self, live: Live, unknown: int) -> None:
        if live not in self.alive:
            return
        references = [each.reference for each in self.fmu.reals] + [999, 2**32 - 1] * unknown
        status, values = live.instance.get_reals(references)
        assert status == OK
        assert not unknown or all(math.isnan(each) for each in values[-2:])
        live.instance.get_integers("Integer", [each.reference for each in self.fmu.choices] + [999] * unknown)

    # --- steps ----------------------------------------------------------------------------------------------------

    @rule(live=lives, h=STEPS, offset=st.sampled_from((0.0, 0.0, 0.0, -0.1, 0.3, math.nan, 1e300)))
    def step(self, live: Live, h: float, offset: float) -> None:
        """A step that may be anything; one that is refused changes nothing."""
        if live not in self.alive:
            return
        before = live.instance.everything() if live.account.phase != "initializing" else None
        time = live.account.time + offset
        status = live.instance.step(time, h)
        possible = live.account.phase == "stepping" and offset == 0.0 and 0.0 < h <= 3600.0 and time + h > time
        assert status in ((OK, DISCARD) if possible else (DISCARD,)), status
        if status == OK:
            live.account.calls.append(("step", time, h))
            live.account.time = time + h
        elif before is not None:
            assert live.instance.everything() == before

    @rule(live=lives, jet=CHOSEN, count=st.integers(1, 4))
    def step_well(self, live: Live, jet: Array, count: int) -> None:
        """Steps that nothing is wrong with are taken, if the initialization succeeded and parameters are legal."""
        if live not in self.alive or live.account.phase != "stepping" or not self.healthy(live):
            return
        for _ in range(count):
            self.set_jet(live, jet)
            time = live.account.time
            status = live.instance.step(time, 0.1)
            if status != OK and not self.fmu.follows_a_path:
                return  # a plant may rightly be where it cannot go on
            assert status == OK, live.instance.messages[-1:]
            live.account.calls.append(("step", time, 0.1))
            live.account.time = time + 0.1

    def healthy(self, live: Live) -> bool:
        _, values = live.instance.get_reals([each.reference for each in self.fmu.reals])
        described = dict(zip((each.name for each in self.fmu.reals), values, strict=True))
        outputs = [described[name] for name in self.fmu.outputs]
        # values of the usual size: with others a step may rightly be impossible
        usual = all(described[name] == value for name, value in self.fmu.usual.items())
        return usual and all(map(math.isfinite, outputs)) and abs(live.account.time) < 1e3

    # --- states ---------------------------------------------------------------------------------------------------

    @rule(live=lives)
    def get_state(self, live: Live) -> None:
        if live in self.alive and len(live.states) < 4:
            status, state = live.instance.get_state()
            assert status == OK
            live.states.append((state, live.account.copy()))

    @rule(live=lives, data=st.data())
    def set_state(self, live: Live, data: st.DataObject) -> None:
        """Back to an earlier state of this instance, or of another of the same FMU."""
        offered = [(state, account) for each in self.alive for state, account in each.states]
        if live in self.alive and offered:
            state, account = data.draw(st.sampled_from(offered))
            assert live.instance.set_state(state) == OK
            live.account = account.copy()
            self.compare(live)

    @rule(live=lives)
    def free_state(self, live: Live) -> None:
        if live in self.alive and live.states:
            state, _ = live.states.pop()
            assert live.instance.free_state(state) == OK

    @rule(target=serialized, live=lives)
    def serialize(self, live: Live) -> tuple[bytes, Account] | MultipleResults[tuple[bytes, Account]]:
        if live not in self.alive or not live.states:
            return multiple()
        state, account = live.states[-1]
        return live.instance.serialized(state), account.copy()

    @rule(live=lives, form=serialized, damage=st.sampled_from((None, None, "cut", "shorter", "empty", "other")))
    def deserialize(self, live: Live, form: tuple[bytes, Account], damage: str | None) -> None:
        if live not in self.alive:
            return
        text, account = form
        damages: dict[str, Callable[[bytes], bytes]] = {
            "cut": lambda b: b[: len(b) // 2],
            "shorter": lambda b: b[8:],
            "empty": lambda _: b"",
            "other": lambda b: bytes([b[0] ^ 1]) + b[1:],  # of another build, or no text that can be read
        }
        before = live.instance.everything() if damage and live.account.phase != "initializing" else None
        state = live.instance.deserialized(damages[damage](text) if damage else text)
        assert live.instance.set_state(state) == OK
        assert live.instance.free_state(state) == OK
        if not damage:
            live.account = account.copy()
        elif before is not None:
            assert live.instance.everything() == before
        self.compare(live)

    # --- the oracle -----------------------------------------------------------------------------------------------

    def compare(self, live: Live) -> None:
        """A fresh instance that is only asked what was valid answers the same, to the last bit, and so do more steps.

        The steps are taken back: that is exact too.
        """
        fresh = self.fmu.instance(lambda _: None)
        try:
            for call in live.account.calls:
                assert fresh.do(call) == OK, (call, fresh.messages[-1:])
            before = live.instance.everything()
            assert before == fresh.everything()
            _, state = live.instance.get_state()
            self.step_both(live, fresh)
            assert live.instance.set_state(state) == OK
            assert live.instance.free_state(state) == OK
            assert live.instance.everything() == before
        finally:
            fresh.free()

    def step_both(self, live: Live, fresh: Instance) -> None:
        time = live.account.time
        for jet in (None, *self.good[:2]):
            if jet is not None:
                assert [each.set_reals(self.fmu.inputs, jet) for each in (live.instance, fresh)] == [OK, OK]
            status, expected = (each.step(time, 0.1) for each in (live.instance, fresh))
            assert status == expected
            time += 0.1 if status == OK else 0.0
            assert live.instance.everything() == fresh.everything()

    def teardown(self) -> None:
        for live in self.alive:
            self.compare(live)
            self.end(live)


TOLD: Counter[str] = Counter()


def tell(text: str) -> None:
    """Write at once: a crash loses what is buffered."""
    os.write(2, f"{text}\n".encode())
    if text[0] not in " -":  # remarks
        TOLD[text.split()[:2][-1]] += 1


def main(file: str, sequences: str, start: str = "0", shrink: str = "yes") -> None:
    """Run so many sequences; an error or a crash ends the process with a non-zero code."""
    with tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as folder:
        Hostile.fmu = Fmu(Path(str(extract(file, folder))))
        Hostile.good = good_inputs(Hostile.fmu)
        chosen = settings(
            max_examples=int(sequences),
            stateful_step_count=25,
            deadline=None,
            database=None,
            phases=(Phase.generate, Phase.shrink) if shrink == "yes" else (Phase.generate,),
            suppress_health_check=list(HealthCheck),
        )
        run_state_machine_as_test(seed(int(start))(Hostile), settings=chosen)
    calls = f"{TOLD.total():,} calls, {TOLD['DoStep']:,} of them steps, {TOLD['SetFMUstate']:,} restored states"
    print(f"{sequences} sequences survived: {calls}", flush=True)


if __name__ == "__main__":
    main(*sys.argv[1:])
