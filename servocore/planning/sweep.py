"""Sweeps: peaks, margins and swing of many cases of a scene, as an xarray Dataset.

The cases go in blocks through one compiled function, in threads of this process or in the processes of an executor.
Workers return a few numbers a case; this process alone writes them: a block is there as a whole or not at all.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import Executor, ThreadPoolExecutor
from dataclasses import replace
from hashlib import sha256
from pathlib import Path
from typing import Any

import numpy as np

from servocore.checks.before_run import require_feasible
from servocore.checks.motion_limits import limited_values, margins_of
from servocore.errors import InvalidSetting, ServocoreError, described, require_callable, require_count, require_kind
from servocore.model.limits import Bounds, run_quantities
from servocore.model.scene import Scene
from servocore.numerics.compiled_calls import Array
from servocore.planning.sweep_cases import SWING, Cases, Work, evaluated, work_of
from servocore.planning.sweep_settings import (
    DURATION,
    PATH,
    Slices,
    SweepSettings,
    checked_settings,
    in_time,
    settings_of,
)
from servocore.planning.sweep_store import FAILURE, SUFFIX, Memory, Parquet, Zarr, blank_dataset, varied
from servocore.planning.worker_pools import Cluster, Pool, PoolLost
from servocore.problem import Problem
from servocore.references.base import Reference
from servocore.solution import Solution
from servocore.solvers.exact_inversion import prepared_motion
from servocore.solvers.solve import solve

Progress = Callable[[int, int], None]

# Cases of a block: so many that a worker is busy for longer than it takes to write them, and few enough to lose.
_FEWEST, _MOST, _WITH_INPUTS, _BLOCKS, _SLOW = 2048, 32768, 4096, 32, 16


def sweep(
    scene: Scene,
    parameters: Any = None,
    references: Sequence[Reference] | None = None,
    limits: Mapping[str, Bounds] | None = None,
    executor: Executor | None = None,
    *,
    instants: int = 201,
    inputs: bool = False,
    store: str | Path | None = None,
    resume: bool = False,
    chunk: int | None = None,
    model: str | None = None,
    distributed: Any = None,
    native: bool | None = None,
    progress: Progress | None = None,
) -> Any:
    """Return peaks, margins and swing of many cases of a scene.

    Parameters
    ----------
    scene : Scene
        Any. Where it has internal dynamics or its branch has to be followed, cases are solved one by one in this
        process.
    parameters : mapping of str to array_like, or table, optional
        Values of parameters in SI units, and of ``duration`` in s. Of several rows the product is swept, one dimension
        each; a table (a pandas DataFrame, or a list of mappings) has one case a row, dimension ``case``.
    references : sequence of Reference, optional
        Paths, dimension ``path``; the scene's own when not given.
    limits : mapping of str to bounds, optional
        As for `Scene.with_limits`, beside those that the scene has.
    executor : concurrent.futures.Executor, optional
        Where the cases are computed; threads of this process when not given.
    instants : int
        Number of instants, evenly from start to end, of a case.
    inputs : bool
        Whether the inputs are kept too, dimension ``instant``.
    store : str or Path, optional
        A Zarr store that is filled block by block, and returned without reading its content; or, where the name
        ends so, a folder of Parquet files (``.parquet``), a row a case.
    resume : bool
        Whether a store of the same settings is completed.
    chunk : int, optional
        Most cases of a block; the memory in use grows with it. When not given, a 32nd of all, but 2048 to 32768
        of them, with inputs at most 4096; 16 where they are solved one by one.
    model : str, optional
        Model of the scene; its smallest when not given.
    distributed : distributed.Client, optional
        In place of an executor.
    native : bool, optional
        Whether as machine code; see `ExactInversion`.
    progress : callable, optional
        Called with (cases done, cases in all).

    Returns
    -------
    xarray.Dataset
        ``peak_NAME`` of every input and quantity of drives, their energies and effective torques, ``margin_NAME`` of
        every limit (negative where it is broken), ``swing`` where the model has it, and ``failure``: the message of a
        case that is not solved, with NaN as its numbers. Units are attributes of the variables, settings those of the
        dataset.

    Raises
    ------
    InvalidSetting, ServocoreError
        If something that varies is no parameter or outside its bounds, a limit is not known, a store is there already
        or has other settings, the workers are lost, or xarray or zarr is not installed.

    Examples
    --------
    >>> import numpy as np
    >>> import servocore as sc
    >>> crane = sc.scenes.rotary_crane()
    >>> dataset = sc.sweep(crane, {"load_mass": np.linspace(50, 150, 11), "duration": np.linspace(10, 30, 5)})
    >>> dataset.peak_M_b.sel(load_mass=100).dims
    ('duration',)
    """
    swept = checked_settings(scene, parameters, references, limits, instants, inputs, model)
    _require_arguments(executor, distributed, chunk, progress)
    work = _work(swept, native)
    fitting = min(max(swept.grid.size // _BLOCKS, _FEWEST), _WITH_INPUTS if swept.inputs else _MOST) if work else _SLOW
    shape = swept.grid.block(chunk or fitting)
    settings = {**settings_of(swept), "function": sha256(work.by_expression.encode()).hexdigest() if work else None}
    blank = blank_dataset(swept, settings)
    kind = Parquet if store and Path(store).suffix == SUFFIX else Zarr
    sink = Memory(blank) if store is None else kind(Path(store), swept, blank, shape, resume)
    known = sink.known()
    todo = [block for block in swept.grid.blocks(shape) if block[0] not in known]
    done = swept.grid.size - sum(_count(block) for _, block in todo)
    try:
        for number, block, answers in _computed(swept, work, blank, todo, executor, distributed):
            try:
                sink.put(number, block, answers)
            except OSError as error:  # such as a full disk
                why = f"{error.strerror or error}; a resumed sweep continues after the stored blocks"
                raise InvalidSetting(f"cannot write {store}: {why}") from error
            done += _count(block)
            if progress is not None:
                progress(done, swept.grid.size)
    except PoolLost as lost:
        how = "resume=True (--resume) does the others" if store else "only a sweep with a store can be resumed"
        raise InvalidSetting(f"{lost}; {done} of {swept.grid.size} cases are done: {how}") from lost
    return sink.dataset()


def _require_arguments(executor: Any, distributed: Any, chunk: Any, progress: Any) -> None:
    """Raise `InvalidSetting` if an argument is of the wrong kind."""
    if executor is not None and distributed is not None:
        raise InvalidSetting("give either an executor or a client of distributed, not both")
    if executor is not None:
        require_kind(executor, Executor, "the executor", "a concurrent.futures.Executor", InvalidSetting)
    if distributed is not None and not hasattr(distributed, "get_executor"):
        raise InvalidSetting(f"distributed must be a Client of the package distributed, not {described(distributed)}")
    if chunk is not None:
        require_count(chunk, 1, "chunk, the cases of a block,", InvalidSetting)
    if progress is not None:
        require_callable(progress, "progress", "a function of (cases done, cases in all)")


def _count(block: Slices) -> int:
    return int(np.prod([slice_.stop - slice_.start for slice_ in block]))


# Computing -----------------------------------------------------------------------------------------------------------


def _work(swept: SweepSettings, native: bool | None) -> Work | None:
    """Compile the evaluation of every case; None where cases have to be solved one by one."""
    problem = swept.problem
    if problem.flat and not (problem.follow_branch or problem.system.time.numel()):
        try:
            motion = prepared_motion(problem)
            if motion.passages:
                require_feasible(problem)
        except ServocoreError:
            require_feasible(problem)  # a limit says more than a singular matrix
            raise
        if motion.direct:
            return work_of(problem, swept.limits, swept.inputs, native)
    rates = [limit.quantity for limit in swept.limits if limit.rate]
    if rates and not problem.flat:
        raise InvalidSetting(
            f"the cases of {problem.name} are solved one by one, where rates have no margin: {rates[0]}"
        )
    return None


def _computed(
    swept: SweepSettings,
    work: Work | None,
    blank: Any,
    todo: list[tuple[int, Slices]],
    executor: Executor | None,
    distributed: Any,
) -> Iterator[tuple[int, Slices, dict[str, Any]]]:
    """Yield the results of blocks as they come, with the sentences of cases that failed."""
    if work is None:
        for number, block in todo:
            yield number, block, _one_by_one(swept, blank, block)
        return
    with ThreadPoolExecutor(os.cpu_count() or 1) as threads:
        pool = Pool(executor or threads) if distributed is None else Cluster(distributed)
        waiting, left = dict[Any, tuple[int, Slices]](), iter(todo)
        try:
            while True:
                while len(waiting) < pool.ahead and (each := next(left, None)) is not None:
                    waiting[pool.submit(evaluated, work, _cases(swept, blank, each[1]))] = each
                if not waiting:
                    return
                for future in pool.completed(waiting):
                    number, block = waiting.pop(future)
                    yield number, block, _with_sentences(swept, blank, block, pool.result(future))
        finally:
            pool.forget(waiting)


def _cases(swept: SweepSettings, blank: Any, block: Slices) -> Cases:
    """Return the cases of a block as arrays."""
    grid, problem = swept.grid, swept.problem
    which, names = varied(blank, PATH, block).astype(np.intp), problem.system.parameters.names
    durations = np.array([reference.duration for reference in swept.references])
    numbers = np.column_stack([durations[which], np.tile(problem.p, (len(which), 1))])
    for name in grid.columns:
        values = varied(blank, name, block)
        numbers[:, 0 if name == DURATION else 1 + names.index(name)] = values
    order, jets = problem.array.reference_order, {}
    for path in np.unique(which).tolist():
        own_path = swept.references[path]
        at = own_path.jet(np.linspace(own_path.start_time, own_path.end_time, swept.instants), order)
        in_a_second = at * durations[path] ** np.arange(order + 1)[:, None]
        jets[path] = np.ascontiguousarray(in_a_second.reshape(len(at), -1).T)
    return Cases(jets, which, numbers)


# Cases that fail, and cases one by one -------------------------------------------------------------------------------


def _with_sentences(swept: SweepSettings, blank: Any, block: Slices, answers: dict[str, Array]) -> dict[str, Any]:
    """Add why cases are not solved."""
    failures = np.full(len(answers["solved"]), "", dtype=object)
    for k in np.flatnonzero(answers["solved"] == 0.0).tolist():
        failures[k] = (
            f"{swept.problem.name}: not solved at all of {swept.instants} instants from the guess of the model"
        )
        try:
            _solved(swept, blank, block, k)
        except ServocoreError as error:
            failures[k] = str(error)
    return {**answers, FAILURE: failures}


def _solved(swept: SweepSettings, blank: Any, block: Slices, k: int) -> Solution:
    case = {name: float(varied(blank, name, block)[k]) for name in swept.grid.columns}
    path = swept.references[int(varied(blank, PATH, block)[k])]
    law = in_time(path, case.pop(DURATION)) if DURATION in case else path
    scene = swept.scene.with_reference(law).with_parameters(**case)
    unlimited = replace(scene, limits=tuple(limit for limit in scene.limits if limit.of_path))
    return solve(unlimited, step=law.duration / (swept.instants - 1), model=swept.model)


def _one_by_one(swept: SweepSettings, blank: Any, block: Slices) -> dict[str, Any]:
    """Solve every case of a block, as `solve` does by default."""
    count, cases = _count(block), len(swept.grid.shape)
    answers = {name: np.full((count, *each.shape[cases:]), np.nan) for name, each in blank.items()}
    answers[FAILURE] = np.full(count, "", dtype=object)
    for k in range(count):
        try:
            found = _found(swept, _solved(swept, blank, block, k))
        except ServocoreError as error:
            answers[FAILURE][k] = str(error)
            continue
        for name in found.keys() & answers.keys():
            answers[name][k] = found[name]
    return answers


def _found(swept: SweepSettings, solution: Solution) -> dict[str, Any]:
    """Return the results of a case from its solution, by variable, and some that a sweep has not."""
    values = {name: solution[name] for name in solution.names}
    found: dict[str, Any] = {f"peak_{name}": np.abs(each).max() for name, each in values.items()}
    if SWING in values:
        found[SWING] = found[f"peak_{SWING}"]
    found |= {quantity.name: values[quantity.name] for quantity in swept.problem.system.inputs}
    found |= {each.name: values[each.name][-1] for each in run_quantities(solution.channels)}
    if any(limit.rate for limit in swept.limits):  # of a flat problem that follows a branch
        assert isinstance(solution.origin, Problem)
        problem = replace(solution.origin, limits=swept.limits)
        exact = limited_values(prepared_motion(problem), solution.t)
        values |= {limit.quantity: row for limit, row in zip(problem.motion_limits, exact, strict=True)}
    limits = [limit for limit in swept.limits if limit.quantity in values]
    margins = margins_of(limits, [values[limit.quantity] for limit in limits], solution.t)
    return found | {f"margin_{name}": margin.slack for name, margin in margins.items()}
