"""Times of many solvers, measured in turn; and a first trial of each in a process of its own, which may fail."""

from __future__ import annotations

import os
import pickle
import re
import resource
import select
import signal
import time
import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np

from benchmarks.chart.candidate import Answer, Candidate, Prepared
from benchmarks.chart.rows import Row

MOST_REPEATS, FEWEST_REPEATS = 11, 3
SLOW = 0.3
"""A solve that takes longer, in s, is timed once: no disturbance changes its place."""
UNHURRIED = 0.2
"""A solve that takes longer, in s, is as warm the first time as ever."""


def processor_time() -> float:
    """Processor time in s of this process and of the children it has waited for: other work does not count."""
    children = resource.getrusage(resource.RUSAGE_CHILDREN)
    return time.process_time() + children.ru_utime + children.ru_stime


@dataclass(frozen=True, eq=False)
class Timed:
    """A row with what its table has no column for.

    Attributes
    ----------
    seconds : tuple of float
        Times of all repeats.
    preparation : float
        Time of what is done once, in s.
    errors : dict of str to float
        Error of each input.
    """

    row: Row
    seconds: tuple[float, ...] = ()
    preparation: float = 0.0
    errors: dict[str, float] = field(default_factory=dict)


@dataclass(eq=False)
class _Tried:
    """A candidate after its trial: ready, or with the message why not."""

    candidate: Candidate
    prepared: Prepared | None
    preparation: float
    message: str = ""
    expected: float = 0.0
    answer: Answer | None = None
    remark: str = ""
    seconds: list[float] = field(default_factory=list)


def measure(candidates: Sequence[Candidate], say: Callable[[str], None], budget: float = 1.0) -> list[Timed]:
    """Prepare, try and time all candidates; the repeats are taken in turn, so that disturbances meet them alike.

    Parameters
    ----------
    candidates : sequence of Candidate
        Of one problem.
    say : callable
        Told what is going on.
    budget : float
        Seconds that the repeats of one candidate may take together, but for the fewest.
    """
    tried = []
    for candidate in candidates:
        say(", ".join((candidate.problem.name, candidate.solver, candidate.model, candidate.formulation,
                       candidate.method, candidate.setting)))  # fmt: skip
        tried.append(_try(candidate))
    say(f"timing {sum(each.prepared is not None for each in tried)} solvers in turn")
    _time_in_turn([each for each in tried if each.prepared is not None], budget)
    return [_timed(each) for each in tried]


def _try(candidate: Candidate) -> _Tried:
    begin = processor_time()
    try:
        prepared = candidate.prepare()
    except Exception as error:  # whatever a peer raises becomes its message
        return _Tried(candidate, None, processor_time() - begin, one_line(error))
    found = _Tried(candidate, prepared, processor_time() - begin)
    outcome = in_child(lambda: _trial(candidate, prepared), candidate.limit)
    if isinstance(outcome, str):
        found.prepared, found.message = None, outcome
    else:
        found.expected = outcome
    return found


def _trial(candidate: Candidate, prepared: Prepared) -> float:
    """Run once to see whether an answer comes out, and once more for the time it takes when warm."""
    took = 0.0
    for _ in range(2):
        if prepared.before:
            prepared.before()
        begin = processor_time()
        found = prepared.run()
        took = processor_time() - begin
        values = prepared.read(found).inputs
        for name in candidate.problem.inputs:
            if not np.isfinite(values[name]).all():
                raise ArithmeticError(f"{name} is not finite")
        if took > UNHURRIED:
            break
    return took


def _time_in_turn(tried: Sequence[_Tried], budget: float) -> None:
    """Take the processor time of every run several times round, after a round to warm up and to keep the answers."""
    for each in tried:
        _run(each)
        if each.expected < UNHURRIED:
            each.seconds.clear()
    wanted = {id(each): _repeats(each.expected, budget) for each in tried if not each.message}
    for _ in range(max(wanted.values(), default=0)):
        for each in tried:
            if not each.message and len(each.seconds) < wanted[id(each)]:
                _run(each)


def _repeats(expected: float, budget: float) -> int:
    if expected > SLOW:
        return 1
    return int(np.clip(budget / max(expected, 1e-6), FEWEST_REPEATS, MOST_REPEATS))


def _run(each: _Tried) -> None:
    prepared = each.prepared
    assert prepared is not None
    if prepared.before:
        prepared.before()
    begin = processor_time()
    try:
        found = prepared.run()
    except Exception as error:  # it was solved in the trial, and now is not: no answer to rely on
        each.message, each.answer = one_line(error), None
        return
    each.seconds.append(processor_time() - begin)
    if each.answer is None:
        each.answer = prepared.read(found)
        each.remark = prepared.remark(found) if prepared.remark else ""


def _timed(each: _Tried) -> Timed:
    candidate = each.candidate
    head = (candidate.problem.name, candidate.solver, candidate.model, candidate.formulation, candidate.method,
            candidate.setting)  # fmt: skip
    if each.answer is None:
        return Timed(Row(*head, message=each.message), preparation=each.preparation)
    errors = candidate.problem.errors(each.answer.inputs)
    violation = each.answer.violation if np.isfinite(each.answer.violation) else None
    row = Row(*head, float(np.median(each.seconds)), max(errors.values()), violation, each.remark)
    return Timed(row, tuple(each.seconds), each.preparation, errors)


def in_child(work: Callable[[], float], limit: float) -> float | str:
    """Run `work` in a forked process; returns what it returns, or a sentence if it raises, dies or takes too long."""
    reading, writing = os.pipe()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DeprecationWarning)  # of threads, which the child does not touch
        child = os.fork()
    if not child:
        _as_child(work, reading, writing)
    os.close(writing)
    try:
        if not select.select([reading], [], [], limit)[0]:
            os.killpg(child, signal.SIGKILL)  # the child leads a group of its own
            return f"gave up after {limit:g} s"
        with os.fdopen(reading, "rb", closefd=False) as stream:
            data = stream.read()
        return pickle.loads(data) if data else "the process of the solver died"
    finally:
        os.close(reading)
        os.waitpid(child, 0)


def _as_child(work: Callable[[], float], reading: int, writing: int) -> None:
    os.setsid()
    os.close(reading)
    silence = os.open(os.devnull, os.O_WRONLY)
    os.dup2(silence, 1)
    os.dup2(silence, 2)
    try:
        outcome: float | str = work()
    except BaseException as error:  # reported to the parent
        outcome = one_line(error)
    with os.fdopen(writing, "wb") as stream:
        stream.write(pickle.dumps(outcome))
    os._exit(0)


def one_line(error: BaseException, longest: int = 200) -> str:
    """Return an error as one line without places in the file system."""
    text = re.sub(r"(/[\w.+-]+)+/", "", " ".join(str(error).split())) or "no message"
    text = f"{type(error).__name__}: {text}"
    return text if len(text) <= longest else f"{text[: longest // 3]} ... {text[-2 * longest // 3 :]}"
