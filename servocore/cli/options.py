"""Groups of options that commands share; each option is declared once."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, fields
from functools import partial
from importlib import import_module
from pathlib import Path
from typing import Any, ClassVar

from servocore.cli.choices import FORMULATIONS, METHODS
from servocore.cli.chosen_scene import chosen_scene
from servocore.cli.command import given_options, option
from servocore.cli.kinds import (
    FILE,
    FILE_READ,
    LIMIT,
    NUMBER,
    PICTURE,
    POINT,
    STEP,
    STIFFNESS,
    TIME,
    Kind,
    choice,
    once,
    quantity,
    text,
)
from servocore.errors import InvalidReference, InvalidSetting, ServocoreWarning
from servocore.export.targets import HOST, TARGETS
from servocore.files import PICTURES, figure_file
from servocore.formulations.base import Formulation
from servocore.methods.base import Method
from servocore.model.limits import Bounds
from servocore.model.parameter_files import read_drives, read_limits, read_parameters, read_table
from servocore.model.scene import Scene
from servocore.problem import Problem
from servocore.references.base import LONGEST_TIME, Reference
from servocore.references.csv_file import samples_or_waypoints, waypoints_from_csv
from servocore.references.profiles import (
    TIME_LAWS,
    Profile,
    ThreePhaseProfile,
    polynomial,
    three_phase,
)
from servocore.references.rest_to_rest import rest_to_rest
from servocore.references.splines import fewest_samples
from servocore.solution import Solution
from servocore.solvers.route import Adaptive

MOST_ROWS = 1e7
"""Largest number of rows of a table: more are taken for a mistake, for they would fill the memory."""


def output(metavar: str, help: str, kind: Kind = FILE, default: Any = None) -> Any:  # noqa: A002
    """Declare the option that names the result of a command."""
    return option("-o", "--output", kind=kind, metavar=metavar, help=help, default=default)


@dataclass(frozen=True)
class Subject:
    """The system that a command computes."""

    title: ClassVar[str] = "System"

    scene: str = option(
        kind=Kind("scene", "rotary_crane", str), metavar="SCENE", default=...,
        help="A scene of the library, as listed by servocore scenes, module:function of your own, or a file of URDF,"
        " MJCF or SDF.",
    )  # fmt: skip
    parameters: Path | None = option(
        "--parameters", kind=FILE_READ, metavar="FILE.toml",
        help="Parameters in SI units, one line each, such as load_mass = 80.0; the others keep their defaults.",
    )  # fmt: skip
    drives: Path | None = option(
        "--drives", kind=FILE_READ, metavar="FILE.toml",
        help='Motors and transmissions, a table for each input: [M_b] with ratio = 120, rated_power = "7.5 kW", ...',
    )  # fmt: skip
    model: str | None = option(
        "--model",
        kind=text("points"),
        metavar="NAME",
        help="Model of the scene. Default: the first, the smallest.",
    )
    servo_output: tuple[str, ...] = option(
        "--servo-output", kind=text("tool0"), metavar="NAME", default=(),
        help="Of a file: a joint, a frame for its place, or tool0.rx for a rotation. Default: all driven joints.",
    )  # fmt: skip
    elastic: tuple[Mapping[str, float], ...] = option(
        "--elastic", kind=STIFFNESS, metavar="K", default=(),
        help="Of a file: stiffness of all driven joints (N m/rad, N/m), or of one as JOINT=K.",
    )  # fmt: skip
    motor_inertia: float | None = option(
        "--motor-inertia", kind=NUMBER, metavar="B",
        help="With --elastic: inertia of each motor behind its gear (kg m2, kg). Default: the armature in the file.",
    )  # fmt: skip
    import_settings: Path | None = option(
        "--import", kind=FILE_READ, metavar="FILE.toml",
        help="Of a file: more settings, the arguments of servocore.scenes.from_file by name.",
    )  # fmt: skip

    def imported(self) -> dict[str, object]:
        """Return the settings for a file; raises `InvalidSetting` or `InvalidModel` if they are malformed."""
        settings = {} if self.import_settings is None else read_table(self.import_settings)
        stiffness: dict[str, object] = dict(once("--elastic", self.elastic))
        if "" in stiffness and len(stiffness) > 1:
            raise InvalidSetting("--elastic gives one stiffness for all joints, or one for each JOINT=K, not both")
        given = {
            "outputs": list(self.servo_output),
            "elastic": stiffness.get("", stiffness),
            "motor_inertia": self.motor_inertia,
        }
        return settings | {name: value for name, value in given.items() if value not in ([], {}, None)}

    def driven(self) -> Scene:
        """Return the scene with its drives, with default parameters."""
        scene = chosen_scene(self.scene, self.imported())
        return scene if self.drives is None else scene.with_drives(**read_drives(self.drives, scene))

    def chosen(self) -> Scene:
        """Return the scene with its parameters; raises `InvalidSetting` or `InvalidModel` if there is no such scene."""
        scene = self.driven()
        return scene.with_parameters(**self.changes(scene))

    def changes(self, scene: Scene) -> dict[str, float]:
        """Return the values in the file of parameters, empty without one."""
        return {} if self.parameters is None else read_parameters(self.parameters, scene)


@dataclass(frozen=True)
class GivenPath:
    """The prescribed path of the outputs: from a file, or a straight line; without options that of the scene."""

    title: ClassVar[str] = "Path"

    reference: Path | None = option(
        "--reference", kind=FILE_READ, metavar="FILE.csv",
        help="Sampled path: the header is time and the names of the outputs, optionally followed by derivatives, as"
        " vx,vy,vz. Few rows are read as waypoints. A plan keeps the geometry alone.",
    )  # fmt: skip
    tolerance: str | None = option(
        "--tolerance", kind=text("1mm"), metavar="LENGTH",
        help="Largest distance of the path from rounded or noisy samples: 1mm, or a number of metres.",
    )  # fmt: skip
    waypoints: Path | None = option(
        "--waypoints", kind=FILE_READ, metavar="FILE.csv",
        help="Points with times, joined from rest to rest; velocities and a column stop are optional.",
    )  # fmt: skip
    start: tuple[float, ...] | None = option(
        "--from", kind=POINT, metavar="X Y ...", help="Start of a line: as many numbers as the scene has outputs."
    )
    end: tuple[float, ...] | None = option("--to", kind=POINT, metavar="X Y ...", help="End of the line.")
    duration: float | None = option("--duration", kind=TIME, metavar="T", help="Duration of the motion (s).")
    profile: Profile | None = option(
        "--profile", kind=choice("profile", TIME_LAWS), metavar="NAME",
        help=f"Time law along the line: {', '.join(TIME_LAWS)}. Default: the first that is smooth enough.",
    )  # fmt: skip
    ramp: float | None = option(
        "--ramp", kind=TIME, metavar="TAU0", help="With three-phase: acceleration time (s). Default: duration/4."
    )

    def options(self) -> list[str]:
        """Return the options that describe a path; raises `InvalidSetting` if they exclude each other."""
        given = given_options(self)
        if self.tolerance is not None:
            given.remove("--tolerance")
            if self.reference is None:
                raise InvalidSetting("--tolerance belongs to --reference: it bounds the distance from its samples")
        if len(given) > 1 and (self.reference or self.waypoints):
            raise InvalidSetting(f"a path is given either by {given[0]} or by {given[1]}, not by both")
        return given

    def path(self, scene: Scene, model: str | None = None) -> Reference | None:
        """Return the path, with as many continuous derivatives as the scene requires; None without options."""
        given = self.options()
        if not given:
            return None
        rest_order = Problem.of(scene, model).array.reference_order
        outputs = scene.model(model).outputs
        names, units = [each.name for each in outputs], [each.unit for each in outputs]
        if self.waypoints is not None:
            through = waypoints_from_csv(self.waypoints, names, rest_order=rest_order, units=units)
            return scene.with_reference(through).reference  # which refuses units that are implausible for the scene
        if self.reference is None:
            missing = [each for each in ("--from", "--to", "--duration") if each not in given]
            if missing:
                raise InvalidSetting(f"a straight line also needs {' and '.join(missing)}")
            return self._line(scene, model, rest_order)
        tolerance = None if self.tolerance is None else quantity("--tolerance", self.tolerance, units[0], "1mm")
        path, rows = samples_or_waypoints(self.reference, names, tolerance, rest_order, units)
        if rows is not None:
            warnings.warn(
                f"{self.reference}: its {rows} rows are read as waypoints; a sampled path has at least"
                f" {fewest_samples(rest_order)} rows",
                ServocoreWarning,
                stacklevel=2,
            )
        return scene.with_reference(path).reference

    def points(
        self, scene: Scene, model: str | None = None, via: Sequence[tuple[float, ...]] = ()
    ) -> list[tuple[float, ...]]:
        """Return start, via points and end; raises `InvalidSetting` unless all have the dimension of the scene."""
        names = [output.name for output in scene.model(model).outputs]
        found = [("--from", self.start or ()), *(("--via", point) for point in via), ("--to", self.end or ())]
        for name, point in found:
            if len(point) != len(names):
                shown = "".join(f" {each:g}" for each in point)
                numbers = f"{len(names)} number{'s' * (len(names) > 1)}, {', '.join(names)}"
                form = " ".join(names).upper()
                raise InvalidSetting(f"{name}{shown}: it needs {numbers}: write it as {name} {form}")
        return [point for _, point in found]

    def along(self, scene: Scene, model: str | None = None) -> Scene:
        """Return the scene with this path; unchanged without one."""
        path = self.path(scene, model)
        return scene if path is None else scene.with_reference(path)

    def _line(self, scene: Scene, model: str | None, rest_order: int) -> Reference:
        (first, last), duration, law = self.points(scene, model), self.duration, self.profile
        assert duration is not None
        if duration > LONGEST_TIME:
            raise InvalidReference(f"the duration of {duration:g} s is longer than the limit of {LONGEST_TIME:g} s")
        if law is None:
            fewest = 2 * rest_order + 1
            law = polynomial(next(degree for degree in (9, 13, fewest) if degree >= fewest))
        if self.ramp is not None:
            if not isinstance(law, ThreePhaseProfile):
                raise InvalidSetting("--ramp belongs to --profile three-phase")
            law = three_phase(self.ramp)
        return rest_to_rest(first, last, duration, profile=law)


@dataclass(frozen=True)
class GivenLimits:
    """Limits of inputs, observables, outputs and their rates."""

    title: ClassVar[str] = "Limits"

    limit: tuple[Mapping[str, Bounds], ...] = option(
        "--limit", kind=LIMIT, metavar="NAME=VALUE", default=(),
        help="A limit of an input, observable or output, or of its rate: F=60, M_w=-104..-92, swing=5deg, s.rate=1.2.",
    )  # fmt: skip
    limits: Path | None = option(
        "--limits", kind=FILE_READ, metavar="FILE.toml",
        help='More limits: F = 60, M_w = [-104, -92], swing = "5 deg"; --limit replaces those of the same names.',
    )  # fmt: skip

    def bounds(self) -> Mapping[str, Bounds]:
        """Return limits for `Scene.with_limits`; raises `InvalidSetting` or `InvalidModel` if one is malformed."""
        return {**({} if self.limits is None else read_limits(self.limits)), **once("--limit", self.limit)}


@dataclass(frozen=True)
class Rows:
    """Time between the rows of a result."""

    title: ClassVar[str] = "Computation"

    step: float | None = option(
        "--step", kind=STEP, metavar="H",
        help="Time between rows (s). It must divide the duration; a plan reduces it to the next that does. Default:"
        " duration/200; of drive: 0.01 s or less.",
    )  # fmt: skip

    def require(self, duration: float) -> None:
        """Raise `InvalidSetting` if a duration has more than `MOST_ROWS` steps."""
        for each in fields(self):
            step = getattr(self, each.name)
            if each.metadata["kind"] is STEP and step is not None and duration / step > MOST_ROWS:
                raise InvalidSetting(f"a step of {step:g} s makes more than {MOST_ROWS:g} rows: take a larger step")


@dataclass(frozen=True)
class Computation(Rows):
    """Formulation, method and accuracy; without options those that the analysis recommends."""

    formulation: Formulation | None = option(
        "--formulation", kind=choice("formulation", FORMULATIONS), metavar="NAME",
        help=f"One of {', '.join(FORMULATIONS)}. Default: recommended by the analysis.",
    )  # fmt: skip
    method: Method | None = option(
        "--method", kind=choice("method", METHODS), metavar="NAME",
        help=f"One of {', '.join(METHODS)}. Default: recommended by the analysis;"
        f" {next(iter(METHODS))} with --formulation.",
    )  # fmt: skip
    rtol: float | None = option(
        "--rtol", kind=NUMBER, metavar="R", help="Instead of a step: tolerance of the inputs relative to their peaks."
    )
    atol: float | None = option(
        "--atol", kind=NUMBER, metavar="A", help="Instead of a step: absolute tolerance of the inputs, in their units."
    )
    output_step: float | None = option(
        "--output-step", kind=STEP, metavar="H",
        help="With --rtol or --atol: time between rows (s); divides the duration. Default: duration/200.",
    )  # fmt: skip

    def accuracy(self) -> float | Adaptive | None:
        """Return the step or tolerance for `solve`; raises `InvalidSetting` if options exclude each other."""
        if self.rtol is None and self.atol is None:
            if self.output_step is not None:
                raise InvalidSetting("--output-step belongs to --rtol or --atol; without them every step is a row")
            return self.step
        if self.step is not None:
            raise InvalidSetting("accuracy is given either by --step or by --rtol and --atol, not by both")
        return Adaptive(self.rtol or 0.0, self.atol or 0.0)


@dataclass(frozen=True)
class Table:
    """The table of a result, and its picture."""

    title: ClassVar[str] = "Results"

    output: Path | None = output("FILE.csv", "The table to write. Default: standard output.")
    columns: str | None = option(
        "--columns", kind=text("F,swing"), metavar="NAMES",
        help="Columns after the time, separated by commas: inputs, observables such as swing, outputs, coordinates.",
    )  # fmt: skip
    plot: Path | None = option(
        "--plot", kind=PICTURE, metavar="FILE.png", help=f"Draw a picture: {', '.join(PICTURES)}."
    )
    verbose: bool = option("-v", "--verbose", help="Print counts of the run, its time, and all versions as well.")

    def picture(self, draw: Callable[[Any], Any]) -> dict[Path, str | bytes]:
        """Return the picture by its file, none without --plot; `draw` takes the module of pictures."""
        if self.plot is None:
            return {}
        pictures = import_module("servocore.cli.pictures")  # slow, for it imports Matplotlib
        return {self.plot: figure_file(draw(pictures), self.plot.suffix.lower())}


@dataclass(frozen=True)
class Platforms:
    """Platforms to compile for."""

    title: ClassVar[str] = "Platforms"

    targets: str | None = option(
        "--targets", kind=text(HOST), metavar="LIST",
        help=f"all, {HOST} (this machine), or some of {', '.join(TARGETS)}, separated by commas.",
    )  # fmt: skip


@dataclass(frozen=True)
class Certified:
    """The certificate of inputs that a command hands out: their proof for all times of the run."""

    title: ClassVar[str] = "Certificate"

    no_certify: bool = option("--no-certify", help="Skip the proof that the inputs hold at all times of the run.")

    def line(
        self, subject: Scene | Solution, model: str | None = None, told: Callable[[str], None] | None = None, *,
        tolerance: float = 1e-8, strict: bool = False,
    ) -> list[str]:  # fmt: skip
        """Return the verdict in one line, none with --no-certify; `strict` raises an error where it is refuted."""
        if self.no_certify:
            return []
        if told is not None:
            told("proving the inputs")
        from servocore.certificate.certify import certify, require_certified  # noqa: PLC0415 - few commands certify

        prove = partial(require_certified, warn=False) if strict else certify
        return [f"  certificate: {prove(subject, tolerance=tolerance, model=model).summary}"]
