"""A WebAssembly module called from Python, by wasmtime: what the loader does in JavaScript."""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt
from budgets import shared_by_all_files
from fmu_host import only_one, scratch
from native_fmu import scene_called
from present import of_kind

import servocore as sc
from servocore.export.wasm import SECTION
from servocore.numerics.compiled_calls import Array

if TYPE_CHECKING:
    import wasmtime


@cache
def module_file(name: str) -> Path:
    """Return a module that the first to ask for it has built."""
    file = scratch() / f"{name}.wasm"
    with only_one(scratch() / f"{name}.wasm.busy"), shared_by_all_files():
        return file if file.is_file() else sc.export_wasm(scene_called(name), file)


def sections(content: bytes) -> list[tuple[int, bytes]]:
    """Return numbers and contents of a module's sections."""
    found, k = [], 8
    while k < len(content):
        number, length, shift = content[k], 0, 0
        while True:
            k += 1
            length |= (content[k] & 127) << shift
            shift += 7
            if content[k] < 128:
                break
        found.append((number, content[k + 1 : k + 1 + length]))
        k += 1 + length
    return found


Verdicts = npt.NDArray[np.int32]


class Module:
    def __init__(self, name: str) -> None:
        import wasmtime

        content = module_file(name).read_bytes()
        mark = bytes([len(SECTION)]) + SECTION.encode()
        (text,) = [each for number, each in sections(content) if number == 0 and each.startswith(mark)]
        self.about = json.loads(text[len(mark) :])
        self.store = wasmtime.Store()
        self.exports = wasmtime.Instance(self.store, wasmtime.Module(self.store.engine, content), []).exports(
            self.store
        )
        self.outputs = [each["name"] for each in self.about["outputs"]]

    def parameters(self, **values: float) -> np.ndarray:
        return np.array([values.get(each["name"], each["start"]) for each in self.about["parameters"]])

    def invert(
        self, jets: np.ndarray, times: Array | None = None, **parameters: float
    ) -> tuple[dict[str, Array], Verdicts]:
        """Return outputs by name and verdicts for jets of shape (N, orders, m)."""
        count = len(jets)
        times = np.zeros(count) if times is None else times
        return self._called(
            count, [times, _laid_out(jets), self.parameters(**parameters)],
            lambda t, path, p, to, verdicts: self._function("invert")(self.store, count, t, path, p, to, verdicts),
        )  # fmt: skip

    def march(
        self, jets: np.ndarray, h: float, start: float = 0.0, **parameters: float
    ) -> tuple[dict[str, Array], Verdicts]:
        """The same in steps; the first jets belong to the instants that a start needs."""
        count = len(jets)
        return self._called(
            count - len(self.about["instants"]) + 1, [_laid_out(jets), self.parameters(**parameters)],
            lambda path, p, to, verdicts: self._function("march")(self.store, count, start, h, path, p, to, verdicts),
        )  # fmt: skip

    def _function(self, name: str) -> wasmtime.Func:
        import wasmtime

        return of_kind(wasmtime.Func, self.exports[name])

    def _called(
        self, instants: int, numbers: Sequence[Array], call: Callable[..., int]
    ) -> tuple[dict[str, Array], Verdicts]:
        import wasmtime

        memory = of_kind(wasmtime.Memory, self.exports["memory"])
        base = of_kind(wasmtime.Global, self.exports["__heap_base"]).value(self.store)
        sizes = [*(each.nbytes for each in numbers), 8 * len(self.outputs) * instants, 4 * instants]
        places = -(-base // 8) * 8 + np.concatenate([[0], np.cumsum(sizes)])
        missing = int(places[-1]) - memory.data_len(self.store)
        if missing > 0:
            memory.grow(self.store, -(-missing // 65536))
        for place, each in zip(places, numbers, strict=False):
            memory.write(self.store, each.tobytes(), int(place))
        solved = call(*map(int, places[:-1]))
        read = bytes(memory.read(self.store, int(places[-3]), int(places[-1])))
        table = np.frombuffer(read[: sizes[-2]]).reshape(-1, instants)
        verdicts = np.frombuffer(read[sizes[-2] :], dtype=np.int32)
        assert solved == (verdicts == 0).sum()
        return dict(zip(self.outputs, table, strict=True)), verdicts


def _laid_out(jets: np.ndarray) -> np.ndarray:
    return np.ascontiguousarray(jets.reshape(len(jets), -1).T)
