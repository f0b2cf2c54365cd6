"""The scene that a command names, of the library or of the user's own, with parameters and path from files."""

from __future__ import annotations

import importlib
import sys
import traceback
import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

from servocore.errors import InvalidSetting, ServocoreError, ServocoreWarning
from servocore.files import path_option
from servocore.model.parameter_files import read_parameters
from servocore.model.scene import Scene
from servocore.problem import Problem
from servocore.references.base import Reference
from servocore.references.csv_file import samples_or_waypoints, waypoints_from_csv
from servocore.references.splines import fewest_samples
from servocore.scenes import REGISTRY


def chosen(name: str, parameters: Path | None) -> Scene:
    """Return the scene of that name with the parameters of a file, if one is given.

    Parameters
    ----------
    name : str
        A scene of the library, or ``module:function`` for a function without arguments that returns one; modules are
        also looked for in the present folder.
    parameters : Path, optional
        A TOML file.

    Raises
    ------
    InvalidSetting
        If there is no such scene, module or function, or it returns something else.
    InvalidModel
        If the file cannot be read or holds something that is no parameter of the scene.
    """
    scene = _scene_of_user(name) if ":" in name else _registered(name)
    return scene if parameters is None else scene.with_parameters(**read_parameters(parameters, scene))


def path_columns(scene: Scene, model: str | None = None) -> tuple[list[str], list[str]]:
    """Return the names and the units of the position columns that files of a scene's path have: its outputs."""
    outputs = scene.model(model).outputs
    return [output.name for output in outputs], [output.unit for output in outputs]


@dataclass(frozen=True)
class GivenPath:
    """The options that give a path by a file, whose columns the outputs of a scene name.

    Attributes
    ----------
    reference : Path, optional
        A path, sampled; positions alone in few rows are taken as waypoints.
    waypoints : Path, optional
        Points with times, joined from rest to rest.
    tolerance : float, optional
        How far the path may stay away from the samples.
    """

    reference: Path | None = None
    waypoints: Path | None = None
    tolerance: float | None = None

    def option(self, others: Sequence[str] = ()) -> str | None:
        """Return which option gives a file, None if none does; raises `InvalidSetting` as `path_option`."""
        return path_option(self.reference, self.waypoints, self.tolerance, others)

    def path(self, scene: Scene, model: str | None = None) -> Reference | None:
        """Return the path, as smooth as the inputs of a scene need it; None without a file."""
        if self.option() is None:
            return None
        rest_order = Problem.of(scene, model).array.reference_order
        names, units = path_columns(scene, model)
        if self.waypoints is not None:
            return waypoints_from_csv(self.waypoints, names, rest_order=rest_order, units=units)
        assert self.reference is not None
        path, rows = samples_or_waypoints(self.reference, names, self.tolerance, rest_order, units)
        if rows is not None:
            warnings.warn(
                f"{self.reference}: its {rows} rows are taken as waypoints, for samples of a path are"
                f" {fewest_samples(rest_order)} or more",
                ServocoreWarning,
                stacklevel=2,
            )
        return path

    def along(self, scene: Scene, model: str | None = None) -> Scene:
        """Return the scene with the path of the file, or as it is without one."""
        path = self.path(scene, model)
        return scene if path is None else scene.with_reference(path)


def _registered(name: str) -> Scene:
    if name not in REGISTRY:
        raise InvalidSetting(
            f"no scene is called {name or repr(name)}; there are {', '.join(REGISTRY)}, and module:function for one of"
            " your own"
        )
    return REGISTRY[name]()


def _scene_of_user(name: str) -> Scene:
    """Return the scene that a function ``module:function`` of the user's own returns."""
    function = _function_of_user(name)
    try:
        scene = function()
        if isinstance(scene, Scene):
            scene.model()  # made once, here, where an error of its factory can be reported
    except ServocoreError:
        raise
    except (Exception, SystemExit) as error:
        if error.__traceback__ is not None and error.__traceback__.tb_next is None:  # raised by the call itself
            raise InvalidSetting(f"{name} cannot be called without arguments: {error}") from error
        raise InvalidSetting(f"{name} returns no scene: {_in_one_line(error)}") from error
    if not isinstance(scene, Scene):
        raise InvalidSetting(f"{name} returns {type(scene).__name__}, not a Scene")
    return scene


def _function_of_user(name: str) -> Callable[[], object]:
    """Import the function ``module:function``; modules are also looked for in the present folder."""
    module_name, _, function_name = name.partition(":")
    here = str(Path.cwd())
    if here not in sys.path:
        sys.path.insert(0, here)
    try:
        if "/" in module_name or "\\" in module_name or not all(module_name.split(".")):
            raise ModuleNotFoundError(name=module_name or repr(module_name))
        module = importlib.import_module(module_name)
    except ModuleNotFoundError as error:
        file = Path(module_name)
        hint = f"; in the folder of {file.name} it is {file.stem}:{function_name}" if file.suffix == ".py" else ""
        raise InvalidSetting(f"{name}: there is no module {error.name}{hint}") from None
    except (Exception, SystemExit) as error:  # the user's own code may raise anything
        raise InvalidSetting(f"{name}: the module cannot be imported: {_in_one_line(error)}") from error
    function: object = getattr(module, function_name, None)
    if not callable(function):
        raise InvalidSetting(f"{name}: the module {module_name} has no function {function_name!r}")
    return function


def _in_one_line(error: BaseException) -> str:
    """Return an error of a user's module in one line, with file and line of its innermost frame."""
    place = traceback.extract_tb(error.__traceback__)[-1]
    where = "" if isinstance(error, SyntaxError) else f" ({Path(place.filename).name}, line {place.lineno})"
    return f"{type(error).__name__}: {' '.join(str(error).split())}{where}"
