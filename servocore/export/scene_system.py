"""`export_ssp`: trajectory, inverse model and plant of a scene, connected: feedforward control as one file."""

from __future__ import annotations

from pathlib import Path

from servocore.errors import InvalidReference, InvalidSetting
from servocore.export.about import About
from servocore.export.building import inverse_model
from servocore.export.fmu import archive, described, require_version
from servocore.export.native_model import HostRules, NativeModel
from servocore.export.plant_model import plant_model
from servocore.export.system import Element, packed_system, require_played, wires_by_name
from servocore.export.targets import Progress, chosen_targets
from servocore.export.trajectory_model import trajectory_model
from servocore.files import require_places, write_together
from servocore.model.scene import Scene, require_scene
from servocore.solvers.exact_inversion import ExactInversion


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
    file, names = Path(path), chosen_targets(targets, require_version(fmi))
    if file.suffix.lower() != ".ssp":
        raise InvalidSetting(f"cannot write {file}: the name of a system ends with .ssp, or tools do not open it")
    require_places({"the system": file})
    require_played(scene.reference)
    progress("analysing")
    inverse, trajectory, plant = inverse_model(scene, model), trajectory_model(scene, model), plant_model(scene)
    jet = scene.reference.jet(scene.reference.start_time, inverse.orders - 1)
    if jet[1:].any():
        if inverse.method:
            raise InvalidReference(
                f"the path starts in motion, and {scene.name} has internal dynamics: start it from rest"
            )
        moving, forces = jet.ravel().tolist(), ExactInversion(scene, model)(scene.reference.start_time).tolist()
        inverse = inverse.with_starts(_named(inverse, "input", "", moving))
        begun = _named(plant, "parameter", "MOTION", moving) | _named(plant, "input", "", forces)
        plant = plant.with_starts(begun)
    elements = []
    for name, made in {"trajectory": trajectory, "inverse": inverse, "plant": plant}.items():
        fmu = archive(described(made, host, about), fmi, names, progress)
        elements.append(Element(name, made.identifier, fmu))
    shared = [each for each in inverse.of("parameter") if each.name in scene.parameter_values()]
    wires, end = wires_by_name(elements), scene.reference.end_time
    write_together({file: packed_system(scene.name, elements, wires, end, shared)})
    return file


def _named(model: NativeModel, causality: str, role: str, values: list[float]) -> dict[str, float | str]:
    """Return values by the names of a model's numbers of one causality and role."""
    chosen = (each for each in model.variables if each.causality == causality and each.role == role)
    return dict(zip((name for each in chosen for name in each.scalar_names), values, strict=False))
