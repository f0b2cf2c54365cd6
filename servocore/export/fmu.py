"""`export_fmu`, `export_plant`, `export_trajectory`, `export_ssp`: native FMUs of a scene, complete or not at all."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

from servocore.errors import InvalidReference, InvalidSetting
from servocore.export.about import About
from servocore.export.building import inverse_model
from servocore.export.c_functions import operations
from servocore.export.description import build_description, model_description, terminals
from servocore.export.inverse_functions import METHOD
from servocore.export.native_model import HostRules, NativeModel
from servocore.export.parameter_sets import related_files
from servocore.export.plant_model import PlantOptions, plant_model
from servocore.export.routes import SteppedRoutes, with_routes
from servocore.export.sampled_laws import SampledEstimates, SampledFeedback
from servocore.export.sources import SHARED, compiled_files, fmu_sources, rendered, token_of
from servocore.export.system import Element, packed_system, require_played, wires_by_name
from servocore.export.targets import Progress, chosen_targets, libraries
from servocore.export.trajectory_model import TrajectoryOptions, trajectory_model
from servocore.export.variables import listed
from servocore.files import require_places, write_together, zipped
from servocore.model.scene import Scene, require_scene
from servocore.numerics.newton import MAX_ITERATIONS
from servocore.solvers.exact_inversion import ExactInversion

VERSIONS = (3, 2)
"""Versions of FMI; the first is the default."""


def export_fmu(
    scene: Scene,
    path: str | Path,
    *,
    fmi: int = 3,
    model: str | None = None,
    targets: str | None = None,
    feedback: SampledFeedback | None = None,
    estimates: SampledEstimates | None = None,
    routes: SteppedRoutes | None = None,
    start: Mapping[str, float | str] | None = None,
    host: HostRules | None = None,
    about: About | None = None,
    cross_check: Mapping[str, str] | None = None,
    progress: Progress = lambda _: None,
) -> Path:
    """Write the inverse model of a scene as a native FMU for co-simulation, which needs no Python.

    Parameters
    ----------
    scene : Scene
        Its parameter values become the start values of the FMU's, the start of its path that of the inputs.
    path : str or Path
        The file; tools ignore its name.
    fmi : int
        Version of FMI, 2 or 3.
    model : str, optional
        Model of the scene; its smallest when not given.
    targets : str, optional
        ``all``, ``host``, ``none`` for its sources alone, or names of platforms, as ``x86_64-windows``. When not given:
        all where the package ziglang is installed, else this machine's own.
    feedback : SampledFeedback, optional
        A law that corrects the inputs by measured values.
    estimates : SampledEstimates, optional
        An estimator of derivatives of the path that are not connected.
    routes : SteppedRoutes, optional
        Formulations and methods that may be chosen in place of the exact inversion of every instant.
    start : mapping of str to float or str, optional
        Start values of inputs and parameters in place of these, by the names of FMI 2, and items of choices.
    host : HostRules, optional
        Rules of the hosts: no ``<stdio.h>``, a bound of internal steps.
    about : About, optional
        Origin and rights of the component, and default items of choices.
    cross_check : mapping of str to str, optional
        Files of a run, by their names, that become a smoke test inside the FMU: see `cross_check_files`.
    progress : callable
        Called with a phrase for every stage.

    Returns
    -------
    Path
        The file.

    Raises
    ------
    InvalidModel
        If the scene's internal dynamics are unstable, or it has no such model.
    InvalidReference
        If the scene's own path breaks its limits.
    InvalidSetting
        If there is no compiler, a platform is unknown, the file cannot be written, or a start value is impossible.

    Examples
    --------
    >>> import servocore as sc
    >>> sc.export_fmu(sc.scenes.rotary_crane(), "crane.fmu", fmi=2, targets="host").name
    'crane.fmu'
    """
    require_scene(scene, "export_fmu")
    require_built(path, targets, fmi)
    progress("analysing")
    made = inverse_model(scene, model, feedback, estimates)
    if routes is not None:
        made = with_routes(made, scene, routes)
    made = replace(made.with_starts(start or {}), cross_check=cross_check or {})
    return written(described(made, host, about), path, fmi, targets, progress)


def export_plant(
    scene: Scene,
    path: str | Path,
    options: PlantOptions | None = None,
    *,
    model: str | None = None,
    fmi: int = 3,
    targets: str | None = None,
    host: HostRules | None = None,
    about: About | None = None,
    progress: Progress = lambda _: None,
) -> Path:
    """Write the forward dynamics of a scene as a native FMU for co-simulation: a plant with the scene's inputs.

    Parameters
    ----------
    scene : Scene
        Its parameter values become the start values of the FMU's; it begins at rest where its path begins.
    path : str or Path
        The file.
    options : PlantOptions, optional
        Differences of the plant from the scene's model.
    model : str, optional
        Model of the scene; when not given the first without constraints, or its smallest.
    fmi, targets, host, about, progress : optional
        As of `export_fmu`.

    Returns
    -------
    Path
        The file.

    Raises
    ------
    InvalidModel
        If constraints are redundant, or the equations contain the time.
    InvalidSetting
        As `export_fmu`.
    """
    require_scene(scene, "export_plant")
    require_built(path, targets, fmi)
    progress("compiling the forward dynamics")
    made = plant_model(scene, model, options)
    return written(described(made, host, about), path, fmi, targets, progress)


def export_trajectory(
    scene: Scene,
    path: str | Path,
    options: TrajectoryOptions | None = None,
    *,
    model: str | None = None,
    fmi: int = 3,
    targets: str | None = None,
    host: HostRules | None = None,
    about: About | None = None,
    progress: Progress = lambda _: None,
) -> Path:
    """Write a generator of paths for a scene as a native FMU: lines by a time law, or a built-in path.

    Parameters
    ----------
    scene : Scene
        Its own path gives the start values, and is built in unless it is a line by one of `TIME_LAWS`.
    path : str or Path
        The file.
    options : TrajectoryOptions, optional
        The path in place of it.
    model : str, optional
        Model of the scene, which determines the number of derivatives; its smallest when not given.
    fmi, targets, host, about, progress : optional
        As of `export_fmu`.

    Returns
    -------
    Path
        The file.

    Raises
    ------
    InvalidReference
        If the path has other components than the scene or too few derivatives, or breaks a limit of the scene.
    InvalidSetting
        As `export_fmu`.
    """
    require_scene(scene, "export_trajectory")
    require_built(path, targets, fmi)
    made = trajectory_model(scene, model, options)
    return written(described(made, host, about), path, fmi, targets, progress)


def described(model: NativeModel, host: HostRules | None, about: About | None = None) -> NativeModel:
    """Return a model with the rules of its hosts, and with its origin and default items."""
    about = about or About()
    return replace(model.with_run_quantities().with_starts(about.defaults), host=host or HostRules(), about=about)


def require_built(path: str | Path, targets: str | None, fmi: int, what: str = "an FMU", ending: str = ".fmu") -> None:
    """Raise `InvalidSetting` if a file cannot be built for its version and platforms, or written there."""
    chosen_targets(targets, require_version(fmi))
    if Path(path).suffix.lower() != ending:
        raise InvalidSetting(f"cannot write {path}: the name of {what} ends with {ending}, or tools do not open it")
    require_places({f"the {what.partition(' ')[2]}": Path(path)})


def written(model: NativeModel, path: str | Path, fmi: int, targets: str | None, progress: Progress) -> Path:
    """Compile and write an FMU, and return its file."""
    write_together({Path(path): archive(model, fmi, chosen_targets(targets, fmi), progress)})
    return Path(path)


def archive(model: NativeModel, fmi: int, targets: tuple[str, ...], progress: Progress) -> bytes:
    """Return a compiled FMU."""
    own = model.about.files(fmi)  # refused before anything is compiled
    sources = fmu_sources(model, fmi)
    built = libraries(sources, compiled_files(model, fmi), model.identifier, targets, fmi, progress, model.more_sources)
    unproven = [name for name in targets if name.endswith("darwin")]
    called = [each for name, each in model.functions.items() if not name.endswith("_tangent")]
    most = max(operations(each, at_most=True) for each in called)
    page = rendered(
        "page.html.j2", model=model, fmi=fmi, targets=targets, unproven=unproven, most=most, iterations=MAX_ITERATIONS,
        built=built, method=METHOD.name,
    )  # fmt: skip
    members = {
        "modelDescription.xml": model_description(model, token_of(model, fmi), fmi),
        "documentation/index.html": page.encode(),
        **{f"sources/{name}": text.encode() for name, text in sources.items()},
        **{place: each.content for place, each in built.items()},
    }
    members["model.png" if fmi == 2 else "terminalsAndIcons/icon.png"] = (SHARED / "icon.png").read_bytes()
    if fmi == 3:
        members["sources/buildDescription.xml"] = build_description(model)
        members["terminalsAndIcons/terminalsAndIcons.xml"] = terminals(model)
    if model.about.documentation is not None:
        members["documentation/model.html"] = page.encode()
    return zipped(members | own | related_files(model, fmi))


def require_version(fmi: int) -> int:
    """Return a version of FMI; raises `InvalidSetting` if there is no export for it."""
    if fmi not in VERSIONS:
        raise InvalidSetting(f"there is no export for FMI {fmi}; there are {' and '.join(map(str, sorted(VERSIONS)))}")
    return fmi


def export_ssp(
    scene: Scene,
    path: str | Path,
    *,
    fmi: int = 2,
    model: str | None = None,
    targets: str | None = None,
    host: HostRules | None = None,
    about: About | None = None,
    progress: Progress = lambda _: None,
) -> Path:
    """Write trajectory, inverse model and plant of a scene as native FMUs, connected in a system of SSP.

    Nothing has to be set in the tool: the trajectory plays the scene's own path, and the plant starts on it. The
    parameters of the scene are a set (SSV) that inverse model and plant share.

    Parameters
    ----------
    scene : Scene
        With its path and parameter values.
    path : str or Path
        The file; its name ends with ``.ssp``.
    fmi : int, optional
        Version of FMI: 2 with SSP 1.0, which most tools read, or 3 with SSP 2.0, whose connectors may be arrays.
    model : str, optional
        Model of trajectory and inverse model, as of `export_fmu`.
    targets : str, optional
        Platforms, as of `export_fmu`.
    host : HostRules, optional
        Rules of the hosts, as of `export_fmu`.
    about : About, optional
        Origin and rights of the FMUs.
    progress : callable, optional
        Called with a phrase for every stage.

    Returns
    -------
    Path
        The file.

    Raises
    ------
    InvalidModel, InvalidReference, InvalidSetting
        As `export_fmu` and `export_plant`; if the path starts in motion after 0 s, or with internal dynamics.

    Warns
    -----
    ServocoreWarning
        If the path ends in motion.
    """
    require_scene(scene, "export_ssp")
    require_built(path, targets, fmi, "a system", ".ssp")
    require_played(scene.reference)
    progress("analysing")
    inverse, trajectory, plant = inverse_model(scene, model), trajectory_model(scene, model), plant_model(scene)
    jet = scene.reference.jet(scene.reference.start_time, inverse.own["orders"] - 1)
    if jet[1:].any():
        if inverse.of("local"):
            raise InvalidReference(
                f"the path starts in motion, and {scene.name} has internal dynamics: start it from rest"
            )
        moving, forces = jet.ravel().tolist(), ExactInversion(scene, model)(scene.reference.start_time).tolist()
        inverse = inverse.with_starts(_named(inverse, "input", "", moving))
        begun = _named(plant, "parameter", "MOTION", moving) | _named(plant, "input", "", forces)
        plant = plant.with_starts(begun)
    elements = []
    for name, made in {"trajectory": trajectory, "inverse": inverse, "plant": plant}.items():
        fmu = archive(described(made, host, about), fmi, chosen_targets(targets, fmi), progress)
        elements.append(Element(name, made.identifier, fmu))
    shared = [each for each in inverse.of("parameter") if each.name in scene.parameter_values()]
    wires, end = wires_by_name(elements), scene.reference.end_time
    write_together({Path(path): packed_system(scene.name, elements, wires, end, shared)})
    return Path(path)


def _named(model: NativeModel, causality: str, role: str, values: list[float]) -> dict[str, float | str]:
    """Return values by the names of a model's numbers of one causality and role."""
    chosen = (each for each in listed(model.variables, 2) if each.causality == causality and each.role == role)
    return dict(zip((each.name for each in chosen), values, strict=False))
