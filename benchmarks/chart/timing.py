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
from typing import TypeVar

import numpy as np

from benchmarks.chart.candidate import Answer, Candidate, Prepared, Problem
from benchmarks.chart.rows import Row

MOST_REPEATS, FEWEST_REPEATS = 11, 3
SLOW = 0.1
"""A solve that takes longer, in s, is timed once, where it is tried: no disturbance changes its place."""
UNHURRIED = 0.02
"""A solve that takes longer, in s, is as warm the first time as ever."""

Found = TypeVar("Found")


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


@dataclass(frozen=True, eq=False)
class _Trial:
    """What the trial of a candidate took, in s, and gave."""

    seconds: float
    answer: Answer
    remark: str


@dataclass(eq=False)
class _Tried:
    """A candidate after its trial: with what it gave, or with the message why not."""

    candidate: Candidate
    preparation: float
    message: str = ""
    prepared: Prepared | None = None
    trial: _Trial | None = None
    seconds: list[float] = field(default_factory=list)


def measure(
    candidates: Sequence[Candidate], say: Callable[[str], None], budget: float = 1.0, slow: float = SLOW
) -> list[Timed]:
    """Prepare, try and time all candidates; the repeats are taken in turn, so that disturbances meet them alike.

    Parameters
    ----------
    candidates : sequence of Candidate
        Of one problem.
    say : callable
        Told what is going on.
    budget : float
        Seconds that the repeats of one candidate may take together, but for the fewest.
    slow : float
        Seconds from which on the time of the trial is that of the row.
    """
    tried: list[_Tried] = []
    for candidate in candidates:
        say(", ".join((candidate.problem.name, candidate.solver, candidate.model, candidate.formulation,
                       candidate.method, candidate.setting)))  # fmt: skip
        tried.append(_try(candidate))
    in_turn = [each for each in tried if each.trial and each.trial.seconds <= slow]
    say(f"timing {len(in_turn)} solvers in turn")
    _time_in_turn(in_turn, budget)
    return [_timed(each) for each in tried]


def _try(candidate: Candidate) -> _Tried:
    begin = processor_time()
    try:
        prepared = candidate.prepare()
    except Exception as error:  # whatever a peer raises becomes its message
        return _Tried(candidate, processor_time() - begin, one_line(error))
    preparation = processor_time() - begin
    outcome = in_child(lambda: _trial(prepared, candidate.problem), candidate.limit)
    if isinstance(outcome, str):
        return _Tried(candidate, preparation, outcome)
    return _Tried(candidate, preparation, "", prepared, outcome)


def _trial(prepared: Prepared, problem: Problem) -> _Trial:
    """Run once to see whether an answer comes out, and a short run once more for the time it takes when warm."""
    seconds, found = _run(prepared)
    answer = prepared.read(found)
    for name in problem.inputs:
        if not np.isfinite(answer.inputs[name]).all():
            raise ArithmeticError(f"{name} is not finite")
    remark = prepared.remark(found) if prepared.remark else ""
    return _Trial(seconds if seconds > UNHURRIED else _run(prepared)[0], answer, remark)


def _run(prepared: Prepared) -> tuple[float, object]:
    """Return the processor time of one run, and what it gives."""
    if prepared.before:
        prepared.before()
    begin = processor_time()
    found = prepared.run()
    return processor_time() - begin, found


def _time_in_turn(tried: Sequence[_Tried], budget: float) -> None:
    """Take the processor time of every run several times round; the first round warms short runs up."""
    for turn in range(1 + MOST_REPEATS):
        for each in tried:
            assert each.prepared is not None
            assert each.trial is not None
            expected = each.trial.seconds
            repeats = np.clip(budget / max(expected, 1e-6), FEWEST_REPEATS, MOST_REPEATS)
            if each.message or turn > repeats or (turn == 0 and expected > UNHURRIED):
                continue
            try:
                took, _ = _run(each.prepared)
            except Exception as error:  # it was solved in the trial, and now is not: no answer to rely on
                each.message = one_line(error)
            else:
                each.seconds += [took] if turn else []


def _timed(each: _Tried) -> Timed:
    candidate = each.candidate
    head = (candidate.problem.name, candidate.solver, candidate.model, candidate.formulation, candidate.method,
            candidate.setting)  # fmt: skip
    if each.message or each.trial is None:
        return Timed(Row(*head, message=each.message), preparation=each.preparation)
    answer, seconds = each.trial.answer, tuple(each.seconds) or (each.trial.seconds,)
    errors = candidate.problem.errors(answer.inputs)
    violation = answer.violation if np.isfinite(answer.violation) else None
    row = Row(*head, float(np.median(seconds)), max(errors.values()), violation, each.trial.remark)
    return Timed(row, seconds, each.preparation, errors)


def in_child(work: Callable[[], Found], limit: float) -> Found | str:
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


def _as_child(work: Callable[[], Found], reading: int, writing: int) -> None:
    os.setsid()
    os.close(reading)
    silence = os.open(os.devnull, os.O_WRONLY)
    os.dup2(silence, 1)
    os.dup2(silence, 2)
    try:
        outcome: Found | str = work()
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
