"""What WebAssembly modules cost: `python benchmarks/wasm_cost.py [--smoke]`, with ziglang, and Node for the times.

Every scene along its own path, a thousand instants in a call of the loader, arrays copied in and out, all modules in
turn: the fastest call of each, in microseconds an instant of `invert` and a step of `march`, and the module's size. The
project sets itself bounds of 0.5 us an instant and 50 kB. With `--smoke` all run a few times; times then mean nothing.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import tempfile
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console
from rich.table import Table

import servocore as sc
from servocore.export.wasm import SECTION

INSTANTS, CALLS, FEW_CALLS = 1000, 300, 3
MOST_MICROSECONDS, MOST_BYTES = 0.5, 50_000

SCRIPT = """
import fs from "node:fs";
const cases = JSON.parse(fs.readFileSync("cases.json"));
for (const each of cases) {
  const { load } = await import(`./${each.name}.mjs`);
  each.module = await load(fs.readFileSync(`${each.name}.wasm`));
  for (const path of ["invert", "march"]) each[path] = Float64Array.from(each[path]);
  each.times = { invert: Infinity, march: Infinity };
}
const timed = (each, name, call) => {
  if (!each.module[name]) return;
  const begun = process.hrtime.bigint(), { solved } = call();
  each.times[name] = Math.min(each.times[name], Number(process.hrtime.bigint() - begun) / 1e3 / INSTANTS);
  if (solved !== INSTANTS) throw new Error(`${each.name}: ${name} solves ${solved} of ${INSTANTS}`);
};
for (let k = 0; k < CALLS; k++)
  for (const each of cases) {
    timed(each, "invert", () => each.module.invert(each.invert));
    timed(each, "march", () => each.module.march(each.march, each.step));
  }
console.log(JSON.stringify(cases.map(({ times }) => times)));
"""


def case(name: str, folder: Path) -> dict[str, Any]:
    """Write a scene's module, and return the paths that it is given."""
    scene = sc.scenes.REGISTRY[name]()
    about = described(sc.export_wasm(scene, folder / f"{name}.wasm").read_bytes())
    orders = len(about["path"]) // len(scene.model().outputs)
    t, step = np.linspace(scene.reference.start_time, scene.reference.end_time, INSTANTS, retstep=True)
    past = np.concatenate([t[0] + float(step) * np.array(about["instants"] or [0.0]), t[1:]])

    def laid_out(times: np.ndarray) -> list[float]:
        values: list[float] = scene.reference.jet(times, orders - 1).reshape(len(times), -1).T.ravel().tolist()
        return values

    return {"name": name, "invert": laid_out(t), "march": laid_out(past), "step": float(step)}


def described(module: bytes) -> dict[str, Any]:
    """Return what a module says of itself, in its last section."""
    mark = bytes([len(SECTION)]) + SECTION.encode()
    about: dict[str, Any] = json.loads(module[module.rindex(mark) + len(mark) :])
    return about


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--smoke", action="store_true")
    calls = FEW_CALLS if parser.parse_args().smoke else CALLS
    names = sorted(sc.scenes.REGISTRY)
    with tempfile.TemporaryDirectory(prefix="servocore_") as folder:
        place = Path(folder)
        (place / "cases.json").write_text(json.dumps([case(name, place) for name in names]), encoding="utf-8")
        script = SCRIPT.replace("INSTANTS", str(INSTANTS)).replace("CALLS", str(calls))
        (place / "main.mjs").write_text(script, encoding="utf-8")
        done = subprocess.run(["node", "main.mjs"], cwd=place, capture_output=True, text=True, check=True)
        sizes = [(place / f"{name}.wasm").stat().st_size for name in names]
    table = Table("scene", "invert, us an instant", "march, us a step", "kB", title=f"bounds: {MOST_MICROSECONDS} us, "
                  f"{MOST_BYTES / 1000:.0f} kB")  # fmt: skip
    for name, size, times in zip(names, sizes, json.loads(done.stdout), strict=True):
        table.add_row(name, *(f"{each:.2f}" if each else "" for each in times.values()), f"{size / 1000:.1f}")
    Console().print(table)


if __name__ == "__main__":
    main()
