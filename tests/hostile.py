"""Hostile use of FMUs: any FMI calls in any order with any values.

    python hostile.py SEQUENCES STEPS SEED FOLDER...

Each folder is an unpacked FMU, a PythonFMU or a native one. The process must survive, the statuses must be right, a
refused call must change nothing, and an instance must answer, to the last bit, as a fresh one that only got the valid
calls. The calls are written to standard error before they are made: after a crash the last lines are those of the
running sequence. Where the library was built with an address sanitizer, which then is loaded before all else, it ends
the process at the first wrong access; memory that is not returned is counted.
"""

from __future__ import annotations

import ctypes
import gc
import math
import os
import sys
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from random import Random

from fmpy import read_model_description
from fmpy.fmi2 import fmi2CallbackFunctions
from hostile_fmu import DISCARD, ERROR, HOSTILE, OK, WARNING, Fmu, Instance, Vectors

VALUES = (*HOSTILE, 1.0, 5.0, -5.0, 0.1, 100.0)
STEPS = (0.1, 0.1, 0.05, 0.01, 1e-7, 0.0, -0.0, -0.1, math.nan, math.inf, -math.inf, 1e300, 5e-324)
OFFSETS = (0.0, 0.0, 0.0, 0.0, -0.1, 0.3, math.nan, 1e300)
TIMES = (0.0, 0.0, 2.5, -3.0, 1e6, math.nan, math.inf, -1e300)
NO_TEXTS = (b"\xff\xfe", b"\xc0\xaf", b"\xed\xa0\x80", b"\xf5\x80\x80\x80", b"\xe2\x82")
DAMAGES: tuple[Callable[[bytes], bytes], ...] = (
    lambda text: text[: len(text) // 2],
    lambda text: text[8:],
    lambda _: b"",
    lambda text: bytes([text[0] ^ 1]) + text[1:],  # of another build, or no text that can be read
)
CALLS, MOST_INSTANCES = 30, 3
LATE = ("stepping", "terminated")


@dataclass
class Account:
    """The valid calls of an instance, and where they led."""

    calls: list[tuple[object, ...]] = field(default_factory=list)
    phase: str = "instantiated"
    time: float = 0.0

    def copy(self) -> Account:
        return Account(list(self.calls), self.phase, self.time)


@dataclass(eq=False)
class Live:
    """An instance with its account and the states it gave."""

    instance: Instance
    account: Account = field(default_factory=Account)
    states: list[tuple[int, Account]] = field(default_factory=list)


class Machine:
    """A sequence of calls of a few instances."""

    def __init__(self, fmu: Fmu, random: Random) -> None:
        self.fmu, self.random = fmu, random
        self.alive: list[Live] = []
        self.serialized: list[tuple[bytes, Account]] = []

    def run(self) -> None:
        tell("--- a new sequence")
        events = (
            self.another, self.free, self.reset, self.setup, self.enter, self.leave, self.terminate, self.begin_well,
            self.set_reals, self.set_reals, self.set_well, self.choose, self.other_types, self.get, self.differentiate,
            self.step, self.step, self.step_well, self.get_state, self.set_state, self.free_state, self.serialize,
            self.deserialize, self.deserialize_damaged,
        )  # fmt: skip
        self.begin_well(self.made())
        for _ in range(CALLS):
            self.random.choice(events)(self.random.choice(self.alive))
        for live in self.alive:
            self.compare(live)
            self.end(live)

    # --- instances ------------------------------------------------------------------------------------------------

    def made(self) -> Live:
        self.alive.append(live := Live(Instance(self.fmu, tell)))
        return live

    def another(self, _: Live) -> None:
        if len(self.alive) < MOST_INSTANCES:
            self.made()

    def free(self, live: Live) -> None:
        self.alive.remove(live)
        self.end(live)
        if not self.alive:
            self.made()

    def end(self, live: Live) -> None:
        if self.random.random() < 0.5 or not self.fmu.has_shim:  # the shim frees states of an instance that is gone
            for state, _ in live.states:
                live.instance.free_state(state)
        live.instance.free()

    def reset(self, live: Live) -> None:
        assert live.instance.call("Reset") == OK
        live.account = Account()

    # --- calls that may be refused --------------------------------------------------------------------------------

    def done(self, live: Live, call: tuple[object, ...], *, valid: bool) -> bool:
        """Make a call, and keep it where it was done; one that was refused must have changed nothing.

        A PythonFMU has no status for a call that is not valid; a native FMU judges values too, at once.
        """
        before = self.seen(live)
        status = live.instance.do(call)
        assert status in ((OK,) if self.fmu.is_deferred else (OK, ERROR) if valid else (ERROR,)), (call, status)
        if valid and status == OK:
            live.account.calls.append(call)
            return True
        assert self.seen(live) == before
        return False

    def seen(self, live: Live) -> object:
        """Return all values, but for an initialization, in which outputs are computed when they are read."""
        return None if live.account.phase == "initializing" else live.instance.everything()

    def move(self, live: Live, call: tuple[object, ...], wanted: str, then: str) -> bool:
        moves = self.done(live, call, valid=live.account.phase == wanted)
        if moves:
            live.account.phase = then
        return moves

    def setup(self, live: Live, time: float | None = None) -> None:
        time = self.random.choice(TIMES) if time is None else time
        if self.move(live, ("setup", time), "instantiated", "instantiated"):
            live.account.time = time

    def enter(self, live: Live) -> None:
        self.move(live, ("enter",), "instantiated", "initializing")

    def leave(self, live: Live) -> None:
        self.move(live, ("leave",), "initializing", "stepping")

    def terminate(self, live: Live) -> None:
        self.move(live, ("terminate",), "stepping", "terminated")

    def begin_well(self, live: Live) -> None:
        """Bring an instance to where it can step, whatever happened to it."""
        self.reset(live)
        self.setup(live, self.random.choice((0.0, 2.5)))
        self.set_well(live)
        self.enter(live)
        self.leave(live)
        assert live.account.phase == "stepping", live.instance.messages[-1:]

    # --- values ---------------------------------------------------------------------------------------------------

    def set_reals(self, live: Live) -> None:
        late = live.account.phase in LATE
        for _ in range(self.random.randrange(4)):
            reference, value = self.random.choice(self.fmu.reals).valueReference, self.random.choice(VALUES)
            self.done(live, ("set_reals", [reference], [value]), valid=self.fmu.settable(reference, late=late))
        self.done(live, ("set_reals", [self.fmu.beyond, 4_294_967_290], [1.0, 2.0]), valid=False)
        if self.fmu.is_deferred or live.account.phase != "terminated":
            assert live.instance.set_reals([], []) == OK

    def set_well(self, live: Live) -> None:
        call = "set_reals", self.fmu.inputs, self.random.choice(self.fmu.good)
        self.done(live, call, valid=self.fmu.is_deferred or live.account.phase != "terminated")

    def choose(self, live: Live) -> None:
        if self.fmu.choices:
            variable = self.random.choice(self.fmu.choices)
            value = self.random.choice((*range(1, self.fmu.items[variable.name] + 1), 0, -1, 99, 2**31 - 1))
            call = "set_integers", "Integer", [variable.valueReference], [value]
            self.done(live, call, valid=self.fmu.settable(variable.valueReference, late=live.account.phase in LATE))

    def other_types(self, live: Live) -> None:
        reference, text = self.random.choice((0, 20, 999)), self.random.choice((b"", b"%n%s", b"x" * 100))
        refused = OK if self.fmu.is_deferred else ERROR
        assert live.instance.set_integers("Boolean", [reference], [1]) == refused
        assert live.instance.get_integers("Boolean", [reference]) == (refused, [0])
        assert live.instance.set_text(reference, text) == refused
        assert live.instance.get_texts([reference]) == (refused, [b"" if self.fmu.is_deferred else None])
        if self.fmu.has_shim:
            assert live.instance.set_text(0, self.random.choice(NO_TEXTS)) == ERROR

    def get(self, live: Live) -> None:
        references = [each.valueReference for each in self.fmu.reals]
        status, values = live.instance.get_reals([*references, self.fmu.beyond, 2**32 - 1])
        assert status == (OK if self.fmu.is_deferred else ERROR)
        assert all(math.isnan(each) for each in values[-2:])
        choices = [each.valueReference for each in self.fmu.choices]
        live.instance.get_integers("Integer", [*choices, max(choices, default=self.fmu.beyond) + 1, 999_999])

    def differentiate(self, live: Live) -> None:
        """Ask for derivatives, which only native FMUs have, by variables and along directions of any kind."""
        if not self.fmu.is_deferred:
            before, known = self.seen(live), [each.valueReference for each in self.fmu.reals] + [self.fmu.beyond]
            of, by = (self.random.choices(known, k=self.random.randrange(4)) for _ in range(2))
            status = live.instance.differentiate(of, by, self.random.choices(VALUES, k=len(by)))
            assert status in (OK, DISCARD, ERROR)
            assert self.seen(live) == before

    # --- steps ----------------------------------------------------------------------------------------------------

    def step(self, live: Live) -> None:
        """Take a step that may be anything; one that is refused changes nothing."""
        before, h, offset = self.seen(live), self.random.choice(STEPS), self.random.choice(OFFSETS)
        time = live.account.time + offset
        status = live.instance.step(time, h)
        possible = live.account.phase == "stepping" and offset == 0.0 and 0.0 < h <= 3600.0 and time + h > time
        senseless = DISCARD if self.fmu.is_deferred else ERROR
        assert status in ((OK, WARNING, DISCARD, senseless) if possible else (senseless,)), (status, time, h)
        self.stepped(live, status, h, before)

    def stepped(self, live: Live, status: int, h: float, before: object) -> None:
        if status <= WARNING:
            live.account.calls.append(("step", live.account.time, h))
            live.account.time += h
        else:
            assert self.seen(live) == before

    def step_well(self, live: Live) -> None:
        """Take steps that nothing is wrong with: an inverse model does, if parameters are legal and it could start."""
        for _ in range(self.random.randrange(1, 5)):
            if live.account.phase != "stepping" or not self.healthy(live):
                return
            self.set_well(live)
            before, status = self.seen(live), live.instance.step(live.account.time, 0.1)
            # a plant may rightly be where it cannot go on; estimated, these jumps of the path slacken the rope
            refused = status == DISCARD and self.estimates(live)
            assert status <= WARNING or not self.fmu.follows_a_path or refused, live.instance.messages[-1:]
            self.stepped(live, status, 0.1, before)

    def estimates(self, live: Live) -> bool:
        """Return whether derivatives of the path are estimated: not all are connected, the first item of the choice."""
        places = [each.valueReference for each in self.fmu.choices if each.name == "connected"]
        return bool(places) and live.instance.get_integers("Integer", places)[1] != [1]

    def healthy(self, live: Live) -> bool:
        _, values = live.instance.get_reals([each.valueReference for each in self.fmu.reals])
        described = dict(zip((each.name for each in self.fmu.reals), values, strict=True))
        outputs = [described[name] for name in self.fmu.outputs]
        # values of the usual size: with others a step may rightly be impossible
        usual = all(described[name] == value for name, value in self.fmu.usual.items())
        return usual and all(map(math.isfinite, outputs)) and abs(live.account.time) < 1e3

    # --- states ---------------------------------------------------------------------------------------------------

    def get_state(self, live: Live) -> None:
        if len(live.states) < 4:
            status, state = live.instance.get_state()
            assert status == OK
            live.states.append((state, live.account.copy()))

    def set_state(self, live: Live) -> None:
        """Restore an earlier state of this instance, or of another of the same FMU."""
        offered = [each for other in self.alive for each in other.states]
        if offered:
            state, account = self.random.choice(offered)
            assert live.instance.set_state(state) == OK
            live.account = account.copy()
            self.compare(live)

    def free_state(self, live: Live) -> None:
        if live.states:
            state, _ = live.states.pop()
            assert live.instance.free_state(state) == OK

    def serialize(self, live: Live) -> None:
        if live.states:
            state, account = live.states[-1]
            self.serialized.append((live.instance.serialized(state), account.copy()))

    def deserialize(self, live: Live) -> None:
        if self.serialized:
            text, account = self.random.choice(self.serialized)
            assert live.instance.restore(text) == OK
            live.account = account.copy()
            self.compare(live)

    def deserialize_damaged(self, live: Live) -> None:
        if self.serialized:
            before, damage = self.seen(live), self.random.choice(DAMAGES)
            status = live.instance.restore(damage(self.random.choice(self.serialized)[0]))
            assert status == (OK if self.fmu.is_deferred else ERROR)
            assert self.seen(live) == before

    # --- the oracle -----------------------------------------------------------------------------------------------

    def compare(self, live: Live) -> None:
        """A fresh instance that only gets the valid calls answers the same, to the last bit, and so do more steps.

        The steps are taken back: that is exact too.
        """
        fresh = Instance(self.fmu, lambda _: None)
        for call in live.account.calls:
            assert fresh.do(call) <= WARNING, (call, fresh.messages[-1:])
        before = live.instance.everything()
        assert before == fresh.everything()
        _, state = live.instance.get_state()
        time = live.account.time
        for values in (None, *self.fmu.good[:2]):
            if values is not None:
                assert len({each.set_reals(self.fmu.inputs, values) for each in (live.instance, fresh)}) == 1
            # a warning is issued once per instance, which may have got it before a state was restored
            status, expected = (max(each.step(time, 0.1), WARNING) for each in (live.instance, fresh))
            assert status == expected
            time += 0.1 if status <= WARNING else 0.0
            assert live.instance.everything() == fresh.everything()
        assert live.instance.set_state(state) == OK
        assert live.instance.free_state(state) == OK
        assert live.instance.everything() == before
        fresh.free()


def go_on(fmu: Fmu, steps: int) -> None:
    """Take many steps along a sine and its derivatives, or from rest; every output must be finite."""
    instance = Instance(fmu, lambda _: None)
    for each in fmu.choices:
        if each.name == "connected":  # the position alone: the others are estimated
            instance.set_integers("Integer", [each.valueReference], [1])
    for call in (("setup", 0.0), ("enter",), ("leave",)):
        assert instance.do(call) == OK, instance.messages
    outputs = [each.valueReference for each in fmu.reals if each.name in fmu.outputs]
    for k in range(steps):
        instance.set_reals(fmu.inputs, fmu.swinging(0.01 * k, 0.01))
        assert instance.step(0.01 * k, 0.01) <= WARNING, instance.messages[-1:]
        status, values = instance.get_reals(outputs)
        assert status == OK
        assert all(map(math.isfinite, values))
    instance.free()


def return_memory(fmu: Fmu, times: int = 200) -> None:
    """Make instances and states, some from damaged texts: the sanitizer's count must not grow."""
    count = ctypes.CDLL(None)["__sanitizer_get_current_allocated_bytes"]
    count.restype = ctypes.c_size_t
    kept = []
    for _ in range(2):  # what is made once was made in the first round
        for _ in range(times):
            instance = Instance(fmu, lambda _: None)
            _, state = instance.get_state()
            text = instance.serialized(state)
            instance.free_state(state)
            assert instance.restore(text) == OK
            assert [instance.restore(damage(text)) for damage in DAMAGES] == [ERROR] * len(DAMAGES)
            instance.free()
        gc.collect()
        kept.append(count())
    assert kept[1] - kept[0] < 100 * times, kept  # a state has more than a hundred numbers


TOLD: Counter[str] = Counter()


def tell(text: str) -> None:
    """Write at once: a crash loses what is buffered."""
    os.write(2, f"{text}\n".encode())
    if text[0] not in " -":  # remarks
        TOLD[text.split()[:2][-1]] += 1


def main(sequences: str, steps: str, seed: str, *folders: str) -> None:
    """Run so many sequences and steps with each FMU; an error or a crash ends the process with a non-zero code."""
    for folder in folders:
        if read_model_description(folder, validate=False).fmiVersion.startswith("3"):
            vectors = Vectors(Path(folder), Random(seed))
            for _ in range(int(sequences)):
                vectors.run(CALLS)
            assert {OK, ERROR} <= vectors.statuses
            continue
        fmu = Fmu(Path(folder))
        assert not fmu.instantiated(b"{}", fmi2CallbackFunctions()), "another model description is accepted"
        for k in range(int(sequences)):
            Machine(fmu, Random(f"{seed} {k}")).run()
        go_on(fmu, int(steps))
        if "LD_PRELOAD" in os.environ:
            return_memory(fmu)
    calls = f"{TOLD.total():,} calls, {TOLD['DoStep']:,} of them steps, {TOLD['SetFMUstate']:,} restored states"
    print(f"{sequences} sequences survived: {calls}", flush=True)


if __name__ == "__main__":
    main(*sys.argv[1:])
