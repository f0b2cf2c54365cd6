"""A path from a file in milliseconds or millimetres is refused, unless its header declares the units."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from command_lines import servocore as run

import servocore as sc
from servocore.errors import InvalidReference

SCENES: dict[str, Callable[[], sc.Scene]] = {
    "rotary_crane": sc.scenes.rotary_crane,
    "overhead_crane": sc.scenes.overhead_crane,
    "gantry_crane": sc.scenes.gantry_crane,
    "mass_on_car": sc.scenes.mass_on_car,
}


def outputs(scene: sc.Scene) -> list[str]:
    return [output.name for output in scene.model().outputs]


def table(file: Path, scene: sc.Scene, times: float, lengths: float, units: tuple[str, str] = ("", "")) -> Path:
    """Write the default path of a scene, its times and positions multiplied."""
    t = np.linspace(scene.reference.start_time, scene.reference.end_time, 101)
    rows = np.column_stack([times * t, lengths * scene.reference.jet(t, 0)[:, 0]])
    header = [f"time{units[0]}", *(f"{name}{units[1]}" for name in outputs(scene))]
    file.write_text("\n".join([",".join(header), *(",".join(map(repr, row)) for row in rows.tolist()), ""]))
    return file


def readers(scene: sc.Scene) -> list[Callable[[Path], sc.Reference]]:
    return [
        lambda file: sc.from_csv(file, columns=outputs(scene)),
        lambda file: sc.waypoints_from_csv(file, columns=outputs(scene)),
    ]


@pytest.mark.parametrize("name", SCENES)
@pytest.mark.parametrize(
    ("times", "lengths", "words"),
    [
        (1e3, 1.0, "milliseconds, .* write time .ms. into the header, or time .s. if"),
        (1.0, 1e3, "millimetres, .* write . .mm. and so on into the header, or . .m. if"),
        (1e3, 1e3, "milliseconds and its positions look like millimetres, .* time .ms. and . .mm. and so on into"),
    ],
)
def test_every_reader_refuses_milliseconds_and_millimetres(
    name: str, times: float, lengths: float, words: str, tmp_path: Path
) -> None:
    scene = SCENES[name]()
    file = table(tmp_path / "path.csv", scene, times, lengths)
    for read in readers(scene):
        with pytest.raises(InvalidReference, match=words):
            scene.with_reference(read(file))


def test_times_of_short_paths_and_far_positions_are_judged_by_the_scene(tmp_path: Path) -> None:
    quick = sc.scenes.overhead_crane()
    file = table(tmp_path / "path.csv", quick, 1e3, 1.0)  # 3000 s at 2 mm/s: plausible for a longer path
    path = sc.from_csv(file, columns=outputs(quick))
    with pytest.raises(InvalidReference, match=r"milliseconds, for 3000 s .* has a path of 3 s and reaches 5 m"):
        quick.with_reference(path)
    with pytest.raises(InvalidReference, match="milliseconds"):
        sc.fastest(quick, path, {"F": 100.0})
    far = sc.from_csv(table(tmp_path / "far.csv", quick, 300.0, 1e3, (" [s]", "")), columns=outputs(quick))
    with pytest.raises(InvalidReference, match=r"far\.csv: its positions look like millimetres, .* reaches 5 m"):
        quick.with_reference(far)
    with pytest.raises(InvalidReference, match=r"far\.csv: its positions look like millimetres"):
        sc.export_trajectory(quick, tmp_path / "T.fmu", sc.TrajectoryOptions(far))


@pytest.mark.parametrize("name", SCENES)
def test_large_and_slow_paths_are_taken_and_so_is_every_declared_unit(name: str, tmp_path: Path) -> None:
    scene = SCENES[name]()
    for times, lengths in ((1.0, 1.0), (20.0, 1.0), (10.0, 20.0), (0.05, 0.01)):
        for read in readers(scene):
            scene.with_reference(read(table(tmp_path / "path.csv", scene, times, lengths)))
    for units in ((" [s]", " [m]"), (" [ms]", " [mm]")):
        file = table(tmp_path / "path.csv", scene, 1e3, 1e3, units)
        for read in readers(scene):
            if units[0] == " [s]":
                scene.with_reference(read(file))
            else:
                with pytest.warns(sc.ServocoreWarning, match="time in ms"):
                    path = read(file)
                scene.with_reference(path)
                assert path.duration == pytest.approx(scene.reference.duration)


@pytest.mark.parametrize(
    "line", ["feedforward", "view", "export --trajectory -o T.fmu", "plan --limit F=30 -o p.csv", "effects"]
)
@pytest.mark.usefixtures("empty_folder")
def test_the_command_lines_refuse_them(line: str, tmp_path: Path) -> None:
    file = table(tmp_path / "path.csv", sc.scenes.overhead_crane(), 1e3, 1.0)
    command, *options = line.split()
    for reader in ("--reference", "--waypoints"):
        result = run(command, "overhead_crane", *options, reader, file)
        run.assert_refused(result, "its times look like milliseconds", "write time [ms] into the header")
