"""Sweeps: every case has the numbers of its own solution, wherever it is computed, however often interrupted."""

from __future__ import annotations

import errno
import os
import re
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from importlib.util import find_spec
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from command_lines import servocore as line
from hypothesis import given, settings
from hypothesis import strategies as st
from outside.systems import elbow_arm, vtol
from present import present
from problems import along_its_line

import servocore as sc
from servocore.model.limits import Bounds
from servocore.planning import worker_pools
from servocore.planning.sweep_settings import drawn
from servocore.planning.sweep_store import Parquet, Zarr

pytestmark = pytest.mark.skipif(not (find_spec("xarray") and find_spec("zarr")), reason="needs xarray and zarr")

CRANE = sc.scenes.rotary_crane()
LIMITS = {"F": 60.0, "s.rate": 1.0}
MASSES, DURATIONS = np.linspace(50.0, 150.0, 7), np.array([10.0, 14.0, 20.0])
VARIED = {"load_mass": MASSES, "duration": DURATIONS}


def assert_case_is_its_solution(found: Any, scene: sc.Scene, path: sc.Reference, **parameters: float) -> sc.Solution:
    solution = sc.solve(scene.with_reference(path).with_parameters(**parameters), step=path.duration / 200)
    for name in (each.name for each in scene.model().inputs):
        assert float(found[f"peak_{name}"]) == pytest.approx(np.abs(solution[name]).max(), rel=1e-12)
    if "swing" in solution:
        assert float(found.swing) == pytest.approx(np.abs(solution["swing"]).max(), rel=1e-9)
    return solution


def default_path(duration: float) -> sc.Reference:
    return along_its_line(CRANE, duration).reference


def test_every_case_of_a_product_has_the_peaks_and_margins_of_its_solution() -> None:
    found = sc.sweep(CRANE, VARIED, limits=LIMITS)
    assert dict(found.sizes) == {"load_mass": 7, "duration": 3}
    for i, k in ((0, 0), (3, 1), (6, 2)):
        case, path = found.isel(load_mass=i, duration=k), default_path(DURATIONS[k])
        solution = assert_case_is_its_solution(case, CRANE, path, load_mass=MASSES[i])
        assert float(case.margin_F) == pytest.approx(60.0 - np.abs(solution["F"]).max(), rel=1e-12)
        rate = np.gradient(solution["s"], solution.t)[2:-2]
        assert float(case["margin_s.rate"]) == pytest.approx(1.0 - np.abs(rate).max(), abs=1e-3)
    assert (found.failure == "").all()


def test_margins_are_those_of_a_solution_at_kinks_and_across_full_turns_too() -> None:
    around = sc.rest_to_rest((-4.0, 2.0, -5.0), (-3.0, -3.0, -4.0), 20.0)  # the bridge passes 180 degrees
    limits: dict[str, Bounds] = {"swing.rate": 1.0, "phi": (-np.pi, 1.5 * np.pi), "s": 6.0}
    found = sc.sweep(CRANE, {"load_mass": [80.0, 120.0]}, [around], limits=limits).isel(path=0)
    for k, mass in enumerate((80.0, 120.0)):
        scene = CRANE.with_reference(around).with_parameters(load_mass=mass).with_limits(**limits)
        for name, margin in sc.solve(scene, step=0.1).margins.items():
            assert float(found[f"margin_{name}"][k]) == pytest.approx(margin.slack, rel=1e-9)


@pytest.mark.parametrize("model", CRANE.models)
def test_every_model_gives_the_same_numbers(model: str) -> None:
    few = {"load_mass": MASSES[:2], "duration": DURATIONS[:2]}
    found, smallest = sc.sweep(CRANE, few, model=model), sc.sweep(CRANE, few)
    for name in ("peak_M_b", "peak_F", "peak_M_w"):
        np.testing.assert_allclose(found[name], smallest[name], rtol=1e-9)


def test_units_coordinates_and_settings_are_told() -> None:
    found = sc.sweep(CRANE, VARIED, limits=LIMITS, inputs=True, instants=21)
    assert found.peak_M_b.attrs["units"] == "N.m"
    assert found.load_mass.attrs["units"] == "kg"
    assert found.duration.attrs["units"] == "s"
    assert found.margin_F.attrs["units"] == "N"
    assert found.M_b.dims == ("load_mass", "duration", "instant")
    np.testing.assert_array_equal(np.abs(found.M_b).max("instant"), found.peak_M_b)
    assert '"scene": "rotary_crane"' in found.attrs["settings"]


@settings(max_examples=8, deadline=None)
@given(st.lists(st.tuples(st.floats(30.0, 300.0), st.floats(9.0, 40.0)), min_size=1, max_size=5))
def test_rows_of_a_table_are_cases(rows: Any) -> None:
    table = [{"load_mass": mass, "duration": duration} for mass, duration in rows]
    found = sc.sweep(CRANE, table)
    assert found.sizes["case"] == len(rows)
    mass, duration = rows[-1]
    assert_case_is_its_solution(found.isel(case=-1), CRANE, default_path(duration), load_mass=mass)


def test_paths_vary_too_whatever_they_are() -> None:
    t = np.linspace(0.0, 15.0, 80)
    paths = [CRANE.reference, sc.sampled(t, sc.rest_to_rest((4.0, 0.0, -5.0), (1.0, 3.0, -4.0), 15.0).jet(t, 0)[:, 0])]
    found = sc.sweep(CRANE, {"load_mass": [80.0, 120.0], "duration": [18.0]}, paths)
    assert dict(found.sizes) == {"path": 2, "load_mass": 2, "duration": 1}
    own = sc.sweep(CRANE, {"load_mass": [80.0, 120.0]}, paths)
    assert_case_is_its_solution(own.isel(path=1, load_mass=0), CRANE, paths[1], load_mass=80.0)


@pytest.mark.parametrize("scene", [sc.scenes.mass_on_car(), elbow_arm().scene, vtol().scene], ids=lambda e: e.name)
def test_scenes_that_need_it_are_solved_case_by_case(scene: sc.Scene) -> None:
    duration = scene.reference.duration
    found = sc.sweep(scene, {"duration": [1.25 * duration, 1.5 * duration]}, instants=201)
    solution = sc.solve(scene, step=duration / 200)
    assert set(found.sizes) == {"duration"}
    assert (found.failure == "").all()
    names = [each.name for each in scene.model().inputs]
    assert all(0.0 < float(found[f"peak_{name}"][0]) < 2.0 * np.abs(solution[name]).max() for name in names)


def test_a_case_that_fails_is_a_row_with_its_sentence() -> None:
    found = sc.sweep(CRANE, {"duration": [1.0, 20.0]})
    with pytest.raises(sc.ServocoreError) as refused:
        sc.solve(CRANE.with_reference(default_path(1.0)), step=1.0 / 200)
    assert str(found.failure[0].item()) == str(refused.value)
    assert np.isnan(found.peak_M_b[0])
    assert found.failure[1] == ""
    assert np.isfinite(found.peak_M_b[1])
    weightless = sc.sweep(sc.scenes.overhead_crane(), {"gravity": [1.0, 9.81]})
    assert "the rope goes slack" in weightless.failure[0].item()


@pytest.mark.parametrize("name", ["s.zarr", "s.parquet"])
@pytest.mark.parametrize("chunk", [1, 5, 21])
def test_a_store_holds_what_memory_does(tmp_path: Path, chunk: int, name: str) -> None:
    kept = sc.sweep(CRANE, VARIED, limits=LIMITS, inputs=True, instants=31)
    stored = sc.sweep(CRANE, VARIED, limits=LIMITS, inputs=True, instants=31, store=tmp_path / name, chunk=chunk)
    assert stored.drop_attrs().load().identical(kept.drop_attrs())


def test_xarray_opens_a_store_by_its_name_alone_as_the_dataset_returned(tmp_path: Path) -> None:
    xarray = pytest.importorskip("xarray")
    returned = sc.sweep(CRANE, VARIED, limits=LIMITS, store=tmp_path / "s.zarr", chunk=5)
    with xarray.open_zarr(tmp_path / "s.zarr") as opened:
        assert opened.load().identical(returned.load())


def test_a_folder_of_tables_has_a_row_a_case_with_units_and_settings(tmp_path: Path) -> None:
    pandas, parquet = pytest.importorskip("pandas"), pytest.importorskip("pyarrow.parquet")
    varied = {"load_mass": MASSES, "duration": [1.0, *DURATIONS]}
    found = sc.sweep(CRANE, varied, limits=LIMITS, store=tmp_path / "s.parquet", chunk=5)
    table = pandas.read_parquet(tmp_path / "s.parquet").set_index(["load_mass", "duration"])
    assert len(table) == found.failure.size
    for name in found:
        np.testing.assert_array_equal(table.to_xarray()[name], found[name])
    assert (table.failure[:, 1.0] != "").all()
    schema = parquet.read_schema(tmp_path / "s.parquet" / "part-000000.parquet")
    assert schema.field("peak_M_b").metadata[b"units"] == b"N.m"
    assert b'"scene": "rotary_crane"' in schema.metadata[b"settings"]


DRIVER = """
import numpy as np, servocore as sc, sys
varied = {"load_mass": np.linspace(50.0, 150.0, 7), "duration": np.array([10.0, 14.0, 20.0])}

def tell(*_):
    print("block", flush=True)
    sys.stdin.readline()

sc.sweep(sc.scenes.rotary_crane(), varied, store="s.zarr", chunk=3, progress=tell)
"""


@pytest.mark.nightly
def test_a_driver_that_is_killed_leaves_a_store_that_is_completed(tmp_path: Path) -> None:
    command = [sys.executable, "-c", DRIVER]
    with subprocess.Popen(
        command, cwd=tmp_path, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, bufsize=1
    ) as driver:
        present(driver.stdin).write("go on once\n")
        for _ in range(2):
            assert present(driver.stdout).readline() == "block\n"
        driver.kill()
    seen = []
    found = sc.sweep(
        CRANE, VARIED, store=tmp_path / "s.zarr", chunk=3, resume=True, progress=lambda done, _: seen.append(done)
    )
    assert 2 <= len(seen) <= 5
    assert found.drop_attrs().load().identical(sc.sweep(CRANE, VARIED).drop_attrs())


def test_processes_compute_the_same_digits() -> None:
    with ProcessPoolExecutor(2, mp_context=get_context("spawn")) as pool:
        found = sc.sweep(CRANE, VARIED, limits=LIMITS, executor=pool, chunk=6)
    assert found.identical(sc.sweep(CRANE, VARIED, limits=LIMITS))


def test_an_executor_whose_worker_is_killed_is_told_in_a_sentence_and_the_store_completed_by_another(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    store, varied = tmp_path / "s.zarr", {"load_mass": np.linspace(50.0, 150.0, 12)}  # more than are under way at once
    monkeypatch.setattr(worker_pools.Pool, "ahead", 2)  # or a worker may have computed all before it is killed
    with ProcessPoolExecutor(1, mp_context=get_context("spawn")) as pool:

        def kill(*_: object) -> None:
            for each in list(pool._processes.values()):
                each.kill()

        with pytest.raises(sc.InvalidSetting, match="the executor gave up: BrokenProcessPool"):
            sc.sweep(CRANE, varied, executor=pool, store=store, chunk=1, progress=kill)
    found = sc.sweep(CRANE, varied, store=store, chunk=1, resume=True)
    assert found.drop_attrs().load().identical(sc.sweep(CRANE, varied).drop_attrs())


@pytest.fixture(scope="module")
def cluster() -> Iterator[Any]:
    distributed = pytest.importorskip("distributed")
    with distributed.LocalCluster(2, threads_per_worker=1, dashboard_address=None, silence_logs=50) as found:
        yield found


def kill_process(worker: Any) -> None:
    """End the process of a worker of Dask, as a machine without memory does."""
    if worker.pid is not None:
        os.kill(worker.pid, signal.SIGKILL)


@pytest.fixture
def client(cluster: Any) -> Iterator[Any]:
    cluster.scale(2)
    with cluster.get_client() as found:
        found.wait_for_workers(1, timeout=60)
        yield found


@pytest.mark.nightly
def test_a_worker_of_dask_that_is_killed_costs_no_case(tmp_path: Path, cluster: Any, client: Any) -> None:
    killed: list[Any] = []

    def kill(done: int, _: object) -> None:
        if done >= 6 and not killed:
            killed.append(next(iter(cluster.workers.values())))
            kill_process(killed[0])
            time.sleep(0.1)

    found = sc.sweep(CRANE, VARIED, distributed=client, store=tmp_path / "s.zarr", chunk=1, progress=kill)
    assert killed
    assert found.drop_attrs().load().identical(sc.sweep(CRANE, VARIED).drop_attrs())


@pytest.mark.usefixtures("client")
def test_a_connection_that_ends_is_told_in_a_sentence_and_the_store_completed_without_it(
    tmp_path: Path, cluster: Any
) -> None:
    distributed, store = pytest.importorskip("distributed"), tmp_path / "s.zarr"
    told = pytest.raises(sc.InvalidSetting, match=r"scheduler does not answer; .* of 21 cases are done: resume=True")
    # As a default client Dask would ask for it ever after, closed as it is.
    with distributed.Client(cluster, set_as_default=False) as own, told:
        sc.sweep(CRANE, VARIED, distributed=own, store=store, chunk=1, progress=lambda *_: own.close())
    found = sc.sweep(CRANE, VARIED, store=store, chunk=1, resume=True)
    assert found.drop_attrs().load().identical(sc.sweep(CRANE, VARIED).drop_attrs())


@pytest.mark.nightly
def test_a_cluster_that_loses_all_workers_is_told_and_the_store_completed_without_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, cluster: Any, client: Any
) -> None:
    store, done = tmp_path / "s.zarr", []
    monkeypatch.setattr(worker_pools, "PATIENCE", 1.0)

    def dismiss(count: int, _: object) -> None:
        done.append(count)
        cluster.scale(0)
        while client.ncores():
            time.sleep(0.05)

    with pytest.raises(sc.InvalidSetting, match=r"had no worker for 1 s; .* of 21 cases are done: resume=True") as lost:
        sc.sweep(CRANE, VARIED, distributed=client, store=store, chunk=1, progress=dismiss)
    assert f" {done[-1]} of 21" in str(lost.value)
    found = sc.sweep(CRANE, VARIED, store=store, chunk=1, resume=True, progress=lambda count, _: done.append(count))
    assert sorted(set(done)) == list(range(1, 22))
    assert len(done) == 21  # no case twice
    assert found.drop_attrs().load().identical(sc.sweep(CRANE, VARIED).drop_attrs())


@pytest.mark.nightly
def test_a_block_that_dask_gives_up_is_told_in_a_sentence(
    monkeypatch: pytest.MonkeyPatch, cluster: Any, client: Any
) -> None:
    monkeypatch.setattr(cluster.scheduler, "allowed_failures", 0)

    def kill(*_: object) -> None:
        for each in cluster.workers.values():
            kill_process(each)

    with pytest.raises(sc.InvalidSetting, match=r"the executor gave up: KilledWorker: .* only a sweep with a store"):
        sc.sweep(CRANE, {"load_mass": np.linspace(50.0, 150.0, 2000)}, distributed=client, chunk=1, progress=kill)


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"parameters": {"weight": [1.0]}}, "has no parameter weight"),
        ({"parameters": {"load_mass": [-1.0, 50.0]}}, "load_mass = -1"),
        ({"parameters": {"load_mass": [np.nan]}}, "must be a row of finite numbers"),
        ({"parameters": {"duration": [0.0]}}, "durations must be positive"),
        ({"parameters": {}}, "nothing varies"),
        ({"parameters": [{"load_mass": 1.0}, {"rope": 2.0}]}, "all have the same names"),
        ({"limits": {"colour": 3.0}}, "colour"),
        ({"limits": {"F.rate": 200.0}}, "F.rate takes a derivative that a sweep does not have"),
        ({"instants": 1}, "instants must be a whole number of at least 2, not 1"),
        ({"chunk": 0}, "chunk, the cases of a block, must be a whole number of at least 1, not 0"),
        ({"parameters": 5}, "a table of cases is a data frame"),
        ({"references": CRANE.reference}, "references must be a list of paths"),
        ({"executor": 5}, "the executor must be a concurrent.futures.Executor, not 5"),
        ({"progress": 4}, r"progress must be a function of \(cases done, cases in all\), not 4"),
        ({"distributed": 6}, "distributed must be a Client of the package distributed, not 6"),
        ({"scene": sc.scenes.mass_on_car(), "parameters": {"mass": [1.0]}, "limits": {"u.rate": 1.0}}, "one by one"),
    ],
)
def test_what_is_wrong_is_named_before_anything_is_computed(change: dict[str, Any], said: str, tmp_path: Path) -> None:
    store = tmp_path / "s.zarr"
    with pytest.raises(sc.ServocoreError, match=said):
        sc.sweep(**{"scene": CRANE, "parameters": VARIED, "store": store, **change})
    assert not store.exists()


@pytest.mark.parametrize("name", ["s.zarr", "s.parquet"])
def test_a_store_of_another_sweep_is_not_resumed(tmp_path: Path, name: str) -> None:
    store = tmp_path / name
    sc.sweep(CRANE, VARIED, store=store)
    with pytest.raises(sc.InvalidSetting, match="is there already"):
        sc.sweep(CRANE, VARIED, store=store)
    with pytest.raises(sc.InvalidSetting, match="another sweep: instants differ"):
        sc.sweep(CRANE, VARIED, store=store, instants=101, resume=True)
    (tmp_path / "folder").mkdir()
    with pytest.raises(sc.InvalidSetting, match="no store of a sweep"):
        sc.sweep(CRANE, VARIED, store=(tmp_path / "folder").rename(tmp_path / f"other_{name}"), resume=True)


def test_a_store_of_other_equations_under_the_same_name_is_not_resumed(tmp_path: Path) -> None:
    masses, store = {"load_mass": MASSES}, tmp_path / "s.zarr"
    sc.sweep(CRANE, masses, store=store)
    system = CRANE.model()
    heavier = replace(system, mass=2.0 * system.mass)
    with pytest.raises(sc.InvalidSetting, match="another sweep: function differ"):
        sc.sweep(replace(CRANE, models={"points": lambda: heavier}), masses, store=store, resume=True)


@pytest.mark.parametrize("name", ["s.zarr", "s.parquet"])
def test_a_disk_that_is_full_is_told_and_what_is_there_is_completed_later(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, name: str
) -> None:
    store, puts = tmp_path / name, []

    def full(self: Any, number: int, block: Any, found: Any) -> None:
        puts.append(number)
        if len(puts) > 3:
            raise OSError(errno.ENOSPC, "No space left on device")
        original(self, number, block, found)

    kind = Parquet if name.endswith("parquet") else Zarr
    original = kind.put
    with monkeypatch.context() as limited:
        limited.setattr(kind, "put", full)
        with pytest.raises(sc.InvalidSetting, match="No space left on device; a resumed sweep continues"):
            sc.sweep(CRANE, VARIED, store=store, chunk=3)
    done = []
    found = sc.sweep(CRANE, VARIED, store=store, chunk=3, resume=True, progress=lambda *_: done.append(1))
    assert len(done) == 4
    assert found.drop_attrs().load().identical(sc.sweep(CRANE, VARIED).drop_attrs())


def test_draws_fill_the_ranges_evenly_and_come_again() -> None:
    rows = drawn({"a": (0.0, 1.0), "b": (-5.0, 5.0)}, 50, 3)
    assert rows == drawn({"a": (0.0, 1.0), "b": (-5.0, 5.0)}, 50, 3)
    values = np.sort([each["a"] for each in rows])
    assert (np.floor(values * 50) == np.arange(50)).all()


# The command ---------------------------------------------------------------------------------------------------------


@pytest.mark.usefixtures("empty_folder")
def test_the_command_fills_a_store_draws_a_page_and_resumes(tmp_path: Path) -> None:
    xarray = pytest.importorskip("xarray")
    words = ["sweep", "rotary_crane", "--vary", "load_mass=50..150:7", "--vary", "duration=10..20:3", "--limit", "F=60"]
    run = line(*words, "-o", "study")
    assert run.exit_code == 0
    assert "21 cases, 0 of them not solved" in run.stdout
    with xarray.open_zarr(tmp_path / "study" / "sweep.zarr") as found:
        own = sc.sweep(CRANE, {"load_mass": MASSES, "duration": np.linspace(10.0, 20.0, 3)}, limits={"F": 60.0})
        np.testing.assert_array_equal(found.peak_M_b, own.peak_M_b)
        np.testing.assert_array_equal(found.margin_F, own.margin_F)
    page = (tmp_path / "study" / "index.html").read_text(encoding="utf-8")
    assert "21 cases, 0 not solved" in page
    assert "peak_M_b" in page
    assert (tmp_path / "study" / "sweep.png").read_bytes().startswith(b"\x89PNG")
    line.assert_refused(line(*words, "-o", "study"), "is there already: resume it")
    assert line(*words, "-o", "study", "--resume").exit_code == 0
    assert line(*words, "-o", "study", "--parquet").exit_code == 0
    assert len(list((tmp_path / "study" / "sweep.parquet").glob("part-*"))) == 1
    assert "sweep.parquet" in (tmp_path / "study" / "index.html").read_text(encoding="utf-8")


@pytest.mark.usefixtures("empty_folder")
def test_the_command_that_is_stopped_says_how_to_go_on(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    puts, put = list[int](), Zarr.put

    def stop(self: Any, number: int, block: Any, found: Any) -> None:
        puts.append(number)
        if len(puts) == 3:
            raise KeyboardInterrupt
        put(self, number, block, found)

    words = ["sweep", "rotary_crane", "--vary", "load_mass=50..150:7", "--vary", "duration=10..20:11", "-o", "study"]
    monkeypatch.setattr("servocore.planning.sweep._FEWEST", 8)  # cases of a block
    with monkeypatch.context() as interrupted:
        interrupted.setattr(Zarr, "put", stop)
        run = line(*words)
    assert run.exit_code == 130
    assert run.stderr.splitlines()[-1] == "servocore: stopped; --resume completes study/sweep.zarr"
    assert [each.name for each in (tmp_path / "study").iterdir()] == ["sweep.zarr"]
    run = line(*words, "--resume")
    assert run.exit_code == 0
    assert "77 cases, 0 of them not solved" in run.stdout


@pytest.mark.usefixtures("empty_folder")
def test_the_command_draws_cases_whose_table_is_drawn_and_opened_as_it_was_asked_for(
    tmp_path: Path, recwarn: pytest.WarningsRecorder
) -> None:
    xarray = pytest.importorskip("xarray")
    words = ["sweep", "rotary_crane", "--vary", "winch_radius=0.1..0.2", "--vary", "load_mass=50..150", "--sample", "9"]
    run = line(*words, "-o", "study")
    assert run.exit_code == 0, run.stderr
    page = (tmp_path / "study" / "index.html").read_text(encoding="utf-8")
    assert "Varied: winch_radius from" in page
    quantities = re.findall("<tr><td>(\\w+)", page)
    assert quantities == ["peak_F", "peak_M_b", "peak_M_w", "swing"]
    assert 'xarray.open_zarr("sweep.zarr")</code>' in page
    with xarray.open_zarr(tmp_path / "study" / "sweep.zarr") as found:
        assert {*found.coords} == {"case", "winch_radius", "load_mass"}
        assert found.load_mass.dims == ("case",)
    assert [str(each.message) for each in recwarn] == []


@pytest.mark.usefixtures("empty_folder")
def test_a_missing_package_is_told_before_the_work(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for package, extra in (("matplotlib.axes", "report"), ("xarray", "sweep"), ("zarr", "sweep")):
        with monkeypatch.context() as without:
            without.setitem(sys.modules, package, None)
            without.delitem(sys.modules, "servocore.cli.pictures", raising=False)
            run = line("sweep", "rotary_crane", "--vary", "load_mass=50..150:3", "-o", "study")
        line.assert_refused(run, f"pip install '.[{extra}]'")
        assert list(tmp_path.iterdir()) == []
