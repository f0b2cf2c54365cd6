"""Which scene a command is about: one of the library, or a function of the user's own, with the values of a file."""

from __future__ import annotations

import importlib
import sys
from pathlib import Path

from servocore.errors import InvalidSetting
from servocore.model.parameter_files import read_parameters
from servocore.model.scene import Scene
from servocore.problem import Problem
from servocore.references.csv_file import from_csv
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
    scene = _own(name) if ":" in name else _registered(name)
    return scene if parameters is None else scene.with_parameters(**read_parameters(parameters, scene))


def path_columns(scene: Scene, model: str | None = None) -> tuple[list[str], list[str]]:
    """Return the names and the units of the position columns that files of a scene's path have: its outputs."""
    outputs = scene.model(model).outputs
    return [output.name for output in outputs], [output.unit for output in outputs]


def along(scene: Scene, reference: Path | None, model: str | None = None) -> Scene:
    """Return the scene with the path of a file, whose columns its outputs name; the scene as it is without one.

    The path is as smooth as the scene's inputs need it, as that of `servocore feedforward`.
    """
    if reference is None:
        return scene
    order = Problem.of(scene, model).array.reference_order
    names, units = path_columns(scene, model)
    return scene.with_reference(from_csv(reference, columns=names, rest_order=order, units=units))


def _registered(name: str) -> Scene:
    if name not in REGISTRY:
        raise InvalidSetting(
            f"no scene is called {name}; there are {', '.join(REGISTRY)}, and module:function for one of your own"
        )
    return REGISTRY[name]()


def _own(name: str) -> Scene:
    module_name, _, function_name = name.partition(":")
    here = str(Path.cwd())
    if here not in sys.path:
        sys.path.insert(0, here)
    try:
        module = importlib.import_module(module_name)
    except ModuleNotFoundError as error:
        raise InvalidSetting(f"{name}: there is no module {error.name}") from None
    except (ImportError, SyntaxError, ValueError, TypeError) as error:
        raise InvalidSetting(f"{name}: the module cannot be imported: {error}") from error
    function = getattr(module, function_name, None)
    if not callable(function):
        raise InvalidSetting(f"{name}: the module {module_name} has no function {function_name!r}")
    try:
        found = function()
    except TypeError as error:
        raise InvalidSetting(f"{name} cannot be called without arguments: {error}") from error
    if not isinstance(found, Scene):
        raise InvalidSetting(f"{name} returns {type(found).__name__}, not a Scene")
    return found
