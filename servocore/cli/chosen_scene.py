"""The scene that a command names: of the library, or of a module of the user."""

from __future__ import annotations

import importlib
import sys
import traceback
from collections.abc import Callable, Mapping
from pathlib import Path

from servocore.errors import InvalidSetting, ServocoreError
from servocore.importers.from_file import SUFFIXES, read_tree, scene_of
from servocore.importers.options import Options
from servocore.model.scene import Scene
from servocore.scenes import REGISTRY


def chosen_scene(name: str, settings: Mapping[str, object] | None = None) -> Scene:
    """Return a scene of the library, of a robot file, or of a function ``module:function`` without arguments.

    Modules are also searched for in the current folder. `InvalidSetting` is raised if there is no such scene, module or
    function, the function returns something else, or there are settings for something else than a file.
    """
    if Path(name).suffix.lower() in SUFFIXES:
        tree = read_tree(name)
        return scene_of(tree, Options.of(settings or {}, tree, "the import of " + tree.source))
    if settings:
        raise InvalidSetting(f"{name} is no URDF, MJCF or SDF file: {', '.join(settings)} cannot be set")
    if ":" in name:
        return _scene_of_user(name)
    if name not in REGISTRY:
        raise InvalidSetting(
            f"no scene is called {name or repr(name)}; there are {', '.join(REGISTRY)}, module:function for one of your"
            f" own, and files *{', *'.join(SUFFIXES)}"
        )
    return REGISTRY[name]()


def _scene_of_user(name: str) -> Scene:
    """Return the scene that a function ``module:function`` returns."""
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
    """Import the function ``module:function``; modules are also searched for in the current folder."""
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
