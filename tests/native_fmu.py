"""A small master for native FMUs of both versions of FMI, and the FMUs that the tests share, each built once."""

from __future__ import annotations

import ctypes
import os
import re
import subprocess
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from typing import Any

import fmpy
import numpy as np
import numpy.typing as npt
from fmu_host import OK, Host, built_once, scratch
from outside import timed
from present import of_kind
from problems import driven_crane
from scipy.interpolate import BPoly

import servocore as sc
from crane_fmu.build.estimates import estimates_of
from crane_fmu.build.native import PLANT, feedback_of
from crane_fmu.files import put
from servocore.export.building import inverse_model
from servocore.export.fmu import written
from servocore.export.plant_model import plant_model
from servocore.export.trajectory_model import trajectory_model
from servocore.numerics.compiled_calls import Array
from servocore.numerics.machine_code import c_compiler

FULL = os.environ.get("SERVOCORE_NATIVE") == "full"
NATIVE = Path(__file__).parent / "native"
HEADERS = Path(fmpy.__file__).parent / "c-code"
START, END = 1, 2
"""Values of input_time."""

HOWTO = Path(__file__).resolve().parent.parent / "docs" / "howto" / "add-a-scene.md"


@cache
def users_scene() -> sc.Scene:
    """Return the scene of the page that shows how to write one."""
    blocks = re.findall(r"^```python\n(.*?)^```", HOWTO.read_text(encoding="utf-8"), re.DOTALL | re.MULTILINE)
    names: dict[str, Any] = {"__name__": "page"}
    for block in blocks[:3]:
        exec(compile(block, str(HOWTO), "exec", dont_inherit=True), names)
    return of_kind(sc.Scene, names["elastic_hoist"]())


def crossing() -> sc.Scene:
    """Return the crane whose trolley passes through the slewing axis: it follows a branch from step to step."""
    path = sc.rest_to_rest((3.0, 0.0, -5.0), (-2.0, 0.0, -5.0), 15.0)
    return replace(sc.scenes.rotary_crane(across_axis=True).with_reference(path), name="crossing")


ARM = Path(__file__).resolve().parents[1] / "examples" / "ur5.urdf"


def elastic_arm() -> sc.Scene:
    """Return the UR5 of the examples with elastic joints."""
    joints = [each.name for each in sc.scenes.from_file(ARM).model().outputs]
    return sc.scenes.from_file(ARM, elastic=dict.fromkeys(joints, sc.Elastic(1e4, 0.3)))


VENDOR = """
version = "4.2"
author = "Jane Doe"
company = "ACME & Sons"
license = "proprietary"
license_text = "terms.txt"
copyright = "Copyright 2026 ACME */"
description = "A <component>"
icon = "icon.png"
documentation = "page.html"
[annotations."com.acme"]
order = "17"
line = "3"
[defaults]
"""


def put_vendor(folder: Path) -> None:
    """Write a vendor's files."""
    texts = {"terms.txt": b"All rights reserved.", "page.html": b"<html>ACME</html>", "vendor.toml": VENDOR.encode()}
    put(folder, {**texts, "icon.png": b"\x89PNG and so on"})


LIMITS: dict[str, Any] = {"F": (-60.0, 1300.0), "w.rate": 2.0}
SLOW = sc.rest_to_rest((0.0,), (5.0,), 8.0)
OTHERS: dict[str, Callable[[], sc.Scene]] = {
    "elastic_arm": elastic_arm,
    "crossing": crossing,
    "driven": driven_crane,
    "elastic_hoist": users_scene,
    "limited": lambda: replace(users_scene().with_limits(**LIMITS), name="limited", reference=SLOW),
    "ship": lambda: timed.load_below_a_ship().scene,
    "waves": timed.mass_in_waves,
    "wind": lambda: timed.pendulum_in_the_wind().scene,
}


@cache
def c_host(fmi: int) -> Path:
    """Return a host in C: see native/host.c."""
    program = scratch() / f"host {fmi}"
    options = ["-O1", "-w", f"-DFMI={fmi}", f"-I{HEADERS}"]
    subprocess.run([*c_compiler(), *options, NATIVE / "host.c", "-o", program, "-ldl"], check=True)
    return program


def numbers_of(text: str) -> np.ndarray:
    """Return what a host in C prints."""
    return np.array([line.split() for line in text.splitlines()], dtype=float)


@cache
def scene_called(name: str) -> sc.Scene:
    return {**sc.scenes.REGISTRY, **OTHERS}[name]()


@dataclass(frozen=True, kw_only=True, eq=False)
class Joined(sc.Reference):
    """A path as an FMU joins what it is told at equal steps: polynomials with the same derivatives at both ends."""

    nodes: np.ndarray
    known: np.ndarray

    @classmethod
    def of(cls, path: sc.Reference, orders: int, steps: int) -> Joined:
        nodes = np.linspace(path.start_time, path.end_time, steps + 1)
        return cls(
            start_time=path.start_time, end_time=path.end_time, dimension=path.dimension, max_order=2 * orders - 1,
            smoothness=orders - 1, nodes=nodes, known=path.jet(nodes, orders - 1),
        )  # fmt: skip

    def _derivatives(self, t: np.ndarray, order: int) -> np.ndarray:
        found, last = np.zeros((len(t), order + 1, self.dimension)), len(self.nodes) - 2
        pieces = np.clip(np.searchsorted(self.nodes, t, side="right") - 1, 0, last)
        for k in set(pieces.tolist()):
            origin, ends, at = self.known[k, 0], self.known[k : k + 2].copy(), pieces == k
            ends[:, 0] -= origin  # else round-off of positions counts in accelerations
            h = self.nodes[k + 1] - self.nodes[k]
            tau = np.clip(t[at] - self.nodes[k], 0.0, h)
            for row in range(self.dimension):
                piece = BPoly.from_derivatives([0.0, h], ends[:, :, row].tolist())
                found[at, :, row] = np.stack([piece(tau, each) for each in range(order + 1)], axis=-1)
            found[at, 0] += origin
        return found


def joined(name: str, steps: int) -> sc.Scene:
    """Return a scene on its own path as an FMU joins it between communication points."""
    scene = scene_called(name)
    return scene.with_reference(Joined.of(scene.reference, exported(name).own["orders"], steps))


def inputs_along_path(name: str, steps: int) -> Array:
    """Return the inputs (steps + 1, m) that the library computes along the scene's own path, as an FMU joins it."""
    scene = scene_called(name)
    if not exported(name).of("local"):
        path = scene.reference
        return sc.ExactInversion(scene)(np.linspace(path.start_time, path.end_time, steps + 1))
    step = scene.reference.duration / steps
    solution = sc.solve(joined(name, steps), sc.Reduced(), sc.RadauIIA(3), step=step)
    return np.column_stack([solution[each.name] for each in scene.model().inputs])


@cache
def exported(name: str) -> Any:
    """Return what is exported of a scene: ``cars`` its inverse model, ``cars plant``, ``cars trajectory``, and of the
    rotary crane ``rotary_crane loop`` the inverse model with feedback
    and estimated derivatives."""
    scene, _, what = name.partition(" ")
    if what == "plant":
        plant = plant_model(scene_called(scene), None, PLANT if scene == "rotary_crane" else None)
        return plant.with_run_quantities()
    if what == "trajectory":
        return trajectory_model(scene_called(scene), None, sc.TrajectoryOptions(path_of(scene)))
    own = scene_called(scene)
    if what == "loop":
        return inverse_model(own, None, feedback_of(own), estimates_of(own))
    return inverse_model(own).with_run_quantities()


@cache
def path_of(scene: str) -> sc.Reference | None:
    """Return the path that a trajectory carries."""
    if scene != "rotary_crane":
        return None
    return sc.through([(5.0, 0.0, -5.0), (4.0, 3.0, -3.0), (-2.0, 2.0, -2.0)], duration=20.0)


@cache
def native_file(name: str, fmi: int) -> Path:
    file = f"native-{name.replace(' ', '-')}-{fmi}.fmu"
    return built_once(file, lambda place: written(exported(name), place, fmi, "host", lambda _: None))


class Native(Host):
    """A native FMU; the path is all its inputs."""

    def __init__(self, name: str, fmi: int = 3, file: Path | None = None) -> None:
        super().__init__(file or native_file(name, fmi), name=name)
        self.name = name
        self.inputs, self.results, self.parameters = (
            tuple(each.name for each in self.description.modelVariables if each.causality == causality)
            for causality in ("input", "output", "parameter")
        )
        self.path = self.inputs

    def values(self) -> np.ndarray:
        return self.get(*self.results)

    def saved(self) -> bytes:
        """Return the serialized state."""
        prefix = "FMUstate" if self.fmi == 2 else "FMUState"
        state = getattr(self.fmu, f"get{prefix}")()
        found = getattr(self.fmu, f"serialize{prefix}")(state)
        getattr(self.fmu, f"free{prefix}")(state)
        return bytes(found)

    def restore(self, saved: bytes) -> None:
        prefix = "FMUstate" if self.fmi == 2 else "FMUState"
        name = f"deSerialize{prefix}" if self.fmi == 2 else f"deserialize{prefix}"
        state = getattr(self.fmu, name)(saved)
        getattr(self.fmu, f"set{prefix}")(state)
        getattr(self.fmu, f"free{prefix}")(state)

    def sensitivities(self, knowns: Sequence[str], weights: Array) -> np.ndarray:
        """Derivatives of a weighted sum of all outputs by some variables."""
        unknowns, by = ([self.references[name] for name in names] for names in (self.results, knowns))
        sizes = sum(self.sizes[name] for name in knowns)
        found = (ctypes.c_double * sizes)()
        given = (ctypes.c_double * len(weights))(*weights)
        arrays = [(ctypes.c_uint * len(each))(*each) for each in (unknowns, by)]
        call = self.fmu.dll.fmi3GetAdjointDerivative
        call.argtypes = [ctypes.c_void_p, *[ctypes.c_void_p, ctypes.c_size_t] * 4]
        status = call(
            self.fmu.component, arrays[0], len(unknowns), arrays[1], len(by), given, len(weights), found, sizes
        )
        assert status == OK, self.messages
        return np.array(found)

    def derivatives(self, knowns: Sequence[str], seeds: Sequence[float] | Array) -> np.ndarray:
        """Derivatives of all outputs along a direction of variables."""
        unknowns = [self.references[name] for name in self.results]
        by = [self.references[name] for name in knowns]
        given = unknowns, by, [float(each) for each in np.ravel(seeds)]
        if self.fmi == 2:
            return np.array(self.fmu.getDirectionalDerivative(*given))
        return np.array(self.fmu.getDirectionalDerivative(*given, sum(self.sizes[name] for name in self.results)))


def jets_of(name: str, t: npt.ArrayLike) -> np.ndarray:
    """Return the jets (N, orders, m) of the scene's own path as the FMU takes them."""
    return scene_called(name).reference.jet(np.asarray(t, dtype=float), exported(name).own["orders"] - 1)


def along_path(host: Native, steps: int, **parameters: float) -> np.ndarray:
    """Return outputs (steps + 1, outputs) along the scene's own path; inputs belong to the end of each step."""
    path = scene_called(host.name).reference
    t = np.linspace(path.start_time, path.end_time, steps + 1)
    jets, h = path.jet(t, exported(host.name).own["orders"] - 1), t[1] - t[0]
    host.start(jets[0], t[0], input_time=END, **parameters)
    found = [host.values()]
    for k in range(steps):
        assert host.tell(jets[k + 1]).step(t[k], h), host.messages
        found.append(host.values())
    return np.array(found)
